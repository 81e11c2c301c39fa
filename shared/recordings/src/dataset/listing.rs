//! Which recordings lie under the paths that are given, whatever their layout.

use std::fs;
use std::path::{Path, PathBuf};

use crate::dataset::{DatasetError, DatasetSettings, SkippedEntry};
use crate::error::RecordingError;
use crate::replay::ReplayStream;
use crate::source::{RecordingSettings, RecordingSource};
use crate::three_dc;

/// One person's samples without a gap, through which the filter runs without a break, made of trials.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// The file, or the folder whose files it is made of.
    pub path: PathBuf,
    /// Number of the person.
    pub person: u16,
    /// When it was made, in the words of its layout: `train` and `test` of 3DC.
    pub session: String,
    /// Repetitions of the person's sessions before this one.
    repetitions_before: u32,
    content: Content,
}

/// What tells a recording's samples and trials.
#[derive(Clone, Debug, PartialEq)]
enum Content {
    /// A repetition of a 3DC folder.
    ThreeDc { repetition: u32 },
}

/// What [`list`] found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recordings {
    /// The recordings, in the order of a data set's windows.
    pub recordings: Vec<Recording>,
    /// What looks like a recording, but cannot be used, and why.
    pub skipped: Vec<SkippedEntry>,
}

impl Recording {
    /// Opens it to be read.
    pub(crate) fn open(&self, settings: &DatasetSettings) -> Result<RecordingSource, RecordingError> {
        match &self.content {
            Content::ThreeDc { repetition } => {
                let settings = RecordingSettings {
                    channels: settings.channels.clone(),
                    sample_rate_hz: None,
                    repetition: Some(*repetition),
                };
                RecordingSource::open(&self.path, &settings)
            }
        }
    }

    /// Opens it to be replayed in blocks of `block_samples`, at the rate of `settings` and with its channels.
    ///
    /// # Errors
    /// When it cannot be opened, or its rate cannot be brought to that of `settings`.
    pub fn stream(
        &self,
        settings: &DatasetSettings,
        block_samples: usize,
    ) -> Result<ReplayStream, RecordingError> {
        ReplayStream::of(self.open(settings)?, settings.sample_rate_hz, block_samples)
    }

    /// A repetition of this session, counted through all sessions of the person.
    pub(crate) fn repetition_of_all(&self, repetition: u32) -> u8 {
        u8::try_from(self.repetitions_before + repetition).unwrap_or(u8::MAX)
    }

    /// What went wrong with it, for the list of what was left out.
    pub(crate) fn skipped(&self, error: &RecordingError) -> SkippedEntry {
        let reason = match &self.content {
            Content::ThreeDc { repetition } => format!("repetition {repetition}: {error}"),
        };
        SkippedEntry { path: self.path.clone(), reason }
    }
}

/// Lists the recordings at or below `paths`.
///
/// # Errors
/// When there is none under one of the paths, or a folder cannot be read.
pub fn list(paths: &[PathBuf]) -> Result<Recordings, DatasetError> {
    let mut found = Recordings::default();
    for path in paths {
        let mut folders = Vec::new();
        gather_folders(path, &mut folders);
        if folders.is_empty() {
            return Err(DatasetError::Unplaced { folder: path.clone() });
        }
        folders.sort_by_key(|(_, person, session)| (*person, *session));
        for (folder, person, session) in folders {
            for repetition in three_dc::repetitions(&folder)? {
                found.recordings.push(Recording {
                    path: folder.clone(),
                    person,
                    session: session.name().to_owned(),
                    repetitions_before: session.repetitions_before(),
                    content: Content::ThreeDc { repetition },
                });
            }
        }
    }
    Ok(found)
}

/// The folders of recordings at or below `folder`.
fn gather_folders(folder: &Path, found: &mut Vec<(PathBuf, u16, three_dc::Session)>) {
    if let Some((person, session)) = three_dc::origin(folder) {
        found.push((folder.to_owned(), person, session));
        return;
    }
    // A folder that cannot be listed holds nothing for us; if nothing is found at all, that is an error.
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir())) {
        gather_folders(&entry.path(), found);
    }
}
