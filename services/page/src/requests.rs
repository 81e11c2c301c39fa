//! Requests of viewers: notes to the recorder, all else to the session's supervisor.

use std::sync::Arc;

use serde::Deserialize;
use tendon_process::{Request, ask_session, leave_note, with_causes};
use tendon_transport::SessionName;
use tokio::sync::Semaphore;
use tokio::sync::mpsc::Sender;

use crate::orders::Answer;

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
    pub fn pass(&self, id: u64, wish: Wish, answers: Sender<Answer>) {
        let order = wish.name();
        let Ok(free) = self.free.clone().try_acquire_owned() else {
            let text = "too many requests wait for an answer: ask again in a moment".to_owned();
            // A viewer that takes no answers gets none.
            let _ = answers.try_send(Answer { id, order, ok: false, text });
            return;
        };
        let session = self.session.clone();
        tokio::spawn(async move {
            let asked = tokio::task::spawn_blocking(move || ask(&session, wish)).await;
            drop(free);
            let (ok, text) = asked.unwrap_or_else(|error| (false, format!("nobody was asked: {error}")));
            // Whoever asked may be gone.
            let _ = answers.send(Answer { id, order, ok, text }).await;
        });
    }
}

/// Waits for the answer: whether it is done, and the words for it.
fn ask(session: &SessionName, wish: Wish) -> (bool, String) {
    match wish {
        Wish::Note(text) => match leave_note(session, &text) {
            Ok(said) => (true, said),
            Err(error) => (false, with_causes(&error)),
        },
        Wish::OfSession(request) => match ask_session(session, &request) {
            Ok(answer) => (answer.ok, answer.text),
            Err(error) => (false, with_causes(&error)),
        },
    }
}
