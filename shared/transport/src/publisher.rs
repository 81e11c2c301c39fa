//! The sending end of a topic.

use core::fmt::Debug;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use iceoryx2::port::publisher::Publisher as Port;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{BackpressureAction, BackpressureInfo};
use iceoryx2::prelude::{BackpressureStrategy, ZeroCopySend, ipc};
use iceoryx2::sample_mut::SampleMut;
use tendon_messages::{Measurement, Stage, Topic, Traced};

use crate::clock::now_ns;
use crate::session::{Delivery, Session, SessionError};
use crate::wake::Waker;

/// What a payload may consist of.
///
/// # Safety
///
/// Every bit pattern must be a valid value of the type, so that memory which the kernel zeroed, or which an
/// earlier message of the same topic left behind, may be handed out as `&mut [Self]`.
pub unsafe trait Element: Copy + Debug + ZeroCopySend + 'static {}

// SAFETY: every 32-bit pattern is an f32.
unsafe impl Element for f32 {}
// SAFETY: integers only, and padding, which carries no value.
unsafe impl Element for Measurement {}

/// Why a message could not be published.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// The payload is longer than what the port was opened for.
    #[error("topic `{topic}`: a message of {length} elements does not fit the {maximum} reserved for it")]
    TooLong {
        /// Topic name.
        topic: &'static str,
        /// Elements asked for.
        length: usize,
        /// Elements reserved.
        maximum: usize,
    },
    /// The process was told to stop while a lossless subscriber had no room.
    #[error("topic `{topic}`: stopped while waiting for a subscriber that takes no more messages")]
    Stopped {
        /// Topic name.
        topic: &'static str,
    },
    /// iceoryx2 refused.
    #[error("topic `{topic}`: cannot publish: {reason}")]
    Transport {
        /// Topic name.
        topic: &'static str,
        /// iceoryx2's own word.
        reason: String,
    },
}

/// A message in shared memory that is not sent yet.
#[derive(Debug)]
pub struct Loan<H: Traced, E: Element> {
    message: SampleMut<ipc::Service, [E], H>,
}

impl<H: Traced, E: Element> Loan<H, E> {
    /// The payload, to be written as a whole: it is zero or from an earlier message.
    pub fn payload_mut(&mut self) -> &mut [E] {
        self.message.payload_mut()
    }
}

/// The sending end of a topic. Not `Sync`: one thread publishes.
#[derive(Debug)]
pub struct Publisher<H: Traced, E: Element> {
    topic: &'static str,
    stage: Option<Stage>,
    port: Port<ipc::Service, [E], H>,
    waker: Waker,
    maximum_length: usize,
    next_sequence: u64,
    stop: Arc<AtomicBool>,
}

impl<H: Traced, E: Element> Publisher<H, E> {
    /// Opens `topic` for messages of up to `maximum_length` elements.
    ///
    /// `stop` ends the wait of a lossless publisher for a subscriber that takes nothing any more.
    ///
    /// # Errors
    ///
    /// [`SessionError`] when shared memory is too small, the topic has its publishers already, or its
    /// layout differs from that of another process.
    pub fn open(
        session: &Session,
        topic: &Topic<H, E>,
        maximum_length: usize,
        delivery: Delivery,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SessionError> {
        let service = session.topic(topic, delivery)?;
        let gives_up = stop.clone();
        let builder = service.publisher_builder().initial_max_slice_len(maximum_length).max_loaned_samples(1);
        let builder = match delivery {
            Delivery::Live => builder.backpressure_strategy(BackpressureStrategy::DiscardData),
            Delivery::Lossless => builder
                .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
                .set_backpressure_handler(move |_: &BackpressureInfo| {
                    if gives_up.load(Ordering::Relaxed) {
                        BackpressureAction::DiscardDataAndFail
                    } else {
                        BackpressureAction::Retry
                    }
                }),
        };
        let port = builder.create().map_err(|error| session.port_error(topic.name, &error))?;
        let mut waker = Waker::open(session, topic.name)?;
        // Subscribers that were there before connect now.
        waker.wake();
        Ok(Publisher {
            topic: topic.name,
            stage: topic.publisher,
            port,
            waker,
            maximum_length,
            next_sequence: 0,
            stop,
        })
    }

    /// Publishes one message of `length` elements: loans it in shared memory, lets `fill` write it there,
    /// stamps it, sends it and wakes the subscribers. Returns when it was published, CLOCK_MONOTONIC ns.
    ///
    /// `fill` must write the whole payload: what it leaves untouched is zero or from an earlier message.
    ///
    /// # Errors
    ///
    /// [`PublishError`]; the message is then not sent and uses up no sequence number.
    pub fn publish(
        &mut self,
        header: H,
        length: usize,
        fill: impl FnOnce(&mut [E]),
    ) -> Result<u64, PublishError> {
        let mut loan = self.loan(length)?;
        fill(loan.payload_mut());
        self.send(loan, header)
    }

    /// A message of `length` elements in shared memory, to be filled there and handed to
    /// [`Publisher::send`] when it is due, or dropped. There can be one at a time.
    ///
    /// # Errors
    ///
    /// [`PublishError`] when it is too long, or the one before was neither sent nor dropped.
    pub fn loan(&mut self, length: usize) -> Result<Loan<H, E>, PublishError> {
        if length > self.maximum_length {
            return Err(PublishError::TooLong { topic: self.topic, length, maximum: self.maximum_length });
        }
        let loan = self.port.loan_slice_uninit(length).map_err(|error| self.transport_error(&error))?;
        // SAFETY: the memory of a loan is a shared mapping that the kernel zeroed when it was created and
        // that only messages of this port have been written to since, so it is initialised; and every bit
        // pattern is a valid `E` by the contract of `Element`.
        Ok(Loan { message: unsafe { loan.assume_init() } })
    }

    /// Stamps `loan`, sends it and wakes the subscribers. Returns when it was published, CLOCK_MONOTONIC ns.
    ///
    /// # Errors
    ///
    /// [`PublishError`]; the message is then not sent and uses up no sequence number.
    pub fn send(&mut self, loan: Loan<H, E>, mut header: H) -> Result<u64, PublishError> {
        let mut message = loan.message;
        header.trace_mut().sequence = self.next_sequence;
        let published_ns = now_ns();
        if let Some(stage) = self.stage {
            header.trace_mut().published_ns[stage.index()] = published_ns;
        }
        *message.user_header_mut() = header;
        if let Err(error) = message.send() {
            if self.stop.load(Ordering::Relaxed) {
                return Err(PublishError::Stopped { topic: self.topic });
            }
            return Err(self.transport_error(&error));
        }
        self.next_sequence += 1;
        self.waker.wake();
        Ok(published_ns)
    }

    /// Connects to the subscribers that came after this port, which allocates; otherwise the next message does so.
    ///
    /// # Errors
    ///
    /// [`PublishError::Transport`] when a subscriber's memory cannot be mapped.
    pub fn connect(&self) -> Result<(), PublishError> {
        self.port.update_connections().map_err(|error| self.transport_error(&error))
    }

    /// Messages published so far.
    pub fn published(&self) -> u64 {
        self.next_sequence
    }

    #[cold]
    fn transport_error(&self, error: &dyn Debug) -> PublishError {
        PublishError::Transport { topic: self.topic, reason: format!("{error:?}") }
    }
}
