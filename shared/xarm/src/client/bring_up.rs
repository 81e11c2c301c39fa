//! How the arm is brought up, whatever another client left.
//!
//! ```text
//! by a person's order    clear error, clear warning ┐
//! by the program itself  an error? then no further ─┴▶ stop ▶ motors on ▶ mode ▶ run ▶ 150 ms ▶ an error? ▶ a report
//!                                                      └ forgets what another client queued        that confirms it
//! ```

use std::time::{Duration, Instant};

use super::status::{Halt, Status};
use crate::command::ALL_AXES;
use crate::{Command, Mode, StateOrder};

/// Motion right after a change of mode or state can be ignored: at least 100 ms, the vendor says.
const SETTLING: Duration = Duration::from_millis(150);
/// Real-time reports come every 10 ms; one must confirm mode and state within this time.
const CONFIRMATION: Duration = Duration::from_secs(1);
/// Bringing up takes a second; after so long it has failed.
const LONGEST: Duration = Duration::from_secs(10);

/// An order to bring the arm up.
#[derive(Clone, Copy, Debug)]
pub(super) struct BringUpOrder {
    pub(super) mode: Mode,
    /// Whether a person has acknowledged the arm's error, if it has one.
    pub(super) clears_error: bool,
}

/// Where bringing up stands.
#[derive(Debug)]
pub(super) struct BringUp {
    order: BringUpOrder,
    step: usize,
    not_before: Instant,
    /// When the arm was set running and had time to settle.
    settled_at: Option<Instant>,
    deadline: Instant,
}

impl BringUp {
    pub(super) fn new(order: BringUpOrder) -> BringUp {
        let now = Instant::now();
        BringUp { order, step: 0, not_before: now, settled_at: None, deadline: now + LONGEST }
    }

    pub(super) fn mode(&self) -> Mode {
        self.order.mode
    }

    fn steps(&self) -> [Option<Command>; 7] {
        let (first, second) = if self.order.clears_error {
            (Command::ClearError, Some(Command::ClearWarning))
        } else {
            (Command::GetErrors, None)
        };
        [
            Some(first),
            second,
            Some(Command::SetState(StateOrder::Stop)),
            Some(Command::Enable { axis: ALL_AXES, on: true }),
            Some(Command::SetMode(self.order.mode)),
            Some(Command::SetState(StateOrder::Run)),
            Some(Command::GetErrors),
        ]
    }

    /// The command of the present step; `None` after the last.
    fn command(&self) -> Option<Command> {
        self.steps().into_iter().flatten().nth(self.step)
    }

    /// The command to send now.
    pub(super) fn next(&self, now: Instant) -> Option<Command> {
        self.command().filter(|_| now >= self.not_before)
    }

    /// The arm took the present step.
    pub(super) fn advance(&mut self) {
        let taken = self.command();
        self.step += 1;
        if taken == Some(Command::SetState(StateOrder::Run)) {
            self.not_before = Instant::now() + SETTLING;
            self.settled_at = Some(self.not_before);
        }
    }

    /// When something is to be done without a reply.
    pub(super) fn due(&self) -> Instant {
        match (self.command(), self.settled_at) {
            (Some(_), _) => self.not_before,
            (None, Some(settled_at)) => settled_at + CONFIRMATION,
            (None, None) => self.deadline,
        }
    }

    /// Whether the arm is ready (`Some(Ok)`), will not become so (`Some(Err)`), or needs more time.
    pub(super) fn outcome(&self, status: &Status, now: Instant) -> Option<Result<(), Halt>> {
        if now >= self.deadline {
            return Some(Err(Halt::TooSlow));
        }
        let settled_at = self.settled_at.filter(|_| self.command().is_none())?;
        let is_fresh = status.reported_at.is_some_and(|at| at >= settled_at);
        let report = status.report.filter(|_| is_fresh);
        match report {
            Some(report) if report.mode == self.order.mode as u8 && report.state.is_ready() => Some(Ok(())),
            _ if now < settled_at + CONFIRMATION => None,
            None => Some(Err(Halt::NoReports)),
            Some(report) if report.state.is_ready() => Some(Err(Halt::ModeChanged(report.mode))),
            Some(report) => Some(Err(Halt::NotReady(report.state))),
        }
    }
}
