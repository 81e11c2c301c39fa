//! What can be wrong with a `labels.csv`.

use std::io;
use std::path::PathBuf;

use tendon_identity::NoPersonId;

use super::COLUMNS;

/// A place in a labels file that cannot be used, and what to do.
#[derive(Debug, thiserror::Error)]
#[error("{}, line {line}: {problem}", .path.display())]
pub struct LabelsError {
    /// The labels file.
    pub path: PathBuf,
    /// Counted from 1; the header line counts.
    pub line: u64,
    /// What is wrong there.
    pub problem: LabelsProblem,
}

/// What can be wrong with a line of a labels file. Each message says what to do.
#[derive(Debug, thiserror::Error)]
pub enum LabelsProblem {
    /// The file cannot be read.
    #[error("cannot be read ({0})")]
    Read(io::Error),
    /// A line that is not CSV in UTF-8.
    #[error("{0}")]
    Csv(csv::Error),
    /// A column with a name that means nothing here.
    #[error("unknown column `{name}`: the columns are {}", COLUMNS.join(","))]
    UnknownColumn {
        /// The name in the header.
        name: String,
    },
    /// A column that is there twice.
    #[error("column `{0}` is there twice: leave one out")]
    ColumnTwice(&'static str),
    /// A column that is needed and missing.
    #[error("there is no column `{name}`: begin with {}", COLUMNS.join(","))]
    MissingColumn {
        /// Its name.
        name: &'static str,
    },
    /// A label of no file.
    #[error("names no file: give its path relative to the folder of labels.csv")]
    NoFile,
    /// A cell that names no person.
    #[error("person: {0}")]
    NoPerson(NoPersonId),
    /// A cell that is not a whole number, or too large.
    #[error("{column} = `{text}`: give a whole number of 0 to {largest}")]
    NotANumber {
        /// The column.
        column: &'static str,
        /// What the cell holds.
        text: String,
        /// The largest number that may stand there.
        largest: u64,
    },
    /// A cell that is no time in a file.
    #[error("{column} = `{text}`: give a number of seconds from the first sample of the file, such as 12.5")]
    NoSeconds {
        /// The column.
        column: &'static str,
        /// What the cell holds.
        text: String,
    },
    /// A place that is given twice.
    #[error("{sample} and {seconds} are both given: leave one empty")]
    TwoPlaces {
        /// One column.
        sample: &'static str,
        /// The other one.
        seconds: &'static str,
    },
    /// Two names that become the same.
    #[error("{names} would both be called {person}: give one of them another name")]
    SamePerson {
        /// Both names.
        names: String,
        /// What both become.
        person: String,
    },
    /// A trial without samples.
    #[error("the trial ends at or before its start ({start}): give an end after the start")]
    EndsBeforeStart {
        /// Where the trial begins, as it stands there.
        start: String,
    },
    /// Labels of one file name two people or sessions.
    #[error(
        "{file} is of {origin} here, but of {first_origin} in line {first_line}: a file is one person's, made in one session"
    )]
    OtherOrigin {
        /// The file, as the line names it.
        file: String,
        /// Person and session of this line, in words.
        origin: String,
        /// Those of the first line that names the file.
        first_origin: String,
        /// That line.
        first_line: u64,
    },
    /// Two trials that share samples.
    #[error(
        "its trial and that of line {other_line} share samples of the same file: end one where the next starts"
    )]
    Overlap {
        /// The other line.
        other_line: u64,
    },
}
