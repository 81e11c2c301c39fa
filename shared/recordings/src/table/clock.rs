//! What a column of time or a counter says: the sampling rate, and where samples are missing.
//!
//! ```text
//! time     0.000 0.001 0.002 0.502 0.503      steps of 0.001: 1000 Hz; 499 samples are missing before the fourth row
//! counter    254   255     0     3     4      2 samples are missing before the fourth row
//! ```
//! Clocks that are read out coarsely (0 0 1 1 2 ms) step by more than a period now and then. A step is a gap only if it is
//! longer than one and a half periods by more than the steps differ among themselves.

use super::cells::{Cells, Separator, line_at, number};

/// Rows from which a clock says something.
const FEWEST_ROWS: usize = 16;
/// Rows that are looked at.
const MOST_ROWS: usize = 16_384;
/// Rates of EMG, Hz: what decides about the unit of a clock that does not state it. Each unit is 1000 times the next, so
/// only one fits.
const PLAUSIBLE_HZ: std::ops::Range<f64> = 50.0..25_000.0;
/// A rate that is so close to a whole number is that number.
const WHOLE: f64 = 2e-4;
/// Samples of a gap are counted up to here: what is longer is another recording.
const LONGEST_GAP: f64 = 1e12;

/// A column by which missing samples are noticed.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    pub(super) column: usize,
    /// From row to row, in the unit of the column.
    step: f64,
    /// A longer step is a gap.
    longest_step: f64,
    /// A counter begins anew after so many numbers.
    wraps_after: Option<f64>,
    /// What the column said last.
    last: f64,
}

impl Clock {
    /// Samples missing between the last row and one with this value; 0 where there is no number.
    pub(super) fn lost_before(&self, value: f64) -> u64 {
        let mut step = value - self.last;
        if let Some(wraps_after) = self.wraps_after.filter(|_| step < 0.0) {
            step += wraps_after;
        }
        if step > self.longest_step {
            ((step / self.step).round() - 1.0).min(LONGEST_GAP) as u64
        } else if step < -self.longest_step {
            // It goes back: what is missing is not known, but what follows does not follow on.
            1
        } else {
            0
        }
    }

    /// Goes on to a row with this value.
    pub(super) fn advance(&mut self, value: f64) {
        self.last = if value.is_finite() { value } else { self.last + self.step };
    }

    /// Forgets the last row.
    pub(super) fn restart(&mut self) {
        self.last = f64::NAN;
    }
}

/// What the first rows of a column say about its clock.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    pub(super) clock: Clock,
    /// From row to row on average, gaps left out, in the unit of the column.
    period: f64,
    is_whole: bool,
}

/// The values of a column, from `position` on.
fn values<'text>(
    text: &'text [u8],
    position: usize,
    separator: Separator,
    column: usize,
    has_comma: bool,
) -> impl Iterator<Item = f64> + 'text {
    let mut position = position;
    std::iter::from_fn(move || {
        let line = line_at(text, position)?;
        position = line.next;
        let cell = Cells::of(line.content, separator).nth(column);
        Some(cell.and_then(|cell| number(cell, has_comma)).unwrap_or(f64::NAN))
    })
    .take(MOST_ROWS)
    .filter(|value| value.is_finite())
}

impl Measured {
    /// Measures the clock in `column`; `None` if it does not rise from row to row, as where samples come in bursts.
    pub(super) fn of_time(
        text: &[u8],
        position: usize,
        separator: Separator,
        column: usize,
        has_comma: bool,
    ) -> Option<Measured> {
        let values: Vec<f64> = values(text, position, separator, column, has_comma).collect();
        if values.len() < FEWEST_ROWS {
            return None;
        }
        let steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        let (low, high) = (at(0.05), at(0.95));
        // Gaps are few: they are not among these.
        let usual: Vec<f64> = steps.iter().copied().filter(|step| (low..=high).contains(step)).collect();
        let rough = usual.iter().sum::<f64>() / usual.len() as f64;
        // Numbers as large as a date in µs are exact only to some digits.
        let rounding = values.last()?.abs() * 4.0 * f64::EPSILON;
        if !(rough > rounding && low >= 0.0) {
            return None;
        }
        let longest_step = 1.5 * rough + (high - low);
        let all: Vec<f64> = steps.into_iter().filter(|step| (0.0..=longest_step).contains(step)).collect();
        let period = all.iter().sum::<f64>() / all.len() as f64;
        // In bursts, one step is as long as many samples: it tells nothing of any one of them.
        if high - low > 8.0 * period {
            return None;
        }
        let clock = Clock { column, step: period, longest_step, wraps_after: None, last: f64::NAN };
        let is_whole = (period - 1.0).abs() < 1e-9;
        Some(Measured { clock, period, is_whole })
    }

    /// Measures the counter in `column`; `None` if it does not count evenly.
    pub(super) fn of_counter(
        text: &[u8],
        position: usize,
        separator: Separator,
        column: usize,
        has_comma: bool,
    ) -> Option<Clock> {
        let values: Vec<f64> = values(text, position, separator, column, has_comma).collect();
        let mut steps: Vec<f64> =
            values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
        if steps.len() < FEWEST_ROWS {
            return None;
        }
        steps.sort_by(f64::total_cmp);
        let step = steps[steps.len() / 2];
        let is_even = steps.iter().filter(|other| **other == step).count() * 10 >= steps.len() * 9;
        let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(*value));
        let falls = values.windows(2).any(|pair| pair[1] < pair[0]);
        let wraps_after = falls.then_some(largest + step);
        is_even.then_some(Clock { column, step, longest_step: 1.5 * step, wraps_after, last: f64::NAN })
    }

    /// The sampling rate in Hz, by the unit of the column or, if it has none, by what is plausible; `None` if nothing is.
    pub(super) fn rate_hz(&self, unit: &str) -> Option<f64> {
        let rate = |unit_s: f64| {
            let rate_hz = 1.0 / (self.period * unit_s);
            let whole = rate_hz.round();
            if (rate_hz - whole).abs() <= WHOLE * whole { whole } else { rate_hz }
        };
        match unit_s(unit) {
            Some(unit_s) => Some(rate(unit_s)).filter(|rate_hz| rate_hz.is_finite() && *rate_hz > 0.0),
            None => {
                [1.0, 1e-3, 1e-6, 1e-9].map(rate).into_iter().find(|rate_hz| PLAUSIBLE_HZ.contains(rate_hz))
            }
        }
    }

    /// Whether it may as well count rows: it rises by 1, and no unit says of what.
    pub(super) fn may_count_rows(&self, unit: &str) -> bool {
        self.is_whole && unit_s(unit).is_none()
    }
}

/// A unit of time in seconds: of a column's unit, or at the end of its name (`time_ms`).
fn unit_s(unit: &str) -> Option<f64> {
    Some(match unit.to_lowercase().as_str() {
        "s" | "sec" | "secs" | "seconds" => 1.0,
        "ms" | "msec" | "milliseconds" => 1e-3,
        "us" | "µs" | "μs" | "usec" | "microseconds" => 1e-6,
        "ns" | "nsec" | "nanoseconds" => 1e-9,
        _ => return None,
    })
}
