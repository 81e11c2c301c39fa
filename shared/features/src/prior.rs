//! How features scatter within a gesture, whoever makes it, and where gestures lie: other people's part in a fit.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::covariance::LaggedLogCovariance;
use crate::error::{FitError, PriorError};
use crate::population::Population;
use crate::training::Training;

/// Beyond this many channels x delays a layout is no layout but a damaged file.
const LARGEST_ROWS: usize = 256;

/// What decides which feature is which.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FeatureLayout {
    /// Number of channels.
    pub channels: usize,
    /// Delays that are used, in ms.
    pub delays_ms: Vec<f64>,
    /// Lowest sampling rate.
    pub lowest_rate_hz: f64,
    /// Highest sampling rate.
    pub highest_rate_hz: f64,
    /// Length of the pieces of which a window's features are the mean, ms.
    pub piece_ms: f64,
}

impl FeatureLayout {
    /// Number of features.
    pub fn feature_count(&self) -> usize {
        let rows = self.channels * self.delays_ms.len();
        rows * (rows + 1) / 2
    }

    /// Refuses features of another layout.
    ///
    /// # Errors
    ///
    /// What differs: channels, delays, pieces or rate.
    pub fn fits(&self, features: &LaggedLogCovariance) -> Result<(), PriorError> {
        let FeatureLayout { channels, delays_ms, lowest_rate_hz, highest_rate_hz, piece_ms } = self;
        let theirs = features.layout();
        if *channels != theirs.channels {
            return Err(PriorError::Channels { prior: *channels, features: theirs.channels });
        }
        if *delays_ms != theirs.delays_ms {
            return Err(PriorError::Delays { prior: delays_ms.clone(), features: theirs.delays_ms });
        }
        if *piece_ms != theirs.piece_ms {
            return Err(PriorError::Pieces { prior: *piece_ms, features: theirs.piece_ms });
        }
        let rate_hz = features.rate_hz();
        if !(*lowest_rate_hz..=*highest_rate_hz).contains(&rate_hz) {
            return Err(PriorError::Rate { lowest: *lowest_rate_hz, highest: *highest_rate_hz, rate_hz });
        }
        Ok(())
    }

    pub(crate) fn check(&self) -> Result<(), PriorError> {
        let rows = self.channels.checked_mul(self.delays_ms.len());
        let fields = [
            ("channels", rows.is_some_and(|rows| (1..=LARGEST_ROWS).contains(&rows))),
            ("delays_ms", self.delays_ms.iter().all(|delay| delay.is_finite())),
            ("lowest_rate_hz", self.lowest_rate_hz > 0.0 && self.lowest_rate_hz <= self.highest_rate_hz),
            ("highest_rate_hz", self.highest_rate_hz.is_finite()),
            ("piece_ms", self.piece_ms > 0.0 && self.piece_ms.is_finite()),
        ];
        match fields.into_iter().find(|(_, fits)| !fits) {
            Some((field, _)) => Err(PriorError::Layout { field }),
            None => Ok(()),
        }
    }
}

/// How the windows of one person scatter about the mean of their gesture. Kept per person, so that a prior
/// can leave people out.
#[derive(Clone, Debug)]
pub struct WithinClassScatter {
    sum: DMatrix<f64>,
    windows: usize,
}

impl WithinClassScatter {
    /// The scatter of one session of a person; [`add`](Self::add) joins further ones.
    ///
    /// # Errors
    ///
    /// What is wrong with the windows.
    pub fn new(session: &Training) -> Result<WithinClassScatter, FitError> {
        session.check()?;
        let centred = session.centred(&session.means());
        Ok(WithinClassScatter { sum: &centred * centred.transpose(), windows: session.len() })
    }

    /// Nothing yet.
    pub(crate) fn zeros(length: usize) -> WithinClassScatter {
        WithinClassScatter { sum: DMatrix::zeros(length, length), windows: 0 }
    }

    pub(crate) fn from_parts(sum: DMatrix<f64>, windows: usize) -> WithinClassScatter {
        WithinClassScatter { sum, windows }
    }

    pub(crate) fn sum(&self) -> &DMatrix<f64> {
        &self.sum
    }

    pub(crate) fn windows(&self) -> usize {
        self.windows
    }

    /// Adds another session of the same person, centred on its own means.
    ///
    /// # Errors
    ///
    /// It has another number of features.
    pub fn add(&mut self, other: &WithinClassScatter) -> Result<(), FitError> {
        let (given, needed) = (other.sum.nrows(), self.sum.nrows());
        if given != needed {
            return Err(FitError::Length { what: "features of the scatter", given, needed });
        }
        self.sum += &other.sum;
        self.windows += other.windows;
        Ok(())
    }
}

/// The pooled within-class covariance of other people, for one layout of features.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    layout: FeatureLayout,
    people: Vec<String>,
    windows: usize,
    covariance: DMatrix<f64>,
    population: Option<Population>,
}

impl Prior {
    /// Pools the scatter of people; each window counts the same.
    ///
    /// # Errors
    ///
    /// A scatter of another layout, or fewer windows than features.
    pub fn pool<'a>(
        layout: FeatureLayout,
        people: impl IntoIterator<Item = (&'a str, &'a WithinClassScatter)>,
    ) -> Result<Prior, PriorError> {
        layout.check()?;
        let length = layout.feature_count();
        let mut total = WithinClassScatter::zeros(length);
        let mut names = Vec::new();
        for (name, scatter) in people {
            total.add(scatter)?;
            names.push(name.to_owned());
        }
        let WithinClassScatter { sum, windows } = total;
        if windows <= length {
            return Err(PriorError::TooFewWindows { windows, length });
        }
        Ok(Prior { layout, people: names, windows, covariance: sum / windows as f64, population: None })
    }

    /// The same prior with what the same people's gestures have in common.
    ///
    /// # Errors
    ///
    /// A population of other features.
    pub fn with_population(self, population: Population) -> Result<Prior, PriorError> {
        let (given, needed) = (population.offsets.nrows(), self.layout.feature_count());
        if given != needed {
            return Err(FitError::Length { what: "features of the population", given, needed }.into());
        }
        Ok(Prior { population: Some(population), ..self })
    }

    /// What the people's gestures have in common, if it is known.
    pub fn population(&self) -> Option<&Population> {
        self.population.as_ref()
    }

    /// Refuses features that the prior was not made for.
    ///
    /// # Errors
    ///
    /// What differs: channels, delays or rate.
    pub fn check(&self, features: &LaggedLogCovariance) -> Result<(), PriorError> {
        self.layout.fits(features)
    }

    /// The features it is for.
    pub fn layout(&self) -> &FeatureLayout {
        &self.layout
    }

    /// Who it was made from. Nobody of them may be scored with it.
    pub fn people(&self) -> &[String] {
        &self.people
    }

    /// Number of windows it was made from.
    pub fn windows(&self) -> usize {
        self.windows
    }

    /// The covariance, features x features.
    pub fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }
}
