//! `tendon evaluate`: how well a model recognises the windows of a data set, by the code that runs live.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::{Classifier, WindowSource};
use tendon_evaluation::{Answer, Evaluation, Origin, Tally, confusion_figure, latency_figure};
use tendon_recordings::StoredDataset;

use crate::Failure;
use crate::run::write_json;

/// Command line of `tendon evaluate`.
#[derive(Debug, Args)]
pub struct Options {
    /// Data set that `tendon dataset build` wrote.
    #[arg(value_name = "FOLDER")]
    dataset: PathBuf,
    /// The ONNX model.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Only these people, by number; when left out, all whom the model was not trained on: nobody else can tell how
    /// well it does for somebody new.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<u16>,
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
struct Scores<'a> {
    model: &'a Path,
    dataset: &'a Path,
    people: Vec<u16>,
    /// Time that all windows took, reading included, s.
    duration_s: f64,
    /// Seconds of signal for every second.
    x_real_time: f64,
    #[serde(flatten)]
    evaluation: Evaluation,
}

/// Windows between two looks at the clock for the progress line, and at memory that is no longer needed.
const WINDOWS_A_ROUND: usize = 256;
/// Time between two lines of progress.
const PROGRESS_INTERVAL: Duration = Duration::from_secs(2);

/// Evaluates a model.
pub fn evaluate(options: &Options) -> Result<(), Failure> {
    let library =
        tendon_classifier::runtime_library(options.runtime_library.as_deref()).map_err(Failure::input)?;
    let mut dataset = StoredDataset::open(&options.dataset).map_err(Failure::input)?;
    let mut classifier = Classifier::load(&library, &options.model).map_err(Failure::input)?;
    let contract = classifier.contract().clone();
    let known: Vec<u16> = dataset.manifest().windows_per_person.keys().copied().collect();
    let people = chosen_people(&known, &options.people, &contract.people_trained).map_err(Failure::input)?;
    let settings = &dataset.manifest().settings;
    let source = WindowSource {
        name: "the data set",
        channels: settings.channels.len(),
        sample_rate_hz: settings.sample_rate_hz,
        window_samples: settings.windows.window_samples,
        // Successive windows of a recording lie one after the other in the array.
        sequence_windows: usize::MAX,
        filter: settings.filter.as_ref(),
        input: settings.input,
    };
    classifier.check_fit(&source).map_err(Failure::input)?;

    let start = Instant::now();
    let tally = classify_all(&mut classifier, &mut dataset, &people).map_err(Failure::running)?;
    let duration_s = start.elapsed().as_secs_f64();
    let evaluation = tally.evaluate();
    if evaluation.windows == 0 {
        let classes = evaluation.classes.join(", ");
        let error =
            anyhow!("{}: holds no window of what the model knows ({classes})", options.dataset.display());
        return Err(Failure::input(error));
    }
    let settings = &dataset.manifest().settings;
    let increment_s = settings.windows.increment_samples as f64 / settings.sample_rate_hz;
    let x_real_time = evaluation.windows as f64 * increment_s / duration_s;
    println!("{} on {}, {} people", options.model.display(), options.dataset.display(), people.len());
    if let Some(provenance) = &contract.provenance {
        println!("the model: {provenance}");
    }
    let left_out: Vec<String> =
        known.iter().filter(|person| !people.contains(person)).map(ToString::to_string).collect();
    if options.people.is_empty() && !left_out.is_empty() {
        println!("left out, because the model was trained on them: people {}", left_out.join(", "));
    }
    println!("\n{evaluation}");
    println!("{duration_s:.1} s in all, {x_real_time:.0} times faster than real time");

    if let Some(folder) = &options.figures {
        write_figures(folder, &options.model, &classifier, &tally).map_err(Failure::running)?;
    }
    if let Some(path) = &options.json {
        let scores = Scores {
            model: &options.model,
            dataset: &options.dataset,
            people: people.into_iter().collect(),
            duration_s,
            x_real_time,
            evaluation,
        };
        write_json(path, &scores).map_err(Failure::running)?;
    }
    Ok(())
}

/// The people to score among the `known` ones.
fn chosen_people(known: &[u16], wanted: &[u16], trained: &[u16]) -> anyhow::Result<BTreeSet<u16>> {
    let list = |people: &[u16]| people.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    for person in wanted {
        ensure!(known.contains(person), "--people {person}: the data set has only {}", list(known));
        ensure!(
            !trained.contains(person),
            "--people {person}: the model was trained on {}, so a score on any of them says nothing about somebody \
             new; name others or leave --people out",
            list(trained)
        );
    }
    let candidates = if wanted.is_empty() { known } else { wanted };
    let people: BTreeSet<u16> =
        candidates.iter().copied().filter(|person| !trained.contains(person)).collect();
    ensure!(
        !people.is_empty(),
        "the model was trained on everybody in the data set ({}): build one with others, or hold people out of the \
         training (tendon dataset build --test-people)",
        list(known)
    );
    Ok(people)
}

fn classify_all(
    classifier: &mut Classifier,
    dataset: &mut StoredDataset,
    people: &BTreeSet<u16>,
) -> anyhow::Result<Tally> {
    let classes = classifier.contract().classes.clone();
    let mut tally = Tally::new(&classes);
    let mut probabilities = vec![0.0; classes.len()];
    let mut next_progress = Instant::now() + PROGRESS_INTERVAL;
    for index in 0..dataset.len() {
        if index % WINDOWS_A_ROUND == 0 {
            dataset.release_before(index);
            if Instant::now() >= next_progress {
                next_progress += PROGRESS_INTERVAL;
                show_progress(index, dataset.len());
            }
        }
        let person = dataset.person(index);
        if !people.contains(&person) {
            continue;
        }
        let Some(truth) = tally.class_of(dataset.gesture(index)) else { continue };
        let start = Instant::now();
        let by_gesture =
            classifier.classify(dataset.window(index)).with_context(|| format!("window {index}"))?;
        let work_ns = start.elapsed().as_nanos() as u64;
        for (probability, gesture) in probabilities.iter_mut().zip(&classes) {
            *probability = by_gesture[gesture.index()];
        }
        let origin = Origin { person, repetition: dataset.repetition(index) };
        tally.record(truth, origin, Answer { probabilities: &probabilities, work_ns });
    }
    Ok(tally)
}

fn write_figures(folder: &Path, model: &Path, classifier: &Classifier, tally: &Tally) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let name = model.file_stem().unwrap_or_default().to_string_lossy();
    for ending in ["png", "svg"] {
        let path = |figure: &str| folder.join(format!("{name}-{figure}.{ending}"));
        confusion_figure(&path("confusion"), &name, &classifier.contract().classes, tally.confusion())?;
        latency_figure(&path("work"), &format!("{name}: time for a window"), tally.work())?;
    }
    println!("figures in {}", folder.display());
    Ok(())
}

#[allow(clippy::print_stderr, reason = "progress is for the person who waits")]
fn show_progress(done: usize, windows: usize) {
    eprintln!("{done} of {windows} windows");
}
