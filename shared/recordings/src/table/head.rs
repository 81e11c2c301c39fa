//! What stands before the samples of a table: where they begin, and what the lines before them say.
//!
//! ```text
//! %Sample Rate = 250 Hz            lines before the table: of any form, a sampling rate in them counts
//! Time, EMG 1, EMG 2               the names: the last line of words with a cell for each column …
//! s, mV, mV                        … but for units and rates, which may stand below them
//! 0.000, -0.012, 0.044             the first line of numbers, and more like it
//! ```
//! A line belongs to the table if it has a number, and the line after it has as many cells, with numbers and words in the
//! same places. A missing sample fits anywhere.

use std::collections::HashMap;

use tendon_signal::without_unit;

use super::cells::{
    Cells, Line, Separator, excerpt, is_missing_sample, line_at, number, text_of, text_start, without_quotes,
};
use super::problem::{TableError, TableProblem, error_at};
use super::quantity::{
    RATES_OF_EMG_HZ, in_brackets, is_unit, is_unit_or_rate, rate_of_cell, stated_rate, stated_unit,
    unbracketed, unit_of_quantity,
};

/// Longest beginning in which the first line of samples has to end, in bytes. What has no newline for so long is no table,
/// and a file may be very large.
pub(super) const LONGEST_HEAD: usize = 1 << 20;

/// Most lines before the table.
const MOST_LINES: usize = 1000;

/// Lines of one form that make a table where words are as many as numbers.
const RUN: usize = 3;

/// The beginning of a table.
#[derive(Clone, Debug)]
pub(super) struct Head {
    pub(super) separator: Separator,
    pub(super) columns: usize,
    /// The name of each column; empty where there is none. No names at all if no line has them.
    pub(super) names: Vec<String>,
    /// The unit of each column, as it stands there; empty where none is stated.
    pub(super) units: Vec<String>,
    /// Sampling rate of each column in Hz, where one is stated.
    pub(super) rates_hz: Vec<Option<f64>>,
    /// Rates for all columns that cannot be taken: no EMG has them, or there are several.
    pub(super) unclear_rates_hz: Vec<f64>,
    /// Where the first line of samples begins, in bytes.
    pub(super) position: usize,
    /// Lines before it.
    pub(super) lines: u64,
}

/// What a cell holds, as far as the form of a line goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Number,
    Word,
    /// Nothing, or a word for a missing sample.
    Missing,
}

/// A line of the beginning that is not blank.
struct HeadLine<'text> {
    content: &'text [u8],
    /// Where it begins, in bytes.
    start: usize,
    /// Lines before it.
    lines: u64,
    separator: Separator,
    forms: Vec<Form>,
}

impl HeadLine<'_> {
    fn numbers(&self) -> usize {
        self.count(Form::Number)
    }

    fn words(&self) -> usize {
        self.count(Form::Word)
    }

    fn count(&self, form: Form) -> usize {
        self.forms.iter().filter(|own| **own == form).count()
    }

    /// Whether the cells of both lines, as many here as there, hold the same kinds of things, numbers among them.
    fn is_like(&self, other: &HeadLine<'_>) -> bool {
        let both = self.forms.iter().zip(&other.forms);
        self.has_as_many_cells(other)
            && both.clone().any(|forms| forms == (&Form::Number, &Form::Number))
            && self
                .forms
                .iter()
                .zip(&other.forms)
                .all(|(own, other)| own == other || *own == Form::Missing || *other == Form::Missing)
    }

    /// Whether its numbers are none of samples: they number the columns, as pandas writes where these have no names, or say
    /// for each how many samples there are, as Biopac does. `next` is the line below.
    fn counts_columns(&self, next: &HeadLine<'_>) -> bool {
        let numbers: Vec<f64> =
            Cells::of(self.content, self.separator).filter_map(|cell| number(cell, false)).collect();
        let is_unlike_time = self.forms[0] == Form::Missing && next.forms[0] == Form::Number;
        let is_whole = numbers.iter().all(|number| number.fract() == 0.0);
        let is_numbered = numbers.iter().enumerate().all(|(index, number)| *number == index as f64);
        let has_samples_below = next.content.iter().filter(|byte| **byte == b'.').count() > 1;
        let is_equal = numbers.windows(2).all(|pair| pair[0] == pair[1]);
        let is_numbered = is_numbered && numbers.len() >= 2 && has_samples_below;
        self.words() == 0 && is_whole && (is_numbered || (is_equal && is_unlike_time && numbers.len() >= 2))
    }

    fn has_as_many_cells(&self, other: &HeadLine<'_>) -> bool {
        self.separator == other.separator && self.forms.len() == other.forms.len()
    }
}

impl Head {
    /// Reads the beginning of `text`.
    ///
    /// # Errors
    /// When there is no line of numbers, with the place where one should be.
    pub(super) fn find(text: &[u8]) -> Result<Head, TableError> {
        let lines = head_lines(text)?;
        let Some(first) = first_of_table(&lines) else {
            return Err(match &lines[..] {
                // Names, and perhaps units.
                [] | [_] | [_, _] => {
                    error_at(lines.last().map_or(1, |last| last.lines + 2), 1, TableProblem::Empty)
                }
                [.., last] => error_at(last.lines + 1, 1, TableProblem::NoNumbers(excerpt(last.content))),
            });
        };
        let begins_with_counts = lines.get(first + 1).is_some_and(|next| lines[first].counts_columns(next));
        let (mut before, mut table) = lines.split_at(first);
        if begins_with_counts {
            table = &table[1..];
        }
        let first = &table[0];
        if let Some((_, others)) = before.split_last().filter(|(last, _)| last.counts_columns(first)) {
            before = others;
        }
        let columns = first.forms.len();
        let mut head = Head {
            separator: first.separator,
            columns,
            names: Vec::new(),
            units: vec![String::new(); columns],
            rates_hz: vec![None; columns],
            unclear_rates_hz: Vec::new(),
            position: first.start,
            lines: first.lines,
        };
        let listed = before.iter().find_map(|line| listed_columns(&text_of(line.content), columns));
        let before = match listed {
            Some(names) => {
                head.names = names;
                before
            }
            None => head.read_names(before, table),
        };
        if let Some(last) = before.last().filter(|_| head.names.is_empty())
            && let Some(names) = head.too_few_names(last, table)
        {
            let problem = TableProblem::FewerNames { names, values: columns };
            return Err(error_at(first.lines + 1, names + 1, problem));
        }
        head.read_preamble(before);
        Ok(head)
    }

    /// Takes names, units and rates from the lines right before the table; gives the lines before these.
    fn read_names<'lines, 'text>(
        &mut self,
        before: &'lines [HeadLine<'text>],
        table: &[HeadLine<'text>],
    ) -> &'lines [HeadLine<'text>] {
        let mut left = before;
        while let Some((line, others)) = left.split_last() {
            let Some(mut cells) = self.cells_of_columns(line, table) else { return left };
            left = others;
            // LabChart begins a line with what it says: `ChannelTitle=`, `Range=`.
            if cells[0].ends_with('=') {
                cells[0].clear();
            }
            if !cells.iter().all(|cell| cell.is_empty() || is_unit_or_rate(cell)) {
                for (column, name) in cells.iter().enumerate() {
                    // Noraxon writes `"LT BICEPS,uV"`.
                    let behind_comma =
                        name.rsplit_once(',').map(|(_, unit)| unit).filter(|unit| is_unit(unit));
                    if let Some(unit) = in_brackets(name).or(behind_comma) {
                        self.note(column, unit);
                    }
                }
                self.names = without_units(cells);
                return left;
            }
            for (column, cell) in cells.iter().enumerate() {
                self.note(column, cell);
            }
        }
        left
    }

    /// The cells of a line before the table, one for each column; `None` if it has more or fewer, or no word.
    fn cells_of_columns(&self, line: &HeadLine<'_>, table: &[HeadLine<'_>]) -> Option<Vec<String>> {
        let text = text_of(line.content);
        let text = text.trim_matches(' ');
        let unmarked = text.trim_start_matches(['#', '%']);
        let has_word = |cells: &Vec<String>| {
            cells.iter().any(|cell| {
                !cell.is_empty()
                    && number(cell.as_bytes(), true).is_none()
                    && !is_missing_sample(cell.as_bytes())
            })
        };
        let others = [b',', b'\t', b';'].map(Separator::Byte);
        // Blanks within the names of `EMG 1,EMG 2` divide nothing.
        let blanks = Some(Separator::Blanks).filter(|_| line.separator != self.separator);
        let separators = std::iter::once(self.separator).chain(others).chain(blanks);
        // A line that is quoted as a whole is split within the quotes.
        let inner = unmarked.strip_prefix('"').and_then(|inner| inner.strip_suffix('"'));
        let texts = inner.filter(|inner| !inner.contains('"')).into_iter().chain([unmarked, text]);
        for (text, separator) in
            texts.flat_map(|text| separators.clone().map(move |separator| (text, separator)))
        {
            let mut cells = quoted_cells(text, separator);
            while cells.len() > self.columns && cells.last().is_some_and(String::is_empty) {
                cells.pop();
            }
            // Rows that end with a separator have an empty column more.
            let ends_empty = table.iter().all(|line| line.forms.last() == Some(&Form::Missing));
            if cells.len() + 1 == self.columns && ends_empty {
                cells.push(String::new());
            }
            // The column of the rows' numbers often has no name.
            if cells.len() + 1 == self.columns && self.columns > 2 && counts_rows(table) {
                cells.insert(0, String::new());
            }
            if cells.len() == self.columns && has_word(&cells) {
                return Some(cells);
            }
        }
        None
    }

    /// How many names stand in `line`, the last one before a table without names, if it was to name the columns and names too few:
    /// then, decimal commas divide the values. Comments and settings (`Subject:, Anna`) are no names.
    fn too_few_names(&self, line: &HeadLine<'_>, table: &[HeadLine<'_>]) -> Option<usize> {
        let text = text_of(line.content);
        let mut cells = quoted_cells(&text, line.separator);
        while cells.last().is_some_and(String::is_empty) {
            cells.pop();
        }
        let is_comment = text.trim_start().starts_with(['#', '%']);
        let is_setting = cells.iter().any(|cell| cell.contains([':', '=']));
        let is_filled =
            |column: &usize| table.iter().any(|line| line.forms.get(*column) != Some(&Form::Missing));
        let values = (0..self.columns).rfind(is_filled).map_or(0, |last| last + 1);
        let is_too_few = (2..values).contains(&cells.len());
        let is_of_names = self.separator == line.separator && line.separator != Separator::Blanks;
        (is_of_names && is_too_few && line.numbers() == 0 && !is_comment && !is_setting)
            .then_some(cells.len())
    }

    /// Takes a unit or a rate of a column from a cell.
    fn note(&mut self, column: usize, cell: &str) {
        if let Some(rate_hz) = rate_of_cell(cell) {
            self.rates_hz[column].get_or_insert(rate_hz);
        } else if self.units[column].is_empty()
            && let Some(unit) = unit_of_quantity(cell).or_else(|| is_unit(cell).then(|| unbracketed(cell)))
        {
            unit.clone_into(&mut self.units[column]);
        }
    }

    /// Takes the sampling rate and the unit from the lines before the names: for all columns, or, if such a line names a
    /// column, for that one.
    fn read_preamble(&mut self, before: &[HeadLine<'_>]) {
        let has_comma = self.separator != Separator::Byte(b',');
        let mut of_all: (Vec<f64>, Vec<String>) = (Vec::new(), Vec::new());
        for line in before {
            let text = text_of(line.content);
            let (rate_hz, unit) = (stated_rate(&text, has_comma), stated_unit(&text));
            let label = labelled(&text);
            match label.and_then(|label| self.names.iter().position(|name| name.eq_ignore_ascii_case(label)))
            {
                Some(column) => {
                    self.rates_hz[column] = self.rates_hz[column].or(rate_hz);
                    if let Some(unit) = unit.filter(|_| self.units[column].is_empty()) {
                        self.units[column] = unit;
                    }
                }
                None => {
                    of_all.0.extend(rate_hz);
                    of_all.1.extend(unit);
                }
            }
        }
        // Several that differ say nothing about any one column.
        let (of_emg, unlikely): (Vec<f64>, Vec<f64>) =
            of_all.0.iter().partition(|rate_hz| RATES_OF_EMG_HZ.contains(rate_hz));
        match &of_emg[..] {
            [rate_hz, others @ ..] if others.iter().all(|other| other == rate_hz) => {
                self.rates_hz.iter_mut().for_each(|own| *own = own.or(Some(*rate_hz)));
            }
            _ => self.unclear_rates_hz = [of_emg, unlikely].concat(),
        }
        if let [unit, others @ ..] = &of_all.1[..]
            && others.iter().all(|other| other == unit)
        {
            self.units.iter_mut().filter(|own| own.is_empty()).for_each(|own| own.clone_from(unit));
        }
    }
}

/// The lines of the beginning that are not blank, up to the first ones that are surely of the table.
fn head_lines(text: &[u8]) -> Result<Vec<HeadLine<'_>>, TableError> {
    let head = &text[..text.len().min(LONGEST_HEAD)];
    let mut start = text_start(text);
    if text[start..].trim_ascii().is_empty() {
        return Err(error_at(1, 1, TableProblem::Empty));
    }
    let mut found: Vec<HeadLine<'_>> = Vec::new();
    let mut lines = 0;
    let mut alike = 0;
    while let Some(Line { content, next, terminated }) = line_at(head, start) {
        let is_cut_off = !terminated && text.len() > LONGEST_HEAD;
        if is_cut_off || !is_printable(content) {
            // What is wrong within the table shows when it is read.
            if found.iter().any(|line| line.numbers() > 0) {
                break;
            }
            return Err(error_at(lines + 1, 1, unreadable(content)));
        }
        if !content.trim_ascii().is_empty() {
            let separator = Separator::of_line(content);
            let forms = Cells::of(content, separator).map(|cell| form(cell, separator)).collect();
            let line = HeadLine { content, start, lines, separator, forms };
            let is_like_last = found.last().is_some_and(|last| line.is_like(last));
            alike = if is_like_last && line.words() <= line.numbers() { alike + 1 } else { 0 };
            found.push(line);
        }
        (start, lines) = (next, lines + 1);
        if alike >= RUN || found.len() > MOST_LINES {
            break;
        }
    }
    Ok(found)
}

/// Whether a line is text in any encoding that has ASCII: units in a head are often not in UTF-8.
fn is_printable(line: &[u8]) -> bool {
    !line.iter().any(|byte| byte.is_ascii_control() && *byte != b'\t')
}

/// Why a line cannot be read as text.
fn unreadable(line: &[u8]) -> TableProblem {
    let has_other = line.iter().any(|byte| byte.is_ascii_control() && !matches!(byte, b'\t' | b'\r'));
    if line.contains(&b'\r') && !has_other { TableProblem::LineEnds } else { TableProblem::NotText }
}

fn form(cell: &[u8], separator: Separator) -> Form {
    match number(cell, separator != Separator::Byte(b',')) {
        Some(value) if value.is_nan() => Form::Missing,
        Some(_) => Form::Number,
        None if cell.is_empty() || is_missing_sample(cell) => Form::Missing,
        None => Form::Word,
    }
}

/// The line with which the table begins.
fn first_of_table(lines: &[HeadLine<'_>]) -> Option<usize> {
    // How many lines from here on look alike, this one among them.
    let run =
        |index: usize| 1 + lines[index..].windows(2).take_while(|pair| pair[0].is_like(&pair[1])).count();
    let reaches_end = |index: usize| index + run(index) == lines.len();
    // Names, and numbers below them.
    let is_headed = |index: usize| {
        let is_below_names = index > 0 && lines[index - 1].numbers() == 0;
        is_below_names && lines[index].numbers() > 0 && (run(index) >= 2 || reaches_end(index))
    };
    let begins = |index: usize| {
        let (line, next) = (&lines[index], lines.get(index + 1));
        match (line.numbers(), line.words()) {
            (0, _) => false,
            // What is wrong in the next line shows when it is read, unless there is a table further on.
            (_, 0) => {
                next.is_none_or(|next| line.has_as_many_cells(next) && next.numbers() > 0)
                    || !(index + 1..lines.len()).any(is_headed)
            }
            (numbers, words) if numbers > words => next.is_some_and(|next| line.is_like(next)),
            (numbers, words) => numbers == words && (run(index) >= RUN || reaches_end(index)),
        }
    };
    let has_number = |index: &usize| lines[*index].numbers() > 0;
    let mut with_number = (0..lines.len()).filter(has_number);
    (0..lines.len())
        .find(|index| begins(*index))
        .or_else(|| with_number.clone().find(|index| reaches_end(*index)))
        .or_else(|| with_number.next())
}

/// The names that OpenSignals lists in a comment: `# {"…": {"column": ["nSeq", "I1", "A1"], …}}`. Its rows end with a tab.
fn listed_columns(line: &str, columns: usize) -> Option<Vec<String>> {
    let list = line.split_once("\"column\":")?.1.trim_start().strip_prefix('[')?.split_once(']')?.0;
    let mut names: Vec<String> =
        list.split(',').map(|name| name.trim().trim_matches('"').to_owned()).collect();
    if names.len() + 1 == columns {
        names.push(String::new());
    }
    (names.len() == columns).then_some(names)
}

/// Whether the first column of a table has the numbers of the rows.
fn counts_rows(table: &[HeadLine<'_>]) -> bool {
    let row = |line: &HeadLine<'_>| {
        let cell = Cells::of(line.content, line.separator).next()?;
        number(without_quotes(cell), false)
    };
    let rows: Vec<f64> = table.iter().map_while(row).collect();
    rows.len() >= 2 && rows.windows(2).all(|pair| pair[1] == pair[0] + 1.0)
}

/// Names without the units of samples in them, unless two columns would then have one name.
fn without_units(names: Vec<String>) -> Vec<String> {
    let mut times: HashMap<String, usize> = HashMap::new();
    names.iter().for_each(|name| *times.entry(without_unit(name).to_owned()).or_default() += 1);
    let is_unique = |name: &String| times[without_unit(name)] == 1;
    names
        .into_iter()
        .map(|name| if is_unique(&name) { without_unit(&name).to_owned() } else { name })
        .collect()
}

/// The cells of a line of words, in which separators may stand within quotes.
fn quoted_cells(line: &str, separator: Separator) -> Vec<String> {
    let ends = |character: char| match separator {
        Separator::Byte(byte) => character == char::from(byte),
        Separator::Blanks => character.is_ascii_whitespace(),
    };
    let mut cells = vec![String::new()];
    let mut is_quoted = false;
    for character in line.trim_matches(' ').chars() {
        match character {
            '"' => is_quoted = !is_quoted,
            _ if !is_quoted && ends(character) => {
                let is_between_blanks =
                    separator == Separator::Blanks && cells.last().is_some_and(String::is_empty);
                if !is_between_blanks {
                    cells.push(String::new());
                }
            }
            _ => cells.last_mut().expect("one cell at least").push(character),
        }
    }
    cells.iter().map(|cell| cell.trim().to_owned()).collect()
}

/// The column that a line before the table is about: `Label: EMG1  Sampling frequency: …`.
fn labelled(line: &str) -> Option<&str> {
    let label = line.strip_prefix("Label:")?.trim_start();
    let end = label.find("  ").or_else(|| label.find('\t')).or_else(|| label.find(" Sampling"));
    Some(label[..end.unwrap_or(label.len())].trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_that_no_emg_has_and_several_are_not_taken_but_named() {
        let head =
            |lines: &str| Head::find(format!("{lines}\na,b\n{}", "0.5,1.5\n".repeat(9)).as_bytes()).unwrap();
        for (lines, rate_hz, unclear_hz) in [
            ("Sampling rate: 2 Hz", None, vec![2.0]),
            ("Sampling rate: 1000 Hz\nSampling rate: 2000 Hz", None, vec![1000.0, 2000.0]),
            ("Sampling rate: 1000 Hz\nSampling rate: 2 Hz", Some(1000.0), vec![]),
        ] {
            let head = head(lines);
            assert_eq!((head.rates_hz[0], &head.unclear_rates_hz), (rate_hz, &unclear_hz), "{lines}");
        }
    }
}
