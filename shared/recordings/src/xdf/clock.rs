//! From time stamps to the times of samples.

use super::chunks::Contents;
use super::stream::Stream;

/// What to add to the stamps of a stream: a straight line through the offsets of its clock.
pub(super) struct Clock {
    /// Where the line is `offset_s`.
    at_s: f64,
    offset_s: f64,
    slope: f64,
}

/// Samples whose stamps follow on.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stretch {
    /// Index of the first one.
    pub(super) first_sample: u64,
    /// How many.
    pub(super) samples: u64,
    /// Time of the first one on the straight line through the stamps.
    pub(super) start_s: f64,
    /// From one to the next on that line.
    pub(super) period_s: f64,
}

impl Stretch {
    /// From one sample to the next by the median of the slopes between stamps a quarter of the stretch apart.
    pub(super) fn usual_period_s(&self, stamps_s: &[f64], clock: &Clock) -> f64 {
        let first = self.first_sample as usize;
        let stamps_s = &stamps_s[first..first + self.samples as usize];
        let lag = (stamps_s.len() / 4).max(1);
        let rise_s = |pair: (&f64, &f64)| clock.corrected(*pair.1) - clock.corrected(*pair.0);
        median(stamps_s.iter().zip(&stamps_s[lag..]).map(rise_s)) / lag as f64
    }

    /// Time of its sample number `sample`, or of one that would follow.
    pub(super) fn time_of(&self, sample: u64) -> f64 {
        self.start_s + sample as f64 * self.period_s
    }
}

impl Clock {
    /// The line that half of the offsets can be wrong about without bending it: the median of the slopes between them
    /// (Theil 1950, Sen 1968).
    pub(super) fn of(stream: &Stream, contents: &Contents<'_>) -> Clock {
        let own = contents.offsets.iter().filter(|(id, ..)| *id == stream.id);
        Clock::through(own.map(|(_, at_s, offset_s)| (*at_s, *offset_s)).collect())
    }

    fn through(offsets: Vec<(f64, f64)>) -> Clock {
        // Of a long recording fewer will do: pairs become many.
        const MAX_OFFSETS: usize = 500;
        let step = offsets.len().div_ceil(MAX_OFFSETS).max(1);
        let offsets: Vec<(f64, f64)> = offsets.into_iter().step_by(step).collect();
        let pairs = offsets.iter().enumerate().flat_map(|(number, first)| {
            offsets[number + 1..].iter().map(move |second| (second.1 - first.1, second.0 - first.0))
        });
        let slope = median(pairs.filter(|(_, run_s)| *run_s > 0.0).map(|(rise_s, run_s)| rise_s / run_s));
        let at_s = offsets.first().map_or(0.0, |(at_s, _)| *at_s);
        let offset_s = median(offsets.iter().map(|(time_s, offset_s)| offset_s - slope * (time_s - at_s)));
        Clock { at_s, offset_s, slope }
    }

    /// A stamp of the stream by the recorder's clock.
    pub(super) fn corrected(&self, stamp_s: f64) -> f64 {
        stamp_s + self.offset_s + self.slope * (stamp_s - self.at_s)
    }
}

/// The median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let middle = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Divides samples where their stamps jump, and lays a straight line through the stamps of each part: the jitter of the network
/// and of the sender's computer is none of the device's. `stamped` are the samples with a stamp of their own.
pub(super) fn stretches(
    stamps_s: &[f64],
    stamped: &[usize],
    rate_hz: f64,
    can_drop_samples: bool,
    clock: &Clock,
) -> Vec<Stretch> {
    let period_s = 1.0 / rate_hz;
    let jump_s = |sample: usize| (stamps_s[sample] - stamps_s[sample - 1] - period_s).abs();
    // As pyxdf: jumps of a second, and of 500 samples. A stream that says that it loses samples means shorter ones, too.
    let mut least_jump_s = f64::max(1.0, 500.0 / rate_hz);
    if can_drop_samples {
        const ENOUGH_STAMPS: usize = 10;
        let is_known = stamped.len() >= ENOUGH_STAMPS;
        let jitter_s =
            median(stamped.iter().filter(|sample| **sample > 0 && is_known).map(|sample| jump_s(*sample)));
        least_jump_s = least_jump_s.min((10.0 * jitter_s).max(0.5 * period_s));
    }
    let mut stretches = Vec::new();
    let mut first = 0;
    for end in 1..=stamps_s.len() {
        let follows_on = end < stamps_s.len() && jump_s(end) <= least_jump_s;
        if !follows_on {
            stretches.push(line(&stamps_s[first..end], first, period_s, clock));
            first = end;
        }
    }
    stretches
}

/// The least-squares line through the stamps of samples from number `first` on.
fn line(stamps_s: &[f64], first: usize, period_s: f64, clock: &Clock) -> Stretch {
    let count = stamps_s.len() as f64;
    let middle = (count - 1.0) / 2.0;
    // From the first stamp, so that no digits are lost.
    let start_s = clock.corrected(stamps_s[0]);
    let late = |stamp_s: &f64| clock.corrected(*stamp_s) - start_s;
    let mean_s = stamps_s.iter().map(late).sum::<f64>() / count;
    let products =
        stamps_s.iter().enumerate().map(|(n, stamp_s)| (n as f64 - middle) * (late(stamp_s) - mean_s));
    let squares = count * (count * count - 1.0) / 12.0;
    let slope_s = products.sum::<f64>() / squares;
    // A single stamp has no slope, and one of a few may have any.
    let is_likely = (slope_s / period_s - 1.0).abs() < 1.0;
    let period_s = if is_likely { slope_s } else { period_s };
    Stretch {
        first_sample: first as u64,
        samples: stamps_s.len() as u64,
        start_s: start_s + mean_s - middle * period_s,
        period_s,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_far_off_do_not_bend_the_line() {
        let offset = |number: i32| {
            let at_s = 1e5 + 5.0 * f64::from(number);
            let wrong_s = if number % 4 == 0 { 0.4 } else { 0.0 };
            (at_s, -0.5 - 1e-4 * (at_s - 1e5) + wrong_s)
        };
        let clock = Clock::through((0..1200).map(offset).collect());
        for after_s in [0.0, 1000.0, 6000.0] {
            let corrected = clock.corrected(1e5 + after_s) - 1e5;
            assert!((corrected - (after_s - 0.5 - 1e-4 * after_s)).abs() < 1e-6, "{after_s}: {corrected}");
        }
        assert_eq!(Clock::through(Vec::new()).corrected(5.0), 5.0);
        assert_eq!(Clock::through(vec![(3.0, -0.5)]).corrected(10.0), 9.5);
    }

    #[test]
    fn jitter_is_taken_for_none_of_the_devices() {
        let jitter = |number: usize| ((number * 7919) % 13) as f64 * 1e-3;
        let mut stamps_s: Vec<f64> = (0..2000).map(|number| number as f64 * 0.01 + jitter(number)).collect();
        stamps_s.extend((0..500).map(|number| 30.0 + number as f64 * 0.01 + jitter(number)));
        let clock = Clock::through(Vec::new());
        let found = stretches(&stamps_s, &[0], 100.0, false, &clock);
        assert_eq!(
            found.iter().map(|stretch| (stretch.first_sample, stretch.samples)).collect::<Vec<_>>(),
            [(0, 2000), (2000, 500)]
        );
        for (stretch, start_s) in found.iter().zip([0.0, 30.0]) {
            assert!((stretch.start_s - start_s - 6e-3).abs() < 1e-3, "{stretch:?}");
            assert!((stretch.period_s - 0.01).abs() < 2e-6, "{stretch:?}");
        }
    }
}
