//! Waiting for sockets with a deadline.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// A socket at which devices dial in, for [`accept`].
///
/// # Errors
///
/// When the address is in use or is none of this computer's.
pub fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Takes a connection to `listener` if one comes within `longest`. `listener` must be non-blocking.
///
/// # Errors
///
/// When the system refuses.
pub fn accept(listener: &TcpListener, longest: Duration) -> io::Result<Option<(TcpStream, SocketAddr)>> {
    let until = Instant::now() + longest;
    loop {
        match listener.accept() {
            Ok(connection) => return Ok(Some(connection)),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            // It hung up before it was accepted.
            Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
            Err(error) => return Err(error),
        }
        if !wait(&[listener.as_fd()], until)?[0] && Instant::now() >= until {
            return Ok(None);
        }
    }
}

/// Makes a stream one that never waits, as [`read_before`] and the loop that acquires need it.
///
/// # Errors
///
/// When the system refuses.
pub fn stay_ready(stream: &impl AsFd) -> io::Result<()> {
    fcntl(stream.as_fd(), FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
    Ok(())
}

/// Reads what has come, at the latest at `until`. Gives the number of bytes, 0 at the end of the stream, or `None` if nothing
/// came in time. The stream must be non-blocking.
///
/// # Errors
///
/// When the stream is broken.
pub fn read_before(stream: &impl AsFd, buffer: &mut [u8], until: Instant) -> io::Result<Option<usize>> {
    loop {
        match nix::unistd::read(stream, buffer) {
            Ok(count) => return Ok(Some(count)),
            Err(Errno::EINTR) => continue,
            Err(Errno::EAGAIN) => {}
            Err(error) => return Err(error.into()),
        }
        if !wait(&[stream.as_fd()], until)?[0] && Instant::now() >= until {
            return Ok(None);
        }
    }
}

/// Waits until one of the descriptors has something or hung up, at the latest at `until`; says which.
pub(crate) fn wait<const COUNT: usize>(
    descriptors: &[BorrowedFd<'_>; COUNT],
    until: Instant,
) -> io::Result<[bool; COUNT]> {
    let mut polled = descriptors.map(|descriptor| PollFd::new(descriptor, PollFlags::POLLIN));
    let left = until.saturating_duration_since(Instant::now());
    // Rounded up: a wait that ends a little early would turn in circles.
    let left = PollTimeout::try_from(left + Duration::from_millis(1)).unwrap_or(PollTimeout::MAX);
    match poll(&mut polled, left) {
        Ok(_) | Err(Errno::EINTR) => Ok(polled.map(|descriptor| descriptor.any() == Some(true))),
        Err(error) => Err(error.into()),
    }
}
