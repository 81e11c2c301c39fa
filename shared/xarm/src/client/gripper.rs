//! The gripper's own lane: its requests may take as long as they like without holding up the arm.
//!
//! ```text
//! stop, bring-up, velocities … ──▶ one request at a time ─────────┐
//! hold ▸ set up ▸ target ▸ read ──▶ one request at a time, beside ┴─▶ 502
//! ```
//!
//! The gripper has no stop command. A stop of a moving gripper therefore reads its position and makes that its target, so
//! that its motor holds it there; if the gripper does not answer within 100 ms, its motor is switched off. A gripper at
//! rest, perhaps around an object, is left alone: a new target would change its grip.
//!
//! Requests follow the vendor's `xarm-python-sdk` 1.18.4, `x3/gripper.py`.

use std::time::{Duration, Instant};

use super::Gripper;
use crate::GripperRequest;
use crate::command::register;
use crate::reply::{Reply, ReplyError};

/// Time for the reply with the position when the gripper must stop.
const HOLD_TIMEOUT: Duration = Duration::from_millis(100);
/// Time for any other reply; grippers may be slow.
const REPLY_TIMEOUT: Duration = Duration::from_secs(5);
/// Time between two reads while the gripper moves, and while it stands.
const MOVING_PERIOD: Duration = Duration::from_millis(100);
const STANDING_PERIOD: Duration = Duration::from_secs(1);
/// A slow gripper is busy with reads for at most a quarter of the time: a pause of three times its reply time.
const REST_PER_REPLY: u32 = 3;
/// The fingers may take this long to start moving.
const STARTING: Duration = Duration::from_millis(300);
/// Positions this close count as equal, pulses.
const SAME_PULSES: i32 = 2;

/// Steps to stop a moving gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Hold {
    /// Read its position.
    Ask,
    /// Make this its target, pulses.
    At(i32),
    /// It does not answer: switch its motor off.
    Off,
}

#[derive(Clone, Copy, Debug)]
struct Outstanding {
    transaction: u16,
    request: GripperRequest,
    sent: Instant,
    deadline: Instant,
}

/// What to send to the gripper, and what it reported.
#[derive(Debug)]
pub(super) struct GripperLane {
    speed: u16,
    hold: Option<Hold>,
    /// Next step of the set-up; [`GripperLane::SET_UP_STEPS`] when done.
    set_up_step: usize,
    target_pulses: Option<i32>,
    outstanding: Option<Outstanding>,
    /// When the last target was sent, until the gripper has been seen standing since.
    ordered_at: Option<Instant>,
    read_due: Instant,
    /// Whether the next read is of the position, not the status.
    position_is_next: bool,
    /// Firmware of the gripper before 3.4.3 has no status; then it moves if its position changes.
    has_status: bool,
    moves: bool,
    read: Option<Gripper>,
}

impl GripperLane {
    pub(super) fn new(speed: u16) -> GripperLane {
        GripperLane {
            speed,
            hold: None,
            set_up_step: GripperLane::SET_UP_STEPS,
            target_pulses: None,
            outstanding: None,
            ordered_at: None,
            read_due: Instant::now(),
            position_is_next: false,
            has_status: true,
            moves: false,
            read: None,
        }
    }

    const SET_UP_STEPS: usize = 3;

    /// Starts over on a new connection.
    pub(super) fn connected(&mut self) {
        self.outstanding = None;
        self.read_due = Instant::now();
        self.read = None;
    }

    /// Enables the gripper and sets its speed, ahead of later targets.
    pub(super) fn set_up(&mut self) {
        self.hold = None;
        self.target_pulses = None;
        self.outstanding = None;
        self.set_up_step = 0;
        self.read_due = Instant::now();
    }

    /// Sets the target, pulses.
    pub(super) fn move_to(&mut self, pulses: i32) {
        self.hold = None;
        self.target_pulses = Some(pulses);
    }

    /// Stops it if it may be moving, and drops what was not sent.
    pub(super) fn stop(&mut self) {
        self.target_pulses = None;
        self.set_up_step = GripperLane::SET_UP_STEPS;
        if (self.ordered_at.is_some() || self.moves) && self.hold.is_none() {
            self.hold = Some(Hold::Ask);
            self.outstanding = None;
        }
    }

    /// Whether a stop is under way.
    pub(super) fn is_stopping(&self) -> bool {
        self.hold.is_some()
    }

    /// Whether anything but a read waits to be sent.
    fn has_order(&self) -> bool {
        self.hold.is_some() || self.set_up_step < GripperLane::SET_UP_STEPS || self.target_pulses.is_some()
    }

    /// The request to send now; [`GripperLane::sent`] must follow.
    pub(super) fn next(&mut self, now: Instant, may_read: bool) -> Option<GripperRequest> {
        if let Some(outstanding) = self.outstanding {
            let is_read =
                matches!(outstanding.request, GripperRequest::GetPosition | GripperRequest::GetStatus);
            // A new target waits neither for a read nor for the reply to the last target.
            let is_overtaken = self.hold.is_none()
                && self.target_pulses.is_some()
                && self.set_up_step == GripperLane::SET_UP_STEPS
                && (is_read || matches!(outstanding.request, GripperRequest::MoveTo(_)));
            if !is_overtaken {
                return None;
            }
        }
        match self.hold {
            Some(Hold::Ask) => return Some(GripperRequest::GetPosition),
            Some(Hold::At(pulses)) => return Some(GripperRequest::MoveTo(pulses)),
            Some(Hold::Off) => return Some(GripperRequest::Enable(false)),
            None => {}
        }
        match self.set_up_step {
            0 => return Some(GripperRequest::Enable(true)),
            1 => return Some(GripperRequest::SetMode(0)),
            2 => return Some(GripperRequest::SetSpeed(self.speed)),
            _ => {}
        }
        if let Some(pulses) = self.target_pulses {
            return Some(GripperRequest::MoveTo(pulses));
        }
        let is_due = may_read && now >= self.read_due;
        is_due.then_some(if self.position_is_next || !self.has_status {
            GripperRequest::GetPosition
        } else {
            GripperRequest::GetStatus
        })
    }

    pub(super) fn sent(&mut self, request: GripperRequest, transaction: u16, now: Instant) {
        let timeout =
            if matches!(self.hold, Some(Hold::Ask | Hold::At(_))) { HOLD_TIMEOUT } else { REPLY_TIMEOUT };
        self.outstanding = Some(Outstanding { transaction, request, sent: now, deadline: now + timeout });
        if matches!(request, GripperRequest::MoveTo(_)) && self.hold.is_none() {
            self.target_pulses = None;
            self.ordered_at = Some(now);
            self.position_is_next = false;
            self.read_due = now;
        }
    }

    /// The newest report.
    pub(super) fn read(&self) -> Option<Gripper> {
        self.read
    }

    /// Takes a reply to the outstanding request. Returns whether it was one.
    pub(super) fn take_reply(&mut self, reply: &Reply<'_>) -> bool {
        let is_expected = |outstanding: &mut Outstanding| {
            outstanding.transaction == reply.transaction && reply.register == register::GRIPPER
        };
        let Some(Outstanding { request, sent, .. }) = self.outstanding.take_if(is_expected) else {
            return false;
        };
        let now = Instant::now();
        let pause = (now.saturating_duration_since(sent) * REST_PER_REPLY).max(self.period());
        match request {
            GripperRequest::GetStatus => {
                self.take_status(reply, sent);
                // Its position follows at once.
                self.position_is_next = true;
            }
            GripperRequest::GetPosition => {
                self.take_position(reply, sent);
                self.position_is_next = false;
                self.read_due = now + pause;
            }
            _ => self.take_confirmation(request, reply),
        }
        true
    }

    fn period(&self) -> Duration {
        if self.ordered_at.is_some() || self.moves { MOVING_PERIOD } else { STANDING_PERIOD }
    }

    fn take_status(&mut self, reply: &Reply<'_>, asked_at: Instant) {
        match reply.gripper_moves() {
            Ok(moves) => self.take_motion(moves, asked_at),
            Err(ReplyError::Gripper { .. }) => self.has_status = false,
            Err(error) => tracing::debug!("{error}"),
        }
    }

    /// Takes over whether it moves. Right after a new target it may not have started yet.
    fn take_motion(&mut self, moves: bool, asked_at: Instant) {
        self.moves = moves;
        let is_over = self.ordered_at.is_some_and(|ordered_at| asked_at >= ordered_at + STARTING);
        if !moves && is_over {
            self.ordered_at = None;
        }
    }

    fn take_position(&mut self, reply: &Reply<'_>, asked_at: Instant) {
        match reply.gripper_position_pulses() {
            Ok(position_pulses) => {
                if !self.has_status {
                    let moves = self.read.is_some_and(|before| {
                        before.position_pulses.abs_diff(position_pulses) > SAME_PULSES.unsigned_abs()
                    });
                    self.take_motion(moves, asked_at);
                }
                if self.hold == Some(Hold::Ask) {
                    self.hold = Some(Hold::At(position_pulses));
                }
                self.read = Some(Gripper { position_pulses, moves: self.moves, asked_at });
            }
            Err(error) => {
                if self.hold == Some(Hold::Ask) {
                    self.hold = Some(Hold::Off);
                }
                tracing::warn!("the gripper does not say where it is: {error}");
            }
        }
    }

    fn take_confirmation(&mut self, request: GripperRequest, reply: &Reply<'_>) {
        let outcome = reply.gripper_took_it();
        match self.hold {
            Some(Hold::At(_)) if outcome.is_err() => self.hold = Some(Hold::Off),
            Some(Hold::At(_) | Hold::Off) => self.hold = None,
            Some(Hold::Ask) => {}
            None if matches!(request, GripperRequest::MoveTo(_)) => {}
            None => self.set_up_step = (self.set_up_step + 1).min(GripperLane::SET_UP_STEPS),
        }
        if let Err(error) = outcome {
            tracing::warn!("the gripper did not take {request:?}: {error}");
        }
    }

    /// Gives up a request whose time is over. Returns whether there was one.
    pub(super) fn expire(&mut self, now: Instant) -> bool {
        let Some(outstanding) = self.outstanding.take_if(|one| now >= one.deadline) else { return false };
        if self.hold.is_some() {
            self.hold = Some(Hold::Off);
        }
        if self.hold.is_none() && self.set_up_step == GripperLane::SET_UP_STEPS {
            self.read_due = now + STANDING_PERIOD;
        }
        tracing::debug!("the gripper did not answer {:?}", outstanding.request);
        true
    }

    /// When something is to be sent or given up.
    pub(super) fn due(&self, now: Instant, may_read: bool) -> Option<Instant> {
        match self.outstanding {
            Some(outstanding) => Some(outstanding.deadline),
            None if self.has_order() => Some(now),
            None => may_read.then_some(self.read_due),
        }
    }
}
