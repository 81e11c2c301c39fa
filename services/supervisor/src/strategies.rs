//! `tendon strategies`: the paper's three real-time strategies on continuous recordings with cues, by the code that
//! runs live, but without its processes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{anyhow, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::TrainedOn;
use tendon_config::Config;
use tendon_dataset::{Recording, list};
use tendon_evaluation::{
    StrategyModels, StrategyScores, chosen_people, dataset_settings, score_strategy, with_trials,
};
use tendon_gesture::{DecisionSettings, Strategy};
use tendon_output::{check_distinct, collect};
use tendon_pipeline::{Pipeline, PipelineSettings};
use tendon_provenance::Provenance;

use crate::Failure;
use crate::options::{channel, check_keys};
use crate::output::{checked, left_out, print};
use crate::progress::Works;
use crate::provenance::PROGRAM;

/// Command line of `tendon strategies`.
#[derive(Debug, Args)]
pub struct Options {
    /// Continuous recordings with cues: folders of the 3DC layout, or folders above such.
    #[arg(required = true, value_name = "PATH")]
    recordings: Vec<PathBuf>,
    /// Score only this strategy. By default, all three.
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
    /// Score only these people, by number. By default, everybody whom none of the models was trained on.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<u16>,
    /// Channels of the recordings, in the order the models expect.
    #[arg(long, value_delimiter = ',', value_parser = channel, default_value = "0,3,5,8")]
    channels: Vec<usize>,
    /// Configuration file with the settings of dsp and decision. By default, the default settings.
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
const KEYS: [&str; 7] = [
    "acquisition.channels",
    "acquisition.sample_rate_hz",
    "dsp",
    "decision.vote_windows",
    "decision.grip_windows",
    "decision.grip_interval_s",
    "decision.speed_mm_per_s",
];

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

    /// Refuses options that have no effect on what is scored.
    fn check_effects(&self) -> anyhow::Result<()> {
        check_keys(&self.assignments, "tendon strategies", &KEYS)?;
        let Some(strategy) = self.strategy else { return Ok(()) };
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
    people: BTreeSet<u16>,
    /// Recordings that could not be used, and why.
    skipped: Vec<String>,
    strategies: BTreeMap<&'static str, StrategyScores>,
    provenance: Provenance,
}

/// Scores the strategies.
pub fn score(options: &Options) -> Result<(), Failure> {
    let json = checked(options.json.as_deref())?;
    check_distinct(&json, [], options.inputs()).map_err(Failure::input)?;
    let begun = Provenance::begin(PROGRAM);
    let mut pipelines = pipelines(options).map_err(Failure::input)?;
    let settings = dataset_settings(pipelines[0].1.settings(), &options.channels);
    let found = list(&settings, &options.recordings).map_err(Failure::input)?;
    let known: BTreeSet<u16> = found.recordings.iter().map(|recording| recording.person).collect();
    let data_set = found.layout.data_set();
    let models = || pipelines.iter().flat_map(|(_, pipeline)| pipeline.recogniser().trained_on());
    let trained = models().flat_map(|model| model.people_of(data_set)).copied().collect();
    let people = chosen_people(&known, &options.people, &trained).map_err(Failure::input)?;
    let scored: Vec<u16> = people.iter().copied().collect();
    let provenance = Provenance {
        trained_on_person: TrainedOn::any_includes(models(), data_set, &scored),
        ..provenance(options, &pipelines, begun).map_err(Failure::running)?
    };
    let recordings: Vec<Recording> =
        found.recordings.into_iter().filter(|recording| people.contains(&recording.person)).collect();

    let (recordings, unusable) = with_trials(&settings, recordings);
    if recordings.is_empty() {
        let reason = unusable.first().map_or("there is none", String::as_str);
        return Err(Failure::input(anyhow!("no recording could be used: {reason}")));
    }
    let mut all = AllScores {
        recordings: options.recordings.iter().map(|path| path.display().to_string()).collect(),
        people,
        skipped: found.skipped.iter().map(ToString::to_string).chain(unusable).collect(),
        strategies: BTreeMap::new(),
        provenance,
    };
    let mut text = String::new();
    for (strategy, pipeline) in &mut pipelines {
        let mut works = Works::default();
        let name = strategy.name();
        let mut progress =
            |done, total| works.show(done, total, "recordings", || format!(", strategy {name}"));
        let scores =
            score_strategy(pipeline, &settings, &recordings, &mut progress).map_err(Failure::running)?;
        text += &format!("strategy {name}\n{scores}\n");
        all.strategies.insert(name, scores);
    }
    if !all.skipped.is_empty() {
        text += &left_out(&all.skipped, "recordings or trials");
    }
    // A closed output does not keep the file from being written, nor the other way round.
    let written = collect(json.iter().map(|file| file.write_json(&all))).map_err(Failure::running);
    written.and(print(text.trim_end()).map_err(Failure::running))
}

/// What was scored on what. The hashes of recordings are left out where nobody gets to read them.
fn provenance(
    options: &Options,
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
    let begun = begun.with_configuration(&configuration(options)?)?.with_models(models)?;
    Ok(begun.with_recording(&options.recordings)?)
}

/// A pipeline for each strategy that is to be scored; at least one.
fn pipelines(options: &Options) -> anyhow::Result<Vec<(Strategy, Pipeline)>> {
    let library = tendon_classifier::runtime_library(options.runtime_library.as_deref())?;
    let config = configuration(options)?;
    let models = StrategyModels {
        five_gesture: options.five_gesture_model.clone(),
        rest_move: options.rest_move_model.clone(),
        six_class: options.six_class_model.clone(),
    };
    let chosen = options.strategy.map_or(Strategy::ALL.to_vec(), |strategy| vec![strategy]);
    let mut pipelines = Vec::new();
    for strategy in chosen {
        let settings = PipelineSettings {
            channels: config.acquisition.channels,
            sample_rate_hz: config.acquisition.sample_rate_hz,
            signal: config.dsp.clone(),
            decision: DecisionSettings { strategy, ..config.decision.clone() },
        };
        pipelines.push((strategy, models.pipeline(&library, &settings)?));
    }
    Ok(pipelines)
}

fn configuration(options: &Options) -> anyhow::Result<Config> {
    options.check_effects()?;
    let mut config = options.config.as_ref().map_or(Ok(Config::default()), |path| Config::read(path))?;
    for assignment in &options.assignments {
        config = config.with(assignment)?;
    }
    ensure!(
        options.channels.len() == config.acquisition.channels,
        "--channels names {} channels, acquisition.channels = {}: make them the same",
        options.channels.len(),
        config.acquisition.channels
    );
    config.check()?;
    Ok(config)
}
