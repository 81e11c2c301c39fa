//! Finds where the movement starts in a recording that begins at rest, offline: the paper's two methods
//! (section "Onset Detection").
//!
//! ```text
//! most active channel's envelope   ____________╱‾╲╱‾‾╲___
//!                                  |baseline|      ▲ the threshold lies above the rest at the start (baseline),
//!                                      |~~search~~|  or at a percentile of the envelope's peaks
//! ```

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::activity::Baseline;
use crate::envelope::{DEFAULT_ENVELOPE_MS, Envelope};
use crate::error::{DesignError, samples_of};

/// Where the threshold comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum OnsetMethod {
    /// Median + k σ of the recording's start, σ = 1.4826 MAD: the paper's choice.
    Baseline,
    /// A percentile of the envelope's local maxima over the whole recording.
    PeakPercentile,
    /// None: no onset is looked for, and every movement begins at the fixed point.
    Fixed,
}

/// The paper's parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OnsetSettings {
    /// Where the threshold comes from.
    pub method: OnsetMethod,
    /// Length of the moving RMS, in ms.
    pub envelope_ms: f64,
    /// How much of the recording's start is rest, in ms.
    pub baseline_ms: f64,
    /// k: the threshold is this many σ above the median at rest.
    pub threshold_sigma: f64,
    /// Which percentile of the local maxima is the threshold; the paper tried 70 to 90.
    pub peak_percentile: f64,
    /// Interval in which an onset is searched, in ms.
    pub search_ms: [f64; 2],
    /// How long the envelope must stay above the threshold within that interval, in ms.
    pub duration_ms: f64,
    /// How much before the onset to keep, in ms.
    pub margin_ms: f64,
}

impl Default for OnsetSettings {
    fn default() -> OnsetSettings {
        OnsetSettings {
            method: OnsetMethod::Baseline,
            envelope_ms: DEFAULT_ENVELOPE_MS,
            baseline_ms: 500.0,
            threshold_sigma: 2.5,
            peak_percentile: 80.0,
            search_ms: [100.0, 1000.0],
            duration_ms: 20.0,
            margin_ms: 50.0,
        }
    }
}

/// Where a movement begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Onset {
    /// The first sample above the threshold that is followed by enough others above it.
    pub sample: usize,
    /// The first sample to keep: the onset minus the margin.
    pub start_sample: usize,
}

/// Finds where the movement begins in the recording. `None` if there is no onset; the paper then cuts at a
/// fixed point.
///
/// `signal` is filtered, `[channels × samples]`. The most active channel, the one with the highest mean
/// envelope, decides for all.
///
/// # Errors
/// No channels, a duration of less than a sample, or a percentile outside 0..=100.
///
/// # Panics
/// If the length of `signal` is not a multiple of the number of channels.
pub fn find_onset(
    settings: &OnsetSettings,
    signal: &[f32],
    channels: usize,
    sample_rate_hz: f64,
) -> Result<Option<Onset>, DesignError> {
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

    if !(0.0..=100.0).contains(&settings.peak_percentile) {
        return Err(DesignError::Percentile { value: settings.peak_percentile });
    }

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

    let threshold = match settings.method {
        OnsetMethod::Baseline => {
            let mut rest = most_active[..baseline_samples.min(samples)].to_vec();
            Baseline::of(&mut rest).threshold(settings.threshold_sigma as f32)
        }
        OnsetMethod::Fixed => f32::INFINITY,
        OnsetMethod::PeakPercentile => percentile(local_maxima(&most_active), settings.peak_percentile),
    };
    let above: Vec<bool> = most_active.iter().map(|&value| value > threshold).collect();
    let searched = above.get(search_start..search_end.min(samples)).unwrap_or_default();
    let onset = searched.windows(duration).position(|run| run.iter().all(|&above| above));
    Ok(onset.map(|onset| Onset {
        sample: search_start + onset,
        start_sample: (search_start + onset).saturating_sub(margin),
    }))
}

/// Values greater than both their neighbours.
fn local_maxima(envelope: &[f32]) -> Vec<f32> {
    let peaks = envelope.windows(3).filter(|three| three[1] > three[0] && three[1] > three[2]);
    peaks.map(|three| three[1]).collect()
}

/// A percentile, interpolated linearly between the two nearest values, like NumPy's; infinite for no values,
/// so that nothing exceeds it.
fn percentile(mut values: Vec<f32>, percent: f64) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return f32::INFINITY };
    let place = percent / 100.0 * last as f64;
    let (below, share) = (place.floor() as usize, place.fract());
    let (lower, upper) = (f64::from(values[below]), f64::from(values[(below + 1).min(last)]));
    (lower + (upper - lower) * share) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_of_peaks_by_hand() {
        let envelope = [0.0, 3.0, 1.0, 1.0, 5.0, 2.0, 4.0, 0.0];
        assert_eq!(local_maxima(&envelope), [3.0, 5.0, 4.0]);
        assert_eq!(percentile(local_maxima(&envelope), 50.0), 4.0);
        assert_eq!(percentile(local_maxima(&envelope), 75.0), 4.5);
        assert_eq!(percentile(local_maxima(&envelope), 100.0), 5.0);
        assert_eq!(percentile(Vec::new(), 80.0), f32::INFINITY);
    }
}
