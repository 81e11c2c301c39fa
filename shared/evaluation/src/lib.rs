//! How well a classifier recognises gestures.
//!
//! ```text
//! window ─▶ probabilities ─▶ Tally ─▶ Evaluation ─▶ text, JSON
//! its true gesture, person, repetition ─┘
//! ```
//!
//! Scores are scikit-learn's, to the last digit: `classification_report`, `confusion_matrix`, `log_loss`.
#![forbid(unsafe_code)]

mod confusion;
mod continuous;
mod evaluation;
mod tally;

pub use confusion::{ClassScores, Confusion};
pub use continuous::{CuePart, GestureWindows, RepetitionScores, Step, StrategyScores, StrategyTally, Times};
pub use evaluation::{ConfusedPair, Evaluation, Group, Spread};
pub use tally::{Answer, Origin, Tally};
