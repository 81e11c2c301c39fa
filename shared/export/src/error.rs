//! Why a session cannot be exported.

use std::io;
use std::path::{Path, PathBuf};

use tendon_config::ConfigError;
use tendon_session_file::SessionFileError;

/// Why a session cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] SessionFileError),
    /// The recorded configuration is not one of this version.
    #[error("{}: the recorded configuration cannot be read: use the Tendon that recorded the session", path.display())]
    Configuration {
        /// The recording.
        path: PathBuf,
        /// What is wrong with it.
        source: Box<ConfigError>,
    },
    /// It holds no samples.
    #[error("{}: the recording holds no samples, so there is nothing to export", path.display())]
    NoSamples {
        /// The recording.
        path: PathBuf,
    },
    /// Blocks that do not belong together.
    #[error(
        "{}: from {at_s:.3} s on the recording has {channels} channels at {sample_rate_hz} Hz, before it had \
         {expected_channels} at {expected_rate_hz} Hz: the file is damaged there",
        path.display()
    )]
    OtherSignal {
        /// The recording.
        path: PathBuf,
        /// Where, s.
        at_s: f64,
        /// Channels from there on.
        channels: usize,
        /// Rate from there on, Hz.
        sample_rate_hz: f64,
        /// Channels before.
        expected_channels: usize,
        /// Rate before, Hz.
        expected_rate_hz: f64,
    },
    /// Something is there already.
    #[error("{} is not empty: name another folder, or add --force to replace an earlier export in it", path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// Another export writes there now.
    #[error("something else is exported into {} right now: wait until it is done, or name another folder", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// A signal ended it.
    #[error("the export was interrupted: nothing of it is left")]
    Interrupted,
    /// The session is in the data set already.
    #[error("{} is there already: add --force to replace it", path.display())]
    Exists {
        /// The recording.
        path: PathBuf,
    },
    /// What is to be replaced was written by something else.
    #[error("{} is something else than an export: move it away, or name another place", path.display())]
    NoExport {
        /// The file or folder.
        path: PathBuf,
    },
    /// A value that BDF cannot hold.
    #[error(
        "channel {channel} reaches {value}, and BDF holds at most eight digits: export it as tables or XDF (--csv, --xdf)"
    )]
    TooLarge {
        /// The channel.
        channel: String,
        /// Its largest value.
        value: f32,
    },
    /// The people of the data set that is added to are not told.
    #[error("{}: its first line names no column participant_id, which BIDS wants: add it, or name another folder", path.display())]
    Participants {
        /// The file.
        path: PathBuf,
    },
    /// A file of the data set that is added to cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A file or folder cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

impl ExportError {
    /// What the system refused at `path`.
    pub(crate) fn writing(path: &Path) -> impl Fn(io::Error) -> ExportError + use<> {
        let path = path.to_owned();
        move |source| ExportError::Write { path: path.clone(), source }
    }
}
