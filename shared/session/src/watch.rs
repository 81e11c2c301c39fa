//! A running session as its supervisor sees it: waits for the stages, watches them, starts them again, stops them.
//!
//! ```text
//! Watch::start ─▶ wait_until_ready ─▶ turn, turn, … ─▶ stop        robot first, whatever went wrong before
//!                                       │  ▲
//!                stage ended: restart ──┘  └── observer, progress, heartbeat
//! ```

mod recording;

use std::collections::{BTreeMap, VecDeque};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use tendon_config::{Backend, Config, Source};
use tendon_gesture::Strategy;
use tendon_messages::{ArmPhase, Stage};
use tendon_observer::{Observer, State};
use tendon_process::{Answer, Asked, Order, Ready};
use tendon_report::SessionEvent;
use tendon_session_file::{RecordingReport, Told};
use tendon_transport::{Delivery, Leftovers, SharedFiles};

use crate::arm_stops::ArmStops;
use crate::children::{Children, ChildrenError, Event, StageEnd};
use crate::failure::SessionFailure;
use crate::progress::ProgressWatch;
use crate::recorder::{Recorder, RecordingPlan};
use crate::resources;
use crate::robot_line::RobotLine;
use crate::writer::Writer;

/// Longest wait for a stage to become ready between two looks.
const READY_TICK: Duration = Duration::from_millis(50);
/// How long the stages may take to become ready.
const READY_TIMEOUT: Duration = Duration::from_secs(60);
/// The same with an arm that first goes to its start position, perhaps twice around.
const READY_TIMEOUT_OF_ARM: Duration = Duration::from_secs(300);
/// After this long without being ready, the user is told what is waited for.
const PATIENCE: Duration = Duration::from_secs(2);
/// What is said of an `a` that was read after a standstill.
const LATE_ARM: &str =
    "tendon: not armed: this program stood still when `a` came; look at the arm, then press it again";
/// A stage that was started again and ends within so long of being ready would do so for ever.
const RESTART_TRIAL: Duration = Duration::from_secs(2);
/// So long after the end of a recording nothing of it is under way any more.
const LAST_OF_RECORDING: Duration = Duration::from_secs(1);
/// Time between two looks for observers that were killed: each keeps one of the eight seats of a topic. A look takes
/// some 10 ms of processor time.
const DEAD_OBSERVERS_INTERVAL: Duration = Duration::from_secs(15);
/// Time between two looks at the session's files.
const FILES_INTERVAL: Duration = Duration::from_secs(1);

/// Whether a session goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// It does.
    GoesOn,
    /// Somebody said stop, or the recording is over.
    Over,
}

/// A stage that ended and was started again.
#[derive(Debug)]
struct Restart {
    stage: Stage,
    at: Instant,
    ready: Option<Instant>,
}

/// What the processes of a session used, from its start to its stop: by stage, and `supervisor`.
#[derive(Clone, Debug, Default)]
pub struct Usage {
    /// How long the session took.
    pub duration: Duration,
    /// Processor time, s.
    pub cpu_s: BTreeMap<String, f64>,
    /// Proportional resident memory at the end, MB.
    pub memory_mb: BTreeMap<String, f64>,
}

/// A running session. Dropping it stops the robot and kills the rest.
#[derive(Debug)]
pub struct Watch<'a> {
    config: &'a Config,
    events: Receiver<Event>,
    robot: RobotLine,
    children: Children,
    observer: Observer,
    standard_error: Writer,
    progress: ProgressWatch,
    arm_stops: ArmStops,
    looked_for_dead: Instant,
    files: SharedFiles,
    /// `None` before the first time.
    looked_at_files: Option<Instant>,
    events_so_far: Vec<SessionEvent>,
    /// In the order in which they happened.
    restarts: Vec<Restart>,
    ready: BTreeMap<Stage, Ready>,
    /// When all stages were ready.
    began: Option<Instant>,
    /// Processor time before, s; less what processes that ended since have used.
    cpu_before_s: BTreeMap<Stage, f64>,
    own_cpu_before_s: f64,
    /// When the recording was over.
    finished: Option<Instant>,
    /// `None` where the session cannot be recorded.
    plan: Option<RecordingPlan>,
    recorder: Option<Recorder>,
    /// Why the last recording broke off or could not begin, if it did.
    recording_failure: Option<String>,
    recordings: Vec<RecordingReport>,
    /// Those that came and were not taken yet.
    requests: VecDeque<Asked>,
}

impl<'a> Watch<'a> {
    /// Starts the stages. `robot`, `sender` and `events` are those that keys and signals were given. In a session that
    /// `follows_on_session` the arm waits for an order to arm before it moves at all.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when one cannot be started.
    pub fn start(
        config: &'a Config,
        robot: &RobotLine,
        (sender, events): (&Sender<Event>, Receiver<Event>),
        observer: Observer,
        follows_on_session: bool,
        standard_error: &Writer,
    ) -> Result<Watch<'a>, ChildrenError> {
        let children =
            Children::start(&Stage::ALL, config, sender, robot, follows_on_session, standard_error)?;
        Ok(Watch {
            config,
            events,
            robot: robot.clone(),
            children,
            observer,
            standard_error: standard_error.clone(),
            progress: ProgressWatch::default(),
            arm_stops: ArmStops::default(),
            looked_for_dead: Instant::now(),
            files: SharedFiles::of(&config.session),
            looked_at_files: None,
            events_so_far: Vec::new(),
            restarts: Vec::new(),
            ready: BTreeMap::new(),
            began: None,
            cpu_before_s: BTreeMap::new(),
            own_cpu_before_s: 0.0,
            finished: None,
            plan: None,
            recorder: None,
            recording_failure: None,
            recordings: Vec::new(),
            requests: VecDeque::new(),
        })
    }

    /// Waits until all stages are ready, then lets the source begin; [`Turn::Over`] when told to stop before.
    ///
    /// # Errors
    ///
    /// [`SessionFailure`] when a stage ends or takes too long.
    pub fn wait_until_ready(&mut self) -> Result<Turn, SessionFailure> {
        let begun = Instant::now();
        let is_simulated = self.config.robot.backend == Backend::Simulate;
        let timeout = if is_simulated { READY_TIMEOUT } else { READY_TIMEOUT_OF_ARM };
        while self.ready.len() < Stage::ALL.len() || self.is_recorder_missing() {
            self.robot.loop_turned();
            match self.events.recv_timeout(READY_TICK) {
                Ok(Event::Ready(stage, message)) => drop(self.ready.insert(stage, message)),
                Ok(Event::Stop) => return Ok(Turn::Over),
                Ok(Event::Ended(stage)) => return self.ended(stage, true),
                Ok(Event::Order(stage, order)) => self.children.order(stage, order),
                Ok(Event::Recorder) => self.hear_recorder()?,
                Ok(Event::Request(asked)) => {
                    asked.answer(&Answer::refused("the session is still starting: ask again when it runs"));
                }
                Ok(Event::GoOn | Event::Redo | Event::LateArm | Event::Record) | Err(_) => {}
            }
            self.observer.gather(|_| ())?;
            self.look_at_files()?;
            let missing = Stage::ALL.into_iter().filter(|stage| !self.ready.contains_key(stage));
            let missing: Vec<&str> =
                missing.map(Stage::name).chain(self.is_recorder_missing().then_some("recorder")).collect();
            if begun.elapsed() > timeout {
                return Err(SessionFailure::NotReady { who: missing.join(", "), timeout });
            }
            if begun.elapsed() > PATIENCE {
                let doing = if missing == ["robot"] { self.what_the_arm_does() } else { String::new() };
                self.standard_error.show(&format!("waiting for {}{doing}", missing.join(", ")));
            }
        }
        for (stage, process_id) in self.children.process_ids() {
            self.cpu_before_s.extend(resources::cpu_s(process_id).map(|cpu_s| (stage, cpu_s)));
        }
        self.own_cpu_before_s = resources::cpu_s(std::process::id()).unwrap_or_default();
        self.tell_recorder_of_the_stages();
        for stage in Stage::ALL {
            self.children.order(stage, Order::Start);
        }
        // All files are there now, those that are deleted in the next moment among them.
        self.looked_at_files = None;
        self.look_at_files()?;
        self.began = Some(Instant::now());
        Ok(Turn::GoesOn)
    }

    /// Waits for what happens next, but no longer than `longest`, and sees to it. `on_state` sees every state of the arm.
    ///
    /// # Errors
    ///
    /// [`SessionFailure`] when the session cannot go on.
    pub fn turn(
        &mut self,
        longest: Duration,
        mut on_state: impl FnMut(&State),
    ) -> Result<Turn, SessionFailure> {
        self.robot.loop_turned();
        match self.events.recv_timeout(longest) {
            Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return Ok(Turn::Over),
            Ok(Event::Order(stage, order)) => self.children.order(stage, order),
            Ok(Event::Ended(stage)) if self.robot.is_ending() => return self.ended(stage, false),
            Ok(Event::Ended(stage)) => self.restart(stage)?,
            Ok(Event::Ready(stage, ready)) => self.go_on(stage, ready),
            Ok(Event::Record) => drop(self.record(self.recorder.is_none())),
            Ok(Event::Recorder) => self.hear_recorder()?,
            Ok(Event::Request(asked)) => self.requests.push_back(asked),
            Ok(Event::LateArm) => self.standard_error.say(LATE_ARM),
            Ok(Event::GoOn | Event::Redo) => {}
            Err(RecvTimeoutError::Timeout) => self.look_at_restarts()?,
        }
        let mut stops = Vec::new();
        let gathered = self.observer.gather(|state| {
            stops.extend(self.arm_stops.look(&state.header));
            on_state(state);
        });
        for stop in stops {
            self.note(stop);
        }
        gathered?;
        self.look_at_progress();
        self.look_at_files()?;
        if self.looked_for_dead.elapsed() > DEAD_OBSERVERS_INTERVAL {
            self.looked_for_dead = Instant::now();
            Leftovers::remove_of_the_dead(&self.config.session);
        }
        if self.observer.measurements().has_finished() {
            self.finished.get_or_insert_with(Instant::now);
        }
        // What a stage missed while it was gone is never taken.
        let is_over = !self.restarts.is_empty()
            && self.finished.is_some_and(|finished| finished.elapsed() > LAST_OF_RECORDING);
        Ok(if self.observer.measurements().is_drained() || is_over { Turn::Over } else { Turn::GoesOn })
    }

    /// What the robot waits for, for the line that says so.
    fn what_the_arm_does(&self) -> String {
        let header = self.observer.newest_state().map(|state| state.header).unwrap_or_default();
        match ArmPhase::from_number(header.arm_phase) {
            ArmPhase::GoingToStart => {
                format!(": the arm goes to its start position, {:.0} mm away", header.start_distance_mm)
            }
            ArmPhase::BringingUp => ": the arm switches its motors on".to_owned(),
            _ if self.config.robot.backend == Backend::Simulate => String::new(),
            _ => ": connecting to the arm".to_owned(),
        }
    }

    /// Stops all stages, robot first, and takes what they say last. In the end none runs, whatever the error:
    /// [`SessionFailure`] when a stage had to be killed, or its last words could not be read.
    pub fn stop(&mut self, mut on_state: impl FnMut(&State)) -> (Usage, Result<(), SessionFailure>) {
        let usage = self.usage();
        let Watch { children, events, observer, arm_stops, .. } = self;
        let mut stops = Vec::new();
        let mut on_state = |state: &State| {
            stops.extend(arm_stops.look(&state.header));
            on_state(state);
        };
        let before = observer.gather(&mut on_state);
        observer.ending();
        // An observer that fails is no reason to leave a stage running.
        let killed = children.stop(events, || drop(observer.gather(&mut on_state)));
        let gathered = before.and(observer.gather(&mut on_state));
        for stop in stops {
            self.note(stop);
        }
        // Last of all, so that it has everything.
        if let Some(recorder) = self.recorder.take() {
            self.recording_ended(recorder);
        }
        let result = match killed {
            Err(error) => Err(error.into()),
            Ok(killed) => {
                if killed.is_empty() {
                    gathered.map_err(SessionFailure::from)
                } else {
                    Err(SessionFailure::Killed { names: killed.join(", ") })
                }
            }
        };
        (usage, result)
    }

    /// What the stages said when they were ready.
    pub fn ready(&self) -> &BTreeMap<Stage, Ready> {
        &self.ready
    }

    /// What the stages measure and publish.
    pub fn observer(&self) -> &Observer {
        &self.observer
    }

    /// Since all stages were ready; zero before.
    pub fn elapsed(&self) -> Duration {
        self.began.map_or(Duration::ZERO, |began| began.elapsed())
    }

    /// Whether all stages were ready once.
    pub fn has_begun(&self) -> bool {
        self.began.is_some()
    }

    /// How often a stage was started again.
    pub fn restarts(&self) -> u64 {
        self.restarts.len() as u64
    }

    /// What was unusual so far.
    pub fn events(&self) -> &[SessionEvent] {
        &self.events_so_far
    }

    /// Which stage makes no progress now, in words.
    pub fn standstill(&self) -> Option<String> {
        self.progress.standstill(Instant::now())
    }

    /// Gives an order to a stage.
    pub fn order(&mut self, stage: Stage, order: Order) {
        self.children.order(stage, order);
    }

    /// What the processes have used since all were ready.
    fn usage(&self) -> Usage {
        let mut usage = Usage { duration: self.elapsed(), ..Usage::default() };
        let mut add = |name: &str, process_id: u32, before_s: f64| {
            let cpu_s = resources::cpu_s(process_id).map(|cpu_s| (name.to_owned(), cpu_s - before_s));
            usage.cpu_s.extend(cpu_s);
            usage.memory_mb.extend(resources::memory_mb(process_id).map(|mb| (name.to_owned(), mb)));
        };
        for (stage, process_id) in self.children.process_ids() {
            let before_s = self.cpu_before_s.get(&stage).copied().unwrap_or_default();
            add(stage.name(), process_id, before_s);
        }
        if let Some(recorder) = &self.recorder {
            add("recorder", recorder.process_id(), 0.0);
        }
        add("supervisor", std::process::id(), self.own_cpu_before_s);
        usage
    }

    /// A stage ended that is not started again: a fault, unless somebody said stop.
    fn ended(&mut self, stage: Stage, at_start: bool) -> Result<Turn, SessionFailure> {
        match self.children.reap(stage)? {
            Some(StageEnd { status, last_words }) if !self.robot.is_ending() => {
                if at_start {
                    // The others are only being stopped, and must not give reasons of their own.
                    self.children.keep_quiet();
                }
                Err(SessionFailure::StageEnded { stage, status, at_start, last_words })
            }
            _ => Ok(Turn::Over),
        }
    }

    /// Starts a stage again that ended, in a session that goes on. The arm is stopped first, until it is armed.
    fn restart(&mut self, stage: Stage) -> Result<(), SessionFailure> {
        self.robot.order(Order::StageEnded);
        let was_restarted = self.restarts.iter().rfind(|restart| restart.stage == stage);
        let proved_itself = was_restarted
            .is_none_or(|restart| restart.ready.is_some_and(|ready| ready.elapsed() >= RESTART_TRIAL));
        // A replay that began anew would be another one.
        let is_replay = self.config.acquisition.source == Source::Replay;
        let goes_on = self.config.delivery() == Delivery::Live && !(is_replay && stage == Stage::Acquisition);
        if !(proved_itself && goes_on) {
            return self.ended(stage, false).map(drop);
        }
        let used_s = self.children.process_id(stage).and_then(resources::cpu_s);
        let status = self.children.reap(stage)?.map_or(String::new(), |end| format!(" ({})", end.status));
        let rest = match (stage, self.config.decision.strategy) {
            (Stage::Dsp, Strategy::Threshold) => {
                format!("{} s of rest, on which it calibrates", self.config.dsp.activity.calibration_s)
            }
            _ => "a rest".to_owned(),
        };
        self.note(format!(
            "{} ended{status} and is started again: the arm moves after `tendon arm` (key a) and {rest}",
            stage.name()
        ));
        Leftovers::remove_of_the_dead(&self.config.session);
        self.children.restart(stage)?;
        self.progress.forget(stage);
        *self.cpu_before_s.entry(stage).or_default() -= used_s.unwrap_or_default();
        self.restarts.push(Restart { stage, at: Instant::now(), ready: None });
        Ok(())
    }

    /// Lets a stage that was started again begin.
    fn go_on(&mut self, stage: Stage, ready: Ready) {
        self.children.order(stage, Order::Start);
        self.ready.insert(stage, ready);
        if let Some(restart) = self.restarts.iter_mut().rfind(|restart| restart.stage == stage) {
            restart.ready = Some(Instant::now());
        }
    }

    /// A stage that was started again must become ready in time.
    fn look_at_restarts(&self) -> Result<(), SessionFailure> {
        let is_late = |restart: &&Restart| restart.ready.is_none() && restart.at.elapsed() > READY_TIMEOUT;
        match self.restarts.iter().find(is_late) {
            None => Ok(()),
            Some(restart) => Err(SessionFailure::NotReady {
                who: format!("{} was started again but", restart.stage.name()),
                timeout: READY_TIMEOUT,
            }),
        }
    }

    /// Says which stage takes nothing though something waits for it.
    fn look_at_progress(&mut self) {
        // What was lost on the way to a stage that was started again is never taken: at the end of a recording that is
        // no fault.
        if self.finished.is_some() && !self.restarts.is_empty() {
            return;
        }
        let is_starting =
            |stage| self.restarts.iter().any(|restart| restart.stage == stage && restart.ready.is_none());
        let measurements = self.observer.measurements();
        let mut notices = Vec::new();
        for stage in Stage::ALL.into_iter().filter(|stage| !is_starting(*stage)) {
            let counts = measurements.counts(stage);
            let (done, waiting) = match stage.upstream() {
                Some(upstream) => {
                    let taken = counts.received + counts.lost;
                    (taken, measurements.counts(upstream).published.saturating_sub(taken))
                }
                None => (counts.published, u64::from(self.is_sample_due())),
            };
            notices.extend(self.progress.observe(Instant::now(), stage, done, waiting));
        }
        for notice in notices {
            self.note(notice.to_string());
        }
    }

    /// Whether the source owes samples: it has not come to its end, and does not wait for dsp either, as in a lossless
    /// session.
    fn is_sample_due(&self) -> bool {
        let measurements = self.observer.measurements();
        let dsp = measurements.counts(Stage::Dsp);
        let published = measurements.counts(Stage::Acquisition).published;
        !measurements.has_finished() && dsp.received + dsp.lost >= published
    }

    /// The next request that has come and whose sender still waits, for whoever runs the session to answer.
    pub fn take_request(&mut self) -> Option<Asked> {
        std::iter::from_fn(|| self.requests.pop_front()).find(Asked::is_waited_for)
    }

    /// Looks once a second whether the files are there through which the stages reach each other.
    fn look_at_files(&mut self) -> Result<(), SessionFailure> {
        if self.looked_at_files.is_some_and(|looked| looked.elapsed() < FILES_INTERVAL) {
            return Ok(());
        }
        self.looked_at_files = Some(Instant::now());
        if let Some(folder) = self.files.deleted_run_time_folder() {
            self.note(format!(
                "{} was deleted while the session ran: it goes on, but nobody can join it any more, and a stage that ends \
                 cannot be started again. End the session and start it anew",
                folder.display()
            ));
        }
        self.files.deleted().map_or(Ok(()), |file| Err(SessionFailure::FileDeleted { file }))
    }

    /// Tells the user of something unusual, and keeps it for the report.
    fn note(&mut self, text: String) {
        self.standard_error.say(format!("tendon: {text}"));
        if let Some(recorder) = &mut self.recorder {
            recorder.tell(&Told::Event(text.clone()));
        }
        self.events_so_far.push(SessionEvent { at_s: self.elapsed().as_secs_f64(), text });
    }
}
