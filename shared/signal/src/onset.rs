//! Where the movement starts in a recording that begins at rest: the paper's baseline method (section
//! "Onset Detection"), offline.

use serde::{Deserialize, Serialize};

use crate::activity::Baseline;
use crate::envelope::{DEFAULT_ENVELOPE_MS, Envelope};
use crate::error::{DesignError, samples_of};

/// The paper's parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OnsetSettings {
    /// Length of the moving RMS, in ms.
    pub envelope_ms: f64,
    /// How much of the recording's start is rest, in ms.
    pub baseline_ms: f64,
    /// k: how many σ above the median of rest the threshold lies.
    pub threshold_sigma: f64,
    /// From where to where an onset is searched, in ms.
    pub search_ms: [f64; 2],
    /// How long the envelope has to stay above the threshold, inside the searched part, in ms.
    pub duration_ms: f64,
    /// How much before the onset to keep, in ms.
    pub margin_ms: f64,
}

impl Default for OnsetSettings {
    fn default() -> OnsetSettings {
        OnsetSettings {
            envelope_ms: DEFAULT_ENVELOPE_MS,
            baseline_ms: 500.0,
            threshold_sigma: 2.5,
            search_ms: [100.0, 1000.0],
            duration_ms: 20.0,
            margin_ms: 50.0,
        }
    }
}

/// The sample from which the recording shows the movement, margin included: everything before is rest.
/// `None` if no onset is found; the paper then cuts at a fixed point.
///
/// `signal` is filtered, `[channels × samples]`. The most active channel, the one with the highest mean
/// envelope, decides for all.
///
/// # Errors
/// No channels, or a duration of less than a sample.
///
/// # Panics
/// If `signal` is not a whole number of samples for every channel.
pub fn find_onset(
    settings: &OnsetSettings,
    signal: &[f32],
    channels: usize,
    sample_rate_hz: f64,
) -> Result<Option<usize>, DesignError> {
    if channels == 0 {
        return Err(DesignError::NoChannels);
    }
    assert!(signal.len().is_multiple_of(channels), "a recording is channels × samples");
    let samples_in =
        |setting, value_ms, example| samples_of(setting, value_ms, 1e-3, sample_rate_hz, example);
    let baseline_samples = samples_in("baseline_ms", settings.baseline_ms, 500.0)?;
    let search_start = samples_in("search_ms", settings.search_ms[0], 100.0)?;
    let search_end = samples_in("search_ms", settings.search_ms[1], 1000.0)?;
    let duration = samples_in("duration_ms", settings.duration_ms, 20.0)?;
    let margin = samples_in("margin_ms", settings.margin_ms, 50.0)?;

    let samples = signal.len() / channels;
    if samples == 0 {
        return Ok(None);
    }
    let mut most_active = Vec::new();
    let mut highest_sum = -1.0;
    for channel in signal.chunks_exact(samples) {
        let mut tracker = Envelope::new(settings.envelope_ms, sample_rate_hz)?;
        let envelope: Vec<f32> = channel.iter().map(|&sample| tracker.push(sample)).collect();
        let sum: f64 = envelope.iter().map(|&value| f64::from(value)).sum();
        if sum > highest_sum {
            (most_active, highest_sum) = (envelope, sum);
        }
    }

    let mut rest = most_active[..baseline_samples.min(samples)].to_vec();
    let threshold = Baseline::of(&mut rest).threshold(settings.threshold_sigma as f32);
    let above: Vec<bool> = most_active.iter().map(|&value| value > threshold).collect();
    let searched = above.get(search_start..search_end.min(samples)).unwrap_or_default();
    let onset = searched.windows(duration).position(|run| run.iter().all(|&above| above));
    Ok(onset.map(|onset| (search_start + onset).saturating_sub(margin)))
}
