//! Tendon's own hop, as dsp receives blocks from acquisition.

use std::os::fd::AsFd;

use anyhow::bail;
use tendon_messages::{BLOCKS, BlockHeader, Stage};
use tendon_process::{Control, Wake};
use tendon_transport::{Delivery, Publisher, Session, Subscriber};

use super::{Lane, Receiver, Sender};

pub struct TendonSender {
    publisher: Publisher<BlockHeader, f32>,
}

impl TendonSender {
    pub fn open(lane: Lane) -> anyhow::Result<TendonSender> {
        let session = Session::join(&lane.session_name(), "bench-send")?;
        let stop = std::sync::Arc::default();
        let publisher = Publisher::open(&session, &BLOCKS, lane.block_length(), Delivery::Live, stop)?;
        Ok(TendonSender { publisher })
    }
}

impl Sender for TendonSender {
    fn send(&mut self, block: &[f32]) -> anyhow::Result<()> {
        self.publisher.publish(BlockHeader::default(), block.len(), |payload| {
            payload.copy_from_slice(block);
        })?;
        Ok(())
    }
}

pub struct TendonReceiver {
    subscriber: Subscriber<BlockHeader, f32>,
    control: Control,
}

impl TendonReceiver {
    pub fn open(lane: Lane) -> anyhow::Result<TendonReceiver> {
        let session = Session::join(&lane.session_name(), "bench-receive")?;
        let subscriber = Subscriber::open(&session, &BLOCKS, Some(Stage::Dsp), Delivery::Live)?;
        Ok(TendonReceiver { subscriber, control: Control::install()? })
    }
}

impl Receiver for TendonReceiver {
    fn receive(&mut self) -> anyhow::Result<u64> {
        loop {
            if let Some(message) = self.subscriber.receive()? {
                let trace = message.trace();
                let received_ns = trace.received_ns[Stage::Dsp.index()];
                return Ok(received_ns.saturating_sub(trace.published_ns[Stage::Acquisition.index()]));
            }
            match self.control.wait(Some(self.subscriber.as_fd()), None)? {
                Wake::Message => self.subscriber.acknowledge_wakes()?,
                Wake::Stop => bail!("told to stop"),
                Wake::Order(_) | Wake::Deadline => {}
            }
        }
    }
}
