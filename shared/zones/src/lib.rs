//! The target-zone task: steer the arm into zones, one after the other, and see how well that goes.
//!
//! ```text
//!   ┌──────────────────────── the system: muscle signals to motion ───────────────────┐
//!   ▼                                                                                 │
//! position ─┬─▶ ZoneTask: appear ─▶ enter ─▶ dwell ─▶ reached, the next appears ─▶ TaskReport
//!           │       │ zone                    └─▶ leave: an overshoot                 │
//!           └───────┴─▶ SimulatedUser: sees late, reacts, errs ─▶ gesture ────────────┘
//! ```
//!
//! The task is the paper's ("Simulations and Implementation on the Robotic Arm"), scored as ISO 9241-411 and
//! studies of myoelectric control score pointing: see [`ZoneScore`]. Everything is pure: time and positions
//! are given from outside, and the same seed gives the same zones and the same user.
//!
//! Positions are those of the flange in the arm's base frame, mm. Zones lie along the axes that the gestures move the arm
//! along, in one mode or another: by default along y and z, in the plane of the x at which the task began.
#![forbid(unsafe_code)]

mod controls;
mod report;
mod run;
mod settings;
mod task;
mod user;
mod zone;

pub use controls::{Controls, NothingMoves};
pub use report::{TaskReport, TaskStatus, ZoneScore, ZoneStatus};
pub use run::{TaskKind, TaskPlan, TaskRun};
pub use settings::{TaskSettings, TaskSettingsError, UserSettings};
pub use task::ZoneTask;
pub use user::{Contraction, SimulatedUser};
pub use zone::{NoRoomForZones, Placement, Workspace, Zone, ZoneShape};
