//! The wire protocol of the UFACTORY xArm7, and a client that speaks it.
//!
//! ```text
//!            port 502                                          30003, 100 Hz    30001, 5 Hz
//! [`Command`] ──▶ request [`frame`] ──▶ arm ──▶ reply [`frame`]    │  [`report`]  │
//!     ▲                                              │             ▼              ▼
//!     └────────────────────────── [`Client`], one thread of its own ──────────▶ [`Status`]
//! ```
//!
//! Requests and replies go over the control connection, one at a time; the arm tells its joints, pose, mode and
//! state by itself over the report connections. [`error`] has the words and the remedy of every code.
//!
//! A software stop, of this crate or of any program, is not safety-rated: whoever works near the arm needs the
//! hardware emergency stop within reach.
//!
//! Lengths are millimetres and angles radians, as on the wire.
#![forbid(unsafe_code)]

mod client;
pub mod command;
pub mod error;
pub mod frame;
pub mod report;

pub use client::{Client, ClientError, ClientSettings, Halt, Phase, Status, Velocity};
pub use command::{ArmState, Command, GripperRequest, Mode, StateOrder, TwistFrame};
pub use error::{Fault, Source};
