//! The robot's policy: from commands, orders and the arm's reports to what the arm is told.
//!
//! ```text
//! connecting ─▶ departing ─▶ enabling joints ─▶ going to start ─▶ enabling flange ─▶ following
//!     │            │ no record, far …  │               │               │ ▲              │
//!     │            ▼                   ▼               ▼               ▼ │ tendon arm   ▼
//!     └────────▶ waiting ◀──────── any stop: order, error, guard, silence, end of a stage
//! ```

mod state;
mod watch;

use tendon_arm::{ArmSettings, Guard, JointVector, LimitViolation, Twist, XArm7};
use tendon_messages::{CommandHeader, Permission, StateHeader, StopReason, TWIST_LENGTH, Trace, TwistFrame};

use crate::answer::{ArmAnswer, Outdated, StopAnswer};
use crate::arm::{Arm, ArmReport, Drive, Link, Stop};
use crate::gripper::Gripper;
use crate::latch::Latch;
use crate::start::{Departure, Start};

pub use state::State;
use watch::ARM_SILENCE_NS;

/// How long the arm may take to connect, ns.
const CONNECT_TIMEOUT_NS: u64 = 10_000_000_000;
/// How long the arm may take to be brought up after an order, ns.
const BRING_UP_TIMEOUT_NS: u64 = 11_000_000_000;
/// An order to arm counts for so long after its sender saw the arm, ns: a person who looks, decides and presses takes less.
const SEEN_NS: u64 = 2_000_000_000;

/// What the controller needs to know.
#[derive(Clone, Debug)]
pub struct ControlSettings {
    /// Limits, start position and watchdog.
    pub arm: ArmSettings,
    /// Whether there is a gripper.
    pub has_gripper: bool,
    /// Greatest speed of a joint on the way to the start position, rad/s.
    pub start_speed_rad_per_s: f64,
    /// Whether the arm waits for an order to arm at the start, also where it would set out, or follow, by itself.
    pub waits_at_start: bool,
    /// Whether rest is known only once the activity detector is calibrated.
    pub needs_calibration: bool,
    /// Samples from one window to the next.
    pub increment_samples: u64,
    /// Windows in a row that must say rest before the arm moves.
    pub rest_windows: u32,
    /// A command whose newest sample is older than this, in ns, is not acted on, and a controller that stood still for
    /// longer does not go on where it was. `None` in a lossless replay, whose time is that of the samples.
    pub stale_ns: Option<u64>,
}

/// What became of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It was in time.
    Fresh,
    /// It was too old, and was not acted on.
    Stale,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Connecting,
    /// Connected; how the arm was left decides whether it sets out.
    Departing,
    EnablingJoints,
    /// The joints were told these velocities, rad/s.
    GoingToStart(JointVector),
    EnablingFlange,
    Following,
    Waiting,
}

/// Somebody who ordered to arm waits for what comes of it.
#[derive(Clone, Copy, Debug)]
struct Asked {
    deadline_ns: u64,
}

/// Decides when the arm moves.
pub struct Controller {
    arm: Box<dyn Arm>,
    settings: ControlSettings,
    kinematics: XArm7,
    latch: Latch,
    guard: Guard,
    /// What the guard found last, and whether [`Controller::take_violation`] has told it.
    violation: Option<LimitViolation>,
    is_violation_told: bool,
    gripper: Gripper,
    start: Start,
    phase: Phase,
    /// When the arm was stopped last, or a new reason for it became known; `None` before the first stop.
    stopped_ns: Option<u64>,
    /// Why the arm could not be reached.
    failure: Option<Stop>,
    /// Whether it has followed commands in this session.
    has_followed: bool,
    /// Whether the arm waits for nothing but a word that it may go to its start position.
    waits_to_go: bool,
    connecting_since_ns: Option<u64>,
    /// When the supervisor was last heard; `None` without one.
    supervisor_heard_ns: Option<u64>,
    /// When this was last called.
    woke_ns: Option<u64>,
    /// When the newest fresh command came; `None` before the first.
    fresh_command_ns: Option<u64>,
    /// Sequence number of the newest command, and the first sample of its window.
    newest_command: Option<(u64, u64)>,
    asked: Option<Asked>,
    answer: Option<ArmAnswer>,
    /// Of the last command acted on.
    header: StateHeader,
}

impl Controller {
    /// A controller of an arm that begins to connect at the time `now_ns`. It goes to its start position by itself if how
    /// it was left permits that ([`Controller::depart`]), or waits for [`Controller::order_arm`] from the beginning
    /// because of `stopped`.
    pub fn new(
        arm: Box<dyn Arm>,
        settings: ControlSettings,
        stopped: Option<StopReason>,
        now_ns: u64,
    ) -> Controller {
        let mut latch = Latch::new(settings.rest_windows, settings.needs_calibration);
        if let Some(reason) = stopped {
            latch.stop(Stop::because(reason));
        }
        Controller {
            arm,
            kinematics: XArm7::new(),
            latch,
            guard: Guard::new(&settings.arm),
            violation: None,
            is_violation_told: true,
            gripper: Gripper::new(&settings.arm),
            start: Start::new(&settings.arm, settings.start_speed_rad_per_s),
            phase: Phase::Connecting,
            stopped_ns: stopped.map(|_| now_ns),
            failure: None,
            has_followed: false,
            waits_to_go: false,
            connecting_since_ns: None,
            supervisor_heard_ns: None,
            woke_ns: None,
            fresh_command_ns: None,
            newest_command: None,
            asked: None,
            answer: None,
            header: StateHeader::default(),
            settings,
        }
    }

    /// What a user may want to know of the arm.
    pub fn description(&self) -> String {
        self.arm.description()
    }

    /// By what the arm is told apart from others; see [`Arm::key`].
    pub fn key(&self) -> &str {
        self.arm.key()
    }

    /// Whether the arm is where it waits for something that only the rest of the session can give: commands, or an
    /// order to arm.
    pub fn is_ready(&self) -> bool {
        matches!(self.phase, Phase::Following | Phase::Waiting)
    }

    /// Whether it is known which arm is there.
    pub fn is_connected(&self) -> bool {
        self.arm.report().link != Link::Connecting
    }

    /// Why the arm could not be reached at all, after which there is nothing to wait for.
    pub fn failure(&self) -> Option<Stop> {
        self.failure.filter(|_| self.phase == Phase::Connecting)
    }

    /// Whether the arm would set out for its start position now if it was left in good order: the time to read, and
    /// remove, the record of that, and to call [`Controller::depart`].
    pub fn wants_departure(&self, now_ns: u64) -> bool {
        self.phase == Phase::Departing
            && self.supervisor_heard_ns.is_some()
            && !self.is_supervisor_silent(now_ns)
    }

    /// Whether everything is as it should be: the arm follows commands, or would after a rest, and has no error.
    pub fn is_in_good_order(&self) -> bool {
        let report = self.arm.report();
        self.phase == Phase::Following
            && self.latch.permission() != Permission::Stopped
            && report.error_code.is_none()
            && report.stop.is_none()
    }

    /// Lets the arm come to rest after [`Controller::end`]. Returns its joint angles in rad; `None` if it is no longer in
    /// good order.
    pub fn at_the_end(&mut self, now_ns: u64) -> Option<JointVector> {
        self.arm.tick(now_ns);
        let report = self.arm.report();
        let is_well = report.error_code.is_none()
            && report.link != Link::Connecting
            && report.silent_ns < ARM_SILENCE_NS
            // Else another program has set it running again.
            && report.is_stopped
            && report.stop.is_none_or(|stop| stop.reason == StopReason::Ordered);
        report.joints_rad.filter(|_| is_well)
    }

    /// Whether nothing moves and nothing is told to.
    pub fn is_still(&self) -> bool {
        self.is_ready() && self.arm.is_still()
    }

    /// See [`Arm::command_to_wire_ns`].
    pub fn command_to_wire_ns(&mut self) -> Option<u64> {
        self.arm.command_to_wire_ns()
    }

    /// What came of an order to arm, once.
    pub fn take_answer(&mut self) -> Option<ArmAnswer> {
        self.answer.take()
    }

    /// The supervisor said that it is there.
    pub fn hear_supervisor(&mut self, now_ns: u64) {
        self.supervisor_heard_ns = Some(now_ns);
    }

    /// Somebody ordered the arm to stop.
    pub fn order_stop(&mut self, now_ns: u64) -> StopAnswer {
        self.stop(Stop::because(StopReason::Ordered), now_ns);
        let report = self.arm.report();
        match report.link {
            Link::Connecting => StopAnswer::NotConnected,
            _ if report.silent_ns > ARM_SILENCE_NS => StopAnswer::ArmSilent,
            _ => StopAnswer::Stopped,
        }
    }

    /// Another stage ended: its successor begins anew.
    pub fn stage_ended(&mut self, now_ns: u64) {
        self.newest_command = None;
        self.gripper.counts_anew();
        self.stop(Stop::because(StopReason::StageEnded), now_ns);
    }

    /// The session ends: stops the arm for good, unless it is not known yet whether this session may have it.
    pub fn end(&mut self) {
        if !matches!(self.phase, Phase::Connecting | Phase::Departing) {
            self.arm.stop();
        }
        self.gripper.stopped();
    }

    /// Why an order to arm counts for nothing now, if it does. Orders are late where a process or a line hangs: one whose
    /// sender saw the arm at `seen_ns` must not undo a stop that came after that. To be asked before
    /// [`Controller::order_arm`].
    pub fn is_outdated(&self, seen_ns: u64, now_ns: u64) -> Option<Outdated> {
        if self.stopped_ns.is_some_and(|stopped_ns| seen_ns < stopped_ns) {
            return Some(Outdated::StoppedSince);
        }
        // Nobody saw what is to come.
        let is_late = now_ns.checked_sub(seen_ns).is_none_or(|age_ns| age_ns > SEEN_NS);
        is_late.then_some(Outdated::TooLate)
    }

    /// Somebody ordered to permit motion again. [`Controller::take_answer`] tells what came of it, at once or once the
    /// arm is up.
    ///
    /// An arm that waits only because its start position is far away, or at the start of a session that follows on another,
    /// goes there; any other follows from where it is.
    pub fn order_arm(&mut self, now_ns: u64) {
        self.notice_stall(now_ns);
        let report = self.arm.report();
        let answer = match (self.phase, self.latch.permission()) {
            (Phase::Following, Permission::Granted) => ArmAnswer::AlreadyArmed,
            (Phase::Following, _) => ArmAnswer::AwaitsRest,
            // Somebody asked before: both are told what comes of it.
            _ if self.asked.is_some() => return,
            (Phase::EnablingJoints | Phase::GoingToStart(_), _) => ArmAnswer::GoingToStart,
            (Phase::EnablingFlange, _) => ArmAnswer::BringingUp,
            (Phase::Connecting, _) if report.link == Link::Connecting => {
                ArmAnswer::NotConnected(StopReason::NeverConnected)
            }
            _ if report.link == Link::Connecting => ArmAnswer::NotConnected(StopReason::ConnectionBroke),
            _ if self.is_supervisor_silent(now_ns) => ArmAnswer::SupervisorSilent,
            _ => {
                let unseen = report.error_code.map(Stop::by_fault);
                if let Some(fault) = unseen.filter(|fault| self.latch.reason() != Some(*fault)) {
                    // Nobody can have acknowledged an error before it was shown.
                    self.wait(fault, now_ns);
                    self.answer = Some(ArmAnswer::Failed(fault));
                    return;
                }
                let is_there = report.joints_rad.is_some_and(|joints_rad| self.start.is_at(&joints_rad));
                let goes_to_start = self.waits_to_go && !is_there;
                self.latch.stop(Stop::because(StopReason::Ordered));
                self.latch.forget_reason();
                self.asked = Some(Asked { deadline_ns: now_ns + BRING_UP_TIMEOUT_NS });
                let drive = if goes_to_start { Drive::Joints } else { Drive::Flange };
                self.bring_up(drive, true, now_ns);
                return;
            }
        };
        self.answer = Some(answer);
    }

    /// Lets the arm set out for its start position if how it was left permits it. Else it waits.
    pub fn depart(&mut self, departure: Departure, now_ns: u64) {
        let report = self.arm.report();
        if let (Phase::Departing, Some(joints_rad)) = (self.phase, report.joints_rad) {
            let limits = self.arm.joint_limits();
            let permitted = match report.error_code {
                Some(code) => Err(Stop::by_fault(code)),
                None => self.start.permit(departure, &joints_rad, &limits).map_err(Stop::because),
            };
            match permitted {
                Ok(()) if self.settings.waits_at_start => {
                    self.wait(Stop::because(StopReason::NextSession), now_ns);
                }
                Ok(()) if self.start.is_at(&joints_rad) => self.bring_up(Drive::Flange, false, now_ns),
                Ok(()) => self.bring_up(Drive::Joints, false, now_ns),
                Err(stop) => self.wait(stop, now_ns),
            }
        }
    }

    fn bring_up(&mut self, drive: Drive, acknowledges_error: bool, now_ns: u64) {
        self.guard.reset();
        self.arm.bring_up(drive, acknowledges_error, now_ns);
        self.phase = match drive {
            Drive::Joints => Phase::EnablingJoints,
            Drive::Flange => Phase::EnablingFlange,
        };
    }

    fn stop(&mut self, stop: Stop, now_ns: u64) {
        self.arm.stop();
        self.wait(stop, now_ns);
    }

    /// The arm stays where it is until it is armed.
    fn wait(&mut self, stop: Stop, now_ns: u64) {
        self.gripper.stopped();
        self.latch.stop(stop);
        self.stopped_ns = self.stopped_ns.max(Some(now_ns));
        let asks_to_go = matches!(stop.reason, StopReason::StartIsFar | StopReason::NextSession);
        self.waits_to_go = asks_to_go && !self.has_followed;
        if self.phase != Phase::Connecting {
            self.phase = Phase::Waiting;
        }
        if self.asked.take().is_some() {
            self.answer = Some(ArmAnswer::Failed(self.latch.reason().unwrap_or(stop)));
        }
    }

    /// The arm comes to rest, and moves again after a rest of the person.
    fn interrupt(&mut self, reason: StopReason) {
        if self.latch.permission() == Permission::Granted {
            self.arm.rest();
            self.halt_gripper();
        }
        self.latch.interrupt(reason);
    }

    /// A gripper on its way stays where it is. One that holds something goes on holding it.
    fn halt_gripper(&mut self) {
        let report = self.arm.report();
        if let Some(pulses) = report.gripper_pulses.filter(|_| report.is_gripper_moving) {
            self.arm.move_gripper(pulses, self.woke_ns.unwrap_or_default());
            self.gripper.stopped();
        }
    }

    /// Lets the arm move, and looks after it.
    pub fn tick(&mut self, now_ns: u64) {
        self.notice_stall(now_ns);
        self.arm.tick(now_ns);
        let report = self.arm.report();
        match self.phase {
            Phase::Connecting => self.connect(&report, now_ns),
            Phase::Departing => self.look_at_link(&report, now_ns),
            Phase::Waiting => {
                // An error that comes later may say why the arm stopped.
                if let Some(stop) = report.error_code.map(Stop::by_fault).or(report.stop) {
                    let before = self.latch.reason();
                    self.latch.stop(stop);
                    self.waits_to_go = false;
                    if self.latch.reason() != before {
                        self.stopped_ns = self.stopped_ns.max(Some(now_ns));
                    }
                }
            }
            Phase::EnablingJoints | Phase::GoingToStart(_) | Phase::EnablingFlange | Phase::Following => {
                self.look_at_link(&report, now_ns);
                self.watch(&report, now_ns);
                self.go_on(&report, now_ns);
            }
        }
        if self.asked.is_some_and(|asked| now_ns >= asked.deadline_ns) {
            self.asked = None;
            self.stop(Stop::because(StopReason::NotReady), now_ns);
            self.answer = Some(ArmAnswer::TooSlow);
        }
    }

    fn connect(&mut self, report: &ArmReport, now_ns: u64) {
        let since_ns = *self.connecting_since_ns.get_or_insert(now_ns);
        // That there is no connection yet is no reason to give up. That Tendon cannot drive this arm is one.
        if let Some(stop) = report.stop.filter(|stop| stop.reason == StopReason::UnsupportedArm) {
            return self.give_up(stop);
        }
        if let Some(joints_rad) = report.joints_rad.filter(|_| report.link != Link::Connecting) {
            let limits = self.arm.joint_limits();
            self.guard.set_joint_limits(limits);
            self.header.start_distance_mm = self.start.distance_mm(&joints_rad) as f32;
            self.phase = match report.link {
                _ if self.latch.permission() == Permission::Stopped => {
                    // The process before may have left a gripper on its way.
                    self.arm.stop();
                    Phase::Waiting
                }
                Link::Up(_) if self.settings.waits_at_start => {
                    self.wait(Stop::because(StopReason::NextSession), now_ns);
                    Phase::Waiting
                }
                Link::Up(_) => Phase::Following,
                _ => Phase::Departing,
            };
            self.has_followed |= self.phase == Phase::Following;
            return;
        }
        let is_live = self.settings.stale_ns.is_some();
        if is_live && now_ns.saturating_sub(since_ns) > CONNECT_TIMEOUT_NS {
            self.give_up(Stop::because(StopReason::NeverConnected));
        }
    }

    /// The arm cannot be reached or driven.
    fn give_up(&mut self, stop: Stop) {
        self.latch.stop(stop);
        self.failure = self.failure.or(Some(stop));
    }

    /// The next step of what the arm does by itself.
    fn go_on(&mut self, report: &ArmReport, now_ns: u64) {
        let Some(joints_rad) = report.joints_rad else { return };
        self.header.start_distance_mm = self.start.distance_mm(&joints_rad) as f32;
        match (self.phase, report.link) {
            (Phase::EnablingJoints, Link::Up(Drive::Joints)) => {
                self.phase = Phase::GoingToStart(JointVector::zeros());
                if self.asked.take().is_some() {
                    self.answer = Some(ArmAnswer::GoingToStart);
                }
            }
            (Phase::GoingToStart(_), _) if self.start.is_at(&joints_rad) => {
                self.arm.follow_joints(&JointVector::zeros());
                // An error that comes now is nobody's to clear.
                self.bring_up(Drive::Flange, false, now_ns);
            }
            (Phase::GoingToStart(told_rad_per_s), _) => {
                let velocities_rad_per_s = self.start.step(&joints_rad, told_rad_per_s.amax());
                self.arm.follow_joints(&velocities_rad_per_s);
                self.phase = Phase::GoingToStart(velocities_rad_per_s);
            }
            (Phase::EnablingFlange, Link::Up(Drive::Flange)) => {
                self.phase = Phase::Following;
                self.has_followed = true;
                self.latch.arm();
                if self.asked.take().is_some() {
                    self.answer = Some(ArmAnswer::Armed);
                }
            }
            _ => {}
        }
    }

    /// Takes a command that has come, with its twist in mm/s and rad/s. `now_ns` is the time of the samples in a
    /// lossless replay.
    pub fn take(&mut self, header: &CommandHeader, twist: &[f32; TWIST_LENGTH], now_ns: u64) -> Taken {
        let CommandHeader { trace, context, .. } = *header;
        if let Some((sequence, first_sample)) =
            self.newest_command.replace((trace.sequence, context.first_sample))
        {
            if trace.sequence <= sequence {
                // From a decision process that began anew, whoever started it.
                self.gripper.counts_anew();
                self.stop(Stop::because(StopReason::StageEnded), now_ns);
            }
            let is_next = trace.sequence == sequence.wrapping_add(1);
            if !(is_next && context.first_sample == first_sample + self.settings.increment_samples) {
                self.latch.break_row();
            }
        }
        if self.settings.stale_ns.is_some_and(|stale_ns| trace.is_stale(stale_ns, now_ns)) {
            self.latch.break_row();
            return Taken::Stale;
        }
        self.fresh_command_ns = Some(now_ns);
        self.tick(now_ns);
        let is_permitted = self.phase == Phase::Following && self.latch.admits(header);
        if is_permitted {
            self.follow(twist, TwistFrame::from_number(header.frame), now_ns);
        }
        let reported_pulses = self.arm.report().gripper_pulses;
        let pulses = self.gripper.take(header.gripper_toggles, is_permitted, reported_pulses);
        if let Some(pulses) = pulses.filter(|_| self.settings.has_gripper) {
            self.arm.move_gripper(pulses, now_ns);
        }
        self.header = StateHeader {
            trace: Trace { sequence: 0, ..trace },
            gesture: header.voted,
            confidence: header.confidence,
            mode: header.mode,
            is_unsure: header.is_unsure,
            calibration_left_ms: if self.settings.needs_calibration {
                context.calibration_left_ms
            } else {
                0
            },
            ..self.header
        };
        Taken::Fresh
    }

    fn follow(&mut self, twist: &[f32; TWIST_LENGTH], frame: TwistFrame, now_ns: u64) {
        let [x, y, z, about_x, about_y, about_z] = twist.map(f64::from);
        let mut twist = Twist { linear_mm_per_s: [x, y, z], angular_rad_per_s: [about_x, about_y, about_z] };
        if frame == TwistFrame::Tool {
            // Where the flange points is known of an arm that follows: it has reported.
            let joints_rad = self.arm.report().joints_rad;
            let rotation = joints_rad.map(|joints_rad| self.kinematics.flange_pose_m(&joints_rad).rotation);
            twist = rotation.map_or(Twist::ZERO, |rotation| twist.rotated(&rotation));
        }
        if self.arm.command(twist, now_ns).is_err() {
            // It is taken as rest; a decision process that sends such is not to be followed.
            self.stop(Stop::because(StopReason::NoCommands), now_ns);
        }
    }
}

#[cfg(test)]
mod tests;
