//! Sources of samples, and the loop that publishes their blocks.
//!
//! ```text
//! device ───── its own clock, a descriptor ─────┐
//!       chunks of any length ─▶ BlockAssembler ─┼─▶ Source ─▶ acquire: wait, fill in shared memory, publish
//! simulated person, recording ─▶ Paced, due ────┘
//! ```
//!
//! A source owns its clock. It says what to wait for (a descriptor or a time), and each of its blocks says which
//! sample comes first and when the newest one was captured, CLOCK_MONOTONIC. A device has no due times: it has a
//! clock of its own, which [`DeviceClock`] maps to ours, and a counter of samples, whose gaps are lost samples.
//! [`Offer`] says what an amplifier has, and which channels of it a session takes, in which unit.
//! [`BlockAssembler`] makes blocks of the chunks that a device or a network delivers.
//! [`Paced`] gives due times to what has no clock: the simulated person and recordings.
//!
//! A program that acquires from a vendor's library implements [`Source`] and calls [`acquire`] from
//! `tendon_process::main`; `acquisition.program` in `tendon.toml` names it. `tests/src/bin/push-device.rs` is one.
#![forbid(unsafe_code)]

mod acquire;
mod assemble;
mod clock;
mod loss;
mod offer;
mod paced;

use std::error::Error;
use std::os::fd::BorrowedFd;

use tendon_gesture::Gesture;
use tendon_messages::Truth;

pub use acquire::{AcquireError, acquire, open_blocks};
pub use assemble::{BlockAssembler, Chunk};
pub use clock::DeviceClock;
pub use loss::LossByTime;
pub use offer::{Choice, Offer, OfferError, OfferedChannel};
pub use paced::{BlockMaker, MadeBlock, Pace, Paced};
pub use tendon_signal::{UnitError, canonical_unit, unit_factor};

/// What to wait for until [`Source::next_block`] may have a block.
#[derive(Clone, Copy, Debug)]
pub enum Wait<'a> {
    /// Nothing: ask for it now. Its block says when it is to be published.
    Nothing,
    /// This time, CLOCK_MONOTONIC ns.
    Until(u64),
    /// This descriptor becomes readable.
    Readable(BorrowedFd<'a>),
    /// The same, or this time comes, CLOCK_MONOTONIC ns.
    ReadableUntil(BorrowedFd<'a>, u64),
}

/// A block that was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Index of its first sample since the source began, those that were lost included.
    pub first_sample: u64,
    /// Samples of each channel: fewer than a block holds where samples are missing after them, otherwise as many.
    pub samples: usize,
    /// When its newest sample was captured, CLOCK_MONOTONIC ns.
    pub captured_ns: u64,
    /// When it is to be published, CLOCK_MONOTONIC ns: later than now for a block that was prepared ahead of its
    /// time, 0 for at once.
    pub publish_at_ns: u64,
    /// The gesture that was really made, if the source knows it.
    pub truth: Truth,
}

/// What a source answers when asked for a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// A block was written.
    Block(Block),
    /// There is none yet.
    NotYet,
    /// There will be none any more.
    End,
}

/// A source of samples broke off.
#[derive(Debug, thiserror::Error)]
#[error("the source failed")]
pub struct SourceError(#[source] Box<dyn Error + Send + Sync>);

impl SourceError {
    /// It failed for this reason.
    pub fn new(reason: impl Into<Box<dyn Error + Send + Sync>>) -> SourceError {
        SourceError(reason.into())
    }
}

/// Where samples come from.
pub trait Source {
    /// Begins to acquire: all stages are ready. Its samples count from here.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when the device does not start.
    fn start(&mut self) -> Result<(), SourceError>;

    /// What to wait for before the next call of [`Source::next_block`].
    fn wait(&self) -> Wait<'_>;

    /// Writes the next block, `[channels × samples]`, channel-major, into `samples` if it is there. A block of fewer
    /// samples lies at the beginning of `samples`. Does not wait.
    ///
    /// # Errors
    ///
    /// [`SourceError`] when the source broke off.
    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError>;

    /// How much faster than CLOCK_MONOTONIC the source's own clock counts, in parts per million; `None` when it has none
    /// or that is not known yet.
    fn clock_drift_ppm(&self) -> Option<f64> {
        None
    }

    /// The person at the keyboard, or the simulated user, makes this gesture from now on, at an effort from 0 to 1.
    /// Sources with a person of their own pass over it.
    fn set_gesture(&mut self, _gesture: Gesture, _effort: f32) {}
}
