//! What can be wrong with a recording.

use std::io;
use std::path::{Path, PathBuf};

use tendon_signal::{DesignError, UnitError};

use crate::mat::MatError;
use crate::recorder::RecorderError;
use crate::signals::SignalsError;
use crate::table::{Rate, TableError, TableProblem};

/// A recording that cannot be read. Each message says where and what to do.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// A file or folder that is not there or not readable.
    #[error("cannot open {}: {reason}; check the path and its permissions", .path.display())]
    Open {
        /// What was to be opened.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// A path without a known layout.
    #[error(
        "{} is not a recording that can be read: give a table of samples (.csv, .tsv or .txt), a file .edf, .bdf, .xdf or .xdfz, a file \
         3dc_EMG_gesture_R_G.txt, or the EMG folder that holds such files",
        .path.display()
    )]
    UnknownLayout {
        /// The path.
        path: PathBuf,
    },
    /// A repetition that the folder does not hold.
    #[error("{} has no repetition {repetition}: choose among {}", .folder.display(), listed(available))]
    NoSuchRepetition {
        /// The EMG folder.
        folder: PathBuf,
        /// The repetition asked for.
        repetition: u32,
        /// The repetitions that are there.
        available: Vec<u32>,
    },
    /// A repetition was given for a single file.
    #[error("{} is a single file: leave out repetition, which chooses within a 3DC EMG folder", .file.display())]
    RepetitionOfFile {
        /// The file.
        file: PathBuf,
    },
    /// A column of labels was given for what has cues of its own.
    #[error("{} has cues of its own: leave out label_column, which is for tables", .path.display())]
    OwnCues {
        /// The recording.
        path: PathBuf,
    },
    /// A column of labels that names no gesture.
    #[error(
        "{}: column `{column}` names no gesture: give as label_column one with words, such as rest and grip, or whole \
         numbers, of which 0 is rest",
        .file.display()
    )]
    NoLabels {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
    },
    /// A plain table whose sampling rate was not given.
    #[error("{} does not state its sampling rate: give sample_rate_hz, e.g. 2000", .file.display())]
    SampleRateMissing {
        /// The file.
        file: PathBuf,
    },
    /// A plain table whose first lines state rates of which none can be taken.
    #[error(
        "{} states {}, which does not tell its sampling rate: give sample_rate_hz (--recording-rate-hz), e.g. 2000",
        .file.display(),
        .stated.iter().map(|rate| format!("{rate} Hz")).collect::<Vec<_>>().join(" and ")
    )]
    SampleRateUnclear {
        /// The file.
        file: PathBuf,
        /// What it states.
        stated: Vec<Rate>,
    },
    /// A sampling rate other than the one the layout has.
    #[error(
        "{} was sampled at {actual_hz} Hz, but sample_rate_hz = {given_hz}: leave sample_rate_hz out",
        .path.display()
    )]
    SampleRateDiffers {
        /// The recording.
        path: PathBuf,
        /// The rate of the layout.
        actual_hz: f64,
        /// The rate in the settings.
        given_hz: f64,
    },
    /// A recording without a single frame.
    #[error("{}: no line has a sample in every chosen column ({channels}): choose other channels", .path.display())]
    NoSamples {
        /// The recording.
        path: PathBuf,
        /// The chosen columns.
        channels: String,
    },
    /// Rates between which no resampler is made.
    #[error(
        "cannot resample from {} Hz to {to_hz} Hz: both must be above 0, and neither more than 100000 times the other; check the \
         rate of the recording",
        Rate(*.from_hz)
    )]
    Resampling {
        /// Rate of the recording.
        from_hz: f64,
        /// Rate of the session.
        to_hz: f64,
    },
    /// A block of no samples.
    #[error("block_samples = 0: give a number of samples, e.g. 10")]
    NoBlock,
    /// A place in a file that cannot be read.
    #[error("{}, {error}", .file.display())]
    Table {
        /// The file.
        file: PathBuf,
        /// The place and what is wrong there.
        error: TableError,
    },
    /// A MAT-file that cannot be read.
    #[error("{} {error}", .file.display())]
    Mat {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        error: MatError,
    },
    /// A file of samples that describes itself, and cannot be read.
    #[error("{} {error}", .file.display())]
    Signals {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        error: SignalsError,
    },
    /// A channel chosen by name where channels have none.
    #[error("{} has no channel names: choose `{name}` by its number, counted from 0", .file.display())]
    NamedChannel {
        /// The file.
        file: PathBuf,
        /// The name asked for.
        name: String,
    },
    /// A description of a recording that cannot be read.
    #[error(transparent)]
    Recorded(#[from] RecorderError),
    /// Samples whose unit cannot be converted.
    #[error(transparent)]
    Unit(#[from] UnitError),
    /// Settings from which no filter or window can be made.
    #[error(transparent)]
    Design(#[from] DesignError),
}

/// `0, 1, 2`.
fn listed(numbers: &[u32]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

impl RecordingError {
    /// Whether a channel was asked for by a number that the recording does not have.
    pub fn is_missing_channel(&self) -> bool {
        match self {
            RecordingError::Table { error, .. } => {
                matches!(
                    error.problem,
                    TableProblem::MissingChannel { .. } | TableProblem::TooFewMuscles { .. }
                )
            }
            RecordingError::Mat { error, .. } => matches!(error, MatError::NoColumn { .. }),
            RecordingError::Signals { error, .. } => {
                matches!(error, SignalsError::Channel(TableProblem::MissingChannel { .. }))
            }
            _ => false,
        }
    }

    /// What is wrong, where `path` is named already: a file below it by its name there.
    pub fn below(&self, path: &Path) -> String {
        let (file, problem) = match self {
            RecordingError::Table { file, error } => (file, error.to_string()),
            RecordingError::Mat { file, error } => (file, error.to_string()),
            RecordingError::Signals { file, error } => (file, error.to_string()),
            other => return other.to_string(),
        };
        match file.strip_prefix(path) {
            Ok(rest) if rest.as_os_str().is_empty() => problem,
            Ok(rest) => format!("{}, {problem}", rest.display()),
            Err(_) => self.to_string(),
        }
    }

    pub(crate) fn table(file: &Path) -> impl FnOnce(TableError) -> RecordingError + '_ {
        |error| RecordingError::Table { file: file.to_owned(), error }
    }

    pub(crate) fn mat(file: &Path) -> impl Fn(MatError) -> RecordingError + '_ {
        |error| RecordingError::Mat { file: file.to_owned(), error }
    }

    pub(crate) fn signals(file: &Path) -> impl FnOnce(SignalsError) -> RecordingError + '_ {
        |error| RecordingError::Signals { file: file.to_owned(), error }
    }

    pub(crate) fn open(path: &Path) -> impl FnOnce(io::Error) -> RecordingError + '_ {
        |reason| RecordingError::Open { path: path.to_owned(), reason }
    }
}
