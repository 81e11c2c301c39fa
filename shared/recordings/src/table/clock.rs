//! What a column of time or a counter says: the sampling rate, and where samples are missing.
//!
//! ```text
//! time     0.000 0.001 0.002 0.502 0.503      steps of 0.001: 1000 Hz; 499 samples are missing before the fourth row
//! counter    254   255     0     3     4      2 samples are missing before the fourth row
//! ```
//! Single steps of time mislead: a clock that is read out in whole ms steps by 0 or 2 ms now and then, and stamps given on
//! arrival jitter. So the rate is the slope of a line through all stamps, and a long step is a gap only if the stamps stay
//! late after it:
//!
//! ```text
//! late ▲                              ▄▄▄▄▄▄▄▄▄▄▄▄       stamp - row × period
//!      │              ▖                                  a late stamp: those after it are as before
//!      │▄▄▄▄▄▄▄▄▄▄▄▄▄▄ ▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄                   a gap: they stay late
//!      └─────────────────────────────────────────► row
//! ```

use super::cells::{Cells, Separator, line_at, number, without_quotes};

/// Rows from which a clock says something.
const FEWEST_ROWS: usize = 16;
/// Rows by which one clock is compared with another.
pub(super) const ROWS_OF_A_CHECK: usize = 16_384;
/// Steps of the clock that are sorted.
const MOST_STEPS: usize = 16_384;
/// Rows before and after a long step by which it is judged.
const WINDOW_ROWS: usize = 64;
/// A stamp that may be off by more than this share of a period does not show the loss of a single sample: clocks in whole ms
/// skip one now and then.
const FINE: f64 = 1.0 / 3.0;
/// Rates of EMG, Hz: what decides about the unit of a clock that does not state it. Each unit is 1000 times the next, so
/// only one fits.
const PLAUSIBLE_HZ: std::ops::Range<f64> = 50.0..25_000.0;
/// A rate that is so close to a whole number is that number.
const WHOLE: f64 = 2e-4;
/// Samples of a gap are counted up to here: what is longer is another recording.
const LONGEST_GAP: f64 = 1e12;

/// Samples that are missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gap {
    /// Rows of the table before them.
    pub(super) rows_before: u64,
    /// How many; 1 where it is not known.
    pub(super) samples: u64,
}

/// What a column of time says.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    /// From row to row, gaps left out, in the unit of the column.
    period: f64,
    /// Share by which that may be wrong.
    pub(super) uncertainty: f64,
    /// In their order.
    pub(super) gaps: Vec<Gap>,
}

/// The numbers in a column, row by row; NaN where there is none.
#[derive(Debug)]
struct Stamps {
    /// From the first one on, so that large ones lose no digits.
    late: Vec<f64>,
    /// The largest, as it stands there.
    largest: f64,
    /// What they are written in multiples of; 0 if that is not known.
    resolution: f64,
}

impl Stamps {
    fn read(
        text: &[u8],
        mut position: usize,
        separator: Separator,
        column: usize,
        has_comma: bool,
        most_rows: usize,
    ) -> Stamps {
        let mut late = Vec::new();
        let mut largest = 0.0_f64;
        let mut digits = Digits::default();
        while let Some(line) = line_at(text, position).filter(|_| late.len() < most_rows) {
            position = line.next;
            let cell = Cells::of(line.content, separator).nth(column).unwrap_or_default();
            let stamp = number(cell, has_comma).or_else(|| seconds(cell)).filter(|stamp| stamp.is_finite());
            if let Some(stamp) = stamp {
                digits.see(cell);
                largest = largest.max(stamp.abs());
            }
            late.push(stamp.unwrap_or(f64::NAN));
        }
        let first = late.iter().copied().find(|stamp| !stamp.is_nan()).unwrap_or(0.0);
        late.iter_mut().for_each(|stamp| *stamp -= first);
        Stamps { late, largest, resolution: digits.resolution() }
    }

    /// Rows that have a stamp, each with the next such row.
    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        let mut last = None;
        let stamped = (0..self.late.len()).filter(|row| !self.late[*row].is_nan());
        stamped.filter_map(move |row| Some((last.replace(row)?, row)))
    }

    /// How late those from row `from` up to `end` are, by a clock of this period: the mean of the middle half.
    fn level(&self, from: usize, end: usize, period: f64) -> f64 {
        let mut late = [0.0; WINDOW_ROWS];
        let mut count = 0;
        for row in (from..end.min(from + WINDOW_ROWS)).filter(|row| !self.late[*row].is_nan()) {
            late[count] = self.late[row] - row as f64 * period;
            count += 1;
        }
        let late = &mut late[..count];
        late.sort_by(f64::total_cmp);
        let middle = &late[count / 4..count - count / 4];
        middle.iter().sum::<f64>() / middle.len() as f64
    }
}

/// How finely numbers are written.
#[derive(Debug)]
struct Digits {
    /// Most digits behind the point.
    decimals: usize,
    /// Fewest zeros at the end of a whole number.
    zeros: usize,
    has_exponent: bool,
}

impl Default for Digits {
    fn default() -> Digits {
        Digits { decimals: 0, zeros: usize::MAX, has_exponent: false }
    }
}

impl Digits {
    fn see(&mut self, cell: &[u8]) {
        let digits = cell.iter().filter(|byte| byte.is_ascii_digit()).count();
        self.has_exponent |= cell.iter().any(|byte| matches!(byte, b'e' | b'E'));
        match cell.iter().position(|byte| matches!(byte, b'.' | b',')) {
            Some(point) => {
                let decimals = cell[point..].iter().filter(|byte| byte.is_ascii_digit()).count();
                self.decimals = self.decimals.max(decimals);
            }
            None => {
                let zeros = cell.iter().rev().take_while(|byte| **byte == b'0').count();
                // Zero is a multiple of anything.
                if zeros < digits {
                    self.zeros = self.zeros.min(zeros);
                }
            }
        }
    }

    fn resolution(&self) -> f64 {
        match (self.has_exponent, self.decimals, self.zeros) {
            (true, ..) | (_, 0, usize::MAX) => 0.0,
            (_, 0, zeros) => 10_f64.powi(zeros as i32),
            (_, decimals, _) => 0.1_f64.powi(decimals as i32),
        }
    }
}

impl Clock {
    /// Measures the clock in `column` over up to `most_rows` rows of `text` from `position` on; `None` if it does not rise from
    /// row to row, as where samples come in bursts.
    pub(super) fn of_time(
        text: &[u8],
        position: usize,
        separator: Separator,
        column: usize,
        has_comma: bool,
        most_rows: usize,
    ) -> Option<Clock> {
        let stamps = Stamps::read(text, position, separator, column, has_comma, most_rows);
        let mut steps: Vec<f64> = stamps
            .pairs()
            .take(MOST_STEPS)
            .map(|(row, next)| (stamps.late[next] - stamps.late[row]) / (next - row) as f64)
            .collect();
        if steps.len() + 1 < FEWEST_ROWS {
            return None;
        }
        steps.sort_by(f64::total_cmp);
        // Gaps are few: they are not among these.
        let (low, high) = (share(&steps, 0.05), share(&steps, 0.95));
        let usual: Vec<f64> = steps.into_iter().filter(|step| (low..=high).contains(step)).collect();
        let rough = usual.iter().sum::<f64>() / usual.len() as f64;
        // Numbers as large as a date in µs are exact only to some digits.
        let rounding = stamps.largest * 4.0 * f64::EPSILON;
        let spread = high - low;
        if rough <= rounding || !rough.is_finite() {
            return None;
        }
        let mut period = slope_between(&stamps, rough, spread);
        // In bursts, one step is as long as many samples: it tells nothing of any one of them.
        if !(period > rounding && spread <= 8.0 * period) {
            return None;
        }
        let mut gaps = find_gaps(&stamps, period, spread);
        for _ in 0..2 {
            period = slope_within(&stamps, &gaps).filter(|slope| *slope > rounding).unwrap_or(period);
            gaps = find_gaps(&stamps, period, spread);
        }
        let uncertainty = (spread + stamps.resolution) / (stamps.late.len() as f64 * period);
        Some(Clock { period, uncertainty, gaps })
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
        (self.period - 1.0).abs() < 1e-9 && unit_s(unit).is_none()
    }
}

/// The value below which this share of `sorted`, at least one, lies.
fn share(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// The period by stamps that lie so far apart that jitter matters little, and so near that few gaps are between them.
fn slope_between(stamps: &Stamps, rough: f64, spread: f64) -> f64 {
    let late = &stamps.late;
    let lag = (16.0 * spread / rough).ceil().clamp(1.0, WINDOW_ROWS as f64) as usize;
    let lag = lag.min(late.len() / 4).max(1);
    let starts = late.len() - lag;
    // Odd, so that it does not keep step with packets of samples.
    let stride = starts.div_ceil(MOST_STEPS) | 1;
    let slopes = (0..starts).step_by(stride).map(|row| (late[row + lag] - late[row]) / lag as f64);
    let mut slopes: Vec<f64> = slopes.filter(|slope| !slope.is_nan()).collect();
    if slopes.is_empty() {
        return rough;
    }
    slopes.sort_by(f64::total_cmp);
    let (low, high) = (share(&slopes, 0.2), share(&slopes, 0.8));
    let margin = (high - low).max(1e-3 * rough);
    slopes.retain(|slope| (low - margin..=high + margin).contains(slope));
    slopes.iter().sum::<f64>() / slopes.len() as f64
}

/// The slope that the least-squares lines through the stamps between gaps have in common.
fn slope_within(stamps: &Stamps, gaps: &[Gap]) -> Option<f64> {
    let ends = gaps.iter().map(|gap| gap.rows_before as usize).chain([stamps.late.len()]);
    let (mut products, mut squares) = (0.0, 0.0);
    let mut start = 0;
    for end in ends {
        let stamped =
            || (start..end).map(|row| (row as f64, stamps.late[row])).filter(|(_, late)| !late.is_nan());
        let count = stamped().count() as f64;
        let mean_row = stamped().map(|(row, _)| row).sum::<f64>() / count;
        let mean_late = stamped().map(|(_, late)| late).sum::<f64>() / count;
        for (row, late) in stamped() {
            products += (row - mean_row) * (late - mean_late);
            squares += (row - mean_row).powi(2);
        }
        start = end;
    }
    Some(products / squares).filter(|slope| slope.is_finite())
}

/// Unusual steps that follow close on each other: of one gap, or of samples that were held up and then came all at once.
struct Disturbance {
    /// The row after the first of its steps.
    first: usize,
    /// The row after the last one.
    last: usize,
    /// The row after the longest one, and by how much that is too long.
    longest: usize,
    excess: f64,
}

/// The steps after which stamps of this period stay late. `spread` is how much usual steps differ.
fn find_gaps(stamps: &Stamps, period: f64, spread: f64) -> Vec<Gap> {
    let disturbances = disturbances(stamps, period, spread);
    let noise = if spread < 0.5 * period { 0.0 } else { 5.0 * usual_shift(stamps, period) };
    let least_shift = if stamps.resolution <= FINE * period { 0.5 * period } else { 1.5 * period };
    let gap = |(index, disturbance): (usize, &Disturbance)| {
        let Disturbance { first, last, longest, .. } = *disturbance;
        let steady_from = if index == 0 { 0 } else { disturbances[index - 1].last };
        let before = steady_from.max(first.saturating_sub(WINDOW_ROWS));
        let steady_to = disturbances.get(index + 1).map_or(stamps.late.len(), |next| next.first);
        let after = steady_to.min(last + WINDOW_ROWS);
        let shift = stamps.level(last, after, period) - stamps.level(before, first, period);
        let fewest_rows = (first - before).min(after - last) as f64;
        if shift.abs() <= least_shift + noise * (WINDOW_ROWS as f64 / fewest_rows).sqrt() {
            return None;
        }
        // Where time goes back, what is missing is not known, but what follows does not follow on.
        let samples = (shift / period).round().clamp(1.0, LONGEST_GAP) as u64;
        Some(Gap { rows_before: longest as u64, samples })
    };
    disturbances.iter().enumerate().filter_map(gap).collect()
}

fn disturbances(stamps: &Stamps, period: f64, spread: f64) -> Vec<Disturbance> {
    /// Rows between steps that belong together.
    const CLOSE: usize = 2;
    // A coarse clock steps by its resolution, however short the period.
    let usual = (0.5 * period).max(0.9 * spread).max(stamps.resolution);
    let mut found: Vec<Disturbance> = Vec::new();
    for (row, next) in stamps.pairs() {
        let excess = (stamps.late[next] - stamps.late[row] - (next - row) as f64 * period).abs();
        if excess <= usual {
            continue;
        }
        match found.last_mut().filter(|last| row <= last.last + CLOSE) {
            Some(last) => {
                last.last = next;
                if excess > last.excess {
                    (last.longest, last.excess) = (next, excess);
                }
            }
            None => found.push(Disturbance { first: next, last: next, longest: next, excess }),
        }
    }
    found
}

/// By how much stamps are later, or earlier, than those of the window before them, where nothing is missing.
fn usual_shift(stamps: &Stamps, period: f64) -> f64 {
    let starts = (0..stamps.late.len()).step_by(WINDOW_ROWS);
    let levels: Vec<f64> = starts
        .map(|start| stamps.level(start, (start + WINDOW_ROWS).min(stamps.late.len()), period))
        .collect();
    let mut shifts: Vec<f64> = levels.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    shifts.retain(|shift| !shift.is_nan());
    shifts.sort_by(f64::total_cmp);
    if shifts.is_empty() { 0.0 } else { share(&shifts, 0.5) }
}

/// Where the counter in `column` jumps; nowhere if it does not count evenly.
pub(super) fn gaps_of_counter(
    text: &[u8],
    position: usize,
    separator: Separator,
    column: usize,
    has_comma: bool,
) -> Vec<Gap> {
    let counts = Stamps::read(text, position, separator, column, has_comma, usize::MAX);
    let step_to = |(row, next): (usize, usize)| counts.late[next] - counts.late[row];
    let mut steps: Vec<f64> =
        counts.pairs().take(MOST_STEPS).map(step_to).filter(|step| *step > 0.0).collect();
    if steps.len() < FEWEST_ROWS {
        return Vec::new();
    }
    steps.sort_by(f64::total_cmp);
    let step = share(&steps, 0.5);
    let is_even = steps.iter().filter(|other| **other == step).count() * 10 >= steps.len() * 9;
    if !is_even {
        return Vec::new();
    }
    // It begins anew after its largest number.
    let values = || counts.late.iter().copied().filter(|count| !count.is_nan());
    let numbers = values().fold(0.0, f64::max) - values().fold(0.0, f64::min) + step;
    let gap = |(row, next): (usize, usize)| {
        let risen = step_to((row, next));
        let risen = if risen < 0.0 { risen + numbers } else { risen };
        let missing = (risen / step).round() - (next - row) as f64;
        let samples = missing.clamp(0.0, LONGEST_GAP) as u64;
        (samples > 0).then_some(Gap { rows_before: next as u64, samples })
    };
    counts.pairs().filter_map(gap).collect()
}

/// The seconds that a date with a time of day, a time of day, or a number with its unit says: `2024-03-01T10:00:00.125`,
/// `10:00:00,125`, `0.0005 sec`. Time zones are passed over: a recording has one.
fn seconds(cell: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(without_quotes(cell)).ok()?;
    if let Some((value, unit)) = text.split_once(' ')
        && let (Some(value), Some(unit_s)) = (number(value.as_bytes(), true), unit_s(unit.trim()))
    {
        return Some(value * unit_s);
    }
    let (days, clock) = match text.split_once(['T', ' ']) {
        Some((date, clock)) => (days(date)?, clock.trim_start()),
        None => (0.0, text),
    };
    let end = clock.find(|part: char| !(part.is_ascii_digit() || matches!(part, ':' | '.' | ',')));
    let mut parts = clock[..end.unwrap_or(clock.len())].split(':');
    let mut next = || number(parts.next()?.as_bytes(), true).filter(|part| *part >= 0.0);
    let (hours, minutes, seconds) = (next()?, next()?, next()?);
    Some(86_400.0 * days + 3600.0 * hours + 60.0 * minutes + seconds)
}

/// Days from the beginning of 1970 to a date that is written `2024-03-01` (Fliegel and Van Flandern 1968).
fn days(date: &str) -> Option<f64> {
    let mut parts = date.split(['-', '/']).map(|part| part.parse::<i64>().ok().filter(|part| *part <= 9999));
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    if !(1..=12).contains(&month) {
        return None;
    }
    let shift = (month - 14) / 12;
    let julian = 1461 * (year + 4800 + shift) / 4 + 367 * (month - 2 - 12 * shift) / 12
        - 3 * ((year + 4900 + shift) / 100) / 4
        + day
        - 32_075;
    Some((julian - 2_440_588) as f64)
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

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use proptest::prelude::*;

    use super::*;

    /// Measures the clock by a column of nothing but these stamps.
    fn measure(stamps: impl IntoIterator<Item = String>) -> Option<Clock> {
        let text = stamps.into_iter().fold(String::new(), |text, stamp| text + &stamp + "\n");
        Clock::of_time(text.as_bytes(), 0, Separator::Byte(b','), 0, false, usize::MAX)
    }

    /// From 0 up to, but not, 1: the same for the same number.
    fn random(number: u64) -> f64 {
        let mixed = (number ^ (number >> 31)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn assert_steady(kind: &str, rate_hz: f64, stamps_s: impl IntoIterator<Item = String>) {
        let clock = measure(stamps_s).unwrap_or_else(|| panic!("{kind}: no clock"));
        let found_hz = clock.rate_hz("s").unwrap();
        assert!((found_hz / rate_hz - 1.0).abs() < 1e-3, "{kind}: {found_hz} Hz");
        assert_eq!(clock.gaps, [], "{kind}");
    }

    #[test]
    fn stamps_as_programs_take_them_give_the_rate_and_no_gaps() {
        let rows = 20_000_u64;
        for rate_hz in [999.7, 1000.4, 2000.0, 500.3, 976.5625, 962.0, 990.0] {
            let time = |row| row as f64 / rate_hz;
            assert_steady("rounded to ms", rate_hz, (0..rows).map(|row| format!("{:.3}", time(row))));
            let cut = |row| ((time(row) * 1000.0) as u64) as f64 / 1000.0;
            assert_steady("cut to ms", rate_hz, (0..rows).map(|row| format!("{:.3}", cut(row))));
            let sparse = |row| if row % 7 == 0 { String::new() } else { format!("{:.4}", time(row)) };
            assert_steady("every seventh is missing", rate_hz, (0..rows).map(sparse));
        }
        let time = |row: u64| 1.7e9 + row as f64 / 200.0;
        let bell = |row| (0..12).map(|number| random(12 * row + number)).sum::<f64>() - 6.0;
        let jitter = (0..rows).map(|row| format!("{:.6}", time(row) + 2e-3 * bell(row)));
        assert_steady("jitter on both sides", 200.0, jitter);
        // What arrives late makes what follows wait.
        let late = |number: u64, mean_s: f64| -mean_s * (1.0 - random(number)).ln();
        let mut last = 0.0_f64;
        let arrived = (0..rows).map(|row| {
            last = last.max(time(row) + late(row, 3e-3));
            format!("{last:.6}")
        });
        assert_steady("on arrival", 200.0, arrived);
        let mut last = 0.0_f64;
        let packets = (0..rows).map(|row| {
            last = last.max(time(row / 2 * 2) + late(row / 2, 2e-3));
            format!("{last:.6}")
        });
        assert_steady("packets of two", 200.0, packets);
        // The radio stalls for 15 samples, which then come at once.
        let stalled = |row| time(if row % 4000 < 15 { row / 4000 * 4000 + 15 } else { row });
        assert_steady("stalls", 200.0, (100..rows).map(|row| format!("{:.6}", stalled(row))));
    }

    #[test]
    fn times_of_day_are_read() {
        for (cell, expected_s) in [
            ("1970-01-02T00:00:01.5", Some(86_401.5)),
            ("2024-03-01 10:00:00.125", Some(1_709_287_200.125)),
            ("2024-03-01T10:00:00+01:00", Some(1_709_287_200.0)),
            ("10:01:00,125", Some(36_060.125)),
            ("\"00:00:01\"", Some(1.0)),
            ("0.0005 sec", Some(0.0005)),
            ("12 ms", Some(0.012)),
            ("10:00", None),
            ("2024-03-01", None),
            ("2024-13-01 10:00:00", None),
            ("rest", None),
            ("", None),
        ] {
            assert_eq!(seconds(cell.as_bytes()), expected_s, "{cell}");
        }
        let times = (0..4000).map(|row| {
            let time_s = f64::from(row + if row < 2000 { 0 } else { 5000 }) / 2000.0;
            format!("2024-03-01T23:{:02}:{:09.6}", 59 + (time_s / 60.0) as u32, time_s % 60.0)
        });
        let clock = measure(times).unwrap();
        assert_eq!(clock.rate_hz(""), Some(2000.0));
        assert_eq!(clock.gaps, [Gap { rows_before: 2000, samples: 5000 }]);
    }

    #[test]
    fn a_counter_begins_anew_wherever_that_is() {
        for (first, numbers) in [(0_u64, 65_536_u64), (45_536, 65_536), (60_000, 65_536), (3, 256)] {
            let counts = |skipped: u64| {
                (0..30_000).fold(String::new(), |mut text, row| {
                    let count = first + row + if row < 25_000 { 0 } else { skipped };
                    writeln!(text, "{}", count % numbers).unwrap();
                    text
                })
            };
            let gaps = |text: String| gaps_of_counter(text.as_bytes(), 0, Separator::Byte(b','), 0, false);
            assert_eq!(gaps(counts(0)), [], "from {first}");
            assert_eq!(gaps(counts(5)), [Gap { rows_before: 25_000, samples: 5 }], "from {first}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        #[test]
        fn rate_and_gaps_are_found_whatever_the_clock(
            rate_hz in 150.0_f64..5000.0,
            start_s in prop::sample::select(vec![0.0, 3.7, 1.7e9]),
            decimals in prop::sample::select(vec![3_usize, 4, 6]),
            jitter in prop::sample::select(vec![0.0, 0.1, 0.5, 1.0]),
            gaps in prop::collection::vec((0_u64..2000, 1_u64..400), 0..=3),
            seed: u64,
        ) {
            const ROWS_BETWEEN: u64 = 5000;
            let resolution = 0.1_f64.powi(decimals as i32);
            // In units of the coarser of period and resolution.
            let is_exact = resolution * rate_hz < 0.2 && jitter == 0.0;
            let shortest = if is_exact { 1 } else { (3.0 * f64::max(1.0, resolution * rate_hz)).ceil() as u64 };
            let gaps: Vec<Gap> = gaps
                .iter()
                .enumerate()
                .map(|(number, (at, samples))| Gap {
                    rows_before: (number as u64 + 1) * ROWS_BETWEEN + at,
                    samples: shortest + samples - 1,
                })
                .collect();
            let stamps = (0..(gaps.len() as u64 + 2) * ROWS_BETWEEN).map(|row| {
                let lost: u64 = gaps.iter().filter(|gap| gap.rows_before <= row).map(|gap| gap.samples).sum();
                let late = jitter * random(seed.wrapping_add(row));
                let stamp = start_s + ((row + lost) as f64 + late) / rate_hz;
                format!("{stamp:.decimals$}")
            });
            let clock = measure(stamps).unwrap();
            let found_hz = clock.rate_hz("s").unwrap();
            prop_assert!((found_hz / rate_hz - 1.0).abs() < 1e-3, "{found_hz} Hz");
            let at = |gaps: &[Gap]| gaps.iter().map(|gap| gap.rows_before).collect::<Vec<_>>();
            prop_assert_eq!(at(&clock.gaps), at(&gaps));
            for (found, gap) in clock.gaps.iter().zip(&gaps) {
                prop_assert!(found.samples.abs_diff(gap.samples) <= u64::from(!is_exact), "{found:?}, {gap:?}");
            }
        }
    }
}
