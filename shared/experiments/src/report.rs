//! The results as Markdown: each table of the paper with the paper's own values beside ours.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use tendon_evaluation::{GestureWindows, Scores, Spread, StrategyScores, in_words};
use tendon_gesture::{Gesture, Strategy};
use tendon_identity::list_of;

use crate::paper::{Paper, PaperModel};
use crate::run::Results;

/// The whole report.
pub fn text(paper: &Paper, results: &[Results]) -> String {
    let mut report = Report { text: String::new(), paper, results };
    report.write().expect("writing to a string does not fail");
    report.text
}

struct Report<'a> {
    text: String,
    paper: &'a Paper,
    results: &'a [Results],
}

/// Comparisons of the paper: the one it found better, the other, and what it concluded.
const ORDERINGS: [(&str, &str, &str); 5] = [
    ("cnn-raw", "cnn-envelope", "the filtered signal over its envelope, for the CNN"),
    ("lstm-envelope", "lstm-raw", "the envelope over the filtered signal, for the LSTM"),
    ("cnn-raw", "lstm-raw", "the CNN over the LSTM, on the filtered signal"),
    ("cnn-envelope", "lstm-envelope", "the CNN over the LSTM, on the envelope"),
    ("cnn-raw", "cnn-percentile", "onsets from the baseline over those from percentiles"),
];

impl Report<'_> {
    fn write(&mut self) -> std::fmt::Result {
        writeln!(self.text, "# The paper's experiments, repeated\n")?;
        writeln!(
            self.text,
            "\"Paper\" is what the paper printed, on the Ozdemir data set (35 people trained, five held out). Every \
             other column names its data set. Accuracies are of people whom the model has never seen, each value \
             that of the first seed unless a spread is given.\n"
        )?;
        for source in ["Ozdemir", "3DC"] {
            if !self.results.iter().any(|results| results.source == source) {
                let option = if source == "3DC" { "three-dc" } else { "ozdemir" };
                writeln!(
                    self.text,
                    "- {source}: no recordings were given, so no column: `scripts/fetch-data {}`, then \
                     `tendon experiments --{option} FOLDER`.",
                    option.replace("three-dc", "3dc")
                )?;
            }
        }
        for results in self.results {
            let trained = results.datasets.values().next().map(|manifest| &manifest.split.train_people[..]);
            writeln!(
                self.text,
                "- {}: scored on people {}; models are trained on people {}.",
                results.source,
                list_of(&results.tested_people),
                list_of(trained.unwrap_or_default())
            )?;
            for missing in &results.missing {
                writeln!(self.text, "- {}: {missing}.", results.source)?;
            }
        }
        self.datasets()?;
        self.onsets()?;
        self.orderings()?;
        self.models("Onset detection: models of both methods", &["cnn-raw", "cnn-percentile"])?;
        writeln!(
            self.text,
            "\nThe paper's table of windows counts whole recordings (77 windows of 300 ms each), cut at no onset; ours \
             are cut at onsets from the baseline, as in all other tables.\n"
        )?;
        self.models("Windows of 250, 300 and 350 ms", &["window-250", "window-300", "window-350"])?;
        self.models("CNN: filtered signal and envelope", &["cnn-raw", "cnn-envelope"])?;
        self.models("LSTM: filtered signal and envelope", &["lstm-raw", "lstm-envelope"])?;
        self.models("The five gestures", &["five-gesture"])?;
        self.models("Other class sets", &["rest-move", "four-gesture", "two-gesture"])?;
        self.strategies()?;
        self.repetitions()?;
        self.latency()
    }

    fn datasets(&mut self) -> std::fmt::Result {
        writeln!(self.text, "\n## Data sets\n")?;
        for results in self.results {
            writeln!(
                self.text,
                "{}\n\n| data set | window, increment | input | recordings | windows | left out |\n|---|---|---|---|---|---|",
                results.source
            )?;
            for (name, manifest) in &results.datasets {
                let settings = &manifest.settings;
                writeln!(
                    self.text,
                    "| {name} | {}, {} samples | {} | {} | {} | {} |",
                    settings.windows.window_samples,
                    settings.windows.increment_samples,
                    format!("{:?}", settings.input).to_lowercase(),
                    manifest.recordings.len(),
                    manifest.windows,
                    manifest.skipped.len()
                )?;
            }
            writeln!(self.text)?;
        }
        Ok(())
    }

    /// The table of fallbacks.
    fn onsets(&mut self) -> std::fmt::Result {
        writeln!(self.text, "## Onset detection: recordings without an onset, and onset times\n")?;
        for (method, dataset) in [("baseline", "raw"), ("peak-percentile", "peak-percentile")] {
            let paper = &self.paper.onsets[method];
            write!(self.text, "{method}\n\n| gesture | paper |")?;
            self.results.iter().try_for_each(|results| write!(self.text, " {} |", results.source))?;
            write!(self.text, "\n|---|---|{}\n", "---|".repeat(self.results.len()))?;
            for gesture in Gesture::PAPER_ACTIVE.each_ref().map(Gesture::name).into_iter().chain(["total"]) {
                let of = if gesture == "total" { 1000 } else { 200 };
                let count = paper.fallbacks[gesture];
                write!(
                    self.text,
                    "| {gesture} | {count}/{of} ({:.1} %) |",
                    100.0 * count as f64 / f64::from(of)
                )?;
                for results in self.results {
                    match results.datasets.get(dataset).and_then(|manifest| manifest.onsets.get(gesture)) {
                        Some(onsets) => write!(
                            self.text,
                            " {}/{} ({:.1} %) |",
                            onsets.fallbacks, onsets.recordings, onsets.fallback_percent
                        )?,
                        None => write!(self.text, " – |")?,
                    }
                }
                writeln!(self.text)?;
            }
            write!(
                self.text,
                "| onset, ms | mean {:.1}, sd {:.1}, {:.1} to {:.1} |",
                paper.mean_ms, paper.sd_ms, paper.min_ms, paper.max_ms
            )?;
            for results in self.results {
                match results.datasets.get(dataset).and_then(|manifest| manifest.onsets.get("total")) {
                    Some(onsets) => write!(
                        self.text,
                        " mean {:.1}, sd {:.1}, {:.1} to {:.1} |",
                        onsets.mean_ms, onsets.sd_ms, onsets.min_ms, onsets.max_ms
                    )?,
                    None => write!(self.text, " – |")?,
                }
            }
            writeln!(self.text, "\n")?;
        }
        Ok(())
    }

    /// What the paper found better, and whether it is here.
    fn orderings(&mut self) -> std::fmt::Result {
        writeln!(self.text, "## What the paper found better, and what we find\n")?;
        writeln!(
            self.text,
            "Accuracy: mean ± standard deviation over the seeds (lowest to highest). \"Agrees\" where the means are in \
             the paper's order; a difference smaller than the spreads together says little.\n"
        )?;
        writeln!(
            self.text,
            "| the paper: | better | worse | data set | better | worse | |\n|---|---|---|---|---|---|---|"
        )?;
        for (better, worse, words) in ORDERINGS {
            let paper = [better, worse].map(|name| self.paper.models[name].accuracy);
            for results in self.results {
                let spread = |name: &str| results.models.get(name).map(|runs| accuracy_spread(runs));
                let (Some(first), Some(second)) = (spread(better), spread(worse)) else {
                    writeln!(
                        self.text,
                        "| {words} | {:.4} | {:.4} | {} | not trained | | |",
                        paper[0], paper[1], results.source
                    )?;
                    continue;
                };
                let seeds = |name: &str| results.models.get(name).map_or(0, Vec::len);
                let difference = first.mean - second.mean;
                let order = if difference > 0.0 { "agrees" } else { "**disagrees**" };
                let verdict = if seeds(better).min(seeds(worse)) < 2 {
                    format!("{order}, by one seed")
                } else if difference.abs() > first.sd + second.sd {
                    order.to_owned()
                } else {
                    format!("{order}, within the spread")
                };
                let said = |name: &str, spread: &Spread| match seeds(name) {
                    1 => format!("{:.4} (one seed)", spread.mean),
                    seeds => format!(
                        "{:.4} ± {:.4} ({:.4} to {:.4}, {seeds} seeds)",
                        spread.mean, spread.sd, spread.min, spread.max
                    ),
                };
                writeln!(
                    self.text,
                    "| {words} | {:.4} | {:.4} | {} | {} | {} | {verdict} |",
                    paper[0],
                    paper[1],
                    results.source,
                    said(better, &first),
                    said(worse, &second)
                )?;
            }
        }
        writeln!(self.text)
    }

    /// Scores of some models, each with the paper's beside.
    fn models(&mut self, title: &str, names: &[&str]) -> std::fmt::Result {
        writeln!(self.text, "## {title}\n")?;
        for &name in names {
            // The windows of 300 ms are those of all other models.
            let own = if name == "window-300" { "cnn-raw" } else { name };
            let results = self.results;
            let runs: Vec<(&str, &[Scores])> = results
                .iter()
                .filter_map(|results| Some((results.source, results.models.get(own)?.as_slice())))
                .collect();
            let paper = self.paper.models.get(name);
            writeln!(self.text, "### {name}\n")?;
            if let Some(paper) = paper {
                writeln!(self.text, "{}", paper_line(paper))?;
            }
            for (source, runs) in &runs {
                writeln!(self.text, "{}", own_line(source, runs))?;
            }
            self.model_table(paper, &runs)?;
            for (source, runs) in &runs {
                let Some(stem) = Path::new(&runs[0].model).file_stem() else { continue };
                writeln!(
                    self.text,
                    "![confusion matrix of {name}, {source}]({}/figures/{}-confusion.png)\n",
                    source.to_lowercase(),
                    stem.to_string_lossy()
                )?;
            }
        }
        Ok(())
    }

    /// Precision, recall and F1 of every class, the paper's and those of each source.
    fn model_table(&mut self, paper: Option<&PaperModel>, runs: &[(&str, &[Scores])]) -> std::fmt::Result {
        write!(self.text, "\n| class |")?;
        if paper.is_some() {
            write!(self.text, " paper: precision, recall, F1 (windows) |")?;
        }
        for (source, _) in runs {
            write!(self.text, " {source}: precision, recall, F1 (windows) |")?;
        }
        let columns = runs.len() + usize::from(paper.is_some());
        write!(self.text, "\n|---|{}\n", "---|".repeat(columns))?;
        let classes: Vec<&str> = match (runs.first(), paper) {
            (Some((_, runs)), _) => runs[0].evaluation.classes.iter().map(String::as_str).collect(),
            (None, Some(paper)) => {
                let known = Gesture::PAPER.each_ref().map(Gesture::name).into_iter();
                known.filter(|class| paper.per_class.contains_key(*class)).collect()
            }
            (None, None) => Vec::new(),
        };
        for class in classes {
            write!(self.text, "| {class} |")?;
            if let Some(paper) = paper {
                let [precision, recall, f1, windows] = paper.per_class[class];
                write!(self.text, " {precision:.4}, {recall:.4}, {f1:.4} ({windows:.0}) |")?;
            }
            for (_, runs) in runs {
                let scores = &runs[0].evaluation.per_class[class];
                write!(
                    self.text,
                    " {:.4}, {:.4}, {:.4} ({}) |",
                    scores.precision, scores.recall, scores.f1, scores.support
                )?;
            }
            writeln!(self.text)?;
        }
        writeln!(self.text)
    }

    fn strategies(&mut self) -> std::fmt::Result {
        writeln!(
            self.text,
            "## The three strategies, offline on continuous recordings\n\nShares of windows, in percent, of people never \
             seen in training; the paper's are of one person's recordings made for it.\n"
        )?;
        Strategy::ALL.into_iter().try_for_each(|strategy| self.strategy_table(strategy))?;
        self.strategies_compared()
    }

    /// Shares of windows by gesture, the paper's and those of each source.
    fn strategy_table(&mut self, strategy: Strategy) -> std::fmt::Result {
        let paper = &self.paper.strategies[strategy.name()];
        let results = self.results;
        let all: Vec<(&str, &StrategyScores)> = results
            .iter()
            .filter_map(|results| Some((results.source, results.strategies.get(strategy.name())?)))
            .collect();
        write!(self.text, "### {}\n\n| gesture | paper: moving, correct |", strategy.name())?;
        for (source, _) in &all {
            write!(self.text, " {source}: windows | moving | correct | correct of moving |")?;
        }
        write!(self.text, "\n|---|---|{}\n", "---|---|---|---|".repeat(all.len()))?;
        for gesture in Gesture::PAPER.each_ref().map(Gesture::name) {
            let said = |shares: &BTreeMap<String, f64>| {
                shares.get(gesture).map_or("–".to_owned(), |share| format!("{share:.2}"))
            };
            let (moving, correct) = (said(&paper.moving_percent), said(&paper.correct_percent));
            write!(self.text, "| {gesture} | {moving}, {correct} |")?;
            for (_, scores) in &all {
                match scores.per_gesture.get(gesture) {
                    Some(GestureWindows {
                        windows,
                        moving_percent,
                        correct_percent,
                        correct_of_moving_percent,
                        ..
                    }) => write!(
                        self.text,
                        " {windows} | {moving_percent:.2} | {correct_percent:.2} | {} |",
                        in_words(*correct_of_moving_percent, 2)
                    )?,
                    None => write!(self.text, " – | – | – | – |")?,
                }
            }
            writeln!(self.text)?;
        }
        writeln!(self.text)
    }

    /// What the strategies come to, side by side.
    fn strategies_compared(&mut self) -> std::fmt::Result {
        write!(self.text, "### Compared\n\n| |")?;
        for results in self.results {
            for strategy in Strategy::ALL {
                write!(self.text, " {} {} |", results.source, strategy.name())?;
            }
        }
        write!(self.text, "\n|---|{}\n", "---|".repeat(3 * self.results.len()))?;
        type Row = (&'static str, fn(&StrategyScores) -> String);
        let rows: [Row; 13] = [
            ("mean of the gestures, correct %", |scores| in_words(scores.mean_correct_percent, 2)),
            ("windows after an onset: right command, %", |scores| percent(scores.correct_share)),
            ("windows after an onset: another gesture, %", |scores| percent(scores.wrong_gesture_share)),
            ("windows after an onset: wrong direction, %", |scores| percent(scores.wrong_direction_share)),
            ("windows of rest taken for movement, %", |scores| percent(scores.rest_taken_for_movement_share)),
            ("false activations a minute of rest", |scores| {
                in_words(scores.rest_false_activations_per_min, 2)
            }),
            ("wrong motion, mm a minute", |scores| in_words(scores.wrong_motion_mm_per_min, 0)),
            ("gripper: false activations a minute", |scores| {
                in_words(scores.gripper_false_activations_per_min, 2)
            }),
            ("grips answered, %", |scores| in_words(scores.grips_answered_percent, 1)),
            ("changes of direction a minute", |scores| in_words(scores.direction_changes_per_min, 2)),
            ("onset to first correct command, median (mean, sd; p90), ms", |scores| {
                let times = &scores.onset_to_first_correct_command_ms;
                let [median, mean, sd, p90] =
                    [times.median, times.mean, times.sd, times.p90].map(|time| in_words(time, 0));
                format!("{median} ({mean}, {sd}; {p90})")
            }),
            ("movements never answered", |scores| {
                let never = scores.never_answered.unwrap_or(0);
                format!("{never} of {}", never + scores.onset_to_first_correct_command_ms.count)
            }),
            ("window start to command, computing alone, mean, ms", |scores| {
                in_words(scores.window_start_to_command_ms.mean, 2)
            }),
        ];
        for (words, value) in rows {
            write!(self.text, "| {words} |")?;
            for results in self.results {
                for strategy in Strategy::ALL {
                    let said = results.strategies.get(strategy.name()).map_or("–".to_owned(), value);
                    write!(self.text, " {said} |")?;
                }
            }
            writeln!(self.text)?;
        }
        writeln!(self.text)
    }

    /// The paper's table of repetitions, for each strategy.
    fn repetitions(&mut self) -> std::fmt::Result {
        writeln!(self.text, "## Correct windows of every repetition, %\n")?;
        for results in self.results {
            for strategy in Strategy::ALL {
                let Some(scores) = results.strategies.get(strategy.name()) else { continue };
                writeln!(
                    self.text,
                    "{}, {}\n\n| person, session, repetition | {} |\n|---|{}",
                    results.source,
                    strategy.name(),
                    Gesture::PAPER.each_ref().map(Gesture::name).join(" | "),
                    "---|".repeat(Gesture::PAPER.len())
                )?;
                for row in &scores.per_repetition {
                    write!(self.text, "| {}, {}, {} |", row.person, row.session, row.repetition)?;
                    for gesture in Gesture::PAPER.each_ref().map(Gesture::name) {
                        match row.correct_percent.get(gesture) {
                            Some(percent) => write!(self.text, " {percent:.1} |")?,
                            None => write!(self.text, " – |")?,
                        }
                    }
                    writeln!(self.text)?;
                }
                writeln!(self.text)?;
            }
        }
        Ok(())
    }

    fn latency(&mut self) -> std::fmt::Result {
        let paper = &self.paper.latency;
        writeln!(
            self.text,
            "## Latency: window start to command, live\n\nOne recording at its true pace through all processes.\n\n\
             | | windows | mean, ms | sd | min | median | max |\n|---|---|---|---|---|---|---|\n\
             | paper | – | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
            paper.mean_ms, paper.sd_ms, paper.min_ms, paper.median_ms, paper.max_ms
        )?;
        for results in self.results {
            for strategy in Strategy::ALL {
                let Some(report) = results.live.get(strategy.name()) else { continue };
                let latency = &report.window_start_to_command;
                writeln!(
                    self.text,
                    "| {}, {} | {} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
                    results.source,
                    strategy.name(),
                    latency.count,
                    latency.mean_ms,
                    latency.sd_ms,
                    latency.min_ms,
                    latency.median_ms,
                    latency.max_ms
                )?;
            }
        }
        for results in self.results.iter().filter(|results| !results.live.is_empty()) {
            for strategy in results.live.keys() {
                writeln!(
                    self.text,
                    "\n![window start to command, {0}, {strategy}]({1}/figures/{strategy}/window-start-to-command.png)",
                    results.source,
                    results.source.to_lowercase()
                )?;
            }
        }
        Ok(())
    }
}

/// A share in percent.
fn percent(share: Option<f64>) -> String {
    in_words(share.map(|share| 100.0 * share), 2)
}

fn accuracy_spread(runs: &[Scores]) -> Spread {
    Spread::of(&runs.iter().map(|scores| scores.evaluation.accuracy).collect::<Vec<f64>>())
}

fn paper_line(paper: &PaperModel) -> String {
    let mut line = format!("- paper: accuracy {:.4}", paper.accuracy);
    if let Some(loss) = paper.loss {
        line += &format!(", loss {loss:.4}");
    }
    if let Some(accuracy) = paper.validation_accuracy {
        line += &format!(", validation accuracy {accuracy:.4}");
    }
    if let Some(windows) = paper.training_windows {
        line += &format!(", {windows} windows trained on and validated");
    }
    line
}

fn own_line(source: &str, runs: &[Scores]) -> String {
    let first = &runs[0];
    let mut line =
        format!("- {source}: accuracy {:.4}, loss {:.4}", first.evaluation.accuracy, first.evaluation.loss);
    if runs.len() > 1 {
        let spread = accuracy_spread(runs);
        line += &format!(" (accuracy of {} seeds {:.4} ± {:.4})", runs.len(), spread.mean, spread.sd);
    }
    if let Some(accuracy) = first.validation_accuracy {
        line += &format!(", validation accuracy {accuracy:.4}");
    }
    let people = &first.evaluation.people_spread;
    line += &format!(", by person {:.4} to {:.4}", people.min, people.max);
    if let Some(pair) = &first.evaluation.most_confused {
        line += &format!(
            ", most confused: {} taken for {} ({} windows)",
            pair.truth, pair.predicted, pair.windows
        );
    }
    line
}
