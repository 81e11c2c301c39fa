//! `tendon evaluate`: how well a model recognises windows, by the code that runs live.
//!
//! ```text
//! data set ──▶ windows ──┐
//!                        ├─▶ model ─▶ tally ─▶ scores: text, JSON, figures
//! recordings ─▶ cut ─────┘
//! ```

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::{Classifier, Contract, WindowSource};
use tendon_dataset::{DatasetSettings, StoredDataset, cut, list};
use tendon_evaluation::{Answer, Evaluation, Origin, Tally};
use tendon_figures::{confusion_figure, latency_figure};
use tendon_gesture::Gesture;
use tendon_recordings::Channel;
use tendon_signal::WindowSettings;

use crate::Failure;
use crate::progress::Progress;
use crate::run::write_json;

/// Command line of `tendon evaluate`.
#[derive(Debug, Args)]
pub struct Options {
    /// A data set that `tendon dataset build` wrote; or recordings, which are then cut into windows as
    /// `tendon dataset build` does by default, without writing them.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The ONNX model.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Only these people, by number; when left out, all whom the model was not trained on: nobody else can tell how
    /// well it does for somebody new.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<u16>,
    /// Of recordings: channels, in this order.
    #[arg(long, value_delimiter = ',', default_value = "0,3,5,8")]
    channels: Vec<usize>,
    /// ONNX Runtime's shared library; without it, ORT_DYLIB_PATH, then what scripts/fetch-onnxruntime fetched.
    #[arg(long, value_name = "FILE")]
    runtime_library: Option<PathBuf>,
    /// Writes the scores there as JSON, too.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes the confusion matrix and the time that windows took there, as PNG and SVG.
    #[arg(long, value_name = "FOLDER")]
    figures: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
pub struct Scores {
    /// The ONNX file.
    pub model: PathBuf,
    /// A data set, or recordings.
    pub paths: Vec<PathBuf>,
    /// Who was scored.
    pub people: BTreeSet<u16>,
    /// What the model's training got on its validation windows, if the model says so.
    pub validation_accuracy: Option<f64>,
    /// Recordings that could not be used, and why.
    pub skipped: Vec<String>,
    /// Time from the first byte to the last class, s.
    pub duration_s: f64,
    /// Seconds of signal for every second: of recordings, all that was read, windows or not; of a data set, an
    /// increment for every window.
    pub x_real_time: f64,
    /// The scores.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// Windows between two looks at the clock for the progress line, and at memory that is no longer needed.
const WINDOWS_A_ROUND: usize = 256;

/// Evaluates a model.
pub fn evaluate(options: &Options) -> Result<(), Failure> {
    let library =
        tendon_classifier::runtime_library(options.runtime_library.as_deref()).map_err(Failure::input)?;
    let classifier = Classifier::load(&library, &options.model).map_err(Failure::input)?;
    let provenance = classifier.contract().provenance.clone();
    let (scores, tally) = match &options.paths[..] {
        [folder] if StoredDataset::is_one(folder) => score_dataset(classifier, folder, &options.people)?,
        paths => score_recordings(classifier, paths, &options.channels, &options.people)?,
    };
    let people: Vec<String> = scores.people.iter().map(ToString::to_string).collect();
    println!("{} on people {}", options.model.display(), people.join(", "));
    if let Some(provenance) = provenance {
        println!("the model: {provenance}");
    }
    println!("\n{}", scores.evaluation);
    if !scores.skipped.is_empty() {
        println!("{} recordings or trials left out:", scores.skipped.len());
        scores.skipped.iter().for_each(|skipped| println!("  {skipped}"));
    }
    println!("{:.1} s in all, {:.0} times faster than real time", scores.duration_s, scores.x_real_time);
    if let Some(folder) = &options.figures {
        write_figures(folder, &options.model, &tally).map_err(Failure::running)?;
        println!("figures in {}", folder.display());
    }
    if let Some(path) = &options.json {
        write_json(path, &scores).map_err(Failure::running)?;
    }
    Ok(())
}

/// Scores `classifier` on the data set in `folder`.
///
/// # Errors
///
/// When the data set cannot be read, does not fit the model, or holds nothing for it.
pub fn score_dataset(
    classifier: Classifier,
    folder: &Path,
    wanted: &[u16],
) -> Result<(Scores, Tally), Failure> {
    let mut dataset = StoredDataset::open(folder).map_err(Failure::input)?;
    let settings = dataset.manifest().settings.clone();
    let source = WindowSource {
        name: "the data set",
        channels: settings.channels.len(),
        sample_rate_hz: settings.sample_rate_hz,
        window_samples: settings.windows.window_samples,
        sequence_windows: usize::MAX,
        filter: settings.filter.as_ref(),
        input: settings.input,
    };
    classifier.check_fit(&source).map_err(Failure::input)?;
    let known = dataset.manifest().windows_per_person.keys().copied().collect();
    let trained = classifier.contract().people_trained.iter().copied().collect();
    let people = chosen_people(&known, wanted, &trained).map_err(Failure::input)?;
    let mut scorer = Scorer::new(classifier, people);
    let windows = dataset.len();
    let mut progress = Progress::of(windows, "windows");
    for index in 0..windows {
        if index % WINDOWS_A_ROUND == 0 {
            dataset.release_before(index);
            progress.show(index, String::new);
        }
        let window = Window {
            samples: dataset.window(index),
            gesture: dataset.gesture(index),
            person: dataset.person(index),
            repetition: dataset.repetition(index),
            trial: u64::from(dataset.recording(index)),
        };
        scorer.take(&window).with_context(|| format!("window {index}")).map_err(Failure::running)?;
    }
    let increments = scorer.tally.confusion().windows() * settings.windows.increment_samples as u64;
    scorer.finish(vec![folder.to_owned()], increments as f64 / settings.sample_rate_hz, Vec::new())
}

/// Scores `classifier` on the windows that are cut from the recordings at or below `paths`.
///
/// # Errors
///
/// When there are no recordings, or none of what the model knows.
pub fn score_recordings(
    classifier: Classifier,
    paths: &[PathBuf],
    channels: &[usize],
    wanted: &[u16],
) -> Result<(Scores, Tally), Failure> {
    let contract = classifier.contract();
    let settings = DatasetSettings {
        channels: channels.iter().copied().map(Channel::Index).collect(),
        sample_rate_hz: contract.sample_rate_hz,
        filter: Some(contract.filter.clone()),
        input: contract.input,
        windows: WindowSettings {
            window_samples: contract.window_samples,
            increment_samples: (contract.window_samples / 4).max(1),
        },
        ..DatasetSettings::default()
    };
    let source = WindowSource {
        name: "--channels",
        channels: channels.len(),
        sample_rate_hz: contract.sample_rate_hz,
        window_samples: contract.window_samples,
        sequence_windows: usize::MAX,
        filter: None,
        input: contract.input,
    };
    classifier.check_fit(&source).map_err(Failure::input)?;
    let found = list(&settings, paths).map_err(Failure::input)?;
    let known = found.recordings.iter().map(|recording| recording.person).collect();
    let trained = contract.people_trained.iter().copied().collect();
    let people = chosen_people(&known, wanted, &trained).map_err(Failure::input)?;
    let mut skipped: Vec<String> = found.skipped.iter().map(ToString::to_string).collect();
    let recordings: Vec<_> =
        found.recordings.into_iter().filter(|recording| people.contains(&recording.person)).collect();
    let mut scorer = Scorer::new(classifier, people);
    let mut progress = Progress::of(recordings.len(), "recordings");
    let mut trials_before = 0;
    let mut samples = 0;
    for (index, recording) in recordings.iter().enumerate() {
        progress.show(index, String::new);
        // A recording that cannot be read to its end counts for nothing.
        let before = scorer.tally.clone();
        let mut result = Ok(());
        let cut = cut(&settings, recording, &mut |window| {
            if result.is_ok() {
                result = scorer.take(&Window {
                    samples: window.samples,
                    gesture: window.gesture,
                    person: window.person,
                    repetition: window.repetition,
                    trial: trials_before + window.trial as u64,
                });
            }
        });
        result.with_context(|| recording.path.display().to_string()).map_err(Failure::running)?;
        match cut {
            Ok(cut) => {
                trials_before += cut.trials.len() as u64;
                samples += cut.samples;
                skipped.extend(cut.skipped.iter().map(ToString::to_string));
            }
            Err(error) => {
                scorer.tally = before;
                skipped.push(error.to_string());
            }
        }
    }
    scorer.finish(paths.to_vec(), samples as f64 / settings.sample_rate_hz, skipped)
}

/// The people to score among the `known` ones: those `wanted`, or else all; but none whom a model was `trained` on.
///
/// # Errors
///
/// When somebody wanted is not known or was trained on, or nobody is left.
pub fn chosen_people(
    known: &BTreeSet<u16>,
    wanted: &[u16],
    trained: &BTreeSet<u16>,
) -> anyhow::Result<BTreeSet<u16>> {
    let list = |people: &BTreeSet<u16>| people.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    for person in wanted {
        ensure!(known.contains(person), "--people {person}: there are only {}", list(known));
        ensure!(
            !trained.contains(person),
            "--people {person}: the model was trained on {}, so a score on any of them says nothing about somebody \
             new; name others or leave --people out",
            list(trained)
        );
    }
    let people: BTreeSet<u16> =
        if wanted.is_empty() { known - trained } else { wanted.iter().copied().collect() };
    ensure!(
        !people.is_empty(),
        "the model was trained on everybody here ({}): give recordings of others, or hold people out of the training \
         (tendon dataset build --test-people)",
        list(known)
    );
    Ok(people)
}

/// A window to be scored.
struct Window<'a> {
    /// Channel-major `[channels × samples]`.
    samples: &'a [f32],
    gesture: Gesture,
    person: u16,
    repetition: u8,
    /// What tells windows of one trial from those of the next.
    trial: u64,
}

/// A model being scored, window by window.
struct Scorer {
    classifier: Classifier,
    people: BTreeSet<u16>,
    tally: Tally,
    sequence: Sequence,
    start: Instant,
}

impl Scorer {
    fn new(classifier: Classifier, people: BTreeSet<u16>) -> Scorer {
        let Contract { channels, window_samples, sequence_windows, ref classes, .. } = *classifier.contract();
        let tally = Tally::new(classes);
        let start = Instant::now();
        Scorer {
            sequence: Sequence::new(sequence_windows, channels * window_samples),
            classifier,
            people,
            tally,
            start,
        }
    }

    fn take(&mut self, window: &Window<'_>) -> anyhow::Result<()> {
        if !self.people.contains(&window.person) {
            return Ok(());
        }
        let Some(truth) = self.tally.class_of(window.gesture) else { return Ok(()) };
        let start = Instant::now();
        let Some(input) = self.sequence.push(window.trial, window.samples) else { return Ok(()) };
        let probabilities = self.classifier.classify(input)?;
        let work_ns = start.elapsed().as_nanos() as u64;
        let origin = Origin { person: window.person, repetition: window.repetition };
        self.tally.record(truth, origin, Answer { probabilities, work_ns });
        Ok(())
    }

    fn finish(
        self,
        paths: Vec<PathBuf>,
        signal_s: f64,
        skipped: Vec<String>,
    ) -> Result<(Scores, Tally), Failure> {
        let duration_s = self.start.elapsed().as_secs_f64();
        let evaluation = self.tally.evaluate();
        if evaluation.windows == 0 {
            let classes = evaluation.classes.join(", ");
            let reasons = match &skipped[..] {
                [] => String::new(),
                [first, ..] => format!("; {} left out, the first because: {first}", skipped.len()),
            };
            let error =
                anyhow!("{}: no window of what the model knows ({classes}){reasons}", paths[0].display());
            return Err(Failure::input(error));
        }
        let scores = Scores {
            model: self.classifier.path().to_owned(),
            paths,
            people: self.people,
            validation_accuracy: self.classifier.contract().validation_accuracy,
            skipped,
            duration_s,
            x_real_time: signal_s / duration_s,
            evaluation,
        };
        Ok((scores, self.tally))
    }
}

/// The newest windows of a trial, as a model of sequences wants them.
struct Sequence {
    windows: usize,
    /// One after the other `[windows × channels × samples]`; not used by a model of single windows.
    samples: Vec<f32>,
    trial: Option<u64>,
    /// How many windows of the trial have come.
    windows_of_trial: usize,
}

impl Sequence {
    fn new(windows: usize, window_length: usize) -> Sequence {
        let length = if windows > 1 { windows * window_length } else { 0 };
        Sequence { windows, samples: vec![0.0; length], trial: None, windows_of_trial: 0 }
    }

    /// The sequence that ends with `window`; `None` while its trial has not had enough.
    fn push<'a>(&'a mut self, trial: u64, window: &'a [f32]) -> Option<&'a [f32]> {
        if self.windows == 1 {
            return Some(window);
        }
        if self.trial.replace(trial) != Some(trial) {
            self.windows_of_trial = 0;
        }
        self.windows_of_trial += 1;
        self.samples.copy_within(window.len().., 0);
        let newest = self.samples.len() - window.len();
        self.samples[newest..].copy_from_slice(window);
        (self.windows_of_trial >= self.windows).then_some(&self.samples)
    }
}

/// Writes the confusion matrix and the histogram of work into `folder`, named after `model`.
///
/// # Errors
///
/// When the folder or a figure cannot be written.
pub fn write_figures(folder: &Path, model: &Path, tally: &Tally) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let name = model.file_stem().unwrap_or_default().to_string_lossy();
    for ending in ["png", "svg"] {
        let path = |figure: &str| folder.join(format!("{name}-{figure}.{ending}"));
        confusion_figure(&path("confusion"), &name, tally.classes(), tally.confusion())?;
        latency_figure(&path("work"), &format!("{name}: time for a window"), tally.work())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sequence_is_what_came_before_in_the_same_trial() {
        let mut sequence = Sequence::new(3, 2);
        let windows: Vec<[f32; 2]> = (0..6).map(|index| [index as f32, 0.5]).collect();
        let mut ended = Vec::new();
        for (index, window) in windows.iter().enumerate() {
            // Four windows of one trial, two of the next.
            let trial = u64::from(index >= 4);
            ended.push(sequence.push(trial, window).map(<[f32]>::to_vec));
        }
        assert_eq!(ended[..2], [None, None]);
        assert_eq!(ended[2], Some(vec![0.0, 0.5, 1.0, 0.5, 2.0, 0.5]));
        assert_eq!(ended[3], Some(vec![1.0, 0.5, 2.0, 0.5, 3.0, 0.5]));
        assert_eq!(ended[4..], [None, None]);

        let mut single = Sequence::new(1, 2);
        assert_eq!(single.push(0, &windows[3]), Some(&windows[3][..]));
    }

    #[test]
    fn people_are_those_wanted_or_all_but_never_those_trained_on() {
        let set = |people: &[u16]| people.iter().copied().collect::<BTreeSet<u16>>();
        let chosen = |wanted: &[u16]| chosen_people(&set(&[1, 2, 3]), wanted, &set(&[2, 9]));
        assert_eq!(chosen(&[]).unwrap(), set(&[1, 3]));
        assert_eq!(chosen(&[3]).unwrap(), set(&[3]));
        assert!(
            chosen(&[3, 2]).unwrap_err().to_string().contains("--people 2: the model was trained on 2, 9")
        );
        assert!(chosen(&[4]).unwrap_err().to_string().contains("--people 4: there are only 1, 2, 3"));
        assert!(
            chosen_people(&set(&[2]), &[], &set(&[2]))
                .unwrap_err()
                .to_string()
                .contains("everybody here (2)")
        );
    }
}
