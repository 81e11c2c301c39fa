//! The parts that a recording is made of, and what is known about each.

use std::collections::BTreeMap;
use std::fmt;
use std::mem::discriminant;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};
use tendon_gesture::Gesture;

use crate::check::LONGEST_SILENCE_S;
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
    /// Chosen columns do not look like EMG.
    NoMuscle {
        /// The file.
        file: PathBuf,
        /// The columns, and what each looks like.
        columns: Vec<(String, ColumnKind)>,
    },
    /// A column of a table says what was done when.
    Labels {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
    },
    /// That column has labels that are no gesture.
    LabelsLeftOut {
        /// The file.
        file: PathBuf,
        /// The column.
        column: String,
        /// The labels, at least one, as they are written, and the trials of each.
        labels: Vec<(String, u64)>,
    },
    /// The chosen columns of a table state different units, and are brought to that of the first.
    UnitsDiffer {
        /// The file.
        file: PathBuf,
        /// The unit that they are given in.
        unit: String,
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
    /// The longest gap is so long that a replay at its true pace does not wait for all of it.
    Silence {
        /// The recording.
        path: PathBuf,
        /// How long it is, in seconds.
        silence_s: f64,
        /// Seconds of samples before it.
        after_s: f64,
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
    /// Channels have the same value throughout.
    Constant {
        /// The recording.
        path: PathBuf,
        /// The channels, by name or number, and the value of each.
        channels: Vec<(String, f32)>,
    },
    /// A file was not ended by whoever wrote it.
    CutOff {
        /// The file.
        file: PathBuf,
        /// What it holds.
        read: String,
    },
    /// Parts of a file could not be understood.
    PartsDamaged {
        /// The file.
        file: PathBuf,
    },
    /// Channels of a file that are not read with the others.
    OtherRates {
        /// The file.
        file: PathBuf,
        /// The channels.
        channels: Vec<String>,
        /// Rate of those that are read, in Hz.
        sample_rate_hz: f64,
    },
    /// The time stamps of a file contradict its rate.
    OtherRateFound {
        /// The file.
        file: PathBuf,
        /// The rate that it states, in Hz.
        stated_hz: f64,
        /// The rate of its time stamps, in Hz.
        found_hz: f64,
    },
    /// Samples that are no finite number.
    SamplesMissing {
        /// The file.
        file: PathBuf,
        /// How many.
        samples: u64,
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
            Notice::NoMuscle { file, columns } => match &columns[..] {
                [(column, kind)] => write!(
                    formatter,
                    "{}: column `{column}` is taken as EMG, as asked, but looks like {kind}",
                    file.display()
                ),
                several => write!(
                    formatter,
                    "{}: columns are taken as EMG, as asked, that look like something else: {}",
                    file.display(),
                    list(several, |(column, kind)| format!("`{column}` like {kind}"))
                ),
            },
            Notice::Labels { file, column } => {
                write!(formatter, "{}: column `{column}` says which gestures were made", file.display())
            }
            Notice::LabelsLeftOut { file, column, labels } => {
                write!(formatter, "{}: {}", file.display(), labels_left_out(column, labels))
            }
            Notice::UnitsDiffer { file, unit } => {
                write!(
                    formatter,
                    "{}: its columns have different units: all are converted to {unit}",
                    file.display()
                )
            }
            Notice::Time { file, remark } => write!(formatter, "{}: {remark}", file.display()),
            Notice::Gaps { file, gaps, samples, line } => write!(
                formatter,
                "{}: {} missing in {} (the first before line {line}): nothing is joined across",
                file.display(),
                if *samples == 1 { "1 sample is".to_owned() } else { format!("{samples} samples are") },
                places(*gaps)
            ),
            Notice::Silence { path, silence_s, after_s } => write!(
                formatter,
                "{}: after {after_s:.1} s of samples, {silence_s:.0} s are missing: if a clock was set then, cut the recording in two; \
                 replayed at its true pace, it is silent for {LONGEST_SILENCE_S:.0} s of them",
                path.display()
            ),
            Notice::MissingSamples { file, lines, line } => write!(
                formatter,
                "{}: {} no sample in a chosen column (the first is line {line}): gaps of one sample each",
                file.display(),
                if *lines == 1 { "1 line has".to_owned() } else { format!("{lines} lines have") }
            ),
            Notice::Constant { path, channels } => match &channels[..] {
                [(channel, value)] => write!(
                    formatter,
                    "{}: channel {channel} was constant ({value}): is its electrode connected?",
                    path.display()
                ),
                several => write!(
                    formatter,
                    "{}: channels {} were constant: are their electrodes connected?",
                    path.display(),
                    list(several, |(channel, value)| format!("{channel} ({value})"))
                ),
            },
            Notice::CutOff { file, read } => write!(
                formatter,
                "{}: the file was cut off or not closed; what it holds was read: {read}",
                file.display()
            ),
            Notice::PartsDamaged { file } => {
                write!(formatter, "{}: parts of the file are damaged and were passed over", file.display())
            }
            Notice::OtherRates { file, channels, sample_rate_hz } => write!(
                formatter,
                "{}: passed over because their rate is not {sample_rate_hz:.3} Hz: {}",
                file.display(),
                channels.join(", ")
            ),
            Notice::OtherRateFound { file, stated_hz, found_hz } => write!(
                formatter,
                "{}: it says {stated_hz} Hz, but its time stamps say {found_hz:.3} Hz, which is taken",
                file.display()
            ),
            Notice::SamplesMissing { file, samples } => write!(
                formatter,
                "{}: samples that are no finite number in one of the channels, or only fill a record up, are taken as missing: {samples}",
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

/// What is left out of a column of labels: `left out of column `label`: 2 trials of `😀`: …`.
pub fn labels_left_out(column: &str, labels: &[(String, u64)]) -> String {
    /// So many labels are named.
    const NAMED: usize = 8;
    let trials = |(label, trials): &(String, u64)| {
        format!("{trials} {} of `{label}`", if *trials == 1 { "trial" } else { "trials" })
    };
    let named = list(&labels[..labels.len().min(NAMED)], trials);
    let more = match labels.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    format!(
        "left out of column `{column}`: {named}{more}: a gesture has a name of its own, of 1 to 23 characters, without letters beyond \
         a-z, or a whole number from 0"
    )
}

/// One line for each kind of notice: the first of its kind, and how many more there are.
pub fn summed_up(notices: &[Notice]) -> Vec<String> {
    let is_alike = |one: &Notice, other: &Notice| discriminant(one) == discriminant(other);
    let firsts = notices
        .iter()
        .enumerate()
        .filter(|(place, notice)| !notices[..*place].iter().any(|before| is_alike(before, notice)));
    let line = |(place, first): (usize, &Notice)| match notices[place + 1..]
        .iter()
        .filter(|notice| is_alike(first, notice))
        .count()
    {
        0 => first.to_string(),
        1 => format!("{first} (and 1 more notice of this kind)"),
        more => format!("{first} (and {more} more notices of this kind)"),
    };
    firsts.map(line).collect()
}

fn list<T>(items: &[T], in_words: impl Fn(&T) -> String) -> String {
    items.iter().map(in_words).collect::<Vec<_>>().join(", ")
}

fn places(count: u64) -> String {
    if count == 1 { "1 place".to_owned() } else { format!("{count} places") }
}

/// Why something is left out, to sum it up by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkippedKind {
    /// A trial of a gesture that is not asked for, or has no name.
    OtherGesture,
    /// Trials of a table by their labels, which are no gesture.
    OtherLabels,
    /// A table of which nothing says what it shows.
    NoLabel,
    /// A file that labels name, but that is not there.
    NotThere,
    /// A recording that cannot be read.
    Unreadable,
    /// A recording without a trial.
    NoTrial,
    /// A trial that its file does not hold to the end.
    CutOff,
    /// A trial too short for a window.
    TooShort,
    /// A trial too long to be held in memory.
    TooLong,
    /// A trial with samples that no amplifier delivers.
    Faulty,
    /// A recording that was given twice.
    Twice,
    /// A file that lies beside recordings and is none.
    OtherFile,
    /// A person who cannot be calibrated or scored.
    Person,
    /// Nothing: a word about a recording that was used.
    Notice,
    /// Anything else.
    #[default]
    Other,
}

impl SkippedKind {
    /// So many of this kind, in words: `3 files without labels`.
    pub fn counted(self, count: usize) -> String {
        let (one, several) = match self {
            SkippedKind::OtherGesture => ("trial of another gesture", "trials of other gestures"),
            SkippedKind::OtherLabels => {
                ("recording with labels that are no gesture", "recordings with labels that are no gesture")
            }
            SkippedKind::NoLabel => ("file without labels", "files without labels"),
            SkippedKind::NotThere => ("file that is not there", "files that are not there"),
            SkippedKind::Unreadable => ("recording that cannot be read", "recordings that cannot be read"),
            SkippedKind::NoTrial => ("recording without trials", "recordings without trials"),
            SkippedKind::CutOff => ("trial that is cut off", "trials that are cut off"),
            SkippedKind::TooShort => ("trial too short for a window", "trials too short for a window"),
            SkippedKind::TooLong => ("trial that is too long", "trials that are too long"),
            SkippedKind::Faulty => ("trial with faulty samples", "trials with faulty samples"),
            SkippedKind::Twice => ("recording given twice", "recordings given twice"),
            SkippedKind::OtherFile => ("file that is no recording", "files that are no recordings"),
            SkippedKind::Person => ("person", "people"),
            SkippedKind::Notice => ("notice about a recording", "notices about recordings"),
            SkippedKind::Other => ("other", "others"),
        };
        format!("{count} {}", if count == 1 { one } else { several })
    }

    /// How many there are of each kind.
    pub fn count(kinds: impl IntoIterator<Item = SkippedKind>) -> BTreeMap<SkippedKind, usize> {
        let mut counts = BTreeMap::new();
        kinds.into_iter().for_each(|kind| *counts.entry(kind).or_default() += 1);
        counts
    }
}

/// A file, a part of one, or a whole recording that was left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkippedEntry {
    /// The file, or the folder of the recording.
    #[serde(serialize_with = "as_displayed")]
    pub path: PathBuf,
    /// Why, in short; of an earlier version [`SkippedKind::Other`].
    #[serde(default)]
    pub kind: SkippedKind,
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
