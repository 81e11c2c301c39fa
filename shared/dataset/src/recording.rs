//! One recording of a data set, whatever its layout.

use std::path::PathBuf;

use tendon_identity::PersonId;
use tendon_recordings::{
    Channel, RecordingError, RecordingSettings, RecordingSource, ReplayStream, Segment, SkippedEntry,
    SkippedKind, ozdemir, three_dc,
};

use crate::settings::DatasetSettings;

/// One person's samples without a gap, through which the filter runs without a break, made of trials.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// The file, or the folder whose files it is made of.
    pub path: PathBuf,
    /// Whose it is.
    pub person: PersonId,
    /// When it was made, in the words of its layout: `train` and `test` of 3DC.
    pub session: String,
    /// Repetitions of the person's sessions before this one.
    pub(crate) repetitions_before: u32,
    pub(crate) content: Content,
}

/// Where a recording's samples are, and how its trials are found.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Content {
    /// A repetition of a 3DC folder.
    ThreeDc { repetition: u32 },
    /// A `.mat` file of Ozdemir 2022.
    OzdemirMat,
    /// A text table, divided like this.
    Table { segments: Vec<Segment>, default_hz: Option<f64>, units: Units },
    /// A file that describes itself, divided like this or by its own cues.
    Signals { segments: Option<Vec<Segment>>, units: Units },
}

/// The unit of a recording's samples and that of the data set; of neither or both is none known.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Units {
    pub(crate) own: String,
    pub(crate) wanted: String,
}

impl Units {
    fn convert(&self, mut source: RecordingSource) -> Result<RecordingSource, RecordingError> {
        // The chosen channels may be in another unit than the first ones.
        let own = if source.unit().is_empty() { self.own.clone() } else { source.unit().to_owned() };
        if !own.is_empty() && !self.wanted.is_empty() {
            source.convert(&own, &self.wanted)?;
        }
        Ok(source)
    }
}

impl Recording {
    /// Opens it to be read at its own rate.
    ///
    /// # Errors
    /// When it cannot be opened, or lacks a channel.
    pub fn open(&self, settings: &DatasetSettings) -> Result<RecordingSource, RecordingError> {
        let source = self.open_in_own_unit(settings)?;
        match &self.content {
            Content::ThreeDc { .. } | Content::OzdemirMat => Ok(source),
            Content::Table { units, .. } | Content::Signals { units, .. } => units.convert(source),
        }
    }

    /// The same with its samples as the file has them.
    fn open_in_own_unit(&self, settings: &DatasetSettings) -> Result<RecordingSource, RecordingError> {
        match &self.content {
            Content::ThreeDc { repetition } => {
                let settings = RecordingSettings {
                    channels: settings.channels.clone(),
                    sample_rate_hz: settings.recording_rate_hz,
                    repetition: Some(*repetition),
                    label_column: None,
                };
                RecordingSource::open(&self.path, &settings)
            }
            Content::OzdemirMat => ozdemir::open(&self.path, &settings.channels, settings.recording_rate_hz),
            Content::Table { segments, default_hz, .. } => {
                let rate_hz = settings.recording_rate_hz.or(*default_hz);
                RecordingSource::of_table(segments.clone(), &settings.channels, rate_hz)
            }
            Content::Signals { segments, .. } => {
                let (segments, rate_hz) = (segments.clone(), settings.recording_rate_hz);
                RecordingSource::of_signals(&self.path, segments, &settings.channels, rate_hz)
            }
        }
    }

    /// The channels of its first file, chosen or not: by name where it gives one, else by number from 0.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn file_channels(&self, settings: &DatasetSettings) -> Result<Vec<Channel>, RecordingError> {
        // The first one may be time or another sensor, whose unit is none of EMG.
        let first = DatasetSettings { channels: vec![Channel::Index(0)], ..settings.clone() };
        let names = self.open_in_own_unit(&first)?.file_names();
        let channel = |(index, name): (usize, &String)| {
            let is_unique = names.iter().filter(|other| *other == name).count() == 1;
            if is_unique && *name != index.to_string() {
                Channel::Name(name.clone())
            } else {
                Channel::Index(index)
            }
        };
        Ok(names.iter().enumerate().map(channel).collect())
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
    pub fn repetition_of_all(&self, repetition: u32) -> u8 {
        u8::try_from(self.repetitions_before + repetition).unwrap_or(u8::MAX)
    }

    /// What went wrong with it, for the list of what was left out.
    pub fn skipped(&self, error: &RecordingError) -> SkippedEntry {
        let problem = error.below(&self.path);
        let option = if error.is_missing_channel() { " with --channels" } else { "" };
        let reason = match &self.content {
            Content::ThreeDc { repetition } => format!("repetition {repetition}: {problem}{option}"),
            Content::OzdemirMat | Content::Table { .. } | Content::Signals { .. } => {
                format!("{problem}{option}")
            }
        };
        SkippedEntry { path: self.path.clone(), kind: SkippedKind::Unreadable, reason }
    }

    /// Its files.
    pub(crate) fn files(&self) -> Vec<PathBuf> {
        match &self.content {
            Content::ThreeDc { repetition } => three_dc::list(&self.path)
                .ok()
                .and_then(|mut files| files.remove(repetition))
                .map(|files| files.into_values().collect())
                .unwrap_or_default(),
            Content::OzdemirMat | Content::Table { .. } | Content::Signals { .. } => vec![self.path.clone()],
        }
    }
}
