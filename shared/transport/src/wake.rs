//! The wake-up that comes with every message.
//!
//! ```text
//! publisher                                /dev/shm                        subscriber
//!     │                          seats of the topic: one page ◀── takes a seat ──┤
//! 1. message into the queue                                                      │
//! 2. a byte into the FIFO of every seat ───▶ FIFO ───readable───▶ a. poll(2) returns
//!                                                                 b. empties the FIFO
//!                                                                 c. receives until nothing is left
//! ```
//!
//! **No wake-up can be lost.** Whether a subscriber sleeps depends on one thing only: whether its FIFO holds a
//! byte. The kernel keeps that; no second word in memory says the same and could disagree with it. The byte of
//! step 2 is still there at (a), and poll returns, or an earlier (b) has read it. That (b) came after step 2,
//! hence after step 1, and the (c) that follows it finds the message. A FIFO that is full takes no more bytes
//! and needs none, because it is readable. A new subscriber puts the first byte into its own FIFO once it has
//! its seat. A publisher that does not see the seat yet has queued its message before that byte is read: both
//! sides have a full fence between their own write and their look at what the other wrote.
//!
//! iceoryx2's event is not used, because version 0.10 loses wake-ups. It goes from "notified" to "idle" first
//! and empties its socket then. A notification in between is emptied away with the others while the state
//! says "notified" again, so none of the later ones writes to the socket, and whoever polls it sleeps for ever.
//!
//! A seat holds the number in the name of its subscriber's FIFO, 0 when it is free. A subscriber holds a lock
//! on its FIFO (`flock(2)`), which the kernel gives back however it ends, so the seats of the dead are known.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};

use memmap2::MmapRaw;
use nix::errno::Errno;
use nix::fcntl::posix_fallocate;
use nix::sys::stat::Mode;
use nix::unistd::mkfifo;

use crate::session::{MAXIMUM_SUBSCRIBERS, Session, SessionError, SessionName};

/// Size of the page of seats, in bytes.
const PAGE_SIZE: i64 = (MAXIMUM_SUBSCRIBERS * size_of::<AtomicU64>()) as i64;
/// Bytes read from a FIFO at a time. What is left keeps it readable.
const READ_SIZE: usize = 1024;

/// Where the page of seats of a topic lies. It stays until the end of the session.
pub(crate) fn page_path(session: &SessionName, topic: &str) -> PathBuf {
    session.shared_memory_file(&format!("wake-{topic}"))
}

/// Who is to be woken by the messages of a topic: one page of memory shared by its publishers and subscribers.
#[derive(Debug)]
struct Seats {
    page: MmapRaw,
    /// Path of the page; the FIFOs lie beside it.
    path: PathBuf,
}

impl Seats {
    fn open(session: &Session, topic: &'static str) -> Result<Seats, SessionError> {
        let path = page_path(session.name(), topic);
        Seats::open_page(&path)
            .map(|page| Seats { page, path: path.clone() })
            .map_err(|source| SessionError::Wake { topic, path, source })
    }

    /// Whoever comes first makes the page. All zeros is a page without subscribers, so there is nothing to
    /// initialise. Its memory is reserved now, because touching what cannot be had later kills a process.
    fn open_page(path: &Path) -> io::Result<MmapRaw> {
        loop {
            let file = OpenOptions::new()
                .create(true)
                .truncate(false)
                .read(true)
                .write(true)
                .mode(0o600)
                .custom_flags(libc::O_NOFOLLOW)
                .open(path)?;
            check_owner(&file)?;
            posix_fallocate(&file, 0, PAGE_SIZE)?;
            // As long as it was empty somebody may have cleared it away. Others would then have another page.
            if file.metadata()?.nlink() > 0 {
                return MmapRaw::map_raw(&file);
            }
        }
    }

    fn seats(&self) -> impl Iterator<Item = &AtomicU64> {
        let first: *mut u64 = self.page.as_mut_ptr().cast();
        (0..MAXIMUM_SUBSCRIBERS).map(move |seat| {
            // SAFETY: the mapping is `PAGE_SIZE` bytes long, which is room for `MAXIMUM_SUBSCRIBERS` of them;
            // it begins at a page's boundary, so they are aligned, and it lives as long as the borrow of
            // `self`. All processes use this memory as atomics only.
            unsafe { AtomicU64::from_ptr(first.add(seat)) }
        })
    }

    fn fifo_path(&self, number: u64) -> PathBuf {
        let mut path = self.path.clone().into_os_string();
        path.push(format!("-{number:x}"));
        path.into()
    }

    /// Takes a free seat, or that of a subscriber that died; `false` when there is none.
    fn take(&self, number: u64) -> bool {
        let take = |seat: &AtomicU64, before| {
            seat.compare_exchange(before, number, Ordering::SeqCst, Ordering::SeqCst).is_ok()
        };
        self.seats().any(|seat| take(seat, 0))
            || self.seats().any(|seat| {
                let before = seat.load(Ordering::SeqCst);
                let is_taken = self.is_dead(before) && take(seat, before);
                if is_taken {
                    // What is gone already needs no removing.
                    let _ = std::fs::remove_file(self.fifo_path(before));
                }
                is_taken
            })
    }

    fn is_dead(&self, number: u64) -> bool {
        match open_fifo(&self.fifo_path(number)) {
            Ok(fifo) => fifo.try_lock().is_ok(),
            Err(error) => error.kind() == io::ErrorKind::NotFound,
        }
    }
}

/// Opens a FIFO at both ends, so that neither a missing reader nor a missing writer is ever an error.
fn open_fifo(path: &Path) -> io::Result<File> {
    let fifo = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(libc::O_NONBLOCK | libc::O_NOFOLLOW)
        .open(path)?;
    check_owner(&fifo)?;
    Ok(fifo)
}

/// Refuses what another user has put in this place.
fn check_owner(file: &File) -> io::Result<()> {
    if file.metadata()?.uid() == nix::unistd::geteuid().as_raw() {
        return Ok(());
    }
    Err(io::Error::new(io::ErrorKind::PermissionDenied, "it belongs to another user"))
}

/// The subscriber's end: readable when a message may have come.
#[derive(Debug)]
pub(crate) struct WakeListener {
    seats: Seats,
    number: u64,
    /// Locked as long as this process lives.
    fifo: File,
}

impl WakeListener {
    pub(crate) fn open(session: &Session, topic: &'static str) -> Result<WakeListener, SessionError> {
        let seats = Seats::open(session, topic)?;
        let (number, path) = make_fifo(&seats).map_err(|source| SessionError::Wake {
            topic,
            path: seats.path.clone(),
            source,
        })?;
        let failed = |source| SessionError::Wake { topic, path: path.clone(), source };
        let fifo = open_fifo(&path).map_err(failed)?;
        fifo.try_lock().map_err(|error| failed(error.into()))?;
        // From here on the FIFO is removed with the listener.
        let listener = WakeListener { seats, number, fifo };
        if !listener.seats.take(number) {
            return Err(SessionError::NoSeat { topic });
        }
        (&listener.fifo).write_all(&[0]).map_err(failed)?;
        Ok(listener)
    }

    /// Takes back the wake-ups that have come so far.
    pub(crate) fn acknowledge(&self) -> io::Result<()> {
        let mut bytes = [0; READ_SIZE];
        match (&self.fifo).read(&mut bytes) {
            Ok(_) => Ok(()),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {
                Ok(())
            }
            Err(error) => Err(error),
        }
    }
}

/// Makes a FIFO with a number that no other has.
fn make_fifo(seats: &Seats) -> io::Result<(u64, PathBuf)> {
    static NEXT: AtomicU32 = AtomicU32::new(1);
    loop {
        let next = NEXT.fetch_add(1, Ordering::Relaxed);
        let number = u64::from(std::process::id()) << 32 | u64::from(next);
        let path = seats.fifo_path(number);
        match mkfifo(&path, Mode::S_IRUSR | Mode::S_IWUSR) {
            Ok(()) => return Ok((number, path)),
            // A process that had this one's id was killed.
            Err(Errno::EEXIST) => {}
            Err(error) => return Err(error.into()),
        }
    }
}

impl AsFd for WakeListener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fifo.as_fd()
    }
}

impl Drop for WakeListener {
    fn drop(&mut self) {
        // The seat first: who finds the FIFO missing takes the subscriber of that seat for dead.
        for seat in self.seats.seats() {
            // A seat that is not this listener's stays as it is.
            let _ = seat.compare_exchange(self.number, 0, Ordering::SeqCst, Ordering::SeqCst);
        }
        // One that stays goes with the session.
        let _ = std::fs::remove_file(self.seats.fifo_path(self.number));
    }
}

/// The publisher's end.
#[derive(Debug)]
pub(crate) struct Waker {
    seats: Seats,
    /// The FIFO of each seat that was taken when last looked at, and its number.
    fifos: [Option<(u64, File)>; MAXIMUM_SUBSCRIBERS],
}

impl Waker {
    pub(crate) fn open(session: &Session, topic: &'static str) -> Result<Waker, SessionError> {
        Ok(Waker { seats: Seats::open(session, topic)?, fifos: Default::default() })
    }

    /// Wakes every subscriber of the topic. Call it when the message is in their queues.
    pub(crate) fn wake(&mut self) {
        // The message is queued before the seats are looked at: see the head of this module.
        fence(Ordering::SeqCst);
        for (seat, fifo) in self.seats.seats().zip(&mut self.fifos) {
            let number = seat.load(Ordering::SeqCst);
            if fifo.as_ref().map_or(0, |(number, _)| *number) != number {
                // A subscriber that dies meanwhile has no FIFO and needs none. Any other failure is tried again
                // with the next message.
                *fifo = (number != 0)
                    .then(|| open_fifo(&self.seats.fifo_path(number)).ok())
                    .flatten()
                    .map(|fifo| (number, fifo));
            }
            if let Some((_, fifo)) = fifo {
                // A full FIFO refuses the byte and is readable without it. Nothing else can go wrong: this
                // process reads from the FIFO, too, as far as the kernel knows.
                let _ = fifo.write(&[0]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

    const TOPIC: &str = "blocks";

    fn session(name: &str) -> Session {
        let name: SessionName = format!("{name}-{}", std::process::id()).parse().unwrap();
        Session::join(&name, "test").unwrap()
    }

    fn is_awake(listener: &WakeListener) -> bool {
        let mut descriptor = [PollFd::new(listener.as_fd(), PollFlags::POLLIN)];
        poll(&mut descriptor, PollTimeout::ZERO).unwrap() == 1
    }

    fn remove_page(session: &Session) {
        std::fs::remove_file(session.name().shared_memory_file("wake-blocks")).unwrap();
    }

    #[test]
    fn every_listener_wakes_once_by_itself_and_then_by_every_wake_until_acknowledged() {
        let session = session("wake");
        let mut waker = Waker::open(&session, TOPIC).unwrap();
        let listeners = [(); MAXIMUM_SUBSCRIBERS].map(|()| WakeListener::open(&session, TOPIC).unwrap());
        for listener in &listeners {
            assert!(is_awake(listener));
            listener.acknowledge().unwrap();
            assert!(!is_awake(listener));
        }
        for _ in 0..100_000 {
            // More than a FIFO can take.
            waker.wake();
        }
        for listener in &listeners {
            while is_awake(listener) {
                listener.acknowledge().unwrap();
            }
            listener.acknowledge().unwrap();
        }
        waker.wake();
        assert!(listeners.iter().all(is_awake));
        drop(listeners);
        remove_page(&session);
    }

    #[test]
    fn seats_of_the_dead_are_taken_and_those_of_the_living_are_not() {
        let session = session("seats");
        let mut listeners: Vec<_> =
            (0..MAXIMUM_SUBSCRIBERS).map(|_| WakeListener::open(&session, TOPIC).unwrap()).collect();
        assert!(matches!(WakeListener::open(&session, TOPIC), Err(SessionError::NoSeat { .. })));
        let mut waker = Waker::open(&session, TOPIC).unwrap();
        waker.wake();
        // A process that is killed leaves its seat and its FIFO, but not the lock on it.
        let killed = listeners.remove(3);
        killed.fifo.unlock().unwrap();
        let successor = WakeListener::open(&session, TOPIC).unwrap();
        successor.acknowledge().unwrap();
        waker.wake();
        assert!(is_awake(&successor));
        drop((listeners, killed, successor));
        remove_page(&session);
    }

    #[test]
    fn what_is_no_page_of_ours_is_refused() {
        let session = session("planted");
        let path = session.name().shared_memory_file("wake-blocks");
        std::os::unix::fs::symlink("/dev/shm/elsewhere", &path).unwrap();
        let error = Waker::open(&session, TOPIC).unwrap_err();
        assert!(error.to_string().contains("wake-blocks"), "{error}");
        assert!(!Path::new("/dev/shm/elsewhere").exists());
        std::fs::remove_file(path).unwrap();
    }
}
