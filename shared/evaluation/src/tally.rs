//! Gathers a classifier's answers, window by window.

use std::collections::BTreeMap;

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use tendon_gesture::{Class, Gesture};
use tendon_identity::PersonId;
use tendon_report::duration_histogram;

use crate::confusion::Confusion;

/// Whose window it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Origin {
    /// Whose it is.
    pub person: PersonId,
    /// Repetition of the gesture, counted through all sessions of the person.
    pub repetition: u8,
}

/// What a classifier said of a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer<'a> {
    /// Probability of every class, in the order of the classes.
    pub probabilities: &'a [f32],
    /// How long it took, ns.
    pub work_ns: u64,
}

/// Answers for a group of windows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Windows.
    pub windows: u64,
    /// Those whose class was predicted.
    pub correct: u64,
    /// Their share.
    pub accuracy: f64,
}

impl Group {
    fn add(&mut self, is_correct: bool) {
        self.windows += 1;
        self.correct += u64::from(is_correct);
        self.accuracy = self.correct as f64 / self.windows as f64;
    }
}

/// Answers gathered so far.
#[derive(Clone, Debug)]
pub struct Tally {
    pub(crate) classes: Vec<Class>,
    pub(crate) confusion: Confusion,
    /// Sum of −ln p of the true class.
    pub(crate) loss_sum: f64,
    pub(crate) people: BTreeMap<PersonId, Group>,
    pub(crate) repetitions: BTreeMap<u8, Group>,
    pub(crate) work: Histogram<u64>,
    pub(crate) windows_left_out: BTreeMap<Gesture, u64>,
}

impl Tally {
    /// No answers yet, of a classifier that knows these classes, in the order of its outputs.
    pub fn new(classes: &[Class]) -> Tally {
        Tally {
            classes: classes.to_vec(),
            confusion: Confusion::new(classes.len()),
            loss_sum: 0.0,
            people: BTreeMap::new(),
            repetitions: BTreeMap::new(),
            work: duration_histogram(),
            windows_left_out: BTreeMap::new(),
        }
    }

    /// Which class a gesture is; `None`, and counted as left out, when the classifier does not know it.
    pub fn class_of(&mut self, gesture: Gesture) -> Option<usize> {
        let class = self.classes.iter().position(|class| class.includes(gesture));
        if class.is_none() {
            *self.windows_left_out.entry(gesture).or_default() += 1;
        }
        class
    }

    /// Takes the answer for a window of class `truth`. The predicted class is the most probable one, of equals
    /// the first. Probabilities that are not all finite are no answer, and the window is not recognised.
    ///
    /// # Panics
    ///
    /// When the answer has not one probability for each class.
    pub fn record(&mut self, truth: usize, origin: Origin, answer: Answer<'_>) {
        let probabilities = answer.probabilities;
        assert_eq!(probabilities.len(), self.classes.len(), "one probability for each class");
        let predicted = most_probable(probabilities);
        match predicted {
            Some(predicted) => self.confusion.record(truth, predicted),
            None => self.confusion.record_unanswered(truth),
        }
        // As scikit-learn's log_loss: no single window weighs infinitely.
        let probability =
            predicted.map_or(0.0, |_| probabilities[truth]).clamp(f32::EPSILON, 1.0 - f32::EPSILON);
        self.loss_sum -= f64::from(probability).ln();
        let is_correct = predicted == Some(truth);
        self.people.entry(origin.person).or_default().add(is_correct);
        self.repetitions.entry(origin.repetition).or_default().add(is_correct);
        self.work.saturating_record(answer.work_ns);
    }

    /// The classes, in the order of the classifier's outputs.
    pub fn classes(&self) -> &[Class] {
        &self.classes
    }

    /// Time that each answer took, ns.
    pub fn work(&self) -> &Histogram<u64> {
        &self.work
    }

    /// The answers by class.
    pub fn confusion(&self) -> &Confusion {
        &self.confusion
    }
}

/// The most probable class, of equals the first; `None` if a probability is not finite.
fn most_probable(probabilities: &[f32]) -> Option<usize> {
    if !probabilities.iter().all(|probability| probability.is_finite()) {
        return None;
    }
    let mut most = 0;
    for (class, probability) in probabilities.iter().enumerate() {
        if *probability > probabilities[most] {
            most = class;
        }
    }
    Some(most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::Evaluation;

    #[test]
    fn an_output_that_is_no_number_is_no_answer_and_not_the_first_class() {
        let classes = [Gesture::REST, Gesture::GRIP].map(Class::Gesture);
        let mut tally = Tally::new(&classes);
        let origin = Origin { person: PersonId::Number(1), repetition: 0 };
        // All of rest, which is class 0.
        for probabilities in [[f32::NAN; 2], [f32::NAN, 1.0], [0.5, f32::INFINITY], [0.9, 0.1]] {
            tally.record(0, origin, Answer { probabilities: &probabilities, work_ns: 1 });
        }
        let evaluation = Evaluation::of(&tally);
        assert_eq!((evaluation.windows, evaluation.windows_without_answer), (4, 3));
        assert_eq!((evaluation.accuracy, evaluation.per_class["rest"].recall), (0.25, 0.25));
        assert_eq!(evaluation.per_class["rest"].support, 4);
        assert_eq!(evaluation.confusion, [[1, 0], [0, 0]]);
        assert_eq!(evaluation.per_person[&PersonId::Number(1)].correct, 1);
        assert!(evaluation.loss.is_finite() && evaluation.loss > 10.0, "{}", evaluation.loss);
        let text = evaluation.to_string();
        assert!(text.contains("no answer: 3 windows"), "{text}");
    }
}
