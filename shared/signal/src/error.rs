//! What can be wrong with the settings of the signal processing.

/// A setting from which no filter, envelope, detector or window can be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// The sampling rate is not a positive number.
    #[error("sample_rate_hz = {0}: give the positive rate at which the source samples, e.g. 2000")]
    SampleRate(f64),
    /// There is nothing to process.
    #[error("channels = 0: give the number of channels of the source, at least 1")]
    NoChannels,
    /// The notch is not between 0 Hz and half the sampling rate.
    #[error(
        "notch_hz = {frequency_hz} at {sample_rate_hz} Hz: give the mains frequency (50 or 60), above 0 and \
         below half the sampling rate, or \"off\""
    )]
    NotchFrequency {
        /// The setting.
        frequency_hz: f64,
        /// The sampling rate it has to fit.
        sample_rate_hz: f64,
    },
    /// The quality is not a positive number, or so low that the notch is wider than the whole band.
    #[error("notch_quality = {0}: give frequency / width of the notch, a number above 0.5, e.g. 30")]
    NotchQuality(f64),
    /// The edges of the band are not in order, or the lower one is not below half the sampling rate.
    #[error(
        "band_pass_hz = [{low_hz}, {high_hz}] at {sample_rate_hz} Hz: give two edges with \
         0 < low < high and low below half the sampling rate, e.g. [5, 500]"
    )]
    BandEdges {
        /// The lower edge.
        low_hz: f64,
        /// The upper edge.
        high_hz: f64,
        /// The sampling rate they have to fit.
        sample_rate_hz: f64,
    },
    /// The order of the band-pass is zero or needlessly high.
    #[error("band_pass_order = {0}: give an order from 1 to 12, e.g. 6")]
    BandOrder(usize),
    /// The percentile is not between 0 and 100.
    #[error("peak_percentile = {value}: give a percentile from 0 to 100, e.g. 80")]
    Percentile {
        /// What was given.
        value: f64,
    },
    /// A duration is shorter than a sample, or longer than a minute.
    #[error("{setting} = {value}: give a duration from one sample to a minute, e.g. {example}")]
    Duration {
        /// The key of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// A value that works.
        example: f64,
    },
    /// A threshold factor is not a usable number.
    #[error("{setting} = {value}: give a finite number {bounds}, e.g. {example}")]
    Threshold {
        /// The key of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// The range it must be in.
        bounds: &'static str,
        /// A value that works.
        example: f64,
    },
    /// A window or the increment has no samples.
    #[error("{setting} = 0: give a number of samples, e.g. {example}")]
    NoSamples {
        /// The key of the setting.
        setting: &'static str,
        /// A value that works.
        example: usize,
    },
    /// A resampling ratio with a zero in it.
    #[error("resampling {up}/{down}: give two whole numbers above 0, e.g. 2/1 from 1000 Hz to 2000 Hz")]
    Ratio {
        /// Output samples …
        up: usize,
        /// … for so many input samples.
        down: usize,
    },
}

/// Refuses a rate that is not a positive number.
pub(crate) fn check_sample_rate(sample_rate_hz: f64) -> Result<(), DesignError> {
    if sample_rate_hz.is_finite() && sample_rate_hz > 0.0 {
        Ok(())
    } else {
        Err(DesignError::SampleRate(sample_rate_hz))
    }
}

/// A duration as a number of samples, at least one. `setting` and `example` are for the message.
pub(crate) fn samples_of(
    setting: &'static str,
    value: f64,
    unit_s: f64,
    sample_rate_hz: f64,
    example: f64,
) -> Result<usize, DesignError> {
    check_sample_rate(sample_rate_hz)?;
    let samples = (value * unit_s * sample_rate_hz).round();
    // One minute limits what the process could allocate if the unit was mistaken.
    if samples >= 1.0 && samples <= 60.0 * sample_rate_hz {
        Ok(samples as usize)
    } else {
        Err(DesignError::Duration { setting, value, example })
    }
}
