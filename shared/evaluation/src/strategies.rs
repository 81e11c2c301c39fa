//! Scores a strategy on continuous recordings with cues.
//!
//! ```text
//! recording ─▶ blocks ─▶ pipeline ─▶ what the arm would do ─┐
//!     └─▶ onsets of the movements ──────────────────────────┴─▶ scores
//! ```

use std::path::{Path, PathBuf};

use tendon_classifier::Recogniser;
use tendon_dataset::{DatasetSettings, Recording, RecordingEntry, cut};
use tendon_gesture::Strategy;
use tendon_pipeline::{Pipeline, PipelineError, PipelineSettings};
use tendon_recordings::{Channel, RecordingError, ReplayStream};

use crate::continuous::{CuePart, Step, StrategyScores, StrategyTally};
use crate::score::OnProgress;

/// The models of the strategies; `None` stands for the one that comes with Tendon.
#[derive(Clone, Debug, Default)]
pub struct StrategyModels {
    /// Of the five gestures.
    pub five_gesture: Option<PathBuf>,
    /// Of rest and move.
    pub rest_move: Option<PathBuf>,
    /// Of all six classes.
    pub six_class: Option<PathBuf>,
}

impl StrategyModels {
    /// A pipeline with the models that the strategy of `settings` needs, run by ONNX Runtime in `library`.
    ///
    /// # Errors
    /// When a model cannot be loaded or does not fit `settings`.
    pub fn pipeline(&self, library: &Path, settings: &PipelineSettings) -> Result<Pipeline, PipelineError> {
        let strategy = settings.decision.strategy;
        let model = match strategy {
            Strategy::Threshold | Strategy::TwoStage => &self.five_gesture,
            Strategy::Direct => &self.six_class,
            // It has no model: whoever calibrates makes the pipeline.
            Strategy::Personal => &None,
        };
        let recogniser =
            Recogniser::load(library, &settings.decision, model.as_deref(), self.rest_move.as_deref())?;
        Pipeline::new(settings.clone(), recogniser)
    }
}

/// How recordings are read, and their trials cut, for a pipeline with these settings.
pub fn dataset_settings(pipeline: &PipelineSettings, channels: &[usize]) -> DatasetSettings {
    DatasetSettings {
        channels: channels.iter().copied().map(Channel::Index).collect(),
        sample_rate_hz: pipeline.sample_rate_hz,
        filter: Some(pipeline.signal.filter.clone()),
        windows: pipeline.signal.windows.clone(),
        ..DatasetSettings::default()
    }
}

/// Why a strategy cannot be scored on a recording.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", .path.display())]
pub struct StrategyError {
    /// The recording.
    pub path: PathBuf,
    /// What went wrong.
    pub problem: StrategyProblem,
}

/// What can go wrong on the way through the pipeline.
#[derive(Debug, thiserror::Error)]
pub enum StrategyProblem {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The pipeline failed.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

/// A recording that can be read to its end, and where the movements in it begin.
#[derive(Debug)]
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
                skipped.push(format!("{}: contains none of the six gestures", recording.path.display()));
            }
            Ok(cut) => usable.push(WithTrials { recording, trials: cut.trials }),
            Err(error) => skipped.push(recording.skipped(&error).to_string()),
        }
    }
    (usable, skipped)
}

/// Samples of a block. What comes out does not depend on it.
const BLOCK_SAMPLES: usize = 10;

/// Scores the strategy of `pipeline` on `recordings`, read as `settings` say. `on_progress` counts recordings.
///
/// # Errors
/// When a recording cannot be read, or a model fails on a window.
pub fn score_strategy(
    pipeline: &mut Pipeline,
    settings: &DatasetSettings,
    recordings: &[WithTrials],
    on_progress: &mut OnProgress<'_>,
) -> Result<StrategyScores, StrategyError> {
    let mut tally = StrategyTally::new(settings.sample_rate_hz);
    for (index, WithTrials { recording, trials }) in recordings.iter().enumerate() {
        on_progress(index, recordings.len());
        let failed = |problem| StrategyError { path: recording.path.clone(), problem };
        let stream = recording.stream(settings, BLOCK_SAMPLES).map_err(|error| failed(error.into()))?;
        let (cues, steps) = run(pipeline, stream, trials).map_err(failed)?;
        let RecordingEntry { person, session, repetition, .. } = &trials[0];
        tally.add(*person, session, *repetition, &cues, &steps);
    }
    Ok(tally.scores())
}

/// Runs a recording through the whole pipeline.
fn run(
    pipeline: &mut Pipeline,
    mut stream: ReplayStream,
    trials: &[RecordingEntry],
) -> Result<(Vec<CuePart>, Vec<Step>), StrategyProblem> {
    pipeline.restart()?;
    let window_samples = pipeline.settings().signal.windows.window_samples as u64;
    let mut block = vec![0.0; pipeline.settings().channels * BLOCK_SAMPLES];
    let segments = stream.source().segments().to_vec();
    let mut cues: Vec<CuePart> = Vec::new();
    let mut steps = Vec::new();
    let mut segment = None;
    let mut end = 0;
    while let Some(replayed) = stream.next_block(&mut block)? {
        if segment.replace(replayed.segment) != Some(replayed.segment) {
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
        end = replayed.first_sample + BLOCK_SAMPLES as u64;
        pipeline.push(&block, |step| {
            steps.push(Step {
                first_sample: step.window.first_sample,
                end_sample: step.window.first_sample + window_samples,
                gesture: step.decision.gesture,
                voted: step.decision.voted,
                toggles_gripper: step.decision.toggles_gripper,
                work_ns: step.work_ns,
            });
        })?;
    }
    for index in 0..cues.len() {
        cues[index].end = cues.get(index + 1).map_or(end, |next| next.start);
    }
    Ok((cues, steps))
}
