//! Orders to a running stage: from the supervisor by its standard input, and to the robot from its user and root by a
//! socket, so that a stop needs neither the supervisor nor shared memory.
//!
//! ```text
//! tendon run ──"alive", "stop", …────────▶ standard input ─┐
//!                                                           ├─▶ Control::wait ─▶ ahead of every message
//! tendon stop ──────"stop"──▶ socket of the session ────────┘
//!      ◀──── what came of it ────┘
//! ```

use std::io::IoSliceMut;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, UnixAddr, UnixCredentials, recvmsg, sendto, setsockopt, sockopt,
};
use tendon_gesture::Gesture;
use tendon_paths::claimed_names;
use tendon_transport::{FindError, SessionName, find_owner, own_user};

use crate::error::ProcessError;

/// What a stage is told to do, one line of text each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Let the source begin.
    Start,
    /// The person at the keyboard, or the simulated one, makes a gesture.
    Gesture {
        /// Which.
        gesture: Gesture,
        /// Its share of the amplitude of a full contraction, from 0 to 1. The line need not say it: 1 then.
        effort: f32,
    },
    /// Take the mode at this place, from 0.
    Mode(u8),
    /// The supervisor is there. The robot rests when this stops coming.
    Alive,
    /// Stop the arm, until [`Order::Arm`].
    Stop,
    /// Permit motion again, once the person has been at rest.
    Arm {
        /// When the arm was as the sender of the order saw it, CLOCK_MONOTONIC ns: the order must not undo a stop that came
        /// later.
        seen_ns: u64,
    },
    /// Another stage ended: stop the arm, until [`Order::Arm`].
    StageEnded,
}

impl Order {
    /// The line for this order, without the line feed.
    pub fn line(self) -> String {
        match self {
            Order::Start => "start".to_owned(),
            Order::Gesture { gesture, effort } => format!("gesture {gesture} {effort}"),
            Order::Mode(place) => format!("mode {place}"),
            Order::Alive => "alive".to_owned(),
            Order::Stop => "stop".to_owned(),
            Order::Arm { seen_ns } => format!("arm {seen_ns}"),
            Order::StageEnded => "stage-ended".to_owned(),
        }
    }

    pub(crate) fn stops_the_arm(self) -> bool {
        matches!(self, Order::Stop | Order::StageEnded)
    }

    pub(crate) fn parse(line: &str) -> Option<Order> {
        match line.trim() {
            "start" => Some(Order::Start),
            "alive" => Some(Order::Alive),
            "stop" => Some(Order::Stop),
            "stage-ended" => Some(Order::StageEnded),
            line => parse_gesture(line).or_else(|| parse_mode(line)).or_else(|| parse_arm(line)),
        }
    }
}

/// Reads `mode PLACE`.
fn parse_mode(line: &str) -> Option<Order> {
    line.strip_prefix("mode ").and_then(|place| place.trim().parse().ok()).map(Order::Mode)
}

/// Reads `arm SEEN_NS`.
fn parse_arm(line: &str) -> Option<Order> {
    let seen_ns = line.strip_prefix("arm ").and_then(|seen_ns| seen_ns.trim().parse().ok())?;
    Some(Order::Arm { seen_ns })
}

/// Reads `gesture NAME` and `gesture NAME EFFORT`.
fn parse_gesture(line: &str) -> Option<Order> {
    let mut words = line.split_whitespace();
    let (Some("gesture"), Some(name), effort, None) =
        (words.next(), words.next(), words.next(), words.next())
    else {
        return None;
    };
    let effort = effort.map_or(Some(1.0), |effort| effort.parse().ok())?;
    let gesture = name.parse().ok()?;
    (0.0..=1.0).contains(&effort).then_some(Order::Gesture { gesture, effort })
}

/// Longest line of an order, and longest answer; what is longer is none of ours.
pub(crate) const MAXIMUM_LINE_LENGTH: usize = 256;

/// How long the robot may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);
/// The same for [`Order::Arm`], which is answered once the arm is up or has failed to come up.
const ARM_ANSWER_TIMEOUT: Duration = Duration::from_secs(13);

/// Why an order did not arrive.
#[derive(Debug, thiserror::Error)]
pub enum OrderError {
    /// There is no such session, or it cannot be reached.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The robot process is there but does not answer.
    #[error(
        "the robot of session `{0}` does not answer: use the arm's emergency stop button. A robot process that \
         hangs sends nothing, and the arm comes to rest by itself"
    )]
    NoAnswer(SessionName),
    /// The socket could not be used.
    #[error("cannot use the socket for orders to session `{session}`")]
    Socket {
        /// Session name.
        session: SessionName,
        /// The system's word.
        source: std::io::Error,
    },
}

/// What the robot's socket is called in the kernel, for a session that `user` runs. It is no file, so that nobody can
/// remove it while the arm moves.
fn listening_name(user: u32, session: &SessionName) -> String {
    format!("tendon.{user}.{session}.orders")
}

/// A datagram socket that learns from the kernel who sent what it receives.
#[derive(Debug)]
pub(crate) struct Socket {
    pub(crate) socket: UnixDatagram,
    /// Room for the sender's credentials and nothing else, so that nobody can hand us descriptors.
    control: Vec<u8>,
}

/// One datagram: its sender's user and address, and how long it is.
pub(crate) struct Datagram {
    pub(crate) user: u32,
    pub(crate) sender: Option<UnixAddr>,
    pub(crate) length: usize,
}

impl Datagram {
    /// Whether it is from this user or root: nobody else is heard.
    pub(crate) fn is_from_this_user_or_root(&self) -> bool {
        self.user == own_user() || self.user == 0
    }
}

impl Socket {
    /// One at a name of the kernel. It is no file, so nobody can remove it.
    pub(crate) fn at(name: &str) -> std::io::Result<Socket> {
        Socket::new(UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(name)?)?)
    }

    fn new(socket: UnixDatagram) -> std::io::Result<Socket> {
        setsockopt(&socket, sockopt::PassCred, &true)?;
        Ok(Socket { socket, control: nix::cmsg_space!(UnixCredentials) })
    }

    pub(crate) fn receive(&mut self, bytes: &mut [u8]) -> nix::Result<Datagram> {
        let mut room = [IoSliceMut::new(bytes)];
        let flags = MsgFlags::MSG_CMSG_CLOEXEC;
        let message =
            recvmsg::<UnixAddr>(self.socket.as_raw_fd(), &mut room, Some(&mut self.control), flags)?;
        let user = message.cmsgs()?.find_map(|message| match message {
            ControlMessageOwned::ScmCredentials(credentials) => Some(credentials.uid()),
            _ => None,
        });
        // The kernel gives the credentials of every datagram to a socket that asks for them.
        let user = user.ok_or(Errno::EPERM)?;
        Ok(Datagram { user, sender: message.address, length: message.bytes })
    }

    pub(crate) fn send(&self, text: &str, to: &UnixAddr) -> nix::Result<usize> {
        send(&self.socket, text, to)
    }
}

/// Sends a datagram, or fails if it would have to wait.
pub(crate) fn send(socket: &UnixDatagram, text: &str, to: &UnixAddr) -> nix::Result<usize> {
    sendto(socket.as_raw_fd(), text.as_bytes(), to, MsgFlags::MSG_DONTWAIT)
}

/// What somebody at a socket of the kernel answers to `text`. `user` is whose answer counts: whoever else listens at that name
/// is not heard. It waits `timeout` for at most `longest_answer` bytes.
pub(crate) fn ask(
    name: &str,
    user: u32,
    text: &str,
    timeout: Duration,
    longest_answer: usize,
) -> Result<String, AskError> {
    let to = UnixAddr::new_abstract(name.as_bytes())?;
    let socket = UnixDatagram::unbound()?;
    socket.set_read_timeout(Some(timeout))?;
    let mut own = Socket::new(socket)?;
    match own.send(text, &to) {
        Ok(_) => {}
        // The second when its process is about to end.
        Err(Errno::ECONNREFUSED | Errno::EPIPE) => return Err(AskError::Nobody),
        // Its queue is full of what it does not take.
        Err(Errno::EAGAIN) => return Err(AskError::NoAnswer),
        Err(error) => return Err(error.into()),
    }
    let asked = Instant::now();
    let mut answer = vec![0; longest_answer];
    while asked.elapsed() < timeout {
        match own.receive(&mut answer) {
            Ok(datagram) if datagram.user == user => {
                return Ok(String::from_utf8_lossy(&answer[..datagram.length]).into_owned());
            }
            Ok(_) | Err(Errno::EPERM | Errno::EINTR) => {}
            Err(_) => break,
        }
    }
    Err(AskError::NoAnswer)
}

/// Why there is no answer.
#[derive(Debug)]
pub(crate) enum AskError {
    /// Nobody listens.
    Nobody,
    /// Somebody listens but does not answer in time.
    NoAnswer,
    /// The socket could not be used.
    Socket(std::io::Error),
}

impl From<std::io::Error> for AskError {
    fn from(error: std::io::Error) -> AskError {
        AskError::Socket(error)
    }
}

impl From<Errno> for AskError {
    fn from(error: Errno) -> AskError {
        AskError::Socket(error.into())
    }
}

/// Somebody who waits for an answer.
#[derive(Debug)]
pub struct Asker(pub(crate) UnixAddr);

/// The robot's end.
#[derive(Debug)]
pub(crate) struct OrderSocket {
    socket: Socket,
    /// Who waits for the answer to the newest order.
    asker: Option<UnixAddr>,
}

impl OrderSocket {
    pub(crate) fn open(session: &SessionName) -> Result<OrderSocket, ProcessError> {
        let name = listening_name(own_user(), session);
        let failed = |source| ProcessError::OrderSocket { name: name.clone(), source };
        let socket = Socket::at(&name).map_err(failed)?;
        socket.socket.set_nonblocking(true).map_err(failed)?;
        Ok(OrderSocket { socket, asker: None })
    }

    /// The next order that has come from this user or root; everything else is passed over.
    pub(crate) fn receive(&mut self) -> Option<Order> {
        let mut bytes = [0; MAXIMUM_LINE_LENGTH];
        loop {
            match self.socket.receive(&mut bytes) {
                Ok(datagram) if datagram.is_from_this_user_or_root() => {
                    let text = std::str::from_utf8(&bytes[..datagram.length]);
                    let order = text.ok().and_then(Order::parse);
                    if order.is_some() {
                        self.asker = datagram.sender;
                        return order;
                    }
                }
                // From somebody else, or without a sender.
                Ok(_) | Err(Errno::EPERM | Errno::EINTR | Errno::ENOBUFS) => {}
                // That nothing more is there is the only other error that a bound socket gives.
                Err(_) => return None,
            }
        }
    }

    /// Takes no more datagrams; those that have come can still be received.
    pub(crate) fn close(&self) {
        // A socket that is bound, as this one, can be shut down.
        let _ = self.socket.socket.shutdown(std::net::Shutdown::Read);
    }

    /// Who gave the newest order, and waits for an answer.
    pub(crate) fn take_asker(&mut self) -> Option<Asker> {
        self.asker.take().map(Asker)
    }

    /// Tells somebody what came of an order.
    pub(crate) fn answer(&mut self, asker: &Asker, text: &str) {
        // One that is gone, or does not read, needs no answer.
        let _ = self.socket.send(text, &asker.0);
    }
}

impl AsFd for OrderSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.socket.as_fd()
    }
}

/// Whose session of this name an order goes to, of those whose robot process listens.
fn addressee(session: &SessionName, wanted: Option<u32>) -> Result<u32, FindError> {
    let ending = format!(".{session}.orders");
    let listening: Vec<u32> = claimed_names("tendon.")
        .iter()
        .filter_map(|name| name.strip_prefix("tendon.")?.strip_suffix(&ending)?.parse().ok())
        .collect();
    find_owner(session, &listening, wanted)
}

/// Gives the robot of a session an order and returns its answer. The session is that of `user`, if given; else one's own,
/// or, for root, that of the one user who runs a session of this name.
///
/// # Errors
///
/// [`OrderError`] when there is no such session, or nobody answers.
pub fn order_robot(session: &SessionName, user: Option<u32>, order: Order) -> Result<String, OrderError> {
    let user = addressee(session, user)?;
    let timeout = if matches!(order, Order::Arm { .. }) { ARM_ANSWER_TIMEOUT } else { ANSWER_TIMEOUT };
    let name = listening_name(user, session);
    ask(&name, user, &order.line(), timeout, MAXIMUM_LINE_LENGTH).map_err(|error| match error {
        AskError::Nobody => FindError::not_running(session).into(),
        AskError::NoAnswer => OrderError::NoAnswer(session.clone()),
        AskError::Socket(source) => OrderError::Socket { session: session.clone(), source },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_read_back_from_their_lines() {
        for order in [
            Order::Start,
            Order::Gesture { gesture: Gesture::ULNAR, effort: 1.0 },
            Order::Gesture { gesture: Gesture::GRIP, effort: 0.3 },
            Order::Mode(0),
            Order::Mode(255),
            Order::Alive,
            Order::Stop,
            Order::Arm { seen_ns: u64::MAX },
            Order::StageEnded,
        ] {
            assert_eq!(Order::parse(&order.line()), Some(order));
        }
        let full = Order::Gesture { gesture: Gesture::ULNAR, effort: 1.0 };
        assert_eq!(Order::parse("gesture ulnar"), Some(full));
        for nonsense in [
            "",
            "begin",
            "gesture",
            "gesture Fist!",
            "gesture ulnar hard",
            "gesture ulnar 1.5",
            "gesture ulnar NaN",
            "gesture ulnar 1 1",
            "start now",
            "mode",
            "mode 256",
            "mode -1",
            "mode y-z",
            "mode 1 2",
            "stop it",
            "arm",
            "arm now",
            "arm -1",
        ] {
            assert_eq!(Order::parse(nonsense), None, "{nonsense}");
        }
    }

    #[test]
    fn an_order_by_socket_is_answered_and_nobody_is_no_session() {
        let session: SessionName = format!("orders-{}", std::process::id()).parse().unwrap();
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::Find(_))));
        let mut robot = OrderSocket::open(&session).unwrap();
        let asked = {
            let session = session.clone();
            std::thread::spawn(move || order_robot(&session, None, Order::Stop))
        };
        let order = loop {
            if let Some(order) = robot.receive() {
                break order;
            }
            std::thread::yield_now();
        };
        assert_eq!(order, Order::Stop);
        let asker = robot.take_asker().unwrap();
        robot.answer(&asker, "stopped");
        assert_eq!(asked.join().unwrap().unwrap(), "stopped");
        // One that hangs fills its queue, and nobody waits for ever.
        for _ in 0..20 {
            robot.socket.send("stop", &address(&session)).unwrap_or_default();
        }
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::NoAnswer(_))));
        drop(robot);
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::Find(_))));
    }

    #[test]
    fn a_socket_that_is_closed_refuses_orders_and_still_gives_those_that_came_before() {
        let session: SessionName = format!("closed-{}", std::process::id()).parse().unwrap();
        let mut robot = OrderSocket::open(&session).unwrap();
        let early = Socket::new(UnixDatagram::unbound().unwrap()).unwrap();
        early.send("stop", &address(&session)).unwrap();
        robot.close();
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::Find(_))));
        assert_eq!(robot.receive(), Some(Order::Stop));
        assert_eq!(robot.receive(), None);
    }

    fn address(session: &SessionName) -> UnixAddr {
        UnixAddr::new_abstract(listening_name(own_user(), session).as_bytes()).unwrap()
    }
}
