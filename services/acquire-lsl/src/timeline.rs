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
//!
//! While stamps contradict those before, no sample counts as newer than its stamp says.

use std::ops::Range;

use tendon_source::{DeviceClock, LossByTime};

use crate::stamps::{Arrival, Newest, Oddities, Stamps, Step};

/// Where stamps jitter, samples that come so much later than before and stay so were preceded by lost ones, ns.
const LATE_NS: u64 = 20_000_000;

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
    stamps: Stamps,
    clock: DeviceClock,
    loss: LossByTime,
    /// How long before its arrival the newest sample was stamped, s.
    stamp_age_s: f64,
}

impl Timeline {
    /// For a stream of this nominal rate.
    pub fn new(sample_rate_hz: f64) -> Timeline {
        Timeline {
            sample_rate_hz,
            next_sample: 0,
            stamps: Stamps::new(sample_rate_hz),
            clock: DeviceClock::default(),
            loss: LossByTime::new(LATE_NS),
            stamp_age_s: 0.0,
        }
    }

    /// Numbers the samples of a frame, whose stamps these are, and gives its parts without a gap.
    pub fn place(&mut self, stamps: &[f64], arrival: Arrival, mut on_run: impl FnMut(Run)) {
        if arrival.is_new_connection {
            self.next_sample += self.stamps.reconnect(stamps.first().copied(), arrival);
            self.begin_clock();
        }
        let mut begin = 0;
        let mut first_sample = self.next_sample;
        for (index, &stamp_s) in stamps.iter().enumerate() {
            let Step { lost, begins_clock } = self.stamps.take(stamp_s, arrival);
            if begins_clock {
                self.begin_clock();
            }
            if lost > 0 {
                if index > begin {
                    on_run(self.run(begin..index, first_sample, arrival));
                }
                self.next_sample += lost;
                (begin, first_sample) = (index, self.next_sample);
            }
            self.next_sample += 1;
        }
        if !stamps.is_empty() {
            on_run(self.run(begin..stamps.len(), first_sample, arrival));
        }
    }

    /// What was odd so far.
    pub fn oddities(&self) -> Oddities {
        self.stamps.oddities()
    }

    /// How long before its arrival the newest sample was stamped, s.
    pub fn stamp_age_s(&self) -> f64 {
        self.stamp_age_s
    }

    /// How much faster than CLOCK_MONOTONIC the amplifier counts its samples, ppm.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.clock.drift_ppm()
    }

    fn begin_clock(&mut self) {
        self.clock = DeviceClock::default();
        self.loss = LossByTime::new(LATE_NS);
    }

    /// A part of a frame whose newest sample is the last one that was numbered.
    fn run(&mut self, samples: Range<usize>, first_sample: u64, arrival: Arrival) -> Run {
        let Newest { age_s, is_future, captured_ns: stamp_ns } = self.stamps.newest(arrival.received_ns);
        self.stamp_age_s = age_s;
        let counted_s = (first_sample + samples.len() as u64) as f64 / self.sample_rate_hz;
        let counted_ns = (counted_s * 1e9) as u64;
        let captured_ns = if self.stamps.is_contradicting() {
            self.clock.predicted_ns(counted_ns).map_or(stamp_ns, |predicted_ns| predicted_ns.min(stamp_ns))
        } else {
            let smooth_ns = self.clock.captured_ns(counted_ns, stamp_ns);
            if self.stamps.is_exact() && !is_future {
                stamp_ns
            } else {
                let lost_ns = self.loss.observe(arrival.received_ns, stamp_ns - smooth_ns);
                self.next_sample += (lost_ns as f64 * 1e-9 * self.sample_rate_hz).round() as u64;
                smooth_ns
            }
        };
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

    /// Places a chunk, and gives when its newest sample was captured.
    fn place_one(timeline: &mut Timeline, stamps: &[f64], received_ns: u64) -> Run {
        let arrival = Arrival { is_new_connection: false, correction_s: CORRECTION_S, received_ns };
        let mut runs = Vec::new();
        timeline.place(stamps, arrival, |run| runs.push(run));
        runs.pop().unwrap()
    }

    /// When the newest sample of a chunk of [`counted`] stamps is captured, ns.
    fn true_ns(chunk: u64) -> u64 {
        100_000_000_000 + (chunk * 20 + 19) * 500_000
    }

    /// A chunk of stamps of the moment of sending: chunks overlap by up to 3 ms.
    fn jittering(chunk: u64) -> Vec<f64> {
        let late_s = (chunk * 7 % 4) as f64 * 1e-3;
        counted(chunk * 20..chunk * 20 + 20).iter().map(|stamp| stamp + late_s).collect()
    }

    #[test]
    fn one_chunk_with_odd_stamps_changes_nothing_for_those_after_it() {
        for chunk_of in [jittering, |chunk| counted(chunk * 20..chunk * 20 + 20)] {
            for offset_s in [-1000.0, -5.0, -1.5, -0.3, -0.15, 0.3, 5.0, 1e12, -1e12] {
                let (mut timeline, mut ahead) = (Timeline::new(RATE_HZ), 0);
                for chunk in 0..2000 {
                    let mut stamps = chunk_of(chunk);
                    if chunk == 500 {
                        stamps.iter_mut().for_each(|stamp| *stamp += offset_s);
                    }
                    // Stamps of sending lie up to 3 ms after the capture.
                    let received_ns = true_ns(chunk) + 4_000_000;
                    let run = place_one(&mut timeline, &stamps, received_ns);
                    if chunk < 10 {
                        // The first chunks may be taken for exact ones.
                        ahead = run.first_sample - chunk * 20;
                    }
                    assert_eq!(run.first_sample - ahead, chunk * 20, "{offset_s} s: chunk {chunk}");
                    assert!(run.captured_ns <= received_ns, "{offset_s} s");
                    if chunk != 500 {
                        let age_ns = received_ns - run.captured_ns;
                        assert!(age_ns < 10_000_000, "{offset_s} s: chunk {chunk} is {age_ns} ns old");
                    }
                }
                assert!(
                    timeline.drift_ppm().unwrap().abs() < 100.0,
                    "{offset_s} s: {:?}",
                    timeline.drift_ppm()
                );
                // What is really late is found so.
                let late_ns = true_ns(2000) + 200_000_000;
                assert!(
                    late_ns - place_one(&mut timeline, &chunk_of(2000), late_ns).captured_ns > 150_000_000
                );
            }
        }
    }

    #[test]
    fn a_clock_that_leaps_for_good_is_measured_anew() {
        for leap_s in [-3600.0, -5.0, 3600.0] {
            let (mut timeline, mut ahead) = (Timeline::new(RATE_HZ), 0);
            let leapt = |chunk: u64| -> Vec<f64> {
                let leap_s = if chunk < 500 { 0.0 } else { leap_s };
                jittering(chunk).iter().map(|stamp| stamp + leap_s).collect()
            };
            for chunk in 0..1000 {
                let received_ns = true_ns(chunk) + 4_000_000;
                let run = place_one(&mut timeline, &leapt(chunk), received_ns);
                if chunk < 10 {
                    ahead = run.first_sample - chunk * 20;
                }
                assert_eq!(run.first_sample - ahead, chunk * 20, "{leap_s} s: chunk {chunk}");
                let age_s = (received_ns - run.captured_ns) as f64 * 1e-9;
                let expected_s = if chunk < 500 { 0.0 } else { f64::max(0.0, -leap_s).min(104.0) };
                assert!(chunk < 500 || (timeline.stamp_age_s() + leap_s).abs() < 0.01);
                assert!((age_s - expected_s).abs() < 10.0, "{leap_s} s: chunk {chunk} is {age_s} s old");
                assert!((age_s > 0.1) == (expected_s > 0.1), "{leap_s} s: chunk {chunk} is {age_s} s old");
            }
        }
    }

    #[test]
    fn chunks_that_overlap_because_they_are_stamped_when_sent_are_not_odd() {
        let mut timeline = Timeline::new(RATE_HZ);
        // Stamps of the first second count as exact until they show that they are not.
        place(&mut timeline, &(0..5).map(jittering).collect::<Vec<_>>());
        let before = timeline.oddities();
        place(&mut timeline, &(5..1000).map(jittering).collect::<Vec<_>>());
        assert_eq!(timeline.oddities(), before);
    }

    #[test]
    fn many_short_gaps_between_jittering_chunks_are_counted_and_do_not_add_up_to_lateness() {
        let mut timeline = Timeline::new(RATE_HZ);
        let mut gap_s = 0.0;
        for chunk in 0..3000 {
            gap_s += if chunk % 300 == 299 { 0.04 } else { 0.0 };
            let stamps: Vec<f64> = jittering(chunk).iter().map(|stamp| stamp + gap_s).collect();
            let received_ns = true_ns(chunk) + (gap_s * 1e9) as u64 + 4_000_000;
            let run = place_one(&mut timeline, &stamps, received_ns);
            assert!(received_ns - run.captured_ns < 100_000_000, "chunk {chunk}");
        }
        let lost = timeline.next_sample - 60_000;
        assert!(lost.abs_diff(10 * 80) < 120, "{lost}");
    }

    /// Any number, the odd ones often.
    fn any_stamp() -> impl Strategy<Value = f64> {
        prop_oneof![
            any::<f64>(),
            Just(f64::NAN),
            Just(f64::INFINITY),
            Just(f64::NEG_INFINITY),
            Just(-1.0),
            Just(0.0),
            5000.0..5200.0_f64,
        ]
    }

    proptest! {
        #[test]
        fn after_any_stamps_at_all_true_ones_give_true_times(
            odd in prop::collection::vec(prop::collection::vec(any_stamp(), 1..20), 1..30),
            is_jittering in any::<bool>(),
            // Stamps of sending lie up to 3 ms after the capture.
            late_ms in 105..2000_u64,
        ) {
            let mut timeline = Timeline::new(RATE_HZ);
            for (chunk, stamps) in (0..).zip(&odd) {
                let received_ns = true_ns(chunk) + 1_000_000;
                prop_assert!(place_one(&mut timeline, stamps, received_ns).captured_ns <= received_ns);
            }
            let first = odd.len() as u64;
            let chunk_of = |chunk: u64| match is_jittering {
                true => jittering(chunk),
                false => counted(chunk * 20..chunk * 20 + 20),
            };
            for chunk in first..first + 400 {
                let received_ns = true_ns(chunk) + 4_000_000;
                let run = place_one(&mut timeline, &chunk_of(chunk), received_ns);
                prop_assert!(run.captured_ns <= received_ns);
                prop_assert!(chunk < first + 300 || received_ns - run.captured_ns < 30_000_000);
            }
            let chunk = first + 400;
            let late_ns = true_ns(chunk) + late_ms * 1_000_000;
            let captured_ns = place_one(&mut timeline, &chunk_of(chunk), late_ns).captured_ns;
            prop_assert!(late_ns - captured_ns > 100_000_000);
        }
    }
}
