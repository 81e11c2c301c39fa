//! The configuration that a command works with: a file, and the keys that were set.
//!
//! ```text
//! --config FILE, else ./tendon.toml, else defaults ─▶ --set KEY=VALUE ─▶ finish ─▶ checked Config
//! ```

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Args;
use tendon_config::Config;
use tendon_transport::own_user;

/// Read where no other is named.
const DEFAULT_FILE: &str = "tendon.toml";

/// Keys of the configuration that windows depend on.
pub const WINDOW_KEYS: [&str; 3] = ["acquisition.sample_rate_hz", "dsp.filter", "dsp.windows"];

/// The configuration as `tendon run` and `tendon doctor` read it.
#[derive(Debug, Args)]
pub struct Base {
    /// Configuration; without it, ./tendon.toml if there is one, else the defaults.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Change one key of the configuration, such as dsp.filter.notch_hz=50; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
}

impl Base {
    /// The configuration that a session without other options would have, checked. All paths absolute.
    ///
    /// # Errors
    ///
    /// What makes no sense, by name.
    pub fn configuration(&self) -> anyhow::Result<Config> {
        finish(self.read()?)
    }

    /// The same for a command that uses only some keys: `used`, or what begins with them.
    ///
    /// # Errors
    ///
    /// What makes no sense, by name; also a key that was set and that the command does not use.
    pub fn configuration_of(&self, command: &str, used: &[&str]) -> anyhow::Result<Config> {
        check_keys(&self.assignments, command, used)?;
        self.configuration()
    }

    /// The configuration that was named.
    pub fn file(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    /// Whether a configuration was named or a key was set.
    pub fn is_given(&self) -> bool {
        self.config.is_some() || !self.assignments.is_empty()
    }

    /// The options again, as they are typed after a command.
    pub fn typed(&self) -> String {
        let config = self.config.iter().map(|config| format!(" --config {}", config.display()));
        config.chain(self.assignments.iter().map(|assignment| format!(" --set '{assignment}'"))).collect()
    }

    /// The same, a word each.
    pub fn words(&self) -> Vec<String> {
        let config = self.config.iter().map(|config| format!("--config={}", config.display()));
        config.chain(self.assignments.iter().map(|assignment| format!("--set={assignment}"))).collect()
    }

    /// Whether a key was set that begins with `beginning`.
    pub fn sets(&self, beginning: &str) -> bool {
        sets(&self.assignments, beginning)
    }

    /// The file, then what was set.
    pub fn read(&self) -> anyhow::Result<Config> {
        self.with_assignments(read_configuration(self.config.as_deref())?)
    }

    /// The value that `--set` gives this key last, as it was written, without quotation marks.
    pub fn assigned(&self, key: &str) -> Option<&str> {
        let assignments = self.assignments.iter().rev().filter_map(|assignment| assignment.split_once('='));
        let value = assignments.into_iter().find_map(|(own, value)| (own.trim() == key).then_some(value))?;
        Some(value.trim().trim_matches(['"', '\'']))
    }

    /// What was set, on top of `config`.
    pub fn with_assignments(&self, mut config: Config) -> anyhow::Result<Config> {
        for assignment in &self.assignments {
            config = config.with(assignment)?;
        }
        Ok(config)
    }
}

/// The configuration in this file; without one, in `tendon.toml` here if it is there, else the default.
///
/// # Errors
///
/// What is wrong with the file, by its place.
fn read_configuration(file: Option<&Path>) -> anyhow::Result<Config> {
    let default = Path::new(DEFAULT_FILE);
    match file {
        Some(file) => Ok(Config::read(file)?),
        // Also when it is no file: what lies there is refused, not passed over.
        None if default.symlink_metadata().is_ok() => {
            // It names libraries that are loaded: somebody else's is read only when it is asked for.
            let owner = default.metadata().context("cannot look at ./tendon.toml")?.uid();
            ensure!(
                owner == own_user() || owner == 0,
                "./tendon.toml belongs to {}: if you trust it, name it with --config",
                tendon_paths::user_name(owner)
            );
            Ok(Config::read(default)?)
        }
        None => Ok(Config::default()),
    }
}

/// Whether one of the assignments sets a key that begins with `beginning`.
pub fn sets(assignments: &[String], beginning: &str) -> bool {
    assignments.iter().any(|assignment| assignment.trim_start().starts_with(beginning))
}

/// Refuses assignments of keys that `command` does not use: they would have no effect.
///
/// # Errors
///
/// The first such assignment.
pub fn check_keys(assignments: &[String], command: &str, used: &[&str]) -> anyhow::Result<()> {
    for assignment in assignments {
        let key = assignment.split('=').next().unwrap_or_default().trim();
        let is_used = |used: &&str| {
            key.strip_prefix(*used).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
        };
        ensure!(
            used.iter().any(is_used),
            "--set {assignment}: {command} does not use {key}, only {}: leave it out",
            used.join(", ")
        );
    }
    Ok(())
}

/// Makes all paths absolute, and checks the whole.
pub fn finish(mut config: Config) -> anyhow::Result<Config> {
    for path in config.files_mut() {
        *path = std::path::absolute(&path)
            .with_context(|| format!("cannot make {} an absolute path", path.display()))?;
    }
    config.check()?;
    Ok(config)
}
