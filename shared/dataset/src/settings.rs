//! How windows are cut from recordings.

use serde::{Deserialize, Serialize};
use tendon_recordings::Channel;
use tendon_signal::{
    DesignError, EmgFilter, FilterSettings, OnsetSettings, WindowInput, WindowSettings, find_onset,
};

/// How windows are made. The defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatasetSettings {
    /// Which channels of the recordings, in order.
    pub channels: Vec<Channel>,
    /// Sampling rate of the recordings, in Hz, where they do not tell it.
    pub recording_rate_hz: Option<f64>,
    /// The column of tables that says what was done. Without it, a `labels.csv` must say it.
    pub label_column: Option<Channel>,
    /// Sampling rate of the windows, in Hz: the session's.
    pub sample_rate_hz: f64,
    /// The session's filter; `null` for recordings that are filtered already.
    pub filter: Option<FilterSettings>,
    /// What the windows hold.
    pub input: WindowInput,
    /// Length and distance of the windows.
    pub windows: WindowSettings,
    /// How the start of a movement is found.
    pub onset: OnsetSettings,
    /// Where a gesture is taken to begin if no onset is found, in ms from the cue; 0 keeps the whole recording.
    pub fallback_ms: f64,
    /// How much of the start of rest is left out, in ms: the movement before it dies away.
    pub rest_start_ms: f64,
}

impl Default for DatasetSettings {
    fn default() -> DatasetSettings {
        DatasetSettings {
            channels: [0, 3, 5, 8].map(Channel::Index).to_vec(),
            recording_rate_hz: None,
            label_column: None,
            sample_rate_hz: 2000.0,
            filter: Some(FilterSettings::default()),
            input: WindowInput::Raw,
            windows: WindowSettings::default(),
            onset: OnsetSettings::default(),
            fallback_ms: 500.0,
            rest_start_ms: 500.0,
        }
    }
}

impl DatasetSettings {
    /// What would otherwise only show at the first recording, as a reason to leave it out.
    ///
    /// # Errors
    /// The first setting that does not fit.
    pub(crate) fn check(&self) -> Result<(), DesignError> {
        let channels = self.channels.len();
        if let Some(filter) = &self.filter {
            EmgFilter::new(filter, channels, self.sample_rate_hz)?;
        }
        find_onset(&self.onset, &[], channels, self.sample_rate_hz)?;
        if let Some(rate_hz) =
            self.recording_rate_hz.filter(|rate_hz| !(rate_hz.is_finite() && *rate_hz > 0.0))
        {
            return Err(DesignError::SampleRate(rate_hz));
        }
        let WindowSettings { window_samples, increment_samples } = self.windows;
        for (setting, samples, example) in
            [("window_samples", window_samples, 600), ("increment_samples", increment_samples, 150)]
        {
            if samples == 0 {
                return Err(DesignError::NoSamples { setting, example });
            }
        }
        for (setting, value) in [("fallback_ms", self.fallback_ms), ("rest_start_ms", self.rest_start_ms)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(DesignError::Duration { setting, value, example: 500.0 });
            }
        }
        Ok(())
    }
}
