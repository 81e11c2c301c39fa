//! Orders to a running stage: from the supervisor by its standard input, and to the robot from its user and root by a
//! socket, so that a stop needs neither the supervisor nor shared memory.
//!
//! ```text
//! tendon run ──"alive", "stop", …────────▶ standard input ─┐
//!                                                           ├─▶ Control::wait ─▶ ahead of every message
//! tendon stop ──────"stop"──▶ socket of the session ────────┘
//!      ◀──── what came of it ────┘
//! ```

use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::sys::socket::UnixAddr;
use tendon_gesture::Gesture;
use tendon_paths::claimed_names;
use tendon_transport::{FindError, SessionName, find_owner, now_ns, own_user, running_sessions};

use crate::answer::Answer;
use crate::datagrams::{AskError, Socket, ask};
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
        /// later. See [`Order::arm_shown_at`].
        seen_ns: u64,
    },
    /// Another stage ended: stop the arm, until [`Order::Arm`].
    StageEnded,
}

impl Order {
    /// An order to arm, by somebody before whose eyes the arm, or its picture, was at `shown_ns`, CLOCK_MONOTONIC ns. What they
    /// have taken in is older by their reaction time: a stop that came since is one they do not know of.
    pub fn arm_shown_at(shown_ns: u64) -> Order {
        // Nobody was shown what is to come: the robot refuses it.
        let is_to_come = shown_ns > now_ns();
        Order::Arm { seen_ns: if is_to_come { u64::MAX } else { shown_ns.saturating_sub(REACTION_NS) } }
    }

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

/// Simple reactions to what is seen take about 200 ms.
const REACTION_NS: u64 = 200_000_000;
/// Longest line of an order; what is longer is none of ours.
pub(crate) const MAXIMUM_LINE_LENGTH: usize = 256;
/// Longest answer, bytes.
const LONGEST_ANSWER: usize = 4096;

/// How long a stop waits for the robot of a session that is starting to listen, and the time between two looks.
const LISTENING_TIMEOUT: Duration = Duration::from_secs(5);
const LISTENING_LOOK: Duration = Duration::from_millis(2);
/// Most datagrams of strangers that are passed over at a time.
const MOST_STRANGERS: usize = 32;

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
    #[error("the robot of session `{0}` does not answer: use the arm's emergency stop button")]
    NoAnswer(SessionName),
    /// The session is there, but no robot process takes orders yet, or any more; or it is a calibration, which has none.
    #[error(
        "session `{0}` has no robot that takes orders: it is starting or ending, or is a calibration, which moves no arm. Use \
         the arm's emergency stop button if it moves"
    )]
    NotListening(SessionName),
    /// The answer is none.
    #[error(
        "the robot of session `{0}` gave an answer that makes no sense, so nothing is certain: look at the arm, and use \
         its emergency stop button. Are this program and the session of the same version?"
    )]
    Nonsense(SessionName),
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

/// Somebody who waits for an answer.
#[derive(Debug)]
pub struct Asker(pub(crate) UnixAddr);

/// The robot's end: a socket in the user's run-time folder, where nobody else can fill its queue, and one that is no file,
/// should that folder be deleted while the arm moves.
#[derive(Debug)]
pub(crate) struct OrderSocket {
    private: Option<PrivateSocket>,
    public: Socket,
    /// Who waits for the answer to the newest order.
    asker: Option<UnixAddr>,
}

/// A socket that is a file, which goes with it.
#[derive(Debug)]
struct PrivateSocket {
    socket: Socket,
    path: PathBuf,
}

impl Drop for PrivateSocket {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

impl OrderSocket {
    pub(crate) fn open(session: &SessionName) -> Result<OrderSocket, ProcessError> {
        let name = listening_name(own_user(), session);
        let failed = |source| ProcessError::OrderSocket { name: name.clone(), source };
        let public = Socket::at(&name).map_err(failed)?;
        public.socket.set_nonblocking(true).map_err(failed)?;
        // Nobody supervises in tests of a stage alone.
        let private = session.order_socket(own_user()).map(|path| -> std::io::Result<PrivateSocket> {
            // What a robot process that was killed has left: none runs beside this one, which holds the name above.
            let _ = std::fs::remove_file(&path);
            let socket = Socket::new(UnixDatagram::bind(&path)?)?;
            socket.socket.set_nonblocking(true)?;
            Ok(PrivateSocket { socket, path })
        });
        Ok(OrderSocket { private: private.transpose().map_err(failed)?, public, asker: None })
    }

    /// The next order that has come from this user or root; everything else is passed over, so much of it at a time that
    /// nobody can hold the robot up.
    pub(crate) fn receive(&mut self) -> Option<Order> {
        let private = self.private.as_mut().map(|private| &mut private.socket);
        private.into_iter().chain([&mut self.public]).find_map(|socket| {
            let (order, asker) = next_order(socket)?;
            self.asker = asker;
            Some(order)
        })
    }

    /// Takes no more datagrams; those that have come can still be received.
    pub(crate) fn close(&self) {
        for socket in self.sockets() {
            // A socket that is bound, as these, can be shut down.
            let _ = socket.socket.shutdown(std::net::Shutdown::Read);
        }
    }

    /// Who gave the newest order, and waits for an answer.
    pub(crate) fn take_asker(&mut self) -> Option<Asker> {
        self.asker.take().map(Asker)
    }

    /// Tells somebody what came of an order.
    pub(crate) fn answer(&mut self, asker: &Asker, answer: &Answer) {
        // One that is gone, or does not read, needs no answer; text and keys always make JSON.
        let _ = serde_json::to_string(answer).map(|answer| self.public.send(&answer, &asker.0));
    }

    /// What is to be waited for.
    pub(crate) fn descriptors(&self) -> [Option<BorrowedFd<'_>>; 2] {
        let private = self.private.as_ref().map(|private| private.socket.socket.as_fd());
        [private, Some(self.public.socket.as_fd())]
    }

    fn sockets(&self) -> impl Iterator<Item = &Socket> {
        self.private.iter().map(|private| &private.socket).chain([&self.public])
    }
}

/// The next order at a socket, and who gave it.
fn next_order(socket: &mut Socket) -> Option<(Order, Option<UnixAddr>)> {
    let mut bytes = [0; MAXIMUM_LINE_LENGTH];
    for _ in 0..MOST_STRANGERS {
        match socket.receive(&mut bytes) {
            Ok(datagram) if datagram.is_from_this_user_or_root() => {
                let text = std::str::from_utf8(&bytes[..datagram.length]);
                if let Some(order) = text.ok().and_then(Order::parse) {
                    return Some((order, datagram.sender));
                }
            }
            // From somebody else, or without a sender.
            Ok(_) | Err(Errno::EPERM | Errno::EINTR | Errno::ENOBUFS) => {}
            // That nothing more is there is the only other error that a bound socket gives.
            Err(_) => return None,
        }
    }
    None
}

/// Whose session of this name an order goes to, of those that run or whose robot process listens.
fn addressee(session: &SessionName, wanted: Option<u32>) -> Result<u32, FindError> {
    // The kernel says who holds the name of a session: nobody can pass for another user.
    let mut users: Vec<u32> = running_sessions()
        .into_iter()
        .filter_map(|(user, name)| (name == *session).then_some(user))
        .collect();
    let own = listening_name(own_user(), session);
    if users.is_empty() && claimed_names(&own).contains(&own) {
        // A robot without a supervisor.
        users.push(own_user());
    }
    find_owner(session, &users, wanted)
}

/// Gives the robot of a session an order and returns its answer. The session is that of `user`, if given; else one's own,
/// or, for root, that of the one user who runs a session of this name. A stop waits for the robot of a session that is
/// starting.
///
/// # Errors
///
/// [`OrderError`] when there is no such session, or nobody answers. An order that the robot does not obey is no error: see
/// [`Answer::ok`].
pub fn order_robot(session: &SessionName, user: Option<u32>, order: Order) -> Result<Answer, OrderError> {
    let begun = Instant::now();
    loop {
        let user = addressee(session, user)?;
        match give(session, user, order) {
            Err(OrderError::NotListening(_)) if !session.is_run_by(user) => {
                return Err(FindError::not_running(session).into());
            }
            Err(OrderError::NotListening(_))
                if order == Order::Stop && begun.elapsed() < LISTENING_TIMEOUT =>
            {
                std::thread::sleep(LISTENING_LOOK);
            }
            answered => return answered,
        }
    }
}

/// Gives the order to the robot of this user's session, if it listens.
fn give(session: &SessionName, user: u32, order: Order) -> Result<Answer, OrderError> {
    let failed = |source| OrderError::Socket { session: session.clone(), source };
    let timeout = if matches!(order, Order::Arm { .. }) { ARM_ANSWER_TIMEOUT } else { ANSWER_TIMEOUT };
    // First what needs no word of a supervisor, which may hang while the arm moves.
    let at_hand = if user == own_user() { session.order_sockets_at_hand() } else { Vec::new() };
    let on_card = std::iter::once_with(|| session.order_socket(user)).flatten();
    let private = at_hand.into_iter().chain(on_card).map(|path| UnixAddr::new(&path));
    let public = UnixAddr::new_abstract(listening_name(user, session).as_bytes());
    for to in private.chain([public]) {
        let to = to.map_err(|error| failed(error.into()))?;
        match ask(&to, user, &order.line(), timeout, LONGEST_ANSWER) {
            Ok(answer) => {
                return serde_json::from_str(&answer).map_err(|_| OrderError::Nonsense(session.clone()));
            }
            Err(AskError::Nobody) => {}
            Err(AskError::NoAnswer) => return Err(OrderError::NoAnswer(session.clone())),
            Err(AskError::Socket(source)) => return Err(failed(source)),
        }
    }
    Err(OrderError::NotListening(session.clone()))
}

#[cfg(test)]
mod tests {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::net::{SocketAddr, UnixListener};

    use tendon_transport::SessionLock;

    use super::*;
    use crate::datagrams::send;

    #[test]
    fn an_order_to_arm_counts_for_what_was_seen_a_reaction_time_before() {
        let now_ns = now_ns();
        assert_eq!(Order::arm_shown_at(now_ns), Order::Arm { seen_ns: now_ns - 200_000_000 });
        assert_eq!(Order::arm_shown_at(now_ns + 60_000_000_000), Order::Arm { seen_ns: u64::MAX });
        assert_eq!(Order::arm_shown_at(5), Order::Arm { seen_ns: 0 });
    }

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
        robot.answer(&asker, &Answer::done("stopped"));
        assert_eq!(asked.join().unwrap().unwrap(), Answer::done("stopped"));
        // One that hangs fills its queue, and nobody waits for ever.
        for _ in 0..20 {
            robot.public.send("stop", &address(&session)).unwrap_or_default();
        }
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::NoAnswer(_))));
        drop(robot);
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::Find(_))));
    }

    #[test]
    fn a_stop_waits_for_a_robot_that_starts_and_comes_through_whatever_others_send() {
        let session: SessionName = format!("starts-{}", std::process::id()).parse().unwrap();
        let _lock = SessionLock::take(&session).unwrap();
        let asked = {
            let session = session.clone();
            std::thread::spawn(move || order_robot(&session, None, Order::Stop))
        };
        assert!(matches!(
            order_robot(&session, None, Order::Arm { seen_ns: 1 }),
            Err(OrderError::NotListening(_))
        ));
        let mut robot = OrderSocket::open(&session).unwrap();
        // Everybody may fill the queue of the socket that is no file.
        let stranger = UnixDatagram::unbound().unwrap();
        stranger.set_nonblocking(true).unwrap();
        while send(&stranger, "noise", &address(&session)).is_ok() {}
        let order = loop {
            if let Some(order) = robot.receive() {
                break order;
            }
            while send(&stranger, "noise", &address(&session)).is_ok() {}
        };
        assert_eq!(order, Order::Stop);
        let asker = robot.take_asker().unwrap();
        robot.answer(&asker, &Answer::done("stopped"));
        assert_eq!(asked.join().unwrap().unwrap(), Answer::done("stopped"));
        let path = session.order_socket(own_user()).unwrap();
        assert!(path.exists());
        // Should somebody delete it, there is the other.
        std::fs::remove_file(&path).unwrap();
        let asked = {
            let session = session.clone();
            std::thread::spawn(move || order_robot(&session, None, Order::Stop))
        };
        while robot.receive().is_none() {
            std::thread::yield_now();
        }
        let asker = robot.take_asker().unwrap();
        robot.answer(&asker, &Answer::done("stopped again"));
        assert_eq!(asked.join().unwrap().unwrap(), Answer::done("stopped again"));
    }

    #[test]
    fn a_stop_waits_for_no_other_program_that_holds_a_name_and_says_nothing() {
        let own = std::process::id();
        // As those of another user, whom nobody can make answer.
        let silent: Vec<UnixListener> = (0..20)
            .map(|number| format!("tendon.4294967294.silent-{own}-{number}"))
            .map(|name| UnixListener::bind_addr(&SocketAddr::from_abstract_name(name).unwrap()).unwrap())
            .collect();
        let session: SessionName = format!("beside-silent-{own}").parse().unwrap();
        let begun = Instant::now();
        assert!(matches!(order_robot(&session, None, Order::Stop), Err(OrderError::Find(_))));
        // Half a second for each of them would be ten.
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
        drop(silent);
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
