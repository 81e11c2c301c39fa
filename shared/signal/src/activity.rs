//! Rest or movement: the paper's strategy (a), a threshold on the envelope that a calibration at rest sets.
//!
//! ```text
//! envelope ─▶ calibration: the first 5 s, at rest        threshold = median + k σ, σ = 1.4826 MAD
//!          └▶ detector:    Rest ──above for enter_ms──▶ Move
//!                               ◀──below for leave_ms──
//! ```

use serde::{Deserialize, Serialize};

use crate::error::{DesignError, samples_of};

/// MAD of a normal distribution × this = its standard deviation: 1 / Φ⁻¹(3/4).
pub const SIGMA_PER_MAD: f32 = 1.4826;

/// What the user's muscles are doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Activity {
    /// The rest that sets the thresholds is still being measured.
    Calibrating = 0,
    /// No muscle is active.
    Rest = 1,
    /// A movement is made or held.
    Move = 2,
}

/// When rest becomes movement and back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActivitySettings {
    /// How long the user rests at the start so that the thresholds can be set, in s.
    pub calibration_s: f64,
    /// k: how many σ above the median of rest a channel's threshold lies.
    pub threshold_sigma: f64,
    /// How many σ above the median of rest the envelope has to stay for the movement to go on.
    pub release_sigma: f64,
    /// On how many channels at once the envelope has to be above the threshold.
    pub min_channels: usize,
    /// How long without a break until rest becomes movement, in ms.
    pub enter_ms: f64,
    /// How long the envelope has to be below without a break until movement becomes rest, in ms.
    pub leave_ms: f64,
}

impl Default for ActivitySettings {
    fn default() -> ActivitySettings {
        ActivitySettings {
            calibration_s: 5.0,
            threshold_sigma: 2.5,
            release_sigma: 2.5,
            min_channels: 1,
            enter_ms: 100.0,
            leave_ms: 200.0,
        }
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
    /// The baseline of `envelope`, which is left in disorder. Zero for an empty one.
    pub fn of(envelope: &mut [f32]) -> Baseline {
        let median = take_median(envelope);
        for value in envelope.iter_mut() {
            *value = (*value - median).abs();
        }
        Baseline { median, sigma: SIGMA_PER_MAD * take_median(envelope) }
    }

    /// `median + k sigma` (the paper's equation 1). A channel whose envelope did not vary at all has no
    /// electrode on it: its threshold is infinite, so that it never counts as active.
    pub fn threshold(&self, k: f32) -> f32 {
        if self.sigma > 0.0 { self.median + k * self.sigma } else { f32::INFINITY }
    }
}

/// The median, as NumPy's: the mean of the two in the middle of an even number.
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
    // Halved before they are added: no overflow.
    lower / 2.0 + upper / 2.0
}

/// Calibrates on the first envelope samples, then tells rest from movement.
#[derive(Clone, Debug)]
pub struct ActivityDetector {
    settings: ActivitySettings,
    channels: usize,
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
    /// A detector for `channels` channels, with all its memory.
    ///
    /// # Errors
    /// The first setting that does not fit.
    pub fn new(
        settings: &ActivitySettings,
        channels: usize,
        sample_rate_hz: f64,
    ) -> Result<ActivityDetector, DesignError> {
        if channels == 0 {
            return Err(DesignError::NoChannels);
        }
        let calibration_samples =
            samples_of("calibration_s", settings.calibration_s, 1.0, sample_rate_hz, 5.0)?;
        Ok(ActivityDetector {
            settings: settings.clone(),
            channels,
            enter_samples: samples_of("enter_ms", settings.enter_ms, 1e-3, sample_rate_hz, 100.0)?,
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

    /// What calibration found of each channel; `None` until it is over.
    pub fn baselines(&self) -> Option<&[Baseline]> {
        (self.activity != Activity::Calibrating).then_some(&self.baselines)
    }

    /// Back to rest, for where the signal has a gap. A calibration goes on with what comes after the gap.
    pub fn restart(&mut self) {
        self.run = 0;
        if self.activity == Activity::Move {
            self.activity = Activity::Rest;
        }
    }

    /// Takes one time's envelope of every channel.
    pub fn push(&mut self, envelope: &[f32]) -> Activity {
        debug_assert_eq!(envelope.len(), self.channels);
        match self.activity {
            Activity::Calibrating => self.calibrate(envelope),
            Activity::Rest => {
                let active = self.active_channels(envelope, &self.thresholds) >= self.settings.min_channels;
                self.switch_after(active, self.enter_samples, Activity::Move);
            }
            Activity::Move => {
                let active = self.active_channels(envelope, &self.releases) >= self.settings.min_channels;
                self.switch_after(!active, self.leave_samples, Activity::Rest);
            }
        }
        self.activity
    }

    fn active_channels(&self, envelope: &[f32], levels: &[f32]) -> usize {
        envelope.iter().zip(levels).filter(|(value, level)| value > level).count()
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
            self.thresholds.push(baseline.threshold(self.settings.threshold_sigma as f32));
            self.releases.push(baseline.threshold(self.settings.release_sigma as f32));
        }
        self.activity = Activity::Rest;
    }
}
