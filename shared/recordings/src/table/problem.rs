//! What can be wrong with a table, and where.

use std::fmt;

/// A place in a table that cannot be read, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {problem}")]
pub struct TableError {
    /// Line, counted from 1; a header line counts.
    pub line: u64,
    /// Column, counted from 1: column 1 is channel 0. Where values are missing, the first missing one.
    pub column: usize,
    /// What is wrong there and what to do.
    pub problem: TableProblem,
}

/// What can be wrong with a place in a table. Each message says what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TableProblem {
    /// There is no line with numbers.
    #[error("the file has no samples: record it again or leave it out")]
    Empty,
    /// Many lines, none with a number.
    #[error(
        "no line up to this one, which begins with `{0}`, holds samples: write them as numbers such as -12 or 0.5e-3, with a \
         decimal comma only between tabs or ;, and with no more than 1000 lines before them"
    )]
    NoNumbers(String),
    /// A blank line with samples after it.
    #[error("blank line before the end: delete it, or cut the file in two if samples were lost here")]
    BlankLine,
    /// More or fewer values than line 1 has.
    #[error(
        "expected {expected} values as in line 1, found {found}: complete or delete this line \
         (deleting shortens the recording by one sample)"
    )]
    Ragged {
        /// Values in line 1.
        expected: usize,
        /// Values in this line.
        found: usize,
    },
    /// The last line has no newline and is incomplete: the file was cut off while it was written.
    #[error(
        "the file is truncated: its last line ends after {found} of {expected} values; \
         delete that line or copy the file again"
    )]
    Truncated {
        /// Values in line 1.
        expected: usize,
        /// Values that are complete.
        found: usize,
    },
    /// Infinity, or a number too large for 32-bit floating point.
    #[error("`{0}` is not a finite sample: cut the recording here or choose other channels")]
    NotFinite(String),
    /// Text where a number belongs.
    #[error(
        "`{0}` is not a number: samples are written like -12 or 0.5e-3, with a decimal comma only between tabs or ;: \
         choose other channels if this column holds no samples"
    )]
    NotANumber(String),
    /// Bytes that are not UTF-8 text, or control characters.
    #[error("binary or non-UTF-8 bytes: save the recording as UTF-8 text, one line a sample")]
    NotText,
    /// Lines that end as on old Macs.
    #[error(
        "its lines end with a carriage return (CR) alone, as old Mac programs write them: save the recording with line ends of \
         Unix (LF) or Windows (CR LF)"
    )]
    LineEnds,
    /// More values in a line than names above them.
    #[error(
        "this line has {values} values, but the line above it names only {names} columns: between values with decimal commas take ; or \
         tabs, otherwise name every column, or delete the line of names"
    )]
    FewerNames {
        /// Names of columns.
        names: usize,
        /// Values in the line.
        values: usize,
    },
    /// No channel was chosen.
    #[error("no channel is chosen: choose at least one of the {columns} (channels 0 to {last})", last = .columns - 1)]
    NoChannels {
        /// Columns of the file.
        columns: usize,
    },
    /// A chosen column number beyond the last column.
    #[error("there is no channel {channel}: the file has {columns} (channels 0 to {last}); choose among them", last = .columns - 1)]
    MissingChannel {
        /// The channel asked for.
        channel: usize,
        /// Columns of the file.
        columns: usize,
    },
    /// Too few columns that look like EMG.
    #[error(
        "{wanted} channels of EMG are wanted, but {}: choose channels by name or number ({columns})",
        looking_like_emg(*.found)
    )]
    TooFewMuscles {
        /// Columns asked for.
        wanted: usize,
        /// How many look like them.
        found: usize,
        /// All columns, with what each looks like.
        columns: String,
    },
    /// A column that is named like a muscle and rises like time.
    #[error(
        "column `{0}` is named like a muscle, but rises evenly, as time does: choose the channels by name or number"
    )]
    RisingMuscle(String),
    /// Columns that were not sampled at the same rate.
    #[error("{columns}: choose columns of one rate")]
    RatesDiffer {
        /// Two of them with their rates, in words.
        columns: String,
    },
    /// A chosen name that the header line does not hold.
    #[error("there is no channel named `{name}`: {}", available(.names))]
    MissingName {
        /// The name asked for.
        name: String,
        /// The names of the header line; empty when there is none.
        names: Vec<String>,
    },
    /// A chosen name that the header line holds twice.
    #[error("two columns are named `{0}`: choose by column number instead")]
    AmbiguousName(String),
    /// One column chosen twice.
    #[error("channel {0} is chosen twice: choose each channel once")]
    ChosenTwice(usize),
}

/// A sampling rate in a message: to 6 digits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate(pub f64);

impl Eq for Rate {}

impl fmt::Display for Rate {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.abs() >= 1e9 {
            return write!(out, "{:.3e}", self.0);
        }
        let text = format!("{:.3}", self.0);
        out.write_str(text.trim_end_matches('0').trim_end_matches('.'))
    }
}

fn looking_like_emg(columns: usize) -> String {
    match columns {
        0 => "no column looks like one".to_owned(),
        1 => "1 column looks like one".to_owned(),
        _ => format!("{columns} columns look like them"),
    }
}

fn available(names: &[String]) -> String {
    if names.is_empty() {
        "the file has no header line; choose by column number, counted from 0".to_owned()
    } else {
        format!("choose among {}", names.join(", "))
    }
}

pub(super) fn error_at(line: u64, column: usize, problem: TableProblem) -> TableError {
    TableError { line, column, problem }
}
