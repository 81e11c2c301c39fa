//! Gestures, and the decisions that turn a stream of class probabilities into intentions.
//!
//! ```text
//! probabilities ─▶ strategy ─▶ gesture ─▶ vote, or evidence of a person ─┬─▶ mode ─▶ velocity along or about an axis
//!     activity ──▶                                                       └─▶ held ─▶ gripper: open | closed, next mode
//! ```
#![forbid(unsafe_code)]

mod belief;
mod class;
mod decide;
mod hold;
mod label;
mod map;
mod set;
mod settings;
mod vote;

pub use belief::EvidenceSettings;
pub use class::Class;
pub use decide::{Decider, Decision, Evidence};
pub use label::{Gesture, LONGEST_NAME, NoGestureName, UnknownGesture};
pub use map::{
    Action, Axis, Direction, Frame, InvalidModes, MAXIMUM_MODES, Mode, Motion, NoAction, NoDirection,
};
pub use set::{GestureSet, InvalidGestureSet};
pub use settings::{DecisionSettings, InvalidDecisionSetting, SpeedControl, Strategy};
