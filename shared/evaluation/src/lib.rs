//! How well a classifier recognises gestures, and a strategy steers.
//!
//! ```text
//! data set, recordings ─▶ windows ─▶ model ─▶ Tally ─▶ Evaluation ─▶ text, JSON           (score)
//! recordings ─▶ a recogniser for each person ─▶ Tally ─▶ Evaluation                    (personal)
//! recordings with cues ─▶ pipeline ─▶ decisions ─▶ StrategyTally ─▶ StrategyScores          (strategies)
//! ```
//!
//! Scores are scikit-learn's, to the last digit: `classification_report`, `confusion_matrix`, `log_loss`.
#![forbid(unsafe_code)]

mod confusion;
mod continuous;
mod evaluation;
mod left_out;
mod people;
mod personal;
mod personal_strategy;
mod score;
mod sequence;
mod strategies;
mod strategy_scores;
mod tally;
mod unlabelled;
mod windows;

pub use confusion::{ClassScores, Confusion};
pub use continuous::{Asked, CuePart, FALL_MS, Step, StrategyTally};
pub use evaluation::{ConfusedPair, Evaluation, Spread};
pub use left_out::LeftOut;
pub use people::{PeopleError, chosen_people};
pub use personal::{
    PersonalError, PersonalScores, PersonalSettings, SCORED_SESSION, gather_cohort, prior_without,
    score_people,
};
pub use personal_strategy::{Calibrating, PersonalStrategyError, calibrate_person, score_personal};
pub use score::{OnProgress, ScoreError, Scores, score_dataset, score_recordings, settings_of};
pub use strategies::{
    PersonRecordings, StrategyError, StrategyModels, StrategyProblem, dataset_settings, score_strategy,
    with_trials,
};
pub use strategy_scores::{GestureWindows, RepetitionScores, StrategyScores, Times, in_words};
pub use tally::{Answer, Group, Origin, Tally};
pub use unlabelled::{UnlabelledPerson, UnlabelledScores, UnlabelledSettings, score_unlabelled};
pub use windows::{MemberError, PersonWindows, UnlabelledFitError, WindowOrigin};
