//! Windows of known gestures, from which a discriminant is fitted.

use std::collections::BTreeSet;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::error::FitError;

/// A gesture to be recognised, or rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Class {
    /// Its name, for messages.
    pub name: String,
    /// How much it counts beside the others: its share of the covariance, and how often it is expected.
    /// However many windows it has, it counts the same. Any positive number; 1 for all treats them alike.
    pub weight: f64,
}

/// Features of windows with their gestures.
#[derive(Clone, Copy, Debug)]
pub struct Training<'a> {
    /// The classes, in the order of the posterior.
    pub classes: &'a [Class],
    /// Features of one window.
    pub feature_count: usize,
    /// Windows x features, one window after the other.
    pub features: &'a [f64],
    /// Index of each window's class.
    pub labels: &'a [usize],
    /// Time from one window to the next, s: how much the windows count beside other people's.
    pub increment_s: f64,
    /// Number of the repetition or block that each window belongs to. Windows of different blocks should
    /// share no samples.
    pub blocks: &'a [usize],
}

impl<'a> Training<'a> {
    /// Number of windows.
    pub(crate) fn len(&self) -> usize {
        self.labels.len()
    }

    /// The windows, one slice each.
    pub(crate) fn windows(&self) -> impl Iterator<Item = &'a [f64]> {
        self.features.chunks_exact(self.feature_count.max(1))
    }

    /// Checks everything but the number of windows.
    pub(crate) fn check(&self) -> Result<(), FitError> {
        let Training { classes, feature_count, features, labels, increment_s, blocks } = *self;
        if classes.len() < 2 {
            return Err(FitError::TooFewClasses(classes.len()));
        }
        if let Some(class) = classes.iter().find(|class| !(class.weight.is_normal() && class.weight > 0.0)) {
            return Err(FitError::Weight { class: class.name.clone(), weight: class.weight });
        }
        if !(increment_s.is_finite() && increment_s > 0.0) {
            return Err(FitError::Increment(increment_s));
        }
        let fits = feature_count > 0
            && features.len().checked_div(feature_count) == Some(labels.len())
            && features.len().is_multiple_of(feature_count)
            && blocks.len() == labels.len();
        if !fits {
            return Err(FitError::Shape {
                values: features.len(),
                labels: labels.len(),
                blocks: blocks.len(),
                length: feature_count,
            });
        }
        if let Some((window, &label)) = labels.iter().enumerate().find(|(_, label)| **label >= classes.len())
        {
            return Err(FitError::Label { window, label, classes: classes.len() });
        }
        match self.windows().position(|window| !window.iter().all(|value| value.is_finite())) {
            Some(window) => Err(FitError::NotFinite { window }),
            None => Ok(()),
        }
    }

    /// Number of windows of each class.
    pub(crate) fn counts(&self) -> Vec<usize> {
        let mut counts = vec![0; self.classes.len()];
        self.labels.iter().for_each(|&label| counts[label] += 1);
        counts
    }

    /// Checks that every class has at least `needed` windows.
    pub(crate) fn check_counts(&self, needed: usize) -> Result<(), FitError> {
        match self.counts().iter().zip(self.classes).find(|(windows, _)| **windows < needed) {
            Some((&windows, class)) => {
                Err(FitError::TooFewWindows { class: class.name.clone(), windows, needed })
            }
            None => Ok(()),
        }
    }

    /// Number of repetitions or blocks.
    pub(crate) fn repetitions(&self) -> usize {
        self.blocks.iter().collect::<BTreeSet<_>>().len()
    }

    /// The weight of each class, with a sum of 1.
    pub(crate) fn shares(&self) -> Vec<f64> {
        // Divided by the largest first, so that no sum overflows.
        let largest = self.classes.iter().fold(0.0_f64, |largest, class| largest.max(class.weight));
        let sum: f64 = self.classes.iter().map(|class| class.weight / largest).sum();
        self.classes.iter().map(|class| class.weight / largest / sum).collect()
    }

    /// Mean of each class, one a column; 0 for a class without windows.
    pub(crate) fn means(&self) -> DMatrix<f64> {
        let mut means = DMatrix::zeros(self.feature_count, self.classes.len());
        for (window, &label) in self.windows().zip(self.labels) {
            for (mean, value) in means.column_mut(label).iter_mut().zip(window) {
                *mean += value;
            }
        }
        for (mut mean, count) in means.column_iter_mut().zip(self.counts()) {
            mean /= count.max(1) as f64;
        }
        means
    }

    /// The windows less the mean of their class, one a column.
    pub(crate) fn centred(&self, means: &DMatrix<f64>) -> DMatrix<f64> {
        let mut centred = DMatrix::from_column_slice(self.feature_count, self.len(), self.features);
        for (mut window, &label) in centred.column_iter_mut().zip(self.labels) {
            window -= means.column(label);
        }
        centred
    }
}
