//! What a stage measures of its messages, gathered in batches so that measuring costs the path of a sample
//! next to nothing.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use tendon_messages::{MEASUREMENTS, Measured, Measurement, MeasurementHeader, Stage};
use tendon_transport::{Delivery, Publisher, Session, SessionError, now_ns};

use crate::allocations::allocations;
use crate::error::ProcessError;

/// Measurements in a batch: at full speed, some 50 000 messages/s, observers who come by every 50 ms find less
/// than the topic keeps.
pub const BATCH_LENGTH: usize = 256;
/// How long a measurement may wait for its batch to fill.
const BATCH_INTERVAL_NS: u64 = 200_000_000;

/// Gathers and publishes a stage's measurements.
#[derive(Debug)]
pub struct Measurements {
    publisher: Publisher<MeasurementHeader, Measurement>,
    batch: Vec<Measurement>,
    /// Counts since the stage started; the stage keeps them up to date.
    pub counts: MeasurementHeader,
    published_counts: MeasurementHeader,
    due_ns: u64,
}

impl Measurements {
    /// Opens the topic of measurements for `stage`.
    ///
    /// # Errors
    ///
    /// When shared memory is too small.
    pub fn open(session: &Session, stage: Stage) -> Result<Measurements, SessionError> {
        // Observers are never waited for, so nothing ever has to give up waiting.
        let never = Arc::new(AtomicBool::new(false));
        let publisher = Publisher::open(session, &MEASUREMENTS, BATCH_LENGTH, Delivery::Live, never)?;
        let counts = MeasurementHeader {
            stage: stage.number(),
            process_id: u64::from(std::process::id()),
            ..MeasurementHeader::default()
        };
        Ok(Measurements {
            publisher,
            batch: Vec::with_capacity(BATCH_LENGTH),
            counts,
            published_counts: counts,
            due_ns: now_ns() + BATCH_INTERVAL_NS,
        })
    }

    /// Takes a measurement, and publishes the batch if it is full or has waited long enough.
    ///
    /// # Errors
    ///
    /// When the batch cannot be published.
    pub fn record(&mut self, measured: Measured) -> Result<(), ProcessError> {
        let now_ns = now_ns();
        if self.counts.first_message_ns == 0 {
            self.counts.first_message_ns = now_ns;
            // A recorder that came after this stage would otherwise be connected to with the first batch: an allocation in
            // the middle of the session.
            self.publisher.connect().map_err(ProcessError::Measurements)?;
        }
        self.counts.newest_message_ns = now_ns;
        self.push(measured)
    }

    /// Takes how late a control tick was.
    ///
    /// # Errors
    ///
    /// As [`Measurements::record`].
    pub fn record_tick(&mut self, lateness_ns: u64) -> Result<(), ProcessError> {
        self.push(Measured::ControlTick { late_ns: lateness_ns })
    }

    /// Takes how long a command took from its receipt to the arm's network.
    ///
    /// # Errors
    ///
    /// As [`Measurements::record`].
    pub fn record_command_to_wire(&mut self, took_ns: u64) -> Result<(), ProcessError> {
        self.push(Measured::CommandToWire { took_ns })
    }

    fn push(&mut self, measured: Measured) -> Result<(), ProcessError> {
        self.batch.push(measured.into());
        if self.batch.len() == BATCH_LENGTH { self.publish() } else { self.publish_if_due() }
    }

    /// When the batch is to be published; `None` while there is nothing in it and no count has changed.
    pub fn deadline_ns(&self) -> Option<u64> {
        (!self.batch.is_empty() || self.counts != self.published_counts).then_some(self.due_ns)
    }

    /// Publishes the batch if it has waited long enough.
    ///
    /// # Errors
    ///
    /// When the batch cannot be published.
    pub fn publish_if_due(&mut self) -> Result<(), ProcessError> {
        if now_ns() >= self.due_ns { self.publish() } else { Ok(()) }
    }

    /// Publishes the batch now.
    ///
    /// # Errors
    ///
    /// When the batch cannot be published.
    pub fn publish(&mut self) -> Result<(), ProcessError> {
        self.counts.allocations = allocations();
        self.publisher
            .publish(self.counts, self.batch.len(), |payload| payload.copy_from_slice(&self.batch))
            .map_err(ProcessError::Measurements)?;
        self.published_counts = self.counts;
        self.batch.clear();
        self.due_ns = now_ns() + BATCH_INTERVAL_NS;
        Ok(())
    }
}
