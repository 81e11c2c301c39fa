//! A program that observes a session while it runs, such as one that gives its results to other programs. The session needs it
//! for nothing: if it ends, that is said, and the session goes on.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tendon_config::Config;
use tendon_process::PAGE_VARIABLE;

use crate::children::{ChildrenError, SealedConfig, own_folder};
use crate::writer::Writer;

/// How long it may take to stop before it is killed.
const STOP_TIMEOUT: Duration = Duration::from_secs(2);
/// Time between two looks whether it has.
const STOP_LOOK: Duration = Duration::from_millis(10);

/// A program beside the stages. Dropping it stops it.
#[derive(Debug)]
pub struct Companion {
    process: Child,
    /// It reads the configuration from there.
    _config: SealedConfig,
    has_ended: bool,
}

impl Companion {
    /// Starts the program `name`, which lies beside this one, on this configuration, with `arguments` and variables of the
    /// `environment` of its own and `input` as its standard input. Each line that it says on standard output goes to `on_said`, in a thread; what it
    /// writes to standard error goes to `standard_error`.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when it cannot be started.
    pub fn start(
        name: &'static str,
        config: &Config,
        arguments: &[String],
        environment: Vec<(&str, String)>,
        input: Stdio,
        mut on_said: impl FnMut(&str) + Send + 'static,
        standard_error: &Writer,
    ) -> Result<Companion, ChildrenError> {
        let program = own_folder()?.join(name);
        let config = SealedConfig::new(&config.to_toml()).map_err(ChildrenError::Configuration)?;
        let mut process = Command::new(&program)
            .arg("--config")
            .arg(config.path())
            .args(arguments)
            .env_remove(PAGE_VARIABLE)
            .envs(environment)
            .stdin(input)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|source| ChildrenError::Start { program, source })?;
        if let Some(output) = process.stdout.take() {
            let hear = std::thread::Builder::new().name(format!("hear {name}"));
            // As below.
            let _ = hear.spawn(move || {
                let lines = BufReader::new(output).lines().map_while(Result::ok);
                lines.for_each(|line| on_said(&line));
            });
        }
        if let Some(errors) = process.stderr.take() {
            let writer = standard_error.clone();
            let relay = std::thread::Builder::new().name(format!("errors {name}"));
            // Without the thread, what it says is lost, and nothing else.
            let _ = relay.spawn(move || {
                for line in BufReader::new(errors).lines().map_while(Result::ok) {
                    writer.say(line);
                }
            });
        }
        Ok(Companion { process, _config: config, has_ended: false })
    }

    /// How it has ended, when that is seen for the first time. Does not wait.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        if self.has_ended {
            return None;
        }
        let status = self.process.try_wait().ok().flatten();
        self.has_ended = status.is_some();
        status
    }
}

impl Drop for Companion {
    fn drop(&mut self) {
        if self.has_ended {
            return;
        }
        // It is not reaped yet, so its id is still its own.
        let _ = kill(Pid::from_raw(self.process.id() as i32), Signal::SIGTERM);
        let begun = Instant::now();
        while matches!(self.process.try_wait(), Ok(None)) && begun.elapsed() < STOP_TIMEOUT {
            std::thread::sleep(STOP_LOOK);
        }
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
