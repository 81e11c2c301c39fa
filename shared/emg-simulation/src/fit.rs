//! A profile from recordings of a person.
//!
//! Every recording is cut into frames of 256 ms (Hann window, half overlapped, Welch 1967). Every frame has
//! the same weight, however strong it is: its spectrum is divided by its power before spectra are averaged,
//! and the power of the profile is the geometric mean of the frames' powers. A burst or a slipping electrode
//! then counts no more than any other frame. At each frequency of the profile the spectra are averaged with
//! weights that fall to zero at its neighbours (0 Hz before the first), the counterpart of the linear
//! interpolation with which they are used.

use std::collections::BTreeSet;

use tendon_gesture::Gesture;
use tendon_spectrum::{Complex, RealToComplex, plan_real_fft};

use crate::profile::{Coherency, GestureProfile, Profile, cholesky};

/// The frequencies of a fitted profile, up to half of the recordings' sampling rate.
const FREQUENCIES_HZ: [f64; 22] = [
    5.0, 15.0, 25.0, 35.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0, 140.0, 160.0, 180.0, 200.0, 230.0, 260.0,
    300.0, 340.0, 380.0, 420.0, 460.0, 500.0,
];

const FRAME_SECONDS: f64 = 0.256;

/// The power of a frame is measured from here up. Below are movements of the skin and the cables.
const LOWEST_HZ: f64 = 8.0;

/// A stretch of a recording during which one gesture is held, without the head in which it begins.
#[derive(Clone, Copy, Debug)]
pub struct Segment<'a> {
    /// The gesture.
    pub gesture: Gesture,
    /// Raw samples, channel-major `[channels][samples]`.
    pub samples: &'a [f32],
}

/// What [`fit()`] needs to know about the recordings.
#[derive(Clone, Debug)]
pub struct FitSettings {
    /// Whose recordings they are: [`Profile::source`].
    pub source: String,
    /// The unit of their samples: [`Profile::unit`].
    pub unit: String,
    /// Number of their channels.
    pub channels: usize,
    /// Their sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// The mains frequency where they were recorded, Hz. It and its harmonics do not come from muscles and
    /// are left out.
    pub mains_hz: f64,
}

/// Why no profile could be fitted.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The settings do not describe recordings.
    #[error(
        "fit: {channels} channels at {sample_rate_hz} Hz with {mains_hz} Hz mains: give at least one channel, at least \
         200 Hz, and a mains frequency from 40 to 70 Hz (50 or 60)"
    )]
    Settings {
        /// Channels given.
        channels: usize,
        /// Sample rate given.
        sample_rate_hz: f64,
        /// Mains frequency given.
        mains_hz: f64,
    },
    /// The number of values in a segment is not a multiple of the number of channels.
    #[error("fit, segment {segment} ({gesture}): {values} values do not divide among {channels} channels")]
    Channels {
        /// Index of the segment, from 0.
        segment: usize,
        /// Its gesture.
        gesture: Gesture,
        /// Its values.
        values: usize,
        /// Channels given.
        channels: usize,
    },
    /// A gesture has no frame in which every channel has a signal.
    #[error(
        "fit, gesture `{gesture}`: no segment has 256 ms of signal on all channels; add recordings of this gesture"
    )]
    NoSignal {
        /// The gesture.
        gesture: Gesture,
    },
}

/// Fits a profile from segments of gestures, rest among them. The same segments give the same profile.
///
/// # Errors
/// If a gesture is missing or a segment does not fit the settings.
pub fn fit(segments: &[Segment<'_>], settings: &FitSettings) -> Result<Profile, FitError> {
    let FitSettings { channels, sample_rate_hz, mains_hz, .. } = *settings;
    let is_valid = channels > 0
        && sample_rate_hz >= 200.0
        && sample_rate_hz.is_finite()
        && (40.0..=70.0).contains(&mains_hz);
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
    let made: BTreeSet<Gesture> = segments.iter().map(|segment| segment.gesture).collect();
    if !made.contains(&Gesture::REST) {
        return Err(FitError::NoSignal { gesture: Gesture::REST });
    }
    let gestures = made
        .into_iter()
        .map(|gesture| {
            let of_gesture = segments.iter().filter(|segment| segment.gesture == gesture);
            let mut spectra = Spectra::new(settings);
            of_gesture.for_each(|segment| spectra.add(segment.samples));
            spectra.finish(gesture, &frequencies_hz).ok_or(FitError::NoSignal { gesture })
        })
        .collect::<Result<_, _>>()?;
    let FitSettings { source, unit, .. } = settings.clone();
    Ok(Profile { source, unit, data_set: None, number: None, frequencies_hz, gestures })
}

/// Sums over the frames of one gesture.
struct Spectra {
    channels: usize,
    window: Vec<f64>,
    fft: std::sync::Arc<dyn RealToComplex<f64>>,
    bin_hz: f64,
    /// Bins that are not mains.
    usable_bins: Vec<usize>,
    frames: usize,
    /// Logarithm of the power of each channel, summed over frames.
    log_power: Vec<f64>,
    /// `X1 · conj(X2)` summed over frames, each spectrum divided by the root of its power: `[pairs][bins]`,
    /// pairs in the order of [`pairs`].
    cross: Vec<Vec<Complex<f64>>>,
}

/// Every pair of channels once, and every channel with itself.
fn pairs(channels: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..channels).flat_map(|second| (0..=second).map(move |first| [first, second]))
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
            // The Hann window spreads a line over two bins on either side.
            (hz - harmonic * settings.mains_hz).abs() < 2.0 * bin_hz
        };
        let channels = settings.channels;
        Spectra {
            channels,
            window,
            fft: plan_real_fft(frame),
            bin_hz,
            usable_bins: (0..=frame / 2).filter(|bin| !is_mains(*bin)).collect(),
            frames: 0,
            log_power: vec![0.0; channels],
            cross: pairs(channels).map(|_| vec![Complex::ZERO; frame / 2 + 1]).collect(),
        }
    }

    /// Adds the frames of one segment, except those in which a channel is flat.
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
        for (sum, power) in self.log_power.iter_mut().zip(power) {
            *sum += power.ln();
        }
        for ([first, second], cross) in pairs(self.channels).zip(&mut self.cross) {
            let scale = 1.0 / (power[first] * power[second]).sqrt();
            for ((sum, first), second) in cross.iter_mut().zip(&spectra[first]).zip(&spectra[second]) {
                *sum += first * second.conj() * scale;
            }
        }
    }

    /// Scaled so that the sum of its squared magnitudes is the mean square of the frame.
    fn spectrum(&self, frame: &[f32]) -> Vec<Complex<f64>> {
        let mean = frame.iter().map(|value| f64::from(*value)).sum::<f64>() / frame.len() as f64;
        let mut input: Vec<f64> = frame
            .iter()
            .zip(&self.window)
            .map(|(value, weight)| (f64::from(*value) - mean) * weight)
            .collect();
        let mut output = self.fft.make_output_vec();
        self.fft.process(&mut input, &mut output).expect("both buffers have the length of the plan");
        let weights: f64 = self.window.iter().map(|weight| weight * weight).sum();
        let scale = (2.0 / (weights * frame.len() as f64)).sqrt();
        output.iter_mut().for_each(|value| *value *= scale);
        output
    }

    fn power(&self, spectrum: &[Complex<f64>]) -> f64 {
        let muscle_bins = self.usable_bins.iter().filter(|bin| **bin as f64 * self.bin_hz >= LOWEST_HZ);
        muscle_bins.map(|bin| spectrum[*bin].norm_sqr()).sum()
    }

    /// `None` if no frame was added.
    fn finish(self, gesture: Gesture, frequencies_hz: &[f64]) -> Option<GestureProfile> {
        if self.frames == 0 {
            return None;
        }
        let means: Vec<Vec<Complex<f64>>> = self
            .cross
            .iter()
            .map(|cross| {
                (0..frequencies_hz.len()).map(|at| self.mean_near(cross, frequencies_hz, at)).collect()
            })
            .collect();
        let pair_index = |first: usize, second: usize| second * (second + 1) / 2 + first;
        let own = |channel: usize| &means[pair_index(channel, channel)];
        let amplitude_density = (0..self.channels)
            .map(|channel| {
                let power = (self.log_power[channel] / self.frames as f64).exp();
                own(channel).iter().map(|shape| round((shape.re * power / self.bin_hz).sqrt())).collect()
            })
            .collect();
        let coherency = pairs(self.channels)
            .filter(|[first, second]| first != second)
            .map(|[first, second]| {
                let values: Vec<Complex<f64>> = means[pair_index(first, second)]
                    .iter()
                    .zip(own(first).iter().zip(own(second)))
                    .map(|(together, (first, second))| together / (first.re * second.re).sqrt())
                    .collect();
                Coherency {
                    channels: [first, second],
                    real: values.iter().map(|value| round(value.re)).collect(),
                    imaginary: values.iter().map(|value| round(value.im)).collect(),
                }
            })
            .collect();
        let mut entry = GestureProfile { gesture, amplitude_density, coherency };
        for frequency in 0..frequencies_hz.len() {
            weaken_until_possible(&mut entry, frequency);
        }
        Some(entry)
    }

    /// The mean per frame around one of the profile's frequencies, over the bins that are not mains.
    fn mean_near(&self, cross: &[Complex<f64>], frequencies_hz: &[f64], at: usize) -> Complex<f64> {
        let middle_hz = frequencies_hz[at];
        let previous_hz = if at == 0 { 0.0 } else { frequencies_hz[at - 1] };
        let below_hz = middle_hz - previous_hz;
        let above_hz = frequencies_hz.get(at + 1).map_or(below_hz, |next| next - middle_hz);
        let mut sum = Complex::ZERO;
        let mut weights = 0.0;
        for bin in &self.usable_bins {
            let distance_hz = *bin as f64 * self.bin_hz - middle_hz;
            let reach_hz = if distance_hz < 0.0 { below_hz } else { above_hz };
            let weight = (1.0 - distance_hz.abs() / reach_hz).max(0.0);
            sum += cross[*bin] * weight;
            weights += weight;
        }
        // Every reach is wider than a line of the mains, so some bin is left.
        sum / (weights * self.frames as f64)
    }
}

/// Estimates from few frames, and rounding, can give coherencies that slightly contradict each other.
/// Slightly weaker ones do not.
fn weaken_until_possible(entry: &mut GestureProfile, frequency: usize) {
    while cholesky(&entry.coherency_matrix(frequency)).is_none() {
        for coherency in &mut entry.coherency {
            for part in [&mut coherency.real[frequency], &mut coherency.imaginary[frequency]] {
                *part = round(*part * 0.98);
            }
        }
    }
}

/// To three decimals: no recording supports more, and the file stays small.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::performance::{ContractionSettings, Performance};
    use crate::simulator::{SimulatedEmg, SimulationSettings};

    fn settings() -> FitSettings {
        FitSettings {
            source: "a test".into(),
            unit: "adc_counts".into(),
            channels: 4,
            sample_rate_hz: 2000.0,
            mains_hz: 60.0,
        }
    }

    /// A minute of each gesture as the default profile makes it, mains hum included.
    fn recordings() -> Vec<(Gesture, Vec<f32>)> {
        let simulation = SimulationSettings::default();
        let mut emg = SimulatedEmg::new(&Profile::default(), &simulation).expect("settings are in range");
        let contraction = ContractionSettings { rise_ms: 0.0, fall_ms: 0.0 };
        let mut performance = Performance::at_rest(emg.gestures(), contraction, simulation.sample_rate_hz);
        let record = |gesture| {
            performance.set_gesture(gesture, 1.0);
            let mut samples = vec![0.0; 4 * 120_000];
            emg.fill_block(&mut performance, &mut samples);
            (gesture, samples)
        };
        Gesture::PAPER.map(record).to_vec()
    }

    #[test]
    fn what_a_profile_makes_is_fitted_by_that_profile() {
        let recordings = recordings();
        let segments: Vec<Segment<'_>> =
            recordings.iter().map(|(gesture, samples)| Segment { gesture: *gesture, samples }).collect();
        let wanted = Profile::default();
        let fitted = fit(&segments, &settings()).expect("all gestures are there");
        fitted.check().expect("a fitted profile has no faults");
        assert_eq!(fitted.frequencies_hz, wanted.frequencies_hz);
        // 60 to 230 Hz, where most of the power is. The 30 Hz that filters resolve show below and above.
        let compared = 5..15;
        for (fitted, wanted) in fitted.gestures.iter().zip(&wanted.gestures) {
            assert_eq!(fitted.gesture, wanted.gesture);
            for channel in 0..4 {
                for at in compared.clone() {
                    let ratio = fitted.amplitude_density[channel][at] / wanted.amplitude_density[channel][at];
                    let place = format!("{}, channel {channel}, {} Hz", wanted.gesture, FREQUENCIES_HZ[at]);
                    assert!((0.85..1.15).contains(&ratio), "{place}: {ratio}");
                }
            }
            for (fitted, wanted) in fitted.coherency.iter().zip(&wanted.coherency) {
                assert_eq!(fitted.channels, wanted.channels);
                for at in compared.clone() {
                    let real = fitted.real[at] - wanted.real[at];
                    let imaginary = fitted.imaginary[at] - wanted.imaginary[at];
                    assert!(real.hypot(imaginary) < 0.15, "{:?}, {} Hz", wanted.channels, FREQUENCIES_HZ[at]);
                }
            }
        }
    }

    /// Made by `tests/golden/make_fit.py`.
    #[derive(serde::Deserialize)]
    struct Golden {
        samples: [Vec<f32>; 2],
        amplitude_density: [Vec<f64>; 2],
        coherency_real: Vec<f64>,
        coherency_imaginary: Vec<f64>,
    }

    #[test]
    fn the_fit_is_that_of_numpy() {
        let golden: Golden = serde_json::from_str(include_str!("../tests/golden/fit.json")).expect("JSON");
        let samples = golden.samples.concat();
        let segments = Gesture::PAPER.map(|gesture| Segment { gesture, samples: &samples });
        let settings = FitSettings { channels: 2, sample_rate_hz: 1000.0, ..settings() };
        let profile = fit(&segments, &settings).expect("all gestures are there");
        let entry = &profile.gestures[2];
        let fitted = entry.amplitude_density.iter().flatten().chain(&entry.coherency[0].real);
        let fitted: Vec<f64> = fitted.chain(&entry.coherency[0].imaginary).copied().collect();
        let wanted = golden.amplitude_density.concat().into_iter().chain(golden.coherency_real);
        let wanted: Vec<f64> = wanted.chain(golden.coherency_imaginary).collect();
        assert_eq!(fitted.len(), wanted.len());
        for (fitted, wanted) in fitted.iter().zip(&wanted) {
            // A profile is rounded to 0.001.
            assert!((fitted - wanted).abs() < 0.000_51, "{fitted} for {wanted}");
        }
    }

    #[test]
    fn identical_channels_give_a_profile_that_can_be_simulated() {
        let recordings = recordings();
        let doubled: Vec<(Gesture, Vec<f32>)> = recordings
            .iter()
            .map(|(gesture, samples)| (*gesture, [&samples[..4000], &samples[..4000]].concat()))
            .collect();
        let segments: Vec<Segment<'_>> =
            doubled.iter().map(|(gesture, samples)| Segment { gesture: *gesture, samples }).collect();
        let profile =
            fit(&segments, &FitSettings { channels: 2, ..settings() }).expect("all gestures are there");
        assert_eq!(profile.check(), Ok(()));
        assert!(profile.gestures[0].coherency[0].real.iter().all(|real| *real > 0.9));
    }

    #[test]
    fn faults_are_named() {
        let flat = vec![0.0; 4000];
        let segments = Gesture::PAPER.map(|gesture| Segment { gesture, samples: &flat });
        assert_eq!(fit(&segments, &settings()), Err(FitError::NoSignal { gesture: Gesture::REST }));
        let odd = Segment { gesture: Gesture::GRIP, samples: &flat[..7] };
        assert_eq!(
            fit(&[odd], &settings()),
            Err(FitError::Channels { segment: 0, gesture: Gesture::GRIP, values: 7, channels: 4 })
        );
        let settings = FitSettings { mains_hz: 0.0, ..settings() };
        assert!(matches!(fit(&[], &settings), Err(FitError::Settings { .. })));
    }
}
