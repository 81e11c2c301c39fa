//! `tendon strategies`: the paper's three real-time strategies, and recognisers calibrated to each person, on continuous
//! recordings with cues, by the code that runs live, but without its processes.

mod personal;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{anyhow, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::TrainedOn;
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, Recording, list};
use tendon_evaluation::{
    LeftOut, PersonRecordings, StrategyModels, StrategyScores, chosen_people, dataset_settings,
    score_strategy, with_trials,
};
use tendon_gesture::{DecisionSettings, Strategy};
use tendon_identity::PersonId;
use tendon_output::{check_distinct, collect};
use tendon_pipeline::{Pipeline, PipelineSettings};
use tendon_provenance::Provenance;
use tendon_recordings::{Channel, SkippedKind};

use crate::Failure;
use crate::channels::{channels_or_default, listed};
use crate::configuration::{check_keys, sets};
use crate::model_channels;
use crate::output::{checked, counted, left_out, print};
use crate::progress::Works;
use crate::provenance::PROGRAM;
use crate::recording_options::RecordingOptions;

use personal::People;

/// Command line of `tendon strategies`.
#[derive(Debug, Args)]
pub struct Options {
    /// Continuous recordings with cues: folders of the 3DC layout or with a labels.csv, files .edf, .bdf, .xdf or .xdfz, or
    /// folders above such.
    #[arg(required = true, value_name = "PATH")]
    recordings: Vec<PathBuf>,
    /// Score only this strategy. By default, all: the paper's three, and `personal`, a recogniser calibrated to each
    /// person.
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
    /// For the personal strategy, calibrate each person on the first N repetitions of the first session. All strategies
    /// are then scored on the last session, or on what is left of an only one [default: 4, or as many as there are].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    calibrate_repetitions: Option<u32>,
    /// Score only these people, by number or name. By default, everybody whom none of the models was trained on.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<PersonId>,
    #[command(flatten)]
    recording: RecordingOptions,
    /// Configuration file with the settings of dsp, decision and adaptation. By default, the default settings.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Change one setting, such as decision.vote_windows=5; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// ONNX model of the five gestures, for threshold and two_stage. By default, the one that comes with Tendon.
    #[arg(long, value_name = "FILE")]
    five_gesture_model: Option<PathBuf>,
    /// ONNX model of rest and move, for two_stage. By default, the one that comes with Tendon.
    #[arg(long, value_name = "FILE")]
    rest_move_model: Option<PathBuf>,
    /// ONNX model of all six classes, for direct. By default, the one that comes with Tendon.
    #[arg(long, value_name = "FILE")]
    six_class_model: Option<PathBuf>,
    /// ONNX Runtime's shared library. By default ORT_DYLIB_PATH, then what scripts/fetch-onnxruntime fetched.
    #[arg(long, value_name = "FILE")]
    runtime_library: Option<PathBuf>,
    /// Also write the scores to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Keys of the configuration that scores depend on.
const KEYS: [&str; 5] =
    ["acquisition.channels", "acquisition.sample_rate_hz", "dsp", "inference.adaptation", "decision"];

/// Keys among them that the command sets itself.
const OWN_KEYS: [&str; 2] = ["decision.strategy", "decision.gestures"];

impl Options {
    /// The models named, each with its option and the strategies that use it.
    fn models(&self) -> [(&'static str, &Option<PathBuf>, &'static [Strategy]); 3] {
        [
            ("--five-gesture-model", &self.five_gesture_model, &[Strategy::Threshold, Strategy::TwoStage]),
            ("--rest-move-model", &self.rest_move_model, &[Strategy::TwoStage]),
            ("--six-class-model", &self.six_class_model, &[Strategy::Direct]),
        ]
    }

    /// The files and folders that the command reads.
    fn inputs(&self) -> impl Iterator<Item = &Path> {
        let models = self.models().into_iter().filter_map(|(_, model, _)| model.as_ref());
        self.recordings.iter().chain(models).chain(&self.config).map(PathBuf::as_path)
    }

    /// Whether a key was set that begins with `beginning`.
    fn sets(&self, beginning: &str) -> bool {
        sets(&self.assignments, beginning)
    }

    /// The strategies with models, and whether the personal one is scored.
    fn strategies(&self) -> (Vec<Strategy>, bool) {
        match self.strategy {
            None => (Strategy::ALL.to_vec(), true),
            Some(Strategy::Personal) => (Vec::new(), true),
            Some(strategy) => (vec![strategy], false),
        }
    }

    /// Refuses options that have no effect on what is scored.
    fn check_effects(&self) -> anyhow::Result<()> {
        check_keys(&self.assignments, "tendon strategies", &KEYS)?;
        for key in OWN_KEYS {
            ensure!(
                !self.sets(key),
                "tendon strategies sets {key} itself: leave it out; --strategy chooses what is scored"
            );
        }
        let Some(strategy) = self.strategy else { return Ok(()) };
        ensure!(
            self.calibrate_repetitions.is_none() || strategy == Strategy::Personal,
            "--calibrate-repetitions has no effect with --strategy {}: leave one of the two out",
            strategy.name()
        );
        ensure!(
            !self.sets("inference.adaptation") || strategy == Strategy::Personal,
            "--set inference.adaptation has no effect with --strategy {}: leave one of the two out",
            strategy.name()
        );
        for (option, model, used_by) in self.models() {
            ensure!(
                model.is_none() || used_by.contains(&strategy),
                "{option} has no effect with --strategy {}: leave one of the two out",
                strategy.name()
            );
        }
        Ok(())
    }
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct AllScores {
    recordings: Vec<String>,
    people: BTreeSet<PersonId>,
    /// What calibrated the recognisers of people, in words; `null` if none was.
    calibrated_on: Option<String>,
    /// What was scored, in words.
    scored_on: &'static str,
    /// Recordings and people that could not be used, and why.
    skipped: Vec<LeftOut>,
    /// How much of it there is of each kind.
    skipped_by_kind: BTreeMap<SkippedKind, usize>,
    /// By name; `null` for what could not be scored.
    strategies: BTreeMap<&'static str, Option<StrategyScores>>,
    provenance: Provenance,
}

/// Scores the strategies.
pub fn score(options: &Options) -> Result<(), Failure> {
    let json = checked(options.json.as_deref())?;
    check_distinct(&json, [], options.inputs()).map_err(Failure::input)?;
    let begun = Provenance::begin(PROGRAM);
    let config = configuration(options).map_err(Failure::input)?;
    let mut pipelines = pipelines(options, &config).map_err(Failure::input)?;
    let settings = settings(options, &config, &pipelines).map_err(Failure::input)?;
    let found = list(&settings, &options.recordings).map_err(Failure::input)?;
    let (layout, data_set) = (found.layout, found.layout.data_set());
    let known: BTreeSet<PersonId> = found.recordings.iter().map(|recording| recording.person).collect();
    let models = || pipelines.iter().flat_map(|(_, pipeline)| pipeline.recogniser().trained_on());
    let trained = models().flat_map(|model| model.people_of(data_set)).copied().collect();
    let chosen = chosen_people(&known, &options.people, &trained).map_err(Failure::input)?;
    let recordings: Vec<Recording> =
        found.recordings.into_iter().filter(|recording| chosen.contains(&recording.person)).collect();
    let mut skipped: Vec<LeftOut> = found.skipped.iter().map(LeftOut::from).collect();
    let (usable, unusable) = with_trials(&settings, recordings);
    skipped.extend(unusable);
    if usable.is_empty() {
        let reason = skipped.first().map_or("there is none", |first| &first.reason);
        return Err(Failure::input(anyhow!("no recording could be used: {reason}")));
    }
    let calibrated = match options.strategies() {
        (_, false) => People::uncalibrated(usable),
        (_, true) => personal::calibrate(options, &config, &settings.channels, layout, usable, &mut skipped)?,
    };
    let people: BTreeSet<PersonId> = calibrated.recordings.iter().map(PersonRecordings::person).collect();
    let scored: Vec<PersonId> = people.iter().copied().collect();
    let provenance = Provenance {
        trained_on_person: TrainedOn::any_includes(models(), data_set, &scored),
        ..provenance(options, &config, &pipelines, begun).map_err(Failure::running)?
    };
    let mut all = AllScores {
        recordings: options.recordings.iter().map(|path| path.display().to_string()).collect(),
        people,
        calibrated_on: calibrated.calibrated_on(),
        scored_on: calibrated.scored_on(),
        skipped_by_kind: SkippedKind::count(skipped.iter().map(|left_out| left_out.kind)),
        skipped,
        strategies: BTreeMap::new(),
        provenance,
    };
    let mut text = format!("channels {}\nscored on {}\n", listed(&settings.channels), all.scored_on);
    if let Some(calibrated_on) = &all.calibrated_on {
        text += &format!("personal: calibrated on {calibrated_on}\n");
    }
    text += "\n";
    let mut add = |strategy: Strategy, scores: StrategyScores| {
        text += &format!("strategy {}\n{scores}\n", strategy.name());
        all.strategies.insert(strategy.name(), Some(scores));
    };
    for (strategy, pipeline) in &mut pipelines {
        let mut works = Works::default();
        let mut progress = progress_of(&mut works, *strategy);
        let scores = score_strategy(pipeline, &settings, &calibrated.recordings, &mut progress);
        add(*strategy, scores.map_err(Failure::running)?);
    }
    if !calibrated.people.is_empty() {
        let mut works = Works::default();
        let mut progress = progress_of(&mut works, Strategy::Personal);
        add(Strategy::Personal, personal::score(options, &config, &settings, &calibrated, &mut progress)?);
    } else if options.strategies().1 {
        all.strategies.insert(Strategy::Personal.name(), None);
    }
    if !all.skipped.is_empty() {
        text += &left_out(&all.skipped);
    }
    // A closed output does not keep the file from being written, nor the other way round.
    let written = collect(json.iter().map(|file| file.write_json(&all))).map_err(Failure::running);
    written.and(print(text.trim_end()).map_err(Failure::running))
}

/// Shows how many recordings a strategy has been scored on.
fn progress_of(works: &mut Works, strategy: Strategy) -> impl FnMut(usize, usize) + '_ {
    move |done, total| works.show(done, total, "recordings", || format!(", strategy {}", strategy.name()))
}

/// What was scored on what. The hashes of recordings are left out where nobody gets to read them.
fn provenance(
    options: &Options,
    config: &Config,
    pipelines: &[(Strategy, Pipeline)],
    begun: Provenance,
) -> anyhow::Result<Provenance> {
    if options.json.is_none() {
        return Ok(begun);
    }
    let mut models: Vec<PathBuf> = Vec::new();
    for (_, pipeline) in pipelines {
        models.extend(pipeline.recogniser().models().into_iter().map(PathBuf::from));
    }
    models.sort();
    models.dedup();
    let begun = begun.with_configuration(config)?.with_models(models)?;
    Ok(begun.with_recording(&options.recordings)?)
}

/// A pipeline for each strategy with models that is to be scored.
fn pipelines(options: &Options, config: &Config) -> anyhow::Result<Vec<(Strategy, Pipeline)>> {
    let (strategies, _) = options.strategies();
    if strategies.is_empty() {
        return Ok(Vec::new());
    }
    let library = tendon_classifier::runtime_library(options.runtime_library.as_deref())?;
    let models = StrategyModels {
        five_gesture: options.five_gesture_model.clone(),
        rest_move: options.rest_move_model.clone(),
        six_class: options.six_class_model.clone(),
    };
    let pipeline =
        |strategy| Ok((strategy, models.pipeline(&library, &pipeline_settings(config, strategy))?));
    strategies.into_iter().map(pipeline).collect()
}

/// The settings of the pipeline of a strategy.
fn pipeline_settings(config: &Config, strategy: Strategy) -> PipelineSettings {
    PipelineSettings {
        channels: config.acquisition.channels,
        sample_rate_hz: config.acquisition.sample_rate_hz,
        signal: config.dsp.clone(),
        decision: DecisionSettings { strategy, ..config.decision.clone() },
    }
}

fn configuration(options: &Options) -> anyhow::Result<Config> {
    options.check_effects()?;
    let mut config = options.config.as_ref().map_or(Ok(Config::default()), |path| Config::read(path))?;
    for assignment in &options.assignments {
        config = config.with(assignment)?;
    }
    config.check()?;
    Ok(config)
}

/// How the recordings are cut.
fn settings(
    options: &Options,
    config: &Config,
    pipelines: &[(Strategy, Pipeline)],
) -> anyhow::Result<DatasetSettings> {
    let settings = dataset_settings(&pipeline_settings(config, Strategy::Direct), &[]);
    let settings = options.recording.settings(settings);
    let models: Vec<&Path> =
        pipelines.iter().flat_map(|(_, pipeline)| pipeline.recogniser().models()).collect();
    let given = &options.recording.channels;
    let given =
        if given.is_empty() { model_channels::remembered(models.iter().copied()) } else { given.clone() };
    let channels = channels_or_default(&given, &settings, &options.recordings)?;
    let names: Vec<String> = channels.iter().map(Channel::name).collect();
    model_channels::check(models, "the recordings give", &names)?;
    ensure!(
        channels.len() == config.acquisition.channels,
        "of the recordings {} taken ({}; --channels names others), acquisition.channels = {}: make them the same",
        counted(channels.len(), "channel is", "channels are"),
        listed(&channels),
        config.acquisition.channels
    );
    Ok(DatasetSettings { channels, ..settings })
}
