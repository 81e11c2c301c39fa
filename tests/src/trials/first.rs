//! The first session of a trial: the phase, the cause, and what the arm and the session make of it.

use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tendon_xarm_emulator::Fault;

use super::cause::{Order, Victim};
use super::{
    Bench, Cause, END_LIMIT, FULL_SPEED_MM_PER_S, Failure, LOOK_ON, Outputs, PHASE_LIMIT, Phase, Plan,
    REST_MM_PER_S, STOP_LIMIT, Watch, ending_failures,
};

/// Gestures long enough that the arm does not stop for want of one.
const SCRIPT: &str = "rest 0.8s, ulnar 3s, rest 0.8s, radial 3s";
/// A start position some centimetres away from where the arm stands: more than a second.
const START_ELSEWHERE: &str = "robot.arm.start_joints_deg=[12.0, -15.0, 0.0, 45.0, 0.0, 60.0, 0.0]";
/// How long outputs have been stalled, or closed, when the order comes.
const BEFORE_ORDER: Duration = Duration::from_millis(400);
/// How long a report may take while nobody reads the outputs.
const REPORT_LIMIT: Duration = Duration::from_secs(5);
/// Time between two looks at a condition.
const LOOK: Duration = Duration::from_millis(5);

/// What came of the first session.
pub struct First {
    pub failures: Vec<Failure>,
    /// Its standard error.
    pub errors: String,
    /// From the cause to the last motion, ms.
    pub stop_ms: Option<f64>,
    /// Whether the next session may move the arm by itself.
    pub may_move_afterwards: bool,
}

/// Runs the first session.
pub fn run(bench: &Bench, plan: &Plan) -> First {
    let mut session = Running::start(bench, plan);
    if !session.reach_phase() {
        return session.given_up();
    }
    let cause_at = session.apply_cause();
    std::thread::sleep(LOOK_ON);
    session.let_go_on();
    let has_begun = session.has_begun();
    let status = session.end(has_begun);
    let mut failures = session.failures(cause_at, status, has_begun);
    let stop_ms = cause_at.and_then(|at| {
        let last = session.watch.last_motion_after(at)?;
        Some((last - at).as_secs_f64() * 1e3)
    });
    if plan.is_released && plan.cause == Cause::EmergencyStop {
        bench.emulator.inject(Fault::Release);
    }
    let may_move_afterwards = plan.cause.may_move_afterwards(plan.phase, bench.has_record());
    if failures.contains(&Failure::NoEnd) {
        // What runs on leaves everything where it is.
        let errors = session.outputs.errors();
        bench.end_processes();
        let _ = session.child.wait();
        return First { failures, errors, stop_ms, may_move_afterwards };
    }
    let left = session.processes_that_stay();
    if !left.is_empty() {
        failures.push(Failure::Processes(left));
    }
    let files = bench.files();
    // The next session of the name clears away what a killed supervisor could not.
    if !files.is_empty() && !session.was_supervisor_killed() {
        failures.push(Failure::Leftovers(files));
    }
    First { failures, errors: session.outputs.errors(), stop_ms, may_move_afterwards }
}

/// A session in a phase.
struct Running<'a> {
    bench: &'a Bench,
    plan: &'a Plan,
    child: Child,
    outputs: Outputs,
    watch: Watch,
    report: PathBuf,
    /// The process that hangs.
    hanging: Option<Pid>,
}

impl<'a> Running<'a> {
    fn start(bench: &'a Bench, plan: &'a Plan) -> Running<'a> {
        let settings: &[&str] = if plan.phase == Phase::WayToStart { &[START_ELSEWHERE] } else { &[] };
        let report = bench.folder.path().join("first.json");
        let watch = Watch::start(&bench.emulator);
        let command = bench.session(SCRIPT, settings, &report);
        let (child, outputs) = Outputs::start(plan.cause.output(), command);
        Running { bench, plan, child, outputs, watch, report, hanging: None }
    }

    fn given_up(mut self) -> First {
        let failures = vec![Failure::NotReached];
        self.bench.end_processes();
        let _ = self.child.wait();
        First { failures, errors: self.outputs.errors(), stop_ms: None, may_move_afterwards: true }
    }

    /// Waits for the moment of the plan; false if it does not come.
    fn reach_phase(&mut self) -> bool {
        let (speed_mm_per_s, length_ms) = match self.plan.phase {
            Phase::StartUp => return self.reach_start_up(),
            Phase::WayToStart => (REST_MM_PER_S, 400.0),
            Phase::Moving | Phase::ShutDown => (0.97 * FULL_SPEED_MM_PER_S, 400.0),
        };
        let begun = Instant::now();
        let mut moves = false;
        // An arm that a busy machine has stopped meanwhile would make the trial an easy one.
        while !moves {
            while self.bench.speed_mm_per_s() < speed_mm_per_s {
                if begun.elapsed() > PHASE_LIMIT || self.has_ended() {
                    return false;
                }
                std::thread::sleep(LOOK);
            }
            std::thread::sleep(Duration::from_secs_f64(self.plan.moment * length_ms / 1e3));
            moves = self.bench.speed_mm_per_s() > REST_MM_PER_S;
        }
        if self.plan.phase == Phase::ShutDown {
            self.signal(Signal::SIGTERM);
            std::thread::sleep(Duration::from_secs_f64(self.plan.moment * 0.15));
        }
        true
    }

    /// From the start of the stages, of the victim among them, until about when all are ready.
    fn reach_start_up(&mut self) -> bool {
        let victim = match self.plan.cause {
            Cause::Kill(victim) | Cause::Hang(victim) => victim,
            _ => Victim::Supervisor,
        };
        let begun = Instant::now();
        let stage = |victim| match victim {
            Victim::Stage(_) => victim,
            Victim::Supervisor => Victim::Stage(tendon_messages::Stage::Acquisition),
        };
        while self.process_of(stage(victim)).is_none() {
            if begun.elapsed() > PHASE_LIMIT || self.has_ended() {
                return false;
            }
            std::thread::sleep(LOOK);
        }
        std::thread::sleep(Duration::from_secs_f64(self.plan.moment * 0.6));
        true
    }

    /// Does it. Gives the moment from which the arm has to stop; none if nothing could be done: the process was gone, or
    /// there was no session yet to be stopped.
    fn apply_cause(&mut self) -> Option<Instant> {
        let begun = Instant::now();
        match self.plan.cause {
            Cause::Kill(victim) => {
                kill(self.process_of(victim)?, Signal::SIGKILL).ok()?;
            }
            Cause::Hang(victim) => {
                let process = self.process_of(victim)?;
                kill(process, Signal::SIGSTOP).ok()?;
                self.hanging = Some(process);
            }
            Cause::Cut => self.bench.emulator.inject(Fault::Drop),
            Cause::EmergencyStop => self.bench.emulator.inject(Fault::EmergencyStop),
            Cause::Collision => self.bench.emulator.inject(Fault::Collision),
            Cause::ArmError => self.bench.emulator.inject(Fault::Error(23)),
            Cause::Order(order) => return self.give(order),
            Cause::Stalled(_, order) => {
                self.outputs.stall();
                std::thread::sleep(BEFORE_ORDER);
                return self.give(order);
            }
            Cause::ClosedOutput => self.outputs.close_first(),
            Cause::ClosedOutputs => self.outputs.close(),
            Cause::FullDevice => {}
            Cause::TerminalGone => self.outputs.close(),
        }
        match self.plan.cause {
            Cause::ClosedOutput | Cause::ClosedOutputs | Cause::FullDevice => {
                std::thread::sleep(BEFORE_ORDER);
                self.give(Order::Signal(Signal::SIGTERM))
            }
            _ => Some(begun),
        }
    }

    fn give(&mut self, order: Order) -> Option<Instant> {
        let begun = Instant::now();
        match order {
            Order::Space => self.outputs.press(b' '),
            Order::Quit => self.outputs.press(b'q'),
            Order::ControlC => self.outputs.press(3),
            Order::Signal(signal) => self.signal(signal),
            // Before the session is there to be found, and when it is on its way out, there is nothing to stop.
            Order::Stop => {
                let taken = self.bench.order("stop");
                if !taken && matches!(self.plan.phase, Phase::StartUp | Phase::ShutDown) {
                    return None;
                }
            }
        }
        Some(begun)
    }

    /// What hangs goes on.
    fn let_go_on(&mut self) {
        if let Some(process) = self.hanging.take() {
            // It may have been ended meanwhile.
            let _ = kill(process, Signal::SIGCONT);
        }
    }

    /// Whether the session got so far that there is something to report.
    fn has_begun(&self) -> bool {
        matches!(self.plan.phase, Phase::Moving | Phase::ShutDown)
            || self.outputs.text().contains("scheduling")
    }

    /// Ends the session, if the cause does not, and waits for its end; none if it does not come.
    fn end(&mut self, has_begun: bool) -> Option<ExitStatus> {
        let ends_by_itself = match self.plan.cause {
            Cause::Order(order) | Cause::Stalled(_, order) => !matches!(order, Order::Stop | Order::Space),
            Cause::ClosedOutput | Cause::ClosedOutputs | Cause::FullDevice | Cause::TerminalGone => true,
            Cause::Kill(Victim::Supervisor) => true,
            _ => self.plan.phase == Phase::ShutDown,
        };
        if !ends_by_itself && !self.has_ended() {
            self.signal(Signal::SIGTERM);
        }
        if let Cause::Stalled(..) = self.plan.cause {
            // What was measured is written though nobody reads; only then somebody does again.
            let begun = Instant::now();
            while has_begun && !self.report.exists() && begun.elapsed() < REPORT_LIMIT {
                std::thread::sleep(LOOK);
            }
            if has_begun && !self.report.exists() {
                return None;
            }
            self.outputs.resume();
        }
        let begun = Instant::now();
        while begun.elapsed() < END_LIMIT {
            if let Ok(Some(status)) = self.child.try_wait() {
                return Some(status);
            }
            std::thread::sleep(LOOK);
        }
        None
    }

    fn failures(
        &self,
        cause_at: Option<Instant>,
        status: Option<ExitStatus>,
        has_begun: bool,
    ) -> Vec<Failure> {
        let mut failures = Vec::new();
        let last = cause_at.and_then(|at| Some((at, self.watch.last_motion_after(at)?)));
        if let Some((at, last)) = last
            && last - at > STOP_LIMIT
            && self.plan.cause.must_stop(self.plan.phase)
        {
            failures.push(Failure::LateMotion((last - at).as_secs_f64() * 1e3));
        }
        if self.was_supervisor_killed() {
            return failures;
        }
        let report: Option<&Path> = has_begun.then_some(&self.report);
        failures.extend(ending_failures(status, &self.outputs.errors(), report));
        failures
    }

    /// Programs that do not end with their session.
    fn processes_that_stay(&self) -> Vec<String> {
        let begun = Instant::now();
        loop {
            let names: Vec<String> = self.bench.processes().into_iter().map(|(_, name)| name).collect();
            if names.is_empty() || begun.elapsed() > Duration::from_secs(3) {
                return names;
            }
            std::thread::sleep(10 * LOOK);
        }
    }

    fn was_supervisor_killed(&self) -> bool {
        self.plan.cause == Cause::Kill(Victim::Supervisor)
    }

    fn has_ended(&mut self) -> bool {
        !matches!(self.child.try_wait(), Ok(None))
    }

    fn signal(&self, signal: Signal) {
        // One that has ended needs none.
        let _ = kill(self.supervisor(), signal);
    }

    fn supervisor(&self) -> Pid {
        Pid::from_raw(self.child.id() as i32)
    }

    fn process_of(&self, victim: Victim) -> Option<Pid> {
        let Victim::Stage(stage) = victim else { return Some(self.supervisor()) };
        // The kernel keeps 15 characters of a program's name.
        let name: String = format!("tendon-{}", stage.name()).chars().take(15).collect();
        self.bench.processes().into_iter().find(|(_, program)| *program == name).map(|(process, _)| process)
    }
}
