//! The personal strategy on continuous recordings: a recogniser is calibrated to each person, once, on the first
//! repetitions of the first session, and scored on later ones.
//!
//! ```text
//! person's first session ─▶ first repetitions ─▶ Person::fit ─▶ pipeline ─┐
//! other people ─▶ Cohort without the person ─▶ prior ──┘                  │
//! person's last session ──────────────────────────────────────────────────┴─▶ StrategyTally
//! ```

use std::path::Path;

use tendon_classifier::{Adaptation, Recogniser};
use tendon_dataset::{DatasetSettings, Layout, Recording};
use tendon_features::{Cohort, MethodSettings, PriorError};
use tendon_gesture::{DecisionSettings, Strategy};
use tendon_identity::PersonId;
use tendon_people::{CalibrationError, Made, Person, PersonName};
use tendon_pipeline::{Pipeline, PipelineError, PipelineSettings};

use crate::personal::prior_without;
use crate::score::OnProgress;
use crate::strategies::{PersonRecordings, StrategyError, score_person, tally};
use crate::strategy_scores::StrategyScores;
use crate::windows::PersonWindows;

/// How people are calibrated for the personal strategy.
#[derive(Clone, Debug)]
pub struct Calibrating<'a> {
    /// How windows are cut to calibrate on.
    pub dataset: &'a DatasetSettings,
    /// The constants of the recogniser.
    pub method: &'a MethodSettings,
    /// The people who make the prior.
    pub cohort: &'a Cohort,
    /// The layout in which people have their numbers.
    pub layout: Layout,
}

/// Why somebody cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum PersonalStrategyError {
    /// There are no repetitions to score after those that calibrate.
    #[error(
        "person {person} has nothing left to score after {repetitions} repetitions that calibrate; take fewer with \
         --calibrate-repetitions"
    )]
    NothingLeft {
        /// The person.
        person: PersonId,
        /// The repetitions that would calibrate.
        repetitions: usize,
    },
    /// The windows that calibrate make no recogniser.
    #[error("person {person} cannot be calibrated: {problem}")]
    Calibration {
        /// The person.
        person: PersonId,
        /// What is wrong with them.
        problem: CalibrationError,
    },
    /// Other people make no prior.
    #[error(transparent)]
    Prior(#[from] PriorError),
}

/// Fits a recogniser to a person on the repetitions that `person` holds back from the score; see
/// [`PersonRecordings::hold_back`].
///
/// # Errors
/// When the windows make no recogniser.
pub fn calibrate_person(
    person: &PersonRecordings,
    calibrating: &Calibrating<'_>,
) -> Result<Person, PersonalStrategyError> {
    let Calibrating { dataset, method, cohort, layout } = *calibrating;
    let number = person.person();
    let recordings: Vec<Recording> = person.calibrating().cloned().collect();
    // What cannot be read has been said before.
    let windows = PersonWindows::read(dataset, &recordings, &mut Vec::new());
    let calibrates: Vec<usize> = (0..windows.origins().len())
        .filter(|&window| person.calibrates_repetition(windows.origins()[window].repetition_of_all))
        .collect();
    let prior = prior_without(cohort, layout, number)?;
    let name = PersonName::of(number);
    windows
        .fit(&calibrates, name, Made::default(), method, prior.as_ref(), &[])
        .map_err(|problem| PersonalStrategyError::Calibration { person: number, problem })
}

/// Scores the personal strategy on `recordings`, each with the recogniser of the person in the same place of `people`.
/// What that adapts to lasts until the person's last recording. Recordings are read as `dataset` says. `on_progress` counts
/// recordings.
///
/// # Errors
/// When a recording cannot be read, a recogniser does not fit the settings, or it fails on a window.
pub fn score_personal(
    settings: &PipelineSettings,
    adaptation: Adaptation,
    dataset: &DatasetSettings,
    recordings: &[PersonRecordings],
    people: &[Person],
    on_progress: &mut OnProgress<'_>,
) -> Result<StrategyScores, StrategyError> {
    let mut tally = tally(settings);
    let total = recordings.iter().map(PersonRecordings::scored_count).sum();
    let mut done = 0;
    for (recordings, person) in recordings.iter().zip(people) {
        let mut on_recording = || {
            on_progress(done, total);
            done += 1;
        };
        let pipeline = pipeline_of(settings, adaptation, person);
        let mut pipeline = pipeline.map_err(|error| recordings.failed(error.into()))?;
        score_person(&mut pipeline, dataset, recordings, &mut tally, &mut on_recording)?;
    }
    Ok(tally.scores())
}

/// A pipeline with the recogniser of `person`, whose gestures do what the modes of `settings` say.
fn pipeline_of(
    settings: &PipelineSettings,
    adaptation: Adaptation,
    person: &Person,
) -> Result<Pipeline, PipelineError> {
    let gestures = person.gesture_set();
    let mut modes = settings.decision.modes.clone();
    modes.iter_mut().for_each(|mode| mode.keep(&gestures));
    let decision =
        DecisionSettings { strategy: Strategy::Personal, gestures, modes, ..settings.decision.clone() };
    let path = Path::new(person.name.as_str());
    let recogniser =
        Recogniser::of_person(person.clone(), path, &decision.gestures, &settings.signal.windows)?;
    let recogniser = recogniser.with_adaptation(adaptation)?;
    Pipeline::new(PipelineSettings { decision, ..settings.clone() }, recogniser)
}
