//! What one person's muscles look like to the electrodes: for every gesture a spectrum per channel and how
//! the channels go together. Nothing in a profile depends on a sample rate.

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;

/// A small file in the crate: `profiles/default.toml`.
const DEFAULT_PROFILE: &str = include_str!("../profiles/default.toml");

/// The muscle signals of one person, rest included. Read from and written to TOML.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Whose recordings it was fitted from, for people.
    pub source: String,
    /// The unit of the samples, such as `adc_counts`.
    pub unit: String,
    /// The frequencies, ascending, at which the spectra are given. Between them the amplitude density is
    /// interpolated linearly; below the first and above the last there is no signal.
    pub frequencies_hz: Vec<f64>,
    /// One entry a gesture, all six, in any order.
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
    /// `[channels][channels]`: correlation between the channels, 1 on the diagonal, positive definite.
    pub correlation: Vec<Vec<f64>>,
}

/// What is wrong with a profile.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ProfileError {
    /// The text is no TOML, or lacks a key, or has one too many.
    #[error("profile: {0}")]
    Toml(#[from] toml::de::Error),
    /// A gesture occurs not at all or more than once.
    #[error("profile: {found} entries for the gesture `{gesture}`: give each of the six gestures once")]
    Gestures {
        /// The gesture.
        gesture: Gesture,
        /// How many entries it has.
        found: usize,
    },
    /// The frequencies are not ascending, or fewer than two, or not finite and from 0 Hz.
    #[error("profile: frequencies_hz must be at least two, ascending and not negative")]
    Frequencies,
    /// An array is not as long as the frequencies or the channels ask for.
    #[error("profile, gesture `{gesture}`: {array} must be {rows} rows of {columns}")]
    Shape {
        /// The gesture.
        gesture: Gesture,
        /// The name of the array.
        array: &'static str,
        /// The rows it should have.
        rows: usize,
        /// The columns it should have.
        columns: usize,
    },
    /// A density is negative or not finite.
    #[error("profile, gesture `{gesture}`: amplitude_density must be finite and not negative")]
    Density {
        /// The gesture.
        gesture: Gesture,
    },
    /// The correlation is no correlation matrix.
    #[error(
        "profile, gesture `{gesture}`: correlation must be symmetric, 1 on its diagonal and positive definite"
    )]
    Correlation {
        /// The gesture.
        gesture: Gesture,
    },
}

impl Default for Profile {
    /// The profile that comes with the crate.
    fn default() -> Profile {
        Profile::from_toml(DEFAULT_PROFILE).expect("a unit test reads the profile that comes with the crate")
    }
}

impl Profile {
    /// Reads and checks a profile.
    ///
    /// # Errors
    /// If the text is no TOML of this shape, or [`Profile::check`] finds fault with it.
    pub fn from_toml(text: &str) -> Result<Profile, ProfileError> {
        let profile: Profile = toml::from_str(text)?;
        profile.check()?;
        Ok(profile)
    }

    /// The text that [`Profile::from_toml`] reads.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a profile holds only what TOML can write")
    }

    /// Number of channels the profile describes.
    pub fn channels(&self) -> usize {
        self.gestures.first().map_or(0, |gesture| gesture.amplitude_density.len())
    }

    /// Checks that every gesture is there once and every array fits.
    ///
    /// # Errors
    /// The first fault found.
    pub fn check(&self) -> Result<(), ProfileError> {
        for gesture in Gesture::ALL {
            let found = self.gestures.iter().filter(|entry| entry.gesture == gesture).count();
            if found != 1 {
                return Err(ProfileError::Gestures { gesture, found });
            }
        }
        let ascending = self.frequencies_hz.windows(2).all(|pair| pair[0] < pair[1]);
        let in_range = self.frequencies_hz.iter().all(|hz| hz.is_finite() && *hz >= 0.0);
        if self.frequencies_hz.len() < 2 || !ascending || !in_range {
            return Err(ProfileError::Frequencies);
        }
        let channels = self.channels();
        for entry in &self.gestures {
            entry.check(channels, self.frequencies_hz.len())?;
        }
        Ok(())
    }

    /// The entry of `gesture`; [`Profile::check`] has found it to be there.
    pub(crate) fn gesture(&self, gesture: Gesture) -> &GestureProfile {
        self.gestures.iter().find(|entry| entry.gesture == gesture).expect("a checked profile has all gestures")
    }
}

impl GestureProfile {
    fn check(&self, channels: usize, frequencies: usize) -> Result<(), ProfileError> {
        let gesture = self.gesture;
        let shape = |array, rows, columns| Err(ProfileError::Shape { gesture, array, rows, columns });
        if channels == 0 || !is_matrix(&self.amplitude_density, channels, frequencies) {
            return shape("amplitude_density", channels.max(1), frequencies);
        }
        if !is_matrix(&self.correlation, channels, channels) {
            return shape("correlation", channels, channels);
        }
        if self.amplitude_density.iter().flatten().any(|density| !density.is_finite() || *density < 0.0) {
            return Err(ProfileError::Density { gesture });
        }
        let correlation = &self.correlation;
        let is_symmetric = (0..channels).all(|row| {
            correlation[row][row] == 1.0
                && (0..row).all(|column| correlation[row][column] == correlation[column][row])
        });
        if !is_symmetric || cholesky(correlation).is_none() {
            return Err(ProfileError::Correlation { gesture });
        }
        Ok(())
    }
}

fn is_matrix(rows: &[Vec<f64>], height: usize, width: usize) -> bool {
    rows.len() == height && rows.iter().all(|row| row.len() == width)
}

/// The lower triangular `L` with `L Lᵀ = matrix`; `None` unless `matrix` is positive definite.
pub(crate) fn cholesky(matrix: &[Vec<f64>]) -> Option<Vec<Vec<f64>>> {
    let size = matrix.len();
    let mut lower = vec![vec![0.0; size]; size];
    for row in 0..size {
        for column in 0..=row {
            let known: f64 = (0..column).map(|k| lower[row][k] * lower[column][k]).sum();
            let rest = matrix[row][column] - known;
            if row == column {
                // Also false for NaN.
                if !(rest > 1e-9) {
                    return None;
                }
                lower[row][row] = rest.sqrt();
            } else {
                lower[row][column] = rest / lower[column][column];
            }
        }
    }
    Some(lower)
}
