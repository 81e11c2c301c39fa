//! What is wrong with a configuration.

use std::path::PathBuf;

use tendon_emg_simulation::{ProfileError, SimulationError};
use tendon_recordings::RecordingError;

/// What is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("{}: cannot read the configuration", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The file cannot be parsed.
    #[error("{}: {message}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong and where, with the nearest known key if one is near.
        message: String,
    },
    /// What was to change one key cannot be used.
    #[error("--set {assignment}: {message}")]
    Assignment {
        /// What was given.
        assignment: String,
        /// What is wrong with it, with the nearest known key if one is near.
        message: String,
    },
    /// A plain table whose sampling rate was not given.
    #[error(
        "{} does not state its sampling rate: give it, such as --recording-rate-hz 1000, or \
         acquisition.replay.sample_rate_hz",
        path.display()
    )]
    SampleRateMissing {
        /// The table.
        path: PathBuf,
    },
    /// The profile of the simulated amplifier could not be read.
    #[error("{}: cannot read the profile", path.display())]
    ReadProfile {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The profile of the simulated amplifier is none.
    #[error("{}", path.display())]
    Profile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ProfileError,
    },
    /// Nothing can be simulated with the profile and the settings.
    #[error("acquisition.simulate")]
    Simulation(#[from] SimulationError),
    /// A recording with fewer channels than the session has, of which none were named.
    #[error(
        "{error}. No channels are named, and acquisition.channels is {channels}: set it to the number you have, or name \
         the channels in acquisition.replay.channels"
    )]
    MissingChannel {
        /// What the recording lacks.
        error: RecordingError,
        /// Channels of the session.
        channels: usize,
    },
    /// The recording to replay cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Values of a section cannot work.
    #[error("[{section}] {reason}")]
    Section {
        /// Name of the section.
        section: &'static str,
        /// Which key, and what to do.
        reason: String,
    },
    /// A value cannot work.
    #[error("{key} = {value}: {remedy}")]
    Value {
        /// Key of the setting.
        key: &'static str,
        /// Its value.
        value: String,
        /// What to do.
        remedy: String,
    },
}
