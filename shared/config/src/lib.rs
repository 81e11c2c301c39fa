//! The settings of a session: `tendon.toml`.
//!
//! ```text
//! tendon.toml ──read──▶ Config ──with KEY=VALUE──▶ Config ──check──▶ fit for a session
//!   read.rs           settings.rs,    read.rs              check.rs
//!                     acquisition.rs
//! ```
//!
//! Every key has a default (the paper's, where it gives one), so an empty file is valid. An unknown key is an
//! error that names the nearest known one, or lists those there are. Paths are relative to the file's folder.
#![forbid(unsafe_code)]

mod acquisition;
mod check;
mod error;
mod read;
mod settings;

pub use acquisition::{AcquisitionSettings, Gestures, Pace, ReplaySettings, SimulateSettings, Source};
pub use error::ConfigError;
pub use settings::{
    Backend, Config, InferenceSettings, OutletSettings, Realtime, RobotSettings, SchedulingSettings,
    XArmSettings,
};
