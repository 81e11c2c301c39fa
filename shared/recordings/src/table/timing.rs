//! The rate of a table, and the column by which its missing samples are seen.

use std::fmt;

use super::Table;
use super::clock::Measured;
use super::column::{Column, ColumnKind};
use super::problem::{Rate, TableError, TableProblem, error_at};

/// Share by which two rates of the same samples may differ.
pub(super) const SAME_RATE: f64 = 0.01;

/// What a table says about its time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timing {
    /// Its sampling rate in Hz, if it tells.
    pub rate_hz: Option<f64>,
    /// What its user should know.
    pub remark: Option<TimingRemark>,
}

/// What is odd about the time of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TimingRemark {
    /// The column of time does not rise from sample to sample: gaps are not seen in it.
    Bursts {
        /// The column.
        column: String,
    },
    /// No unit says what the column counts.
    TakenAsMilliseconds {
        /// The column.
        column: String,
    },
    /// The lines before the table state another rate than the column of time has, which holds.
    StatedOtherwise {
        /// The column.
        column: String,
        /// Its rate.
        rate_hz: Rate,
        /// The stated one.
        stated_hz: Rate,
    },
}

impl fmt::Display for TimingRemark {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            TimingRemark::Bursts { column } => write!(
                out,
                "its samples come in bursts by column `{column}`, which is not used for the rate or to find missing samples"
            ),
            TimingRemark::TakenAsMilliseconds { column } => write!(
                out,
                "column `{column}` rises by 1 and states no unit: it is taken as ms, so 1000 Hz; give the rate if it is another"
            ),
            TimingRemark::StatedOtherwise { column, rate_hz, stated_hz } => write!(
                out,
                "its first lines state {stated_hz} Hz, but column `{column}` rises with {rate_hz} Hz, which is taken"
            ),
        }
    }
}

impl Table {
    /// Finds the sampling rate in what the head states and in the column of time, and watches that column, or a counter,
    /// for missing samples from now on. `columns` are what [`columns`] gives for `text`, of which nothing has been read.
    ///
    /// # Errors
    /// When the chosen columns have different rates.
    pub fn watch_time(&mut self, text: &[u8], columns: &[Column]) -> Result<Timing, TableError> {
        let chosen = self.chosen_columns();
        let stated = |column: usize| {
            let before = column.checked_sub(1).filter(|before| columns[*before].kind == ColumnKind::Time);
            columns[column].rate_hz.or_else(|| columns[before?].rate_hz)
        };
        let stated_hz = self.common_rate(&chosen, stated)?;
        let measure = |column| Measured::of_time(text, self.position, self.separator, column, self.has_comma);
        // Each channel may have a column of time of its own, left of it.
        let time_of = |column: usize| {
            let is_time = |index: &usize| columns[*index].kind == ColumnKind::Time;
            (0..column).rev().find(is_time).or_else(|| (0..columns.len()).find(is_time))
        };
        let mut timing = Timing { rate_hz: stated_hz, remark: None };
        let time = chosen.first().and_then(|first| time_of(*first));
        let measured = time.and_then(|time| Some((time, measure(time)?)));
        if let Some((time, measured)) = measured {
            let rate_of = |column| measure(time_of(column)?)?.rate_hz(&columns[time_of(column)?].unit);
            self.common_rate(&chosen, rate_of)?;
            let unit = &columns[time].unit;
            let name = || self.name(time);
            let rate_hz = measured.rate_hz(unit);
            timing = match (rate_hz, stated_hz) {
                // Both know: the stated one is exact.
                (Some(rate_hz), Some(stated_hz)) if is_same_rate(rate_hz, stated_hz) => timing,
                (Some(_), Some(_)) if measured.may_count_rows(unit) => timing,
                (Some(rate_hz), Some(stated_hz)) => {
                    let (rate, stated_hz) = (Rate(rate_hz), Rate(stated_hz));
                    let remark = TimingRemark::StatedOtherwise { column: name(), rate_hz: rate, stated_hz };
                    Timing { rate_hz: Some(rate_hz), remark: Some(remark) }
                }
                (Some(rate_hz), None) => {
                    let is_unsure = measured.may_count_rows(unit);
                    let remark = is_unsure.then(|| TimingRemark::TakenAsMilliseconds { column: name() });
                    Timing { rate_hz: Some(rate_hz), remark }
                }
                (None, _) => timing,
            };
            self.clock = Some(measured.clock);
        } else {
            let counter = (0..columns.len()).find(|index| columns[*index].kind == ColumnKind::Counter);
            self.clock = counter.and_then(|counter| {
                Measured::of_counter(text, self.position, self.separator, counter, self.has_comma)
            });
            timing.remark = time.map(|time| TimingRemark::Bursts { column: self.name(time) });
        }
        Ok(timing)
    }

    /// The rate that the chosen columns have in common, by `rate_of`; `None` if it knows of none.
    fn common_rate(
        &self,
        chosen: &[usize],
        rate_of: impl Fn(usize) -> Option<f64>,
    ) -> Result<Option<f64>, TableError> {
        let mut known = chosen.iter().filter_map(|column| Some((*column, rate_of(*column)?)));
        let Some((first, first_hz)) = known.next() else { return Ok(None) };
        match known.find(|(_, rate_hz)| !is_same_rate(*rate_hz, first_hz)) {
            Some((second, second_hz)) => {
                let (first, second_name) = (self.name(first), self.name(second));
                let (first_hz, second_hz) = (Rate(first_hz), Rate(second_hz));
                let columns =
                    format!("column `{first}` has {first_hz} Hz and column `{second_name}` {second_hz} Hz");
                let problem = TableProblem::RatesDiffer { columns };
                Err(error_at(1, second + 1, problem))
            }
            None => Ok(Some(first_hz)),
        }
    }
}

/// Whether two rates are those of the same samples.
pub(crate) fn is_same_rate(first_hz: f64, second_hz: f64) -> bool {
    (first_hz - second_hz).abs() <= SAME_RATE * first_hz.max(second_hz)
}
