//! Numbers out of a text table, one line at a time: the parser below every text recording.
//!
//! ```text
//! EMG_zyg,EMG_cor\n        the head: names, units, other lines before the samples (see `head`)
//! -0.1455,-0.0970\n        one line a sample, one column a channel
//! └─ column 1 ─┘ └ newline: \n or \r\n; the last line may have none
//! ```
//!
//! The separator (tab, `;`, `,` or blanks, in this order of preference) and the number of columns come from
//! the first line of samples; every later line must match. Only chosen columns are parsed; the others are just counted.
//! What the columns are is a question for [`columns`].
//!
//! Most recordings hold converter counts and nothing else, `-27,58,70`: such lines go through `counts`, which is
//! much faster and gives up on anything else. All other lines, and all errors, take the general path.
//!
//! A [`Table`] is only a place in a text: the text itself is handed to each call, so that a memory map, a
//! slice in a test and a fuzzer's bytes are read by the same code.

use std::collections::VecDeque;

mod cells;
mod channel;
mod choice;
mod clock;
mod column;
mod counts;
mod head;
mod problem;
mod quantity;
mod timing;

pub(crate) use cells::text_of;
pub use channel::Channel;
pub(crate) use channel::places;
pub(crate) use choice::{cells_of_column, columns_by_name, find, truth};
pub use choice::{columns, first_muscles, muscles};
pub use column::{Column, ColumnKind};
pub use problem::{Rate, TableError, TableProblem};
pub use timing::{Timing, TimingRemark};

use cells::{
    Cells, Line, Separator, excerpt, is_missing, is_text, line_at, sample, text_start, unusual_sample,
};
use clock::Gap;
use head::Head;
use problem::error_at;

/// What [`Table::next_row`] found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// A line of samples.
    Samples,
    /// A line in which a chosen cell is empty or says that its sample is missing.
    Missing,
    /// So many samples that are missing before the next line, by the column of time or a counter.
    Gap(u64),
    /// The end.
    End,
}

/// How a text table is laid out, which of its columns are wanted, and how far it has been read.
#[derive(Clone, Debug)]
pub struct Table {
    separator: Separator,
    /// Whether a comma can be a decimal sign.
    has_comma: bool,
    names: Vec<String>,
    /// For each column its place in a frame, if chosen.
    places: Vec<Option<usize>>,
    chosen: usize,
    /// Where samples are missing, by the column of time or a counter, as far as it was not told.
    gaps: VecDeque<Gap>,
    /// Where the next line starts, in bytes.
    position: usize,
    /// Lines read so far.
    line: u64,
    /// Those of them before the first line of samples.
    lines_of_head: u64,
    /// Rates in the head that are none of EMG, or of which there are several.
    unclear_rates_hz: Vec<f64>,
}

impl Table {
    /// Finds out the layout from the beginning of `text` and chooses `channels`, in the order a frame shall
    /// have.
    ///
    /// # Errors
    /// When there is no line of numbers, or a chosen channel is not there, each with its place.
    pub fn open(text: &[u8], channels: &[Channel]) -> Result<Table, TableError> {
        let Head { separator, columns, names, position, lines, unclear_rates_hz, .. } = Head::find(text)?;
        let places = places(channels, columns, &names)?;
        let has_comma = separator != Separator::Byte(b',') && !has_decimal_point(text, position);
        Ok(Table {
            separator,
            has_comma,
            names,
            places,
            chosen: channels.len(),
            gaps: VecDeque::new(),
            position,
            line: lines,
            lines_of_head: lines,
            unclear_rates_hz,
        })
    }

    /// Goes to the start of another text, which must have the same layout but no head: the next file
    /// of a recording made of several.
    ///
    /// # Errors
    /// When the text has no line.
    pub fn continue_with(&mut self, text: &[u8]) -> Result<(), TableError> {
        self.position = text_start(text);
        if text[self.position..].trim_ascii().is_empty() {
            return Err(error_at(1, 1, TableProblem::Empty));
        }
        self.line = 0;
        self.gaps.clear();
        self.lines_of_head = 0;
        Ok(())
    }

    /// Columns of the file, chosen or not.
    pub fn columns(&self) -> usize {
        self.places.len()
    }

    /// The names in the head; empty when there are none.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The chosen columns in the order of a frame: by name where they have one, else by number from 0.
    pub fn chosen(&self) -> Vec<String> {
        self.chosen_columns().into_iter().map(|column| self.name(column)).collect()
    }

    /// The numbers of the chosen columns, in the order of a frame.
    pub fn chosen_columns(&self) -> Vec<usize> {
        let mut columns: Vec<usize> =
            (0..self.places.len()).filter(|column| self.places[*column].is_some()).collect();
        columns.sort_by_key(|column| self.places[*column]);
        columns
    }

    /// A column's name, or its number where it has none.
    pub fn name(&self, column: usize) -> String {
        let name = self.names.get(column).filter(|name| !name.is_empty());
        name.cloned().unwrap_or_else(|| column.to_string())
    }

    /// Bytes of the text that have been read.
    pub fn position(&self) -> usize {
        self.position
    }

    /// Lines of the text that have been read, those of the head included.
    pub fn lines(&self) -> u64 {
        self.line
    }

    /// Reads the next line of `text` into `frame`, one value for each chosen channel. At the end, blank lines may stand.
    /// A gap is told before the line that follows it is read. `text` is the one last given to [`open`](Table::open) or
    /// [`continue_with`](Table::continue_with). Nothing is allocated but for an error. Only of [`Row::Samples`], `frame`
    /// holds them.
    ///
    /// # Errors
    /// When the line is not what the first line promised, with its place. Reading on after an error gives
    /// the same error again.
    ///
    /// # Panics
    /// When `frame` is not one value for each chosen channel.
    #[inline]
    pub fn next_row(&mut self, text: &[u8], frame: &mut [f32]) -> Result<Row, TableError> {
        assert_eq!(frame.len(), self.chosen, "a frame holds one value for each chosen channel");
        let rows = self.line - self.lines_of_head;
        if let Some(gap) = self.gaps.pop_front_if(|gap| gap.rows_before == rows) {
            return Ok(Row::Gap(gap.samples));
        }
        if let Separator::Byte(separator) = self.separator
            && let Some(next) = counts::read_line(text, self.position, separator, &self.places, frame)
        {
            self.position = next;
            self.line += 1;
            return Ok(Row::Samples);
        }
        let Some(line) = line_at(text, self.position) else { return Ok(Row::End) };
        let lacks_sample = match self.parse(line.content, frame) {
            Ok(lacks_sample) => lacks_sample,
            Err(_) if line.content.trim_ascii().is_empty() && text[line.next..].trim_ascii().is_empty() => {
                self.position = text.len();
                return Ok(Row::End);
            }
            Err(column) => return Err(self.explain(&line, column)),
        };
        if lacks_sample {
            if line.content.trim_ascii().is_empty() && text[line.next..].trim_ascii().is_empty() {
                self.position = text.len();
                return Ok(Row::End);
            }
            let last_cell = Cells::of(line.content, self.separator).last().unwrap_or_default();
            let last_place = self.places.last().copied().flatten();
            if !line.terminated && last_place.is_some() && matches!(last_cell, [] | [b'-']) {
                return Err(self.explain(&line, self.places.len() - 1));
            }
        }
        self.position = line.next;
        self.line += 1;
        Ok(if lacks_sample { Row::Missing } else { Row::Samples })
    }

    /// Parses one line: whether a chosen cell has no sample; where that fails, the column (from 0) it fails at.
    #[inline]
    fn parse(&self, line: &[u8], frame: &mut [f32]) -> Result<bool, usize> {
        let mut columns = 0;
        let mut lacks_sample = false;
        for cell in Cells::of(line, self.separator) {
            match self.places.get(columns) {
                Some(None) => {}
                Some(&Some(place)) => match sample(cell) {
                    Some(sample) => frame[place] = sample,
                    None if is_missing(cell) => lacks_sample = true,
                    None => frame[place] = unusual_sample(cell, self.has_comma).ok_or(columns)?,
                },
                None => return Err(columns),
            }
            columns += 1;
        }
        if columns == self.places.len() { Ok(lacks_sample) } else { Err(columns) }
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
        let problem = if fast_float2::parse::<f32, _>(cell).is_ok() {
            TableProblem::NotFinite(excerpt(cell))
        } else {
            TableProblem::NotANumber(excerpt(cell))
        };
        error_at(number, column + 1, problem)
    }
}

/// Whether one of the first rows has a number with a decimal point: then a comma is no decimal sign.
fn has_decimal_point(text: &[u8], position: usize) -> bool {
    let rows = &text[position..text.len().min(position + (1 << 12))];
    let is_point =
        |window: &[u8]| window[0].is_ascii_digit() && window[1] == b'.' && window[2].is_ascii_digit();
    rows.windows(3).any(is_point)
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
        loop {
            match table.next_row(text, &mut frame)? {
                Row::Samples => rows.push(frame.clone()),
                Row::Missing => rows.push(vec![f32::NAN; channels.len()]),
                Row::Gap(_) => {}
                Row::End => return Ok(rows),
            }
        }
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
    fn a_large_file_without_lines_is_no_table() {
        let zeros = vec![0; head::LONGEST_HEAD + 1];
        assert_fails(&zeros, 1, 1, TableProblem::NotText);
        assert_fails(vec![b'1'; head::LONGEST_HEAD + 1], 1, 1, TableProblem::NotText);
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
        assert_fails("1.5;2\n3,5;4\n", 2, 1, TableProblem::NotANumber("3,5".into()));
        assert_fails("1,2\n-inf,4\n", 2, 1, TableProblem::NotFinite("-inf".into()));
        assert_fails("1,2\n1e39,4\n", 2, 1, TableProblem::NotFinite("1e39".into()));
    }

    #[test]
    fn a_line_without_a_sample_is_missing_wherever_it_is_chosen() {
        for cell in ["NULL", "", " ", "NaN", "n/a", "-", "\"\""] {
            let text = format!("1,2,3\n4,{cell},6\n7,8,9\n");
            let rows = read(&text, &columns(&[0, 1])).unwrap();
            assert!(rows[1].iter().all(|value| value.is_nan()), "{text:?}");
            assert_eq!([&rows[0], &rows[2]], [&[1.0, 2.0], &[7.0, 8.0]], "{text:?}");
            assert_eq!(read(&text, &columns(&[2])).unwrap(), [[3.0], [6.0], [9.0]], "{text:?}");
        }
        assert_eq!(read("NULL,NULL\n1,2\n", &columns(&[0, 1])).unwrap(), [[1.0, 2.0]]);
    }

    #[test]
    fn a_comma_is_a_decimal_sign_where_it_separates_nothing() {
        let text = "X[s];EMG 1 [mV]\n0;-1,5\n0,001;2\n0,002;2,25e-1\n";
        assert_eq!(read(text, &columns(&[0, 1])).unwrap(), [[0.0, -1.5], [0.001, 2.0], [0.002, 0.225]]);
        assert_eq!(read("1\t-0,5\n2\t7\n", &columns(&[1])).unwrap(), [[-0.5], [7.0]]);
        assert_eq!(read("1,5\n2,7\n", &columns(&[1])).unwrap(), [[5.0], [7.0]]);
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
        assert_eq!(table.next_row(text, &mut frame), Ok(Row::Samples));
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
                prop_assert!(rows.iter().flatten().all(|value| !value.is_infinite()));
            }
        }

        #[test]
        fn text_that_is_nearly_a_table_never_panics_and_every_error_is_in_the_text(
            text in "[-+0-9eE.,;\t \r\nNULnaif\u{feff}\0é]{0,80}",
        ) {
            match read(&text, &columns(&[0])) {
                Ok(rows) => prop_assert!(rows.iter().flatten().all(|value| !value.is_infinite())),
                Err(error) => prop_assert!(error.line as usize <= text.split('\n').count() + 1 && error.column > 0),
            }
        }
    }
}
