//! A client of the arm that never makes its caller wait.
//!
//! ```text
//! caller                      control thread, poll(2)                       arm
//! stop() ─────────┐ ┌────────▶ at once, whatever is outstanding ──────────▶ 502
//! arm() ──────────┼─┤          identity, bring-up, velocities, errors:
//! follow(…) ──────┤ │            one request at a time
//! move_gripper(…) ┘ └ mailbox  gripper: one request at a time, beside these
//! status() ◀── what is known ◀── replies ◀─────────────────────────────────
//!                        ▲────── two report threads ◀────────────────────── 30003, 30001
//! ```
//!
//! An order replaces one of its kind that was not sent yet, so an old intention never goes out after a new one. A
//! reply whose transaction id is not that of an outstanding request is late, and skipped. A broken connection, an
//! error of the arm, a report of another mode or state, a refused velocity, or [`Client::stop`] takes the client out
//! of [`Phase::Ready`], and only [`Client::arm`] or [`Client::bring_up_unless_fault`] brings it back.
//!
//! Every velocity carries a duration, so that the arm comes to rest by itself when this program or the cable is
//! gone. That is no safety function: see the head of the crate.

mod bring_up;
mod control;
mod gripper;
mod reports;
mod status;

use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::eventfd::{EfdFlags, EventFd};

use self::bring_up::BringUpOrder;
use self::control::Control;
use self::reports::read_reports;
use self::status::Known;
pub use self::status::{Gripper, Halt, Phase, Status};
use crate::Mode;
use crate::report::Kind;

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
    /// Time for any other reply but those of enabling and of the gripper; then the connection counts as broken.
    /// Default 2 s.
    pub reply_timeout: Duration,
    /// Time for the reply to enabling. Default 5 s.
    pub enable_timeout: Duration,
    /// The speed at which the gripper moves, as the vendor counts it: 1 to 5000. Default 2000. `None`: there is no
    /// gripper, and nothing is ever asked of one.
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

/// A velocity to send, and when the command was received that it answers first, if it does.
#[derive(Clone, Copy, Debug)]
struct Asked {
    velocity: Velocity,
    command_at: Option<Instant>,
}

impl Asked {
    /// Takes the place of one that was not sent, and answers what that would have answered. Returns whether there
    /// was one.
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
    #[error("no thread or event for the arm's connection: close other programs")]
    System(#[from] std::io::Error),
}

/// The newest order of each kind.
#[derive(Debug, Default)]
struct Mailbox {
    stop: bool,
    bring_up: Option<BringUpOrder>,
    velocity: Option<Asked>,
    replaced: u64,
    gripper_pulses: Option<i32>,
}

/// Where both locks are held, that of the mailbox is taken first.
#[derive(Debug)]
struct Shared {
    mailbox: Mutex<Mailbox>,
    known: Mutex<Known>,
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

/// A connection to an arm, kept up by threads of its own. Dropped, it stops the arm and its gripper.
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
            known: Mutex::default(),
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

    /// Brings the arm up because a person ordered it: clears its error, which that person has thereby acknowledged,
    /// and goes on as [`Client::bring_up_unless_fault`].
    pub fn arm(&self, mode: Mode) {
        self.bring_up(BringUpOrder { mode, clears_error: true });
    }

    /// Brings the arm up for velocities of its flange ([`Mode::CartesianVelocity`]) or of its joints
    /// ([`Mode::JointVelocity`]), whatever mode and state another client left: stops it, switches the motors on, sets
    /// mode and state, and waits for a report that confirms them. An arm with an error stays as it is:
    /// [`Halt::Fault`].
    ///
    /// When this returns, [`Status::phase`] is [`Phase::BringingUp`] and [`Status::halt`] is `None`, or there is no
    /// connection to a supported arm and [`Status::halt`] says so. Within 10 s, mostly 0.5 s, [`Phase::Ready`] or
    /// [`Status::halt`] follows.
    pub fn bring_up_unless_fault(&self, mode: Mode) {
        self.bring_up(BringUpOrder { mode, clears_error: false });
    }

    fn bring_up(&self, order: BringUpOrder) {
        let mut mailbox = lock(&self.shared.mailbox);
        mailbox.velocity = None;
        let mut known = lock(&self.shared.known);
        match (known.status.phase, known.status.halt) {
            (_, Some(Halt::Unsupported(_))) => return,
            (Phase::Disconnected | Phase::Identifying, _) => {
                known.status.halt = Some(Halt::ConnectionBroke);
                return;
            }
            _ => known.begin_bring_up(),
        }
        mailbox.bring_up = Some(order);
        drop((known, mailbox));
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

    /// Stops the arm and a gripper that moves, ahead of everything else, and forgets what was not sent yet. When this
    /// returns, [`Status::phase`] is no longer [`Phase::Ready`]. The stop is sent again until the arm acknowledges
    /// it, over a new connection if need be.
    pub fn stop(&self) {
        let mut mailbox = lock(&self.shared.mailbox);
        let replaced = mailbox.replaced + u64::from(mailbox.velocity.is_some());
        *mailbox = Mailbox { stop: true, replaced, ..Mailbox::default() };
        lock(&self.shared.known).halt(Halt::Ordered);
        drop(mailbox);
        self.shared.wake();
    }

    /// Where the gripper is to go, pulses: about −10 (closed) to 850 (open). Ignored unless [`Phase::Ready`], and
    /// without a gripper ([`ClientSettings::gripper_speed`]).
    pub fn move_gripper(&self, pulses: i32) {
        lock(&self.shared.mailbox).gripper_pulses = Some(pulses);
        self.shared.wake();
    }

    /// What is known of the arm.
    pub fn status(&self) -> Status {
        lock(&self.shared.known).status
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
