//! How hard a gesture is made: the amplitude between the person's rest and a comfortable contraction.
//!
//! ```text
//! level of a window = mean over channels of  RMS / RMS at rest             1 at rest
//!
//! level    rest ──────────────── comfortable
//! effort   0 ─────────────────── 1
//! ```
//!
//! In units of the person's rest, so that every channel counts the same and the unit does not matter.

use serde::{Deserialize, Serialize};

/// Share of the windows of rest whose level is no effort.
const REST_SHARE: f64 = 0.95;
/// Share of the windows of a gesture that are weaker than its comfortable contraction, which is effort 1.
const COMFORTABLE_SHARE: f64 = 0.6;
/// A comfortable contraction is at least so many times as strong as rest: a gesture that was hardly made must not make a
/// twitch full effort.
const SMALLEST_RATIO: f64 = 1.2;

/// From which level to which a gesture goes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffortRange {
    /// Level of effort 0.
    pub rest: f64,
    /// Level of effort 1.
    pub comfortable: f64,
}

impl EffortRange {
    /// The range of a gesture from the levels of its windows and of those of rest.
    pub(crate) fn of(rest_levels: &[f64], levels: &[f64]) -> EffortRange {
        let rest = quantile(rest_levels, REST_SHARE);
        EffortRange { rest, comfortable: quantile(levels, COMFORTABLE_SHARE).max(SMALLEST_RATIO * rest) }
    }

    /// The effort of a level, from 0 to 1.
    pub fn effort(&self, level: f64) -> f64 {
        ((level - self.rest) / (self.comfortable - self.rest)).clamp(0.0, 1.0)
    }

    pub(crate) fn is_valid(&self) -> bool {
        self.rest >= 0.0 && self.rest < self.comfortable && self.comfortable.is_finite()
    }
}

/// Root mean square of samples.
pub(crate) fn rms(samples: &[f32]) -> f64 {
    let sum: f64 = samples.iter().map(|&sample| f64::from(sample) * f64::from(sample)).sum();
    (sum / samples.len().max(1) as f64).sqrt()
}

/// The level of a window. A channel that is flat at rest does not count; 0 if all are.
pub(crate) fn level(window: &[f32], rest_rms: &[f64]) -> f64 {
    let samples = (window.len() / rest_rms.len().max(1)).max(1);
    let (mut sum, mut channels) = (0.0, 0);
    for (channel, rest) in window.chunks_exact(samples).zip(rest_rms) {
        if *rest > 0.0 {
            sum += rms(channel) / rest;
            channels += 1;
        }
    }
    if channels == 0 { 0.0 } else { sum / f64::from(channels) }
}

/// The value that a share of `values` lies below; 0 without values.
pub(crate) fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effort_goes_from_rest_to_a_comfortable_contraction() {
        let rest: Vec<f64> = (0..=100).map(|value| 0.9 + 0.002 * f64::from(value)).collect();
        let levels: Vec<f64> = (0..=100).map(|value| f64::from(value) / 10.0).collect();
        let range = EffortRange::of(&rest, &levels);
        assert!((range.rest - 1.09).abs() < 1e-12 && (range.comfortable - 6.0).abs() < 1e-12, "{range:?}");
        assert_eq!([0.0, 1.09, 6.0, 100.0].map(|level| range.effort(level)), [0.0, 0.0, 1.0, 1.0]);
        assert!((range.effort(0.5 * (1.09 + 6.0)) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_gesture_as_weak_as_rest_still_has_a_range() {
        let range = EffortRange::of(&[1.0; 10], &[1.0; 10]);
        assert!(range.is_valid());
        assert_eq!(range.effort(1.0), 0.0);
    }

    #[test]
    fn every_channel_counts_by_its_own_rest_and_a_flat_one_does_not() {
        let window = [2.0, -2.0, 30.0, -30.0, 5.0, 5.0];
        assert_eq!(level(&window, &[1.0, 10.0, 0.0]), 2.5);
        assert_eq!(level(&window, &[0.0; 3]), 0.0);
    }
}
