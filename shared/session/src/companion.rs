//! A program that observes a session while it runs, such as one that gives its results to other programs. The session needs it
//! for nothing: if it ends, that is said, and the session goes on.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
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
    name: &'static str,
    process: Child,
    /// It reads the configuration from there.
    _config: SealedConfig,
    standard_error: Writer,
    has_ended: bool,
}

impl Companion {
    /// Starts the program `name`, which lies beside this one, on this configuration, with `arguments` of its own, and `page` as
    /// [`PAGE_VARIABLE`] in its environment. Each line that it says on standard output goes to `on_said`, in a thread; what it
    /// writes to standard error goes to `standard_error`.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when it cannot be started.
    pub fn start(
        name: &'static str,
        config: &Config,
        arguments: &[String],
        page: Option<&str>,
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
            .envs(page.map(|page| (PAGE_VARIABLE, page)))
            .stdin(Stdio::null())
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
        Ok(Companion {
            name,
            process,
            _config: config,
            standard_error: standard_error.clone(),
            has_ended: false,
        })
    }

    /// Whether it was seen to have ended.
    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Says once that it has ended, if it has. Does not wait.
    pub fn look(&mut self) {
        if !self.has_ended
            && let Ok(Some(status)) = self.process.try_wait()
        {
            self.has_ended = true;
            self.standard_error
                .say(format!("tendon: {} ended ({status}): the session goes on without it", self.name));
        }
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
