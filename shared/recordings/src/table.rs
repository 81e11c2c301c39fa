//! Numbers out of a text table, one line at a time: the parser below every text recording.
//!
//! ```text
//! EMG_zyg,EMG_cor\n        header: accepted when no cell of line 1 is a number
//! -0.1455,-0.0970\n        one line a sample, one column a channel
//! └─ column 1 ─┘ └ newline: \n or \r\n; the last line may have none
//! ```
//!
//! The separator (tab, `;`, `,` or blanks, in this order of preference) and the number of columns come from
//! line 1; every later line must match. Only chosen columns are parsed; the others are just counted.
//!
//! Most recordings hold converter counts and nothing else, `-27,58,70`: such lines go through `counts`, which is
//! much faster and gives up on whatever is not so plain. All others, and all errors, go the general way.
//!
//! A [`Table`] is only a place in a text: the text itself is handed to each call, so that a memory map, a
//! slice in a test and a fuzzer's bytes are read by the same code.

mod counts;

use std::fmt;

use serde::{Deserialize, Serialize};

/// A channel the caller chooses: by column, counted from 0, or by the name a header line gives it.
///
/// In a configuration file: `channels = [0, 3, 5, 8]` or `channels = ["EMG_zyg", "EMG_cor"]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Channel {
    /// Column number, counted from 0.
    Index(usize),
    /// Name in the header line.
    Name(String),
}

impl From<usize> for Channel {
    fn from(index: usize) -> Channel {
        Channel::Index(index)
    }
}

impl From<&str> for Channel {
    fn from(name: &str) -> Channel {
        Channel::Name(name.to_owned())
    }
}

impl fmt::Display for Channel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Channel::Index(index) => write!(formatter, "{index}"),
            Channel::Name(name) => write!(formatter, "`{name}`"),
        }
    }
}

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
    /// Nothing between two separators.
    #[error("empty cell: fill in the sample or cut the recording here")]
    EmptyCell,
    /// A word that stands for a missing sample, such as `NULL`.
    #[error("missing sample `{0}`: cut the recording here, or fill the gap before replaying it")]
    MissingSample(String),
    /// NaN, infinity, or a number too large for 32-bit floating point.
    #[error("`{0}` is not a finite sample: cut the recording here or choose other channels")]
    NotFinite(String),
    /// Text where a number belongs.
    #[error(
        "`{0}` is not a number: samples are written like -12 or 0.5e-3, with a point as decimal sign; \
         choose other channels if this column holds no samples"
    )]
    NotANumber(String),
    /// Bytes that are not UTF-8 text, or control characters.
    #[error("binary or non-UTF-8 bytes: save the recording as UTF-8 text, one line a sample")]
    NotText,
    /// No channel was chosen.
    #[error("no channel is chosen: choose at least one of the {columns} (channels 0 to {last})", last = .columns - 1)]
    NoChannels {
        /// Columns of the file.
        columns: usize,
    },
    /// A chosen column number beyond the last column.
    #[error("there is no channel {channel}: the file has {columns} (channels 0 to {last})", last = .columns - 1)]
    MissingChannel {
        /// The channel asked for.
        channel: usize,
        /// Columns of the file.
        columns: usize,
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

fn available(names: &[String]) -> String {
    if names.is_empty() {
        "the file has no header line; choose by column number, counted from 0".to_owned()
    } else {
        format!("choose among {}", names.join(", "))
    }
}

/// What ends a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Separator {
    Byte(u8),
    Blanks,
}

impl Separator {
    fn of_line(line: &[u8]) -> Separator {
        [b'\t', b';', b',']
            .into_iter()
            .find(|byte| line.contains(byte))
            .map_or(Separator::Blanks, Separator::Byte)
    }
}

/// The cells of one line, without the blanks around them.
struct Cells<'line> {
    rest: Option<&'line [u8]>,
    separator: Separator,
}

impl<'line> Cells<'line> {
    fn of(line: &'line [u8], separator: Separator) -> Cells<'line> {
        let line = match separator {
            Separator::Byte(_) => line,
            Separator::Blanks => line.trim_ascii(),
        };
        Cells { rest: Some(line), separator }
    }
}

impl<'line> Iterator for Cells<'line> {
    type Item = &'line [u8];

    #[inline]
    fn next(&mut self) -> Option<&'line [u8]> {
        let rest = self.rest?;
        let end = match self.separator {
            Separator::Byte(separator) => rest.iter().position(|&byte| byte == separator),
            Separator::Blanks => rest.iter().position(u8::is_ascii_whitespace),
        };
        let Some(end) = end else {
            self.rest = None;
            return Some(rest.trim_ascii());
        };
        let after = &rest[end + 1..];
        self.rest = Some(match self.separator {
            Separator::Byte(_) => after,
            Separator::Blanks => after.trim_ascii_start(),
        });
        Some(rest[..end].trim_ascii())
    }
}

/// The sample in a cell, `None` where there is no finite number.
#[inline]
fn sample(cell: &[u8]) -> Option<f32> {
    // Counts need no general parser here either: up to seven digits are exact in an f32 (below 2^24).
    let (negative, digits) = match cell {
        [b'-', digits @ ..] => (true, digits),
        digits => (false, digits),
    };
    if (1..=7).contains(&digits.len()) && digits.iter().all(u8::is_ascii_digit) {
        let magnitude = digits.iter().fold(0_u32, |sum, digit| sum * 10 + u32::from(digit - b'0')) as f32;
        return Some(if negative { -magnitude } else { magnitude });
    }
    fast_float2::parse::<f32, _>(cell).ok().filter(|value| value.is_finite())
}

/// Whether a cell is a word by which tools write a missing sample.
fn is_missing_sample(cell: &[u8]) -> bool {
    ["null", "na", "n/a", "none", "-"].iter().any(|word| cell.eq_ignore_ascii_case(word.as_bytes()))
}

/// Whether bytes are UTF-8 without control characters.
fn is_text(line: &[u8]) -> bool {
    std::str::from_utf8(line)
        .is_ok_and(|text| !text.chars().any(|character| character.is_control() && character != '\t'))
}

/// A cell as an error message shows it: the first 24 characters.
fn excerpt(cell: &[u8]) -> String {
    String::from_utf8_lossy(cell).chars().take(24).collect()
}

/// One line of a text, without its newline.
struct Line<'text> {
    content: &'text [u8],
    /// Where the next line starts.
    next: usize,
    /// Whether a newline ends it.
    terminated: bool,
}

/// The line starting at `start`, `None` at the end of the text.
#[inline]
fn line_at(text: &[u8], start: usize) -> Option<Line<'_>> {
    let rest = text.get(start..).filter(|rest| !rest.is_empty())?;
    let (content, next, terminated) = match rest.iter().position(|&byte| byte == b'\n') {
        Some(end) => (&rest[..end], start + end + 1, true),
        None => (rest, text.len(), false),
    };
    Some(Line { content: content.strip_suffix(b"\r").unwrap_or(content), next, terminated })
}

/// Spreadsheet programs write this mark before UTF-8 text.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

fn text_start(text: &[u8]) -> usize {
    if text.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 }
}

/// How a text table is laid out, which of its columns are wanted, and how far it has been read.
#[derive(Clone, Debug)]
pub struct Table {
    separator: Separator,
    names: Vec<String>,
    /// For each column its place in a frame, if chosen.
    places: Vec<Option<usize>>,
    chosen: usize,
    /// Where the next line starts, in bytes.
    position: usize,
    /// Lines read so far.
    line: u64,
}

impl Table {
    /// Finds out the layout from the first line of `text` and chooses `channels`, in the order a frame shall
    /// have.
    ///
    /// # Errors
    /// When there is no first line of numbers or names, or a chosen channel is not there, each with its place.
    pub fn open(text: &[u8], channels: &[Channel]) -> Result<Table, TableError> {
        let start = first_line_start(text)?;
        let Some(first) = line_at(text, start) else { return Err(error_at(1, 1, TableProblem::Empty)) };
        if !is_text(first.content) {
            return Err(error_at(1, 1, TableProblem::NotText));
        }
        let separator = Separator::of_line(first.content);
        let columns = Cells::of(first.content, separator).count();
        let mut names = Vec::new();
        let (mut position, mut line) = (start, 0);
        let is_header = Cells::of(first.content, separator).all(|cell| {
            !cell.is_empty() && fast_float2::parse::<f32, _>(cell).is_err() && !is_missing_sample(cell)
        });
        if is_header {
            names.extend(Cells::of(first.content, separator).map(|cell| {
                let name = cell.strip_prefix(b"\"").and_then(|name| name.strip_suffix(b"\"")).unwrap_or(cell);
                String::from_utf8_lossy(name).into_owned()
            }));
            (position, line) = (first.next, 1);
            if text[position..].trim_ascii().is_empty() {
                return Err(error_at(2, 1, TableProblem::Empty));
            }
        }
        let places = places(channels, columns, &names)?;
        Ok(Table { separator, names, places, chosen: channels.len(), position, line })
    }

    /// Goes to the start of another text, which must have the same layout but no header line: the next file
    /// of a recording made of several.
    ///
    /// # Errors
    /// When the text has no line.
    pub fn continue_with(&mut self, text: &[u8]) -> Result<(), TableError> {
        self.position = first_line_start(text)?;
        self.line = 0;
        Ok(())
    }

    /// Columns of the file, chosen or not.
    pub fn columns(&self) -> usize {
        self.places.len()
    }

    /// The names in the header line; empty when there is none.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Bytes of the text that have been read.
    pub fn position(&self) -> usize {
        self.position
    }

    /// Reads the next line of `text` into `frame`, one value for each chosen channel; `false` at the end,
    /// where blank lines may stand. `text` is the one last given to [`open`](Table::open) or
    /// [`continue_with`](Table::continue_with). Nothing is allocated but for an error.
    ///
    /// # Errors
    /// When the line is not what the first line promised, with its place. Reading on after an error gives
    /// the same error again.
    ///
    /// # Panics
    /// When `frame` is not one value for each chosen channel.
    #[inline]
    pub fn next_row(&mut self, text: &[u8], frame: &mut [f32]) -> Result<bool, TableError> {
        assert_eq!(frame.len(), self.chosen, "a frame holds one value for each chosen channel");
        if let Separator::Byte(separator) = self.separator
            && let Some(next) = counts::read_line(text, self.position, separator, &self.places, frame)
        {
            self.position = next;
            self.line += 1;
            return Ok(true);
        }
        let Some(line) = line_at(text, self.position) else { return Ok(false) };
        if let Err(column) = self.parse(line.content, frame) {
            if line.content.trim_ascii().is_empty() && text[line.next..].trim_ascii().is_empty() {
                self.position = text.len();
                return Ok(false);
            }
            return Err(self.explain(&line, column));
        }
        self.position = line.next;
        self.line += 1;
        Ok(true)
    }

    /// Parses one line; where that fails, the column (from 0) it fails at.
    #[inline]
    fn parse(&self, line: &[u8], frame: &mut [f32]) -> Result<(), usize> {
        let mut columns = 0;
        for cell in Cells::of(line, self.separator) {
            match self.places.get(columns) {
                Some(None) => {}
                Some(&Some(place)) => frame[place] = sample(cell).ok_or(columns)?,
                None => return Err(columns),
            }
            columns += 1;
        }
        if columns == self.places.len() { Ok(()) } else { Err(columns) }
    }

    /// Why a line could not be parsed beyond `column` (from 0).
    #[cold]
    fn explain(&self, line: &Line<'_>, column: usize) -> TableError {
        let number = self.line + 1;
        let expected = self.places.len();
        let found = Cells::of(line.content, self.separator).count();
        if line.content.trim_ascii().is_empty() {
            return error_at(number, 1, TableProblem::BlankLine);
        }
        if !is_text(line.content) {
            return error_at(number, column + 1, TableProblem::NotText);
        }
        // A file cut off inside a line ends too early, or with the head of a number such as `-` or `1e`.
        let last_cell = Cells::of(line.content, self.separator).last().unwrap_or_default();
        let is_head_of_number =
            matches!(last_cell, [] | [b'-' | b'+' | b'.'] | [.., b'e' | b'E' | b'-' | b'+']);
        if !line.terminated && (found < expected || (column + 1 == expected && is_head_of_number)) {
            let found = found - usize::from(is_head_of_number);
            return error_at(number, found + 1, TableProblem::Truncated { expected, found });
        }
        if found != expected {
            let first_wrong = found.min(expected) + 1;
            return error_at(number, first_wrong, TableProblem::Ragged { expected, found });
        }
        let cell = Cells::of(line.content, self.separator).nth(column).unwrap_or_default();
        let problem = if cell.is_empty() {
            TableProblem::EmptyCell
        } else if is_missing_sample(cell) {
            TableProblem::MissingSample(excerpt(cell))
        } else if fast_float2::parse::<f32, _>(cell).is_ok() {
            TableProblem::NotFinite(excerpt(cell))
        } else {
            TableProblem::NotANumber(excerpt(cell))
        };
        error_at(number, column + 1, problem)
    }
}

fn error_at(line: u64, column: usize, problem: TableProblem) -> TableError {
    TableError { line, column, problem }
}

/// Where the first line starts, if there is anything to read.
fn first_line_start(text: &[u8]) -> Result<usize, TableError> {
    let start = text_start(text);
    if text[start..].trim_ascii().is_empty() {
        return Err(error_at(1, 1, TableProblem::Empty));
    }
    match line_at(text, start) {
        Some(line) if line.content.trim_ascii().is_empty() => Err(error_at(1, 1, TableProblem::BlankLine)),
        _ => Ok(start),
    }
}

/// For each column its place in a frame of `channels`, if chosen.
fn places(channels: &[Channel], columns: usize, names: &[String]) -> Result<Vec<Option<usize>>, TableError> {
    if channels.is_empty() {
        return Err(error_at(1, 1, TableProblem::NoChannels { columns }));
    }
    let mut places = vec![None; columns];
    for (place, channel) in channels.iter().enumerate() {
        let column = match channel {
            Channel::Index(index) => *index,
            Channel::Name(name) => {
                let mut found = names.iter().enumerate().filter(|(_, candidate)| *candidate == name);
                let Some((column, _)) = found.next() else {
                    let problem = TableProblem::MissingName { name: name.clone(), names: names.to_vec() };
                    return Err(error_at(1, 1, problem));
                };
                if let Some((second, _)) = found.next() {
                    return Err(error_at(1, second + 1, TableProblem::AmbiguousName(name.clone())));
                }
                column
            }
        };
        match places.get_mut(column) {
            None => {
                let problem = TableProblem::MissingChannel { channel: column, columns };
                return Err(error_at(1, column.saturating_add(1), problem));
            }
            Some(Some(_)) => return Err(error_at(1, column + 1, TableProblem::ChosenTwice(column))),
            Some(free) => *free = Some(place),
        }
    }
    Ok(places)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// All rows of chosen channels.
    fn read(text: impl AsRef<[u8]>, channels: &[Channel]) -> Result<Vec<Vec<f32>>, TableError> {
        let text = text.as_ref();
        let mut table = Table::open(text, channels)?;
        let mut frame = vec![0.0; channels.len()];
        let mut rows = Vec::new();
        while table.next_row(text, &mut frame)? {
            rows.push(frame.clone());
        }
        Ok(rows)
    }

    fn columns(indices: &[usize]) -> Vec<Channel> {
        indices.iter().copied().map(Channel::Index).collect()
    }

    /// Reading columns 0 and 1 fails at this place for this reason.
    fn assert_fails(text: impl AsRef<[u8]>, line: u64, column: usize, problem: TableProblem) {
        assert_eq!(read(text, &columns(&[0, 1])), Err(TableError { line, column, problem }));
    }

    #[test]
    fn every_separator_is_found_out() {
        for text in
            ["1,2,3\n-4,5e0,.6\n", "1;2;3\n-4; 5.0;0.6", "1\t2\t3\n-4\t5\t0.6\n", " 1 2   3\n-4 5 \t6e-1 \n"]
        {
            assert_eq!(
                read(text, &columns(&[0, 1, 2])).unwrap(),
                [[1.0, 2.0, 3.0], [-4.0, 5.0, 0.6]],
                "{text:?}"
            );
        }
    }

    #[test]
    fn windows_newlines_blank_lines_at_the_end_and_a_byte_order_mark_are_accepted() {
        for text in
            ["1,2\r\n3,4\r\n", "1,2\r\n3,4\r\n\r\n", "1,2\n3,4\n\n \n", "\u{feff}1,2\n3,4", "1,2\n3,4\n"]
        {
            assert_eq!(read(text, &columns(&[0, 1])).unwrap(), [[1.0, 2.0], [3.0, 4.0]], "{text:?}");
        }
    }

    #[test]
    fn channels_come_in_the_order_chosen_by_number_or_by_name() {
        let text = "\u{feff}Time,\"EMG_zyg\",EMG_cor\n0.5,1,2\n1.0,3,4\n";
        assert_eq!(read(text, &columns(&[2, 0])).unwrap(), [[2.0, 0.5], [4.0, 1.0]]);
        assert_eq!(read(text, &["EMG_cor".into(), "EMG_zyg".into()]).unwrap(), [[2.0, 1.0], [4.0, 3.0]]);
    }

    #[test]
    fn columns_that_are_not_chosen_may_hold_anything() {
        assert_eq!(read("12:00,1\nNULL,2\n,3\n", &columns(&[1])).unwrap(), [[1.0], [2.0], [3.0]]);
    }

    #[test]
    fn a_channel_that_is_not_there_is_named() {
        let failure = |text: &str, channel: Channel| read(text, &[channel]).unwrap_err().problem;
        assert_eq!(failure("1,2\n", 2.into()), TableProblem::MissingChannel { channel: 2, columns: 2 });
        let names = vec!["a".to_owned(), "b".to_owned()];
        assert_eq!(failure("a,b\n1,2\n", "c".into()), TableProblem::MissingName { name: "c".into(), names });
        let no_names = TableProblem::MissingName { name: "c".into(), names: Vec::new() };
        assert_eq!(failure("1,2\n", "c".into()), no_names);
        assert_eq!(failure("a,a\n1,2\n", "a".into()), TableProblem::AmbiguousName("a".into()));
        assert_eq!(read("1,2\n", &columns(&[1, 1])).unwrap_err().problem, TableProblem::ChosenTwice(1));
        assert_eq!(read("1,2\n", &[]).unwrap_err().problem, TableProblem::NoChannels { columns: 2 });
    }

    #[test]
    fn ragged_lines_are_refused() {
        assert_fails("1,2\n3\n5,6\n", 2, 2, TableProblem::Ragged { expected: 2, found: 1 });
        assert_fails("1,2\n3,4\n5,6,7\n", 3, 3, TableProblem::Ragged { expected: 2, found: 3 });
        assert_fails("a,b\n1,2\n5,6,7", 3, 3, TableProblem::Ragged { expected: 2, found: 3 });
    }

    #[test]
    fn cells_without_a_finite_number_are_refused() {
        assert_fails("1,2\n3,four\n", 2, 2, TableProblem::NotANumber("four".into()));
        assert_fails("1;2\n3,5;4\n", 2, 1, TableProblem::NotANumber("3,5".into()));
        assert_fails("1,2\nNULL,4\n", 2, 1, TableProblem::MissingSample("NULL".into()));
        assert_fails("NULL,NULL\n1,2\n", 1, 1, TableProblem::MissingSample("NULL".into()));
        assert_fails("1,2\n3, \n", 2, 2, TableProblem::EmptyCell);
        assert_fails("1,2\n3,NaN\n", 2, 2, TableProblem::NotFinite("NaN".into()));
        assert_fails("nan,2\n3,4\n", 1, 1, TableProblem::NotFinite("nan".into()));
        assert_fails("1,2\n-inf,4\n", 2, 1, TableProblem::NotFinite("-inf".into()));
        assert_fails("1,2\n1e39,4\n", 2, 1, TableProblem::NotFinite("1e39".into()));
    }

    #[test]
    fn a_file_without_samples_is_refused() {
        for text in ["", "\n", "\u{feff}", " \r\n\n"] {
            assert_fails(text, 1, 1, TableProblem::Empty);
        }
        assert_fails("a,b\n", 2, 1, TableProblem::Empty);
    }

    #[test]
    fn a_blank_line_between_samples_is_refused() {
        assert_fails("1,2\n\n3,4\n", 2, 1, TableProblem::BlankLine);
        assert_fails("\n1,2\n", 1, 1, TableProblem::BlankLine);
    }

    #[test]
    fn a_file_cut_off_inside_its_last_line_is_called_truncated() {
        for text in ["1,2\n3", "1,2\n3,", "1,2\n3,-", "1,2\n3,1e"] {
            assert_fails(text, 2, 2, TableProblem::Truncated { expected: 2, found: 1 });
        }
        assert_fails("1,2\n-", 2, 1, TableProblem::Truncated { expected: 2, found: 0 });
    }

    #[test]
    fn binary_is_refused() {
        assert_fails(b"\x00\x01\x02\xff\xfe", 1, 1, TableProblem::NotText);
        assert_fails(b"\xff\xfe1\x00,\x002\x00\n\x00", 1, 1, TableProblem::NotText);
        assert_fails(b"1,2\n3,\xe9\n", 2, 2, TableProblem::NotText);
        assert_fails(b"1,2\n\x00\x00\x00\x00", 2, 1, TableProblem::NotText);
    }

    #[test]
    fn reading_on_after_an_error_gives_it_again() {
        let text = b"1,2\n3\n4,5\n";
        let mut table = Table::open(text, &columns(&[0, 1])).unwrap();
        let mut frame = [0.0; 2];
        assert_eq!(table.next_row(text, &mut frame), Ok(true));
        let error = table.next_row(text, &mut frame).unwrap_err();
        assert_eq!(table.next_row(text, &mut frame), Err(error));
    }

    #[test]
    fn the_message_names_place_and_remedy() {
        let error = read("1,2\n3\n", &columns(&[0, 1])).unwrap_err();
        assert_eq!(
            error.to_string(),
            "line 2, column 2: expected 2 values as in line 1, found 1: complete or delete this line (deleting \
             shortens the recording by one sample)"
        );
    }

    #[test]
    fn the_short_way_for_counts_gives_what_the_general_parser_gives() {
        for text in ["0", "-0", "7", "-9999999", "0012", "99999999", "16777217", "+3", "-", "", "--1", "1-"] {
            let general = text.parse::<f32>().ok();
            assert_eq!(sample(text.as_bytes()).map(f32::to_bits), general.map(f32::to_bits), "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_frames_written_as_a_table_read_back(
            (columns_of_file, cells) in (1_usize..12).prop_flat_map(|columns| {
                let value = prop_oneof![
                    (-8_388_608_i32..8_388_607).prop_map(|count| count as f32),
                    any::<f32>().prop_filter("finite", |value| value.is_finite()),
                ];
                (Just(columns), prop::collection::vec(prop::collection::vec(value, columns), 1..40))
            }),
            separator in prop::sample::select(vec![",", ";", "\t", " ", ", "]),
            newline in prop::sample::select(vec!["\n", "\r\n"]),
            has_header: bool,
            ends_with_newline: bool,
        ) {
            let header = (0..columns_of_file).map(|column| format!("EMG{column}")).collect::<Vec<_>>();
            let mut lines: Vec<String> = if has_header { vec![header.join(separator)] } else { Vec::new() };
            lines.extend(cells.iter().map(|row| {
                row.iter().map(|value| value.to_string()).collect::<Vec<_>>().join(separator)
            }));
            let mut text = lines.join(newline);
            if ends_with_newline {
                text += newline;
            }
            let all: Vec<usize> = (0..columns_of_file).collect();
            prop_assert_eq!(&read(&text, &columns(&all)).unwrap(), &cells);
            if has_header {
                let last: Vec<Vec<f32>> = cells.iter().map(|row| vec![row[columns_of_file - 1]]).collect();
                prop_assert_eq!(read(&text, &[header[columns_of_file - 1].as_str().into()]).unwrap(), last);
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic_and_what_is_read_is_finite(
            bytes in prop::collection::vec(any::<u8>(), 0..200),
            channel in 0_usize..4,
        ) {
            if let Ok(rows) = read(&bytes, &columns(&[channel])) {
                prop_assert!(rows.iter().flatten().all(|value| value.is_finite()));
            }
        }

        #[test]
        fn text_that_is_nearly_a_table_never_panics_and_every_error_is_in_the_text(
            text in "[-+0-9eE.,;\t \r\nNULnaif\u{feff}\0é]{0,80}",
        ) {
            match read(&text, &columns(&[0])) {
                Ok(rows) => prop_assert!(rows.iter().flatten().all(|value| value.is_finite())),
                Err(error) => prop_assert!(error.line as usize <= text.split('\n').count() + 1 && error.column > 0),
            }
        }
    }
}
