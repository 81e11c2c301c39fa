//! `tendon run`: one session from start to report.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use clap::Args;
use serde::Serialize;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use tendon_config::{Backend, Config, Gestures, Pace, Realtime, Source};
use tendon_figures::latency_figure;
use tendon_gesture::{Gesture, Strategy};
use tendon_messages::{
    BLOCKS, COMMANDS, MEASUREMENTS, PREDICTIONS, STATE_LENGTH, STATES, Stage, StateHeader, TWIST_LENGTH,
    WINDOWS,
};
use tendon_observer::Observer;
use tendon_process::{BATCH_LENGTH, Order, Ready};
use tendon_report::{Report, SessionFacts, SessionMeasurements, write_latency_log};
use tendon_transport::{
    Delivery, Leftovers, SessionLock, SessionName, required_bytes, shared_memory_directory,
};
use tendon_zones::{TaskKind, TaskRun};

use crate::Failure;
use crate::children::{Children, Event};
use crate::resources;
use crate::screen::{GESTURE_KEYS, KEYS, Keyboard, Screen, live_line};
use crate::zones;

/// Time between two looks at what the stages say. Their messages do not wait for it.
const TICK: Duration = Duration::from_millis(100);
/// The same in a lossless replay, which says much more in that time.
const LOSSLESS_TICK: Duration = Duration::from_millis(50);
/// The same with a task: the simulated user answers no later than a person would notice.
const TASK_TICK: Duration = Duration::from_millis(20);
/// How long the stages may take to become ready.
const READY_TIMEOUT: Duration = Duration::from_secs(60);
/// The same with an arm that first goes to its start position, perhaps twice around.
const READY_TIMEOUT_OF_ARM: Duration = Duration::from_secs(300);
/// After this long without being ready, the user is told what is waited for.
const PATIENCE: Duration = Duration::from_secs(2);
/// A stage that was started again and ends within so long of being ready would do so for ever.
const RESTART_TRIAL: Duration = Duration::from_secs(2);
/// So long after the end of a recording nothing of it is under way any more.
const LAST_OF_RECORDING: Duration = Duration::from_secs(1);

/// What can be said on the command line of `tendon run`; the rest is in the configuration.
#[derive(Debug, Args)]
pub struct Options {
    /// Configuration; without it, ./tendon.toml if there is one, else the defaults.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Change one key of the configuration, such as acquisition.channels=8; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
    /// Name of the session; two at a time need two names.
    #[arg(long)]
    session: Option<SessionName>,
    /// Stop after this long, such as 20s or 10m; without it, on Ctrl-C or at the recording's end.
    #[arg(long, value_parser = humantime::parse_duration)]
    duration: Option<Duration>,
    /// Write the report as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write all histograms in hdrhistogram's interval log format.
    #[arg(long, value_name = "FILE")]
    latency_log: Option<PathBuf>,
    /// Draw the histograms of newest sample to command and of window start to command there, as PNG and SVG.
    #[arg(long, value_name = "FOLDER")]
    figures: Option<PathBuf>,
    /// Replay a recording: a 3DC folder or file, or a CSV file.
    #[arg(long, value_name = "PATH")]
    replay: Option<PathBuf>,
    /// Sampling rate of the recording, for a CSV file.
    #[arg(long, value_name = "HZ", requires = "replay")]
    replay_rate_hz: Option<f64>,
    /// Replay only this repetition of a 3DC folder.
    #[arg(long, value_name = "N", requires = "replay")]
    repetition: Option<u32>,
    /// How fast to replay.
    #[arg(long, value_enum)]
    pace: Option<PaceOption>,
    /// Gestures of the simulated person, such as "rest 6s, grip 2s".
    #[arg(long, value_name = "STEPS", conflicts_with_all = ["replay", "random", "keyboard"])]
    script: Option<String>,
    /// The simulated person makes random gestures, set by --seed.
    #[arg(long, conflicts_with_all = ["replay", "keyboard"])]
    random: bool,
    /// The keys say which gesture the simulated person makes.
    #[arg(long, conflicts_with = "replay")]
    keyboard: bool,
    /// Steer the arm into zones and score how it went. With the simulated DAQ and none of --script, --random and
    /// --keyboard, a simulated user does it.
    #[arg(long, value_enum)]
    task: Option<TaskKind>,
    /// Seed of the simulated DAQ: the same seed gives the same samples.
    #[arg(long)]
    seed: Option<u64>,
    /// How rest and movement are told apart.
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
    /// The ONNX model of the gestures.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// The ONNX model of rest and move, with --strategy two_stage.
    #[arg(long, value_name = "FILE")]
    rest_move_model: Option<PathBuf>,
    /// Real-time scheduling: where the rights allow it, or else fail, or never.
    #[arg(long, value_enum)]
    realtime: Option<RealtimeOption>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum PaceOption {
    True,
    Full,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum RealtimeOption {
    Auto,
    On,
    Off,
}

impl Options {
    /// The session's configuration: the file, then the command line. All paths absolute.
    fn configuration(&self) -> anyhow::Result<Config> {
        let default = Path::new("tendon.toml");
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None if default.is_file() => Config::read(default)?,
            None => Config::default(),
        };
        for assignment in &self.assignments {
            config = config.with(assignment)?;
        }
        let acquisition = &mut config.acquisition;
        if let Some(session) = &self.session {
            config.session = session.clone();
        }
        if let Some(path) = &self.replay {
            acquisition.source = Source::Replay;
            acquisition.replay.path = Some(path.clone());
        }
        if self.replay_rate_hz.is_some() {
            acquisition.replay.sample_rate_hz = self.replay_rate_hz;
        }
        if self.repetition.is_some() {
            acquisition.replay.repetition = self.repetition;
        }
        if let Some(pace) = self.pace {
            ensure!(
                acquisition.source == Source::Replay,
                "--pace is for recordings: name one with --replay PATH"
            );
            acquisition.replay.pace = match pace {
                PaceOption::True => Pace::True,
                PaceOption::Full => Pace::Full,
            };
        }
        if let Some(script) = &self.script {
            acquisition.simulate.gestures = Gestures::Script;
            acquisition.simulate.script = script.clone();
        }
        if self.random {
            acquisition.simulate.gestures = Gestures::Random;
        }
        if self.keyboard {
            acquisition.simulate.gestures = Gestures::Keyboard;
        }
        if self.has_simulated_user(acquisition.source) {
            acquisition.simulate.gestures = Gestures::Keyboard;
        }
        if let Some(seed) = self.seed {
            acquisition.simulate.seed = seed;
        }
        if let Some(strategy) = self.strategy {
            config.decision.strategy = strategy;
        }
        if let Some(model) = &self.model {
            config.inference.model = Some(model.clone());
        }
        if let Some(model) = &self.rest_move_model {
            config.inference.rest_move_model = Some(model.clone());
        }
        if let Some(realtime) = self.realtime {
            config.scheduling.realtime = match realtime {
                RealtimeOption::Auto => Realtime::Auto,
                RealtimeOption::On => Realtime::On,
                RealtimeOption::Off => Realtime::Off,
            };
        }
        if let Some(task) = self.task {
            config.task = task.settings(config.task);
            ensure!(
                config.delivery() == Delivery::Live,
                "--task is for the arm's own time: leave --pace full away"
            );
        }
        for path in [
            &mut config.acquisition.simulate.profile,
            &mut config.acquisition.replay.path,
            &mut config.inference.model,
            &mut config.inference.rest_move_model,
            &mut config.inference.runtime_library,
        ]
        .into_iter()
        .flatten()
        {
            *path = std::path::absolute(&path)
                .with_context(|| format!("cannot make {} an absolute path", path.display()))?;
        }
        config.check()?;
        Ok(config)
    }

    /// Whether the simulated user does the task: nobody else says which gestures are made.
    fn has_simulated_user(&self, source: Source) -> bool {
        let by_others = self.script.is_some() || self.random || self.keyboard;
        self.task.is_some() && source == Source::Simulate && !by_others
    }
}

fn not_ready(who: &str, timeout: Duration) -> Failure {
    let seconds = timeout.as_secs();
    Failure::running(anyhow::anyhow!("{who} not ready after {seconds} s: TENDON_LOG=debug shows more"))
}

/// Says something beside the live line.
fn tell(text: &str) {
    // Standard error may be closed; the arm's state says it, too.
    let _ = writeln!(std::io::stderr(), "tendon: {text}");
}

/// Runs a session.
pub fn run(options: &Options) -> Result<(), Failure> {
    let config = options.configuration().map_err(Failure::input)?;
    let lock = SessionLock::take(&config.session).map_err(Failure::input)?;
    // What a killed session of this name left behind goes before anything is opened.
    Leftovers::remove(&lock, &config.session);
    let result =
        check_shared_memory(&config).map_err(Failure::input).and_then(|()| run_locked(options, &config));
    Leftovers::remove(&lock, &config.session);
    result
}

/// Refuses a session that would run out of shared memory, because that kills the process which touches the
/// page that is missing (SIGBUS).
fn check_shared_memory(config: &Config) -> anyhow::Result<()> {
    let needed = required_bytes(&BLOCKS, config.block_length())
        + required_bytes(&WINDOWS, config.window_length())
        + required_bytes(&PREDICTIONS, Gesture::COUNT)
        + required_bytes(&COMMANDS, TWIST_LENGTH)
        + required_bytes(&STATES, STATE_LENGTH)
        + Stage::ALL.len() as u64 * required_bytes(&MEASUREMENTS, BATCH_LENGTH);
    let folder = shared_memory_directory();
    let free = free_bytes(folder)?;
    let megabytes = |bytes: u64| bytes.div_ceil(1_000_000);
    ensure!(
        needed <= free,
        "{}: {} MB free, but the session may need {} MB: free some (`tendon doctor`), enlarge it (mount -o \
         remount,size=… {0}), or take fewer channels or shorter blocks",
        folder.display(),
        megabytes(free),
        megabytes(needed)
    );
    Ok(())
}

/// Free bytes of the file system at `folder`.
pub fn free_bytes(folder: &Path) -> anyhow::Result<u64> {
    let status = nix::sys::statvfs::statvfs(folder)
        .with_context(|| format!("cannot look at {}: is it mounted?", folder.display()))?;
    Ok(status.blocks_available() * status.fragment_size())
}

fn run_locked(options: &Options, config: &Config) -> Result<(), Failure> {
    let (sender, events) = channel();
    stop_on_signals(&sender).map_err(Failure::running)?;
    let observer = Observer::before_the_stages(&config.session, "supervisor").map_err(Failure::input)?;
    let has_simulated_user = options.has_simulated_user(config.acquisition.source);
    let task = options.task.map(|kind| zones::task(kind, config, has_simulated_user));
    let task = task.transpose().map_err(Failure::input)?;
    // From before the arm goes to its start position: it can be stopped then, too.
    let keyboard = if options.keyboard || Keyboard::is_there() {
        Some(Keyboard::listen(&sender, options.keyboard).map_err(Failure::input)?)
    } else {
        None
    };
    let children = Children::start(config, &sender).map_err(Failure::input)?;
    let mut watch =
        Watch { config, events, children, observer, task, screen: Screen::new(), restarts: Vec::new() };
    watch.session(options, keyboard)
}

fn write_figures(folder: &Path, gathered: &SessionMeasurements) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let histograms = [
        ("newest-sample-to-command", "newest sample to command", &gathered.newest_sample_to_command),
        ("window-start-to-command", "window start to command", &gathered.window_start_to_command.histogram),
    ];
    for (name, title, histogram) in histograms {
        for ending in ["png", "svg"] {
            latency_figure(&folder.join(format!("{name}.{ending}")), title, histogram)?;
        }
    }
    Ok(())
}

fn write_log(path: &Path, measurements: &SessionMeasurements, length: Duration) -> anyhow::Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let mut file = BufWriter::new(File::create(path).with_context(failed)?);
    write_latency_log(measurements, length, &mut file).with_context(failed)
}

/// Writes what a `--json FILE` asks for.
pub fn write_json(path: &Path, content: &impl Serialize) -> anyhow::Result<()> {
    let file = File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
    serde_json::to_writer_pretty(file, content).with_context(|| format!("cannot write {}", path.display()))
}

fn stop_on_signals(events: &Sender<Event>) -> anyhow::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM]).context("cannot handle signals")?;
    let events = events.clone();
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            for _ in signals.forever() {
                // Nobody listens any more once the session is over.
                let _ = events.send(Event::Stop);
            }
        })
        .context("cannot start a thread")?;
    Ok(())
}

/// Takes everything that the stages have said, and lets the task see every state.
fn gather(observer: &mut Observer, task: &mut Option<TaskRun>) -> anyhow::Result<()> {
    let mut no_room = Ok(());
    observer.gather(|state| {
        if let Some(Err(error)) = task.as_mut().map(|task| task.observe(&state.header, state.position_mm())) {
            no_room = Err(error);
        }
    })?;
    Ok(no_room?)
}

/// A running session as the supervisor sees it.
struct Watch<'a> {
    config: &'a Config,
    events: Receiver<Event>,
    children: Children,
    observer: Observer,
    task: Option<TaskRun>,
    screen: Screen,
    /// In the order in which they happened.
    restarts: Vec<Restart>,
}

/// What is known once all stages are ready.
struct Started {
    ready: BTreeMap<Stage, Ready>,
    at: Instant,
    /// Processor time before, s; less what processes that ended since have used.
    cpu_s: BTreeMap<Stage, f64>,
    own_cpu_s: f64,
}

/// A stage that ended and was started again.
struct Restart {
    stage: Stage,
    at: Instant,
    ready: Option<Instant>,
}

impl Watch<'_> {
    /// The session, from the wait for its stages to the report. In the end no stage runs.
    fn session(&mut self, options: &Options, keyboard: Option<Keyboard>) -> Result<(), Failure> {
        let ready = self.wait_until_ready();
        let Ok(Some(mut started)) = ready else {
            let stopped = self.stop_stages().map_err(Failure::running);
            return ready.and(stopped);
        };
        self.introduce(&started);
        if options.keyboard {
            println!("  {GESTURE_KEYS}");
        }
        if keyboard.is_some() {
            println!("  {KEYS}");
        }
        let watched = self.until_the_end(&mut started, options.duration);
        let report = self.stop_and_report(&started, options.latency_log.as_deref());
        drop(keyboard);
        self.screen.finish();
        let written = report.and_then(|report| self.write(options, &report)).map_err(Failure::running);
        // What ended the session says more than what came of that.
        watched.and(written)
    }

    /// Prints the report and writes what was asked for.
    fn write(&self, options: &Options, report: &Report) -> anyhow::Result<()> {
        println!("{}", report.table());
        if let Some(folder) = &options.figures {
            write_figures(folder, self.observer.measurements())?;
            if let Some(task) = &self.task {
                zones::write_figures(folder, task)?;
            }
        }
        match &options.json {
            Some(path) => write_json(path, report),
            None => Ok(()),
        }
    }

    /// Waits until all stages are ready, then lets the source begin; `None` when told to stop before.
    fn wait_until_ready(&mut self) -> Result<Option<Started>, Failure> {
        let begun = Instant::now();
        let (timeout, on_the_way) = match self.config.robot.backend {
            Backend::Simulate => (READY_TIMEOUT, ""),
            Backend::XArm => (READY_TIMEOUT_OF_ARM, ": the arm goes to its start position"),
        };
        let mut ready = BTreeMap::new();
        while ready.len() < Stage::ALL.len() {
            match self.events.recv_timeout(TICK) {
                Ok(Event::Ready(stage, message)) => drop(ready.insert(stage, message)),
                Ok(Event::Stop) => return Ok(None),
                Ok(Event::Ended(stage)) => return Err(self.ended_early(stage)),
                Ok(Event::Order(stage, order)) => self.children.order(stage, order),
                Err(_) => {}
            }
            let missing = || -> Vec<&str> {
                let missing = Stage::ALL.into_iter().filter(|stage| !ready.contains_key(stage));
                missing.map(Stage::name).collect()
            };
            if begun.elapsed() > timeout {
                return Err(not_ready(&missing().join(", "), timeout));
            }
            if begun.elapsed() > PATIENCE {
                let missing = missing();
                let going = if missing == ["robot"] { on_the_way } else { "" };
                self.screen.show(&format!("waiting for {}{going}", missing.join(", ")));
            }
        }
        let cpu_s = self
            .children
            .process_ids()
            .filter_map(|(stage, process_id)| Some((stage, resources::cpu_s(process_id)?)))
            .collect();
        let own_cpu_s = resources::cpu_s(std::process::id()).unwrap_or_default();
        for stage in Stage::ALL {
            self.children.order(stage, Order::Start);
        }
        Ok(Some(Started { ready, at: Instant::now(), cpu_s, own_cpu_s }))
    }

    /// Stops all stages that run, robot first, and takes what they say last.
    fn stop_stages(&mut self) -> anyhow::Result<()> {
        let Watch { children, events, observer, task, .. } = self;
        let killed = children.stop(events, || gather(observer, task))?;
        gather(observer, task)?;
        ensure!(killed.is_empty(), "{} did not stop and had to be killed", killed.join(", "));
        Ok(())
    }

    fn introduce(&self, started: &Started) {
        println!("session {}", self.config.session);
        for stage in Stage::ALL {
            if let Some(ready) = started.ready.get(&stage) {
                println!("  {:<12}{}", stage.name(), ready.detail);
            }
        }
        if let Some(task) = &self.task {
            println!("  {:<12}{}", "task", task.describe());
        }
        // All stages ask for the same, but for the priority.
        if let Some(ready) = started.ready.get(&Stage::Dsp) {
            let shortfall = &ready.scheduling.shortfall;
            let remark = if shortfall.is_empty() { String::new() } else { format!(" ({shortfall})") };
            println!("  {:<12}{}{remark}", "scheduling", ready.scheduling);
        }
    }

    /// Watches until the time is over, the recording is, somebody says stop, or a stage ends that cannot be started
    /// again.
    fn until_the_end(&mut self, started: &mut Started, duration: Option<Duration>) -> Result<(), Failure> {
        let begun = Instant::now();
        let mut finished = None;
        let tick = match self.config.delivery() {
            Delivery::Live if self.task.is_some() => TASK_TICK,
            Delivery::Live => TICK,
            Delivery::Lossless => LOSSLESS_TICK,
        };
        loop {
            let left = duration.map_or(tick, |duration| duration.saturating_sub(begun.elapsed()));
            match self.events.recv_timeout(tick.min(left)) {
                Ok(Event::Stop) => return Ok(()),
                Ok(Event::Order(stage, order)) => self.children.order(stage, order),
                Ok(Event::Ended(stage)) => self.restart(started, stage)?,
                Ok(Event::Ready(stage, ready)) => self.go_on(started, stage, ready),
                Err(RecvTimeoutError::Timeout) => self.look_at_restarts()?,
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            gather(&mut self.observer, &mut self.task).map_err(Failure::running)?;
            let (header, payload) = self
                .observer
                .newest_state()
                .map_or((StateHeader::default(), [0.0; STATE_LENGTH]), |state| (state.header, state.payload));
            let mut line = live_line(begun.elapsed(), &header, &payload);
            if let Some(task) = &mut self.task {
                if let Some(gesture) = task.new_gesture() {
                    self.children.order(Stage::Acquisition, Order::Gesture(gesture));
                }
                line.push_str(&task.live());
            }
            self.screen.show(&line);
            if self.observer.measurements().has_finished() && finished.is_none() {
                finished = Some(Instant::now());
            }
            // What a stage missed while it was gone is never taken.
            let is_over = !self.restarts.is_empty()
                && finished.is_some_and(|finished| finished.elapsed() > LAST_OF_RECORDING);
            if duration.is_some_and(|duration| begun.elapsed() >= duration)
                || self.observer.measurements().is_drained()
                || is_over
            {
                return Ok(());
            }
        }
    }

    /// Starts a stage again that ended, in a session that goes on. The arm is stopped first, until it is armed.
    fn restart(&mut self, started: &mut Started, stage: Stage) -> Result<(), Failure> {
        self.children.order(Stage::Robot, Order::StageEnded);
        let was_restarted = self.restarts.iter().rfind(|restart| restart.stage == stage);
        let proved_itself = was_restarted
            .is_none_or(|restart| restart.ready.is_some_and(|ready| ready.elapsed() >= RESTART_TRIAL));
        // A replay that began anew would be another one.
        let is_replay = self.config.acquisition.source == Source::Replay;
        let goes_on = self.config.delivery() == Delivery::Live && !(is_replay && stage == Stage::Acquisition);
        if !(proved_itself && goes_on) {
            return Err(Failure { exit_code: 1, ..self.ended_early(stage) });
        }
        let used_s = self.children.process_id(stage).and_then(resources::cpu_s);
        let status = self.children.reap(stage).map_err(Failure::running)?;
        let status = status.map_or(String::new(), |status| format!(" ({status})"));
        let Config { decision, dsp, .. } = self.config;
        let rest = match (stage, decision.strategy) {
            (Stage::Dsp, Strategy::Threshold) => {
                format!("{} s of rest, on which it calibrates", dsp.activity.calibration_s)
            }
            _ => "a rest".to_owned(),
        };
        self.screen.finish();
        tell(&format!(
            "{} ended{status} and is started again: the arm moves after `tendon arm` (key a) and {rest}",
            stage.name()
        ));
        Leftovers::remove_of_the_dead(&self.config.session);
        self.children.restart(stage).map_err(Failure::running)?;
        *started.cpu_s.entry(stage).or_default() -= used_s.unwrap_or_default();
        self.restarts.push(Restart { stage, at: Instant::now(), ready: None });
        Ok(())
    }

    /// Lets a stage that was started again begin.
    fn go_on(&mut self, started: &mut Started, stage: Stage, ready: Ready) {
        self.children.order(stage, Order::Start);
        started.ready.insert(stage, ready);
        if let Some(restart) = self.restarts.iter_mut().rfind(|restart| restart.stage == stage) {
            restart.ready = Some(Instant::now());
        }
    }

    /// A stage that was started again must become ready in time.
    fn look_at_restarts(&self) -> Result<(), Failure> {
        let is_late = |restart: &&Restart| restart.ready.is_none() && restart.at.elapsed() > READY_TIMEOUT;
        match self.restarts.iter().find(is_late) {
            None => Ok(()),
            Some(restart) => {
                Err(not_ready(&format!("{} was started again but", restart.stage.name()), READY_TIMEOUT))
            }
        }
    }

    /// What to say of a stage that ended by itself. It has said itself why.
    fn ended_early(&mut self, stage: Stage) -> Failure {
        self.screen.finish();
        match self.children.reap(stage) {
            Ok(Some(status)) => {
                let error = anyhow::anyhow!("{} ended ({status}): the session is stopped", stage.name());
                let exit_code = if status.code() == Some(2) { 2 } else { 1 };
                Failure { error, exit_code }
            }
            Ok(None) => Failure::running(anyhow::anyhow!("{} ended: the session is stopped", stage.name())),
            Err(error) => Failure::running(error),
        }
    }

    /// Stops all stages, robot first, and says what was measured.
    fn stop_and_report(&mut self, started: &Started, log: Option<&Path>) -> anyhow::Result<Report> {
        let duration = started.at.elapsed();
        let mut cpu_s = BTreeMap::new();
        let mut memory_mb = BTreeMap::new();
        for (stage, process_id) in self.children.process_ids() {
            let before = started.cpu_s.get(&stage).copied().unwrap_or_default();
            if let Some(seconds) = resources::cpu_s(process_id) {
                cpu_s.insert(stage.name().to_owned(), seconds - before);
            }
            if let Some(megabytes) = resources::memory_mb(process_id) {
                memory_mb.insert(stage.name().to_owned(), megabytes);
            }
        }
        let own = std::process::id();
        if let (Some(seconds), Some(megabytes)) = (resources::cpu_s(own), resources::memory_mb(own)) {
            cpu_s.insert("supervisor".to_owned(), seconds - started.own_cpu_s);
            memory_mb.insert("supervisor".to_owned(), megabytes);
        }
        gather(&mut self.observer, &mut self.task)?;
        self.observer.ending();
        self.stop_stages()?;
        if let Some(path) = log {
            write_log(path, self.observer.measurements(), duration)?;
        }
        let facts = SessionFacts { duration, cpu_s, memory_mb, ..self.facts(started) };
        Ok(Report::new(facts, self.observer.measurements()))
    }

    /// What the session knows of itself, but for how long it took and what it used.
    fn facts(&self, started: &Started) -> SessionFacts {
        let Config { acquisition, decision, robot, .. } = self.config;
        let detail = |stage| started.ready.get(&stage).map_or(String::new(), |ready| ready.detail.clone());
        let scheduling =
            |(stage, ready): (&Stage, &Ready)| (stage.name().to_owned(), ready.scheduling.to_string());
        let is_full_speed = self.config.delivery() == Delivery::Lossless;
        SessionFacts {
            session: self.config.session.to_string(),
            source: match acquisition.source {
                Source::Simulate => "simulate".to_owned(),
                Source::Replay => "replay".to_owned(),
            },
            robot: match robot.backend {
                Backend::Simulate => "simulate".to_owned(),
                Backend::XArm => "xarm".to_owned(),
            },
            model: detail(Stage::Inference),
            strategy: decision.strategy.name().to_owned(),
            scheduling: started.ready.iter().map(scheduling).collect(),
            full_speed_block_s: is_full_speed
                .then(|| acquisition.block_samples as f64 / acquisition.sample_rate_hz),
            final_position_mm: self
                .observer
                .newest_state()
                .map_or([0.0; 3], |state| state.position_mm().map(f64::from)),
            restarts: self.restarts.len() as u64,
            task: self.task.as_ref().and_then(|task| task.report(self.observer.states_lost())),
            ..SessionFacts::default()
        }
    }
}
