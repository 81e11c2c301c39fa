//! What ends a session before its time.

use std::path::PathBuf;
use std::process::ExitStatus;
use std::time::Duration;

use tendon_messages::Stage;
use tendon_process::with_causes;
use tendon_transport::{ReceiveError, SessionError, shared_memory_directory};

use crate::children::ChildrenError;

/// What ends a session before its time.
#[derive(Debug, thiserror::Error)]
pub enum SessionFailure {
    /// Stages took too long to start.
    #[error("{who} not ready after {} s: TENDON_LOG=debug shows more", timeout.as_secs())]
    NotReady {
        /// Names of the stages.
        who: String,
        /// How long they had.
        timeout: Duration,
    },
    /// A stage ended by itself and is not started again. It has said itself why.
    #[error("{} ended ({status}): the session is stopped", stage.name())]
    StageEnded {
        /// Which stage.
        stage: Stage,
        /// How it ended.
        status: ExitStatus,
        /// Whether it did so before all were ready.
        at_start: bool,
        /// The last line that it wrote to standard error, which the terminal has shown; empty if it wrote none.
        last_words: String,
    },
    /// The session was to be recorded from its beginning, and cannot be.
    #[error("the recording cannot begin ({status}): choose another folder for --record, or leave it out")]
    RecorderEnded {
        /// How the recorder ended.
        status: String,
        /// The last line that it wrote to standard error.
        last_words: String,
    },
    /// Files without which the stages do not reach each other are gone.
    #[error(
        "the session's files in {} were deleted while it ran ({} is gone): its stages no longer reach each other, so it \
         is stopped. Start it again, and keep {0}/tendon.* from whatever cleans up there",
        shared_memory_directory().display(),
        file.display()
    )]
    FileDeleted {
        /// One of them.
        file: PathBuf,
    },
    /// The source gives no samples any more.
    #[error("no samples for {} s: check the amplifier and its connection", silence.as_secs())]
    NoSamples {
        /// How long there were none.
        silence: Duration,
    },
    /// Stages had to be killed at the end.
    #[error("{names} did not stop and had to be killed")]
    Killed {
        /// Names of the stages.
        names: String,
    },
    /// A stage could not be started or reaped.
    #[error(transparent)]
    Children(#[from] ChildrenError),
    /// The session cannot be joined.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// What the stages say could not be read.
    #[error("cannot read what the stages say")]
    Observer(#[from] ReceiveError),
}

impl SessionFailure {
    /// Whether a stage could not start with what it was given, such as a model that does not fit.
    pub fn is_input(&self) -> bool {
        match self {
            SessionFailure::StageEnded { status, at_start, .. } => *at_start && status.code() == Some(2),
            SessionFailure::RecorderEnded { .. } => true,
            _ => false,
        }
    }

    /// The reason as a report says it: with what a stage that ended had said of it itself.
    pub fn reason(&self) -> String {
        match self {
            SessionFailure::StageEnded { last_words, .. }
            | SessionFailure::RecorderEnded { last_words, .. }
                if !last_words.is_empty() =>
            {
                format!("{last_words}; {self}")
            }
            _ => with_causes(self),
        }
    }
}
