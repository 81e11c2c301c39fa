//! The parts that a recording is made of, and what is known about each.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};
use tendon_gesture::Gesture;

/// A file of a recording, or a part of one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segment {
    /// The file.
    pub file: PathBuf,
    /// Repetition that the segment is a trial of; `None` of a plain table and of what lies between trials.
    pub repetition: Option<u32>,
    /// What the person was asked to do; `None` if unknown or none of ours.
    pub cue: Option<Gesture>,
    /// Index within the file of the first sample after this segment, at the recording's rate;
    /// `None` if it lasts to the end of the file.
    pub end_sample: Option<u64>,
    /// Samples that are missing before its first one, at the recording's rate; 0 if it follows on what is before it.
    pub samples_lost_before: u64,
}

/// Something about a recording that does not keep it from being read, but that its user should know.
#[derive(Clone, Debug, PartialEq)]
pub enum Notice {
    /// A repetition lacks a file: what is before and after it is not continuous.
    MissingFile {
        /// The file that is not there.
        file: PathBuf,
    },
    /// A folder lacks a repetition between others.
    MissingRepetition {
        /// The folder.
        folder: PathBuf,
        /// The repetition that is not there.
        repetition: u32,
    },
    /// The last line of a recording that Tendon made is not whole: the disk was full, or the power gone.
    CutShort {
        /// The file.
        file: PathBuf,
        /// Whole lines of samples before it.
        lines: u64,
    },
    /// No ratio of small numbers leads from the rate of the recording to that of the session.
    RateApproximated {
        /// Rate of the recording.
        from_hz: f64,
        /// Rate of the session.
        to_hz: f64,
        /// So many samples are made …
        up: u64,
        /// … of so many.
        down: u64,
        /// How far that is from the true ratio.
        error_ppm: f64,
    },
}

impl fmt::Display for Notice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Notice::MissingFile { file } => {
                write!(formatter, "{} is missing: the recording jumps there", file.display())
            }
            Notice::MissingRepetition { folder, repetition } => {
                write!(formatter, "{} has no repetition {repetition}", folder.display())
            }
            Notice::CutShort { file, lines } => write!(
                formatter,
                "{}: the last line is cut short and was left out; {lines} lines of samples before it were read",
                file.display()
            ),
            Notice::RateApproximated { from_hz, to_hz, up, down, error_ppm } => write!(
                formatter,
                "{from_hz} Hz is brought to {to_hz} Hz by the ratio {up}/{down}, {:.3} ppm off: {:.1} ms in an hour",
                error_ppm.abs(),
                error_ppm.abs() * 3.6
            ),
        }
    }
}

/// A file, a part of one, or a whole recording that was left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkippedEntry {
    /// The file, or the folder of the recording.
    #[serde(serialize_with = "as_displayed")]
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

impl fmt::Display for SkippedEntry {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.path.display(), self.reason)
    }
}

/// JSON holds only UTF-8: of another name, what a message would show.
fn as_displayed<S: Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&path.display())
}
