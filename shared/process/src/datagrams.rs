//! Datagram sockets on this machine, by which one process asks another and is answered. The kernel says who sent what.

use std::io::IoSliceMut;
use std::os::fd::AsRawFd;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::sys::socket::{
    ControlMessageOwned, MsgFlags, UnixAddr, UnixCredentials, recvmsg, sendto, setsockopt, sockopt,
};
use tendon_transport::own_user;

/// Time between two tries to put something into a queue that is full.
const FULL_LOOK: Duration = Duration::from_micros(200);

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

    pub(crate) fn new(socket: UnixDatagram) -> std::io::Result<Socket> {
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

/// What somebody at a socket of the kernel answers: see [`ask`].
pub(crate) fn ask_by_name(
    name: &str,
    user: u32,
    text: &str,
    timeout: Duration,
    longest_answer: usize,
) -> Result<String, AskError> {
    ask(&UnixAddr::new_abstract(name.as_bytes())?, user, text, timeout, longest_answer)
}

/// What somebody at the socket `to` answers to `text`. `user` is whose answer counts: whoever else listens there is not heard. It
/// waits `timeout` for at most `longest_answer` bytes.
pub(crate) fn ask(
    to: &UnixAddr,
    user: u32,
    text: &str,
    timeout: Duration,
    longest_answer: usize,
) -> Result<String, AskError> {
    let socket = UnixDatagram::unbound()?;
    socket.set_read_timeout(Some(timeout))?;
    let mut own = Socket::new(socket)?;
    let asked = Instant::now();
    loop {
        match own.send(text, to) {
            Ok(_) => break,
            // The second when its process is about to end, the third where its file is gone.
            Err(Errno::ECONNREFUSED | Errno::EPIPE | Errno::ENOENT) => return Err(AskError::Nobody),
            // Its queue is full: it hangs, or others send so much that one has to wait for a place.
            Err(Errno::EAGAIN) if asked.elapsed() < timeout => std::thread::sleep(FULL_LOOK),
            Err(Errno::EAGAIN) => return Err(AskError::NoAnswer),
            Err(error) => return Err(error.into()),
        }
    }
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
