//! Names that one process holds: a listening socket in Linux's abstract namespace (unix(7)).
//!
//! ```text
//! Claim::take("tendon.1000.left-arm", card) ── first ──▶ Claim, until dropped or the process ends
//!                                           └─ later ──▶ ClaimError::Held by process 4711 of user ada
//! Holder::of("tendon.1000.left-arm")        ────────────▶ process, user, card
//! ```
//!
//! No file stands for such a name, so nobody can delete it under its holder, and nothing is left of it. All users share
//! the names; the kernel says which process and user holds one.

use std::io::{ErrorKind, Read, Write};
use std::net::Shutdown;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixListener, UnixStream};
use std::path::Path;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::sys::socket::{
    self, AddressFamily, SockFlag, SockType, UnixAddr, UnixCredentials, connect, getsockopt, sockopt,
};

use crate::user_name;

/// How long a holder may take to hand over its card.
const CARD_TIMEOUT: Duration = Duration::from_millis(500);
/// How long the name of a process that has ended may stay held: by a child that it was about to start, say.
const LAST_HOLD: Duration = Duration::from_secs(1);
/// Time between two tries for a name that is held.
const RETRY: Duration = Duration::from_millis(20);
/// Longest card, bytes.
const MAXIMUM_CARD_LENGTH: usize = 4096;

/// Why a name cannot be claimed.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// Another process holds it.
    #[error("{}", held(.0.as_ref()))]
    Held(Option<Holder>),
    /// The system refused.
    #[error("cannot claim the name `{name}`")]
    System {
        /// The name.
        name: String,
        /// The system's reason.
        source: std::io::Error,
    },
}

fn held(holder: Option<&Holder>) -> String {
    match holder {
        Some(holder) => format!("held by process {} of {}", holder.process_id, user_name(holder.user)),
        None => "held by another process".to_owned(),
    }
}

/// A name that this process holds until this is dropped.
#[derive(Debug)]
pub struct Claim {
    listener: UnixListener,
    door: Option<JoinHandle<()>>,
}

impl Claim {
    /// Claims `name`. Whoever asks for its holder is given `card`.
    ///
    /// # Errors
    ///
    /// [`ClaimError::Held`] while another process holds the name.
    pub fn take(name: &str, card: &str) -> Result<Claim, ClaimError> {
        Claim::take_within(Duration::ZERO, name, card)
    }

    /// As [`Claim::take`], but gives a holder that is about to end this long to do so.
    ///
    /// # Errors
    ///
    /// As [`Claim::take`].
    pub fn take_within(patience: Duration, name: &str, card: &str) -> Result<Claim, ClaimError> {
        let begun = Instant::now();
        loop {
            let held = match Claim::try_take(name, card) {
                Err(ClaimError::Held(holder)) => holder,
                taken => return taken,
            };
            let has_ended = held.as_ref().is_some_and(|holder| !holder.is_running());
            let patience = if has_ended { patience.max(LAST_HOLD) } else { patience };
            if begun.elapsed() >= patience {
                return Err(ClaimError::Held(held));
            }
            std::thread::sleep(RETRY);
        }
    }

    fn try_take(name: &str, card: &str) -> Result<Claim, ClaimError> {
        let failed = |source| ClaimError::System { name: name.to_owned(), source };
        let address = SocketAddr::from_abstract_name(name).map_err(failed)?;
        let listener = match UnixListener::bind_addr(&address) {
            Err(error) if error.kind() == ErrorKind::AddrInUse => {
                return Err(ClaimError::Held(Holder::of(name)));
            }
            bound => bound.map_err(failed)?,
        };
        let entrance = listener.try_clone().map_err(failed)?;
        let card = card.to_owned();
        let door = std::thread::Builder::new()
            .name("claim".to_owned())
            .spawn(move || hand_out(&entrance, &card))
            .map_err(failed)?;
        Ok(Claim { listener, door: Some(door) })
    }
}

/// Gives the card to everybody who comes, until the socket is shut down.
fn hand_out(entrance: &UnixListener, card: &str) {
    loop {
        match entrance.accept() {
            // A short text fits the socket's buffer; a visitor that is gone needs none.
            Ok((mut visitor, _)) => drop(visitor.write_all(card.as_bytes())),
            Err(error) if error.kind() == ErrorKind::InvalidInput => return,
            // Too many open files, say. The name stays held all the same.
            Err(_) => std::thread::sleep(CARD_TIMEOUT),
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let _ = socket::shutdown(self.listener.as_raw_fd(), socket::Shutdown::Both);
        if let Some(door) = self.door.take() {
            // The name is free once the thread has closed the socket, too.
            let _ = door.join();
        }
    }
}

/// Who holds a name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Process that claimed the name.
    pub process_id: i32,
    /// Its user.
    pub user: u32,
    /// What it has to say to who asks; empty if it hangs.
    pub card: String,
}

impl Holder {
    /// Who holds `name`; `None` if nobody does, or nobody can tell. It waits 0.5 s for the card at most.
    pub fn of(name: &str) -> Option<Holder> {
        let (visitor, credentials) = visit(name)?;
        let stream = UnixStream::from(visitor);
        let _ = stream.set_nonblocking(false);
        let _ = stream.shutdown(Shutdown::Write);
        let card = read_card(&stream);
        Some(Holder { process_id: credentials.pid(), user: credentials.uid(), card })
    }

    fn is_running(&self) -> bool {
        Path::new("/proc").join(self.process_id.to_string()).exists()
    }
}

/// A connection to the holder of `name`, and who that is: the process that began to listen, see unix(7).
fn visit(name: &str) -> Option<(OwnedFd, UnixCredentials)> {
    let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
    let visitor = socket::socket(AddressFamily::Unix, SockType::Stream, flags, None).ok()?;
    let address = UnixAddr::new_abstract(name.as_bytes()).ok()?;
    connect(visitor.as_raw_fd(), &address).ok()?;
    let credentials = getsockopt(&visitor, sockopt::PeerCredentials).ok()?;
    Some((visitor, credentials))
}

/// What comes before the holder hangs up, or the time for it is over.
fn read_card(mut stream: &UnixStream) -> String {
    let begun = Instant::now();
    let mut card = Vec::new();
    let mut piece = [0; 512];
    while card.len() < MAXIMUM_CARD_LENGTH {
        let left = CARD_TIMEOUT.saturating_sub(begun.elapsed());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            break;
        }
        match stream.read(&mut piece) {
            Ok(0) | Err(_) => break,
            Ok(count) => card.extend_from_slice(&piece[..count]),
        }
    }
    String::from_utf8(card).unwrap_or_default()
}

/// The user whose process holds `name`; `None` if nobody does. It asks the kernel alone, so it does not wait for the holder.
pub fn holding_user(name: &str) -> Option<u32> {
    visit(name).map(|(_, credentials)| credentials.uid())
}

/// All names in the abstract namespace that begin with `prefix`, held by whatever user.
pub fn claimed_names(prefix: &str) -> Vec<String> {
    let table = std::fs::read("/proc/self/net/unix").unwrap_or_default();
    let table = String::from_utf8_lossy(&table);
    let names = table.lines().filter_map(|line| line.split_once(" @").map(|(_, name)| name.to_owned()));
    let mut names: Vec<String> = names.filter(|name| name.starts_with(prefix)).collect();
    names.sort_unstable();
    names.dedup();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_has_one_holder_who_is_known_and_is_free_once_dropped() {
        let name = format!("tendon-test.{}.claim", std::process::id());
        assert_eq!(Holder::of(&name), None);
        let claim = Claim::take(&name, "in /run/user/1000/tendon").unwrap();
        let error = Claim::take(&name, "").unwrap_err();
        assert!(error.to_string().contains(&format!("held by process {}", std::process::id())), "{error}");
        for _ in 0..300 {
            let holder = Holder::of(&name).unwrap();
            assert_eq!(holder.process_id, std::process::id() as i32);
            assert_eq!(holder.user, nix::unistd::geteuid().as_raw());
            assert_eq!(holder.card, "in /run/user/1000/tendon");
        }
        assert_eq!(claimed_names("tendon-test."), std::slice::from_ref(&name));
        drop(claim);
        assert_eq!(Holder::of(&name), None);
        Claim::take(&name, "").unwrap();
    }

    #[test]
    fn a_holder_that_hands_its_card_out_byte_by_byte_is_waited_for_no_longer_than_one_that_hangs() {
        let name = format!("tendon-trickle.{}", std::process::id());
        let listener = UnixListener::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap();
        assert_eq!(holding_user(&name), Some(nix::unistd::geteuid().as_raw()));
        std::thread::spawn(move || {
            let visitors: Vec<UnixStream> = (0..2).map(|_| listener.accept().unwrap().0).collect();
            while (&visitors[1]).write_all(b"x").is_ok() {
                std::thread::sleep(CARD_TIMEOUT / 5);
            }
        });
        // Without an end to it, this does not return.
        assert!(Holder::of(&name).unwrap().card.len() < 100);
    }

    #[test]
    fn a_holder_that_is_about_to_end_is_waited_for() {
        let name = format!("tendon-test.{}.patience", std::process::id());
        let claim = Claim::take(&name, "").unwrap();
        let successor = {
            let name = name.clone();
            std::thread::spawn(move || Claim::take_within(Duration::from_secs(60), &name, ""))
        };
        drop(claim);
        successor.join().unwrap().unwrap();
    }
}
