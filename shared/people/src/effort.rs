//! How hard a gesture is made: the amplitude between the person's rest and a comfortable contraction.
//!
//! ```text
//! level of a window for a gesture = weighted mean of the channels' RMS
//!                                   a channel counts the more, the more the gesture raises it above rest
//!
//! level    rest ──────────────── comfortable
//! effort   0 ─────────────────── 1
//! ```
//!
//! Each gesture has weights of its own: the muscles that make it tell how hard it is made. Levels are in the unit of the
//! samples, efforts have none.

use serde::{Deserialize, Serialize};

use crate::person::LARGEST_VALUE;

/// Share of the windows of rest whose level is no effort.
const REST_SHARE: f64 = 0.95;
/// Share of the windows of a gesture that are weaker than its comfortable contraction, which is effort 1. Of a contraction
/// from light to firm and back, it is the one in the middle.
const COMFORTABLE_SHARE: f64 = 0.5;
/// A comfortable contraction that is less than so many times as strong as rest says nothing of effort.
const SMALLEST_RATIO: f64 = 1.3;

/// From which level to which a gesture goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffortRange {
    /// How much each channel counts; the sum is 1.
    pub channel_weights: Vec<f64>,
    /// Level of effort 0.
    pub rest: f64,
    /// Level of effort 1.
    pub comfortable: f64,
}

impl EffortRange {
    /// The range of a gesture from the RMS of every channel (windows x channels) at rest and in the gesture.
    pub(crate) fn of(rest: &[Vec<f64>], gesture: &[Vec<f64>]) -> EffortRange {
        let channels = rest.first().map_or(0, Vec::len);
        let median = |windows: &[Vec<f64>], channel: usize| {
            quantile(&windows.iter().map(|rms| rms[channel]).collect::<Vec<f64>>(), 0.5)
        };
        let raised: Vec<f64> = (0..channels)
            .map(|channel| (median(gesture, channel) - median(rest, channel)).max(0.0))
            .collect();
        let sum: f64 = raised.iter().sum();
        let channel_weights: Vec<f64> = match sum > 0.0 {
            true => raised.iter().map(|raised| raised / sum).collect(),
            // It is as weak as rest on all channels: none tells more than the others.
            false => vec![1.0 / channels.max(1) as f64; channels],
        };
        let range = EffortRange { channel_weights, rest: 0.0, comfortable: 0.0 };
        let levels = |windows: &[Vec<f64>]| windows.iter().map(|rms| range.level(rms)).collect::<Vec<f64>>();
        let resting = quantile(&levels(rest), REST_SHARE);
        let comfortable = quantile(&levels(gesture), COMFORTABLE_SHARE);
        EffortRange { rest: resting, comfortable, ..range }
    }

    /// Whether the gesture is so much stronger than rest that its strength says something.
    pub fn is_usable(&self) -> bool {
        self.comfortable >= SMALLEST_RATIO * self.rest && self.comfortable > self.rest
    }

    /// The effort of a window with this RMS of every channel, from 0 to 1; 1 if the range is not usable.
    pub fn effort(&self, rms: &[f64]) -> f64 {
        if !self.is_usable() {
            return 1.0;
        }
        ((self.level(rms) - self.rest) / (self.comfortable - self.rest)).clamp(0.0, 1.0)
    }

    fn level(&self, rms: &[f64]) -> f64 {
        self.channel_weights.iter().zip(rms).map(|(weight, rms)| weight * rms).sum()
    }

    pub(crate) fn is_valid(&self, channels: usize) -> bool {
        self.channel_weights.len() == channels
            && self.channel_weights.iter().all(|weight| (0.0..=1.0).contains(weight))
            && (0.0..=LARGEST_VALUE).contains(&self.rest)
            && (0.0..=LARGEST_VALUE).contains(&self.comfortable)
    }
}

/// Root mean square of every channel of a window, channel-major.
pub(crate) fn rms_of_channels(window: &[f32], channels: usize) -> impl Iterator<Item = f64> + '_ {
    window.chunks_exact((window.len() / channels.max(1)).max(1)).map(rms)
}

/// Root mean square of samples.
pub(crate) fn rms(samples: &[f32]) -> f64 {
    let sum: f64 = samples.iter().map(|&sample| f64::from(sample) * f64::from(sample)).sum();
    (sum / samples.len().max(1) as f64).sqrt()
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

    /// Windows of three channels, of which the gesture raises the first two.
    fn ramp() -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
        let rest = (0..=100).map(|window| vec![1.0 + 0.002 * f64::from(window), 1.0, 5.0]).collect();
        let gesture =
            (0..=100).map(|window| vec![1.1 + 0.06 * f64::from(window), 1.0 + 0.02 * f64::from(window), 5.0]);
        (rest, gesture.collect())
    }

    #[test]
    fn a_gesture_is_measured_on_the_channels_that_it_raises() {
        let (rest, gesture) = ramp();
        let range = EffortRange::of(&rest, &gesture);
        // The medians rise from 1.1 to 4.1, from 1 to 2, and not at all.
        assert!(
            (range.channel_weights[0] - 0.75).abs() < 1e-12 && range.channel_weights[2] == 0.0,
            "{range:?}"
        );
        assert!((range.rest - (0.75 * 1.19 + 0.25)).abs() < 1e-12, "{range:?}");
        assert!((range.comfortable - (0.75 * 4.1 + 0.25 * 2.0)).abs() < 1e-12, "{range:?}");
        assert_eq!([[1.0, 1.0, 90.0], [9.0, 9.0, 0.0]].map(|rms| range.effort(&rms)), [0.0, 1.0]);
        let middle = range.effort(&[0.5 * (1.19 + 4.1), 1.5, 5.0]);
        assert!((middle - 0.5).abs() < 0.01, "{middle}");
        assert!(range.is_valid(3) && !range.is_valid(2));
    }

    #[test]
    fn the_effort_of_a_gesture_as_weak_as_rest_says_nothing() {
        let (rest, _) = ramp();
        let range = EffortRange::of(&rest, &rest);
        assert!(range.is_valid(3), "{range:?}");
        assert!(!range.is_usable());
        assert_eq!(range.effort(&rest[0]), 1.0);
    }

    #[test]
    fn every_channel_has_its_rms() {
        let window = [2.0, -2.0, 30.0, -30.0, 0.0, 0.0];
        assert_eq!(rms_of_channels(&window, 3).collect::<Vec<f64>>(), [2.0, 30.0, 0.0]);
    }
}
