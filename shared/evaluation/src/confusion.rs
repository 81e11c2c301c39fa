//! Counts of a classifier's answers, and the scores that follow from them.

use serde::{Deserialize, Serialize};

/// Counts of answers: one row a true class, one column a predicted class. A window without an answer counts as one of its
/// class that was not recognised.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Confusion {
    classes: usize,
    counts: Vec<u64>,
    /// Windows of each true class to which there was no answer.
    unanswered: Vec<u64>,
}

/// Scores of a class, or averages of them. Where a score would divide by zero, as for a class that never occurs, it
/// is 0, as with scikit-learn's `zero_division=0`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClassScores {
    /// Share of the windows predicted as this class that are of it.
    pub precision: f64,
    /// Share of the windows of this class that are predicted as it.
    pub recall: f64,
    /// Harmonic mean of precision and recall.
    pub f1: f64,
    /// Windows of this class; of averages, all windows.
    pub support: u64,
}

impl Confusion {
    /// No answers yet, for this many classes.
    pub fn new(classes: usize) -> Confusion {
        Confusion { classes, counts: vec![0; classes * classes], unanswered: vec![0; classes] }
    }

    /// Counts one answer.
    ///
    /// # Panics
    ///
    /// When there is no such class.
    pub fn record(&mut self, truth: usize, predicted: usize) {
        assert!(truth < self.classes && predicted < self.classes, "there are {} classes", self.classes);
        self.counts[truth * self.classes + predicted] += 1;
    }

    /// Counts a window to which there was no answer.
    ///
    /// # Panics
    ///
    /// When there is no such class.
    pub fn record_unanswered(&mut self, truth: usize) {
        self.unanswered[truth] += 1;
    }

    /// Windows to which there was no answer.
    pub fn unanswered(&self) -> u64 {
        self.unanswered.iter().sum()
    }

    /// Number of classes.
    pub fn classes(&self) -> usize {
        self.classes
    }

    /// Windows of class `truth` that were predicted as `predicted`.
    pub fn count(&self, truth: usize, predicted: usize) -> u64 {
        self.counts[truth * self.classes + predicted]
    }

    /// Windows of a class.
    pub fn support(&self, truth: usize) -> u64 {
        let answered: u64 = (0..self.classes).map(|predicted| self.count(truth, predicted)).sum();
        answered + self.unanswered[truth]
    }

    /// Windows predicted as a class.
    pub fn predicted(&self, predicted: usize) -> u64 {
        (0..self.classes).map(|truth| self.count(truth, predicted)).sum()
    }

    /// All windows.
    pub fn windows(&self) -> u64 {
        self.counts.iter().sum::<u64>() + self.unanswered()
    }

    /// Windows whose class was predicted.
    pub fn correct(&self) -> u64 {
        (0..self.classes).map(|class| self.count(class, class)).sum()
    }

    /// Share of windows whose class was predicted; 0 of none.
    pub fn accuracy(&self) -> f64 {
        share(self.correct(), self.windows())
    }

    /// What share of a class's windows was predicted as `predicted`, in percent.
    pub fn row_percent(&self, truth: usize, predicted: usize) -> f64 {
        100.0 * share(self.count(truth, predicted), self.support(truth))
    }

    /// Scores of a class.
    pub fn scores(&self, class: usize) -> ClassScores {
        let correct = self.count(class, class);
        let (support, predicted) = (self.support(class), self.predicted(class));
        ClassScores {
            precision: share(correct, predicted),
            recall: share(correct, support),
            f1: share(2 * correct, support + predicted),
            support,
        }
    }

    /// Averages in which every class that occurs, or is predicted, counts the same.
    pub fn macro_average(&self) -> ClassScores {
        self.average(|_| 1)
    }

    /// Averages in which every class counts by its windows.
    pub fn weighted_average(&self) -> ClassScores {
        self.average(|scores| scores.support)
    }

    /// The two different classes taken for each other most often, in that direction, and how often; `None` when no
    /// window was mistaken. Of equals the first in the order of the classes.
    pub fn most_confused(&self) -> Option<(usize, usize, u64)> {
        let mut most = None;
        let mut most_count = 0;
        for truth in 0..self.classes {
            for predicted in (0..self.classes).filter(|predicted| *predicted != truth) {
                let count = self.count(truth, predicted);
                if count > most_count {
                    most_count = count;
                    most = Some((truth, predicted, count));
                }
            }
        }
        most
    }

    fn average(&self, weight: impl Fn(&ClassScores) -> u64) -> ClassScores {
        let occurring = (0..self.classes).filter(|class| self.support(*class) + self.predicted(*class) > 0);
        let scores: Vec<(ClassScores, f64)> = occurring
            .map(|class| self.scores(class))
            .map(|scores| (scores, weight(&scores) as f64))
            .collect();
        let total: f64 = scores.iter().map(|(_, weight)| weight).sum();
        let mean = |value: fn(&ClassScores) -> f64| {
            let sum: f64 = scores.iter().map(|(scores, weight)| value(scores) * weight).sum();
            if total > 0.0 { sum / total } else { 0.0 }
        };
        ClassScores {
            precision: mean(|scores| scores.precision),
            recall: mean(|scores| scores.recall),
            f1: mean(|scores| scores.f1),
            support: self.windows(),
        }
    }
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 / whole as f64 }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::{prop, proptest};

    use super::*;

    fn of(answers: &[(usize, usize)], classes: usize) -> Confusion {
        let mut confusion = Confusion::new(classes);
        answers.iter().for_each(|(truth, predicted)| confusion.record(*truth, *predicted));
        confusion
    }

    #[test]
    fn scores_of_a_small_case_by_hand() {
        let confusion = of(&[(0, 0), (0, 0), (0, 1), (1, 1), (1, 0), (1, 0)], 2);
        assert_eq!(confusion.accuracy(), 0.5);
        let first = confusion.scores(0);
        assert_eq!((first.precision, first.recall, first.support), (0.5, 2.0 / 3.0, 3));
        assert!((first.f1 - 4.0 / 7.0).abs() < 1e-15);
        assert_eq!(confusion.most_confused(), Some((1, 0, 2)));
        assert!((confusion.row_percent(1, 0) - 200.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_recorded_gives_zeros_and_no_confusion() {
        let confusion = Confusion::new(3);
        assert_eq!((confusion.accuracy(), confusion.macro_average().f1), (0.0, 0.0));
        assert_eq!(confusion.most_confused(), None);
    }

    #[test]
    fn of_equal_confusions_the_first_is_named() {
        assert_eq!(of(&[(2, 0), (1, 2), (0, 0)], 3).most_confused(), Some((1, 2, 1)));
    }

    proptest! {
        #[test]
        fn scores_stay_within_their_ranges(answers in prop::collection::vec((0..5_usize, 0..5_usize), 1..300)) {
            let confusion = of(&answers, 5);
            assert_eq!(confusion.windows() as usize, answers.len());
            for class in 0..5 {
                let scores = confusion.scores(class);
                for value in [scores.precision, scores.recall, scores.f1] {
                    assert!((0.0..=1.0).contains(&value));
                }
                let percents: f64 = (0..5).map(|predicted| confusion.row_percent(class, predicted)).sum();
                assert!(confusion.support(class) == 0 || (percents - 100.0).abs() < 1e-9);
            }
            // Weighted by support, the recalls add up to the accuracy.
            assert!((confusion.weighted_average().recall - confusion.accuracy()).abs() < 1e-12);
        }
    }
}
