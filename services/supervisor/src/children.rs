//! The stages as child processes: started, heard, started again, stopped, reaped.

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use anyhow::Context;
use nix::fcntl::{FcntlArg, SealFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tendon_config::Config;
use tendon_messages::Stage;
use tendon_process::{Order, Ready};

/// How long a stage may take to stop before it is killed.
const STOP_TIMEOUT: Duration = Duration::from_secs(3);
/// Time between two signs of life to the robot, which rests after four have not come.
const HEARTBEAT: Duration = Duration::from_millis(30);

/// What the supervisor waits for.
#[derive(Debug)]
pub enum Event {
    /// A stage is ready.
    Ready(Stage, Ready),
    /// A stage closed its standard output: it has ended.
    Ended(Stage),
    /// A key for an order to this stage.
    Order(Stage, Order),
    /// SIGINT, SIGTERM, or the key for it.
    Stop,
}

/// Tells the robot again and again that this process is there, from a thread that waits for nothing else: an arm
/// whose supervisor hangs cannot be stopped from its keys.
fn beat(orders: &ChildStdin) -> anyhow::Result<()> {
    let own = orders.as_fd().try_clone_to_owned().context("cannot duplicate a pipe")?;
    let mut orders = std::fs::File::from(own);
    let line = format!("{}\n", Order::Alive.line());
    std::thread::Builder::new()
        .name("heartbeat".to_owned())
        .spawn(move || {
            // It fails when the robot is gone.
            while write_if_there_is_room(&mut orders, line.as_bytes()).is_ok() {
                std::thread::sleep(HEARTBEAT);
            }
        })
        .context("cannot start a thread")?;
    Ok(())
}

/// Writes this line unless it would be the last that fits the pipe: to a process that hangs, orders come through when it
/// goes on, and whoever gives them need not wait for that. (Linux takes a pipe whose last page is begun for full, and
/// small writes still go to that page: pipe(7), poll(2).)
fn write_if_there_is_room(pipe: &mut (impl Write + AsFd), line: &[u8]) -> std::io::Result<()> {
    let mut looked_at = [PollFd::new(pipe.as_fd(), PollFlags::POLLOUT)];
    poll(&mut looked_at, PollTimeout::ZERO)?;
    let is = looked_at[0].revents().unwrap_or(PollFlags::empty());
    if is.intersects(PollFlags::POLLERR | PollFlags::POLLOUT) { pipe.write_all(line) } else { Ok(()) }
}

/// The configuration that the stages read: in memory, sealed, under a descriptor that they inherit. There is no file that
/// somebody else could put another in place of.
#[derive(Debug)]
struct SealedConfig {
    memory: OwnedFd,
}

impl SealedConfig {
    fn new(text: &str) -> anyhow::Result<SealedConfig> {
        let failed = "cannot keep the configuration in memory";
        // Not closed on exec: the stages inherit it.
        let memory = memfd_create("tendon-configuration", MFdFlags::MFD_ALLOW_SEALING).context(failed)?;
        let mut file = File::from(memory);
        file.write_all(text.as_bytes()).context(failed)?;
        let seals =
            SealFlag::F_SEAL_SEAL | SealFlag::F_SEAL_SHRINK | SealFlag::F_SEAL_GROW | SealFlag::F_SEAL_WRITE;
        fcntl(&file, FcntlArg::F_ADD_SEALS(seals)).context(failed)?;
        Ok(SealedConfig { memory: file.into() })
    }

    /// Where a process that inherited the descriptor reads it from its beginning: proc(5).
    fn path(&self) -> String {
        format!("/proc/self/fd/{}", self.memory.as_raw_fd())
    }
}

/// All stages of a session. Dropping it kills and reaps what still runs.
#[derive(Debug)]
pub struct Children {
    /// Where the programs lie.
    folder: PathBuf,
    config: SealedConfig,
    events: Sender<Event>,
    running: Vec<Running>,
}

#[derive(Debug)]
struct Running {
    stage: Stage,
    process: Child,
    orders: ChildStdin,
}

impl Children {
    /// Starts all stages, which lie beside this program, on this configuration. What they say
    /// comes as `events`.
    pub fn start(config: &Config, events: &Sender<Event>) -> anyhow::Result<Children> {
        let program = std::env::current_exe().context("cannot find this program's own folder")?;
        let folder = program.parent().context("this program is in no folder")?;
        let mut children = Children {
            folder: folder.to_owned(),
            config: SealedConfig::new(&config.to_toml())?,
            events: events.clone(),
            running: Vec::new(),
        };
        for stage in Stage::ALL {
            children.start_stage(stage, false)?;
        }
        Ok(children)
    }

    /// Starts a stage that ended and was reaped once more, in a session that goes on.
    pub fn restart(&mut self, stage: Stage) -> anyhow::Result<()> {
        self.start_stage(stage, true)
    }

    fn start_stage(&mut self, stage: Stage, is_restarted: bool) -> anyhow::Result<()> {
        let path = self.folder.join(format!("tendon-{}", stage.name()));
        let mut process = Command::new(&path)
            .arg("--config")
            .arg(self.config.path())
            .args(is_restarted.then_some("--restarted"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // Ctrl-C is for the supervisor alone, which then stops the stages in their order.
            .process_group(0)
            .spawn()
            .with_context(|| {
                format!(
                    "cannot start {}: build all programs with ./scripts/run or cargo build",
                    path.display()
                )
            })?;
        let orders = process.stdin.take().context("a piped input is missing")?;
        if stage == Stage::Robot {
            beat(&orders)?;
        }
        let output = process.stdout.take().context("a piped output is missing")?;
        self.running.push(Running { stage, process, orders });
        let events = self.events.clone();
        std::thread::Builder::new()
            .name(format!("hear {}", stage.name()))
            .spawn(move || {
                for line in BufReader::new(output).lines().map_while(Result::ok) {
                    if let Ok(ready) = serde_json::from_str(&line) {
                        // Nobody listens any more once the session is over.
                        let _ = events.send(Event::Ready(stage, ready));
                    }
                }
                let _ = events.send(Event::Ended(stage));
            })
            .context("cannot start a thread")?;
        Ok(())
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
        // In one piece, as the heartbeat writes to the same pipe.
        let line = format!("{}\n", order.line());
        for running in self.running.iter_mut().filter(|running| running.stage == stage) {
            let _ = running.orders.write_all(line.as_bytes());
        }
    }

    /// Reaps a stage that has ended, at once: iceoryx2 takes a process that nobody reaped for alive.
    pub fn reap(&mut self, stage: Stage) -> anyhow::Result<Option<ExitStatus>> {
        let Some(position) = self.running.iter().position(|running| running.stage == stage) else {
            return Ok(None);
        };
        let mut running = self.running.swap_remove(position);
        let status = running.process.wait().with_context(|| format!("cannot reap {}", stage.name()))?;
        Ok(Some(status))
    }

    /// Stops all stages, the robot first, and kills those that do not stop. Returns the names of those that
    /// had to be killed. `meanwhile` is called again and again while waiting.
    pub fn stop(
        &mut self,
        events: &Receiver<Event>,
        mut meanwhile: impl FnMut() -> anyhow::Result<()>,
    ) -> anyhow::Result<Vec<&'static str>> {
        let mut killed = self.stop_those(&[Stage::Robot], events, &mut meanwhile)?;
        killed.extend(self.stop_those(&Stage::ALL, events, &mut meanwhile)?);
        Ok(killed)
    }

    fn stop_those(
        &mut self,
        stages: &[Stage],
        events: &Receiver<Event>,
        meanwhile: &mut impl FnMut() -> anyhow::Result<()>,
    ) -> anyhow::Result<Vec<&'static str>> {
        self.signal(stages, Signal::SIGTERM);
        let deadline = Instant::now() + STOP_TIMEOUT;
        while self.running.iter().any(|running| stages.contains(&running.stage)) {
            let now = Instant::now();
            if now >= deadline {
                break;
            }
            match events.recv_timeout((deadline - now).min(Duration::from_millis(20))) {
                Ok(Event::Ended(stage)) => drop(self.reap(stage)?),
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            meanwhile()?;
        }
        self.signal(stages, Signal::SIGKILL);
        let killed: Vec<Stage> = stages
            .iter()
            .copied()
            .filter(|stage| self.running.iter().any(|running| running.stage == *stage))
            .collect();
        for stage in &killed {
            self.reap(*stage)?;
        }
        Ok(killed.into_iter().map(Stage::name).collect())
    }

    fn signal(&self, stages: &[Stage], signal: Signal) {
        for running in self.running.iter().filter(|running| stages.contains(&running.stage)) {
            // The child is not reaped yet, so its id is still its own; a dead one needs no signal.
            let _ = kill(Pid::from_raw(running.process.id() as i32), signal);
            if signal == Signal::SIGTERM {
                // One that was stopped with SIGSTOP hears nothing else before this.
                let _ = kill(Pid::from_raw(running.process.id() as i32), Signal::SIGCONT);
            }
        }
    }
}

impl Drop for Children {
    fn drop(&mut self) {
        for running in &mut self.running {
            // There is nobody left to report to; what cannot be killed is already dead.
            let _ = running.process.kill();
            let _ = running.process.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn the_configuration_of_the_stages_cannot_be_changed() {
        let config = SealedConfig::new("session = \"tendon\"").unwrap();
        for _ in 0..2 {
            assert_eq!(std::fs::read_to_string(config.path()).unwrap(), "session = \"tendon\"");
        }
        assert!(std::fs::write(config.path(), "session = \"other\"").is_err());
        assert_eq!(std::fs::read_to_string(config.path()).unwrap(), "session = \"tendon\"");
    }

    #[test]
    fn an_order_fits_the_pipe_of_a_process_that_hangs_however_many_heartbeats_came_before() {
        let (mut reader, mut writer) = std::io::pipe().unwrap();
        // A pipe holds 64 kB unless it is told otherwise.
        for _ in 0..100_000 {
            write_if_there_is_room(&mut writer, b"alive\n").unwrap();
        }
        writer.write_all(b"stop\n").unwrap();
        drop(writer);
        let mut lines = String::new();
        reader.read_to_string(&mut lines).unwrap();
        assert!(lines.ends_with("alive\nstop\n") && lines.len() < 100_000);
        let (reader, mut writer) = std::io::pipe().unwrap();
        drop(reader);
        assert!(write_if_there_is_room(&mut writer, b"alive\n").is_err());
    }
}
