//! What is wrong with a configuration.

use std::path::PathBuf;

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
    #[error("{}: {message}{suggestion}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        message: String,
        /// The nearest known key, as a sentence; empty when there is none.
        suggestion: String,
    },
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
