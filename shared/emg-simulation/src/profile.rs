//! What one person's muscles look like at the electrodes: for every gesture, a spectrum per channel and the
//! coherency of every pair of channels. Nothing in a profile depends on a sampling rate.

use serde::{Deserialize, Serialize};
use tendon_gesture::{Gesture, GestureSet, InvalidGestureSet};
use tendon_spectrum::Complex;

/// A small file in the crate: `profiles/default.toml`.
const DEFAULT_PROFILE: &str = include_str!("../profiles/default.toml");

/// People whom the networks that come with Tendon were not trained on, by name.
const STRANGERS: [(&str, &str); 3] = [
    ("stranger-19", include_str!("../profiles/stranger-19.toml")),
    ("stranger-20", include_str!("../profiles/stranger-20.toml")),
    ("stranger-22", include_str!("../profiles/stranger-22.toml")),
];

/// The muscle signals of one person, rest included. Read from and written to TOML.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Whose recordings it was fitted to, for human readers.
    pub source: String,
    /// The unit of the samples, such as `adc_counts`.
    pub unit: String,
    /// The data set that these recordings are of, such as `3DC`; `None` for recordings of your own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data_set: Option<String>,
    /// Number of the person there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<u16>,
    /// The frequencies, ascending, at which spectra and coherencies are given. Between them both are
    /// interpolated linearly; below the first and above the last there is no signal.
    pub frequencies_hz: Vec<f64>,
    /// One entry per gesture, rest among them, in any order.
    pub gestures: Vec<GestureProfile>,
}

/// The signal while one gesture is held.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GestureProfile {
    /// The gesture.
    pub gesture: Gesture,
    /// `[channels][frequencies]`: square root of the one-sided power spectral density, in unit/√Hz.
    pub amplitude_density: Vec<Vec<f64>>,
    /// How the channels vary together: every pair of channels once.
    pub coherency: Vec<Coherency>,
}

/// The coherency of two channels, `S12 / √(S11 S22)` with `S12` the mean of `X1 · conj(X2)` over the spectra
/// `X` of many frames: its magnitude is the share of both signals with a common origin, its phase how far the
/// first channel leads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coherency {
    /// First and second channel, from 0, the lower one first.
    pub channels: [usize; 2],
    /// Real part at each frequency.
    pub real: Vec<f64>,
    /// Imaginary part at each frequency.
    pub imaginary: Vec<f64>,
}

/// What is wrong with a profile.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProfileError {
    /// The text is not TOML, lacks a key, or has an unknown one.
    #[error("profile: {0}")]
    Toml(toml::de::Error),
    /// Rest is missing, a gesture occurs more than once, or there are too few or too many.
    #[error("profile: {0}")]
    Gestures(InvalidGestureSet),
    /// The frequencies are not ascending, fewer than two, not finite, or negative.
    #[error("profile: frequencies_hz must be at least two, ascending and not negative")]
    Frequencies,
    /// A gesture's densities are not `[channels][frequencies]`, or not all finite and at least zero.
    #[error(
        "profile, gesture `{gesture}`: amplitude_density must be {channels} rows of {frequencies} finite numbers, \
         none negative"
    )]
    Density {
        /// The gesture.
        gesture: Gesture,
        /// Channels of the profile, those of its first gesture.
        channels: usize,
        /// Number of its frequencies.
        frequencies: usize,
    },
    /// The coherency of two channels is missing, given twice, or not as long as the frequencies.
    #[error(
        "profile, gesture `{gesture}`: give the coherency of channels {channels:?} once, with {frequencies} real and \
         {frequencies} imaginary parts"
    )]
    CoherencyShape {
        /// The gesture.
        gesture: Gesture,
        /// The two channels.
        channels: [usize; 2],
        /// Number of frequencies.
        frequencies: usize,
    },
    /// A coherency of channels that do not exist, or not with the lower one first.
    #[error(
        "profile, gesture `{gesture}`: no coherency of channels {channels:?} is wanted: there are {available} channels, the lower one goes first"
    )]
    CoherencyChannels {
        /// The gesture.
        gesture: Gesture,
        /// The two channels.
        channels: [usize; 2],
        /// Channels of the profile.
        available: usize,
    },
    /// No signals can have all of these coherencies at the same time.
    #[error(
        "profile, gesture `{gesture}`: the coherencies at {frequency_hz} Hz contradict each other: make them smaller"
    )]
    Coherency {
        /// The gesture.
        gesture: Gesture,
        /// The first frequency at which they do.
        frequency_hz: f64,
    },
}

impl Default for Profile {
    /// The profile that comes with the crate.
    fn default() -> Profile {
        Profile::from_toml(DEFAULT_PROFILE).expect("a unit test reads the profile that comes with the crate")
    }
}

impl Profile {
    /// A profile that comes with the crate, by its name: `stranger-19`, `stranger-20` or `stranger-22`.
    pub fn of_stranger(name: &str) -> Option<Profile> {
        let (_, text) = STRANGERS.into_iter().find(|(own, _)| *own == name)?;
        Some(Profile::from_toml(text).expect("a unit test reads the profiles that come with the crate"))
    }

    /// Whether a profile of this name comes with the crate.
    pub fn is_stranger(name: &str) -> bool {
        STRANGERS.iter().any(|(own, _)| *own == name)
    }

    /// Reads and checks a profile.
    ///
    /// # Errors
    /// If the text is not TOML of this shape, or [`Profile::check`] rejects it.
    pub fn from_toml(text: &str) -> Result<Profile, ProfileError> {
        let profile: Profile = toml::from_str(text).map_err(ProfileError::Toml)?;
        profile.check()?;
        Ok(profile)
    }

    /// The text that [`Profile::from_toml`] reads.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a profile holds only what TOML can write")
    }

    /// Number of channels the profile describes.
    pub fn channels(&self) -> usize {
        self.gestures.first().map_or(0, |entry| entry.amplitude_density.len())
    }

    /// The gestures that this person makes.
    ///
    /// # Errors
    /// Rest is missing, a gesture occurs more than once, or there are too few or too many.
    pub fn gesture_set(&self) -> Result<GestureSet, InvalidGestureSet> {
        let mut gestures: Vec<Gesture> = self.gestures.iter().map(|entry| entry.gesture).collect();
        gestures.sort();
        GestureSet::new(gestures)
    }

    /// Checks that rest is among the gestures, each of them is present once, and every array has the right length.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<(), ProfileError> {
        self.gesture_set().map_err(ProfileError::Gestures)?;
        let ascending = self.frequencies_hz.windows(2).all(|pair| pair[0] < pair[1]);
        let in_range = self.frequencies_hz.iter().all(|hz| hz.is_finite() && *hz >= 0.0);
        if self.frequencies_hz.len() < 2 || !ascending || !in_range {
            return Err(ProfileError::Frequencies);
        }
        self.gestures.iter().try_for_each(|entry| entry.check(self.channels(), &self.frequencies_hz))
    }

    /// The entry of `gesture`; [`Profile::check`] has made sure that it exists.
    pub(crate) fn gesture(&self, gesture: Gesture) -> &GestureProfile {
        self.gestures
            .iter()
            .find(|entry| entry.gesture == gesture)
            .expect("a checked profile has all gestures")
    }
}

impl GestureProfile {
    /// The coherency matrix `[channels][channels]` at one of the frequencies.
    pub(crate) fn coherency_matrix(&self, frequency: usize) -> Matrix {
        let channels = self.amplitude_density.len();
        let mut matrix = vec![vec![Complex::new(1.0, 0.0); channels]; channels];
        for Coherency { channels: [first, second], real, imaginary } in &self.coherency {
            let value = Complex::new(real[frequency], imaginary[frequency]);
            matrix[*first][*second] = value;
            matrix[*second][*first] = value.conj();
        }
        matrix
    }

    fn check(&self, channels: usize, frequencies_hz: &[f64]) -> Result<(), ProfileError> {
        let gesture = self.gesture;
        let frequencies = frequencies_hz.len();
        let density = &self.amplitude_density;
        let has_shape = density.len() == channels && density.iter().all(|row| row.len() == frequencies);
        let in_range = density.iter().flatten().all(|value| value.is_finite() && *value >= 0.0);
        if channels == 0 || !has_shape || !in_range {
            return Err(ProfileError::Density { gesture, channels: channels.max(1), frequencies });
        }
        for Coherency { channels: [first, second], .. } in &self.coherency {
            if first >= second || *second >= channels {
                let channels_given = [*first, *second];
                return Err(ProfileError::CoherencyChannels {
                    gesture,
                    channels: channels_given,
                    available: channels,
                });
            }
        }
        for second in 0..channels {
            for first in 0..second {
                let mut of_pair = self.coherency.iter().filter(|entry| entry.channels == [first, second]);
                let fits = of_pair.next().is_some_and(|entry| {
                    entry.real.len() == frequencies && entry.imaginary.len() == frequencies
                });
                if !fits || of_pair.next().is_some() {
                    return Err(ProfileError::CoherencyShape {
                        gesture,
                        channels: [first, second],
                        frequencies,
                    });
                }
            }
        }
        for (frequency, frequency_hz) in frequencies_hz.iter().enumerate() {
            if cholesky(&self.coherency_matrix(frequency)).is_none() {
                return Err(ProfileError::Coherency { gesture, frequency_hz: *frequency_hz });
            }
        }
        Ok(())
    }
}

/// Rows of complex numbers.
pub(crate) type Matrix = Vec<Vec<Complex<f64>>>;

/// The lower triangular `L` with `L · Lᴴ = matrix`; `None` unless the Hermitian `matrix` is positive definite.
pub(crate) fn cholesky(matrix: &Matrix) -> Option<Matrix> {
    let size = matrix.len();
    let mut lower = vec![vec![Complex::new(0.0, 0.0); size]; size];
    for row in 0..size {
        for column in 0..=row {
            let known: Complex<f64> = (0..column).map(|k| lower[row][k] * lower[column][k].conj()).sum();
            let rest = matrix[row][column] - known;
            lower[row][column] = if row == column {
                // A comparison with NaN is false.
                let is_positive = rest.re > 1e-9 && rest.re.is_finite();
                Complex::new(is_positive.then(|| rest.re.sqrt())?, 0.0)
            } else {
                rest / lower[column][column].re
            };
        }
    }
    Some(lower)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_profile_is_read_and_written_back() {
        let profile = Profile::default();
        assert_eq!(Profile::from_toml(&profile.to_toml()), Ok(profile.clone()));
        assert_eq!(profile.channels(), 4);
        assert_eq!(profile.unit, "adc_counts");
        assert!(DEFAULT_PROFILE.len() < 30_000, "{} bytes", DEFAULT_PROFILE.len());
    }

    #[test]
    fn strangers_are_read_by_name_and_differ() {
        for (name, text) in STRANGERS {
            let profile = Profile::of_stranger(name).unwrap();
            assert_eq!(profile.channels(), 4);
            assert_eq!(format!("stranger-{}", profile.number.unwrap()), name);
            assert_eq!(profile.data_set.as_deref(), Some("3DC"));
            assert!(Profile::is_stranger(name) && profile != Profile::default());
            assert!(text.len() < 30_000, "{} bytes", text.len());
        }
        assert_eq!(Profile::of_stranger("stranger-1"), None);
    }

    #[test]
    fn faults_are_named() {
        let fault = |spoil: fn(&mut Profile)| {
            let mut profile = Profile::default();
            spoil(&mut profile);
            profile.check().expect_err("spoilt")
        };
        assert_eq!(
            fault(|profile| profile.gestures[5].gesture = Gesture::REST),
            ProfileError::Gestures(InvalidGestureSet::Twice(Gesture::REST))
        );
        assert_eq!(fault(|profile| profile.frequencies_hz.swap(0, 1)), ProfileError::Frequencies);
        let frequencies = Profile::default().frequencies_hz.len();
        let gesture = Gesture::EXTENSION;
        assert_eq!(
            fault(|profile| profile.gestures[1].amplitude_density[2][3] = f64::NAN),
            ProfileError::Density { gesture, channels: 4, frequencies }
        );
        assert_eq!(
            fault(|profile| drop(profile.gestures[1].coherency.pop())),
            ProfileError::CoherencyShape { gesture, channels: [2, 3], frequencies }
        );
        assert_eq!(
            fault(|profile| profile.gestures[1].coherency[0].channels = [1, 0]),
            ProfileError::CoherencyChannels { gesture, channels: [1, 0], available: 4 }
        );
        let frequency_hz = Profile::default().frequencies_hz[7];
        for value in [1.5, f64::NAN] {
            let mut profile = Profile::default();
            profile.gestures[1].coherency[0].real[7] = value;
            assert_eq!(profile.check(), Err(ProfileError::Coherency { gesture, frequency_hz }));
        }
        assert!(matches!(Profile::from_toml("unit = 1"), Err(ProfileError::Toml(_))));
    }
}
