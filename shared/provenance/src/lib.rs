//! Where a result comes from: what every report and manifest says of itself, so that it can be made again.
//!
//! ```text
//! program (version, commit) ─┐
//! machine (host, kernel) ────┤
//! start (clock, monotonic) ──┼─▶ Provenance ─▶ "provenance" in a report or manifest
//! configuration ─────────────┤
//! models, recordings ─SHA-256┘
//! ```
#![forbid(unsafe_code)]

mod hash;

use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use nix::sys::utsname::uname;
use nix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

pub use hash::{FileHash, RecordingHash};

/// Why it cannot be told where a result comes from.
#[derive(Debug, thiserror::Error)]
pub enum ProvenanceError {
    /// A model or recording cannot be read.
    #[error("cannot open {}: {reason}; check the path and its permissions", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        reason: io::Error,
    },
    /// The settings cannot be said in JSON.
    #[error("the settings cannot be written into the report: {reason}")]
    Configuration {
        /// What is wrong.
        reason: String,
    },
}

/// The program that makes a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Program {
    /// Its version.
    pub version: &'static str,
    /// The commit it was built from; `unknown` without a repository. Changes that were not committed do not show.
    pub commit: &'static str,
}

/// Where a result comes from. The JSON keys are a contract with other programs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the program.
    pub version: String,
    /// The commit it was built from, or `unknown`.
    pub commit: String,
    /// When the command started, RFC 3339 in UTC.
    pub started_at: String,
    /// The same moment on CLOCK_MONOTONIC, ns: the clock of all stamps.
    pub started_monotonic_ns: u64,
    /// Name of the machine.
    pub host: String,
    /// Its kernel: name, release, architecture.
    pub kernel: String,
    /// All settings, defaults included; `null` where there are none.
    pub configuration: serde_json::Value,
    /// The models used.
    pub models: Vec<FileHash>,
    /// The recordings used; `null` where there are none.
    pub recording: Option<RecordingHash>,
    /// Whether a model was trained on the person whose recording it is; `null` where that is not known.
    pub trained_on_person: Option<bool>,
}

impl Provenance {
    /// Of a command of `program` that starts now.
    pub fn begin(program: Program) -> Provenance {
        let (host, kernel) = uname().map_or_else(
            |_| ("unknown".to_owned(), "unknown".to_owned()),
            |system| {
                let text = |part: &std::ffi::OsStr| part.to_string_lossy().into_owned();
                let kernel = [system.sysname(), system.release(), system.machine()].map(text).join(" ");
                (text(system.nodename()), kernel)
            },
        );
        let started_monotonic_ns = clock_gettime(ClockId::CLOCK_MONOTONIC)
            .map_or(0, |time| time.tv_sec() as u64 * 1_000_000_000 + time.tv_nsec() as u64);
        Provenance {
            version: program.version.to_owned(),
            commit: program.commit.to_owned(),
            started_at: humantime::format_rfc3339_millis(SystemTime::now()).to_string(),
            started_monotonic_ns,
            host,
            kernel,
            ..Provenance::default()
        }
    }

    /// With all settings.
    ///
    /// # Errors
    ///
    /// When they cannot be said in JSON, such as a path that is no UTF-8.
    pub fn with_configuration(self, configuration: &impl Serialize) -> Result<Provenance, ProvenanceError> {
        let configuration = serde_json::to_value(configuration)
            .map_err(|error| ProvenanceError::Configuration { reason: error.to_string() })?;
        Ok(Provenance { configuration, ..self })
    }

    /// With these models.
    ///
    /// # Errors
    ///
    /// When a file cannot be read.
    pub fn with_models<P: AsRef<Path>>(
        self,
        models: impl IntoIterator<Item = P>,
    ) -> Result<Provenance, ProvenanceError> {
        let models = models.into_iter().map(|path| FileHash::of(path.as_ref()));
        Ok(Provenance { models: models.collect::<Result<_, _>>()?, ..self })
    }

    /// With the recordings at these paths: files, or folders with all that lies in them.
    ///
    /// # Errors
    ///
    /// When a file cannot be read.
    pub fn with_recording(self, paths: &[PathBuf]) -> Result<Provenance, ProvenanceError> {
        let recording = (!paths.is_empty()).then(|| RecordingHash::of(paths)).transpose()?;
        Ok(Provenance { recording, ..self })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_keys_are_those_that_other_programs_read() {
        let begun = Provenance::begin(Program { version: "0.1.0", commit: "unknown" });
        let json = serde_json::to_value(&begun).unwrap();
        for key in
            ["version", "commit", "started_at", "host", "kernel", "configuration", "models", "recording"]
        {
            assert!(json.get(key).is_some(), "`{key}` is missing");
        }
        assert!(json["models"].is_array() && json["recording"].is_null());
        assert!(humantime::parse_rfc3339(json["started_at"].as_str().unwrap()).is_ok());
        assert!(begun.started_monotonic_ns > 0 && begun.kernel.starts_with("Linux "));
        assert_eq!(serde_json::from_value::<Provenance>(json).unwrap(), begun);
    }
}
