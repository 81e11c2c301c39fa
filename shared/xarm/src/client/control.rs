//! The thread of the control connection.

mod replies;

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use super::bring_up::BringUp;
use super::gripper::GripperLane;
use super::status::{Halt, Phase};
use super::{Asked, ClientSettings, Mailbox, Shared, Velocity, lock};
use crate::command::register;
use crate::frame::{Decoder, FEEDBACK_REGISTER, next_transaction};
use crate::identity::Text;
use crate::reply::Reply;
use crate::{Command, Mode, StateOrder, TwistFrame};

/// What the outstanding request is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    Identity,
    BringUp,
    Velocity,
    Errors,
}

#[derive(Clone, Copy, Debug)]
struct Outstanding {
    transaction: u16,
    register: u8,
    purpose: Purpose,
    deadline: Instant,
}

/// A stop that the arm has not acknowledged.
#[derive(Clone, Copy, Debug, Default)]
struct Stop {
    /// `None`: not sent on this connection.
    sent: Option<SentStop>,
}

/// The same stop may have been sent several times, and any acknowledgement will do.
#[derive(Clone, Copy, Debug)]
struct SentStop {
    first_transaction: u16,
    last_transaction: u16,
    first_sent: Instant,
    last_sent: Instant,
}

impl SentStop {
    fn is_acknowledged_by(&self, reply: &Reply<'_>) -> bool {
        let after_first = reply.transaction.wrapping_sub(self.first_transaction);
        reply.register == register::SET_STATE
            && after_first <= self.last_transaction.wrapping_sub(self.first_transaction)
    }
}

/// Who the arm of this connection is.
#[derive(Clone, Copy, Debug)]
enum Identification {
    Unknown,
    /// Its version was told.
    Version(Text),
    Supported,
    Refused,
}

/// An idle connection may be dropped: something is asked this often.
const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// So many velocities in a row without a reply, and the connection counts as broken.
const MOST_TIMEOUTS: u32 = 10;
/// How many requests without a reply are kept track of: more than a connection lasts.
const MOST_UNANSWERED: usize = 64;
/// At the end of the client, time for the stop of arm and gripper to be acknowledged.
const LAST_STOP: Duration = Duration::from_millis(200);

/// The connection is of no use any more.
struct Broken;

/// What the control thread works with.
pub(super) struct Control {
    shared: Arc<Shared>,
    settings: ClientSettings,
    stream: Option<TcpStream>,
    transaction: u16,
    request: Vec<u8>,
    identification: Identification,
    outstanding: Option<Outstanding>,
    /// Transaction ids of requests without a reply, and when they were sent; the oldest first.
    unanswered: VecDeque<(u16, Instant)>,
    stop: Option<Stop>,
    bring_up: Option<BringUp>,
    /// Whether it was ever brought up.
    has_brought_up: bool,
    /// The mode in which the arm is ready.
    ready: Option<Mode>,
    velocity: Option<Asked>,
    gripper: Option<GripperLane>,
    errors_wanted: bool,
    keep_alive_due: Instant,
    connect_due: Instant,
    timeouts_in_a_row: u32,
}

impl Control {
    pub(super) fn new(shared: Arc<Shared>, settings: ClientSettings) -> Control {
        let now = Instant::now();
        Control {
            shared,
            gripper: settings.gripper_speed.map(GripperLane::new),
            settings,
            stream: None,
            transaction: 0,
            request: Vec::with_capacity(64),
            identification: Identification::Unknown,
            outstanding: None,
            unanswered: VecDeque::with_capacity(MOST_UNANSWERED),
            stop: None,
            bring_up: None,
            has_brought_up: false,
            ready: None,
            velocity: None,
            errors_wanted: false,
            keep_alive_due: now,
            connect_due: now,
            timeouts_in_a_row: 0,
        }
    }

    pub(super) fn run(mut self) {
        let mut decoder = Decoder::new();
        while !self.shared.ended.load(Ordering::SeqCst) {
            if self.stream.is_none() && Instant::now() >= self.connect_due {
                self.connect(&mut decoder);
            }
            self.take_orders();
            if self.turn(&mut decoder).is_err() {
                self.disconnect();
            }
            self.wait(KEEP_ALIVE);
        }
        self.leave(&mut decoder);
    }

    /// Stops arm and gripper, unless they may be driven by somebody else: this client has never brought the arm up. If
    /// nobody answers, the duration of the velocity ends the motion.
    fn leave(&mut self, decoder: &mut Decoder) {
        self.take_orders();
        self.halt(Halt::Ordered);
        if self.has_brought_up {
            self.stop = Some(Stop::default());
        }
        let end = Instant::now() + LAST_STOP;
        let is_stopping = |control: &Control| {
            control.stop.is_some() || control.gripper.as_ref().is_some_and(GripperLane::is_stopping)
        };
        while self.stream.is_some() && is_stopping(self) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() || self.turn(decoder).is_err() {
                return;
            }
            self.wait(left);
        }
    }

    fn connect(&mut self, decoder: &mut Decoder) {
        let connected = TcpStream::connect_timeout(&self.settings.control, self.settings.connect_timeout)
            .and_then(|stream| {
                stream.set_nodelay(true)?;
                stream.set_nonblocking(true)?;
                Ok(stream)
            });
        match connected {
            Ok(stream) => {
                self.stream = Some(stream);
                decoder.give_up();
                self.identification = Identification::Unknown;
                self.errors_wanted = true;
                self.keep_alive_due = Instant::now();
                self.timeouts_in_a_row = 0;
                self.gripper.iter_mut().for_each(GripperLane::connected);
                let status = &mut lock(&self.shared.known).status;
                status.phase = Phase::Identifying;
                status.connections += 1;
            }
            Err(error) => {
                tracing::debug!("no connection to the arm at {}: {error}", self.settings.control);
                self.connect_due = Instant::now() + self.settings.reconnect_period;
            }
        }
    }

    fn disconnect(&mut self) {
        self.stream = None;
        self.outstanding = None;
        self.unanswered.clear();
        self.connect_due = Instant::now() + self.settings.reconnect_period;
        if let Some(stop) = &mut self.stop {
            stop.sent = None;
        }
        self.halt(Halt::ConnectionBroke);
        let status = &mut lock(&self.shared.known).status;
        status.phase = Phase::Disconnected;
        // Another arm may answer next time.
        status.identity = None;
        status.setup = None;
        status.gripper = None;
        status.unanswered_since = None;
        if matches!(status.halt, Some(Halt::Unsupported(_))) {
            status.halt = None;
        }
    }

    /// Takes the arm out of what it was ready for.
    fn halt(&mut self, halt: Halt) {
        self.forget_motion();
        let mailbox = lock(&self.shared.mailbox);
        // An order to bring it up that was not taken yet begins anew.
        if mailbox.bring_up.is_none() {
            lock(&self.shared.known).halt(halt);
        }
    }

    fn forget_motion(&mut self) {
        self.ready = None;
        self.bring_up = None;
        self.gripper.iter_mut().for_each(GripperLane::stop);
        if self.velocity.take().is_some() {
            lock(&self.shared.known).status.velocities_replaced += 1;
        }
    }

    fn take_orders(&mut self) {
        let Mailbox { stop, bring_up, velocity, replaced, gripper_pulses } =
            std::mem::take(&mut *lock(&self.shared.mailbox));
        if replaced > 0 {
            lock(&self.shared.known).status.velocities_replaced += replaced;
        }
        if stop || bring_up.is_some() {
            self.forget_motion();
        }
        if stop {
            self.stop = Some(Stop::default());
        }
        if let Some(order) = bring_up {
            if self.stream.is_some() && matches!(self.identification, Identification::Supported) {
                self.bring_up = Some(BringUp::new(order));
                self.has_brought_up = true;
                // The reply to what was asked before says nothing about what comes.
                self.outstanding = None;
                self.gripper.iter_mut().for_each(GripperLane::set_up);
                lock(&self.shared.known).begin_bring_up();
            } else {
                // The connection broke after the order was given.
                lock(&self.shared.known).halt(Halt::ConnectionBroke);
            }
        }
        let asked = velocity.filter(|asked| self.ready == Some(asked.velocity.mode()));
        if asked.is_some_and(|asked| asked.replace(&mut self.velocity)) {
            lock(&self.shared.known).status.velocities_replaced += 1;
        }
        if let (Some(gripper), Some(pulses), Some(_)) = (&mut self.gripper, gripper_pulses, self.ready) {
            gripper.move_to(pulses);
        }
    }

    /// Reads what came, then sends what is due.
    fn turn(&mut self, decoder: &mut Decoder) -> Result<(), Broken> {
        if self.stream.is_none() {
            return Ok(());
        }
        // A stop waits for nothing, not even for what came.
        self.send_stop()?;
        self.read(decoder)?;
        self.look_at_reports();
        self.expire(decoder)?;
        if self.outstanding.is_none() {
            self.send_next()?;
        }
        self.send_to_gripper()
    }

    fn send_stop(&mut self) -> Result<(), Broken> {
        let Some(stop) = self.stop else { return Ok(()) };
        let now = Instant::now();
        if stop.sent.is_some_and(|sent| now >= sent.first_sent + self.settings.reply_timeout) {
            // The next connection may carry it.
            return Err(Broken);
        }
        let is_due = stop.sent.is_none_or(|sent| now >= sent.last_sent + self.settings.motion_reply_timeout);
        if is_due {
            // Whatever was outstanding is of no interest any more; its reply will be a late one.
            self.outstanding = None;
            let transaction = self.send(Command::SetState(StateOrder::Stop))?;
            let sent = stop.sent.unwrap_or(SentStop {
                first_transaction: transaction,
                last_transaction: transaction,
                first_sent: now,
                last_sent: now,
            });
            self.stop =
                Some(Stop { sent: Some(SentStop { last_transaction: transaction, last_sent: now, ..sent }) });
            self.expect_reply(transaction, now);
        }
        Ok(())
    }

    fn send_next(&mut self) -> Result<(), Broken> {
        let now = Instant::now();
        let timeout = self.settings.reply_timeout;
        if self.stop.is_some() {
            // Nothing but the stop until it is acknowledged.
            return Ok(());
        }
        match self.identification {
            Identification::Unknown => return self.request(Command::GetVersion, Purpose::Identity, timeout),
            Identification::Version(_) => {
                return self.request(Command::GetSerialNumber, Purpose::Identity, timeout);
            }
            Identification::Supported | Identification::Refused => {}
        }
        if let Some(bring_up) = &self.bring_up {
            let Some(command) = bring_up.next(now) else { return Ok(()) };
            let is_enabling = matches!(command, Command::Enable { .. });
            let timeout = if is_enabling { self.settings.enable_timeout } else { timeout };
            return self.request(command, Purpose::BringUp, timeout);
        }
        if let Some(asked) = self.velocity.take() {
            return self.send_velocity(asked);
        }
        if self.errors_wanted || now >= self.keep_alive_due {
            self.errors_wanted = false;
            self.keep_alive_due = now + KEEP_ALIVE;
            return self.request(Command::GetErrors, Purpose::Errors, timeout);
        }
        Ok(())
    }

    fn send_velocity(&mut self, Asked { velocity, command_at }: Asked) -> Result<(), Broken> {
        let duration_s = Some(self.settings.duration.as_secs_f32());
        let command = match velocity {
            Velocity::Flange(twist) => {
                Command::CartesianVelocity { twist, frame: TwistFrame::Base, duration_s }
            }
            Velocity::Joints(velocities_rad_per_s) => {
                Command::JointVelocity { velocities_rad_per_s, synchronous: true, duration_s }
            }
        };
        self.request(command, Purpose::Velocity, self.settings.motion_reply_timeout)?;
        let status = &mut lock(&self.shared.known).status;
        status.velocities_sent += 1;
        if let Some(command_at) = command_at {
            status.commands_answered += 1;
            status.command_to_wire = command_at.elapsed();
        }
        Ok(())
    }

    /// Whether the gripper may be asked where it is.
    fn may_read_gripper(&self) -> bool {
        matches!(self.identification, Identification::Supported)
    }

    fn send_to_gripper(&mut self) -> Result<(), Broken> {
        let now = Instant::now();
        let may_read = self.may_read_gripper();
        let Some(gripper) = &mut self.gripper else { return Ok(()) };
        let Some(request) = gripper.next(now, may_read) else { return Ok(()) };
        let transaction = self.send(Command::Gripper(request))?;
        if let Some(gripper) = &mut self.gripper {
            gripper.sent(request, transaction, now);
        }
        Ok(())
    }

    fn request(&mut self, command: Command, purpose: Purpose, timeout: Duration) -> Result<(), Broken> {
        let transaction = self.send(command)?;
        let sent = Instant::now();
        let register = command.register();
        self.outstanding = Some(Outstanding { transaction, register, purpose, deadline: sent + timeout });
        self.expect_reply(transaction, sent);
        Ok(())
    }

    fn expect_reply(&mut self, transaction: u16, sent: Instant) {
        if self.unanswered.len() < MOST_UNANSWERED {
            self.unanswered.push_back((transaction, sent));
        }
        lock(&self.shared.known).status.unanswered_since.get_or_insert(sent);
    }

    /// Gives a request to the network. A network that does not take these few bytes at once counts as broken.
    fn send(&mut self, command: Command) -> Result<u16, Broken> {
        let stream = self.stream.as_mut().ok_or(Broken)?;
        self.transaction = next_transaction(self.transaction);
        self.request.clear();
        command.encode(self.transaction, &mut self.request);
        match stream.write(&self.request) {
            Ok(length) if length == self.request.len() => Ok(self.transaction),
            _ => Err(Broken),
        }
    }

    fn read(&mut self, decoder: &mut Decoder) -> Result<(), Broken> {
        let mut buffer = [0; 2048];
        loop {
            let Some(stream) = self.stream.as_mut() else { return Ok(()) };
            let length = match stream.read(&mut buffer) {
                Ok(0) => return Err(Broken),
                Ok(length) => length,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(_) => return Err(Broken),
            };
            let mut input = &buffer[..length];
            let skipped = decoder.skipped_bytes();
            while let Some(frame) = decoder.next_frame(&mut input) {
                match Reply::parse(&frame) {
                    Ok(reply) if reply.register == FEEDBACK_REGISTER => {}
                    Ok(reply) => self.take_reply(&reply),
                    Err(error) => tracing::debug!("{error}"),
                }
            }
            lock(&self.shared.known).status.garbage_bytes += decoder.skipped_bytes() - skipped;
        }
    }

    /// Acts upon what the reports say: that the arm is up, or that it is not ready any more.
    fn look_at_reports(&mut self) {
        if let Some(bring_up) = &self.bring_up {
            let status = lock(&self.shared.known).status;
            let mode = bring_up.mode();
            match bring_up.outcome(&status, Instant::now()) {
                Some(Ok(())) => self.become_ready(mode),
                Some(Err(halt)) => {
                    self.halt(halt);
                    self.errors_wanted = true;
                }
                None => {}
            }
        }
        let noticed = lock(&self.shared.known).noticed.take();
        if let Some(halt) = noticed.filter(|_| self.ready.is_some()) {
            self.halt(halt);
            // An error says more than the state that it leads to.
            self.errors_wanted = true;
        }
    }

    fn become_ready(&mut self, mode: Mode) {
        let mailbox = lock(&self.shared.mailbox);
        // An order that was not taken yet comes first.
        if !mailbox.stop && mailbox.bring_up.is_none() {
            lock(&self.shared.known).become_ready(mode);
            self.ready = Some(mode);
            self.bring_up = None;
        }
    }

    /// Gives up requests whose time is over.
    fn expire(&mut self, decoder: &mut Decoder) -> Result<(), Broken> {
        let now = Instant::now();
        if self.gripper.as_mut().is_some_and(|gripper| gripper.expire(now)) {
            lock(&self.shared.known).status.timeouts += 1;
        }
        let Some(outstanding) = self.outstanding.take_if(|one| now >= one.deadline) else { return Ok(()) };
        decoder.give_up();
        self.timeouts_in_a_row += 1;
        lock(&self.shared.known).status.timeouts += 1;
        if outstanding.purpose == Purpose::Velocity && self.timeouts_in_a_row < MOST_TIMEOUTS {
            return Ok(());
        }
        Err(Broken)
    }

    /// Until an order or a reply comes, something is due, or `at_most` has passed.
    fn wait(&mut self, at_most: Duration) {
        let now = Instant::now();
        let due = self.due(now).min(now + at_most);
        // Rounded up, so that what is due is due afterwards.
        let left_ms = due.saturating_duration_since(now).as_micros().div_ceil(1000);
        let timeout = PollTimeout::try_from(left_ms as i32).unwrap_or(PollTimeout::MAX);
        let wake = PollFd::new(self.shared.wake.as_fd(), PollFlags::POLLIN);
        let polled = match &self.stream {
            Some(stream) => poll(&mut [wake, PollFd::new(stream.as_fd(), PollFlags::POLLIN)], timeout),
            None => poll(&mut [wake], timeout),
        };
        // Interrupted or not, what is there is looked at next; nothing to read is no failure.
        let _ = (polled, self.shared.wake.read());
    }

    /// When something is to be done though nothing comes.
    fn due(&self, now: Instant) -> Instant {
        if self.stream.is_none() {
            return self.connect_due;
        }
        let arm = if let Some(Stop { sent }) = self.stop {
            sent.map_or(now, |sent| sent.last_sent + self.settings.motion_reply_timeout)
        } else if let Some(outstanding) = self.outstanding {
            outstanding.deadline
        } else if let Some(bring_up) = &self.bring_up {
            bring_up.due()
        } else if self.errors_wanted || self.velocity.is_some() {
            now
        } else {
            self.keep_alive_due
        };
        let may_read = self.may_read_gripper();
        let gripper = self.gripper.as_ref().and_then(|gripper| gripper.due(now, may_read));
        gripper.map_or(arm, |gripper| gripper.min(arm))
    }
}
