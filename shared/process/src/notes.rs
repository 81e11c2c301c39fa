//! Notes on a running session, to the recorder that keeps them.
//!
//! ```text
//! tendon note "electrode 3 is loose" ──text──▶ socket of the session ─▶ tendon-recorder ─▶ events of the file
//!      ◀──────────── where it was noted ────────────┘   once it is written
//! ```

use std::time::Duration;

use nix::errno::Errno;
use tendon_transport::{FindError, SessionName, own_user};

use crate::datagrams::{AskError, Socket, ask_by_name};
use crate::orders::Asker;

/// Longest note, bytes.
pub const LONGEST_NOTE: usize = 2000;
/// Longest answer, bytes: a path and a few words.
const LONGEST_ANSWER: usize = 8192;
/// How long the recorder may take to write a note.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(3);

/// Why a note was not kept.
#[derive(Debug, thiserror::Error)]
pub enum NoteError {
    /// There is no such session.
    #[error(transparent)]
    Find(#[from] FindError),
    /// The session is not recorded.
    #[error(
        "session `{0}` is not being recorded, so nobody keeps a note: start it with --record FOLDER, press w in it, or begin \
         a recording on its page"
    )]
    NotRecorded(SessionName),
    /// There is nothing in it.
    #[error("the note is empty: write it behind the command, such as tendon note \"electrode 3 is loose\"")]
    Empty,
    /// It is too long.
    #[error("the note has {length} bytes, {LONGEST_NOTE} are the most: make it shorter, or two of it")]
    TooLong {
        /// Its length, bytes.
        length: usize,
    },
    /// The recorder is there but does not answer.
    #[error("the recorder of session `{0}` does not answer: is the disk full or gone? The note may be lost")]
    NoAnswer(SessionName),
    /// The socket could not be used.
    #[error("cannot use the socket for notes of session `{session}`")]
    Socket {
        /// Session name.
        session: SessionName,
        /// The system's word.
        source: std::io::Error,
    },
}

/// What the recorder's socket is called in the kernel. It is no file, so nobody can remove it.
fn listening_name(session: &SessionName) -> String {
    format!("tendon.{}.{session}.notes", own_user())
}

/// A note, and who waits for the answer.
#[derive(Debug)]
pub struct NoteText {
    /// What to keep.
    pub text: String,
    asker: Option<Asker>,
}

/// The recorder's end.
#[derive(Debug)]
pub struct NoteSocket {
    socket: Socket,
}

impl NoteSocket {
    /// Listens for notes on this session.
    ///
    /// # Errors
    ///
    /// [`NoteError::Socket`] when another recorder does so, or the system refuses.
    pub fn open(session: &SessionName) -> Result<NoteSocket, NoteError> {
        let failed = |source| NoteError::Socket { session: session.clone(), source };
        let socket = Socket::at(&listening_name(session)).map_err(failed)?;
        socket.socket.set_nonblocking(true).map_err(failed)?;
        Ok(NoteSocket { socket })
    }

    /// The next note that has come from this user or root, without waiting; what is none is passed over.
    pub fn receive(&mut self) -> Option<NoteText> {
        let mut bytes = [0; LONGEST_NOTE];
        loop {
            match self.socket.receive(&mut bytes) {
                Ok(note) if note.is_from_this_user_or_root() => {
                    let text = String::from_utf8_lossy(&bytes[..note.length]).into_owned();
                    return Some(NoteText { text, asker: note.sender.map(Asker) });
                }
                Ok(_) | Err(Errno::EPERM | Errno::EINTR | Errno::ENOBUFS) => {}
                Err(_) => return None,
            }
        }
    }

    /// Tells whoever gave the note what came of it.
    pub fn answer(&self, note: &NoteText, text: &str) {
        if let Some(Asker(address)) = &note.asker {
            // One that is gone needs no answer.
            let _ = self.socket.send(text, address);
        }
    }
}

/// Gives a note to the recorder of this user's session, and returns its answer: it is written then.
///
/// # Errors
///
/// [`NoteError`].
pub fn leave_note(session: &SessionName, text: &str) -> Result<String, NoteError> {
    let text = text.trim();
    if text.is_empty() {
        return Err(NoteError::Empty);
    }
    if text.len() > LONGEST_NOTE {
        return Err(NoteError::TooLong { length: text.len() });
    }
    let answered = ask_by_name(&listening_name(session), own_user(), text, ANSWER_TIMEOUT, LONGEST_ANSWER);
    answered.map_err(|error| match error {
        AskError::Nobody if !session.is_run_by(own_user()) => FindError::not_running(session).into(),
        AskError::Nobody => NoteError::NotRecorded(session.clone()),
        AskError::NoAnswer => NoteError::NoAnswer(session.clone()),
        AskError::Socket(source) => NoteError::Socket { session: session.clone(), source },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_is_answered_and_refused_where_nobody_records() {
        let session: SessionName = format!("notes-{}", std::process::id()).parse().unwrap();
        let refused = leave_note(&session, "electrode 3 is loose").unwrap_err();
        assert!(matches!(refused, NoteError::Find(FindError::NotRunning { .. })), "{refused}");
        let mut recorder = NoteSocket::open(&session).unwrap();
        assert!(matches!(NoteSocket::open(&session), Err(NoteError::Socket { .. })));
        assert!(recorder.receive().is_none());
        let left = {
            let session = session.clone();
            std::thread::spawn(move || leave_note(&session, " electrode 3 is loose "))
        };
        let note = loop {
            if let Some(note) = recorder.receive() {
                break note;
            }
            std::thread::yield_now();
        };
        assert_eq!(note.text, "electrode 3 is loose");
        recorder.answer(&note, "noted");
        assert_eq!(left.join().unwrap().unwrap(), "noted");
        assert!(matches!(leave_note(&session, "  "), Err(NoteError::Empty)));
        let long = "x".repeat(LONGEST_NOTE + 1);
        assert!(matches!(leave_note(&session, &long), Err(NoteError::TooLong { length: 2001 })));
    }
}
