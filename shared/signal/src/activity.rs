//! Rest or movement: the paper's strategy (a), a threshold on the envelope, set by a calibration at rest.
//!
//! ```text
//! envelope ─▶ calibration: the first 5 s, at rest        threshold = median + k σ, σ = 1.4826 MAD
//!          └▶ detector:    Rest ──enough channels above for enter_ms──▶ Move
//!                               ◀──fewer above the release for leave_ms──
//! ```

use serde::{Deserialize, Serialize};

use crate::error::{DesignError, samples_of};

/// MAD of a normal distribution × this = its standard deviation: 1 / Φ⁻¹(3/4).
pub const SIGMA_PER_MAD: f32 = 1.4826;

/// An envelope that varies less than this, in whatever unit, comes from a channel without an electrode. Noise
/// in volts varies a thousand times more; what the filter's rounding leaves of a constant channel varies
/// less, even in 32-bit counts.
const STUCK_SIGMA: f32 = 1e-12;

/// What the user's muscles are doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Activity {
    /// The rest that sets the thresholds is still being measured: calibration.
    Calibrating = 0,
    /// No muscle is active.
    Rest = 1,
    /// A movement is being made or held.
    Move = 2,
}

/// When rest becomes movement and back.
///
/// The defaults come from the 3DC recordings (15 people, 118 repetitions of 55 s, 4 channels). The paper's
/// rule alone, any one channel above its threshold for 100 ms, gives 5 false starts per minute in the rests
/// of other repetitions than the one calibrated on, and classifies a fifth of that rest as movement. Two of
/// four channels for 200 ms give 0.7 false starts per minute (`tests/recordings.rs`), while 96.6 % of the
/// gesture samples from 1.2 s after the cue count as movement. The 200 ms add no delay that a user feels: the
/// first window that is all movement takes 300 ms. Releasing after 200 ms instead of 100 ms would raise the
/// 96.6 % to 98.4 %, but the noise at rest would then often hold the arm in motion for a second after the
/// muscles have let go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActivitySettings {
    /// How long the user rests at the start while the thresholds are measured, in s.
    pub calibration_s: f64,
    /// k: a channel's threshold is this many σ above its median at rest.
    pub threshold_sigma: f64,
    /// The movement lasts while the envelope stays this many σ above the median at rest. Less than
    /// `threshold_sigma`, so that a weakly held gesture is not interrupted.
    pub release_sigma: f64,
    /// Share of the channels, rounded up, on which the envelope must be above the threshold at the same time:
    /// above 0, at most 1. 0.4 means 2 of 4 channels and 4 of 10.
    pub channel_share: f64,
    /// How long this must last without a break until rest becomes movement, in ms.
    pub enter_ms: f64,
    /// How long fewer channels must be above without a break until movement becomes rest, in ms.
    pub leave_ms: f64,
}

impl Default for ActivitySettings {
    fn default() -> ActivitySettings {
        ActivitySettings {
            calibration_s: 5.0,
            threshold_sigma: 2.5,
            release_sigma: 1.5,
            channel_share: 0.4,
            enter_ms: 200.0,
            leave_ms: 100.0,
        }
    }
}

impl ActivitySettings {
    fn check(&self) -> Result<(), DesignError> {
        let ActivitySettings { threshold_sigma, release_sigma, channel_share, .. } = *self;
        if !(threshold_sigma.is_finite() && threshold_sigma > 0.0) {
            return Err(DesignError::Threshold {
                setting: "threshold_sigma",
                value: threshold_sigma,
                bounds: "above 0",
                example: 2.5,
            });
        }
        if !(release_sigma > 0.0 && release_sigma <= threshold_sigma) {
            return Err(DesignError::Threshold {
                setting: "release_sigma",
                value: release_sigma,
                bounds: "above 0 and at most threshold_sigma",
                example: 1.5,
            });
        }
        if !(channel_share > 0.0 && channel_share <= 1.0) {
            return Err(DesignError::Threshold {
                setting: "channel_share",
                value: channel_share,
                bounds: "above 0 and at most 1",
                example: 0.4,
            });
        }
        Ok(())
    }
}

/// The envelope of a channel at rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// Median of the envelope, in the samples' unit.
    pub median: f32,
    /// Robust standard deviation of the envelope, [`SIGMA_PER_MAD`] × median absolute deviation.
    pub sigma: f32,
}

impl Baseline {
    /// The baseline of `envelope`, whose order is lost. Zero for an empty one.
    pub fn of(envelope: &mut [f32]) -> Baseline {
        let median = take_median(envelope);
        for value in envelope.iter_mut() {
            *value = (*value - median).abs();
        }
        Baseline { median, sigma: SIGMA_PER_MAD * take_median(envelope) }
    }

    /// `median + k sigma` (the paper's equation 1). A channel whose envelope did not vary at all is stuck or
    /// has no electrode. Its threshold is infinite, so it never counts as active.
    pub fn threshold(&self, k: f32) -> f32 {
        if self.sigma > STUCK_SIGMA { self.median + k * self.sigma } else { f32::INFINITY }
    }
}

/// The median, like NumPy's: the mean of the two middle values of an even number.
fn take_median(values: &mut [f32]) -> f32 {
    let (middle, is_odd) = (values.len() / 2, values.len() % 2 == 1);
    if values.is_empty() {
        return 0.0;
    }
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    if is_odd {
        return upper;
    }
    let lower = below.iter().copied().max_by(f32::total_cmp).unwrap_or(upper);
    // Halved before the addition, to prevent overflow.
    lower / 2.0 + upper / 2.0
}

/// Calibrates on the first envelope samples, then tells rest from movement.
#[derive(Clone, Debug)]
pub struct ActivityDetector {
    threshold_sigma: f32,
    release_sigma: f32,
    /// Channels that must be above the threshold.
    needed_channels: usize,
    enter_samples: usize,
    leave_samples: usize,
    /// `[channels × calibration samples]`.
    calibration: Vec<f32>,
    calibration_samples: usize,
    calibrated_samples: usize,
    baselines: Vec<Baseline>,
    thresholds: Vec<f32>,
    releases: Vec<f32>,
    activity: Activity,
    /// For how many samples the envelope has been on the other side.
    run: usize,
}

impl ActivityDetector {
    /// Creates a detector for `channels` channels and allocates all its memory.
    ///
    /// # Errors
    /// The first setting that cannot work.
    pub fn new(
        settings: &ActivitySettings,
        channels: usize,
        sample_rate_hz: f64,
    ) -> Result<ActivityDetector, DesignError> {
        if channels == 0 {
            return Err(DesignError::NoChannels);
        }
        settings.check()?;
        let calibration_samples =
            samples_of("calibration_s", settings.calibration_s, 1.0, sample_rate_hz, 5.0)?;
        Ok(ActivityDetector {
            threshold_sigma: settings.threshold_sigma as f32,
            release_sigma: settings.release_sigma as f32,
            needed_channels: (settings.channel_share * channels as f64).ceil() as usize,
            enter_samples: samples_of("enter_ms", settings.enter_ms, 1e-3, sample_rate_hz, 200.0)?,
            leave_samples: samples_of("leave_ms", settings.leave_ms, 1e-3, sample_rate_hz, 200.0)?,
            calibration: vec![0.0; channels * calibration_samples],
            calibration_samples,
            calibrated_samples: 0,
            baselines: Vec::with_capacity(channels),
            thresholds: Vec::with_capacity(channels),
            releases: Vec::with_capacity(channels),
            activity: Activity::Calibrating,
            run: 0,
        })
    }

    /// The activity at the newest sample.
    pub fn activity(&self) -> Activity {
        self.activity
    }

    /// How many more samples the calibration needs; 0 once it is over.
    pub fn calibration_left_samples(&self) -> usize {
        self.calibration_samples - self.calibrated_samples
    }

    /// What calibration measured of each channel; `None` until it is over.
    pub fn baselines(&self) -> Option<&[Baseline]> {
        (self.activity != Activity::Calibrating).then_some(&self.baselines)
    }

    /// Returns to rest, for a gap in the signal. A calibration continues after the gap.
    pub fn restart(&mut self) {
        self.run = 0;
        if self.activity == Activity::Move {
            self.activity = Activity::Rest;
        }
    }

    /// Takes the envelope of every channel at one point in time.
    pub fn push(&mut self, envelope: &[f32]) -> Activity {
        match self.activity {
            Activity::Calibrating => self.calibrate(envelope),
            Activity::Rest => {
                let active = self.enough_channels_above(&self.thresholds, envelope);
                self.switch_after(active, self.enter_samples, Activity::Move);
            }
            Activity::Move => {
                let active = self.enough_channels_above(&self.releases, envelope);
                self.switch_after(!active, self.leave_samples, Activity::Rest);
            }
        }
        self.activity
    }

    fn enough_channels_above(&self, levels: &[f32], envelope: &[f32]) -> bool {
        let above = envelope.iter().zip(levels).filter(|(value, level)| value > level).count();
        above >= self.needed_channels
    }

    fn switch_after(&mut self, on_other_side: bool, samples: usize, other: Activity) {
        self.run = if on_other_side { self.run + 1 } else { 0 };
        if self.run >= samples {
            self.run = 0;
            self.activity = other;
        }
    }

    fn calibrate(&mut self, envelope: &[f32]) {
        let channels = self.calibration.chunks_exact_mut(self.calibration_samples);
        for (channel, &value) in channels.zip(envelope) {
            channel[self.calibrated_samples] = value;
        }
        self.calibrated_samples += 1;
        if self.calibrated_samples < self.calibration_samples {
            return;
        }
        for channel in self.calibration.chunks_exact_mut(self.calibration_samples) {
            let baseline = Baseline::of(channel);
            self.baselines.push(baseline);
            self.thresholds.push(baseline.threshold(self.threshold_sigma));
            self.releases.push(baseline.threshold(self.release_sigma));
        }
        self.activity = Activity::Rest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_those_of_numpy() {
        for (mut values, median, sigma) in [
            (vec![], 0.0, 0.0),
            (vec![3.0], 3.0, 0.0),
            (vec![4.0, 1.0, 3.0, 2.0], 2.5, 1.4826),
            (vec![9.0, 1.0, 2.0, 4.0, 100.0], 4.0, 1.4826 * 3.0),
        ] {
            assert_eq!(Baseline::of(&mut values), Baseline { median, sigma });
        }
    }

    /// 4 channels at 1000 Hz, calibrated on 2 and 4 in turn: median 3, σ 1.4826.
    fn calibrated() -> ActivityDetector {
        let settings = ActivitySettings { calibration_s: 0.01, ..ActivitySettings::default() };
        let mut detector = ActivityDetector::new(&settings, 4, 1000.0).expect("a detector");
        for sample in 0..10 {
            assert_eq!(detector.baselines(), None);
            detector.push(&[if sample % 2 == 0 { 2.0 } else { 4.0 }; 4]);
        }
        let rest = Baseline { median: 3.0, sigma: 1.4826 };
        assert_eq!(detector.baselines(), Some([rest; 4].as_slice()));
        detector
    }

    fn push(detector: &mut ActivityDetector, envelope: [f32; 4], samples: usize) -> Activity {
        (0..samples).fold(detector.activity(), |_, _| detector.push(&envelope))
    }

    /// Above 3 + 2.5 σ = 6.7065, between that and the release at 3 + 1.5 σ = 5.2239, and below.
    const ABOVE: f32 = 6.8;
    const BETWEEN: f32 = 5.3;
    const BELOW: f32 = 5.2;

    #[test]
    fn movement_takes_two_of_four_channels_for_all_of_the_time() {
        let mut detector = calibrated();
        assert_eq!(push(&mut detector, [ABOVE, BETWEEN, BETWEEN, BETWEEN], 1000), Activity::Rest);
        assert_eq!(push(&mut detector, [ABOVE, BELOW, ABOVE, BELOW], 199), Activity::Rest);
        assert_eq!(push(&mut detector, [BETWEEN; 4], 1), Activity::Rest);
        assert_eq!(push(&mut detector, [ABOVE, BELOW, ABOVE, BELOW], 199), Activity::Rest);
        // Not the same channels all the time, but enough of them.
        assert_eq!(push(&mut detector, [BELOW, ABOVE, BELOW, ABOVE], 1), Activity::Move);
    }

    #[test]
    fn movement_lasts_until_the_release_is_undercut_for_all_of_the_time() {
        let mut detector = calibrated();
        assert_eq!(push(&mut detector, [ABOVE; 4], 200), Activity::Move);
        assert_eq!(push(&mut detector, [BETWEEN, BETWEEN, BELOW, BELOW], 1000), Activity::Move);
        assert_eq!(push(&mut detector, [BETWEEN, BELOW, BELOW, BELOW], 99), Activity::Move);
        assert_eq!(push(&mut detector, [BETWEEN; 4], 1), Activity::Move);
        assert_eq!(push(&mut detector, [BETWEEN, BELOW, BELOW, BELOW], 99), Activity::Move);
        assert_eq!(push(&mut detector, [BETWEEN, BELOW, BELOW, BELOW], 1), Activity::Rest);
    }

    #[test]
    fn settings_that_cannot_work_are_refused() {
        let defaults = ActivitySettings::default();
        for (settings, key) in [
            (ActivitySettings { calibration_s: 0.0, ..defaults.clone() }, "calibration_s = 0"),
            (ActivitySettings { threshold_sigma: f64::NAN, ..defaults.clone() }, "threshold_sigma = NaN"),
            (ActivitySettings { release_sigma: 3.0, ..defaults.clone() }, "release_sigma = 3"),
            (ActivitySettings { channel_share: 0.0, ..defaults.clone() }, "channel_share = 0"),
            (ActivitySettings { enter_ms: f64::INFINITY, ..defaults.clone() }, "enter_ms = inf"),
            (ActivitySettings { leave_ms: -1.0, ..defaults }, "leave_ms = -1"),
        ] {
            let error = ActivityDetector::new(&settings, 4, 2000.0).expect_err("refused");
            assert!(error.to_string().starts_with(key), "{error}");
        }
    }
}
