//! Requests of viewers: notes to the recorder, all else to the session's supervisor.

use std::sync::Arc;

use serde::Deserialize;
use tendon_process::{Answer, NoteError, Request, RequestError, ask_session, leave_note, with_causes};
use tendon_transport::SessionName;
use tokio::sync::Semaphore;
use tokio::sync::mpsc::Sender;

use crate::orders::Told;

/// Requests that may be under way at a time: each has a thread that waits for its answer.
const MOST: usize = 4;

/// What the page can ask for.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Wish {
    /// Keep a note in the recording.
    Note(String),
    /// What the supervisor sees to.
    #[serde(untagged)]
    OfSession(Request),
}

impl Wish {
    /// Its name in the answer.
    pub fn name(&self) -> &'static str {
        match self {
            Wish::Note(_) => "note",
            Wish::OfSession(request) => request.name(),
        }
    }
}

/// The way to the supervisor and the recorder of one session.
#[derive(Debug)]
pub struct Requests {
    session: SessionName,
    free: Arc<Semaphore>,
}

impl Requests {
    /// To this session.
    pub fn new(session: SessionName) -> Requests {
        Requests { session, free: Arc::new(Semaphore::new(MOST)) }
    }

    /// Passes a wish on; the answer goes to `answers` when it comes.
    pub fn pass(&self, id: u64, wish: Wish, answers: Sender<Told>) {
        let order = wish.name();
        let Ok(free) = self.free.clone().try_acquire_owned() else {
            let answer = Answer::refused("too many requests wait for an answer: ask again in a moment");
            // A viewer that takes no answers gets none.
            let _ = answers.try_send(Told { id, order, answer: answer.with_key("too-many-requests") });
            return;
        };
        let session = self.session.clone();
        tokio::spawn(async move {
            let asked = tokio::task::spawn_blocking(move || ask(&session, wish)).await;
            drop(free);
            let answer = asked.unwrap_or_else(|error| Answer::refused(format!("nobody was asked: {error}")));
            // Whoever asked may be gone.
            let _ = answers.send(Told { id, order, answer }).await;
        });
    }
}

/// Waits for the answer.
fn ask(session: &SessionName, wish: Wish) -> Answer {
    match wish {
        Wish::Note(text) => match leave_note(session, &text) {
            Ok(said) => Answer::done(said),
            Err(error) => not_noted(&error),
        },
        Wish::OfSession(request) => ask_session(session, &request).unwrap_or_else(|error| not_asked(&error)),
    }
}

fn not_noted(error: &NoteError) -> Answer {
    let refused = Answer::refused(with_causes(error));
    match error {
        NoteError::Find(_) => refused.with_key("session-not-running"),
        NoteError::NotRecorded(_) => refused.with_key("note-not-recorded"),
        NoteError::Empty => refused.with_key("note-empty"),
        NoteError::TooLong { .. } => refused.with_key("note-too-long"),
        NoteError::NoAnswer(_) => refused.with_key("recorder-silent"),
        NoteError::Socket { .. } => refused,
    }
}

fn not_asked(error: &RequestError) -> Answer {
    let refused = Answer::refused(with_causes(error));
    match error {
        RequestError::NotRunning(_) => refused.with_key("session-not-running"),
        RequestError::NoAnswer(_) => refused.with_key("session-silent"),
        RequestError::Nonsense(_) | RequestError::Listen { .. } | RequestError::Socket { .. } => refused,
    }
}
