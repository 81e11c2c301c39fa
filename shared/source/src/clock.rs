//! The clock of a device, mapped to CLOCK_MONOTONIC.
//!
//! ```text
//! received − device time     ·  ·   ·      ·  ·     each block comes some time after its capture, now more, now less;
//!                          ·   ·  · ·  · ·  ·  ·    the least of them lie on a line: offset and drift of the clock
//!                         ─────────────────────────
//! ```

use std::collections::VecDeque;

/// Time over which the least delay is looked for, ns of the device.
const INTERVAL_NS: u64 = 2_000_000_000;
/// Intervals that the line goes through.
const INTERVALS: usize = 15;

/// Maps the time of a device to CLOCK_MONOTONIC, whatever its offset and its (constant) drift, from the times at which
/// its blocks were received. A delay that all blocks have cannot be told from an offset.
#[derive(Clone, Debug, Default)]
pub struct DeviceClock {
    /// Of each completed interval, the point with the least difference.
    least: VecDeque<Point>,
    /// The same of the current interval.
    current: Option<Point>,
    current_began_ns: u64,
    /// Through `least`: difference at a device time, and its slope.
    line: Option<(Point, f64)>,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    device_ns: u64,
    /// Received minus device time.
    difference_ns: i64,
}

impl DeviceClock {
    /// Takes the device's time of a sample and when it was received (CLOCK_MONOTONIC), both in ns and not earlier
    /// than before, and returns when it was captured, CLOCK_MONOTONIC: never later than it was received.
    pub fn captured_ns(&mut self, device_ns: u64, received_ns: u64) -> u64 {
        let point = Point { device_ns, difference_ns: received_ns.wrapping_sub(device_ns) as i64 };
        if self.current.is_some() && device_ns.saturating_sub(self.current_began_ns) >= INTERVAL_NS {
            self.complete_interval();
        }
        let least = match self.current {
            None => {
                self.current_began_ns = device_ns;
                self.current.insert(point)
            }
            Some(ref mut least) => {
                // Along the line, so that drift within the interval does not favour one of its ends.
                let drift_ns =
                    self.line.map_or(0.0, |(_, slope)| slope * (device_ns - least.device_ns) as f64);
                if point.difference_ns < least.difference_ns + drift_ns as i64 {
                    *least = point;
                }
                least
            }
        };
        let expected_ns = match self.line {
            Some((from, slope)) => from.difference_ns + (slope * (device_ns - from.device_ns) as f64) as i64,
            None => least.difference_ns,
        };
        device_ns.wrapping_add(expected_ns.min(point.difference_ns) as u64)
    }

    /// How much faster than CLOCK_MONOTONIC the device counts, in parts per million; `None` until that is known.
    pub fn drift_ppm(&self) -> Option<f64> {
        self.line.filter(|_| self.least.len() > 1).map(|(_, slope)| -slope * 1e6)
    }

    /// Lays the line anew: least squares through the least of each interval, then down to the lowest of them.
    fn complete_interval(&mut self) {
        self.least.extend(self.current.take());
        if self.least.len() > INTERVALS {
            self.least.pop_front();
        }
        let Some(&origin) = self.least.back() else { return };
        let relative = |point: &Point| {
            let x = point.device_ns as f64 - origin.device_ns as f64;
            (x, (point.difference_ns - origin.difference_ns) as f64)
        };
        let count = self.least.len() as f64;
        let (sum_x, sum_y) =
            self.least.iter().map(relative).fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x, sum.1 + y));
        let (mean_x, mean_y) = (sum_x / count, sum_y / count);
        let (mut xx, mut xy) = (0.0, 0.0);
        for (x, y) in self.least.iter().map(relative) {
            xx += (x - mean_x) * (x - mean_x);
            xy += (x - mean_x) * (y - mean_y);
        }
        let slope = if xx > 0.0 { xy / xx } else { 0.0 };
        let lowest = self.least.iter().map(relative).map(|(x, y)| y - slope * x).fold(f64::MAX, f64::min);
        let at_origin = Point { difference_ns: origin.difference_ns + lowest as i64, ..origin };
        self.line = Some((at_origin, slope));
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
}
