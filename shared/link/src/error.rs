//! Why a device is not connected.

use std::error::Error;
use std::io;

use tendon_process::ProcessError;
use tendon_source::OfferError;

/// Why a try to connect came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum ConnectError {
    /// The device may be there later.
    #[error(transparent)]
    NotYet(Box<dyn Error + Send + Sync>),
    /// It is there, and it will not do. At the start this ends the program.
    #[error(transparent)]
    Unfit(Box<dyn Error + Send + Sync>),
}

impl ConnectError {
    /// The device may be there later.
    pub fn not_yet(reason: impl Into<Box<dyn Error + Send + Sync>>) -> ConnectError {
        ConnectError::NotYet(reason.into())
    }

    /// It is there, and it will not do.
    pub fn unfit(reason: impl Into<Box<dyn Error + Send + Sync>>) -> ConnectError {
        ConnectError::Unfit(reason.into())
    }
}

/// Why there is no source.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The system grants no pipe or thread.
    #[error("cannot start the thread that connects")]
    Thread(#[source] io::Error),
    /// Nobody came in time, or who came will not do.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The device does not offer what the session wants.
    #[error(transparent)]
    Offer(#[from] OfferError),
    /// The process cannot go on.
    #[error(transparent)]
    Process(#[from] ProcessError),
}
