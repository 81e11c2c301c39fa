//! What a build that did not come to its end has finished: `progress.jsonl`, beside the windows.
//!
//! ```text
//! 1f0c2a9b {"format":1,"settings":{…},"recordings":[…]}     what is being built
//! 77ab03d1 {"windows":24,"checksum":…,"trials":[…],…}       after each recording, its windows being written
//! └ checksum of the line
//! ```
//! The next build of the same data set continues after the last line that is intact and whose windows in
//! `windows.npy` match their checksum. Everything after it is rebuilt.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;
use std::time::UNIX_EPOCH;

use serde::{Deserialize, Serialize};

use tendon_recordings::SkippedEntry;

use crate::files::PROGRESS;
use crate::recording::Recording;
use crate::settings::DatasetSettings;
use crate::trial::RecordingEntry;

/// Changes when other windows would come from the same recordings and settings.
const FORMAT: u32 = 1;

/// What is being built. Only the same is gone on with.
#[derive(Serialize)]
struct Plan<'a> {
    format: u32,
    version: &'static str,
    settings: &'a DatasetSettings,
    recordings: Vec<PlannedRecording>,
}

#[derive(Serialize)]
struct PlannedRecording {
    /// All that is known of it.
    recording: String,
    /// Length and time of the last change, in ns, of each of its files.
    files: Vec<(u64, u128)>,
}

/// A recording that is finished.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Finished {
    /// Its windows.
    pub(crate) windows: u64,
    /// CRC-32 of the bytes of its windows.
    pub(crate) checksum: u32,
    pub(crate) trials: Vec<RecordingEntry>,
    pub(crate) skipped: Vec<SkippedEntry>,
    pub(crate) notices: Vec<String>,
}

/// The open file. As long as it is open, no other build writes to the folder.
#[derive(Debug)]
pub(crate) struct Journal {
    file: File,
}

/// What was found of an earlier build.
#[derive(Debug, PartialEq)]
pub(crate) enum Earlier {
    /// Nothing.
    None,
    /// One of something else.
    Other,
    /// One of the same, with these recordings finished.
    Same(Vec<Finished>),
}

/// Why there is no journal.
pub(crate) enum JournalError {
    /// Another build is writing to the folder.
    InUse,
    Io(io::Error),
}

impl From<io::Error> for JournalError {
    fn from(error: io::Error) -> JournalError {
        JournalError::Io(error)
    }
}

impl Journal {
    /// Opens the journal in `folder` to continue the build it records, or starts a new one.
    pub(crate) fn open(
        folder: &Path,
        settings: &DatasetSettings,
        recordings: &[Recording],
    ) -> Result<(Journal, Earlier), JournalError> {
        let path = folder.join(PROGRESS);
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(JournalError::InUse),
            Err(TryLockError::Error(error)) => return Err(error.into()),
        }
        let plan = plan(settings, recordings)?;
        let text = tendon_input::read_file(&file, tendon_input::LARGEST_LIST)?;
        let mut lines = text.split_inclusive(|&byte| byte == b'\n');
        let found = lines.next();
        let mut journal = Journal { file };
        if found != Some(plan.as_slice()) {
            journal.keep(0)?;
            journal.file.write_all(&plan)?;
            let earlier = if text.is_empty() { Earlier::None } else { Earlier::Other };
            return Ok((journal, earlier));
        }
        let finished: Vec<Finished> = lines.map_while(parse).take(recordings.len()).collect();
        Ok((journal, Earlier::Same(finished)))
    }

    /// Forgets all but the first `recordings` recordings.
    pub(crate) fn keep_recordings(&mut self, recordings: usize) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        let text = tendon_input::read_file(&self.file, tendon_input::LARGEST_LIST)?;
        let kept: usize =
            text.split_inclusive(|&byte| byte == b'\n').take(1 + recordings).map(<[u8]>::len).sum();
        self.keep(kept as u64)
    }

    fn keep(&mut self, bytes: u64) -> io::Result<()> {
        self.file.set_len(bytes)?;
        self.file.seek(SeekFrom::Start(bytes))?;
        Ok(())
    }

    /// Says that the next recording is finished. Its windows must have been handed to the system.
    pub(crate) fn push(&mut self, finished: &Finished) -> io::Result<()> {
        self.file.write_all(&line(finished)?)
    }
}

fn plan(settings: &DatasetSettings, recordings: &[Recording]) -> io::Result<Vec<u8>> {
    let describe = |recording: &Recording| {
        let state_of = |path: &Path| {
            let metadata = path.metadata().ok()?;
            let changed = metadata.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
            Some((metadata.len(), changed.as_nanos()))
        };
        let files = recording.files().iter().map(|path| state_of(path).unwrap_or_default()).collect();
        PlannedRecording { recording: format!("{recording:?}"), files }
    };
    line(&Plan {
        format: FORMAT,
        version: env!("CARGO_PKG_VERSION"),
        settings,
        recordings: recordings.iter().map(describe).collect(),
    })
}

fn line(content: &impl Serialize) -> io::Result<Vec<u8>> {
    let json = serde_json::to_string(content)?;
    Ok(format!("{:08x} {json}\n", crc32fast::hash(json.as_bytes())).into_bytes())
}

/// The content of a line, if it is intact.
fn parse(line: &[u8]) -> Option<Finished> {
    let text = std::str::from_utf8(line.strip_suffix(b"\n")?).ok()?;
    let (checksum, json) = text.split_once(' ')?;
    if u32::from_str_radix(checksum, 16) != Ok(crc32fast::hash(json.as_bytes())) {
        return None;
    }
    serde_json::from_str(json).ok()
}
