//! Gestures, and the decisions that turn a stream of class probabilities into intentions.
//!
//! ```text
//! probabilities ─▶ strategy ─▶ gesture ─▶ vote of three ─┬─▶ velocity map ─▶ velocity
//!     activity ──▶                                       └─▶ gripper ──────▶ open | closed
//! ```
#![forbid(unsafe_code)]

mod class;
mod decide;
mod label;
mod set;

pub use class::Class;
pub use decide::{Decider, Decision, DecisionSettings, Evidence, InvalidDecisionSetting, Strategy};
pub use label::{Gesture, LONGEST_NAME, NoGestureName, UnknownGesture};
pub use set::{GestureSet, InvalidGestureSet};
