//! A line of the labels.

use std::collections::BTreeMap;

use super::clock::Place;
use super::{COLUMNS, LabelsProblem};

/// Columns that may stand in place of `start_sample` and `end_sample`.
const SECONDS: [&str; 2] = ["start_s", "end_s"];

/// Of these, those that must be there.
const REQUIRED: [&str; 4] = ["file", "person", "repetition", "gesture"];

/// The session where none is given.
const ONLY_SESSION: &str = "1";

/// A line's cells.
pub(super) struct Row {
    pub(super) file: String,
    /// As it stands there.
    pub(super) person: String,
    pub(super) session: String,
    pub(super) repetition: u32,
    pub(super) gesture: String,
    pub(super) start: Place,
    pub(super) end: Option<Place>,
}

impl Row {
    pub(super) fn read(
        columns: &BTreeMap<&str, usize>,
        record: &csv::StringRecord,
    ) -> Result<Row, LabelsProblem> {
        let cell = |column: &str| columns.get(column).and_then(|&index| record.get(index)).unwrap_or("");
        let number = |column: &'static str, largest: u64| {
            let text = cell(column);
            text.parse()
                .ok()
                .filter(|&number: &u64| number <= largest)
                .ok_or_else(|| LabelsProblem::NotANumber { column, text: text.to_owned(), largest })
        };
        let place = |sample: &'static str, seconds: &'static str| match (cell(sample), cell(seconds)) {
            ("", "") => Ok(None),
            ("", text) => {
                let value = text
                    .replace(',', ".")
                    .parse()
                    .ok()
                    .filter(|value: &f64| value.is_finite() && *value >= 0.0);
                let problem = || LabelsProblem::NoSeconds { column: seconds, text: text.to_owned() };
                value.map(|value| Some(Place::Seconds(value))).ok_or_else(problem)
            }
            (_, "") => Ok(Some(Place::Sample(number(sample, u64::MAX)?))),
            _ => Err(LabelsProblem::TwoPlaces { sample, seconds }),
        };
        if cell("file").is_empty() {
            return Err(LabelsProblem::NoFile);
        }
        let repetition = number("repetition", u8::MAX.into())? as u32;
        let start = place("start_sample", "start_s")?.unwrap_or(Place::Sample(0));
        let end = place("end_sample", "end_s")?;
        let is_reversed = match (start, end) {
            (Place::Sample(start), Some(Place::Sample(end))) => end <= start,
            (Place::Seconds(start), Some(Place::Seconds(end))) => end <= start,
            _ => false,
        };
        if is_reversed {
            let start = ["start_sample", "start_s"].map(cell).concat();
            return Err(LabelsProblem::EndsBeforeStart { start });
        }
        let session = if cell("session").is_empty() { ONLY_SESSION } else { cell("session") };
        Ok(Row {
            file: cell("file").to_owned(),
            person: cell("person").to_owned(),
            session: session.to_owned(),
            repetition,
            gesture: cell("gesture").to_owned(),
            start,
            end,
        })
    }
}

/// Where each known column stands.
pub(super) fn columns_of(header: &csv::StringRecord) -> Result<BTreeMap<&'static str, usize>, LabelsProblem> {
    let mut columns = BTreeMap::new();
    for (index, name) in header.iter().enumerate() {
        let mut known = COLUMNS.into_iter().chain(SECONDS);
        let Some(known) = known.find(|known| name.eq_ignore_ascii_case(known)) else {
            return Err(LabelsProblem::UnknownColumn { name: name.to_owned() });
        };
        if columns.insert(known, index).is_some() {
            return Err(LabelsProblem::ColumnTwice(known));
        }
    }
    match REQUIRED.into_iter().find(|required| !columns.contains_key(required)) {
        Some(name) => Err(LabelsProblem::MissingColumn { name }),
        None => Ok(columns),
    }
}
