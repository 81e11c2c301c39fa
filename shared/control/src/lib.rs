//! When an arm may move, and how it is stopped: everything that the robot process decides.
//!
//! ```text
//! commands ──▶ in order? fresh? ──▶ latch: permitted? ──▶ arm.command, arm.move_gripper
//! orders ────▶ stop, arm ──────────────▲
//! heartbeat ─▶ supervisor there? ──────┤
//! arm.report ▶ guard, silence, errors ─┘            states ◀── Controller::state
//! ```
//!
//! [`Controller`] is pure: time comes in as nanoseconds, the arm is whatever stands behind [`Arm`], and there is no
//! clock, socket or file. So each way to stop the arm is a test of milliseconds on an arm that is not there. It is
//! software, not safety-rated, and replaces no emergency stop.
#![forbid(unsafe_code)]

mod answer;
mod arm;
mod controller;
#[cfg(test)]
mod fake;
mod gripper;
mod latch;
mod simulated;
mod start;

pub use answer::{ArmAnswer, Outdated, StopAnswer};
pub use arm::{Arm, ArmReport, Drive, Link, Stop};
pub use controller::{ControlSettings, Controller, State, Taken};
pub use start::Departure;
