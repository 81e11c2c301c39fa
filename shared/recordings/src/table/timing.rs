//! The rate of a table, and the column by which its missing samples are seen.

use std::collections::VecDeque;
use std::fmt;

use super::Table;
use super::clock::{Clock, ROWS_OF_A_CHECK, gaps_of_counter};
use super::column::{Column, ColumnKind};
use super::problem::{Rate, TableError, TableProblem, error_at};

/// Share by which two rates of the same samples may differ.
pub(super) const SAME_RATE: f64 = 0.01;

/// What a table says about its time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timing {
    /// Its sampling rate in Hz, if it tells.
    pub rate_hz: Option<f64>,
    /// Share by which the stamps leave that open.
    pub uncertainty: f64,
    /// Rates that its first lines state, and none can be taken: no EMG has them, or they differ.
    pub unclear_hz: Vec<Rate>,
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

impl Timing {
    /// Whether the samples may have been taken at this rate, by what the table says.
    pub fn allows(&self, given_hz: f64) -> bool {
        self.rate_hz.is_none_or(|own_hz| {
            is_same_rate(given_hz, own_hz) || (given_hz - own_hz).abs() <= self.uncertainty * own_hz
        })
    }
}

impl Table {
    /// Finds the sampling rate in what the head states and in the column of time, and the missing samples
    /// in that column or in a counter. `columns` are what `choice::columns` gives for `text`, of which nothing has been read.
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
        let measure = |column, most_rows| {
            let (separator, has_comma) = (self.separator, self.has_comma);
            Clock::of_time(text, self.position, separator, column, has_comma, most_rows)
        };
        // Each channel may have a column of time of its own, left of it.
        let times_of = |column: usize| {
            let is_time = |index: &usize| columns[*index].kind == ColumnKind::Time;
            (0..column).rev().chain(column..columns.len()).filter(is_time)
        };
        let unclear_hz = self.unclear_rates_hz.iter().copied().map(Rate).collect();
        let mut timing = Timing { rate_hz: stated_hz, unclear_hz, ..Timing::default() };
        let first = chosen.first().copied().unwrap_or_default();
        let measured = times_of(first).find_map(|time| Some((time, measure(time, usize::MAX)?)));
        let Some((time, clock)) = measured else {
            let counter = (0..columns.len()).find(|index| columns[*index].kind == ColumnKind::Counter);
            self.gaps = counter.map_or_else(VecDeque::new, |counter| {
                gaps_of_counter(text, self.position, self.separator, counter, self.has_comma).into()
            });
            timing.remark =
                times_of(first).next().map(|time| TimingRemark::Bursts { column: self.name(time) });
            return Ok(timing);
        };
        let unit = &columns[time].unit;
        let rate_hz = clock.rate_hz(unit);
        let rate_of = |column| {
            times_of(column).find_map(|own| match own == time {
                true => Some(rate_hz),
                false => Some(measure(own, ROWS_OF_A_CHECK)?.rate_hz(&columns[own].unit)),
            })?
        };
        self.common_rate(&chosen, rate_of)?;
        let name = || self.name(time);
        let measured = Timing { rate_hz, uncertainty: clock.uncertainty, ..timing };
        let (rate_hz, remark) = match (rate_hz, stated_hz) {
            // Both know: the stated one is exact.
            (Some(_), Some(stated_hz)) if measured.allows(stated_hz) => (Some(stated_hz), None),
            (Some(_), Some(stated_hz)) if clock.may_count_rows(unit) => (Some(stated_hz), None),
            (Some(rate_hz), Some(stated_hz)) => {
                let (rate, stated_hz) = (Rate(rate_hz), Rate(stated_hz));
                let remark = TimingRemark::StatedOtherwise { column: name(), rate_hz: rate, stated_hz };
                (Some(rate_hz), Some(remark))
            }
            (Some(rate_hz), None) => {
                let is_unsure = clock.may_count_rows(unit);
                let remark = is_unsure.then(|| TimingRemark::TakenAsMilliseconds { column: name() });
                (Some(rate_hz), remark)
            }
            (None, _) => (stated_hz, None),
        };
        let timing = Timing { rate_hz, remark, ..measured };
        self.gaps = clock.gaps.into();
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
