//! The wire protocol of the UFACTORY xArm7, and a client that speaks it.
//!
//! ```text
//!            port 502                                           30003, 100 Hz    30001, 5 Hz
//! [`Command`] ──▶ request [`frame`] ──▶ arm ──▶ [`reply`] frame     │  [`report`]  │
//!     ▲                                            │                ▼              ▼
//!     └────────────────────────── [`Client`], one thread of its own ──────────▶ [`Status`]
//! ```
//!
//! Requests and replies use the control connection. The arm pushes its joints, pose, mode, state and settings over
//! the report connections. [`identity`] decides whether an arm is one that this crate can drive; [`error`] explains
//! every error code.
//!
//! A software stop, from this crate or any other program, is not safety-rated: keep the hardware emergency stop
//! within reach of whoever works near the arm.
//!
//! Lengths are in millimetres and angles in radians, as on the wire.
#![forbid(unsafe_code)]

mod client;
pub mod command;
pub mod error;
pub mod frame;
pub mod gripper;
pub mod identity;
pub mod reply;
pub mod report;

pub use client::{Client, ClientError, ClientSettings, Gripper, Halt, Phase, Status, Velocity};
pub use command::{ArmState, Command, Mode, StateOrder, TwistFrame};
pub use error::{Fault, Source};
pub use gripper::GripperRequest;
pub use identity::{Firmware, Identity, JointLimits, Unsupported};
pub use report::Setup;
