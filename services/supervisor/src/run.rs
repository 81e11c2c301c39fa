//! `tendon run`: one session from start to report.
//!
//! ```text
//! options ─▶ lock ─▶ check ─▶ Watch ─▶ turn, show, turn, show, … ─▶ stop ─▶ Known ─▶ table, JSON, log, figures
//!    └── refused ──┴── refused ──┴── a stage fails to start ────────────────▶
//! ```

use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;

use anyhow::Context;
use signal_hook::consts::{SIGINT, SIGTERM};
use tendon_config::Config;
use tendon_gesture::{DecisionSettings, Strategy};
use tendon_messages::Stage;
use tendon_observer::{Observer, State};
use tendon_output::OutputErrors;
use tendon_people::{Person, PersonInUse};
use tendon_process::{Order, Ready};
use tendon_provenance::Provenance;
use tendon_report::{Outcome, Report, SessionFacts, SessionMeasurements};
use tendon_session::{
    Companion, Keyboard, Keys, OutputError, RobotLine, SessionFailure, Turn, Usage, Watch, Writer,
    gesture_keys, stop_on_signals,
};
use tendon_session_file::RecordingReport;
use tendon_transport::{Delivery, Leftovers, SessionLock};
use tendon_zones::{Contraction, TaskRun};

use crate::desk::SessionDesk;
use crate::model_channels::is_replayed_table;
use crate::next::{Following, Handover};
use crate::options::Options;
use crate::page::Page;
use crate::personal::check_signal;
use crate::screen::{KEYS, live_line};
use crate::session_outputs::SessionOutputs;
use crate::{Failure, TERMINAL_TIMEOUT, checks, failed, provenance, recorded, zones};

/// Longest time between two looks at what the stages say. Their messages do not wait for it, but the heartbeat does.
const TICK: Duration = Duration::from_millis(50);
/// The same with a task: the simulated user answers no later than a person would notice.
const TASK_TICK: Duration = Duration::from_millis(20);

/// The program that gives what a session decides to the Lab Streaming Layer.
const LSL_OUTLET: &str = "tendon-lsl-outlet";

/// The programs that observe the session, as far as they are asked for.
struct Companions {
    /// What the session before handed on, if there was one.
    before: Option<Handover>,
    outlet: Option<Companion>,
    page: Option<Page>,
}

impl Companions {
    /// Starts the page and waits until it listens, before the stages: whoever has it can stop the arm before it moves for the
    /// first time. In a session that follows on another the arm waits, and the page comes once the session has begun: browsers
    /// wait at its socket.
    fn before_the_stages(options: &Options, config: &Config, errors: &Writer) -> Result<Companions, Failure> {
        let before = Handover::received().map_err(Failure::input)?;
        let mut companions = Companions { before, outlet: None, page: None };
        if !companions.follow_on_session() {
            companions.start_page(options, config, errors)?;
            // One that cannot listen says so, and the session goes on without it.
            let _ = companions.page.as_ref().map(Page::wait_until_there);
        }
        Ok(companions)
    }

    /// Whether there was a session before, at whose page this one was asked for.
    fn follow_on_session(&self) -> bool {
        self.before.is_some()
    }

    fn start_page(&mut self, options: &Options, config: &Config, errors: &Writer) -> Result<(), Failure> {
        if options.page.page {
            let before = self.before.as_ref();
            self.page = Page::start(&options.page, config, before, errors).map_err(Failure::running)?;
        }
        Ok(())
    }

    /// Starts what is missing, once the stages are ready.
    fn start_rest(&mut self, options: &Options, config: &Config, errors: &Writer) -> Result<(), Failure> {
        if self.follow_on_session() {
            self.start_page(options, config, errors)?;
        }
        let start = || Companion::start(LSL_OUTLET, config, &[], Vec::new(), Stdio::null(), |_| (), errors);
        self.outlet = config.outlets.lsl.then(start).transpose().map_err(Failure::running)?;
        Ok(())
    }

    /// Says that the outlet has ended, if it has. Does not wait.
    fn look(&mut self, errors: &Writer) {
        if let Some(status) = self.outlet.as_mut().and_then(Companion::ended) {
            errors.say(format!("tendon: {LSL_OUTLET} ended ({status}): the session goes on without it"));
        }
    }
}

/// Runs a session, and gives what is to follow on it. Of one that could not begin, the page that it was asked for at says why.
pub fn run(options: &Options) -> Result<Option<Following>, Failure> {
    let mut has_begun = false;
    match run_and_report(options, &mut has_begun) {
        Err(failure) if !has_begun => failed::show(failure, &options.page),
        result => result,
    }
}

/// Runs a session, and says whether it began. However it ends, the files that were asked for are written; not with a configuration that makes no sense,
/// because it may name one of them as an input.
fn run_and_report(options: &Options, has_begun: &mut bool) -> Result<Option<Following>, Failure> {
    // What a replay takes out of its recording lies in the folder, if it takes anything.
    let (config, _folder) = options.configuration().map_err(Failure::input)?;
    let Options { json, latency_log, figures, .. } = options;
    let outputs = SessionOutputs::check(
        json.as_deref(),
        latency_log.as_deref(),
        figures.as_deref(),
        &options.inputs(&config),
    )?;
    let output = Writer::standard_output().map_err(Failure::running)?;
    let errors = Writer::standard_error().map_err(Failure::running)?;
    let terminal = Terminal { output, errors };
    let mut known = Known::default();
    let result = run_configured(options, &config, &mut known, &terminal);
    *has_begun = known.measurements.is_some();
    let written = known.report(&result, &outputs, &terminal);
    // What is said of the end comes after all else, if the terminal takes it.
    let _ = terminal.errors.finish(TERMINAL_TIMEOUT);
    // What ended the session says more than what came of that.
    let result = result.and_then(|following| written.map(|()| following).map_err(Failure::running));
    match terminal.output.finish(TERMINAL_TIMEOUT) {
        // Nobody reads the table; it is no less true for that.
        Ok(()) | Err(OutputError::Closed(_) | OutputError::Stalled(_)) => result,
        Err(error) => result.and(Err(Failure::running(error))),
    }
}

/// The two standard streams. Neither is ever waited for while the session runs.
struct Terminal {
    output: Writer,
    errors: Writer,
}

/// What is known of a session so far: of one that ended early, less.
#[derive(Default)]
struct Known {
    facts: SessionFacts,
    task: Option<TaskRun>,
    /// What the stages measured, once all of them were ready and the session is over.
    measurements: Option<SessionMeasurements>,
}

impl Known {
    /// Prints the table and writes the files that were asked for.
    fn report<T>(
        mut self,
        result: &Result<T, Failure>,
        outputs: &SessionOutputs,
        terminal: &Terminal,
    ) -> Result<(), OutputErrors> {
        self.facts.outcome = match (result, &self.measurements) {
            (_, None) => Outcome::NotStarted,
            (Ok(_), Some(_)) => Outcome::Completed,
            (Err(_), Some(_)) => Outcome::BrokeOff,
        };
        self.facts.error = result.as_ref().err().map(Failure::reason);
        let report =
            Report::new(self.facts, self.measurements.as_ref().unwrap_or(&SessionMeasurements::default()));
        if self.measurements.is_some() {
            terminal.output.say(report.table().to_string());
            report.recordings.iter().for_each(|recording| terminal.output.say(recording_line(recording)));
        } else if result.is_ok() {
            terminal.errors.say("tendon: the session ended before it began, so nothing was measured");
        }
        let measurements = self.measurements.unwrap_or_default();
        outputs.write(&report, &measurements, self.task.as_ref(), &terminal.errors)
    }
}

/// Where a recording lies, and what it lacks.
fn recording_line(recording: &RecordingReport) -> String {
    let lost: Vec<String> = recording.lost.iter().map(|(topic, count)| format!("{count} {topic}")).collect();
    let lost = if lost.is_empty() { String::new() } else { format!(", without {}", lost.join(", ")) };
    let cut = if recording.error.is_some() { ", ended before the session" } else { "" };
    let megabytes = recording.bytes as f64 / 1e6;
    if !recording.path.exists() {
        return format!("recorded to {}, where it is no more{lost}", recording.path.display());
    }
    format!("recorded to {} ({megabytes:.1} MB{lost}{cut})", recording.path.display())
}

fn run_configured(
    options: &Options,
    config: &Config,
    known: &mut Known,
    terminal: &Terminal,
) -> Result<Option<Following>, Failure> {
    known.configured(config)?;
    checks::outlets(config).map_err(Failure::input)?;
    let lock = SessionLock::take(&config.session).map_err(Failure::input)?;
    // What a killed session of this name left behind goes before anything is opened.
    Leftovers::remove(&lock);
    lock.keep_configuration(&config.to_toml()).map_err(Failure::input)?;
    let result = checks::shared_memory(config)
        .map_err(Failure::input)
        .and_then(|_| run_locked(options, config, known, terminal));
    Leftovers::remove(&lock);
    result
}

fn run_locked(
    options: &Options,
    config: &Config,
    known: &mut Known,
    terminal: &Terminal,
) -> Result<Option<Following>, Failure> {
    let _in_use = person_in_use(config).map_err(Failure::input)?;
    let robot = RobotLine::default();
    let (sender, events) = channel();
    stop_on_signals(&robot, &sender).context("cannot handle signals").map_err(Failure::running)?;
    let is_told_to_end = end_flag().context("cannot handle signals").map_err(Failure::running)?;
    let observer = Observer::before_the_stages(&config.session, "supervisor").map_err(Failure::input)?;
    let has_simulated_user = options.has_simulated_user(config.acquisition.source);
    let task = options.task.map(|kind| zones::task(kind, config, has_simulated_user));
    known.task = task.transpose().map_err(Failure::input)?;
    let mut desk = SessionDesk::open(config, options, has_simulated_user, &sender).map_err(Failure::input)?;
    // From before the arm goes to its start position: it can be stopped then, too.
    // With a page, gestures can come from there.
    let needs_keys = options.keyboard && !options.page.page;
    let keyboard = if needs_keys || Keyboard::is_there() {
        let gestures = options.keyboard.then(|| config.decision.gestures.clone());
        let keyboard = Keyboard::listen(&robot, &sender, gestures.map_or(Keys::Arm, Keys::Gestures));
        Some(keyboard.context("--keyboard").map_err(Failure::input)?)
    } else {
        None
    };
    let mut companions = Companions::before_the_stages(options, config, &terminal.errors)?;
    let follows = companions.follow_on_session();
    let mut watch = Watch::start(config, &robot, (&sender, events), observer, follows, &terminal.errors)
        .map_err(Failure::input)?;
    let plan = recorded::plan(config, options.record.as_deref(), &known.facts.provenance);
    watch.plan_recording(plan.map_err(Failure::input)?).map_err(Failure::input)?;
    let beside = (&mut known.task, &mut desk, &mut companions);
    let watched = watch_until_the_end(&mut watch, options, config, beside, terminal);
    // From now on nobody is told that it runs.
    drop(desk);
    let task_report = known.task.as_ref().and_then(|task| task.report(watch.observer().states_lost()));
    if let Some(Ok(report)) = task_report.map(serde_json::to_value) {
        watch.keep_task(report);
    }
    let (usage, stopped) = watch.stop(|state| {
        // What ends the task does not keep the session from ending.
        let _ = known.task.as_mut().map(|task| task.observe(&state.header, state.position_mm()));
    });
    drop(keyboard);
    terminal.errors.end_live();
    known.session_ended(config, &watch, usage);
    let following = watched.and_then(|following| stopped.map(|()| following).map_err(Failure::running))?;
    Ok(following.filter(|_| !is_told_to_end.load(Ordering::Relaxed)))
}

/// Set by a signal that ends the session: then nothing follows on it.
fn end_flag() -> std::io::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, flag.clone())?;
    }
    Ok(flag)
}

/// Says that the session uses its person, if it has one, until the result is dropped.
fn person_in_use(config: &Config) -> anyhow::Result<Option<PersonInUse>> {
    let is_personal = config.decision.strategy == Strategy::Personal;
    let Some(file) = config.inference.person.as_ref().filter(|_| is_personal) else { return Ok(None) };
    Ok(Some(PersonInUse::claim(&Person::read(file)?.name)?))
}

/// Watches until the time is over, the recording is, somebody says stop or asks for something else, or a stage ends that cannot
/// be started again. Gives what was asked for.
fn watch_until_the_end(
    watch: &mut Watch<'_>,
    options: &Options,
    config: &Config,
    (task, desk, companions): (&mut Option<TaskRun>, &mut SessionDesk, &mut Companions),
    terminal: &Terminal,
) -> Result<Option<Following>, Failure> {
    if watch.wait_until_ready().map_err(failure)? == Turn::Over {
        return Ok(None);
    }
    let ready = watch.ready().get(&Stage::Acquisition);
    // The channels of a table were looked at before the session began.
    let signal =
        ready.and_then(|ready| ready.signal.as_ref()).filter(|_| !is_replayed_table(&config.acquisition));
    if let Some(signal) = signal {
        check_signal(config, signal).map_err(Failure::input)?;
    }
    introduce(watch, options, config, task.as_ref(), terminal);
    companions.start_rest(options, config, &terminal.errors)?;
    if companions.before.as_ref().is_some_and(|before| before.is_recorded) {
        // What keeps it from being recorded is said by itself.
        watch.record(true);
    }
    let tick = if task.is_some() { TASK_TICK } else { TICK };
    loop {
        let left = options.duration.map_or(tick, |duration| duration.saturating_sub(watch.elapsed()));
        let mut observed = Ok(());
        let see = |state: &State| {
            if let Some(task) = task {
                let seen = task.observe(&state.header, state.position_mm());
                observed = std::mem::replace(&mut observed, Ok(())).and(seen);
            }
        };
        let turn = watch.turn(tick.min(left), see).map_err(failure)?;
        observed.map_err(Failure::running)?;
        if let Some(contraction) = task.as_mut().and_then(TaskRun::new_contraction) {
            let Contraction { gesture, effort } = contraction;
            watch.order(Stage::Acquisition, Order::Gesture { gesture, effort: effort as f32 });
        }
        desk.turn(watch, task.as_ref());
        companions.look(&terminal.errors);
        terminal.errors.show(&line(watch, &config.decision, task.as_ref()));
        let is_over = options.duration.is_some_and(|duration| watch.elapsed() >= duration);
        if turn == Turn::Over || is_over {
            return Ok(None);
        }
        if let Some(command_line) = desk.take_next() {
            let handover = desk.handover(companions.page.as_ref());
            return Ok(Some(Following { command_line, handover }));
        }
    }
}

fn line(watch: &Watch<'_>, decision: &DecisionSettings, task: Option<&TaskRun>) -> String {
    let task = task.map_or(String::new(), TaskRun::live);
    live_line(
        watch.elapsed(),
        decision,
        watch.observer().newest_state(),
        watch.standstill().as_deref(),
        &task,
    )
}

fn failure(error: SessionFailure) -> Failure {
    if error.is_input() { Failure::input(error) } else { Failure::running(error) }
}

/// Says what runs, and what the keys do.
fn introduce(
    watch: &Watch<'_>,
    options: &Options,
    config: &Config,
    task: Option<&TaskRun>,
    terminal: &Terminal,
) {
    let say = |text: String| terminal.output.say(text);
    say(format!("session {}", config.session));
    for stage in Stage::ALL {
        if let Some(ready) = watch.ready().get(&stage) {
            say(format!("  {:<12}{}", stage.name(), ready.detail));
        }
    }
    if let Some(task) = task {
        say(format!("  {:<12}{}", "task", task.describe()));
    }
    // All stages ask for the same, but for the priority.
    if let Some(ready) = watch.ready().get(&Stage::Dsp) {
        let shortfall = &ready.scheduling.shortfall;
        let remark = if shortfall.is_empty() { String::new() } else { format!(" ({shortfall})") };
        say(format!("  {:<12}{}{remark}", "scheduling", ready.scheduling));
    }
    if options.keyboard {
        say(format!("  {}", gesture_keys(&config.decision.gestures)));
    }
    if options.keyboard || Keyboard::is_there() {
        say(format!("  {KEYS}"));
    }
}

impl Known {
    /// Takes what the configuration says.
    fn configured(&mut self, config: &Config) -> Result<(), Failure> {
        let facts = &mut self.facts;
        facts.session = config.session.to_string();
        facts.source = config.acquisition.source.name().to_owned();
        facts.robot = config.robot.backend.name().to_owned();
        facts.strategy = config.decision.strategy.name().to_owned();
        facts.gestures = config.decision.gestures.clone();
        // Of one whose models or recording cannot be read, this is all that is known.
        let begun = Provenance::begin(provenance::PROGRAM).with_configuration(config);
        facts.provenance = begun.map_err(Failure::running)?;
        facts.provenance = provenance::of_session(config).map_err(Failure::input)?;
        Ok(())
    }

    /// Takes what the stages said, used and measured.
    fn session_ended(&mut self, config: &Config, watch: &Watch<'_>, usage: Usage) {
        let (ready, observer) = (watch.ready(), watch.observer());
        let scheduling =
            |(stage, ready): (&Stage, &Ready)| (stage.name().to_owned(), ready.scheduling.to_string());
        let is_full_speed = config.delivery() == Delivery::Lossless;
        let acquisition = &config.acquisition;
        self.facts = SessionFacts {
            duration: usage.duration,
            model: ready.get(&Stage::Inference).map_or(String::new(), |ready| ready.detail.clone()),
            scheduling: ready.iter().map(scheduling).collect(),
            full_speed_block_s: is_full_speed
                .then(|| acquisition.block_samples as f64 / acquisition.sample_rate_hz),
            cpu_s: usage.cpu_s,
            memory_mb: usage.memory_mb,
            final_position_mm: observer
                .newest_state()
                .map_or([0.0; 3], |state| state.position_mm().map(f64::from)),
            restarts: watch.restarts(),
            events: watch.events().to_vec(),
            recordings: watch.recordings().to_vec(),
            task: self.task.as_ref().and_then(|task| task.report(observer.states_lost())),
            ..std::mem::take(&mut self.facts)
        };
        self.measurements = watch.has_begun().then(|| observer.measurements().clone());
    }
}
