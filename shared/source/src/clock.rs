//! The clock of a device, mapped to CLOCK_MONOTONIC.
//!
//! ```text
//! received − device time     ·  ·   ·      ·  ·     each block comes some time after its capture, now more, now less;
//!                          ·   ·  · ·  · ·  ·  ·    the least of them lie on a line: offset and drift of the clock
//!                         ─────────────────────────
//!                                   x               far below the line: its device time leapt ahead, and it is not learnt
//! ```

use std::collections::VecDeque;

/// Time over which the least delay is looked for, ns of the device.
const INTERVAL_NS: u64 = 2_000_000_000;
/// Intervals that the line goes through.
const INTERVALS: usize = 15;
/// Most drift of a device's clock, 1 for 1. What differs more counts at another rate.
const MOST_DRIFT: f64 = 1e-3;
/// So many intervals in a row in which the device counts too fast, or too slowly, for a clock that drifts are another rate. A delay that
/// comes or goes changes one of them.
const STEADY_INTERVALS: usize = 10;
/// A block that comes so much before its time contradicts the line, ns.
const EARLY_NS: i128 = 20_000_000;
/// So many blocks in a row that come before their time show that the device's clock has leapt.
const SEVERAL: u32 = 5;

/// Maps the time of a device to CLOCK_MONOTONIC, whatever its offset and its (constant) drift, from the times at which
/// its blocks were received. A delay that all blocks have cannot be told from an offset.
///
/// Blocks that come late stay late, however long that lasts: the line rises by 1 ms in a second at most.
#[derive(Clone, Debug, Default)]
pub struct DeviceClock {
    /// Of each completed interval, the point with the least difference.
    least: VecDeque<Point>,
    /// The same of the current interval.
    current: Option<Point>,
    current_began_ns: u64,
    /// Through `least`: difference at a device time, and its slope.
    line: Option<(Point, f64)>,
    /// Blocks in a row that came before their time.
    early_blocks: u32,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    device_ns: u64,
    /// Received minus device time.
    difference_ns: i128,
}

impl Point {
    /// Device time from `other` to this point, ns.
    fn since(&self, other: &Point) -> f64 {
        self.device_ns as f64 - other.device_ns as f64
    }
}

impl DeviceClock {
    /// Takes the device's time of a sample and when it was received (CLOCK_MONOTONIC), both in ns and not earlier
    /// than before, and returns when it was captured, CLOCK_MONOTONIC: never later than it was received.
    ///
    /// A block whose device time lies ahead of what can have passed is not learnt from. Several in a row begin a new line.
    pub fn captured_ns(&mut self, device_ns: u64, received_ns: u64) -> u64 {
        let point = Point { device_ns, difference_ns: i128::from(received_ns) - i128::from(device_ns) };
        let expected_ns = self.expected_ns(&point);
        if expected_ns.is_some_and(|expected_ns| point.difference_ns < expected_ns - EARLY_NS) {
            self.early_blocks += 1;
            if self.early_blocks < SEVERAL {
                return received_ns;
            }
            *self = DeviceClock::default();
        }
        self.early_blocks = 0;
        self.learn(point);
        self.predicted_ns(device_ns).unwrap_or(received_ns).min(received_ns)
    }

    /// When a sample of this device time was captured, CLOCK_MONOTONIC ns, by what was learnt so far; `None` before anything was.
    pub fn predicted_ns(&self, device_ns: u64) -> Option<u64> {
        let expected_ns = self.expected_ns(&Point { device_ns, difference_ns: 0 })?;
        Some((i128::from(device_ns) + expected_ns).clamp(0, i128::from(u64::MAX)) as u64)
    }

    /// How much faster than CLOCK_MONOTONIC the device counts, in parts per million; `None` until that is known.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.line.filter(|_| self.least.len() > 1).map(|(_, slope)| -slope * 1e6)
    }

    /// How fast the device counts, as a share of what it should, where for the last 20 s that has been another rate and no drift.
    pub fn other_rate(&self) -> Option<f64> {
        let newest = self.least.len().checked_sub(STEADY_INTERVALS + 1)?;
        let slope = |from: &Point, to: &Point| {
            (to.difference_ns - from.difference_ns) as f64 / to.since(from).max(1.0)
        };
        let recent = || self.least.iter().skip(newest);
        let is_another = |direction: f64| {
            recent().zip(recent().skip(1)).all(|(from, to)| direction * slope(from, to) > MOST_DRIFT)
        };
        let (first, last) = (recent().next()?, self.least.back()?);
        (is_another(1.0) || is_another(-1.0)).then(|| 1.0 / (1.0 + slope(first, last)))
    }

    /// The difference that the line has at the device time of `point`.
    fn expected_ns(&self, point: &Point) -> Option<i128> {
        match self.line {
            Some((from, slope)) => Some(from.difference_ns + (slope * point.since(&from)) as i128),
            None => self.current.map(|least| least.difference_ns),
        }
    }

    fn learn(&mut self, point: Point) {
        let interval_ns = point.device_ns.saturating_sub(self.current_began_ns);
        if self.current.is_some() && interval_ns >= INTERVAL_NS {
            self.complete_interval();
        }
        // Along the line, so that drift within the interval does not favour one of its ends.
        let slope = self.line.map_or(0.0, |(_, slope)| slope);
        match &mut self.current {
            None => {
                self.current_began_ns = point.device_ns;
                self.current = Some(point);
            }
            Some(least) => {
                if point.difference_ns < least.difference_ns + (slope * point.since(least)) as i128 {
                    *least = point;
                }
            }
        }
    }

    /// Lays the line anew: least squares through the least of each interval, then down to the lowest of them.
    fn complete_interval(&mut self) {
        self.least.extend(self.current.take());
        if self.least.len() > INTERVALS {
            self.least.pop_front();
        }
        let Some(&origin) = self.least.back() else { return };
        let relative =
            |point: &Point| (point.since(&origin), (point.difference_ns - origin.difference_ns) as f64);
        let count = self.least.len() as f64;
        let (sum_x, sum_y) =
            self.least.iter().map(relative).fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x, sum.1 + y));
        let (mean_x, mean_y) = (sum_x / count, sum_y / count);
        let (mut xx, mut xy) = (0.0, 0.0);
        for (x, y) in self.least.iter().map(relative) {
            xx += (x - mean_x) * (x - mean_x);
            xy += (x - mean_x) * (y - mean_y);
        }
        let slope = if xx > 0.0 { (xy / xx).clamp(-MOST_DRIFT, MOST_DRIFT) } else { 0.0 };
        let lowest = self.least.iter().map(relative).map(|(x, y)| y - slope * x).fold(f64::MAX, f64::min);
        let mut difference_ns = origin.difference_ns + lowest as i128;
        if let Some((before, _)) = self.line {
            // Otherwise late blocks would count as timely once they have been late for long enough.
            let rise_ns = (MOST_DRIFT * origin.since(&before).abs()) as i128;
            difference_ns = difference_ns.min(before.difference_ns + rise_ns);
        }
        self.line = Some((Point { difference_ns, ..origin }, slope));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Time of a block of 5 ms, ns.
    const BLOCK_NS: u64 = 5_000_000;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn offset_and_drift_of_a_device_are_found(
            offset_ns in -1_000_000_000_000_i64..1_000_000_000_000,
            drift_ppm in -200.0..200.0_f64,
            seed in any::<u64>(),
        ) {
            let mut clock = DeviceClock::default();
            let mut noise = seed | 1;
            let mut worst_ns = 0;
            for block in 0..12_000_u64 {
                let captured_ns = 2_000_000_000_000 + block * BLOCK_NS;
                let elapsed_ns = (block * BLOCK_NS) as f64 * (1.0 + drift_ppm * 1e-6);
                let device_ns = (2_000_000_000_000 + offset_ns) as u64 + elapsed_ns as u64;
                // xorshift: delays up to 2 ms.
                noise ^= noise << 13;
                noise ^= noise >> 7;
                noise ^= noise << 17;
                let received_ns = captured_ns + noise % 2_000_000;
                let mapped_ns = clock.captured_ns(device_ns, received_ns);
                prop_assert!(mapped_ns <= received_ns);
                if block > 6_000 {
                    worst_ns = worst_ns.max(mapped_ns.abs_diff(captured_ns));
                }
            }
            prop_assert!(worst_ns < 100_000, "captured is {worst_ns} ns off");
            let found_ppm = clock.drift_ppm().unwrap();
            prop_assert!((found_ppm - drift_ppm).abs() < 5.0, "{found_ppm} instead of {drift_ppm} ppm");
        }
    }

    #[test]
    fn the_first_block_counts_as_captured_when_received_and_no_drift_is_known() {
        let mut clock = DeviceClock::default();
        assert_eq!(clock.captured_ns(17, 1_000), 1_000);
        assert_eq!(clock.drift_ppm(), None);
    }

    /// Ten seconds of blocks that come 1 ms after their capture; gives the device time and the time here of the last one.
    fn ten_seconds(clock: &mut DeviceClock) -> (u64, u64) {
        let times = |block: u64| (block * BLOCK_NS, 50_000_000_000 + block * BLOCK_NS);
        for block in 0..2000 {
            let (device_ns, received_ns) = times(block);
            assert_eq!(clock.captured_ns(device_ns, received_ns), received_ns);
        }
        times(1999)
    }

    /// What is said of a minute of a device that counts at this share of its rate, each block this late: of its number.
    fn rate_found(share: f64, late_ns: impl Fn(u64) -> u64) -> Option<f64> {
        let mut clock = DeviceClock::default();
        let found = (0..12_000_u64).filter_map(|block| {
            let captured_ns = 1_000_000_000 + block * BLOCK_NS;
            clock.captured_ns(((block * BLOCK_NS) as f64 * share) as u64, captured_ns + late_ns(block));
            clock.other_rate()
        });
        found.last()
    }

    #[test]
    fn another_rate_is_found_and_neither_drift_nor_delays_are_one() {
        let jitter = |block: u64| (block * 7919 % 100) * 100_000;
        for share in [0.99, 0.995, 0.998, 1.002, 1.005, 1.01] {
            let found = rate_found(share, jitter).unwrap();
            assert!((found - share).abs() < 2e-4, "{found} instead of {share}");
        }
        for share in [0.9995, 1.0, 1.0005] {
            assert_eq!(rate_found(share, jitter), None, "{share}");
        }
        // The network is busy for 5 s in every 15 s, or from the middle on.
        assert_eq!(rate_found(1.0, |block| if block % 3000 < 1000 { 80_000_000 } else { 0 }), None);
        assert_eq!(rate_found(1.0, |block| if block > 6000 { 500_000_000 } else { 0 }), None);
    }

    #[test]
    fn a_device_time_that_leaps_is_not_learnt_from() {
        let mut clock = DeviceClock::default();
        let (device_ns, received_ns) = ten_seconds(&mut clock);
        for leap_ns in [1_500_000_000, 1 << 62, u64::MAX - device_ns] {
            assert_eq!(clock.captured_ns(device_ns + leap_ns, received_ns), received_ns);
        }
        let captured_ns = clock.captured_ns(device_ns + BLOCK_NS, received_ns + 150_000_000);
        assert_eq!(captured_ns, received_ns + BLOCK_NS, "what is late stays late");
    }

    #[test]
    fn a_device_time_that_leapt_for_good_begins_a_new_line() {
        let mut clock = DeviceClock::default();
        let (device_ns, received_ns) = ten_seconds(&mut clock);
        let leapt =
            |block: u64| (device_ns + 1_500_000_000 + block * BLOCK_NS, received_ns + block * BLOCK_NS);
        for block in 1..2000 {
            let (device_ns, received_ns) = leapt(block);
            assert_eq!(clock.captured_ns(device_ns, received_ns), received_ns, "block {block}");
        }
        let (device_ns, received_ns) = leapt(2000);
        assert_eq!(clock.captured_ns(device_ns, received_ns + 150_000_000), received_ns);
        assert!(clock.drift_ppm().unwrap().abs() < 1.0);
    }

    #[test]
    fn what_is_late_stays_late_however_long_it_lasts() {
        let mut clock = DeviceClock::default();
        let (device_ns, received_ns) = ten_seconds(&mut clock);
        for block in 1..20_000 {
            let late_ns = received_ns + block * BLOCK_NS + 300_000_000;
            let captured_ns = clock.captured_ns(device_ns + block * BLOCK_NS, late_ns);
            assert!(late_ns - captured_ns > 100_000_000, "block {block}");
        }
    }

    proptest! {
        #[test]
        fn any_times_at_all_give_captures_that_are_not_in_the_future(
            times in prop::collection::vec((any::<u64>(), any::<u64>(), 0..64_u32, 0..64_u32), 1..200),
        ) {
            let mut clock = DeviceClock::default();
            for (device_ns, received_ns, device_bits, received_bits) in times {
                let received_ns = received_ns >> received_bits;
                prop_assert!(clock.captured_ns(device_ns >> device_bits, received_ns) <= received_ns);
                prop_assert!(clock.drift_ppm().is_none_or(|drift| drift.abs() <= 1000.0));
            }
        }
    }
}
