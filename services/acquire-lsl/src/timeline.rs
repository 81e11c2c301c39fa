//! From time stamps to sample numbers and capture times.
//!
//! ```text
//! stamps          0.0  0.5  1.0  1.5          4.0  4.5   ms         exact: every step is a whole number of samples
//! sample numbers   0    1    2    3   4 lost   8    9
//!
//! stamps of chunks that are stamped when they are sent:  ├┼┼┼┤  ├┼┼┼┤├┼┼┼┤   ├┼┼┼┤   they jitter: only long gaps are loss
//! ```
//!
//! LSL carries no counter: samples are lost where time stamps leap. Stamps that a program counts are exact, and each missing
//! sample shows. Stamps of the moment of sending jitter by milliseconds, and a late one cannot be told from a short gap.

use std::ops::Range;

use tendon_source::DeviceClock;

/// How far from whole numbers of samples the steps of exact stamps lie.
const EXACT: f64 = 0.2;
/// So long without another step, stamps count as exact, s.
const EXACT_AFTER_S: f64 = 1.0;
/// Where stamps jitter, leaps from here on are lost samples, s.
const ROUGH_GAP_S: f64 = 0.05;
/// A stamp further ahead of us than this is none of LSL's clock, s.
const FUTURE_S: f64 = 0.05;
/// A leap of the stamps beyond the time that has passed here, s, is one of the sender's clock and no loss.
const CLOCK_LEAP_S: f64 = 0.5;

/// What was odd about time stamps, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Oddities {
    /// Stamps that were that of the sample before.
    pub repeated: u64,
    /// Stamps before that of the sample before.
    pub backwards: u64,
    /// Leaps of the sender's clock.
    pub leaps: u64,
    /// Stamps that lay in the future, or were no numbers.
    pub impossible: u64,
}

/// A part of a frame without a gap in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Run {
    /// Its samples of the frame.
    pub samples: Range<usize>,
    /// Number of its first sample, lost ones counted in.
    pub first_sample: u64,
    /// When its newest sample was captured, CLOCK_MONOTONIC ns.
    pub captured_ns: u64,
}

/// Numbers samples by their stamps. Allocates nothing.
#[derive(Clone, Debug)]
pub struct Timeline {
    sample_rate_hz: f64,
    next_sample: u64,
    last: Option<Last>,
    /// Steps since the last one that was not exact. Stamps count as exact until they show that they are not.
    exact_steps: f64,
    clock: DeviceClock,
    oddities: Oddities,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    stamp_s: f64,
    /// On our clock.
    corrected_s: f64,
    received_ns: u64,
}

/// When a frame came, and how its stamps are understood.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Whether it is the first one of another connection.
    pub is_new_connection: bool,
    /// Is added to the stamps to have them on our clock, s.
    pub correction_s: f64,
    /// CLOCK_MONOTONIC ns.
    pub received_ns: u64,
}

impl Timeline {
    /// For a stream of this nominal rate.
    pub fn new(sample_rate_hz: f64) -> Timeline {
        Timeline {
            sample_rate_hz,
            next_sample: 0,
            last: None,
            exact_steps: EXACT_AFTER_S * sample_rate_hz,
            clock: DeviceClock::default(),
            oddities: Oddities::default(),
        }
    }

    /// Numbers the samples of a frame, whose stamps these are, and gives its parts without a gap.
    pub fn place(&mut self, stamps: &[f64], arrival: Arrival, mut on_run: impl FnMut(Run)) {
        if arrival.is_new_connection {
            self.reconnect(stamps, arrival);
        }
        let mut begin = 0;
        let mut first_sample = self.next_sample;
        for (index, &stamp_s) in stamps.iter().enumerate() {
            let lost = self.lost_before(stamp_s, arrival.received_ns);
            if lost > 0 {
                if index > begin {
                    on_run(self.run(begin..index, first_sample, arrival));
                }
                self.next_sample += lost;
                (begin, first_sample) = (index, self.next_sample);
            }
            self.next_sample += 1;
            let stamp_s = if stamp_s.is_finite() { stamp_s } else { self.expected_s(arrival) };
            let corrected_s = stamp_s + arrival.correction_s;
            self.last = Some(Last { stamp_s, corrected_s, received_ns: arrival.received_ns });
        }
        if !stamps.is_empty() {
            on_run(self.run(begin..stamps.len(), first_sample, arrival));
        }
    }

    /// What was odd so far.
    pub fn oddities(&self) -> Oddities {
        self.oddities
    }

    /// How much faster than CLOCK_MONOTONIC the amplifier counts its samples, ppm.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.clock.drift_ppm()
    }

    /// The stream was lost and is back: by our clock, so many samples are missing.
    fn reconnect(&mut self, stamps: &[f64], arrival: Arrival) {
        if let (Some(last), Some(first)) = (self.last, stamps.first()) {
            let here_s = arrival.received_ns.saturating_sub(last.received_ns) as f64 * 1e-9;
            let away_s = first + arrival.correction_s - last.corrected_s;
            let is_possible = (0.0..=here_s + CLOCK_LEAP_S).contains(&away_s);
            let samples = (if is_possible { away_s } else { here_s }) * self.sample_rate_hz;
            self.next_sample += (samples.round() as u64).saturating_sub(1);
        }
        self.last = None;
        self.exact_steps = EXACT_AFTER_S * self.sample_rate_hz;
        self.clock = DeviceClock::default();
    }

    fn expected_s(&self, arrival: Arrival) -> f64 {
        let last_s = self.last.map_or(arrival.received_ns as f64 * 1e-9, |last| last.stamp_s);
        last_s + 1.0 / self.sample_rate_hz
    }

    /// How many samples are missing before the one with this stamp.
    fn lost_before(&mut self, stamp_s: f64, received_ns: u64) -> u64 {
        let Some(last) = self.last else { return 0 };
        if !stamp_s.is_finite() {
            self.oddities.impossible += 1;
            return 0;
        }
        let step_s = stamp_s - last.stamp_s;
        let step = step_s * self.sample_rate_hz;
        let is_whole = (step - step.round()).abs() <= EXACT && step.round() >= 1.0;
        let was_exact = self.exact_steps >= EXACT_AFTER_S * self.sample_rate_hz;
        self.exact_steps = if is_whole { self.exact_steps + 1.0 } else { 0.0 };
        let here_s = received_ns.saturating_sub(last.received_ns) as f64 * 1e-9;
        if step_s == 0.0 {
            self.oddities.repeated += 1;
        } else if step_s < -0.5 / self.sample_rate_hz {
            self.oddities.backwards += 1;
        } else if step_s > here_s + CLOCK_LEAP_S {
            self.oddities.leaps += 1;
        } else if (was_exact && is_whole) || step_s > ROUGH_GAP_S {
            return (step.round() as u64).saturating_sub(1);
        }
        0
    }

    /// A part of a frame whose newest sample is the last one that was numbered.
    fn run(&mut self, samples: Range<usize>, first_sample: u64, arrival: Arrival) -> Run {
        let corrected_s = self.last.map_or(0.0, |last| last.corrected_s);
        let received_s = arrival.received_ns as f64 * 1e-9;
        let is_possible = corrected_s >= 0.0 && corrected_s <= received_s + FUTURE_S;
        self.oddities.impossible += u64::from(!is_possible);
        let stamp_ns = if is_possible { (corrected_s * 1e9) as u64 } else { arrival.received_ns };
        let stamp_ns = stamp_ns.min(arrival.received_ns);
        let counted_s = (first_sample + samples.len() as u64) as f64 / self.sample_rate_hz;
        let smooth_ns = self.clock.captured_ns((counted_s * 1e9) as u64, stamp_ns);
        let is_exact = self.exact_steps >= EXACT_AFTER_S * self.sample_rate_hz;
        let captured_ns = if is_exact { stamp_ns } else { smooth_ns };
        Run { samples, first_sample, captured_ns }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const RATE_HZ: f64 = 2000.0;
    const CHUNK: usize = 20;
    /// The sender's clock is so far ahead of ours, s.
    const CORRECTION_S: f64 = -5000.0;

    /// Numbers chunks of stamps as they come, each 1 ms after its newest sample, and gives all runs.
    fn place(timeline: &mut Timeline, chunks: &[Vec<f64>]) -> Vec<Run> {
        let mut runs = Vec::new();
        for stamps in chunks {
            let newest_s = stamps.last().unwrap() + CORRECTION_S;
            let received_ns = (newest_s * 1e9) as u64 + 1_000_000;
            let arrival = Arrival { is_new_connection: false, correction_s: CORRECTION_S, received_ns };
            timeline.place(stamps, arrival, |run| runs.push(run));
        }
        runs
    }

    /// Stamps of samples that were counted: sample 0 at 5100 s of the sender.
    fn counted(samples: Range<u64>) -> Vec<f64> {
        samples.map(|sample| 5100.0 + sample as f64 / RATE_HZ).collect()
    }

    /// Two seconds of chunks, so that stamps count as exact.
    fn two_seconds() -> Vec<Vec<f64>> {
        (0..200).map(|chunk| counted(chunk * CHUNK as u64..(chunk + 1) * CHUNK as u64)).collect()
    }

    #[test]
    fn exact_stamps_give_capture_times_and_every_lost_sample() {
        let mut timeline = Timeline::new(RATE_HZ);
        let runs = place(&mut timeline, &two_seconds());
        assert_eq!(runs.last().unwrap().first_sample, 3980);
        assert!(runs.last().unwrap().captured_ns.abs_diff(100_000_000_000 + 3999 * 500_000) < 1000);
        // One sample lost between chunks, then seven within one.
        let within: Vec<f64> = [counted(4001..4011), counted(4018..4028)].concat();
        let runs = place(&mut timeline, &[within]);
        assert_eq!(runs.len(), 2);
        assert_eq!((runs[0].first_sample, runs[0].samples.clone()), (4001, 0..10));
        assert_eq!((runs[1].first_sample, runs[1].samples.clone()), (4018, 10..20));
        assert_eq!(timeline.oddities(), Oddities::default());
    }

    #[test]
    fn stamps_that_jitter_are_no_loss_and_long_gaps_are() {
        let mut timeline = Timeline::new(RATE_HZ);
        let mut noise = 1_u64;
        let mut jittering = |chunk: u64, gap_s: f64| -> Vec<f64> {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let late_s = (noise >> 40) as f64 / (1 << 24) as f64 * 0.008 + gap_s;
            counted(chunk * 20..chunk * 20 + 20).iter().map(|stamp| stamp + late_s).collect()
        };
        let chunks: Vec<Vec<f64>> = (0..400).map(|chunk| jittering(chunk, 0.0)).collect();
        let runs = place(&mut timeline, &chunks);
        // The first chunks may be taken for exact ones.
        assert!(runs.last().unwrap().first_sample - runs[10].first_sample == 389 * 20, "{runs:?}");
        let last = runs.last().unwrap().first_sample;
        let captured: Vec<u64> = runs[300..].iter().map(|run| run.captured_ns).collect();
        let steps = captured.windows(2).map(|pair| pair[1] - pair[0]);
        assert!(steps.clone().all(|step| step.abs_diff(10_000_000) < 500_000), "{:?}", steps.max());
        let runs = place(&mut timeline, &[jittering(400, 0.2)]);
        let lost = runs[0].first_sample - last - 20;
        assert!((380..=420).contains(&lost), "{lost}");
    }

    #[test]
    fn odd_stamps_are_counted_and_make_no_loss() {
        let mut timeline = Timeline::new(RATE_HZ);
        place(&mut timeline, &two_seconds());
        let mut odd = counted(4000..4020);
        odd[5] = odd[4];
        odd[10] -= 1.0;
        odd[11] = f64::NAN;
        let runs = place(&mut timeline, &[odd]);
        assert_eq!(runs[0].first_sample, 4000);
        let oddities = timeline.oddities();
        assert_eq!((oddities.repeated, oddities.backwards, oddities.impossible), (1, 1, 1), "{oddities:?}");
    }

    #[test]
    fn a_leap_of_the_senders_clock_is_no_loss() {
        let mut timeline = Timeline::new(RATE_HZ);
        place(&mut timeline, &two_seconds());
        let received_ns = 102_011_000_000;
        let arrival = Arrival { is_new_connection: false, correction_s: CORRECTION_S, received_ns };
        let leapt: Vec<f64> = counted(4000..4020).iter().map(|stamp| stamp + 3600.0).collect();
        let mut runs = Vec::new();
        timeline.place(&leapt, arrival, |run| runs.push(run));
        assert_eq!(runs[0].first_sample, 4000);
        assert!(runs[0].captured_ns <= received_ns, "never in the future");
        assert_eq!(timeline.oddities().leaps, 1);
    }

    #[test]
    fn a_stream_that_comes_back_continues_by_our_clock_whatever_its_own_says() {
        let mut timeline = Timeline::new(RATE_HZ);
        place(&mut timeline, &two_seconds());
        // After 3 s, from another computer, whose clock is behind ours.
        let arrival = Arrival { is_new_connection: true, correction_s: 50.0, received_ns: 105_000_000_000 };
        let stamps: Vec<f64> = (0..20).map(|sample| 54.99 + sample as f64 / RATE_HZ).collect();
        let mut runs = Vec::new();
        timeline.place(&stamps, arrival, |run| runs.push(run));
        assert_eq!(runs[0].first_sample, (4.99 * RATE_HZ) as u64);
    }

    proptest! {
        #[test]
        fn numbers_never_go_back_and_captures_are_never_in_the_future(
            steps in prop::collection::vec((-2.0..2.0_f64, 1_usize..40, any::<bool>()), 1..50),
        ) {
            let mut timeline = Timeline::new(RATE_HZ);
            let (mut stamp_s, mut received_ns, mut next) = (100.0, 200_000_000_000, 0);
            for (step_s, samples, is_new_connection) in steps {
                stamp_s += step_s;
                let stamps: Vec<f64> = (0..samples).map(|sample| stamp_s + sample as f64 / RATE_HZ).collect();
                let arrival = Arrival { is_new_connection, correction_s: 100.0, received_ns };
                let mut runs = Vec::new();
                timeline.place(&stamps, arrival, |run| runs.push(run));
                prop_assert_eq!(runs.iter().map(|run| run.samples.len()).sum::<usize>(), samples);
                for run in runs {
                    prop_assert!(run.first_sample >= next);
                    prop_assert!(run.captured_ns <= received_ns);
                    next = run.first_sample + run.samples.len() as u64;
                }
                received_ns += 20_000_000;
            }
        }
    }
}
