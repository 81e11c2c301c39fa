//! The linear discriminant of one person.
//!
//! ```text
//! class means μ, drawn towards other people's ──┐
//! own covariance, shrunk ── 1 - w ──────────────┤
//! other people's covariance ── w ───────────────┴─▶ S = L Lᵀ           w = prior_s / (prior_s + time of the windows)
//!
//! score of a class    = (x - m)ᵀ S⁻¹ (μ - m) - ½ (μ - m)ᵀ S⁻¹ (μ - m) + ln share          m: mean of the means
//! posterior           = softmax(scores / temperature)
//! distance of a class = |L⁻¹ (x - μ)|                                                Mahalanobis
//! ```
//!
//! Subtracting m changes all scores of a window alike, so the posterior is that of the plain formula, with
//! smaller numbers.

mod adaptation;

use nalgebra::{Cholesky, DMatrix};
use serde::{Deserialize, Serialize};

use crate::eigen::{add_scaled, dot};
use crate::error::FitError;
use crate::prior::Prior;
use crate::settings::MethodSettings;
use crate::shrinkage::{Shrunk, ledoit_wolf};
use crate::training::{Class, Training};

pub use adaptation::SlowAdaptation;

/// How much of its own step a class takes that goes beyond the step of all, when everything has moved: a few seconds show the
/// common step better than that of each class.
const OWN_STEP: f64 = 0.5;

/// Largest value of a fitted discriminant, far beyond what any signal makes, but so small that sums of products stay finite.
const LARGEST_VALUE: f64 = 1e30;

/// Tells the gestures of one person apart. Allocates in [`fit`](Self::fit) only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct Discriminant {
    classes: Vec<Class>,
    feature_count: usize,
    temperature: f64,
    /// How far the person's own covariance was shrunk.
    shrinkage: f64,
    /// Weight that the prior had; 0 without one.
    prior_weight: f64,
    /// Classes x features: S⁻¹ (μ - m).
    #[serde(with = "crate::numbers")]
    weights: Vec<f64>,
    /// One per class.
    biases: Vec<f64>,
    /// L, row by row up to the diagonal.
    #[serde(with = "crate::numbers")]
    factor: Vec<f64>,
    /// Classes x features: L⁻¹ μ.
    #[serde(with = "crate::numbers")]
    whitened_means: Vec<f64>,
}

impl Discriminant {
    /// Fits means and covariance, with a temperature of 1. Without a prior its weight is 0. Whether the prior
    /// fits the features in more than their number is checked by [`Prior::check`].
    ///
    /// # Errors
    ///
    /// What is wrong with the training windows or the settings; a prior of another length; windows that do
    /// not differ.
    pub fn fit(
        training: &Training,
        prior: Option<&Prior>,
        settings: &MethodSettings,
    ) -> Result<Discriminant, FitError> {
        settings.check()?;
        training.check()?;
        training.check_counts(settings.fewest_windows)?;
        let shares = training.shares();
        let mut means = training.means();
        let Shrunk { mut covariance, shrinkage } = own_covariance(training, &means, &shares);
        let own_s = training.len() as f64 * training.increment_s;
        let prior_weight = if prior.is_some() { settings.prior_s / (settings.prior_s + own_s) } else { 0.0 };
        if let Some(prior) = prior {
            let (given, needed) = (prior.covariance().nrows(), training.feature_count);
            if given != needed {
                return Err(FitError::Length { what: "features of the prior", given, needed });
            }
            covariance *= 1.0 - prior_weight;
            for (value, prior) in covariance.iter_mut().zip(prior.covariance().iter()) {
                *value += prior_weight * prior;
            }
            if let Some(population) = prior.population() {
                let names: Vec<&str> = training.classes.iter().map(|class| class.name.as_str()).collect();
                population.draw(&names, &mut means, training.repetitions())?;
            }
        }
        let cholesky = Cholesky::new(covariance).ok_or(FitError::Singular)?;
        Ok(Discriminant {
            temperature: 1.0,
            shrinkage,
            prior_weight,
            ..of_means(training, &means, &shares, &cholesky)?
        })
    }

    /// The same discriminant with another temperature, from
    /// [`CrossValidation::temperature`](crate::CrossValidation).
    ///
    /// # Errors
    ///
    /// The temperature is not a positive number.
    pub fn with_temperature(mut self, temperature: f64) -> Result<Discriminant, FitError> {
        self.temperature = temperature;
        self.checked()
    }

    /// The same discriminant where everything lies elsewhere by the same step, as after the electrodes were put on again. The
    /// step is the mean, over the classes that `windows` are of, from each class's mean to that of its windows, which come as
    /// the number of their class and their features.
    ///
    /// # Errors
    ///
    /// There are no windows, one has the wrong length, or a feature is not finite.
    pub fn moved_to<'a>(
        mut self,
        windows: impl Iterator<Item = (usize, &'a [f64])>,
    ) -> Result<Discriminant, FitError> {
        let count = self.feature_count;
        let classes = self.classes.len();
        let mut sums = vec![vec![0.0; count]; classes];
        let mut counts = vec![0_u32; classes];
        for (class, features) in windows.filter(|(class, _)| *class < classes) {
            check_length("features", features.len(), count)?;
            sums[class].iter_mut().zip(features).for_each(|(sum, feature)| *sum += feature);
            counts[class] += 1;
        }
        let mut made: Vec<(usize, Vec<f64>)> = Vec::new();
        for (class, (sum, windows)) in sums.iter().zip(&counts).enumerate().filter(|(_, (_, n))| **n > 0) {
            let mean: Vec<f64> = sum.iter().map(|sum| sum / f64::from(*windows)).collect();
            let mut apart = vec![0.0; count];
            self.whiten(&mean, &mut apart);
            let own = &self.whitened_means[class * count..][..count];
            apart.iter_mut().zip(own).for_each(|(apart, own)| *apart -= own);
            made.push((class, apart));
        }
        if made.is_empty() {
            return Err(FitError::TooFewClasses(0));
        }
        let mut step = vec![0.0; count];
        for (_, apart) in &made {
            add_scaled(&mut step, 1.0 / made.len() as f64, apart);
        }
        let shares_ln = self.shares_ln();
        for mean in self.whitened_means.chunks_exact_mut(count) {
            add_scaled(mean, 1.0, &step);
        }
        for (class, apart) in &made {
            let mean = &mut self.whitened_means[class * count..][..count];
            add_scaled(mean, OWN_STEP, apart);
            add_scaled(mean, -OWN_STEP, &step);
        }
        self.lay_anew(&shares_ln);
        self.checked()
    }

    /// The mean of the whitened means.
    fn whitened_middle(&self) -> Vec<f64> {
        let mut middle = vec![0.0; self.feature_count];
        for mean in self.whitened_means.chunks_exact(self.feature_count) {
            add_scaled(&mut middle, 1.0 / self.classes.len() as f64, mean);
        }
        middle
    }

    /// The logarithm of every class's share, from its bias.
    fn shares_ln(&self) -> Vec<f64> {
        let middle = self.whitened_middle();
        let means = self.whitened_means.chunks_exact(self.feature_count);
        self.biases.iter().zip(means).map(|(bias, mean)| bias - bias_of(mean, &middle)).collect()
    }

    /// Weights and biases for the whitened means.
    fn lay_anew(&mut self, shares_ln: &[f64]) {
        let middle = self.whitened_middle();
        for (class, share_ln) in shares_ln.iter().enumerate() {
            self.lay_class(class, *share_ln, &middle);
        }
    }

    /// Weights and bias of one class for its whitened mean. `middle` stands for the mean of the means: any point does that is
    /// the same for all classes.
    fn lay_class(&mut self, class: usize, share_ln: f64, middle: &[f64]) {
        let count = self.feature_count;
        let mean = &self.whitened_means[class * count..][..count];
        self.biases[class] = share_ln + bias_of(mean, middle);
        let weights = &mut self.weights[class * count..][..count];
        weights.iter_mut().zip(mean.iter().zip(middle)).for_each(|(weight, (mean, m))| *weight = mean - m);
        // L transposed, from its last row up.
        for row in (0..count).rev() {
            let line = &self.factor[row * (row + 1) / 2..][..=row];
            weights[row] /= line[row];
            let weight = weights[row];
            add_scaled(&mut weights[..row], -weight, &line[..row]);
        }
    }

    /// L⁻¹ times the features.
    fn whiten(&self, features: &[f64], whitened: &mut [f64]) {
        let mut at = 0;
        for (row, feature) in features.iter().enumerate() {
            let line = &self.factor[at..=at + row];
            whitened[row] = (feature - dot(&line[..row], &whitened[..row])) / line[row];
            at += row + 1;
        }
    }

    /// The classes, in the order of scores and posterior.
    pub fn classes(&self) -> &[Class] {
        &self.classes
    }

    /// Features that a window must have.
    pub fn feature_count(&self) -> usize {
        self.feature_count
    }

    /// By which the scores are divided before they become probabilities.
    pub fn temperature(&self) -> f64 {
        self.temperature
    }

    /// How far the person's own covariance was shrunk, from 0 to 1.
    pub fn shrinkage(&self) -> f64 {
        self.shrinkage
    }

    /// Weight that other people's covariance had; 0 without a prior.
    pub fn prior_weight(&self) -> f64 {
        self.prior_weight
    }

    /// Writes the score of each class, before the temperature. Only differences between classes mean
    /// something.
    ///
    /// # Errors
    ///
    /// A slice has the wrong length, or a feature is not finite.
    pub fn scores(&self, features: &[f64], scores: &mut [f64]) -> Result<(), FitError> {
        check_length("features", features.len(), self.feature_count)?;
        check_length("scores", scores.len(), self.classes.len())?;
        for ((score, weights), bias) in
            scores.iter_mut().zip(self.weights.chunks_exact(self.feature_count)).zip(&self.biases)
        {
            *score = dot(weights, features) + bias;
        }
        if scores.iter().all(|score| score.is_finite()) {
            Ok(())
        } else {
            Err(FitError::NotFinite { window: 0 })
        }
    }

    /// Writes the probability of each class; the sum is 1.
    ///
    /// # Errors
    ///
    /// A slice has the wrong length, or a feature is not finite.
    pub fn posterior(&self, features: &[f64], posterior: &mut [f64]) -> Result<(), FitError> {
        self.scores(features, posterior)?;
        let highest = posterior.iter().fold(f64::NEG_INFINITY, |highest, score| highest.max(*score));
        let mut sum = 0.0;
        for value in &mut *posterior {
            *value = ((*value - highest) / self.temperature).exp();
            sum += *value;
        }
        posterior.iter_mut().for_each(|value| *value /= sum);
        Ok(())
    }

    /// Mahalanobis distance to the nearest class: how unlike everything in the calibration the window is.
    /// About the square root of the number of features for windows like those of the calibration. `whitened`
    /// is working memory of the length of `features`.
    ///
    /// # Errors
    ///
    /// A slice has the wrong length, or a feature is not finite.
    pub fn distance(&self, features: &[f64], whitened: &mut [f64]) -> Result<f64, FitError> {
        check_length("features", features.len(), self.feature_count)?;
        check_length("whitened", whitened.len(), self.feature_count)?;
        self.whiten(features, whitened);
        let squared = |mean: &[f64]| -> f64 {
            mean.iter().zip(&*whitened).map(|(mean, value)| (value - mean).powi(2)).sum()
        };
        let squares = self.whitened_means.chunks_exact(self.feature_count).map(squared);
        let nearest = squares.fold(f64::INFINITY, f64::min);
        if nearest.is_finite() { Ok(nearest.sqrt()) } else { Err(FitError::NotFinite { window: 0 }) }
    }

    fn checked(self) -> Result<Discriminant, FitError> {
        // So that no length of a damaged file overflows.
        if self.feature_count > self.weights.len() {
            return Err(FitError::Length {
                what: "weights",
                given: self.weights.len(),
                needed: self.feature_count,
            });
        }
        let lengths = [
            ("weights", self.weights.len(), self.classes.len() * self.feature_count),
            ("biases", self.biases.len(), self.classes.len()),
            ("factor", self.factor.len(), self.feature_count * (self.feature_count + 1) / 2),
            ("whitened_means", self.whitened_means.len(), self.classes.len() * self.feature_count),
        ];
        for (what, given, needed) in lengths {
            check_length(what, given, needed)?;
        }
        if self.classes.is_empty() || self.feature_count == 0 {
            return Err(FitError::TooFewClasses(self.classes.len()));
        }
        if !(self.temperature > 0.0 && is_usual(&self.temperature)) {
            return Err(FitError::Temperature(self.temperature));
        }
        let values = [
            ("weights", &self.weights),
            ("biases", &self.biases),
            ("factor", &self.factor),
            ("whitened_means", &self.whitened_means),
        ];
        for (what, values) in values {
            if let Some(&value) = values.iter().find(|value| !is_usual(value)) {
                return Err(FitError::Value { what, value });
            }
        }
        let mut diagonal = 0;
        for row in 0..self.feature_count {
            diagonal += row;
            let value = self.factor[diagonal + row];
            if value < 1.0 / LARGEST_VALUE {
                return Err(FitError::Value { what: "factor", value });
            }
        }
        Ok(self)
    }
}

/// A discriminant as it stands in a file, before it is checked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Unchecked {
    classes: Vec<Class>,
    feature_count: usize,
    temperature: f64,
    shrinkage: f64,
    prior_weight: f64,
    #[serde(with = "crate::numbers")]
    weights: Vec<f64>,
    biases: Vec<f64>,
    #[serde(with = "crate::numbers")]
    factor: Vec<f64>,
    #[serde(with = "crate::numbers")]
    whitened_means: Vec<f64>,
}

impl TryFrom<Unchecked> for Discriminant {
    type Error = FitError;

    fn try_from(file: Unchecked) -> Result<Discriminant, FitError> {
        Discriminant {
            classes: file.classes,
            feature_count: file.feature_count,
            temperature: file.temperature,
            shrinkage: file.shrinkage,
            prior_weight: file.prior_weight,
            weights: file.weights,
            biases: file.biases,
            factor: file.factor,
            whitened_means: file.whitened_means,
        }
        .checked()
    }
}

/// The person's covariance within classes, in which every class has its share whatever its number of windows.
fn own_covariance(training: &Training, means: &DMatrix<f64>, shares: &[f64]) -> Shrunk {
    let counts = training.counts();
    let mut centred = training.centred(means);
    let windows = training.len() as f64;
    for (mut window, &label) in centred.column_iter_mut().zip(training.labels) {
        window *= (windows * shares[label] / counts[label] as f64).sqrt();
    }
    ledoit_wolf(&centred)
}

/// Weights, biases and whitened means for a covariance.
fn of_means(
    training: &Training,
    means: &DMatrix<f64>,
    shares: &[f64],
    cholesky: &Cholesky<f64, nalgebra::Dyn>,
) -> Result<Discriminant, FitError> {
    let feature_count = training.feature_count;
    let middle = means.column_mean();
    let mut apart = means.clone();
    apart.column_iter_mut().for_each(|mut mean| mean -= &middle);
    let weights = cholesky.solve(&apart);
    let biases = weights.column_iter().zip(apart.column_iter()).zip(shares);
    let biases = biases
        .map(|((weights, apart), share)| share.ln() - weights.dot(&middle) - 0.5 * weights.dot(&apart))
        .collect();
    let lower = cholesky.l_dirty();
    let whitened_means = lower.solve_lower_triangular(means).ok_or(FitError::Singular)?;
    Discriminant {
        classes: training.classes.to_vec(),
        feature_count,
        temperature: 1.0,
        shrinkage: 0.0,
        prior_weight: 0.0,
        weights: weights.as_slice().to_vec(),
        biases,
        factor: (0..feature_count)
            .flat_map(|row| (0..=row).map(move |column| lower[(row, column)]))
            .collect(),
        whitened_means: whitened_means.as_slice().to_vec(),
    }
    .checked()
}

/// The bias of a class without its share; means are whitened.
fn bias_of(mean: &[f64], middle: &[f64]) -> f64 {
    let apart = || mean.iter().zip(middle).map(|(mean, middle)| mean - middle);
    let along: f64 = apart().zip(middle).map(|(apart, middle)| apart * middle).sum();
    -along - 0.5 * apart().map(|apart| apart * apart).sum::<f64>()
}

/// Whether it is a number of a size that fitting can give. NaN is none.
fn is_usual(value: &f64) -> bool {
    value.abs() <= LARGEST_VALUE
}

fn check_length(what: &'static str, given: usize, needed: usize) -> Result<(), FitError> {
    if given == needed { Ok(()) } else { Err(FitError::Length { what, given, needed }) }
}
