//! Scores a strategy on continuous recordings with cues.
//!
//! ```text
//! a person's first rest ─▶ calibrates the activity detector, once
//! recording ─▶ blocks ─▶ pipeline ─▶ what the arm would do ─┐
//!     └─▶ onsets of the movements ──────────────────────────┴─▶ scores
//! ```

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

use tendon_classifier::Recogniser;
use tendon_dataset::{DatasetSettings, Recording, RecordingEntry, cut};
use tendon_gesture::{Action, DecisionSettings, Gesture, Strategy};
use tendon_identity::PersonId;
use tendon_pipeline::{Pipeline, PipelineError, PipelineSettings};
use tendon_recordings::{Channel, RecordingError, ReplayBlock, ReplayStream, Segment, SkippedKind};

use crate::continuous::{Asked, CuePart, Step, StrategyTally};
use crate::left_out::LeftOut;
use crate::personal_strategy::PersonalStrategyError;
use crate::score::OnProgress;
use crate::strategy_scores::StrategyScores;

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
pub fn dataset_settings(pipeline: &PipelineSettings, channels: &[Channel]) -> DatasetSettings {
    DatasetSettings {
        channels: channels.to_vec(),
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
    /// The activity detector would never say that anybody moves.
    #[error(
        "person {person} rests too briefly to calibrate the activity detector: {missing_s:.1} s are missing; leave \
         the person out with --people, shorten dsp.activity.calibration_s, or leave the threshold strategy out"
    )]
    NotCalibrated {
        /// The person.
        person: PersonId,
        /// By how much all rest of the person is too short, s.
        missing_s: f64,
    },
}

/// What is scored of a person: recordings that can be read to their ends, in order.
#[derive(Debug)]
pub struct PersonRecordings {
    person: PersonId,
    /// At least one.
    recordings: Vec<WithTrials>,
    /// Repetitions that calibrate a recogniser, counted through all sessions; then only the others of the last session
    /// are scored.
    calibrating: Option<BTreeSet<u8>>,
}

impl PersonRecordings {
    /// Who it is.
    pub fn person(&self) -> PersonId {
        self.person
    }

    /// Sets the first `repetitions` of the first session apart to calibrate on. Scored is the last session, or what is
    /// left of an only one. By default, four calibrate, or as many as leave something to score.
    ///
    /// # Errors
    /// When nothing is left to score.
    pub fn hold_back(&mut self, repetitions: Option<u32>) -> Result<(), PersonalStrategyError> {
        let trials = || self.recordings.iter().flat_map(|recording| &recording.trials);
        let of_session = |session: &str| {
            let own = trials().filter(|trial| trial.session == session);
            own.map(|trial| trial.repetition_of_all).collect::<BTreeSet<u8>>()
        };
        let first = of_session(&self.recordings[0].recording.session);
        let is_only = self.recordings[0].recording.session == self.last_session();
        let most = first.len() - usize::from(is_only);
        let repetitions = repetitions.map_or(DEFAULT_REPETITIONS.min(most), |given| given as usize);
        let calibrating: BTreeSet<u8> = first.iter().copied().take(repetitions).collect();
        if calibrating.is_empty() || (is_only && calibrating.len() == first.len()) {
            return Err(PersonalStrategyError::NothingLeft { person: self.person, repetitions });
        }
        self.calibrating = Some(calibrating);
        Ok(())
    }

    /// Scores everything again.
    pub fn hold_nothing_back(&mut self) {
        self.calibrating = None;
    }

    /// Whether this repetition, counted through all sessions, calibrates.
    pub(crate) fn calibrates_repetition(&self, repetition_of_all: u8) -> bool {
        self.calibrating.as_ref().is_some_and(|calibrating| calibrating.contains(&repetition_of_all))
    }

    /// The recordings with repetitions that calibrate.
    pub(crate) fn calibrating(&self) -> impl Iterator<Item = &Recording> {
        let calibrates = |recording: &&WithTrials| {
            recording.trials.iter().any(|trial| self.calibrates_repetition(trial.repetition_of_all))
        };
        self.recordings.iter().filter(calibrates).map(|recording| &recording.recording)
    }

    /// How many recordings are scored.
    pub(crate) fn scored_count(&self) -> usize {
        self.recordings.iter().filter(|recording| self.is_scored(recording)).count()
    }

    /// An error that concerns all recordings of the person.
    pub(crate) fn failed(&self, problem: StrategyProblem) -> StrategyError {
        StrategyError { path: self.recordings[0].recording.path.clone(), problem }
    }

    fn last_session(&self) -> &str {
        self.recordings.last().map_or("", |recording| &recording.recording.session)
    }

    /// Whether anything of a recording is scored.
    fn is_scored(&self, recording: &WithTrials) -> bool {
        recording.trials.iter().any(|trial| self.is_trial_scored(&trial.session, trial.repetition_of_all))
    }

    fn is_trial_scored(&self, session: &str, repetition_of_all: u8) -> bool {
        self.calibrating.is_none()
            || (session == self.last_session() && !self.calibrates_repetition(repetition_of_all))
    }
}

/// Repetitions that calibrate a recogniser where nobody says how many.
const DEFAULT_REPETITIONS: usize = 4;

/// A recording that can be read to its end, and where the movements in it begin.
#[derive(Debug)]
struct WithTrials {
    recording: Recording,
    /// At least one.
    trials: Vec<RecordingEntry>,
}

/// Reads all `recordings` once and sorts them by person; beside those that can be used, which cannot and why.
pub fn with_trials(
    settings: &DatasetSettings,
    recordings: Vec<Recording>,
) -> (Vec<PersonRecordings>, Vec<LeftOut>) {
    let (mut people, mut skipped): (Vec<PersonRecordings>, _) = (Vec::new(), Vec::new());
    for recording in recordings {
        match cut(settings, &recording, &mut |_| {}) {
            Ok(cut) if cut.trials.is_empty() => {
                let reason = format!("{}: contains none of the six gestures", recording.path.display());
                skipped.push(LeftOut { kind: SkippedKind::NoTrial, reason });
            }
            Ok(cut) => {
                let person = recording.person;
                let usable = WithTrials { recording, trials: cut.trials };
                match people.iter_mut().find(|own| own.person == person) {
                    Some(own) => own.recordings.push(usable),
                    None => {
                        people.push(PersonRecordings { person, recordings: vec![usable], calibrating: None });
                    }
                }
            }
            Err(error) => skipped.push(LeftOut::from(&recording.skipped(&error))),
        }
    }
    (people, skipped)
}

/// Samples of a block. What comes out does not depend on it.
const BLOCK_SAMPLES: usize = 10;

/// Scores the strategy of `pipeline` on all `people`, read as `settings` say. `on_progress` counts recordings.
///
/// # Errors
/// When a recording cannot be read, a model fails on a window, or somebody does not rest long enough to calibrate the
/// activity detector of the threshold strategy.
pub fn score_strategy(
    pipeline: &mut Pipeline,
    settings: &DatasetSettings,
    people: &[PersonRecordings],
    on_progress: &mut OnProgress<'_>,
) -> Result<StrategyScores, StrategyError> {
    let mut tally = tally(pipeline.settings());
    let total = people.iter().map(PersonRecordings::scored_count).sum();
    let mut done = 0;
    for person in people {
        let mut on_recording = || {
            on_progress(done, total);
            done += 1;
        };
        score_person(pipeline, settings, person, &mut tally, &mut on_recording)?;
    }
    Ok(tally.scores())
}

/// A tally of what a pipeline with these settings does.
pub(crate) fn tally(settings: &PipelineSettings) -> StrategyTally {
    let DecisionSettings { gestures, modes, .. } = &settings.decision;
    let works_gripper =
        |gesture: &Gesture| modes.iter().any(|mode| mode.actions.get(gesture) == Some(&Action::Gripper));
    StrategyTally::new(
        settings.sample_rate_hz,
        settings.signal.windows.increment_samples,
        gestures.iter().filter(works_gripper).collect(),
    )
}

/// Scores the strategy of `pipeline` on one person. `on_recording` is called before each recording that is scored.
pub(crate) fn score_person(
    pipeline: &mut Pipeline,
    settings: &DatasetSettings,
    person: &PersonRecordings,
    tally: &mut StrategyTally,
    on_recording: &mut dyn FnMut(),
) -> Result<(), StrategyError> {
    let calibrated = calibrate(pipeline, settings, person)?;
    for (index, with_trials) in person.recordings.iter().enumerate() {
        if !person.is_scored(with_trials) {
            continue;
        }
        on_recording();
        let WithTrials { recording, trials } = with_trials;
        let failed = |problem| StrategyError { path: recording.path.clone(), problem };
        let stream = recording.stream(settings, BLOCK_SAMPLES).map_err(|error| failed(error.into()))?;
        let calibrated = calibrated.get(index).map_or(&[][..], Vec::as_slice);
        let (cues, steps) = run(pipeline, stream, person, with_trials, calibrated).map_err(failed)?;
        let RecordingEntry { person, session, repetition, .. } = &trials[0];
        tally.add(*person, session, *repetition, &cues, &steps);
    }
    Ok(())
}

/// Calibrates the activity detector on the first rest of a person; which samples of each recording it took.
fn calibrate(
    pipeline: &mut Pipeline,
    settings: &DatasetSettings,
    person: &PersonRecordings,
) -> Result<Vec<Vec<Range<u64>>>, StrategyError> {
    let first = &person.recordings[0].recording.path;
    let mut taken = Vec::new();
    pipeline.restart().map_err(|error| StrategyError { path: first.clone(), problem: error.into() })?;
    for WithTrials { recording, .. } in &person.recordings {
        if pipeline.calibration_left_samples() == 0 {
            break;
        }
        let failed = |problem| StrategyError { path: recording.path.clone(), problem };
        pipeline.next_recording().map_err(|error| failed(error.into()))?;
        let stream = recording.stream(settings, BLOCK_SAMPLES).map_err(|error| failed(error.into()))?;
        taken.push(calibrate_on(pipeline, stream).map_err(failed)?);
    }
    let left_samples = pipeline.calibration_left_samples();
    if left_samples > 0 && pipeline.settings().decision.strategy == Strategy::Threshold {
        let missing_s = left_samples as f64 / settings.sample_rate_hz;
        let problem = StrategyProblem::NotCalibrated { person: person.person, missing_s };
        return Err(StrategyError { path: first.clone(), problem });
    }
    Ok(taken)
}

/// Gives the activity detector the rest of a recording until it has enough; which samples it took.
fn calibrate_on(
    pipeline: &mut Pipeline,
    mut stream: ReplayStream,
) -> Result<Vec<Range<u64>>, StrategyProblem> {
    let mut block = vec![0.0; pipeline.settings().channels * BLOCK_SAMPLES];
    let mut taken: Vec<Range<u64>> = Vec::new();
    while pipeline.calibration_left_samples() > 0
        && let Some(ReplayBlock { first_sample, cue, .. }) = stream.next_block(&mut block)?
    {
        if cue != Some(Gesture::REST) {
            continue;
        }
        let end = first_sample + BLOCK_SAMPLES as u64;
        match taken.last_mut().filter(|last| last.end == first_sample) {
            Some(last) => last.end = end,
            None => taken.push(first_sample..end),
        }
        pipeline.push(&block, |_| {})?;
    }
    Ok(taken)
}

/// Runs a recording through the whole pipeline, whose activity detector was calibrated on `calibrated`.
fn run(
    pipeline: &mut Pipeline,
    mut stream: ReplayStream,
    person: &PersonRecordings,
    recording: &WithTrials,
    calibrated: &[Range<u64>],
) -> Result<(Vec<CuePart>, Vec<Step>), StrategyProblem> {
    pipeline.next_recording()?;
    let window_samples = pipeline.settings().signal.windows.window_samples as u64;
    let mut block = vec![0.0; pipeline.settings().channels * BLOCK_SAMPLES];
    let segments = stream.source().segments().to_vec();
    let mut cues: Vec<CuePart> = Vec::new();
    let mut steps = Vec::new();
    let mut segment = None;
    let mut end = 0;
    while let Some(replayed) = stream.next_block(&mut block)? {
        if segment.replace(replayed.segment) != Some(replayed.segment) {
            let segment = &segments[replayed.segment];
            // What follows a cue without one of its own is scored as that cue is.
            let is_scored = match segment.repetition {
                Some(repetition) => person.is_trial_scored(
                    &recording.recording.session,
                    recording.recording.repetition_of_all(repetition),
                ),
                None => cues.last().is_none_or(|cue| cue.is_scored),
            };
            cues.push(CuePart { is_scored, ..cue_part(segment, replayed.cue_since, &recording.trials) });
        }
        if replayed.first_sample > end {
            pipeline.gap(replayed.first_sample - end);
        }
        end = replayed.first_sample + BLOCK_SAMPLES as u64;
        pipeline.push(&block, |step| {
            let first_sample = step.window.first_sample;
            let end_sample = first_sample + window_samples;
            let overlaps = |range: &Range<u64>| range.start < end_sample && range.end > first_sample;
            let twist = step.decision.twist;
            steps.push(Step {
                first_sample,
                end_sample,
                calibrates: calibrated.iter().any(overlaps),
                gesture: step.decision.gesture,
                told: step.decision.voted,
                moves: twist.iter().any(|velocity| *velocity != 0.0),
                speed_mm_per_s: twist[..3].iter().map(|velocity| velocity * velocity).sum::<f64>().sqrt(),
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

/// A segment that begins at `start`, with what is known of its trial. Its end is not known yet.
fn cue_part(segment: &Segment, start: u64, trials: &[RecordingEntry]) -> CuePart {
    let trial = trials.iter().find(|trial| {
        trial.file == segment.file && (segment.end_sample.is_none() || trial.first_sample == start)
    });
    CuePart {
        asked: match (segment.cue, segment.repetition) {
            (Some(gesture), _) => Asked::Gesture(gesture),
            (None, Some(_)) => Asked::OtherMovement,
            (None, None) => Asked::Nothing,
        },
        is_scored: true,
        start,
        begun: trial.map(|trial| start + trial.start_sample as u64),
        onset: trial.and_then(|trial| trial.onset_sample).map(|onset| start + onset as u64),
        end: u64::MAX,
    }
}
