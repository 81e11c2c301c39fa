//! Where the gestures of other people lie, so that few repetitions of a new person need not say everything.
//!
//! ```text
//! of each class c of a person:  μ_c = u + M_c + δ_c + ρ_c
//!   u    the person: electrodes, skin, strength      from this person alone
//!   M_c  the gesture, whoever makes it               mean of other people's μ_c - u
//!   δ_c  how this person makes it                    covariance B, from other people
//!   ρ_c  how it differs between repetitions          covariance R, from other people; R / k for the mean of k
//!
//! the mean of class c is then  u + M_c + B (B + R / k)⁻¹ (measured mean - u - M_c)
//! ```
//!
//! This is the posterior mean of a normal hierarchical model (for instance Gelman et al., Bayesian Data Analysis, 3rd
//! edition, section 5.4) for each class, with u taken as the mean over classes of measured mean - M_c.

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::error::{FitError, PriorError};
use crate::shrinkage::ledoit_wolf;
use crate::training::Training;

/// The means of one person's gestures, and how they differ between repetitions.
#[derive(Clone, Debug)]
pub struct GestureMeans {
    classes: Vec<String>,
    /// Features x classes.
    means: DMatrix<f64>,
    /// Features x (classes x repetitions): repetition less the mean of its class, scaled up for what the mean has
    /// taken of it.
    deviations: DMatrix<f64>,
}

impl GestureMeans {
    /// Takes every block of the training for one repetition.
    ///
    /// # Errors
    ///
    /// What is wrong with the windows, or a class with less than two repetitions.
    pub fn new(training: &Training) -> Result<GestureMeans, FitError> {
        training.check()?;
        let length = training.feature_count;
        let mut means = DMatrix::zeros(length, training.classes.len());
        let mut deviations = Vec::new();
        for (label, class) in training.classes.iter().enumerate() {
            let repetitions = repetition_means(training, label);
            if repetitions.len() < 2 {
                return Err(FitError::TooFewRepetitions { class: class.name.clone() });
            }
            let count = repetitions.len() as f64;
            let mean = repetitions.iter().sum::<DVector<f64>>() / count;
            let scale = (count / (count - 1.0)).sqrt();
            deviations.extend(repetitions.iter().map(|repetition| (repetition - &mean) * scale));
            means.set_column(label, &mean);
        }
        Ok(GestureMeans {
            classes: training.classes.iter().map(|class| class.name.clone()).collect(),
            means,
            deviations: DMatrix::from_columns(&deviations),
        })
    }

    pub(crate) fn from_parts(
        classes: Vec<String>,
        means: DMatrix<f64>,
        deviations: DMatrix<f64>,
    ) -> GestureMeans {
        GestureMeans { classes, means, deviations }
    }

    pub(crate) fn classes(&self) -> &[String] {
        &self.classes
    }

    pub(crate) fn means(&self) -> &DMatrix<f64> {
        &self.means
    }

    pub(crate) fn deviations(&self) -> &DMatrix<f64> {
        &self.deviations
    }

    fn column(&self, class: &str) -> Option<DVector<f64>> {
        let place = self.classes.iter().position(|own| own == class)?;
        Some(self.means.column(place).into_owned())
    }
}

fn repetition_means(training: &Training, label: usize) -> Vec<DVector<f64>> {
    let mut blocks: Vec<usize> = training.blocks.to_vec();
    blocks.sort_unstable();
    blocks.dedup();
    let mean_of = |block: &usize| {
        let (mut sum, mut count) = (DVector::zeros(training.feature_count), 0.0);
        let windows = training.windows().zip(training.labels).zip(training.blocks);
        for ((window, _), _) in windows.filter(|((_, own), at)| **own == label && *at == block) {
            sum += DVector::from_column_slice(window);
            count += 1.0;
        }
        (count > 0.0).then(|| sum / count)
    };
    blocks.iter().filter_map(mean_of).collect()
}

/// What many people's gestures have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct Population {
    pub(crate) classes: Vec<String>,
    /// M, features x classes.
    pub(crate) offsets: DMatrix<f64>,
    /// B.
    pub(crate) between_people: DMatrix<f64>,
    /// R.
    pub(crate) between_repetitions: DMatrix<f64>,
}

impl Population {
    /// Pools the gestures that all of these people made.
    ///
    /// # Errors
    ///
    /// Fewer than two people, fewer than two gestures that all made, or features of another length.
    pub fn pool<'a>(people: impl IntoIterator<Item = &'a GestureMeans>) -> Result<Population, PriorError> {
        let people: Vec<&GestureMeans> = people.into_iter().collect();
        let first = *people.first().ok_or(PriorError::TooFewPeople(0))?;
        let length = first.means.nrows();
        if people.len() < 2 {
            return Err(PriorError::TooFewPeople(people.len()));
        }
        if let Some(other) = people.iter().find(|person| person.means.nrows() != length) {
            let (what, given) = ("features of a person's gestures", other.means.nrows());
            return Err(FitError::Length { what, given, needed: length }.into());
        }
        let is_common = |class: &&String| people.iter().all(|person| person.classes.contains(class));
        let classes: Vec<String> = first.classes.iter().filter(is_common).cloned().collect();
        if classes.len() < 2 {
            return Err(FitError::TooFewClasses(classes.len()).into());
        }
        let centred: Vec<DMatrix<f64>> =
            people.iter().map(|person| centred_means(person, &classes)).collect();
        let count = people.len() as f64;
        let offsets = centred.iter().sum::<DMatrix<f64>>() / count;
        // What the means over people and over classes have taken of the deviations.
        let class_count = classes.len() as f64;
        let scale = (count / (count - 1.0) * class_count / (class_count - 1.0)).sqrt();
        let of_people: Vec<DVector<f64>> = centred
            .iter()
            .flat_map(|means| {
                let apart = (means - &offsets) * scale;
                apart.column_iter().map(|column| column.into_owned()).collect::<Vec<_>>()
            })
            .collect();
        let of_repetitions: Vec<DVector<f64>> = people
            .iter()
            .flat_map(|person| person.deviations.column_iter().map(|column| column.into_owned()))
            .collect();
        Ok(Population {
            classes,
            offsets,
            between_people: ledoit_wolf(&DMatrix::from_columns(&of_people)).covariance,
            between_repetitions: ledoit_wolf(&DMatrix::from_columns(&of_repetitions)).covariance,
        })
    }

    /// Moves the measured means (features x classes, each of `repetitions` repetitions) towards where people's gestures lie.
    /// Classes that the population does not know stay where they are, and all do if it knows fewer than two.
    ///
    /// # Errors
    ///
    /// The covariances have no inverse.
    pub(crate) fn draw(
        &self,
        names: &[&str],
        means: &mut DMatrix<f64>,
        repetitions: usize,
    ) -> Result<(), FitError> {
        let place = |name: &&str| self.classes.iter().position(|class| class == name);
        let known: Vec<(usize, usize)> =
            names.iter().enumerate().filter_map(|(label, name)| Some((label, place(name)?))).collect();
        if known.len() < 2 {
            return Ok(());
        }
        let apart: Vec<DVector<f64>> =
            known.iter().map(|&(label, place)| means.column(label) - self.offsets.column(place)).collect();
        let apart = DMatrix::from_columns(&apart);
        let person = apart.column_mean();
        let mut own = apart;
        own.column_iter_mut().for_each(|mut column| column -= &person);
        let measured = &self.between_people + &self.between_repetitions / repetitions.max(1) as f64;
        let drawn = &self.between_people * Cholesky::new(measured).ok_or(FitError::Singular)?.solve(&own);
        for (column, &(label, place)) in known.iter().enumerate() {
            means.set_column(label, &(&person + self.offsets.column(place) + drawn.column(column)));
        }
        Ok(())
    }
}

/// The means of these classes, less their mean.
fn centred_means(person: &GestureMeans, classes: &[String]) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = classes.iter().filter_map(|class| person.column(class)).collect();
    let mut means = DMatrix::from_columns(&columns);
    let middle = means.column_mean();
    means.column_iter_mut().for_each(|mut column| column -= &middle);
    means
}
