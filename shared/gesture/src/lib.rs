//! Gestures, and what turns a stream of class probabilities into intentions.
//!
//! ```text
//! probabilities ─▶ strategy ─▶ gesture ─▶ vote of three ─┬─▶ velocity map ─▶ twist
//!     activity ──▶                                       └─▶ gripper ──────▶ open | close
//! ```
#![forbid(unsafe_code)]

mod label;

pub use label::{Gesture, UnknownGesture};
