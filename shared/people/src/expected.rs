//! What can be expected of a person's recogniser, from the calibration alone.
//!
//! ```text
//! several repetitions   each in turn is recognised by a fit to the others
//! only one, with prior  made-up ones, which differ from it as other people's repetitions differ
//! only one, alone       four parts of it in turn, which are more alike than repetitions are
//! ```
//!
//! Windows of a gesture that are as weak as rest do not count: the person had not begun yet, or paused. They are rest,
//! whatever the cue said.

use serde::{Deserialize, Serialize};
use tendon_features::{
    Class, CrossValidation, Discriminant, FitError, MethodSettings, Prior, Training,
    recognised_in_new_repetitions,
};
use tendon_gesture::Gesture;

use crate::calibration::Calibration;

/// Parts that a gesture's windows are divided into when there is only one repetition.
const PARTS: usize = 4;
/// Two gestures that are taken for each other in a larger share of their windows look alike.
const ALIKE_SHARE: f64 = 0.05;

/// What was held out to be recognised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeldOut {
    /// Whole repetitions.
    Repetitions,
    /// Nothing: repetitions were made up from the only one and from how other people's repetitions differ.
    MadeUpRepetitions,
    /// Parts of the only repetition: what is said is too good.
    PartsOfOneRepetition,
}

/// How well windows are recognised that were held out of the fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expected {
    /// Share of the windows that were recognised; every gesture counts the same.
    pub accuracy: f64,
    /// What was held out.
    pub held_out: HeldOut,
    /// Share of the windows of gestures that were left out because they were as weak as rest.
    #[serde(default)]
    pub without_effort_share: f64,
    /// With made-up repetitions: the accuracy if the next repetitions were like the only one, which is too good. Parts of it in
    /// turn were recognised by a fit to the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub if_alike: Option<f64>,
    /// Windows by gesture made (row) and gesture recognised (column), in the order of the gestures.
    pub confusion: Vec<Vec<usize>>,
}

impl Expected {
    fn of(confusion: Vec<Vec<usize>>, held_out: HeldOut, without_effort_share: f64) -> Expected {
        let share = |(gesture, row): (usize, &Vec<usize>)| {
            row[gesture] as f64 / row.iter().sum::<usize>().max(1) as f64
        };
        let accuracy = confusion.iter().enumerate().map(share).sum::<f64>() / confusion.len().max(1) as f64;
        Expected { accuracy, held_out, without_effort_share, if_alike: None, confusion }
    }

    /// Share of a gesture's windows that were taken for `other`.
    pub(crate) fn taken_for(&self, gesture: usize, other: usize) -> f64 {
        let row = &self.confusion[gesture];
        row[other] as f64 / row.iter().sum::<usize>().max(1) as f64
    }

    /// Pairs of gestures that are often taken for each other, with the mean share of their windows, the most alike first.
    pub(crate) fn alike(&self) -> Vec<(usize, usize, f64)> {
        let gestures = self.confusion.len();
        let pairs = (0..gestures).flat_map(|first| (first + 1..gestures).map(move |second| (first, second)));
        let mut alike: Vec<(usize, usize, f64)> = pairs
            .map(|(a, b)| (a, b, 0.5 * (self.taken_for(a, b) + self.taken_for(b, a))))
            .filter(|(_, _, share)| *share > ALIKE_SHARE)
            .collect();
        alike.sort_by(|(_, _, a), (_, _, b)| b.total_cmp(a));
        alike
    }

    pub(crate) fn is_valid(&self, gestures: usize) -> bool {
        (0.0..=1.0).contains(&self.accuracy)
            && (0.0..=1.0).contains(&self.without_effort_share)
            && self.if_alike.is_none_or(|if_alike| (0.0..=1.0).contains(&if_alike))
            && self.confusion.len() == gestures
            && self.confusion.iter().all(|row| row.len() == gestures)
    }
}

/// Recognises what is held out of `training`, whose labels are those of `calibration`. `discriminant` is fitted to all of
/// it. Only the windows that have effort count; rest has.
pub(crate) fn cross_validate(
    calibration: &Calibration,
    training: &Training,
    has_effort: &[bool],
    discriminant: &Discriminant,
    prior: Option<&Prior>,
    method: &MethodSettings,
) -> Result<(CrossValidation, Expected), FitError> {
    let gestures = training.labels.iter().filter(|label| **label != 0).count();
    let left_out =
        has_effort.iter().filter(|has_effort| !**has_effort).count() as f64 / gestures.max(1) as f64;
    if (0..training.classes.len()).all(|label| calibration.repetitions_of(label).len() > 1) {
        match CrossValidation::new(training, prior, method) {
            // A repetition of a gesture that was hardly made any other time.
            Err(FitError::CannotHoldOut { .. }) => {}
            validation => {
                let validation = validation?;
                let confusion = validation.confusion(|window| has_effort[window]);
                let expected = Expected::of(confusion, HeldOut::Repetitions, left_out);
                return Ok((validation, expected));
            }
        }
    }
    let (windows, parts) = parts(calibration, training);
    let (features, labels) = some(training, &windows);
    let divided = Training { features: &features, labels: &labels, blocks: &parts, ..*training };
    let validation = CrossValidation::new(&divided, prior, method)?;
    let confusion = validation.confusion(|window| has_effort[windows[window]]);
    let of_parts = Expected::of(confusion, HeldOut::PartsOfOneRepetition, left_out);
    let expected = match prior.and_then(Prior::population) {
        Some(population) => {
            let made: Vec<usize> = (0..has_effort.len()).filter(|&window| has_effort[window]).collect();
            let (features, labels) = some(training, &made);
            let blocks = vec![0; labels.len()];
            let made = Training { features: &features, labels: &labels, blocks: &blocks, ..*training };
            let confusion = recognised_in_new_repetitions(&made, discriminant, population)?;
            let expected = Expected::of(confusion, HeldOut::MadeUpRepetitions, left_out);
            Expected { if_alike: Some(of_parts.accuracy), ..expected }
        }
        None => of_parts,
    };
    Ok((validation, expected))
}

/// Features and labels of some of the windows.
fn some(training: &Training, windows: &[usize]) -> (Vec<f64>, Vec<usize>) {
    let length = training.feature_count;
    let features = windows.iter().flat_map(|&window| &training.features[window * length..][..length]);
    (features.copied().collect(), windows.iter().map(|&window| training.labels[window]).collect())
}

/// Divides the windows of each gesture into parts that share no samples: the windows between two parts are left out, at
/// most half of a part. Returns the windows that are left and the part of each.
fn parts(calibration: &Calibration, training: &Training) -> (Vec<usize>, Vec<usize>) {
    let signal = calibration.signal;
    let overlap = signal.window_samples.div_ceil(signal.increment_samples.max(1)).saturating_sub(1);
    let mut of_window = vec![None; training.labels.len()];
    for label in 0..training.classes.len() {
        let own: Vec<usize> =
            (0..training.labels.len()).filter(|&window| training.labels[window] == label).collect();
        for part in 0..PARTS {
            let windows = &own[part * own.len() / PARTS..(part + 1) * own.len() / PARTS];
            let left_out = if part == 0 { 0 } else { overlap.min(windows.len() / 2) };
            windows[left_out..].iter().for_each(|&window| of_window[window] = Some(part));
        }
    }
    of_window.iter().enumerate().filter_map(|(window, part)| part.map(|part| (window, part))).unzip()
}

/// The classes of a person's discriminant: all count the same.
pub(crate) fn classes(gestures: &[Gesture]) -> Vec<Class> {
    gestures.iter().map(|gesture| Class { name: gesture.name().to_owned(), weight: 1.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_gesture_counts_the_same_and_those_that_look_alike_are_named() {
        let confusion = vec![vec![1000, 0, 0], vec![0, 50, 50], vec![0, 0, 10]];
        let expected = Expected::of(confusion, HeldOut::Repetitions, 0.0);
        assert!((expected.accuracy - 2.5 / 3.0).abs() < 1e-12);
        assert_eq!(expected.alike(), [(1, 2, 0.25)]);
    }
}
