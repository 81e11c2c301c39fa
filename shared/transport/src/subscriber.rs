//! The receiving end of a topic.

use core::fmt::Debug;
use core::sync::atomic::{Ordering, fence};
use std::os::fd::{AsFd, BorrowedFd};

use iceoryx2::port::subscriber::Subscriber as Port;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::ipc;
use iceoryx2::sample::Sample;
use iceoryx2::service::port_factory::PortFactory as _;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use tendon_messages::{Stage, Topic, Trace, Traced};

use crate::clock::now_ns;
use crate::publisher::Element;
use crate::session::{Delivery, Session, SessionError};
use crate::wake::WakeListener;

/// Why nothing could be received.
#[derive(Debug, thiserror::Error)]
#[error("topic `{topic}`: cannot receive: {reason}; restart the session")]
pub struct ReceiveError {
    /// Topic name.
    topic: &'static str,
    /// iceoryx2's own word.
    reason: String,
}

/// The receiving end of a topic. Poll it as a file descriptor ([`AsFd`]) for the wake that comes with every
/// message, then [`Subscriber::receive`] until nothing is left.
#[derive(Debug)]
pub struct Subscriber<H: Traced, E: Element> {
    topic: &'static str,
    stage: Option<Stage>,
    service: PortFactory<ipc::Service, [E], H>,
    port: Port<ipc::Service, [E], H>,
    /// `None` for a [`PolledSubscriber`].
    wakes: Option<WakeListener>,
    gaps: GapCount,
    received: u64,
}

impl<H: Traced, E: Element> Subscriber<H, E> {
    /// Opens `topic` for the stage that consumes it (`None`: an observer, which leaves no stamp).
    ///
    /// # Errors
    ///
    /// [`SessionError`] when shared memory is too small, the topic has all the subscribers it can have, or
    /// its layout differs from that of another process.
    pub fn open(
        session: &Session,
        topic: &Topic<H, E>,
        stage: Option<Stage>,
        delivery: Delivery,
    ) -> Result<Self, SessionError> {
        Subscriber::of_service(session, topic, stage, session.topic(topic, delivery)?)
    }

    /// Opens `topic` for an observer, with the delivery that the session has for it; `None` while nobody has opened the
    /// topic yet. With [`Delivery::Lossless`] an observer that does not read holds up the publisher.
    ///
    /// # Errors
    ///
    /// As [`Subscriber::open`].
    pub fn observe(session: &Session, topic: &Topic<H, E>) -> Result<Option<Self>, SessionError> {
        session
            .existing_topic(topic)?
            .map(|service| Subscriber::of_service(session, topic, None, service))
            .transpose()
    }

    fn of_service(
        session: &Session,
        topic: &Topic<H, E>,
        stage: Option<Stage>,
        service: PortFactory<ipc::Service, [E], H>,
    ) -> Result<Self, SessionError> {
        let polled = Subscriber::without_wakes(session, topic, stage, service)?;
        Ok(Subscriber { wakes: Some(WakeListener::open(session, topic.name)?), ..polled })
    }

    fn without_wakes(
        session: &Session,
        topic: &Topic<H, E>,
        stage: Option<Stage>,
        service: PortFactory<ipc::Service, [E], H>,
    ) -> Result<Self, SessionError> {
        let port = service
            .subscriber_builder()
            .buffer_size(topic.buffer)
            .create()
            .map_err(|error| session.port_error(topic.name, &error))?;
        let gaps = GapCount::default();
        Ok(Subscriber { topic: topic.name, stage, service, port, wakes: None, gaps, received: 0 })
    }

    /// Connects to the publishers that there are; `false` when there is none yet. One that comes later wakes
    /// this port.
    ///
    /// Until this port has connected, by this or by [`Subscriber::receive`], its publisher cannot tell it from
    /// one that is gone, and drops what no longer fits the queue, even with [`Delivery::Lossless`].
    ///
    /// # Errors
    ///
    /// [`ReceiveError`] when the publisher's memory cannot be mapped.
    pub fn connect(&self) -> Result<bool, ReceiveError> {
        // In this order: a publisher that comes in between is connected to, or wakes this port. The fence goes
        // with the one in `Waker::wake`: of a port and a publisher that open at once, one sees the other.
        fence(Ordering::SeqCst);
        let has_publisher = self.service.dynamic_config().number_of_publishers() > 0;
        self.port.update_connections().map_err(|error| self.error(&error))?;
        Ok(has_publisher)
    }

    /// Takes back the wake-ups that have come so far. Call it after the file descriptor became readable and
    /// before [`Subscriber::receive`], then receive until nothing is left: a message that comes after this makes
    /// the descriptor readable again.
    ///
    /// # Errors
    ///
    /// [`ReceiveError`] when the kernel refuses to read.
    pub fn acknowledge_wakes(&self) -> Result<(), ReceiveError> {
        let Some(wakes) = &self.wakes else { return Ok(()) };
        wakes.acknowledge().map_err(|error| self.error(&error))
    }

    /// The next message, stamped as received now; `None` when there is none.
    ///
    /// # Errors
    ///
    /// [`ReceiveError`] when the publisher's memory cannot be mapped.
    pub fn receive(&mut self) -> Result<Option<Received<H, E>>, ReceiveError> {
        let Some(sample) = self.port.receive().map_err(|error| self.error(&error))? else {
            return Ok(None);
        };
        let mut trace = *sample.user_header().trace();
        if let Some(stage) = self.stage {
            trace.received_ns[stage.index()] = now_ns();
        }
        self.received += 1;
        let lost_before = self.gaps.take(trace.sequence);
        Ok(Some(Received { sample, trace, lost_before }))
    }

    /// What happens on this topic when a subscriber is behind.
    pub fn delivery(&self) -> Delivery {
        if self.service.static_config().has_safe_overflow() { Delivery::Live } else { Delivery::Lossless }
    }

    /// Messages received so far.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Messages lost so far, by gaps in the sequence numbers.
    pub fn lost(&self) -> u64 {
        self.gaps.lost
    }

    /// Sequence number of the first message received, and the one after the newest; `None` before the first.
    pub fn sequence_range(&self) -> Option<(u64, u64)> {
        self.gaps.first.zip(self.gaps.next)
    }

    #[cold]
    fn error(&self, error: &dyn Debug) -> ReceiveError {
        ReceiveError { topic: self.topic, reason: format!("{error:?}") }
    }
}

impl<H: Traced, E: Element> AsFd for Subscriber<H, E> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.wakes
            .as_ref()
            .expect("only a polled subscriber has no wake-ups, and it gives out no descriptor")
            .as_fd()
    }
}

/// The receiving end of a topic that nobody wakes: its publishers do nothing for it beyond queueing the message. For an
/// observer that looks by itself before the topic's buffer is full.
#[derive(Debug)]
pub struct PolledSubscriber<H: Traced, E: Element>(Subscriber<H, E>);

impl<H: Traced, E: Element> PolledSubscriber<H, E> {
    /// Opens `topic` for an observer.
    ///
    /// # Errors
    ///
    /// As [`Subscriber::open`].
    pub fn open(session: &Session, topic: &Topic<H, E>, delivery: Delivery) -> Result<Self, SessionError> {
        let service = session.topic(topic, delivery)?;
        Subscriber::without_wakes(session, topic, None, service).map(PolledSubscriber)
    }

    /// As [`Subscriber::connect`].
    ///
    /// # Errors
    ///
    /// As [`Subscriber::connect`].
    pub fn connect(&self) -> Result<bool, ReceiveError> {
        self.0.connect()
    }

    /// As [`Subscriber::receive`].
    ///
    /// # Errors
    ///
    /// As [`Subscriber::receive`].
    pub fn receive(&mut self) -> Result<Option<Received<H, E>>, ReceiveError> {
        self.0.receive()
    }

    /// Messages lost so far, by gaps in the sequence numbers.
    pub fn lost(&self) -> u64 {
        self.0.lost()
    }
}

/// A message, read in place in shared memory. It goes back to its publisher when dropped: keep it no longer
/// than needed.
#[derive(Debug)]
pub struct Received<H: Traced, E: Element> {
    sample: Sample<ipc::Service, [E], H>,
    trace: Trace,
    lost_before: u64,
}

impl<H: Traced, E: Element> Received<H, E> {
    /// The header as sent.
    pub fn header(&self) -> &H {
        self.sample.user_header()
    }

    /// The payload, in shared memory.
    pub fn payload(&self) -> &[E] {
        self.sample.payload()
    }

    /// The trace with this receipt stamped, for the message that follows from this one.
    pub fn trace(&self) -> Trace {
        self.trace
    }

    /// Messages lost between the one before and this one.
    pub fn lost_before(&self) -> u64 {
        self.lost_before
    }
}

/// Counts what is missing in a row of sequence numbers.
#[derive(Debug, Default)]
struct GapCount {
    first: Option<u64>,
    next: Option<u64>,
    lost: u64,
}

impl GapCount {
    /// Takes the next sequence number and returns how many are missing before it. The first one counts as
    /// joined late, a smaller one as a restarted publisher: nothing is missing then.
    fn take(&mut self, sequence: u64) -> u64 {
        let missing = self.next.map_or(0, |next| sequence.saturating_sub(next));
        self.first.get_or_insert(sequence);
        self.next = Some(sequence + 1);
        self.lost += missing;
        missing
    }
}

#[cfg(test)]
mod tests {
    use super::GapCount;
    use proptest::prelude::*;

    #[test]
    fn a_late_start_and_a_restart_are_no_loss() {
        let mut gaps = GapCount::default();
        assert_eq!([7, 8, 0, 1].map(|sequence| gaps.take(sequence)), [0, 0, 0, 0]);
        assert_eq!((gaps.lost, gaps.first, gaps.next), (0, Some(7), Some(2)));
    }

    proptest! {
        #[test]
        fn every_sequence_number_left_out_is_counted(kept in prop::collection::vec(any::<bool>(), 1..200)) {
            let mut gaps = GapCount::default();
            let sequence: Vec<u64> =
                kept.iter().enumerate().filter(|(_, kept)| **kept).map(|(index, _)| index as u64).collect();
            sequence.iter().for_each(|sequence| { gaps.take(*sequence); });
            let expected = match (sequence.first(), sequence.last()) {
                (Some(first), Some(last)) => last - first + 1 - sequence.len() as u64,
                _ => 0,
            };
            prop_assert_eq!(gaps.lost, expected);
        }
    }
}
