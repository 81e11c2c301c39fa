//! What the client knows of the arm.

use std::time::{Duration, Instant};

use crate::identity::Identity;
use crate::report::{Report, Setup};
use crate::{ArmState, Fault, Mode, Source, Unsupported};

/// How far the client has got with the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// No connection; one is tried again and again.
    #[default]
    Disconnected,
    /// Connected; the arm is asked for its version and serial number.
    Identifying,
    /// The arm is known. It obeys no motion before [`super::Client::arm`], and never if it is
    /// [`Halt::Unsupported`].
    Connected,
    /// Motors are being switched on and the mode is being set.
    BringingUp,
    /// The arm follows velocities.
    Ready,
}

/// Why the arm is not ready any more, or could not become so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Halt {
    /// [`super::Client::stop`].
    #[error("stopped by order: arm again to go on")]
    Ordered,
    /// There is no connection, or it broke.
    #[error("no connection to the arm: check its cable, power and address, then arm again")]
    ConnectionBroke,
    /// The arm has an error.
    #[error("{0}")]
    Fault(Fault),
    /// Another client or the emergency stop changed the arm's state.
    #[error(
        "the arm is {0}, by another client or its emergency stop: release the stop, close the other client, then arm \
         again"
    )]
    NotReady(ArmState),
    /// Another client changed the arm's mode, to this number.
    #[error(
        "another client switched the arm to {name}: close that client, then arm again",
        name = name_of_mode(*.0)
    )]
    ModeChanged(u8),
    /// The arm refused a velocity.
    #[error(
        "the arm refused a velocity: close other clients of the arm, release its emergency stop, then arm again"
    )]
    VelocityRefused,
    /// The arm refused a step of bringing up.
    #[error("the arm refused {step}: release its emergency stop, then arm again", step = name_of_step(*.0))]
    Refused(u8),
    /// The arm took every step of bringing up, but no real-time report confirmed it.
    #[error(
        "the arm was brought up, but its real-time reports do not come: check robot.xarm.real_time_report_port and \
         firewalls, then arm again"
    )]
    NoReports,
    /// Bringing up took too long.
    #[error("the arm took too long to be brought up: check what else uses it, then arm again")]
    TooSlow,
    /// The arm is none that this crate can drive.
    #[error("{0}")]
    Unsupported(Unsupported),
}

/// The mode of this number in words.
fn name_of_mode(number: u8) -> &'static str {
    match Mode::from_number(number) {
        Some(Mode::Position) => "mode 0 (positions)",
        Some(Mode::Servo) => "mode 1 (servo)",
        Some(Mode::Teach) => "mode 2 (teaching by hand)",
        Some(Mode::JointVelocity) => "mode 4 (joint velocities)",
        Some(Mode::CartesianVelocity) => "mode 5 (velocities of the flange)",
        Some(Mode::JointOnline) => "mode 6 (online joint positions)",
        Some(Mode::CartesianOnline) => "mode 7 (online positions)",
        None => "a mode that Tendon does not know",
    }
}

/// What a register of bringing up does, in words.
fn name_of_step(register: u8) -> &'static str {
    use crate::command::register::{CLEAR_ERROR, CLEAR_WARNING, ENABLE, SET_MODE, SET_STATE};
    match register {
        CLEAR_ERROR => "to clear its error",
        CLEAR_WARNING => "to clear its warning",
        ENABLE => "to switch its motors on",
        SET_MODE => "to change its mode",
        SET_STATE => "to be set running",
        _ => "to say whether it has an error",
    }
}

/// What the gripper reported last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gripper {
    /// Where it is, pulses: about −10 (closed) to 850 (open).
    pub position_pulses: i32,
    /// Whether its fingers move.
    pub moves: bool,
    /// When it was asked.
    pub asked_at: Instant,
}

/// What is known of the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Status {
    /// How far the client has got with the arm.
    pub phase: Phase,
    /// Why it is not ready, once it was or should have been.
    pub halt: Option<Halt>,
    /// Who the arm is; also of one that is not supported.
    pub identity: Option<Identity>,
    /// What is set on its controller, from the newest normal report.
    pub setup: Option<Setup>,
    /// The error or warning that the arm reports.
    pub fault: Option<Fault>,
    /// The newest real-time report.
    pub report: Option<Report>,
    /// When it came.
    pub reported_at: Option<Instant>,
    /// When the newest reply came.
    pub answered_at: Option<Instant>,
    /// When the oldest unanswered request was sent; a reply answers all requests before it. Requests to the gripper do not
    /// count.
    pub unanswered_since: Option<Instant>,
    /// The gripper; `None` until it answered, or without one ([`super::ClientSettings::gripper_speed`]).
    pub gripper: Option<Gripper>,
    /// Velocities sent.
    pub velocities_sent: u64,
    /// Velocities that a newer one or a stop overtook before they were sent.
    pub velocities_replaced: u64,
    /// Velocities sent that answered a command ([`super::Client::follow_command`]).
    pub commands_answered: u64,
    /// From the receipt of the newest of these commands to the bytes given to the network.
    pub command_to_wire: Duration,
    /// Stops that the arm acknowledged.
    pub stops_acknowledged: u64,
    /// Replies that came too late or answered no request.
    pub late_replies: u64,
    /// Requests whose reply did not come in time.
    pub timeouts: u64,
    /// Bytes that were no reply.
    pub garbage_bytes: u64,
    /// Connections made.
    pub connections: u64,
}

impl Status {
    /// The error of the arm's controller, which stops it; a warning does not.
    pub fn error(&self) -> Option<Fault> {
        self.fault.filter(|fault| fault.source == Source::Controller)
    }

    /// How long the arm has been silent at `now`: the age of its newest real-time report or of the oldest unanswered
    /// request, whichever is greater. [`Duration::MAX`] before the first report.
    pub fn silence(&self, now: Instant) -> Duration {
        let since_report = self.reported_at.map_or(Duration::MAX, |at| now.saturating_duration_since(at));
        let without_reply =
            self.unanswered_since.map_or(Duration::ZERO, |since| now.saturating_duration_since(since));
        since_report.max(without_reply)
    }

    /// Whether the arm is ready or being brought up.
    fn is_up(&self) -> bool {
        matches!(self.phase, Phase::BringingUp | Phase::Ready)
    }
}

/// A normal report from before the bring-up may arrive this late. Until then, one that contradicts the mode counts only
/// after another has confirmed the mode.
const NORMAL_REPORT_DELAY: Duration = Duration::from_secs(1);

/// The mode that every report must show.
#[derive(Clone, Copy, Debug)]
struct Watched {
    mode: Mode,
    since: Instant,
    /// A normal report has confirmed the mode. A real-time report has anyway, else the arm would not be ready.
    is_confirmed: bool,
}

/// The status, and what the reports are held against.
#[derive(Debug, Default)]
pub(super) struct Known {
    pub(super) status: Status,
    watched: Option<Watched>,
    /// What a report contradicted; for the control thread to act upon.
    pub(super) noticed: Option<Halt>,
}

impl Known {
    /// An order to bring the arm up was given.
    pub(super) fn begin_bring_up(&mut self) {
        self.watched = None;
        self.noticed = None;
        self.status.phase = Phase::BringingUp;
        self.status.halt = None;
    }

    /// The arm follows velocities in this mode from now on.
    pub(super) fn become_ready(&mut self, mode: Mode) {
        self.status.phase = Phase::Ready;
        self.noticed = None;
        self.watched = Some(Watched { mode, since: Instant::now(), is_confirmed: false });
    }

    /// The arm does not follow any more. The first reason is kept.
    pub(super) fn halt(&mut self, halt: Halt) {
        let is_first = self.status.halt.is_none() && halt == Halt::Ordered;
        if self.status.is_up() {
            self.status.phase = Phase::Connected;
            self.status.halt = Some(halt);
        } else if is_first {
            self.status.halt = Some(halt);
        }
        self.watched = None;
        self.noticed = None;
    }

    /// An error of the arm explains why it stopped.
    pub(super) fn explain(&mut self, fault: Fault) {
        if let Some(
            Halt::NotReady(_)
            | Halt::ModeChanged(_)
            | Halt::VelocityRefused
            | Halt::Refused(_)
            | Halt::NoReports
            | Halt::TooSlow,
        ) = self.status.halt
        {
            self.status.halt = Some(Halt::Fault(fault));
        }
    }

    /// Takes over a report. Returns whether the control thread should look at it.
    pub(super) fn take_report(&mut self, report: &Report) -> bool {
        let is_normal = report.health.is_some();
        if !is_normal {
            self.status.report = Some(*report);
            self.status.reported_at = Some(Instant::now());
        }
        if report.setup.is_some() {
            self.status.setup = report.setup;
        }
        let deviation = self.deviation(report);
        let counts = match &mut self.watched {
            Some(watched) if is_normal => {
                watched.is_confirmed |= deviation.is_none();
                watched.is_confirmed || watched.since.elapsed() > NORMAL_REPORT_DELAY
            }
            _ => true,
        };
        // While the arm is brought up, a normal report from before the error was cleared says nothing.
        if counts && self.status.phase != Phase::BringingUp {
            self.take_fault(report);
        }
        if counts && self.watched.is_some() && self.noticed.is_none() {
            self.noticed = deviation;
        }
        self.noticed.is_some() || self.status.phase == Phase::BringingUp
    }

    /// How a report differs from that of an arm that follows velocities in the mode that was set.
    fn deviation(&self, report: &Report) -> Option<Halt> {
        let watched = self.watched?;
        let error = report.health.and_then(|health| Fault::new(Source::Controller, health.error));
        if let Some(fault) = error {
            return Some(Halt::Fault(fault));
        }
        // What stops the arm also changes its mode, and then the stop says more.
        if report.state == ArmState::Stopped {
            return Some(Halt::NotReady(report.state));
        }
        if report.mode != watched.mode as u8 {
            return Some(Halt::ModeChanged(report.mode));
        }
        (!report.state.is_ready()).then_some(Halt::NotReady(report.state))
    }

    fn take_fault(&mut self, report: &Report) {
        let Some(health) = report.health else { return };
        let error = Fault::new(Source::Controller, health.error);
        let fault = error.or_else(|| Fault::new(Source::Warning, health.warning));
        // That there is none is for a reply to tell: this report may be older than an error.
        if fault.is_some() {
            self.status.fault = fault;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Health;

    fn real_time(mode: u8, state: ArmState) -> Report {
        Report {
            state,
            mode,
            command_count: 0,
            joints_rad: [0.0; 7],
            pose: [0.0; 6],
            torques_nm: [0.0; 7],
            health: None,
            setup: None,
            forces: None,
        }
    }

    fn normal(mode: u8, state: ArmState, error: u8) -> Report {
        let health = Health { brakes_released: 0x7F, motors_on: 0x7F, error, warning: 0 };
        Report { health: Some(health), setup: Some(Setup::default()), ..real_time(mode, state) }
    }

    fn ready() -> Known {
        let mut known = Known::default();
        known.begin_bring_up();
        known.become_ready(Mode::CartesianVelocity);
        known
    }

    #[test]
    fn any_report_of_another_mode_or_state_is_noticed_and_stays_so() {
        for (report, halt) in [
            (real_time(0, ArmState::Ready), Halt::ModeChanged(0)),
            (real_time(0, ArmState::ConfigurationChanged), Halt::ModeChanged(0)),
            (real_time(5, ArmState::ConfigurationChanged), Halt::NotReady(ArmState::ConfigurationChanged)),
            (real_time(5, ArmState::Paused), Halt::NotReady(ArmState::Paused)),
            (real_time(0, ArmState::Stopped), Halt::NotReady(ArmState::Stopped)),
        ] {
            let mut known = ready();
            assert!(!known.take_report(&real_time(5, ArmState::Running)));
            assert!(known.take_report(&report));
            // One report in between is enough.
            known.take_report(&real_time(5, ArmState::Running));
            assert_eq!(known.noticed, Some(halt));
        }
    }

    #[test]
    fn a_normal_report_counts_once_one_has_confirmed_the_mode() {
        let mut known = ready();
        known.take_report(&normal(0, ArmState::Stopped, 31));
        assert_eq!((known.noticed, known.status.fault), (None, None), "it may be from before the bring-up");
        known.take_report(&normal(5, ArmState::Ready, 0));
        known.take_report(&normal(0, ArmState::Stopped, 31));
        let collision = Fault { source: Source::Controller, code: 31 };
        assert_eq!((known.noticed, known.status.fault), (Some(Halt::Fault(collision)), Some(collision)));
        assert_eq!(known.status.setup, Some(Setup::default()));
    }

    #[test]
    fn the_first_reason_is_kept_and_an_error_explains_it() {
        let collision = Fault { source: Source::Controller, code: 31 };
        let mut known = ready();
        known.halt(Halt::NotReady(ArmState::Stopped));
        known.halt(Halt::Ordered);
        known.explain(collision);
        assert_eq!(known.status.halt, Some(Halt::Fault(collision)));
        let mut known = ready();
        known.halt(Halt::Ordered);
        known.explain(collision);
        assert_eq!((known.status.phase, known.status.halt), (Phase::Connected, Some(Halt::Ordered)));
    }

    #[test]
    fn silence_is_the_longer_of_no_report_and_no_reply() {
        let now = Instant::now();
        let ago = |ms| now.checked_sub(Duration::from_millis(ms));
        let mut status = Status::default();
        assert_eq!(status.silence(now), Duration::MAX);
        status.reported_at = ago(20);
        assert_eq!(status.silence(now), Duration::from_millis(20));
        status.unanswered_since = ago(300);
        assert_eq!(status.silence(now), Duration::from_millis(300));
    }
}
