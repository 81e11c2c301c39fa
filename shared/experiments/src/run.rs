//! All experiments in their order: data sets, trainings, scores, strategies, report.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::slice::from_ref;

use serde::Serialize;
use tendon_classifier::Classifier;
use tendon_dataset::{BuildSettings, Manifest, Recording, StoredDataset, list};
use tendon_evaluation::{
    Scores, StrategyModels, StrategyScores, in_words, score_dataset, score_strategy, with_trials,
};
use tendon_figures::write_score_figures;
use tendon_gesture::{DecisionSettings, Strategy};
use tendon_identity::PersonId;
use tendon_output::{OutputFile, OutputFolder, collect};
use tendon_pipeline::PipelineSettings;
use tendon_provenance::Provenance;
use tendon_recordings::Channel;
use tendon_report::Report;
use tendon_signal::{FilterSettings, SignalSettings};

use crate::error::ExperimentError;
use crate::live::{LiveModels, run_live};
use crate::paper::Paper;
use crate::plan::{DATASETS, DatasetPlan, MODELS, Training};
use crate::report;
use crate::training::{Acquaintance, model_path, train_all};

/// What to run, on what.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The 3DC data set, or a part of it.
    pub three_dc: Option<PathBuf>,
    /// The Ozdemir data set.
    pub ozdemir: Option<PathBuf>,
    /// Folder of everything that is made.
    pub out: PathBuf,
    /// People of 3DC who are held out for the test.
    pub three_dc_test_people: Vec<PersonId>,
    /// People of the Ozdemir data set who are held out for the test.
    pub ozdemir_test_people: Vec<PersonId>,
    /// Seeds of the trainings; at least one.
    pub seeds: Vec<u64>,
    /// Epochs of a training.
    pub epochs: u32,
    /// Trainings at a time.
    pub jobs: usize,
    /// Whether models that are missing are trained.
    pub trains: bool,
    /// Whether data sets and models of other recordings or settings, which an earlier run left in the folder, are replaced.
    pub replaces: bool,
    /// Whether live sessions are run.
    pub runs_live: bool,
    /// ONNX Runtime's shared library.
    pub runtime_library: PathBuf,
    /// Of the program that runs the experiments.
    pub provenance: Provenance,
    /// The `tendon` program, for live sessions; `scripts/train` is looked for above it.
    pub program: PathBuf,
}

/// What a run says while it works.
#[derive(Debug)]
pub enum Event<'a> {
    /// A step begins or has ended, as a line for the person who waits.
    Line(String),
    /// How far the data set that is being built has come.
    Dataset(tendon_dataset::Progress<'a>),
    /// How far the scoring of a model or strategy has come.
    Progress {
        /// Finished.
        done: usize,
        /// In all.
        total: usize,
        /// Of what: `windows` or `recordings`.
        things: &'static str,
    },
}

/// What came out on one source of recordings.
#[derive(Debug, Serialize)]
pub struct Results {
    /// What the source is called.
    pub source: &'static str,
    /// The people who are held out: everything is scored on them.
    pub tested_people: Vec<PersonId>,
    /// Settings, counts and onsets, by data set.
    pub datasets: BTreeMap<&'static str, Manifest>,
    /// Scores on the people held out, by model, one for each seed.
    pub models: BTreeMap<&'static str, Vec<Scores>>,
    /// Offline, on the people held out.
    pub strategies: BTreeMap<&'static str, StrategyScores>,
    /// Reports of live sessions on one recording.
    pub live: BTreeMap<&'static str, Report>,
    /// What is missing, and why.
    pub missing: Vec<String>,
    /// Program, machine and hashes of the recordings; each data set, score and live session has its own as well.
    pub provenance: Provenance,
}

/// Recordings that the experiments are made on.
struct Source {
    /// What it is called in the report.
    name: &'static str,
    /// Folder of its results within that of all.
    folder: &'static str,
    recordings: PathBuf,
    channels: Vec<usize>,
    filter: Option<FilterSettings>,
    test_people: Vec<PersonId>,
    /// Whether `tendon run` can replay its recordings.
    can_be_replayed: bool,
}

/// Runs all experiments and writes `report.md` and `report.json`; the path of the first.
///
/// # Errors
/// The first step that fails. What was finished before stays, and the next run continues from there.
pub fn run(settings: &Settings, on_event: &mut dyn FnMut(Event<'_>)) -> Result<PathBuf, ExperimentError> {
    let sources = sources(settings)?;
    let mut results = Vec::new();
    for source in &sources {
        on_event(Event::Line(format!("== {}: {}", source.name, source.recordings.display())));
        let out = settings.out.join(source.folder);
        let provenance = settings.provenance.clone().with_recording(from_ref(&source.recordings))?;
        results.push(Run { settings, source, out, provenance, on_event }.all()?);
    }
    let path = settings.out.join("report.md");
    let text = report::text(&Paper::results(), &results);
    let json_path = settings.out.join("report.json");
    collect([
        OutputFile::check(&path).and_then(|file| file.write_bytes(text.as_bytes())),
        OutputFile::check(&json_path).and_then(|file| file.write_json(&results)),
    ])?;
    Ok(path)
}

fn sources(settings: &Settings) -> Result<Vec<Source>, ExperimentError> {
    let mut sources = Vec::new();
    if let Some(folder) = &settings.ozdemir {
        let is_filtered = folder.components().any(|component| component.as_os_str() == "filtered");
        sources.push(Source {
            name: "Ozdemir",
            folder: "ozdemir",
            recordings: folder.clone(),
            channels: vec![0, 1, 2, 3],
            filter: (!is_filtered)
                .then(|| FilterSettings { notch_hz: Some(50.0), ..FilterSettings::default() }),
            test_people: settings.ozdemir_test_people.clone(),
            can_be_replayed: false,
        });
    }
    if let Some(folder) = &settings.three_dc {
        sources.push(Source {
            name: "3DC",
            folder: "3dc",
            recordings: folder.clone(),
            channels: vec![0, 3, 5, 8],
            filter: Some(FilterSettings::default()),
            test_people: settings.three_dc_test_people.clone(),
            can_be_replayed: true,
        });
    }
    if sources.is_empty() {
        return Err(ExperimentError::NoRecordings);
    }
    if settings.seeds.is_empty() {
        return Err(ExperimentError::NoSeed);
    }
    Ok(sources)
}

/// The experiments on one source.
struct Run<'a> {
    settings: &'a Settings,
    source: &'a Source,
    /// Folder of its results.
    out: PathBuf,
    provenance: Provenance,
    on_event: &'a mut dyn FnMut(Event<'_>),
}

impl Run<'_> {
    fn all(mut self) -> Result<Results, ExperimentError> {
        for folder in ["data", "models", "logs", "figures"] {
            let path = self.out.join(folder);
            fs::create_dir_all(&path).map_err(|reason| ExperimentError::Folder { path, reason })?;
        }
        let mut results = Results {
            source: self.source.name,
            tested_people: self.source.test_people.clone(),
            datasets: BTreeMap::new(),
            models: BTreeMap::new(),
            strategies: BTreeMap::new(),
            live: BTreeMap::new(),
            missing: Vec::new(),
            provenance: self.provenance.clone(),
        };
        for plan in &DATASETS {
            results.datasets.insert(plan.name, self.build(plan)?);
        }
        let trainings = Training::all(&self.settings.seeds, self.settings.epochs);
        if self.settings.trains {
            train_all(self.settings, &trainings, &results.datasets, &self.out, self.on_event)?;
        }
        for training in &trainings {
            let acquaintance = self.acquaintance(training, &results);
            results.missing.extend(acquaintance.remark(&training.name()));
            if !acquaintance.may_be_tested() {
                continue;
            }
            results.models.entry(training.model.name).or_default().push(self.score(training)?);
        }
        self.strategies(&mut results)?;
        Ok(results)
    }

    fn say(&mut self, line: String) {
        (self.on_event)(Event::Line(line));
    }

    /// Whether a data set of an earlier run holds the same recordings, and holds out the same people.
    fn is_of_source(&self, manifest: &Manifest) -> bool {
        let hash =
            |provenance: &Provenance| provenance.recording.as_ref().map(|recording| recording.sha256.clone());
        let people: BTreeSet<PersonId> = self.source.test_people.iter().copied().collect();
        let recorded = hash(&manifest.provenance);
        recorded.is_some()
            && recorded == hash(&self.provenance)
            && people.iter().eq(manifest.split.test_people.iter())
    }

    /// Whom the model of `training` knows.
    fn acquaintance(&self, training: &Training, results: &Results) -> Acquaintance {
        let dataset = &results.datasets[training.model.dataset];
        Acquaintance::of(&model_path(&self.out, training), dataset)
    }

    /// The data set of `plan`, built unless it is there already.
    fn build(&mut self, plan: &DatasetPlan) -> Result<Manifest, ExperimentError> {
        let folder = self.out.join("data").join(plan.name);
        let settings = plan.settings(&self.source.channels, self.source.filter.clone());
        if StoredDataset::is_one(&folder) {
            let manifest = StoredDataset::open(&folder)?.manifest().clone();
            if manifest.settings == settings && self.is_of_source(&manifest) {
                return Ok(manifest);
            }
        }
        self.say(format!("data set {}", plan.name));
        let test_people = self.source.test_people.clone();
        let building = BuildSettings {
            test_people,
            replaces: self.settings.replaces,
            provenance: self.provenance.clone(),
            ..BuildSettings::default()
        };
        let mut progress = |progress: tendon_dataset::Progress<'_>| {
            (self.on_event)(Event::Dataset(progress));
            ControlFlow::Continue(())
        };
        tendon_dataset::build(&settings, &building, from_ref(&self.source.recordings), &folder, &mut progress)
            .map_err(ExperimentError::Dataset)
    }

    /// Scores a trained model on the people held out.
    fn score(&mut self, training: &Training) -> Result<Scores, ExperimentError> {
        let model = model_path(&self.out, training);
        let classifier = Classifier::load(&self.settings.runtime_library, &model)?;
        let dataset = self.out.join("data").join(training.model.dataset);
        let mut progress = |done, total| (self.on_event)(Event::Progress { done, total, things: "windows" });
        let (scores, tally) = score_dataset(classifier, &dataset, &[], &mut progress)?;
        self.say(format!("{}: accuracy {:.4}", training.name(), scores.evaluation.accuracy));
        let folder = OutputFolder::check(&self.out.join("figures"))?;
        collect(write_score_figures(&folder, &model, &tally))?;
        Ok(scores)
    }

    /// The model that a strategy needs, of the first seed, if it is trained, and on nobody who is held out.
    fn trained(&self, name: &str, results: &Results) -> Option<PathBuf> {
        let model = MODELS.into_iter().find(|model| model.name == name)?;
        let training = Training { model, seed: self.settings.seeds[0], epochs: self.settings.epochs };
        let may_be_tested = self.acquaintance(&training, results).may_be_tested();
        may_be_tested.then(|| model_path(&self.out, &training))
    }

    /// The three strategies, offline on all recordings of the people held out, and live on the first of them.
    fn strategies(&mut self, results: &mut Results) -> Result<(), ExperimentError> {
        let trained = ["five-gesture", "rest-move", "cnn-raw"].map(|name| self.trained(name, results));
        let [Some(five_gesture), Some(rest_move), Some(six_class)] = trained else {
            let missing = "the strategies need the models five-gesture, rest-move and cnn-raw, trained on nobody \
                           who is held out";
            results.missing.push(missing.to_owned());
            return Ok(());
        };
        let Some(filter) = self.source.filter.clone() else {
            let name = self.source.name;
            let missing =
                format!("the strategies need unfiltered recordings: give the raw ones of {name}, too");
            results.missing.push(missing);
            return Ok(());
        };
        let live = LiveModels { five_gesture: &five_gesture, rest_move: &rest_move, six_class: &six_class };
        let models = StrategyModels {
            five_gesture: Some(five_gesture.clone()),
            rest_move: Some(rest_move.clone()),
            six_class: Some(six_class.clone()),
        };
        let first = self.strategies_offline(filter, &models, results)?;
        self.strategies_live(first, &live, results)
    }

    /// Gives the first recording of the people held out.
    fn strategies_offline(
        &mut self,
        filter: FilterSettings,
        models: &StrategyModels,
        results: &mut Results,
    ) -> Result<Option<Recording>, ExperimentError> {
        let mut pipeline_settings = PipelineSettings {
            channels: self.source.channels.len(),
            sample_rate_hz: 2000.0,
            signal: SignalSettings { filter, ..SignalSettings::default() },
            decision: DecisionSettings::default(),
        };
        let channels: Vec<Channel> = self.source.channels.iter().copied().map(Channel::Index).collect();
        let settings = tendon_evaluation::dataset_settings(&pipeline_settings, &channels);
        let test_people: BTreeSet<PersonId> = self.source.test_people.iter().copied().collect();
        let found = list(&settings, from_ref(&self.source.recordings))?;
        let recordings: Vec<Recording> = found
            .recordings
            .into_iter()
            .filter(|recording| test_people.contains(&recording.person))
            .collect();
        let first = recordings.first().cloned();
        let (usable, skipped) = with_trials(&settings, recordings);
        results.missing.extend(skipped.iter().map(ToString::to_string));
        for strategy in Strategy::ALL {
            pipeline_settings.decision.strategy = strategy;
            let mut pipeline = models.pipeline(&self.settings.runtime_library, &pipeline_settings)?;
            let mut progress =
                |done, total| (self.on_event)(Event::Progress { done, total, things: "recordings" });
            let scores = score_strategy(&mut pipeline, &settings, &usable, &mut progress)?;
            let share = in_words(scores.mean_correct_percent, 1);
            self.say(format!("strategy {}: {share} % of the windows", strategy.name()));
            results.strategies.insert(strategy.name(), scores);
        }
        Ok(first)
    }

    fn strategies_live(
        &mut self,
        recording: Option<Recording>,
        models: &LiveModels<'_>,
        results: &mut Results,
    ) -> Result<(), ExperimentError> {
        if !self.settings.runs_live {
            results.missing.push("live sessions were left out by --no-live".to_owned());
            return Ok(());
        }
        let Some(recording) = recording.filter(|_| self.source.can_be_replayed) else {
            let missing = format!("`tendon run` cannot replay recordings of {}", self.source.name);
            results.missing.push(missing);
            return Ok(());
        };
        for strategy in Strategy::ALL {
            self.say(format!("live: strategy {}, one recording at its true pace", strategy.name()));
            let report = run_live(&self.settings.program, strategy, &recording.path, models, &self.out)?;
            results.live.insert(strategy.name(), report);
        }
        Ok(())
    }
}
