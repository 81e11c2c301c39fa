//! Orders to a running stage: from the supervisor by its standard input, and to the robot from anybody of the same
//! user by a socket, so that a stop needs neither the supervisor nor shared memory.
//!
//! ```text
//! tendon run ──"alive", "stop", "arm", …──▶ standard input ─┐
//!                                                           ├─▶ Control::wait ─▶ ahead of every message
//! tendon stop ──────"stop"──▶ socket of the session ────────┘
//!      ◀──── what came of it ────┘
//! ```

use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use tendon_gesture::Gesture;
use tendon_transport::SessionName;

/// What a stage is told to do, one line of text each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Let the source begin.
    Start,
    /// The person at the keyboard, or the simulated one, makes this gesture.
    Gesture(Gesture),
    /// The supervisor is there. The robot rests when this stops coming.
    Alive,
    /// Stop the arm, until [`Order::Arm`].
    Stop,
    /// Permit motion again, once the person has been at rest.
    Arm,
    /// Another stage ended: stop the arm, until [`Order::Arm`].
    StageEnded,
}

impl Order {
    /// The line for this order, without the line feed.
    pub fn line(self) -> String {
        match self {
            Order::Start => "start".to_owned(),
            Order::Gesture(gesture) => format!("gesture {gesture}"),
            Order::Alive => "alive".to_owned(),
            Order::Stop => "stop".to_owned(),
            Order::Arm => "arm".to_owned(),
            Order::StageEnded => "stage-ended".to_owned(),
        }
    }

    pub(crate) fn parse(line: &str) -> Option<Order> {
        match line.trim() {
            "start" => Some(Order::Start),
            "alive" => Some(Order::Alive),
            "stop" => Some(Order::Stop),
            "arm" => Some(Order::Arm),
            "stage-ended" => Some(Order::StageEnded),
            line => match line.split_once(' ') {
                Some(("gesture", name)) => name.trim().parse().ok().map(Order::Gesture),
                _ => None,
            },
        }
    }
}

/// Longest line of an order, and longest answer; what is longer is none of ours.
pub(crate) const MAXIMUM_LINE_LENGTH: usize = 256;

/// How long the robot may take to answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Why an order did not arrive.
#[derive(Debug, thiserror::Error)]
pub enum OrderError {
    /// Nobody listens.
    #[error("no session `{0}` is running here: `tendon run` starts one, --session NAME names another")]
    NoSession(SessionName),
    /// The robot process is there but does not answer.
    #[error(
        "the robot of session `{0}` does not answer: use the arm's emergency stop button. A robot process that \
         hangs sends nothing, and the arm comes to rest by itself"
    )]
    NoAnswer(SessionName),
    /// The socket could not be used.
    #[error("{path}: {source}", path = path.display())]
    Socket {
        /// The socket's file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
}

/// A socket's file, gone when dropped.
#[derive(Debug)]
struct Socket {
    socket: UnixDatagram,
    path: PathBuf,
}

impl Socket {
    fn bind(path: PathBuf) -> std::io::Result<Socket> {
        // One that a killed process left; the session's lock keeps living ones apart.
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let socket = UnixDatagram::bind(&path)?;
        Ok(Socket { socket, path })
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        // One that stays is no harm: the next session of the name replaces it.
        let _ = std::fs::remove_file(&self.path);
    }
}

fn listening_path(session: &SessionName) -> PathBuf {
    session.runtime_file("orders")
}

/// The robot's end.
#[derive(Debug)]
pub(crate) struct OrderSocket {
    socket: Socket,
    /// Who waits for the answer to the newest order.
    asker: Option<PathBuf>,
}

impl OrderSocket {
    pub(crate) fn open(session: &SessionName) -> anyhow::Result<OrderSocket> {
        let path = listening_path(session);
        let failed = || format!("cannot listen for orders at {}", path.display());
        let socket = Socket::bind(path.clone()).with_context(failed)?;
        socket.socket.set_nonblocking(true).with_context(failed)?;
        Ok(OrderSocket { socket, asker: None })
    }

    /// The next order that has come; what is none of ours is passed over.
    pub(crate) fn receive(&mut self) -> Option<Order> {
        let mut bytes = [0; MAXIMUM_LINE_LENGTH];
        // That nothing is there, or no more, is the only error that a bound socket gives.
        while let Ok((length, sender)) = self.socket.socket.recv_from(&mut bytes) {
            if let Some(order) = std::str::from_utf8(&bytes[..length]).ok().and_then(Order::parse) {
                self.asker = sender.as_pathname().map(Path::to_owned);
                return Some(order);
            }
        }
        None
    }

    /// Tells who gave the newest order what came of it.
    pub(crate) fn answer(&mut self, text: &str) {
        if let Some(asker) = self.asker.take() {
            // One that is gone needs no answer.
            let _ = self.socket.socket.send_to(text.as_bytes(), asker);
        }
    }
}

impl AsFd for OrderSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.socket.as_fd()
    }
}

/// Gives the robot of a session an order and returns its answer.
///
/// # Errors
///
/// [`OrderError`] when nobody listens or answers.
pub fn order_robot(session: &SessionName, order: Order) -> Result<String, OrderError> {
    let listening = listening_path(session);
    let own = session.runtime_file(&format!("asks-{}", std::process::id()));
    let failed = |source| OrderError::Socket { path: own.clone(), source };
    if !listening.exists() {
        return Err(OrderError::NoSession(session.clone()));
    }
    let own = Socket::bind(own.clone()).map_err(failed)?;
    own.socket.set_read_timeout(Some(ANSWER_TIMEOUT)).map_err(failed)?;
    match own.socket.send_to(order.line().as_bytes(), &listening) {
        Ok(_) => {}
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::ConnectionRefused) => {
            return Err(OrderError::NoSession(session.clone()));
        }
        Err(source) => return Err(OrderError::Socket { path: listening, source }),
    }
    let mut answer = [0; MAXIMUM_LINE_LENGTH];
    match own.socket.recv(&mut answer) {
        Ok(length) => Ok(String::from_utf8_lossy(&answer[..length]).into_owned()),
        Err(_) => Err(OrderError::NoAnswer(session.clone())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_read_back_from_their_lines() {
        for order in [
            Order::Start,
            Order::Gesture(Gesture::Ulnar),
            Order::Alive,
            Order::Stop,
            Order::Arm,
            Order::StageEnded,
        ] {
            assert_eq!(Order::parse(&order.line()), Some(order));
        }
        for nonsense in ["", "begin", "gesture", "gesture fist", "start now", "stop it"] {
            assert_eq!(Order::parse(nonsense), None, "{nonsense}");
        }
    }

    #[test]
    fn an_order_by_socket_is_answered_and_nobody_is_no_session() {
        let session: SessionName = format!("orders-{}", std::process::id()).parse().unwrap();
        std::fs::create_dir_all(listening_path(&session).parent().unwrap()).unwrap();
        assert!(matches!(order_robot(&session, Order::Stop), Err(OrderError::NoSession(_))));
        let mut robot = OrderSocket::open(&session).unwrap();
        let asked = {
            let session = session.clone();
            std::thread::spawn(move || order_robot(&session, Order::Stop))
        };
        let order = loop {
            if let Some(order) = robot.receive() {
                break order;
            }
            std::thread::yield_now();
        };
        assert_eq!(order, Order::Stop);
        robot.answer("stopped");
        assert_eq!(asked.join().unwrap().unwrap(), "stopped");
        // A robot that was killed leaves the file, and is no session either.
        let file = listening_path(&session);
        drop(robot);
        drop(UnixDatagram::bind(&file).unwrap());
        assert!(matches!(order_robot(&session, Order::Stop), Err(OrderError::NoSession(_))));
        std::fs::remove_file(file).unwrap();
    }
}
