//! What an evaluation says: as JSON with stable keys, and as a table.

use std::collections::BTreeMap;
use std::fmt::{self, Display};

use serde::{Deserialize, Serialize};
use tendon_identity::PersonId;
use tendon_report::LatencySummary;

use crate::confusion::ClassScores;
use crate::tally::{Group, Tally};

/// Scores of a classifier on a data set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Classes, in the order of the classifier's outputs.
    pub classes: Vec<String>,
    /// Windows classified.
    pub windows: u64,
    /// Windows of gestures that the classifier does not know, by gesture.
    pub windows_left_out: BTreeMap<String, u64>,
    /// Windows, among those classified, for which the classifier gave numbers that are not finite: no answer.
    #[serde(default)]
    pub windows_without_answer: u64,
    /// Mean cross-entropy, in nats.
    pub loss: f64,
    /// Share of windows whose class was predicted.
    pub accuracy: f64,
    /// Scores of each class, by name.
    pub per_class: BTreeMap<String, ClassScores>,
    /// Every class counts the same.
    pub macro_average: ClassScores,
    /// Every class counts by its windows.
    pub weighted_average: ClassScores,
    /// Windows: one row a true class, one column a predicted class.
    pub confusion: Vec<Vec<u64>>,
    /// The same in percent of the row.
    pub confusion_row_percent: Vec<Vec<f64>>,
    /// The classes mistaken most often; missing when no window was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub most_confused: Option<ConfusedPair>,
    /// Accuracy of each person.
    pub per_person: BTreeMap<PersonId, Group>,
    /// How much people differ.
    pub people_spread: Spread,
    /// Accuracy of each repetition, by number.
    pub per_repetition: BTreeMap<u8, Group>,
    /// How much repetitions differ.
    pub repetitions: Spread,
    /// Time that one window took.
    pub work: LatencySummary,
}

/// A class and what it is taken for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConfusedPair {
    /// What it is.
    pub truth: String,
    /// What it is taken for.
    pub predicted: String,
    /// How many windows.
    pub windows: u64,
}

/// How much values differ. Every value counts the same; all are 0 without values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation (of the sample); 0 of less than two.
    pub sd: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    /// The spread of `values`.
    pub fn of(values: &[f64]) -> Spread {
        if values.is_empty() {
            return Spread::default();
        }
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Spread {
            mean,
            sd: if values.len() < 2 { 0.0 } else { (squares / (count - 1.0)).sqrt() },
            min: values.iter().copied().fold(f64::INFINITY, f64::min),
            max: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        }
    }

    fn of_groups<'a>(groups: impl Iterator<Item = &'a Group>) -> Spread {
        Spread::of(&groups.map(|group| group.accuracy).collect::<Vec<f64>>())
    }
}

impl Evaluation {
    /// The scores of the answers so far.
    pub fn of(tally: &Tally) -> Evaluation {
        let Tally { classes, confusion, loss_sum, people, repetitions, work, windows_left_out } = tally;
        let name = |class: usize| classes[class].name().to_owned();
        let windows = confusion.windows();
        let all = 0..classes.len();
        Evaluation {
            classes: all.clone().map(name).collect(),
            windows,
            windows_left_out: windows_left_out
                .iter()
                .map(|(gesture, count)| (gesture.name().to_owned(), *count))
                .collect(),
            windows_without_answer: confusion.unanswered(),
            loss: if windows == 0 { 0.0 } else { loss_sum / windows as f64 },
            accuracy: confusion.accuracy(),
            per_class: all.clone().map(|class| (name(class), confusion.scores(class))).collect(),
            macro_average: confusion.macro_average(),
            weighted_average: confusion.weighted_average(),
            confusion: all
                .clone()
                .map(|truth| all.clone().map(|predicted| confusion.count(truth, predicted)).collect())
                .collect(),
            confusion_row_percent: all
                .clone()
                .map(|truth| all.clone().map(|predicted| confusion.row_percent(truth, predicted)).collect())
                .collect(),
            most_confused: confusion.most_confused().map(|(truth, predicted, windows)| ConfusedPair {
                truth: name(truth),
                predicted: name(predicted),
                windows,
            }),
            per_person: people.clone(),
            people_spread: Spread::of_groups(people.values()),
            per_repetition: repetitions.clone(),
            repetitions: Spread::of_groups(repetitions.values()),
            work: LatencySummary::of(work),
        }
    }
}

/// The evaluation as tables for people.
impl Display for Evaluation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(out, "accuracy {:.4}, loss {:.4}, {} windows", self.accuracy, self.loss, self.windows)?;
        for (gesture, windows) in &self.windows_left_out {
            writeln!(out, "left out: {windows} windows of {gesture}, which the model does not know")?;
        }
        if self.windows_without_answer > 0 {
            writeln!(
                out,
                "no answer: {} windows, for which the outputs are not finite numbers; they count as not recognised",
                self.windows_without_answer
            )?;
        }
        writeln!(out, "\n{:<18}{:>10}{:>10}{:>10}{:>10}", "class", "precision", "recall", "F1", "windows")?;
        let averages = [("macro average", &self.macro_average), ("weighted average", &self.weighted_average)];
        let classes = self.classes.iter().map(|class| (class.as_str(), &self.per_class[class]));
        for (name, ClassScores { precision, recall, f1, support }) in classes.chain(averages) {
            writeln!(out, "{name:<18}{precision:>10.4}{recall:>10.4}{f1:>10.4}{support:>10}")?;
        }
        write!(out, "\n{:<18}", "true \\ predicted")?;
        for class in &self.classes {
            write!(out, "{class:>16}")?;
        }
        writeln!(out)?;
        for ((class, counts), percents) in
            self.classes.iter().zip(&self.confusion).zip(&self.confusion_row_percent)
        {
            write!(out, "{class:<18}")?;
            for (count, percent) in counts.iter().zip(percents) {
                write!(out, "{:>16}", format!("{count} ({percent:.1} %)"))?;
            }
            writeln!(out)?;
        }
        if let Some(ConfusedPair { truth, predicted, windows }) = &self.most_confused {
            writeln!(out, "most confused: {truth} taken for {predicted}, {windows} windows")?;
        }
        writeln!(out)?;
        for (person, group) in &self.per_person {
            writeln!(out, "person {person:<11}{:>10.4}{:>30}", group.accuracy, group.windows)?;
        }
        write_spread(out, "people", &self.people_spread)?;
        for (repetition, group) in &self.per_repetition {
            writeln!(out, "repetition {repetition:<7}{:>10.4}{:>30}", group.accuracy, group.windows)?;
        }
        write_spread(out, "repetitions", &self.repetitions)?;
        let LatencySummary { p50_us, p99_us, max_us, .. } = self.work;
        writeln!(out, "a window took {p50_us:.0} us (p50), {p99_us:.0} us (p99), {max_us:.0} us at most")
    }
}

fn write_spread(out: &mut fmt::Formatter<'_>, of: &str, spread: &Spread) -> fmt::Result {
    let Spread { mean, sd, min, max } = spread;
    writeln!(out, "{of}: mean {mean:.4}, sd {sd:.4}, from {min:.4} to {max:.4}\n")
}
