//! The stages as child processes: started, heard, started again, stopped, reaped.
//!
//! ```text
//! configuration, sealed in memory ─▶ stage ─▶ standard output: ready, end ─▶ Event
//!                          orders ─▶       ─▶ standard error ─▶ Writer     a stalled terminal holds no stage up
//! ```

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::signal::{Signal, kill};
use nix::unistd::{AccessFlags, Pid, access};
use tendon_config::Config;
use tendon_messages::Stage;
use tendon_paths::PathError;
use tendon_process::{Asked, Order, PAGE_VARIABLE, Ready};

use crate::recorder::{Recorder, RecordingPlan};
use crate::robot_line::RobotLine;
use crate::writer::Writer;

/// Program of the recorder, which lies beside `tendon`.
pub const RECORDER_PROGRAM: &str = "tendon-recorder";

/// How long a stage may take to stop before it is killed.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);
/// Longest wait for an event while stages stop.
const STOP_TICK: Duration = Duration::from_millis(20);
/// How long the last words of a stage that ended may take.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// Longest line that is taken from a stage in one piece, bytes.
const MAXIMUM_LINE_LENGTH: u64 = 8192;

/// What the supervisor waits for.
#[derive(Debug)]
pub enum Event {
    /// A stage is ready.
    Ready(Stage, Ready),
    /// A stage closed its standard output: it has ended.
    Ended(Stage),
    /// A key for an order to this stage.
    Order(Stage, Order),
    /// The key that lets what waits for it go on.
    GoOn,
    /// The key for the last once more.
    Redo,
    /// The key that arms was read after a standstill of this process, and counts for nothing.
    LateArm,
    /// The key that starts and ends a recording.
    Record,
    /// The recorder said something, or has ended.
    Recorder,
    /// Somebody who sees the session asks for something.
    Request(Asked),
    /// A signal, or the key for it.
    Stop,
}

/// Why a stage cannot be started or reaped.
#[derive(Debug, thiserror::Error)]
pub enum ChildrenError {
    /// Where this program lies is not known.
    #[error("cannot find this program's own folder, where the stages lie")]
    OwnFolder(#[source] std::io::Error),
    /// The configuration cannot be handed over.
    #[error("cannot keep the configuration in memory")]
    Configuration(#[source] std::io::Error),
    /// The socket cannot be handed over.
    #[error("cannot hand over the socket of the page")]
    Socket(#[source] std::io::Error),
    /// The program does not start.
    #[error("cannot start {}: build all programs with ./scripts/run or cargo build", program.display())]
    Start {
        /// Its file.
        program: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// There is no place for a recording.
    #[error(transparent)]
    NoFolder(#[from] PathError),
    /// The program of another source is not there.
    #[error("{}: the program that acquisition.program names was not found: check its path", program.display())]
    SourceMissing {
        /// Its file.
        program: PathBuf,
    },
    /// The program of another source cannot be started.
    #[error(
        "{}: the program that acquisition.program names cannot be started: may it be executed, and by this user?",
        program.display()
    )]
    SourceRefused {
        /// Its file.
        program: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A pipe or thread for a stage is missing.
    #[error("cannot listen to {}", stage.name())]
    Listen {
        /// Which stage.
        stage: Stage,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A stage that ended cannot be reaped.
    #[error("cannot reap {}", stage.name())]
    Reap {
        /// Which stage.
        stage: Stage,
        /// The system's reason.
        source: std::io::Error,
    },
}

/// The configuration that the stages read: in memory, sealed, under a descriptor that they inherit. There is no file that
/// somebody else could put another in place of.
#[derive(Debug)]
pub(crate) struct SealedConfig {
    memory: OwnedFd,
}

impl SealedConfig {
    pub(crate) fn new(text: &str) -> std::io::Result<SealedConfig> {
        // Not closed on exec: the stages inherit it.
        let memory = memfd_create("tendon-configuration", MFdFlags::MFD_ALLOW_SEALING)?;
        let mut file = File::from(memory);
        file.write_all(text.as_bytes())?;
        let seals =
            SealFlag::F_SEAL_SEAL | SealFlag::F_SEAL_SHRINK | SealFlag::F_SEAL_GROW | SealFlag::F_SEAL_WRITE;
        fcntl(&file, FcntlArg::F_ADD_SEALS(seals))?;
        Ok(SealedConfig { memory: file.into() })
    }

    /// Where a process that inherited the descriptor reads it from its beginning: proc(5).
    pub(crate) fn path(&self) -> String {
        format!("/proc/self/fd/{}", self.memory.as_raw_fd())
    }
}

/// The stages of a session. Dropping it stops the robot and kills what still runs.
#[derive(Debug)]
pub struct Children {
    /// Where the programs lie.
    folder: PathBuf,
    /// The program that acquires.
    acquisition: PathBuf,
    /// Whether `acquisition.program` names it.
    is_named: bool,
    config: SealedConfig,
    events: Sender<Event>,
    robot: RobotLine,
    standard_error: Writer,
    /// What stages say is not passed on any more.
    is_quiet: Arc<AtomicBool>,
    running: Vec<Running>,
}

#[derive(Debug)]
struct Running {
    stage: Stage,
    process: Child,
    orders: ChildStdin,
    /// Passes on what it writes to standard error; gives the last line of it.
    relay: JoinHandle<String>,
}

/// How a stage ended.
#[derive(Debug)]
pub struct StageEnd {
    /// Its exit status.
    pub status: ExitStatus,
    /// The last line that it wrote to standard error; empty if it wrote none.
    pub last_words: String,
}

impl Running {
    fn process_id(&self) -> Pid {
        Pid::from_raw(self.process.id() as i32)
    }
}

/// The folder of this program, in which those of Tendon lie.
pub(crate) fn own_folder() -> Result<PathBuf, ChildrenError> {
    let program = std::env::current_exe().map_err(ChildrenError::OwnFolder)?;
    Ok(program.parent().map(ToOwned::to_owned).unwrap_or_default())
}

/// The program that acquires, if programs of Tendon lie in `folder`: the one that the configuration names, else the one of
/// its source.
fn source_program(config: &Config, folder: &Path) -> PathBuf {
    let acquisition = &config.acquisition;
    let of_source = acquisition.source.program().unwrap_or_default();
    acquisition.program.clone().unwrap_or_else(|| folder.join(of_source))
}

/// Checks that the program that acquires can be started, if the configuration names one.
///
/// # Errors
///
/// [`ChildrenError::SourceMissing`] and [`ChildrenError::SourceRefused`].
pub fn check_source_program(config: &Config) -> Result<(), ChildrenError> {
    let Some(program) = config.acquisition.program.clone() else { return Ok(()) };
    if !program.is_file() {
        return Err(ChildrenError::SourceMissing { program });
    }
    access(&program, AccessFlags::X_OK)
        .map_err(|source| ChildrenError::SourceRefused { program, source: source.into() })
}

impl Children {
    /// Starts `stages`, which lie beside this program, on this configuration; as acquisition the program of its source, or
    /// the one that it names. What they say comes as `events`, what they write to standard error goes to
    /// `standard_error`. In a session that `follows_on_session` the robot leaves the arm where it is until it is armed.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when one cannot be started; those that were are stopped.
    pub fn start(
        stages: &[Stage],
        config: &Config,
        events: &Sender<Event>,
        robot: &RobotLine,
        follows_on_session: bool,
        standard_error: &Writer,
    ) -> Result<Children, ChildrenError> {
        check_source_program(config)?;
        let folder = own_folder()?;
        let mut children = Children {
            acquisition: source_program(config, &folder),
            is_named: config.acquisition.program.is_some(),
            folder,
            config: SealedConfig::new(&config.to_toml()).map_err(ChildrenError::Configuration)?,
            events: events.clone(),
            robot: robot.clone(),
            standard_error: standard_error.clone(),
            is_quiet: Arc::default(),
            running: Vec::new(),
        };
        for &stage in stages {
            let is_robot_of_next = follows_on_session && stage == Stage::Robot;
            children.start_stage(stage, is_robot_of_next.then_some("--follows-on-session"))?;
        }
        Ok(children)
    }

    /// Starts a stage that ended and was reaped once more, in a session that goes on.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when it cannot be started.
    pub fn restart(&mut self, stage: Stage) -> Result<(), ChildrenError> {
        self.start_stage(stage, Some("--restarted"))
    }

    fn start_stage(&mut self, stage: Stage, argument: Option<&str>) -> Result<(), ChildrenError> {
        let program = match stage {
            Stage::Acquisition => self.acquisition.clone(),
            _ => self.folder.join(format!("tendon-{}", stage.name())),
        };
        let mut process = Command::new(&program)
            .arg("--config")
            .arg(self.config.path())
            .args(argument)
            .env_remove(PAGE_VARIABLE)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // Ctrl-C is for the supervisor alone, which then stops the stages in their order.
            .process_group(0)
            .spawn()
            .map_err(|source| match stage {
                Stage::Acquisition if self.is_named => ChildrenError::SourceRefused { program, source },
                _ => ChildrenError::Start { program, source },
            })?;
        let pipes = (process.stdin.take(), process.stdout.take(), process.stderr.take());
        let (Some(orders), Some(output), Some(errors)) = pipes else {
            unreachable!("all three were asked for as pipes")
        };
        let failed = |source| ChildrenError::Listen { stage, source };
        let connected = if stage == Stage::Robot {
            self.robot.connect(&orders, Pid::from_raw(process.id() as i32))
        } else {
            Ok(())
        };
        let relay = self.relay(stage.name(), errors);
        let heard = self.hear(stage, output);
        let relay = connected.and(heard).and(relay);
        match relay {
            Ok(relay) => self.running.push(Running { stage, process, orders, relay }),
            Err(error) => {
                // Nobody can hear it: it must not run on.
                self.robot.disconnect();
                let _ = process.kill();
                let _ = process.wait();
                return Err(failed(error));
            }
        }
        Ok(())
    }

    /// Starts the recorder of this session, which lies beside this program.
    ///
    /// # Errors
    ///
    /// [`ChildrenError::Start`] when it cannot be started, [`ChildrenError::NoFolder`] when there is no place for a recording.
    pub(crate) fn start_recorder(&self, plan: &RecordingPlan) -> Result<Recorder, ChildrenError> {
        let folder = plan.folder()?;
        let program = self.folder.join(RECORDER_PROGRAM);
        let mut command = Command::new(&program);
        command.arg("--config").arg(self.config.path()).env_remove(PAGE_VARIABLE).process_group(0);
        Recorder::start(command, &folder, &plan.start, &self.events, |errors| self.relay("recorder", errors))
            .map_err(|source| ChildrenError::Start { program, source })
    }

    /// Listens to what a stage says on standard output, in a thread.
    fn hear(&self, stage: Stage, output: ChildStdout) -> std::io::Result<()> {
        let events = self.events.clone();
        std::thread::Builder::new().name(format!("hear {}", stage.name())).spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if let Ok(ready) = serde_json::from_str(&line) {
                    // Nobody listens any more once the session is over.
                    let _ = events.send(Event::Ready(stage, ready));
                }
            }
            let _ = events.send(Event::Ended(stage));
        })?;
        Ok(())
    }

    /// Passes on what a stage writes to standard error, in a thread: the stage never waits for a terminal.
    fn relay(&self, name: &str, errors: ChildStderr) -> std::io::Result<JoinHandle<String>> {
        let (standard_error, is_quiet) = (self.standard_error.clone(), self.is_quiet.clone());
        std::thread::Builder::new().name(format!("errors {name}")).spawn(move || {
            let mut errors = BufReader::new(errors);
            let mut line = Vec::new();
            let mut last_words = String::new();
            while errors.by_ref().take(MAXIMUM_LINE_LENGTH).read_until(b'\n', &mut line).is_ok_and(|n| n > 0)
            {
                last_words = String::from_utf8_lossy(&line).trim_end().to_owned();
                if !is_quiet.load(Ordering::Relaxed) {
                    standard_error.say(last_words.clone());
                }
                line.clear();
            }
            last_words
        })
    }

    /// From now on what stages write to standard error is not passed on: they are only being stopped, and complain of
    /// what follows from that.
    pub fn keep_quiet(&self) {
        self.is_quiet.store(true, Ordering::Relaxed);
    }

    /// Process ids of the stages that run.
    pub fn process_ids(&self) -> impl Iterator<Item = (Stage, u32)> {
        self.running.iter().map(|running| (running.stage, running.process.id()))
    }

    /// Process id of a stage; `None` when it does not run.
    pub fn process_id(&self, stage: Stage) -> Option<u32> {
        self.process_ids().find(|(other, _)| *other == stage).map(|(_, process_id)| process_id)
    }

    /// Gives an order to a stage. One that ends at this moment does not hear it, which shows as its end.
    pub fn order(&mut self, stage: Stage, order: Order) {
        if stage == Stage::Robot {
            return self.robot.order(order);
        }
        let line = format!("{}\n", order.line());
        for running in self.running.iter_mut().filter(|running| running.stage == stage) {
            let _ = running.orders.write_all(line.as_bytes());
        }
    }

    /// Reaps a stage that has ended, at once: iceoryx2 takes a process that nobody reaped for alive. Its last words have
    /// been passed on then.
    ///
    /// # Errors
    ///
    /// [`ChildrenError::Reap`] when the system refuses.
    pub fn reap(&mut self, stage: Stage) -> Result<Option<StageEnd>, ChildrenError> {
        let Some(position) = self.running.iter().position(|running| running.stage == stage) else {
            return Ok(None);
        };
        let mut running = self.running.swap_remove(position);
        if stage == Stage::Robot {
            self.robot.disconnect();
        }
        let status = running.process.wait().map_err(|source| ChildrenError::Reap { stage, source })?;
        let ended = Instant::now();
        while !running.relay.is_finished() && ended.elapsed() < LAST_WORDS {
            self.robot.loop_turned();
            std::thread::sleep(Duration::from_millis(1));
        }
        let last_words = if running.relay.is_finished() { running.relay.join().ok() } else { None };
        Ok(Some(StageEnd { status, last_words: last_words.unwrap_or_default() }))
    }

    /// Stops all stages, the robot first, and kills those that do not stop. Returns the names of those that
    /// had to be killed. `meanwhile` is called again and again while waiting.
    ///
    /// # Errors
    ///
    /// [`ChildrenError::Reap`], once no stage runs any more.
    pub fn stop(
        &mut self,
        events: &Receiver<Event>,
        mut meanwhile: impl FnMut(),
    ) -> Result<Vec<&'static str>, ChildrenError> {
        let robot = self.stop_those(&[Stage::Robot], events, &mut meanwhile);
        let others = self.stop_those(&Stage::ALL, events, &mut meanwhile);
        let mut killed = robot?;
        killed.extend(others?);
        Ok(killed)
    }

    fn stop_those(
        &mut self,
        stages: &[Stage],
        events: &Receiver<Event>,
        meanwhile: &mut impl FnMut(),
    ) -> Result<Vec<&'static str>, ChildrenError> {
        let mut result = Ok(Vec::new());
        self.signal(stages, Signal::SIGTERM);
        let deadline = Instant::now() + STOP_TIMEOUT;
        while self.running.iter().any(|running| stages.contains(&running.stage)) {
            let now = Instant::now();
            if now >= deadline {
                break;
            }
            self.robot.loop_turned();
            match events.recv_timeout((deadline - now).min(STOP_TICK)) {
                Ok(Event::Ended(stage)) => {
                    if let Err(error) = self.reap(stage) {
                        result = Err(error);
                    }
                }
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            meanwhile();
        }
        self.signal(stages, Signal::SIGKILL);
        for stage in stages {
            match self.reap(*stage) {
                Ok(Some(_)) => {
                    if let Ok(killed) = &mut result {
                        killed.push(stage.name());
                    }
                }
                Ok(None) => {}
                Err(error) => result = Err(error),
            }
        }
        result
    }

    fn signal(&self, stages: &[Stage], signal: Signal) {
        for running in self.running.iter().filter(|running| stages.contains(&running.stage)) {
            // The child is not reaped yet, so its id is still its own; a dead one needs no signal.
            let _ = kill(running.process_id(), signal);
            if signal == Signal::SIGTERM {
                // One that was stopped with SIGSTOP hears nothing else before this.
                let _ = kill(running.process_id(), Signal::SIGCONT);
            }
        }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        // After an error on the way, or a panic: the robot stops the arm in order even now.
        self.signal(&[Stage::Robot], Signal::SIGTERM);
        let begun = Instant::now();
        for running in self.running.iter_mut().filter(|running| running.stage == Stage::Robot) {
            while matches!(running.process.try_wait(), Ok(None)) && begun.elapsed() < STOP_TIMEOUT {
                std::thread::sleep(STOP_TICK);
            }
        }
        self.robot.disconnect();
        for running in &mut self.running {
            // There is nobody left to report to; what cannot be killed is already dead.
            let _ = running.process.kill();
            let _ = running.process.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn the_source_chooses_the_program_that_acquires_unless_one_is_named() {
        let mut config = Config::default();
        let folder = Path::new("/opt/tendon");
        assert_eq!(source_program(&config, folder), folder.join("tendon-acquisition"));
        config.acquisition.source = tendon_config::Source::Lsl;
        assert_eq!(source_program(&config, folder), folder.join("tendon-acquire-lsl"));
        config.acquisition.program = Some("/home/me/acquire".into());
        assert_eq!(source_program(&config, folder), Path::new("/home/me/acquire"));
    }

    #[test]
    fn the_program_of_a_source_must_be_there_and_executable() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("acquire");
        let mut config = Config::default();
        check_source_program(&config).unwrap();
        config.acquisition.program = Some(program.clone());
        let missing = check_source_program(&config).unwrap_err().to_string();
        assert!(missing.contains("the program that acquisition.program names was not found"), "{missing}");
        std::fs::write(&program, "#!/bin/sh\n").unwrap();
        let refused = check_source_program(&config).unwrap_err().to_string();
        assert!(refused.contains("cannot be started"), "{refused}");
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        check_source_program(&config).unwrap();
    }

    #[test]
    fn the_configuration_of_the_stages_cannot_be_changed() {
        let config = SealedConfig::new("session = \"tendon\"").unwrap();
        for _ in 0..2 {
            assert_eq!(std::fs::read_to_string(config.path()).unwrap(), "session = \"tendon\"");
        }
        assert!(std::fs::write(config.path(), "session = \"other\"").is_err());
        assert_eq!(std::fs::read_to_string(config.path()).unwrap(), "session = \"tendon\"");
    }
}
