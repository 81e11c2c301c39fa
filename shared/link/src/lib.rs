//! Sources behind a connection that comes and goes.
//!
//! ```text
//! thread                                                      loop that acquires
//! Connector::connect: dial, or be dialled; start; check       LinkedSource: read, decode, choose, make blocks
//!   again every second until it works                              │
//! read on, so that it stays fresh, until it is asked for ──Link──▶ │
//! refuse whoever else dials in                                     │
//!   ◀── ask for another ── closed, silent for 0.5 s, late for 2 s, out of step
//! ```
//!
//! What may wait for somebody (a connection, an answer) happens in the thread. The loop never waits for anything but
//! samples and the time at which their absence is a failure.
//!
//! An amplifier's program is a [`Connector`] and a call of [`main`].
#![forbid(unsafe_code)]

mod connect;
mod error;
mod rate;
mod socket;
mod source;

use std::error::Error;
use std::os::fd::OwnedFd;
use std::process::ExitCode;

use tendon_config::Config;
use tendon_messages::Stage;
use tendon_process::{StageProcess, WorkError};
use tendon_source::Offer;

pub use connect::Connector;
pub use error::{ConnectError, LinkError};
pub use rate::{RateError, check_rate};
pub use socket::{accept, listen, read_before, stay_ready};
pub use source::LinkedSource;

/// Instants that follow one another without a loss.
#[derive(Clone, Copy, Debug)]
pub struct Instants<'a> {
    /// Index of the first since the connection was made, those that were lost included.
    pub first_sample: u64,
    /// `[samples × channels of the offer]`, in the units of the offer.
    pub instants: &'a [f32],
}

/// Makes samples of the bytes of one connection.
pub trait Decode: Send {
    /// Takes the bytes of a read, and gives every run of instants without a loss to `take`.
    ///
    /// # Errors
    ///
    /// When the bytes are not what they should be. The connection is made anew.
    fn push(
        &mut self,
        bytes: &[u8],
        take: &mut dyn FnMut(Instants<'_>),
    ) -> Result<(), Box<dyn Error + Send + Sync>>;
}

/// A connection that was made and checked.
pub struct Link {
    /// Last words to the device. Said before the stream closes.
    pub goodbye: Option<Goodbye>,
    /// Where its samples come from.
    pub stream: OwnedFd,
    /// What its bytes mean, at the place where the check left off.
    pub decoder: Box<dyn Decode>,
    /// What it measures.
    pub offer: Offer,
    /// The device, for the user: `Muovi at 192.168.14.1`.
    pub name: String,
    /// Whether its stream shows which samples were lost. Otherwise they are counted against the clock.
    pub shows_losses: bool,
}

/// Bytes that a device is sent before the connection to it closes. Sent when it is dropped.
#[derive(Debug)]
pub struct Goodbye {
    /// Where they are sent.
    pub stream: OwnedFd,
    /// The bytes.
    pub bytes: Vec<u8>,
}

impl Drop for Goodbye {
    fn drop(&mut self) {
        // A device that is gone hears nothing.
        let _ = nix::unistd::write(&self.stream, &self.bytes);
    }
}

/// The `main` of a program that acquires over a connection. `open` makes what connects from the session's settings.
pub fn main<C: Connector>(open: impl FnOnce(&Config) -> Result<C, WorkError>) -> ExitCode {
    tendon_process::main(Stage::Acquisition, |process| {
        let connector = open(&process.config)?;
        let opened = match LinkedSource::open(process, connector)? {
            Some(source) => {
                let blocks = tendon_source::open_blocks(process)?;
                process.ready_with_signal(&source.description(), source.signal().clone())?;
                Some((source, blocks))
            }
            // It was told to stop while it waited for the device.
            None => None,
        };
        Ok(move |process: &mut StageProcess| match opened {
            Some((mut source, blocks)) => tendon_source::acquire(process, &mut source, blocks),
            None => Ok(()),
        })
    })
}
