//! The parts that a recording is made of, and what is known about each.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};
use tendon_gesture::Gesture;

use crate::table::{ColumnKind, TimingRemark};

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
    /// A chosen column does not look like EMG.
    NoMuscle {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
        /// What it looks like.
        kind: ColumnKind,
    },
    /// Something about the time of a table.
    Time {
        /// The file.
        file: PathBuf,
        /// What.
        remark: TimingRemark,
    },
    /// Samples are missing, by the column of time or a counter.
    Gaps {
        /// The file.
        file: PathBuf,
        /// In how many places.
        gaps: u64,
        /// How many samples.
        samples: u64,
        /// The line after the first of them.
        line: u64,
    },
    /// Lines have no sample in a chosen column.
    MissingSamples {
        /// The file.
        file: PathBuf,
        /// How many.
        lines: u64,
        /// The first one.
        line: u64,
    },
    /// A channel has the same value throughout.
    Constant {
        /// The recording.
        path: PathBuf,
        /// The channel, by name or number.
        channel: String,
        /// The value.
        value: f32,
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
            Notice::NoMuscle { file, column, kind } => write!(
                formatter,
                "{}: column `{column}` is taken as EMG, as asked, but looks like {kind}",
                file.display()
            ),
            Notice::Time { file, remark } => write!(formatter, "{}: {remark}", file.display()),
            Notice::Gaps { file, gaps, samples, line } => write!(
                formatter,
                "{}: {samples} samples are missing in {} (the first before line {line}): nothing is joined across",
                file.display(),
                places(*gaps)
            ),
            Notice::MissingSamples { file, lines, line } => write!(
                formatter,
                "{}: {} no sample in a chosen column (the first is line {line}): gaps of one sample each",
                file.display(),
                if *lines == 1 { "1 line has".to_owned() } else { format!("{lines} lines have") }
            ),
            Notice::Constant { path, channel, value } => write!(
                formatter,
                "{}: channel {channel} was constant ({value}): is its electrode connected?",
                path.display()
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

fn places(count: u64) -> String {
    if count == 1 { "1 place".to_owned() } else { format!("{count} places") }
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
