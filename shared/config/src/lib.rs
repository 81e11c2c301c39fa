//! The settings of a session: `tendon.toml`.
//!
//! ```text
//! tendon.toml ──read──▶ Config ──with KEY=VALUE──▶ Config ──check──▶ fit for a session
//!   read.rs           settings.rs     read.rs              check.rs
//! ```
//!
//! Every key has a default (the paper's, where it gives one), so an empty file is valid. An unknown key is an
//! error that names the nearest known one, or lists those there are. Paths are relative to the file's folder.
#![forbid(unsafe_code)]

mod check;
mod error;
mod read;
mod settings;

pub use error::ConfigError;
pub use settings::{
    AcquisitionSettings, Backend, Config, Gestures, InferenceSettings, OutletSettings, Pace, Realtime,
    ReplaySettings, RobotSettings, SchedulingSettings, SimulateSettings, Source, XArmSettings,
};
