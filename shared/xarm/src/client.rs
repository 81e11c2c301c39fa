//! A client of the arm that never makes its caller wait.
//!
//! ```text
//! caller                      control thread, poll(2)                       arm
//! stop() ─────────┐ ┌────────▶ at once, whatever is outstanding ──────────▶ 502
//! arm() ──────────┼─┤          one request at a time; bring-up, motion,
//! follow(…) ──────┤ │          gripper, keep-alive, in this order
//! move_gripper(…) ┘ └ mailbox: the newest order of each kind
//! status() ◀── what is known ◀── replies ◀─────────────────────────────────
//!                        ▲────── two report threads ◀────────────────────── 30003, 30001
//! ```
//!
//! Orders overwrite those of their kind that were not yet sent: an old intention never goes out after a new
//! one. A reply with another transaction id than the outstanding one is late, and skipped. What breaks the
//! connection, an error of the arm, or [`Client::stop`] takes the client out of [`Phase::Ready`], and only
//! [`Client::arm`] brings it back.
//!
//! Every velocity carries a duration, so that the arm comes to rest by itself when this program or the cable is
//! gone. That is no safety function: see the head of the crate.

use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::eventfd::{EfdFlags, EventFd};

use crate::command::{ALL_AXES, register};
use crate::frame::{Decoder, FEEDBACK_REGISTER, Reply, fault, next_transaction};
use crate::report::{self, Kind, Report};
use crate::{ArmState, Command, Fault, GripperRequest, Mode, Source, StateOrder, TwistFrame};

/// Where the arm is and how long it may take.
#[derive(Clone, Debug)]
pub struct ClientSettings {
    /// The control port. Default 502.
    pub control: SocketAddr,
    /// The port of the normal reports. Default 30001.
    pub normal_report: SocketAddr,
    /// The port of the real-time reports. Default 30003.
    pub real_time_report: SocketAddr,
    /// After so long without a new velocity the arm comes to rest by itself. Default 200 ms.
    pub duration: Duration,
    /// Time for a connection. Default 1 s.
    pub connect_timeout: Duration,
    /// Time between two attempts to connect. Default 500 ms.
    pub reconnect_period: Duration,
    /// Time for the reply to a velocity or a stop; then the next goes out. Default 100 ms.
    pub motion_reply_timeout: Duration,
    /// Time for any other reply but that of enabling; then the connection counts as broken. Default 2 s.
    pub reply_timeout: Duration,
    /// Time for the reply to enabling. Default 5 s.
    pub enable_timeout: Duration,
    /// The gripper is enabled and set up while the arm is brought up. Default: 2000, `None`: there is none.
    pub gripper_speed: Option<u16>,
}

impl ClientSettings {
    /// The vendor's ports on this address.
    pub fn new(address: IpAddr) -> ClientSettings {
        ClientSettings {
            control: SocketAddr::new(address, 502),
            normal_report: SocketAddr::new(address, Kind::Normal.port()),
            real_time_report: SocketAddr::new(address, Kind::RealTime.port()),
            duration: Duration::from_millis(200),
            connect_timeout: Duration::from_secs(1),
            reconnect_period: Duration::from_millis(500),
            motion_reply_timeout: Duration::from_millis(100),
            reply_timeout: Duration::from_secs(2),
            enable_timeout: Duration::from_secs(5),
            gripper_speed: Some(2000),
        }
    }
}

/// How far the arm is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// No connection; one is tried again and again.
    #[default]
    Disconnected,
    /// Connected; the arm obeys no motion before [`Client::arm`].
    Connected,
    /// Errors are cleared, motors switched on, the mode is set.
    BringingUp,
    /// Motion is obeyed.
    Ready,
}

/// Why the arm is not ready any more, or could not become so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Halt {
    /// [`Client::stop`].
    #[error("stopped by order: arm again to go on")]
    Ordered,
    /// The connection broke.
    #[error("the connection to the arm broke: check its cable and power, then arm again")]
    ConnectionBroke,
    /// The arm has an error.
    #[error("{0}")]
    Fault(Fault),
    /// Somebody else changed the arm's mode or state.
    #[error("the arm is in state {0:?}, by another client or the emergency stop: arm again to go on")]
    NotReady(ArmState),
    /// A step of bringing up was refused.
    #[error(
        "the arm refused register {0:#04x} while it was brought up: release its emergency stop, then arm again"
    )]
    Refused(u8),
}

/// What is known of the arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Status {
    /// How far the arm is.
    pub phase: Phase,
    /// Why it is not ready, once it was or should have been.
    pub halt: Option<Halt>,
    /// The error or warning that the arm tells.
    pub fault: Option<Fault>,
    /// The newest real-time report.
    pub report: Option<Report>,
    /// When it came.
    pub reported_at: Option<Instant>,
    /// Where the gripper was when last asked, pulses.
    pub gripper_pulses: Option<i32>,
    /// Velocities sent.
    pub velocities_sent: u64,
    /// Velocities that a newer one or a stop overtook before they were sent.
    pub velocities_replaced: u64,
    /// Velocities sent that answered a command ([`Client::follow_command`]).
    pub commands_answered: u64,
    /// From the receipt of the newest of these commands to the bytes given to the network.
    pub command_to_wire: Duration,
    /// Stops that the arm acknowledged.
    pub stops_acknowledged: u64,
    /// Replies that came too late.
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
}

/// A velocity to follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Velocity {
    /// Of the flange in the base frame: mm/s along x, y, z, rad/s about x, y, z; in mode 5.
    Flange([f32; 6]),
    /// Of the joints in rad/s; in mode 4.
    Joints([f32; 7]),
}

impl Velocity {
    fn mode(self) -> Mode {
        match self {
            Velocity::Flange(_) => Mode::CartesianVelocity,
            Velocity::Joints(_) => Mode::JointVelocity,
        }
    }
}

/// A velocity that is to be sent, and when the command was received that it answers first, if it does.
#[derive(Clone, Copy, Debug)]
struct Asked {
    velocity: Velocity,
    command_at: Option<Instant>,
}

impl Asked {
    /// Takes the place of one that was not sent, and answers what that would have answered. Returns whether there was one.
    fn replace(self, place: &mut Option<Asked>) -> bool {
        let before = place.take();
        let command_at = before.and_then(|before| before.command_at).or(self.command_at);
        *place = Some(Asked { command_at, ..self });
        before.is_some()
    }
}

/// The arm cannot be talked to.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The operating system gave no thread or no event.
    #[error("no thread or event for the arm's connection ({0}): close other programs")]
    System(#[from] std::io::Error),
}

/// The newest order of each kind.
#[derive(Debug, Default)]
struct Mailbox {
    stop: bool,
    arm: Option<Mode>,
    velocity: Option<Asked>,
    replaced: u64,
    gripper_pulses: Option<i32>,
}

#[derive(Debug)]
struct Shared {
    mailbox: Mutex<Mailbox>,
    status: Mutex<Status>,
    wake: EventFd,
    ended: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Only whole values are written behind these locks.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    fn wake(&self) {
        // It fails only when 2^64 wakes wait, and then it is awake.
        let _ = self.wake.write(1);
    }
}

/// A connection to an arm, kept up by threads of its own. Dropped, it stops the arm.
#[derive(Debug)]
pub struct Client {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl Client {
    /// Begins to connect, and goes on trying for as long as it lives. Returns at once.
    ///
    /// # Errors
    /// [`ClientError::System`] if a thread or an event cannot be had.
    pub fn start(settings: ClientSettings) -> Result<Client, ClientError> {
        let wake = EventFd::from_flags(EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC)
            .map_err(std::io::Error::from)?;
        let shared = Arc::new(Shared {
            mailbox: Mutex::default(),
            status: Mutex::default(),
            wake,
            ended: AtomicBool::new(false),
        });
        let mut client = Client { shared, threads: Vec::new() };
        for (kind, address) in
            [(Kind::RealTime, settings.real_time_report), (Kind::Normal, settings.normal_report)]
        {
            let shared = Arc::clone(&client.shared);
            let settings = settings.clone();
            let thread = std::thread::Builder::new().name("xarm report".to_owned());
            client.threads.push(thread.spawn(move || read_reports(&shared, &settings, kind, address))?);
        }
        let control = Control::new(Arc::clone(&client.shared), settings);
        let thread = std::thread::Builder::new().name("xarm control".to_owned());
        client.threads.push(thread.spawn(move || control.run())?);
        Ok(client)
    }

    /// Brings the arm up for velocities of its flange ([`Mode::CartesianVelocity`]) or of its joints
    /// ([`Mode::JointVelocity`]): clears errors, switches the motors on, sets mode and state. Takes a second or
    /// so; [`Status::phase`] tells. Ignored without a connection: what comes back later must be armed anew.
    pub fn arm(&self, mode: Mode) {
        let mut mailbox = lock(&self.shared.mailbox);
        mailbox.arm = Some(mode);
        mailbox.velocity = None;
        drop(mailbox);
        self.shared.wake();
    }

    /// The velocity to follow from now on, for as long as [`ClientSettings::duration`]. Replaces one that was not
    /// sent yet. Ignored unless the arm is [`Phase::Ready`] in the mode of this velocity.
    pub fn follow(&self, velocity: Velocity) {
        self.ask(Asked { velocity, command_at: None });
    }

    /// As [`Client::follow`], with the first velocity that answers a command received at that time:
    /// [`Status::command_to_wire`] tells how long the answer took.
    pub fn follow_command(&self, velocity: Velocity, received_at: Instant) {
        self.ask(Asked { velocity, command_at: Some(received_at) });
    }

    fn ask(&self, asked: Asked) {
        let mut mailbox = lock(&self.shared.mailbox);
        mailbox.replaced += u64::from(asked.replace(&mut mailbox.velocity));
        drop(mailbox);
        self.shared.wake();
    }

    /// Stops the arm, ahead of everything else, and forgets what was not sent yet. It is sent again until the arm
    /// acknowledges it, over a new connection if need be.
    pub fn stop(&self) {
        let mut mailbox = lock(&self.shared.mailbox);
        let replaced = mailbox.replaced + u64::from(mailbox.velocity.is_some());
        *mailbox = Mailbox { stop: true, replaced, ..Mailbox::default() };
        drop(mailbox);
        self.shared.wake();
    }

    /// Where the gripper is to go, pulses: about −10 (closed) to 850 (open). Ignored unless [`Phase::Ready`].
    pub fn move_gripper(&self, pulses: i32) {
        lock(&self.shared.mailbox).gripper_pulses = Some(pulses);
        self.shared.wake();
    }

    /// What is known of the arm.
    pub fn status(&self) -> Status {
        *lock(&self.shared.status)
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::SeqCst);
        self.shared.wake();
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so already.
            let _ = thread.join();
        }
    }
}

/// What the outstanding request is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    BringUp,
    Velocity,
    Gripper,
    GripperPosition,
    Errors,
    KeepAlive,
}

#[derive(Clone, Copy, Debug)]
struct Outstanding {
    transaction: u16,
    register: u8,
    purpose: Purpose,
    deadline: Instant,
}

/// A stop that the arm has not acknowledged.
#[derive(Clone, Copy, Debug)]
struct Stop {
    /// `None`: not sent on this connection.
    sent: Option<(u16, Instant)>,
}

/// The steps of bringing up; the settling follows the last but one.
#[derive(Debug)]
struct BringUp {
    mode: Mode,
    step: usize,
    not_before: Instant,
}

impl BringUp {
    fn commands(mode: Mode, gripper_speed: Option<u16>) -> impl Iterator<Item = Command> {
        let before =
            [Command::ClearError, Command::ClearWarning, Command::Enable { axis: ALL_AXES, on: true }];
        let gripper = gripper_speed.map(|speed| {
            [
                Command::Gripper(GripperRequest::Enable(true)),
                Command::Gripper(GripperRequest::SetMode(0)),
                Command::Gripper(GripperRequest::SetSpeed(speed)),
            ]
        });
        let after = [Command::SetMode(mode), Command::SetState(StateOrder::Run), Command::GetErrors];
        before.into_iter().chain(gripper.into_iter().flatten()).chain(after)
    }
}

/// Motion right after a change of mode or state can be ignored: at least 100 ms, the vendor says.
const SETTLING: Duration = Duration::from_millis(150);
/// An idle connection may be dropped: something is asked this often.
const KEEP_ALIVE: Duration = Duration::from_secs(1);
/// How long after a command the gripper is asked where it is, and how often.
const GRIPPER_WATCH: Duration = Duration::from_secs(2);
const GRIPPER_PERIOD: Duration = Duration::from_millis(250);
/// So many velocities in a row without a reply, and the connection counts as broken.
const MOST_TIMEOUTS: u32 = 10;
/// A report connection without data for so long is made anew.
const REPORT_SILENCE: Duration = Duration::from_secs(1);

/// The thread of the control connection.
struct Control {
    shared: Arc<Shared>,
    settings: ClientSettings,
    stream: Option<TcpStream>,
    transaction: u16,
    request: Vec<u8>,
    outstanding: Option<Outstanding>,
    stop: Option<Stop>,
    bring_up: Option<BringUp>,
    /// The mode in which the arm is ready.
    ready: Option<Mode>,
    velocity: Option<Asked>,
    gripper_pulses: Option<i32>,
    gripper_watched_until: Option<Instant>,
    gripper_due: Instant,
    errors_wanted: bool,
    keep_alive_due: Instant,
    connect_due: Instant,
    timeouts_in_a_row: u32,
}

/// The connection is of no use any more.
struct Broken;

impl Control {
    fn new(shared: Arc<Shared>, settings: ClientSettings) -> Control {
        let now = Instant::now();
        Control {
            shared,
            settings,
            stream: None,
            transaction: 0,
            request: Vec::with_capacity(64),
            outstanding: None,
            stop: None,
            bring_up: None,
            ready: None,
            velocity: None,
            gripper_pulses: None,
            gripper_watched_until: None,
            gripper_due: now,
            errors_wanted: false,
            keep_alive_due: now,
            connect_due: now,
            timeouts_in_a_row: 0,
        }
    }

    fn run(mut self) {
        let mut decoder = Decoder::new();
        while !self.shared.ended.load(Ordering::SeqCst) {
            if self.stream.is_none() && Instant::now() >= self.connect_due {
                self.connect(&mut decoder);
            }
            self.take_orders();
            if self.turn(&mut decoder).is_err() {
                self.disconnect();
            }
            self.wait();
        }
        if self.stream.is_some() {
            // Nobody is left to hear whether it arrived; the duration of the velocity is what ends the motion then.
            let _ = self.send(Command::SetState(StateOrder::Stop));
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
                self.errors_wanted = true;
                self.keep_alive_due = Instant::now();
                self.timeouts_in_a_row = 0;
                let mut status = lock(&self.shared.status);
                status.phase = Phase::Connected;
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
        self.connect_due = Instant::now() + self.settings.reconnect_period;
        if let Some(stop) = &mut self.stop {
            stop.sent = None;
        }
        self.halt(Halt::ConnectionBroke);
        lock(&self.shared.status).phase = Phase::Disconnected;
    }

    /// Takes the arm out of what it was ready for; the first reason is kept.
    fn halt(&mut self, halt: Halt) {
        let was_up = self.ready.take().is_some() | self.bring_up.take().is_some();
        self.gripper_pulses = None;
        self.gripper_watched_until = None;
        let overtaken = self.velocity.take().is_some();
        let mut status = lock(&self.shared.status);
        status.velocities_replaced += u64::from(overtaken);
        if status.phase != Phase::Disconnected {
            status.phase = Phase::Connected;
        }
        if was_up || halt == Halt::Ordered {
            status.halt = Some(halt);
        }
    }

    fn take_orders(&mut self) {
        let mailbox = std::mem::take(&mut *lock(&self.shared.mailbox));
        if mailbox.replaced > 0 {
            lock(&self.shared.status).velocities_replaced += mailbox.replaced;
        }
        if mailbox.stop {
            self.halt(Halt::Ordered);
            self.stop = Some(Stop { sent: None });
        }
        if let Some(mode) = mailbox.arm.filter(|_| self.stream.is_some()) {
            self.ready = None;
            self.velocity = None;
            self.bring_up = Some(BringUp { mode, step: 0, not_before: Instant::now() });
            let mut status = lock(&self.shared.status);
            status.phase = Phase::BringingUp;
            status.halt = None;
        }
        let asked = mailbox.velocity.filter(|asked| self.ready == Some(asked.velocity.mode()));
        if asked.is_some_and(|asked| asked.replace(&mut self.velocity)) {
            lock(&self.shared.status).velocities_replaced += 1;
        }
        if self.ready.is_some() && mailbox.gripper_pulses.is_some() {
            self.gripper_pulses = mailbox.gripper_pulses;
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
        Ok(())
    }

    fn send_stop(&mut self) -> Result<(), Broken> {
        let Some(stop) = self.stop else { return Ok(()) };
        let now = Instant::now();
        let is_due = stop.sent.is_none_or(|(_, sent)| now >= sent + self.settings.motion_reply_timeout);
        if is_due {
            // Whatever was outstanding is of no interest any more; its reply will be a late one.
            self.outstanding = None;
            let transaction = self.send(Command::SetState(StateOrder::Stop))?;
            self.stop = Some(Stop { sent: Some((transaction, now)) });
        }
        Ok(())
    }

    fn send_next(&mut self) -> Result<(), Broken> {
        let now = Instant::now();
        let settings = &self.settings;
        let (command, purpose, timeout) = if self.stop.is_some() {
            // Nothing but the stop until it is acknowledged.
            return Ok(());
        } else if let Some(bring_up) = &self.bring_up {
            let mut commands = BringUp::commands(bring_up.mode, settings.gripper_speed);
            match commands.nth(bring_up.step) {
                Some(command) if now >= bring_up.not_before => {
                    let is_enabling = matches!(command, Command::Enable { .. });
                    let timeout = if is_enabling { settings.enable_timeout } else { settings.reply_timeout };
                    (command, Purpose::BringUp, timeout)
                }
                _ => return Ok(()),
            }
        } else if let Some(Asked { velocity, command_at }) = self.velocity.take() {
            let duration_s = Some(settings.duration.as_secs_f32());
            let timeout = settings.motion_reply_timeout;
            let command = match velocity {
                Velocity::Flange(twist) => {
                    Command::CartesianVelocity { twist, frame: TwistFrame::Base, duration_s }
                }
                Velocity::Joints(velocities_rad_per_s) => {
                    Command::JointVelocity { velocities_rad_per_s, synchronous: true, duration_s }
                }
            };
            self.request(command, Purpose::Velocity, timeout)?;
            let mut status = lock(&self.shared.status);
            status.velocities_sent += 1;
            if let Some(command_at) = command_at {
                status.commands_answered += 1;
                status.command_to_wire = command_at.elapsed();
            }
            return Ok(());
        } else if self.errors_wanted {
            self.errors_wanted = false;
            (Command::GetErrors, Purpose::Errors, settings.reply_timeout)
        } else if let Some(pulses) = self.gripper_pulses.take() {
            self.gripper_watched_until = Some(now + GRIPPER_WATCH);
            self.gripper_due = now + GRIPPER_PERIOD;
            (Command::Gripper(GripperRequest::MoveTo(pulses)), Purpose::Gripper, settings.reply_timeout)
        } else if self.gripper_watched_until.is_some() && now >= self.gripper_due {
            self.gripper_due = now + GRIPPER_PERIOD;
            self.gripper_watched_until = self.gripper_watched_until.filter(|&until| now < until);
            (Command::Gripper(GripperRequest::GetPosition), Purpose::GripperPosition, settings.reply_timeout)
        } else if now >= self.keep_alive_due {
            self.keep_alive_due = now + KEEP_ALIVE;
            (Command::GetErrors, Purpose::KeepAlive, settings.reply_timeout)
        } else {
            return Ok(());
        };
        self.request(command, purpose, timeout)
    }

    fn request(&mut self, command: Command, purpose: Purpose, timeout: Duration) -> Result<(), Broken> {
        let transaction = self.send(command)?;
        let deadline = Instant::now() + timeout;
        self.outstanding = Some(Outstanding { transaction, register: command.register(), purpose, deadline });
        Ok(())
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
                    Ok(reply) => self.take_reply(&reply),
                    Err(error) => tracing::debug!("{error}"),
                }
            }
            lock(&self.shared.status).garbage_bytes += decoder.skipped_bytes() - skipped;
        }
    }

    fn take_reply(&mut self, reply: &Reply<'_>) {
        if reply.register == FEEDBACK_REGISTER {
            return;
        }
        if let Some(Stop { sent: Some((transaction, _)) }) = self.stop
            && reply.transaction == transaction
            && reply.register == register::SET_STATE
        {
            self.stop = None;
            lock(&self.shared.status).stops_acknowledged += 1;
            return;
        }
        let is_expected = |outstanding: &Outstanding| {
            outstanding.transaction == reply.transaction && outstanding.register == reply.register
        };
        let Some(outstanding) = self.outstanding.filter(is_expected) else {
            lock(&self.shared.status).late_replies += 1;
            return;
        };
        self.outstanding = None;
        self.timeouts_in_a_row = 0;
        self.keep_alive_due = Instant::now() + KEEP_ALIVE;
        match outstanding.purpose {
            Purpose::BringUp => self.next_step(reply),
            Purpose::Velocity if reply.state.is_not_ready() && !reply.state.has_error() => {
                self.halt(Halt::NotReady(ArmState::Stopped));
            }
            Purpose::Velocity | Purpose::Gripper => {}
            Purpose::GripperPosition => match reply.gripper_position_pulses() {
                Ok(pulses) => lock(&self.shared.status).gripper_pulses = Some(pulses),
                Err(error) => tracing::warn!("{error}"),
            },
            Purpose::Errors | Purpose::KeepAlive => self.take_errors(reply),
        }
        if reply.state.has_error() && outstanding.register != register::GET_ERRORS && self.ready.is_some() {
            self.errors_wanted = true;
        }
    }

    /// The error and warning of the arm.
    fn take_errors(&mut self, reply: &Reply<'_>) {
        match fault(reply) {
            Ok(fault) => {
                lock(&self.shared.status).fault = fault;
                if let Some(fault) = fault.filter(|fault| fault.source == Source::Controller) {
                    self.halt(Halt::Fault(fault));
                }
            }
            Err(error) => tracing::warn!("{error}"),
        }
    }

    fn next_step(&mut self, reply: &Reply<'_>) {
        if reply.state.is_invalid() {
            self.halt(Halt::Refused(reply.register));
            self.errors_wanted = true;
            return;
        }
        if reply.register == register::GET_ERRORS {
            self.take_errors(reply);
        }
        let Some(bring_up) = &mut self.bring_up else { return };
        bring_up.step += 1;
        match reply.register {
            register::SET_STATE => bring_up.not_before = Instant::now() + SETTLING,
            register::GET_ERRORS if reply.state.is_not_ready() => {
                self.halt(Halt::NotReady(ArmState::Stopped));
            }
            register::GET_ERRORS => {
                self.ready = Some(bring_up.mode);
                self.bring_up = None;
                lock(&self.shared.status).phase = Phase::Ready;
            }
            _ => {}
        }
    }

    /// An arm that is ready and reports that it is not, or has an error, was stopped by somebody else.
    fn look_at_reports(&mut self) {
        if self.ready.is_none() {
            return;
        }
        let status = *lock(&self.shared.status);
        if let Some(fault) = status.error() {
            self.halt(Halt::Fault(fault));
        } else if let Some(report) = status.report.filter(|report| !report.state.is_ready()) {
            // Asked first: an error says more than the state that it leads to.
            if !self.errors_wanted && self.outstanding.is_none_or(|one| one.purpose != Purpose::Errors) {
                if self.velocity.take().is_some() {
                    lock(&self.shared.status).velocities_replaced += 1;
                }
                self.halt(Halt::NotReady(report.state));
                self.errors_wanted = true;
            }
        }
    }

    /// Gives up requests whose time is over.
    fn expire(&mut self, decoder: &mut Decoder) -> Result<(), Broken> {
        let Some(outstanding) = self.outstanding.filter(|one| Instant::now() >= one.deadline) else {
            return Ok(());
        };
        self.outstanding = None;
        decoder.give_up();
        self.timeouts_in_a_row += 1;
        lock(&self.shared.status).timeouts += 1;
        if outstanding.purpose == Purpose::Velocity && self.timeouts_in_a_row < MOST_TIMEOUTS {
            return Ok(());
        }
        Err(Broken)
    }

    /// Until an order or a reply comes, or something is due.
    fn wait(&mut self) {
        let now = Instant::now();
        let mut due = now + KEEP_ALIVE;
        if self.stream.is_none() {
            due = due.min(self.connect_due);
        } else if let Some(Stop { sent }) = self.stop {
            due = sent.map_or(now, |(_, sent)| sent + self.settings.motion_reply_timeout);
        } else if let Some(outstanding) = self.outstanding {
            due = due.min(outstanding.deadline);
        } else if let Some(bring_up) = &self.bring_up {
            due = due.min(bring_up.not_before);
        } else {
            due = due.min(self.keep_alive_due);
            if self.gripper_watched_until.is_some() {
                due = due.min(self.gripper_due);
            }
            if self.errors_wanted || self.velocity.is_some() || self.gripper_pulses.is_some() {
                due = now;
            }
        }
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
}

/// A thread of a report connection.
fn read_reports(shared: &Shared, settings: &ClientSettings, kind: Kind, address: SocketAddr) {
    let mut buffer = [0; 4096];
    while !shared.ended.load(Ordering::SeqCst) {
        let connected = TcpStream::connect_timeout(&address, settings.connect_timeout).and_then(|stream| {
            stream.set_read_timeout(Some(REPORT_SILENCE))?;
            Ok(stream)
        });
        if let Ok(mut stream) = connected {
            let mut decoder = report::Decoder::new(kind);
            while !shared.ended.load(Ordering::SeqCst) {
                let length = match stream.read(&mut buffer) {
                    Ok(0) => break,
                    Ok(length) => length,
                    Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                    Err(_) => break,
                };
                let mut input = &buffer[..length];
                while let Some(report) = decoder.next_report(&mut input) {
                    take_report(shared, report);
                }
            }
        }
        if !shared.ended.load(Ordering::SeqCst) {
            std::thread::sleep(settings.reconnect_period);
        }
    }
}

fn take_report(shared: &Shared, report: Report) {
    let mut status = lock(&shared.status);
    let was_ready = status.report.is_none_or(|report| report.state.is_ready());
    match report.health {
        Some(health) => {
            let error = Fault::new(Source::Controller, health.error);
            let fault = error.or_else(|| Fault::new(Source::Warning, health.warning));
            // That there is none is for a reply to tell: this report may be older than an error.
            if fault.is_none() || status.fault == fault {
                return;
            }
            // While the arm is brought up, a report from before the error was cleared says nothing.
            if status.phase == Phase::BringingUp {
                return;
            }
            status.fault = fault;
        }
        None => {
            status.report = Some(report);
            status.reported_at = Some(Instant::now());
            if was_ready == report.state.is_ready() {
                return;
            }
        }
    }
    drop(status);
    shared.wake();
}
