//! `tendon strategies`: the paper's three real-time strategies on continuous recordings with cues, by the code that runs
//! live, but without its processes.
//!
//! ```text
//! recording ─▶ blocks ─▶ signal chain ─▶ windows ─▶ recogniser ─▶ decider ─▶ what the arm would do ─┐
//!     └─▶ onsets of the movements ─────────────────────────────────────────────────────────────────┴─▶ scores
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::{Recogniser, WindowSource};
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, Recording, RecordingEntry, cut, list};
use tendon_evaluation::{CuePart, Step, StrategyScores, StrategyTally};
use tendon_gesture::{Decider, Evidence, Strategy};
use tendon_recordings::{Channel, ReplayStream};
use tendon_signal::{Activity, SignalChain};

use crate::Failure;
use crate::progress::Progress;
use crate::run::write_json;

/// Command line of `tendon strategies`.
#[derive(Debug, Args)]
pub struct Options {
    /// Recordings with cues that follow on without a gap: folders of the 3DC layout, or folders above such.
    #[arg(required = true, value_name = "PATH")]
    recordings: Vec<PathBuf>,
    /// Only this strategy; all three when left out.
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
    /// Only these people, by number; when left out, all whom none of the models was trained on.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<u16>,
    /// Channels, in this order.
    #[arg(long, value_delimiter = ',', default_value = "0,3,5,8")]
    channels: Vec<usize>,
    /// Configuration file with the settings of dsp and decision; the defaults when left out.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Change one setting, such as decision.vote_windows=5.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// ONNX model of the five gestures, for threshold and two_stage; the one that comes with Tendon when left out.
    #[arg(long, value_name = "FILE")]
    five_gesture_model: Option<PathBuf>,
    /// ONNX model of rest and move, for two_stage; the one that comes with Tendon when left out.
    #[arg(long, value_name = "FILE")]
    rest_move_model: Option<PathBuf>,
    /// ONNX model of all six classes, for direct; the one that comes with Tendon when left out.
    #[arg(long, value_name = "FILE")]
    six_class_model: Option<PathBuf>,
    /// ONNX Runtime's shared library; without it, ORT_DYLIB_PATH, then what scripts/fetch-onnxruntime fetched.
    #[arg(long, value_name = "FILE")]
    runtime_library: Option<PathBuf>,
    /// Writes the scores there as JSON, too.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// The models of the strategies; `None` stands for the one that comes with Tendon.
#[derive(Clone, Debug, Default)]
pub struct Models {
    /// Of the five gestures.
    pub five_gesture: Option<PathBuf>,
    /// Of rest and move.
    pub rest_move: Option<PathBuf>,
    /// Of all six classes.
    pub six_class: Option<PathBuf>,
}

impl Models {
    /// Loads what `strategy` needs.
    ///
    /// # Errors
    ///
    /// When a model cannot be loaded or does not fit `config`.
    pub fn load(&self, library: &Path, strategy: Strategy, config: &Config) -> anyhow::Result<Recogniser> {
        let model = match strategy {
            Strategy::Threshold | Strategy::TwoStage => &self.five_gesture,
            Strategy::Direct => &self.six_class,
        };
        let recogniser = Recogniser::load(library, strategy, model.as_deref(), self.rest_move.as_deref())?;
        let acquisition = &config.acquisition;
        recogniser.check_fit(&WindowSource::of_chain(
            "the configuration",
            acquisition.channels,
            acquisition.sample_rate_hz,
            &config.dsp,
        ))?;
        Ok(recogniser)
    }
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct AllScores {
    recordings: Vec<PathBuf>,
    people: BTreeSet<u16>,
    /// Recordings that could not be used, and why.
    skipped: Vec<String>,
    strategies: BTreeMap<&'static str, StrategyScores>,
}

/// Scores the strategies.
pub fn score(options: &Options) -> Result<(), Failure> {
    let library =
        tendon_classifier::runtime_library(options.runtime_library.as_deref()).map_err(Failure::input)?;
    let config = configuration(options).map_err(Failure::input)?;
    let models = Models {
        five_gesture: options.five_gesture_model.clone(),
        rest_move: options.rest_move_model.clone(),
        six_class: options.six_class_model.clone(),
    };
    let chosen = options.strategy.map_or(Strategy::ALL.to_vec(), |strategy| vec![strategy]);
    let mut recognisers = Vec::new();
    for strategy in chosen {
        recognisers.push((strategy, models.load(&library, strategy, &config).map_err(Failure::input)?));
    }
    let settings = dataset_settings(&config, &options.channels);
    let found = list(&settings, &options.recordings).map_err(Failure::input)?;
    let known: BTreeSet<u16> = found.recordings.iter().map(|recording| recording.person).collect();
    let trained = recognisers.iter().flat_map(|(_, recogniser)| recogniser.people_trained()).collect();
    let people = crate::evaluate::chosen_people(&known, &options.people, &trained).map_err(Failure::input)?;
    let recordings: Vec<Recording> =
        found.recordings.into_iter().filter(|recording| people.contains(&recording.person)).collect();

    let mut all = AllScores {
        recordings: options.recordings.clone(),
        people,
        skipped: found.skipped.iter().map(ToString::to_string).collect(),
        strategies: BTreeMap::new(),
    };
    let (recordings, skipped) = with_trials(&settings, recordings);
    if recordings.is_empty() {
        let reason = skipped.first().map_or("there is none", String::as_str);
        return Err(Failure::input(anyhow!("no recording could be used: {reason}")));
    }
    all.skipped.extend(skipped);
    for (strategy, mut recogniser) in recognisers {
        let config = with_strategy(&config, strategy);
        let scores =
            score_strategy(&config, &mut recogniser, &settings, &recordings).map_err(Failure::running)?;
        println!("strategy {}\n{scores}", strategy.name());
        all.strategies.insert(strategy.name(), scores);
    }
    if !all.skipped.is_empty() {
        println!("left out:");
        all.skipped.iter().for_each(|skipped| println!("  {skipped}"));
    }
    options.json.as_ref().map_or(Ok(()), |path| write_json(path, &all)).map_err(Failure::running)
}

fn configuration(options: &Options) -> anyhow::Result<Config> {
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

/// How recordings are read for a session of `config`, and its windows cut.
pub fn dataset_settings(config: &Config, channels: &[usize]) -> DatasetSettings {
    DatasetSettings {
        channels: channels.iter().copied().map(Channel::Index).collect(),
        sample_rate_hz: config.acquisition.sample_rate_hz,
        filter: Some(config.dsp.filter.clone()),
        windows: config.dsp.windows.clone(),
        ..DatasetSettings::default()
    }
}

/// `config` with another strategy.
pub fn with_strategy(config: &Config, strategy: Strategy) -> Config {
    let mut config = config.clone();
    config.decision.strategy = strategy;
    config
}

/// A recording that can be read to its end, and where the movements in it begin.
pub struct WithTrials {
    recording: Recording,
    /// At least one.
    trials: Vec<RecordingEntry>,
}

/// Reads all `recordings` once; beside those that can be used, which cannot and why.
pub fn with_trials(settings: &DatasetSettings, recordings: Vec<Recording>) -> (Vec<WithTrials>, Vec<String>) {
    let (mut usable, mut skipped) = (Vec::new(), Vec::new());
    for recording in recordings {
        match cut(settings, &recording, &mut |_| {}) {
            Ok(cut) if cut.trials.is_empty() => {
                skipped.push(format!("{}: holds none of the six gestures", recording.path.display()));
            }
            Ok(cut) => usable.push(WithTrials { recording, trials: cut.trials }),
            Err(error) => skipped.push(error.to_string()),
        }
    }
    (usable, skipped)
}

/// Scores the strategy of `config` on `recordings`.
///
/// # Errors
///
/// When the settings do not fit or the model fails.
pub fn score_strategy(
    config: &Config,
    recogniser: &mut Recogniser,
    settings: &DatasetSettings,
    recordings: &[WithTrials],
) -> anyhow::Result<StrategyScores> {
    let mut tally = StrategyTally::new(settings.sample_rate_hz);
    let mut progress = Progress::of(recordings.len(), "recordings");
    for (index, WithTrials { recording, trials }) in recordings.iter().enumerate() {
        progress.show(index, || format!(", strategy {}", config.decision.strategy.name()));
        let stream = recording.stream(settings, config.acquisition.block_samples)?;
        let (cues, steps) =
            run(config, recogniser, stream, trials).with_context(|| recording.path.display().to_string())?;
        let RecordingEntry { person, session, repetition, .. } = &trials[0];
        tally.add(*person, session, *repetition, &cues, &steps);
    }
    Ok(tally.scores())
}

/// Runs a recording through the whole chain.
fn run(
    config: &Config,
    recogniser: &mut Recogniser,
    mut stream: ReplayStream,
    trials: &[RecordingEntry],
) -> anyhow::Result<(Vec<CuePart>, Vec<Step>)> {
    let sample_rate_hz = config.acquisition.sample_rate_hz;
    let mut chain = SignalChain::new(&config.dsp, config.acquisition.channels, sample_rate_hz)?;
    let mut decider = Decider::new(&config.decision)?;
    let mut block = vec![0.0; config.block_length()];
    let mut window = vec![0.0; config.window_length()];
    let segments = stream.source().segments().to_vec();
    let mut cues: Vec<CuePart> = Vec::new();
    let mut steps = Vec::new();
    let mut segment = None;
    let mut end = 0;
    while let Some(replayed) = stream.next_block(&mut block)? {
        if segment != Some(replayed.segment) {
            segment = Some(replayed.segment);
            let start = replayed.cue_since;
            let part = &segments[replayed.segment];
            let trial = trials.iter().find(|trial| {
                trial.file == part.file && (part.end_sample.is_none() || trial.first_sample == start)
            });
            cues.push(CuePart {
                gesture: part.cue,
                start,
                begun: trial.map(|trial| start + trial.start_sample as u64),
                onset: trial.and_then(|trial| trial.onset_sample).map(|onset| start + onset as u64),
                end: u64::MAX,
            });
        }
        end = replayed.first_sample + config.acquisition.block_samples as u64;
        let mut from = 0;
        while from < config.acquisition.block_samples {
            let began = Instant::now();
            let push = chain.push(&block, from);
            from += push.consumed;
            let Some(complete) = push.window else { continue };
            chain.write_window(&mut window);
            let probabilities = recogniser.recognise(&window)?;
            let decision = decider.decide(&Evidence {
                probabilities,
                moving: complete.activity == Activity::Move,
                intact: complete.replaced_samples == 0,
                captured_ns: (complete.first_sample as f64 * 1e9 / sample_rate_hz) as u64,
            });
            steps.push(Step {
                first_sample: complete.first_sample,
                end_sample: complete.first_sample + config.dsp.windows.window_samples as u64,
                gesture: decision.gesture,
                voted: decision.voted,
                toggles_gripper: decision.toggles_gripper,
                work_ns: began.elapsed().as_nanos() as u64,
            });
        }
    }
    for index in 0..cues.len() {
        cues[index].end = cues.get(index + 1).map_or(end, |next| next.start);
    }
    Ok((cues, steps))
}
