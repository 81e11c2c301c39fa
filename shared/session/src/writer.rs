//! Text for standard output and standard error, written by a thread of its own.
//!
//! ```text
//! say ──▶ lines, the oldest makes way ─┐
//!                                      ├─▶ thread ─▶ terminal, pipe, file     may block for ever
//! show ─▶ one live line, newest wins ──┘
//! ```
//!
//! A terminal whose reader stops (Ctrl-S, a pipe that nobody empties) blocks who writes to it. Only this thread does.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{ErrorKind, IsTerminal, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

/// Lines that wait at most; then the oldest makes way.
const MAXIMUM_LINES: usize = 1000;
/// Time between two live lines where there is no terminal to rewrite one on.
const PLAIN_INTERVAL: Duration = Duration::from_secs(5);

/// Why not everything was written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// Nobody takes it.
    #[error("{0} takes nothing: some of what was to be said is lost")]
    Stalled(&'static str),
    /// The reader is gone, such as `head` once it has its lines, or a terminal that was closed.
    #[error("nobody reads {0} any more")]
    Closed(&'static str),
    /// The system refused, such as a full disk.
    #[error("cannot write to {name}")]
    Failed {
        /// Which of the two.
        name: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
}

#[derive(Debug)]
enum Piece {
    Line(String),
    EndLive,
}

#[derive(Debug, Default)]
struct Mailbox {
    pieces: VecDeque<Piece>,
    left_out: u64,
    live: Option<String>,
    last_plain: Option<Instant>,
    /// The thread is writing.
    is_writing: bool,
    /// Why it stopped writing.
    failure: Option<std::io::Error>,
}

#[derive(Debug)]
struct Shared {
    name: &'static str,
    is_terminal: bool,
    mailbox: Mutex<Mailbox>,
    changed: Condvar,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Mailbox> {
        self.mailbox.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One of the two standard streams. Clones write to the same.
#[derive(Clone, Debug)]
pub struct Writer {
    shared: Arc<Shared>,
}

impl Writer {
    /// Writes to standard output.
    ///
    /// # Errors
    ///
    /// When the system grants no thread.
    pub fn standard_output() -> std::io::Result<Writer> {
        Writer::to(std::io::stdout().as_fd(), "standard output")
    }

    /// Writes to standard error.
    ///
    /// # Errors
    ///
    /// When the system grants no thread.
    pub fn standard_error() -> std::io::Result<Writer> {
        Writer::to(std::io::stderr().as_fd(), "standard error")
    }

    fn to(stream: BorrowedFd<'_>, name: &'static str) -> std::io::Result<Writer> {
        let file = File::from(stream.try_clone_to_owned()?);
        let shared = Arc::new(Shared {
            name,
            is_terminal: file.is_terminal(),
            mailbox: Mutex::default(),
            changed: Condvar::new(),
        });
        let writer = Writer { shared: shared.clone() };
        std::thread::Builder::new().name(name.to_owned()).spawn(move || write_all(&shared, &file))?;
        Ok(writer)
    }

    /// Writes a line, or several, and a line feed.
    pub fn say(&self, text: impl Into<String>) {
        self.put(Piece::Line(text.into()));
    }

    /// Shows a line in place of the one before. Without a terminal, one every five seconds.
    pub fn show(&self, line: &str) {
        let mut mailbox = self.shared.lock();
        if !self.shared.is_terminal {
            if mailbox.last_plain.is_some_and(|last| last.elapsed() < PLAIN_INTERVAL) {
                return;
            }
            mailbox.last_plain = Some(Instant::now());
        }
        mailbox.live = Some(line.to_owned());
        self.shared.changed.notify_all();
    }

    /// Leaves the live line where it is; what follows begins on a line of its own.
    pub fn end_live(&self) {
        self.put(Piece::EndLive);
    }

    fn put(&self, piece: Piece) {
        let mut mailbox = self.shared.lock();
        if mailbox.failure.is_some() {
            return;
        }
        if mailbox.pieces.len() == MAXIMUM_LINES {
            mailbox.pieces.pop_front();
            mailbox.left_out += 1;
        }
        mailbox.pieces.push_back(piece);
        self.shared.changed.notify_all();
    }

    /// Waits until everything is written, but no longer than `timeout`.
    ///
    /// # Errors
    ///
    /// [`OutputError`] when something was not written.
    pub fn finish(&self, timeout: Duration) -> Result<(), OutputError> {
        let name = self.shared.name;
        let is_busy = |mailbox: &mut Mailbox| {
            mailbox.failure.is_none() && (mailbox.is_writing || !mailbox.pieces.is_empty())
        };
        let waited = self.shared.changed.wait_timeout_while(self.shared.lock(), timeout, is_busy);
        let (mut mailbox, timeout) = waited.unwrap_or_else(PoisonError::into_inner);
        match mailbox.failure.take() {
            Some(source) if is_gone(&source) => Err(OutputError::Closed(name)),
            Some(source) => Err(OutputError::Failed { name, source }),
            None if timeout.timed_out() => Err(OutputError::Stalled(name)),
            None => Ok(()),
        }
    }
}

/// Whether nobody is there to read. A terminal that was closed gives EIO.
fn is_gone(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::BrokenPipe || error.raw_os_error() == Some(nix::libc::EIO)
}

/// The thread: writes what comes until that fails.
fn write_all(shared: &Shared, file: &File) {
    let mut live_is_shown = false;
    let mut mailbox = shared.lock();
    loop {
        let text = next_text(&mut mailbox, shared.is_terminal, &mut live_is_shown, file);
        let Some(text) = text else {
            mailbox = shared.changed.wait(mailbox).unwrap_or_else(PoisonError::into_inner);
            continue;
        };
        mailbox.is_writing = true;
        drop(mailbox);
        let written = write_bytes(file, text.as_bytes());
        mailbox = shared.lock();
        mailbox.is_writing = false;
        if let Err(error) = written {
            mailbox.failure = Some(error);
            mailbox.pieces.clear();
        }
        shared.changed.notify_all();
        if mailbox.failure.is_some() {
            return;
        }
    }
}

fn next_text(
    mailbox: &mut Mailbox,
    is_terminal: bool,
    live_is_shown: &mut bool,
    file: &File,
) -> Option<String> {
    if mailbox.left_out > 0 {
        let left_out = std::mem::take(&mut mailbox.left_out);
        mailbox.pieces.push_front(Piece::Line(format!("(lines left out: {left_out})")));
    }
    match mailbox.pieces.pop_front() {
        // The live line comes again with the next `show`.
        Some(Piece::Line(line)) if std::mem::take(live_is_shown) => Some(format!("\r\x1b[2K{line}\n")),
        Some(Piece::Line(line)) => Some(format!("{line}\n")),
        Some(Piece::EndLive) => Some(if std::mem::take(live_is_shown) { "\n" } else { "" }.to_owned()),
        None => {
            let live = mailbox.live.take()?;
            *live_is_shown = is_terminal;
            if !is_terminal {
                return Some(format!("{live}\n"));
            }
            // One that is wider would wrap, and the next would not cover it.
            let columns = rustix::termios::tcgetwinsize(file).map_or(0, |size| size.ws_col);
            let width = if columns == 0 { 80 } else { usize::from(columns) };
            let line: String = live.chars().take(width.saturating_sub(1)).collect();
            Some(format!("\r\x1b[2K{line}"))
        }
    }
}

fn write_bytes(mut file: &File, mut bytes: &[u8]) -> std::io::Result<()> {
    while !bytes.is_empty() {
        match file.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            // Another program has set this terminal so.
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                poll(&mut [PollFd::new(file.as_fd(), PollFlags::POLLOUT)], PollTimeout::NONE)?;
            }
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    const SOON: Duration = Duration::from_millis(50);
    const WATCHDOG: Duration = Duration::from_secs(60);

    #[test]
    fn a_reader_that_stops_holds_nobody_up_and_gets_the_rest_once_it_goes_on() {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let output = Writer::to(writer.as_fd(), "a pipe").unwrap();
        drop(writer);
        // The thread has begun to write once this has come.
        output.say("line 0");
        let mut first = [0; 7];
        reader.read_exact(&mut first).unwrap();
        assert_eq!(&first, b"line 0\n");
        // More than the pipe holds, and then more than may wait.
        for number in 1..2000 {
            output.say(format!("line {number}: {}", "x".repeat(500)));
        }
        assert!(matches!(output.finish(SOON), Err(OutputError::Stalled("a pipe"))));
        let reading = std::thread::spawn(move || {
            let mut text = String::new();
            let mut bytes = [0; 4096];
            while !text.ends_with(&format!("line 1999: {}\n", "x".repeat(500))) {
                let count = reader.read(&mut bytes).unwrap();
                text.push_str(std::str::from_utf8(&bytes[..count]).unwrap());
            }
            text
        });
        output.finish(WATCHDOG).unwrap();
        let text = reading.join().unwrap();
        // Of those that had to wait, the newest are kept.
        assert!(text.contains("line 1000: ") && text.contains("(lines left out: "), "{}", text.len());
    }

    #[test]
    fn a_reader_that_leaves_and_a_full_disk_are_told_apart() {
        let (reader, writer) = std::io::pipe().unwrap();
        let output = Writer::to(writer.as_fd(), "a pipe").unwrap();
        drop(reader);
        output.say("nobody hears this");
        assert!(matches!(output.finish(WATCHDOG), Err(OutputError::Closed("a pipe"))));
        let full = File::options().write(true).open("/dev/full").unwrap();
        let output = Writer::to(full.as_fd(), "a disk").unwrap();
        output.say("no room for this");
        let error = output.finish(WATCHDOG).unwrap_err();
        assert!(matches!(error, OutputError::Failed { name: "a disk", .. }), "{error}");
    }

    #[test]
    fn the_live_line_fits_the_terminal_and_makes_way_for_lines() {
        let size = nix::pty::Winsize { ws_row: 24, ws_col: 20, ws_xpixel: 0, ws_ypixel: 0 };
        let terminal = nix::pty::openpty(&size, None).unwrap();
        let output = Writer::to(terminal.slave.as_fd(), "a terminal").unwrap();
        let mut reader = File::from(terminal.master);
        let mut read_until = |end: &str| {
            let mut text = String::new();
            let mut byte = [0];
            while !text.ends_with(end) {
                reader.read_exact(&mut byte).unwrap();
                text.push(char::from(byte[0]));
            }
            text
        };
        output.show("ARM STOPPED (ordered): and much more than fits");
        assert_eq!(read_until("order"), "\r\x1b[2KARM STOPPED (order");
        output.say("told");
        assert_eq!(read_until("\n"), "e\r\x1b[2Ktold\r\n");
    }
}
