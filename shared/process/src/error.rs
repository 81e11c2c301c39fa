//! Why a stage's process cannot start or go on.

use std::error::Error;
use std::io;
use std::iter::successors;

use nix::errno::Errno;
use tendon_config::ConfigError;
use tendon_transport::{PublishError, ReceiveError, SessionError};

use crate::scheduling::RealtimeRefused;

/// What a stage's own work says went wrong. Every error becomes one by `?`.
pub type WorkError = Box<dyn Error + Send + Sync>;

/// Why a stage's process cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum ProcessError {
    /// The configuration cannot be read, or makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Real-time scheduling was demanded and is not to be had.
    #[error(transparent)]
    Scheduling(#[from] RealtimeRefused),
    /// The session, or a topic of it, cannot be joined.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Nothing can be received.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The system grants no pipe or handler for signals.
    #[error("cannot handle signals")]
    Signals(#[source] io::Error),
    /// The robot's socket for orders cannot be made.
    #[error(
        "cannot listen for orders at the socket @{name}: if another program holds that name, perhaps another user's, choose \
         another session name with --session"
    )]
    OrderSocket {
        /// The socket's name in the kernel.
        name: String,
        /// The system's reason.
        source: io::Error,
    },
    /// The kernel refuses to poll.
    #[error("cannot wait for messages")]
    Wait(#[source] Errno),
    /// Standard input is broken.
    #[error("cannot read orders from standard input")]
    Orders(#[source] Errno),
    /// Standard output is closed.
    #[error("cannot say ready on standard output")]
    Ready(#[source] io::Error),
    /// What was measured cannot be published.
    #[error("cannot publish measurements")]
    Measurements(#[source] PublishError),
    /// The stage's own work went wrong.
    #[error(transparent)]
    Work(WorkError),
}

/// An error and what led to it, in one line.
pub fn with_causes(error: &(dyn Error + 'static)) -> String {
    successors(error.source(), |&cause| cause.source())
        .fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_said_with_its_causes_and_each_once() {
        let error = ProcessError::Orders(Errno::EIO);
        assert_eq!(with_causes(&error), "cannot read orders from standard input: EIO: I/O error");
        let work = ProcessError::Work(Box::new(error));
        assert_eq!(with_causes(&work), "cannot read orders from standard input: EIO: I/O error");
    }
}
