//! `tendon experiments`: every comparison of the paper, on any recordings of its layouts, from raw files to tables.
//!
//! ```text
//! recordings ─▶ data sets ─▶ scripts/train ─▶ models ─▶ scores ─┐
//!     ├─▶ strategies, offline ──────────────────────────────────┼─▶ report.md, report.json, figures
//!     └─▶ strategies, live: tendon run --replay ────────────────┘
//! ```
//! Everything is kept in the folder of `--out`; what is there is not made again, so an interrupted run goes on.

mod paper;
mod plan;
mod report;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::Instant;

use anyhow::{Context, anyhow, bail, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::Classifier;
use tendon_config::Config;
use tendon_dataset::{BuildSettings, Manifest, Recording, StoredDataset, list};
use tendon_evaluation::StrategyScores;
use tendon_gesture::Strategy;
use tendon_report::Report;
use tendon_signal::FilterSettings;

use crate::evaluate::{Scores, score_dataset, write_figures};
use crate::run::write_json;
use crate::strategies::{Models, dataset_settings, score_strategy, with_strategy, with_trials};
use crate::{Failure, dataset};
use paper::Paper;
use plan::{DATASETS, DatasetPlan, Training};

/// Command line of `tendon experiments`.
#[derive(Debug, Args)]
pub struct Options {
    /// The 3DC data set: its folder, or one of some of its people (scripts/fetch-data 3dc fetches it).
    #[arg(long, value_name = "FOLDER")]
    three_dc: Option<PathBuf>,
    /// The Ozdemir data set, which the paper used: its folder raw/mat (scripts/fetch-data ozdemir fetches it). From
    /// filtered/mat come the models, too, but not the strategies, which filter as they go.
    #[arg(long, value_name = "FOLDER")]
    ozdemir: Option<PathBuf>,
    /// Where everything goes: data sets, models, figures, report.md and report.json.
    #[arg(long, value_name = "FOLDER", default_value = "experiments")]
    out: PathBuf,
    /// People of 3DC who are held out for the test.
    #[arg(long, value_name = "P,…", value_delimiter = ',', default_value = "19,20,22")]
    three_dc_test_people: Vec<u16>,
    /// People of the Ozdemir data set who are held out for the test; the paper's.
    #[arg(long, value_name = "P,…", value_delimiter = ',', default_value = "36,37,38,39,40")]
    ozdemir_test_people: Vec<u16>,
    /// Seeds of the trainings; comparisons are told with the spread over all of them.
    #[arg(long, value_delimiter = ',', default_value = "0,1,2")]
    seeds: Vec<u64>,
    /// Epochs of a training; the paper's.
    #[arg(long, default_value_t = 30)]
    epochs: u32,
    /// Trainings at a time, each on one core; as many as there are cores when left out.
    #[arg(long)]
    jobs: Option<usize>,
    /// Train nothing: report on the models that are there.
    #[arg(long)]
    no_training: bool,
    /// Leave out the live sessions, which last about three minutes.
    #[arg(long)]
    no_live: bool,
    /// ONNX Runtime's shared library; without it, ORT_DYLIB_PATH, then what scripts/fetch-onnxruntime fetched.
    #[arg(long, value_name = "FILE")]
    runtime_library: Option<PathBuf>,
}

/// Recordings that the experiments are made on.
#[derive(Clone, Debug)]
struct Source {
    /// What it is called in the report.
    name: &'static str,
    /// Folder of its results within that of all.
    folder: &'static str,
    recordings: PathBuf,
    channels: Vec<usize>,
    filter: Option<FilterSettings>,
    test_people: Vec<u16>,
    /// Whether `tendon run` can replay its recordings.
    can_be_replayed: bool,
}

/// What came out on one source.
#[derive(Debug, Serialize)]
struct Results {
    /// What the source is called.
    source: &'static str,
    /// Settings, counts and onsets, by data set.
    datasets: BTreeMap<&'static str, Manifest>,
    /// Scores on the people held out, by model, one for each seed.
    models: BTreeMap<&'static str, Vec<Scores>>,
    /// Offline, on the people held out.
    strategies: BTreeMap<&'static str, StrategyScores>,
    /// Reports of live sessions on one recording.
    live: BTreeMap<&'static str, Report>,
    /// What could not be had, and why.
    missing: Vec<String>,
}

/// Runs all experiments.
pub fn run(options: &Options) -> Result<(), Failure> {
    let sources = sources(options).map_err(Failure::input)?;
    let library =
        tendon_classifier::runtime_library(options.runtime_library.as_deref()).map_err(Failure::input)?;
    let mut results = Vec::new();
    for source in &sources {
        println!("== {}: {}", source.name, source.recordings.display());
        results.push(run_source(options, source, &library)?);
    }
    let text = report::text(&Paper::results(), &results);
    let path = options.out.join("report.md");
    fs::write(&path, text)
        .with_context(|| format!("cannot write {}", path.display()))
        .map_err(Failure::running)?;
    write_json(&options.out.join("report.json"), &results).map_err(Failure::running)?;
    println!("report: {}", path.display());
    Ok(())
}

fn sources(options: &Options) -> anyhow::Result<Vec<Source>> {
    let mut sources = Vec::new();
    if let Some(folder) = &options.ozdemir {
        let is_filtered = folder.components().any(|component| component.as_os_str() == "filtered");
        sources.push(Source {
            name: "Ozdemir",
            folder: "ozdemir",
            recordings: folder.clone(),
            channels: vec![0, 1, 2, 3],
            filter: (!is_filtered)
                .then(|| FilterSettings { notch_hz: Some(50.0), ..FilterSettings::default() }),
            test_people: options.ozdemir_test_people.clone(),
            can_be_replayed: false,
        });
    }
    if let Some(folder) = &options.three_dc {
        sources.push(Source {
            name: "3DC",
            folder: "3dc",
            recordings: folder.clone(),
            channels: vec![0, 3, 5, 8],
            filter: Some(FilterSettings::default()),
            test_people: options.three_dc_test_people.clone(),
            can_be_replayed: true,
        });
    }
    ensure!(
        !sources.is_empty(),
        "no recordings: name some with --three-dc FOLDER or --ozdemir FOLDER (scripts/fetch-data fetches both)"
    );
    ensure!(!options.seeds.is_empty(), "--seeds: name at least one, such as 0");
    Ok(sources)
}

fn run_source(options: &Options, source: &Source, library: &Path) -> Result<Results, Failure> {
    let out = options.out.join(source.folder);
    for folder in ["data", "models", "logs", "figures"] {
        let folder = out.join(folder);
        fs::create_dir_all(&folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))
            .map_err(Failure::running)?;
    }
    let mut results = Results {
        source: source.name,
        datasets: BTreeMap::new(),
        models: BTreeMap::new(),
        strategies: BTreeMap::new(),
        live: BTreeMap::new(),
        missing: Vec::new(),
    };
    for plan in &DATASETS {
        results.datasets.insert(plan.name, build(plan, source, &out)?);
    }
    let trainings = Training::all(&options.seeds, options.epochs);
    if !options.no_training {
        train_all(options, &trainings, &out).map_err(Failure::running)?;
    }
    for training in &trainings {
        let model = model_path(&out, training);
        if !model.is_file() {
            results.missing.push(format!("{} is not trained yet", training.name()));
            continue;
        }
        let classifier = Classifier::load(library, &model).map_err(Failure::running)?;
        let (scores, tally) = score_dataset(classifier, &out.join("data").join(training.model.dataset), &[])?;
        println!("{}: accuracy {:.4}", training.name(), scores.evaluation.accuracy);
        write_figures(&out.join("figures"), &model, &tally).map_err(Failure::running)?;
        results.models.entry(training.model.name).or_default().push(scores);
    }
    run_strategies(options, source, library, &out, &mut results)?;
    Ok(results)
}

fn model_path(out: &Path, training: &Training) -> PathBuf {
    out.join("models").join(training.name() + ".onnx")
}

/// The data set of `plan`, built unless it is there already.
fn build(plan: &DatasetPlan, source: &Source, out: &Path) -> Result<Manifest, Failure> {
    let folder = out.join("data").join(plan.name);
    let settings = plan.settings(&source.channels, source.filter.clone());
    if StoredDataset::is_one(&folder) {
        let dataset = StoredDataset::open(&folder).map_err(Failure::running)?;
        if dataset.manifest().settings == settings {
            return Ok(dataset.manifest().clone());
        }
    }
    println!("data set {}", plan.name);
    let building = BuildSettings { test_people: source.test_people.clone(), ..BuildSettings::default() };
    let (manifest, _) =
        dataset::build_shown(&settings, &building, std::slice::from_ref(&source.recordings), &folder)?;
    Ok(manifest)
}

/// Trains what is not there yet, several at a time.
fn train_all(options: &Options, trainings: &[Training], out: &Path) -> anyhow::Result<()> {
    let missing: Vec<&Training> =
        trainings.iter().filter(|training| !model_path(out, training).is_file()).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let script = find_train_script()?;
    let jobs = options.jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    println!(
        "{} trainings of {} epochs, {jobs} at a time: some minutes each; logs in {}",
        missing.len(),
        options.epochs,
        out.join("logs").display()
    );
    // The first run of the script may have to install PyTorch, which two must not do at once.
    let output = Command::new(&script).arg("--help").stdout(Stdio::null()).status();
    ensure!(
        output.is_ok_and(|status| status.success()),
        "{} cannot be run: try it by hand",
        script.display()
    );
    let next = Mutex::new(missing.iter().enumerate());
    let work = || -> anyhow::Result<()> {
        loop {
            let taken = next.lock().map_or(None, |mut next| next.next());
            let Some((index, training)) = taken else { return Ok(()) };
            let start = Instant::now();
            train(&script, training, out)?;
            println!(
                "{} of {}: {} in {:.0} min",
                index + 1,
                missing.len(),
                training.name(),
                start.elapsed().as_secs_f64() / 60.0
            );
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs.max(1)).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| {
            worker.join().unwrap_or_else(|_| Err(anyhow!("a thread that waits for a training panicked")))
        })
    })
}

fn train(script: &Path, training: &Training, out: &Path) -> anyhow::Result<()> {
    let log_path = out.join("logs").join(training.name() + ".txt");
    let log = fs::File::create(&log_path).with_context(|| format!("cannot write {}", log_path.display()))?;
    let errors = log.try_clone().with_context(|| format!("cannot write {}", log_path.display()))?;
    let status = Command::new(script)
        .arg("--dataset")
        .arg(out.join("data").join(training.model.dataset))
        .arg("--out")
        .arg(model_path(out, training))
        .args(["--network", training.model.network, "--classes", training.model.classes, "--threads", "1"])
        .args(["--epochs", &training.epochs.to_string(), "--seed", &training.seed.to_string()])
        .stdin(Stdio::null())
        .stdout(log)
        .stderr(errors)
        .status()
        .with_context(|| format!("cannot run {}", script.display()))?;
    ensure!(
        status.success(),
        "{}: the training ended with {status}; {} says why. The same command goes on where it was",
        training.name(),
        log_path.display()
    );
    Ok(())
}

/// `scripts/train` in a folder above this program, or in the current one.
fn find_train_script() -> anyhow::Result<PathBuf> {
    let program = std::env::current_exe().context("cannot tell where this program is")?;
    let folders = program.ancestors().skip(1).map(Path::to_owned).chain(std::env::current_dir());
    let mut scripts = folders.map(|folder| folder.join("scripts/train"));
    scripts.find(|path| path.is_file()).with_context(|| {
        format!(
            "scripts/train was not found above {}: run this program from the project's folder",
            program.display()
        )
    })
}

/// The three strategies, offline on all recordings of the people held out, and live on the first of them.
fn run_strategies(
    options: &Options,
    source: &Source,
    library: &Path,
    out: &Path,
    results: &mut Results,
) -> Result<(), Failure> {
    let path = |name: &str| {
        let model = plan::MODELS.into_iter().find(|model| model.name == name)?;
        let path = model_path(out, &Training { model, seed: options.seeds[0], epochs: options.epochs });
        path.is_file().then_some(path)
    };
    let (Some(five), Some(rest_move), Some(six)) = (path("five-gesture"), path("rest-move"), path("cnn-raw"))
    else {
        results.missing.push("the strategies need the models five-gesture, rest-move and cnn-raw".to_owned());
        return Ok(());
    };
    let models = Models { five_gesture: Some(five), rest_move: Some(rest_move), six_class: Some(six) };
    let mut config = Config::default();
    config.acquisition.channels = source.channels.len();
    match &source.filter {
        Some(filter) => config.dsp.filter = filter.clone(),
        None => {
            results.missing.push(format!(
                "the strategies filter as they go: give the raw recordings of {} besides",
                source.name
            ));
            return Ok(());
        }
    }
    let test_people: BTreeSet<u16> = source.test_people.iter().copied().collect();
    let settings = dataset_settings(&config, &source.channels);
    let found = list(&settings, std::slice::from_ref(&source.recordings)).map_err(Failure::input)?;
    let recordings: Vec<Recording> =
        found.recordings.into_iter().filter(|recording| test_people.contains(&recording.person)).collect();
    let first = recordings.first().cloned();
    let (usable, skipped) = with_trials(&settings, recordings);
    results.missing.extend(skipped);
    for strategy in Strategy::ALL {
        let config = with_strategy(&config, strategy);
        let mut recogniser = models.load(library, strategy, &config).map_err(Failure::running)?;
        let scores =
            score_strategy(&config, &mut recogniser, &settings, &usable).map_err(Failure::running)?;
        println!("strategy {}: {:.1} % of the windows", strategy.name(), scores.mean_correct_percent);
        results.strategies.insert(strategy.name(), scores);
    }
    if options.no_live {
        results.missing.push("live sessions were left out by --no-live".to_owned());
        return Ok(());
    }
    let Some(recording) = first.filter(|_| source.can_be_replayed) else {
        results.missing.push(format!("`tendon run` cannot replay recordings of {}", source.name));
        return Ok(());
    };
    for strategy in Strategy::ALL {
        println!("live: strategy {}, one recording at its true pace", strategy.name());
        let report = run_live(strategy, &recording.path, &models, out).map_err(Failure::running)?;
        results.live.insert(strategy.name(), report);
    }
    Ok(())
}

fn run_live(strategy: Strategy, recording: &Path, models: &Models, out: &Path) -> anyhow::Result<Report> {
    let program = std::env::current_exe().context("cannot tell where this program is")?;
    let json = out.join(format!("live-{}.json", strategy.name()));
    let model = if strategy == Strategy::Direct { &models.six_class } else { &models.five_gesture };
    let (Some(model), Some(rest_move)) = (model, &models.rest_move) else {
        bail!("the models of the live sessions are not there");
    };
    let output = Command::new(program)
        .args(["run", "--session", &format!("experiments-{}", std::process::id()), "--replay"])
        .arg(recording)
        .args(["--repetition", "0", "--strategy", strategy.name(), "--model"])
        .arg(model)
        .arg("--rest-move-model")
        .arg(rest_move)
        .arg("--json")
        .arg(&json)
        .arg("--figures")
        .arg(out.join("figures").join(strategy.name()))
        .stdin(Stdio::null())
        .output()
        .context("cannot run a session")?;
    ensure!(
        output.status.success(),
        "the session with strategy {} failed: {}",
        strategy.name(),
        String::from_utf8_lossy(&output.stderr).trim()
    );
    let text = fs::read_to_string(&json).with_context(|| format!("cannot read {}", json.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} is no report", json.display()))
}
