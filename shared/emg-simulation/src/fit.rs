//! A profile from recordings of a person.
//!
//! Every recording is cut into frames of 256 ms (Hann window, half overlapped, Welch 1967). Each frame counts
//! alike, however strong it is: its spectrum is divided by its power before spectra are averaged, and the power
//! of the profile is the geometric mean of the frames' powers. A burst, or an electrode that slips, then
//! weighs no more than any other frame.

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use tendon_gesture::Gesture;

use crate::profile::{GestureProfile, Profile, cholesky};

/// The frequencies of a fitted profile, as far as half of the recordings' sample rate reaches.
const FREQUENCIES_HZ: [f64; 25] = [
    2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0, 200.0, 230.0,
    260.0, 300.0, 340.0, 380.0, 420.0, 460.0, 500.0,
];

const FRAME_SECONDS: f64 = 0.256;

/// The power of a frame, and the correlation of its channels, are taken from here up: below is movement.
const LOWEST_HZ: f64 = 8.0;

/// A stretch of a recording during which one gesture is held, without the head in which it begins.
#[derive(Clone, Copy, Debug)]
pub struct Segment<'a> {
    /// The gesture.
    pub gesture: Gesture,
    /// Raw samples, channel-major `[channels][samples]`.
    pub samples: &'a [f32],
}

/// What [`fit()`] must know of the recordings.
#[derive(Clone, Debug)]
pub struct FitSettings {
    /// Whose recordings they are: [`Profile::source`].
    pub source: String,
    /// The unit of their samples: [`Profile::unit`].
    pub unit: String,
    /// Their channels.
    pub channels: usize,
    /// Their samples a second.
    pub sample_rate_hz: f64,
    /// The mains frequency where they were made. It and its harmonics are no muscle: the spectrum is
    /// interpolated across them.
    pub mains_hz: f64,
}

/// Why no profile could be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The settings do not describe recordings.
    #[error("fit: {channels} channels at {sample_rate_hz} Hz with {mains_hz} Hz mains: give at least one channel, 200 Hz, and a positive mains frequency")]
    Settings {
        /// Channels given.
        channels: usize,
        /// Sample rate given.
        sample_rate_hz: f64,
        /// Mains frequency given.
        mains_hz: f64,
    },
    /// A segment's values do not divide among the channels.
    #[error("fit, segment {segment} ({gesture}): {values} values do not divide among {channels} channels")]
    Channels {
        /// Place of the segment, from 0.
        segment: usize,
        /// Its gesture.
        gesture: Gesture,
        /// Its values.
        values: usize,
        /// Channels given.
        channels: usize,
    },
    /// A gesture has no frame in which every channel has a signal.
    #[error("fit, gesture `{gesture}`: no segment has 256 ms of signal on all channels; add recordings of this gesture")]
    NoSignal {
        /// The gesture.
        gesture: Gesture,
    },
}

/// Fits a profile from segments of all six gestures. The same segments give the same profile.
///
/// # Errors
/// If a gesture is missing or a segment does not fit the settings.
pub fn fit(segments: &[Segment<'_>], settings: &FitSettings) -> Result<Profile, FitError> {
    let FitSettings { channels, sample_rate_hz, mains_hz, .. } = *settings;
    let is_valid = channels > 0 && sample_rate_hz >= 200.0 && sample_rate_hz.is_finite() && mains_hz > 0.0;
    if !is_valid {
        return Err(FitError::Settings { channels, sample_rate_hz, mains_hz });
    }
    for (segment, Segment { gesture, samples }) in segments.iter().enumerate() {
        if !samples.len().is_multiple_of(channels) {
            return Err(FitError::Channels { segment, gesture: *gesture, values: samples.len(), channels });
        }
    }
    let frequencies_hz: Vec<f64> =
        FREQUENCIES_HZ.into_iter().filter(|hz| *hz <= sample_rate_hz / 2.0).collect();
    let gestures = Gesture::ALL
        .into_iter()
        .map(|gesture| {
            let of_gesture = segments.iter().filter(|segment| segment.gesture == gesture);
            let mut spectra = Spectra::new(settings);
            of_gesture.for_each(|segment| spectra.add(segment.samples));
            spectra.finish(gesture, &frequencies_hz).ok_or(FitError::NoSignal { gesture })
        })
        .collect::<Result<_, _>>()?;
    Ok(Profile { source: settings.source.clone(), unit: settings.unit.clone(), frequencies_hz, gestures })
}

/// Sums over the frames of one gesture.
struct Spectra {
    channels: usize,
    sample_rate_hz: f64,
    window: Vec<f64>,
    fft: std::sync::Arc<dyn realfft::RealToComplex<f64>>,
    /// Bins that are neither movement nor mains.
    muscle_bins: Vec<usize>,
    /// Bins that are not mains.
    usable_bins: Vec<usize>,
    frames: usize,
    /// `[channels][bins]`, each frame divided by its power.
    shape: Vec<Vec<f64>>,
    log_power: Vec<f64>,
    /// `[channels][channels]`, each frame divided by its powers.
    cross: Vec<Vec<f64>>,
}

impl Spectra {
    fn new(settings: &FitSettings) -> Spectra {
        let frame = (FRAME_SECONDS * settings.sample_rate_hz / 2.0).round() as usize * 2;
        let window = (0..frame)
            .map(|sample| (std::f64::consts::PI * sample as f64 / frame as f64).sin().powi(2))
            .collect();
        let bin_hz = settings.sample_rate_hz / frame as f64;
        let is_mains = |bin: usize| {
            let hz = bin as f64 * bin_hz;
            let harmonic = (hz / settings.mains_hz).round().max(1.0);
            // The Hann window smears a line over the bins beside it.
            (hz - harmonic * settings.mains_hz).abs() < 1.1 * bin_hz
        };
        let usable_bins: Vec<usize> = (0..=frame / 2).filter(|bin| !is_mains(*bin)).collect();
        let muscle_bins =
            usable_bins.iter().copied().filter(|bin| *bin as f64 * bin_hz >= LOWEST_HZ).collect();
        let channels = settings.channels;
        Spectra {
            channels,
            sample_rate_hz: settings.sample_rate_hz,
            window,
            fft: RealFftPlanner::new().plan_fft_forward(frame),
            muscle_bins,
            usable_bins,
            frames: 0,
            shape: vec![vec![0.0; frame / 2 + 1]; channels],
            log_power: vec![0.0; channels],
            cross: vec![vec![0.0; channels]; channels],
        }
    }

    /// Adds the frames of one segment, but for those in which a channel is flat.
    fn add(&mut self, samples: &[f32]) {
        let frame = self.window.len();
        let length = samples.len() / self.channels;
        let mut start = 0;
        while start + frame <= length {
            let spectra: Vec<Vec<Complex<f64>>> = (0..self.channels)
                .map(|channel| self.spectrum(&samples[channel * length + start..][..frame]))
                .collect();
            let power: Vec<f64> = spectra.iter().map(|spectrum| self.power(spectrum)).collect();
            if power.iter().all(|power| *power > 0.0 && power.is_finite()) {
                self.add_frame(&spectra, &power);
            }
            start += frame / 2;
        }
    }

    fn add_frame(&mut self, spectra: &[Vec<Complex<f64>>], power: &[f64]) {
        self.frames += 1;
        for channel in 0..self.channels {
            self.log_power[channel] += power[channel].ln();
            for (sum, value) in self.shape[channel].iter_mut().zip(&spectra[channel]) {
                *sum += value.norm_sqr() / power[channel];
            }
            for other in 0..channel {
                let together: f64 = self
                    .muscle_bins
                    .iter()
                    .map(|bin| (spectra[channel][*bin] * spectra[other][*bin].conj()).re)
                    .sum();
                self.cross[channel][other] += together / (power[channel] * power[other]).sqrt();
            }
        }
    }

    /// Scaled so that the sum of its squared magnitudes is the mean square of the frame.
    fn spectrum(&self, frame: &[f32]) -> Vec<Complex<f64>> {
        let mean = frame.iter().map(|value| f64::from(*value)).sum::<f64>() / frame.len() as f64;
        let mut input: Vec<f64> =
            frame.iter().zip(&self.window).map(|(value, weight)| (f64::from(*value) - mean) * weight).collect();
        let mut output = self.fft.make_output_vec();
        self.fft.process(&mut input, &mut output).expect("both buffers have the length of the plan");
        let weights: f64 = self.window.iter().map(|weight| weight * weight).sum();
        let scale = (2.0 / (weights * frame.len() as f64)).sqrt();
        output.iter_mut().for_each(|value| *value *= scale);
        output
    }

    fn power(&self, spectrum: &[Complex<f64>]) -> f64 {
        self.muscle_bins.iter().map(|bin| spectrum[*bin].norm_sqr()).sum()
    }

    /// `None` if no frame was added.
    fn finish(self, gesture: Gesture, frequencies_hz: &[f64]) -> Option<GestureProfile> {
        if self.frames == 0 {
            return None;
        }
        let frames = self.frames as f64;
        let bin_hz = self.sample_rate_hz / self.window.len() as f64;
        let amplitude_density = (0..self.channels)
            .map(|channel| {
                let power = (self.log_power[channel] / frames).exp();
                let density = |bin: usize| (self.shape[channel][bin] / frames * power / bin_hz).sqrt();
                frequencies_hz.iter().map(|hz| round(interpolate(&self.usable_bins, hz / bin_hz, density))).collect()
            })
            .collect();
        Some(GestureProfile { gesture, amplitude_density, correlation: self.correlation() })
    }

    /// The correlation that white noise must have before it is shaped, so that the shaped channels are
    /// correlated as the recorded ones: shaping itself takes away where spectra differ.
    fn correlation(&self) -> Vec<Vec<f64>> {
        let mut correlation = vec![vec![1.0; self.channels]; self.channels];
        for channel in 0..self.channels {
            for other in 0..channel {
                let overlap: f64 = self
                    .muscle_bins
                    .iter()
                    .map(|bin| (self.shape[channel][*bin] * self.shape[other][*bin]).sqrt())
                    .sum();
                let value = round(self.cross[channel][other] / overlap);
                correlation[channel][other] = value;
                correlation[other][channel] = value;
            }
        }
        // Each entry is an estimate of its own, so that together they may be no correlation at all; weaker
        // ones always are.
        while cholesky(&correlation).is_none() {
            for row in 0..self.channels {
                for column in (0..self.channels).filter(|column| *column != row) {
                    correlation[row][column] = round(correlation[row][column] * 0.95);
                }
            }
        }
        correlation
    }
}

/// The value at a place between bins, linear between the nearest bins in `bins`, constant beyond them.
fn interpolate(bins: &[usize], place: f64, value: impl Fn(usize) -> f64) -> f64 {
    let above = bins.partition_point(|bin| (*bin as f64) < place);
    if above == 0 {
        return value(bins[0]);
    }
    if above == bins.len() {
        return value(bins[above - 1]);
    }
    let (low, high) = (bins[above - 1], bins[above]);
    let share = (place - low as f64) / (high - low) as f64;
    value(low) * (1.0 - share) + value(high) * share
}

/// To four decimals: no recording tells more, and the file stays readable.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}
