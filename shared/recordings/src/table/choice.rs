//! What the columns of a table are, and which of them are taken where nobody chooses.

use std::collections::HashMap;

use super::cells::{Cells, Separator, is_missing, line_at, without_quotes};
use super::channel::{Channel, places};
use super::column::{self, Column, ColumnKind, Shape, kind_of, truth_rank};
use super::head::Head;
use super::problem::{TableError, TableProblem, error_at};
use super::timing::SAME_RATE;

/// Rows at the beginning by which the kinds of columns are found out.
const ROWS_AT_START: usize = 2048;
/// Places further on, and rows at each.
const PLACES: usize = 8;
const ROWS_AT_PLACE: usize = 128;

/// What the columns of the table in `text` are, by its head and some of its rows.
///
/// # Errors
/// When there are no samples, with the place where they should be.
pub fn columns(text: &[u8]) -> Result<Vec<Column>, TableError> {
    let Head { separator, columns, names, units, rates_hz, position, .. } = Head::find(text)?;
    let has_comma = separator != Separator::Byte(b',');
    let mut shapes = vec![Shape::default(); columns];
    let mut read_rows = |mut position: usize, rows: usize| {
        for row in 0..rows {
            let Some(line) = line_at(text, position) else { break };
            position = line.next;
            if line.content.trim_ascii().is_empty() {
                continue;
            }
            for (shape, cell) in shapes.iter_mut().zip(Cells::of(line.content, separator)) {
                shape.push(cell, is_missing(cell), has_comma, row > 0);
            }
        }
        position
    };
    let mut next = read_rows(position, ROWS_AT_START);
    for place in 1..=PLACES {
        let wanted = position + (text.len() - position) / PLACES * place;
        // The last one ends with the text.
        let length = (next - position).min(text.len() - position) * ROWS_AT_PLACE / ROWS_AT_START;
        let wanted = wanted.saturating_sub(length.max(1)).max(next);
        let Some(line) = line_at(text, wanted) else { break };
        next = read_rows(line.next, ROWS_AT_PLACE);
    }
    let cell = |cells: &Vec<String>, column: usize| cells.get(column).cloned().unwrap_or_default();
    let column = |(column, shape): (usize, &Shape)| {
        let name = cell(&names, column);
        let mut unit = cell(&units, column);
        let kind = kind_of(&name, &unit, shape);
        if kind == ColumnKind::Time && unit.is_empty() {
            unit = column::unit_of_time(&name);
        }
        Column { name, unit, rate_hz: rates_hz[column], kind }
    };
    Ok(shapes.iter().enumerate().map(column).collect())
}

/// What channels are, of which only the names are known.
pub(crate) fn columns_by_name(names: &[String]) -> Vec<Column> {
    let column = |name: &String| {
        let kind = kind_of(name, "", &Shape::default());
        Column { name: name.clone(), unit: String::new(), rate_hz: None, kind }
    };
    names.iter().map(column).collect()
}

/// Where a column is.
pub(crate) fn find(columns: &[Column], column: &Channel) -> Result<usize, TableError> {
    let mut names: Vec<String> = columns.iter().map(|column| column.name.clone()).collect();
    // Of a table without a header.
    if names.iter().all(String::is_empty) {
        names.clear();
    }
    let places = places(std::slice::from_ref(column), columns.len(), &names)?;
    Ok(places.iter().position(Option::is_some).unwrap_or(0))
}

/// The column of labels that says what was done, by its name.
pub(crate) fn truth(columns: &[Column]) -> Option<usize> {
    let labels = columns.iter().enumerate().filter(|(_, column)| column.kind == ColumnKind::Label);
    let ranked = labels.filter_map(|(index, column)| Some((truth_rank(&column.name)?, index)));
    ranked.min().map(|(_, index)| index)
}

/// What stands in a column, sample by sample, without quotes.
pub(crate) fn cells_of_column(text: &[u8], column: usize) -> impl Iterator<Item = &[u8]> {
    let head = Head::find(text).ok();
    let mut position = head.as_ref().map_or(text.len(), |head| head.position);
    let separator = head.map_or(Separator::Blanks, |head| head.separator);
    std::iter::from_fn(move || {
        let line = line_at(text, position).filter(|line| !line.content.trim_ascii().is_empty())?;
        position = line.next;
        let cell = Cells::of(line.content, separator).nth(column).unwrap_or_default();
        Some(without_quotes(cell))
    })
}

/// The first `count` columns of a table that are muscles, of one rate, by name where that is unique, else by number.
///
/// # Errors
/// When there are too few, or a column with the name of a muscle rises as time does.
pub fn first_muscles(columns: &[Column], count: usize) -> Result<Vec<Channel>, TableError> {
    if columns.len() < count {
        let problem = TableProblem::MissingChannel { channel: columns.len(), columns: columns.len() };
        return Err(error_at(1, columns.len() + 1, problem));
    }
    let muscles = muscles(columns)?;
    if muscles.len() < count {
        let listed = columns.iter().enumerate().map(|(index, column)| match &column.name[..] {
            "" => format!("{index}: {}", column.kind),
            name => format!("{name}: {}", column.kind),
        });
        let columns = listed.collect::<Vec<_>>().join(", ");
        let problem = TableProblem::TooFewMuscles { wanted: count, found: muscles.len(), columns };
        return Err(error_at(1, 1, problem));
    }
    Ok(muscles.into_iter().take(count).collect())
}

/// All columns of a table that are muscles, as [`first_muscles`] gives them. Where their rates are stated and differ, the
/// slower ones are left out.
///
/// # Errors
/// When a column with the name of a muscle rises as time does.
pub fn muscles(columns: &[Column]) -> Result<Vec<Channel>, TableError> {
    if let Some(index) = columns.iter().position(|column| column.kind == ColumnKind::RisingMuscle) {
        return Err(error_at(1, index + 1, TableProblem::RisingMuscle(columns[index].name.clone())));
    }
    let is_muscle = |column: &&Column| column.kind == ColumnKind::Muscle;
    let fastest_hz = columns.iter().filter(is_muscle).filter_map(|column| column.rate_hz).fold(0.0, f64::max);
    let is_fast = |column: &Column| column.rate_hz.is_none_or(|hz| hz >= fastest_hz * (1.0 - SAME_RATE));
    let mut times: HashMap<&str, usize> = HashMap::new();
    columns.iter().for_each(|column| *times.entry(&column.name).or_default() += 1);
    let channel = |(index, column): (usize, &Column)| {
        let is_unique = times[column.name.as_str()] == 1;
        match &column.name[..] {
            name if is_unique && !name.is_empty() && name.parse::<usize>().is_err() => Channel::from(name),
            _ => Channel::Index(index),
        }
    };
    let muscles = columns.iter().enumerate().filter(|(_, column)| is_muscle(column) && is_fast(column));
    Ok(muscles.map(channel).collect())
}
