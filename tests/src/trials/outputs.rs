//! Where a session writes: pipes, a terminal or a full device, whose readers can stop, or go away.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{Winsize, openpty};
use nix::unistd::{pipe2, ttyname};

use super::Output;

/// How long a reader sleeps, at most, before it looks whether it still is to read.
const LOOK_MS: u8 = 10;

const READS: u8 = 0;
const STALLS: u8 = 1;
const IS_CLOSED: u8 = 2;

/// The outputs of a session, and the keys of its terminal.
pub struct Outputs {
    /// Of pipes: standard output, standard error. Of a terminal: all of it.
    readers: Vec<Reader>,
    /// The terminal's end that a person sits at.
    keys: Option<File>,
}

impl Outputs {
    /// Starts `command` with these outputs.
    pub fn start(output: Output, mut command: Command) -> (Child, Outputs) {
        match output {
            Output::FullDevice => {
                let full = || OpenOptions::new().write(true).open("/dev/full").unwrap();
                command.stdin(Stdio::null()).stdout(full()).stderr(full());
                (command.spawn().unwrap(), Outputs { readers: Vec::new(), keys: None })
            }
            Output::Pipes => {
                let [(output, stdout), (errors, stderr)] = [(); 2].map(|()| pipe2(OFlag::O_CLOEXEC).unwrap());
                command.stdin(Stdio::null()).stdout(stdout).stderr(stderr);
                let child = command.spawn().unwrap();
                let readers = [output, errors].map(|end| {
                    let end = File::from(end);
                    // Whoever opens the one end of a pipe for writing writes into it.
                    let other = PathBuf::from(format!("/proc/self/fd/{}", end.as_raw_fd()));
                    Reader::start(end, other)
                });
                (child, Outputs { readers: readers.into(), keys: None })
            }
            Output::Terminal => {
                let size = Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 };
                let terminal = openpty(&size, None).unwrap();
                // A session that inherits the person's end would keep its own terminal from going away.
                for end in [&terminal.master, &terminal.slave] {
                    fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
                }
                let path = ttyname(&terminal.slave).unwrap();
                let child = on_terminal(&command, terminal.slave).spawn().unwrap();
                let keys = File::from(terminal.master);
                let reader = Reader::start(keys.try_clone().unwrap(), path);
                (child, Outputs { readers: vec![reader], keys: Some(keys) })
            }
        }
    }

    /// Everything read so far from standard output, or from the terminal.
    pub fn text(&self) -> String {
        self.readers.first().map_or(String::new(), Reader::text)
    }

    /// Everything read so far from standard error, or from the terminal.
    pub fn errors(&self) -> String {
        self.readers.last().map_or(String::new(), Reader::text)
    }

    /// Presses a key.
    pub fn press(&mut self, key: u8) {
        if let Some(keys) = &mut self.keys {
            keys.write_all(&[key]).unwrap();
        }
    }

    /// Nobody reads any more, and there is no room left: the next write blocks.
    pub fn stall(&mut self) {
        for reader in &self.readers {
            reader.state.store(STALLS, Ordering::SeqCst);
        }
        // What a reader has begun to read it reads.
        std::thread::sleep(Duration::from_millis(2 * u64::from(LOOK_MS)));
        for reader in &self.readers {
            reader.fill();
        }
    }

    /// Somebody reads again.
    pub fn resume(&mut self) {
        for reader in &self.readers {
            reader.state.store(READS, Ordering::SeqCst);
        }
    }

    /// Closes standard output, as `head` does.
    pub fn close_first(&mut self) {
        if let Some(reader) = self.readers.first_mut() {
            reader.close();
        }
    }

    /// Closes everything, the terminal with its keys too.
    pub fn close(&mut self) {
        self.readers.iter_mut().for_each(Reader::close);
        self.keys = None;
    }
}

/// The command with a terminal as its controlling one: setsid(1) keeps the process's number.
fn on_terminal(command: &Command, terminal: OwnedFd) -> Command {
    let mut with_terminal = Command::new("setsid");
    with_terminal.arg("--ctty").arg(command.get_program()).args(command.get_args());
    for (name, value) in command.get_envs() {
        with_terminal.env(name, value.unwrap_or_default());
    }
    if let Some(folder) = command.get_current_dir() {
        with_terminal.current_dir(folder);
    }
    let end = || Stdio::from(terminal.try_clone().unwrap());
    with_terminal.stdin(end()).stdout(end()).stderr(end());
    with_terminal
}

/// Reads one output in a thread.
struct Reader {
    text: Arc<Mutex<String>>,
    state: Arc<AtomicU8>,
    thread: Option<JoinHandle<()>>,
    /// Where to write what this reader would read.
    other_end: PathBuf,
}

impl Reader {
    fn start(end: File, other_end: PathBuf) -> Reader {
        let text = Arc::new(Mutex::new(String::new()));
        let state = Arc::new(AtomicU8::new(READS));
        let thread = {
            let (text, state) = (Arc::clone(&text), Arc::clone(&state));
            std::thread::spawn(move || read(end, &text, &state))
        };
        Reader { text, state, thread: Some(thread), other_end }
    }

    fn text(&self) -> String {
        self.text.lock().unwrap().clone()
    }

    fn close(&mut self) {
        self.state.store(IS_CLOSED, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    /// Writes until there is no room.
    fn fill(&self) {
        let flags = (OFlag::O_NONBLOCK | OFlag::O_NOCTTY).bits();
        // An end that is closed already cannot be filled, and nobody writes to it.
        let Ok(mut end) = OpenOptions::new().write(true).custom_flags(flags).open(&self.other_end) else {
            return;
        };
        for piece in [[b'.'; 1024].as_slice(), b"."] {
            while end.write(piece).is_ok_and(|length| length > 0) {}
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.close();
    }
}

fn read(mut end: File, text: &Mutex<String>, state: &AtomicU8) {
    let mut buffer = [0; 4096];
    loop {
        match state.load(Ordering::SeqCst) {
            IS_CLOSED => return,
            STALLS => std::thread::sleep(Duration::from_millis(u64::from(LOOK_MS))),
            _ => {
                let mut look = [PollFd::new(end.as_fd(), PollFlags::POLLIN)];
                if !poll(&mut look, PollTimeout::from(LOOK_MS)).is_ok_and(|ready| ready > 0) {
                    continue;
                }
                match end.read(&mut buffer) {
                    // A terminal says EIO once nobody has it open any more.
                    Ok(0) => return,
                    Err(error) if error.kind() != ErrorKind::Interrupted => return,
                    Err(_) => {}
                    Ok(length) => text.lock().unwrap().push_str(&String::from_utf8_lossy(&buffer[..length])),
                }
            }
        }
    }
}
