//! iceoryx2 as its own examples use it: publish-subscribe, and an event that wakes the receiver.

use anyhow::anyhow;
use iceoryx2::config::Config;
use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::{LogLevel, NodeBuilder, ServiceName, SignalHandlingMode, ipc, set_log_level};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use tendon_messages::BLOCKS;
use tendon_transport::now_ns;

use super::{Lane, Receiver, Sender};

/// The stamp is the message's user header.
type Blocks = publish_subscribe::PortFactory<ipc::Service, [f32], u64>;
type Wakes = event::PortFactory<ipc::Service>;

fn open(lane: Lane) -> anyhow::Result<(Blocks, Wakes)> {
    set_log_level(LogLevel::Fatal);
    let node: Node<ipc::Service> = NodeBuilder::new()
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .config(&Config::default())
        .create()
        .map_err(|error| failed("join", &error))?;
    let name = ServiceName::new(&format!("tendon-bench-{}", lane.channels))
        .map_err(|error| failed("name the service", &error))?;
    let blocks = node
        .service_builder(&name)
        .publish_subscribe::<[f32]>()
        .user_header::<u64>()
        .subscriber_max_buffer_size(BLOCKS.buffer)
        .open_or_create()
        .map_err(|error| failed("open the service", &error))?;
    let wakes = node
        .service_builder(&name)
        .event()
        .open_or_create()
        .map_err(|error| failed("open the event", &error))?;
    Ok((blocks, wakes))
}

fn failed(what: &str, error: &dyn core::fmt::Debug) -> anyhow::Error {
    anyhow!("bare iceoryx2: cannot {what}: {error:?}")
}

pub struct BareSender {
    publisher: Publisher<ipc::Service, [f32], u64>,
    notifier: Notifier<ipc::Service>,
}

impl BareSender {
    pub fn open(lane: Lane) -> anyhow::Result<BareSender> {
        let (blocks, wakes) = open(lane)?;
        let publisher = blocks
            .publisher_builder()
            .initial_max_slice_len(lane.block_length())
            .create()
            .map_err(|error| failed("create a publisher", &error))?;
        let notifier =
            wakes.notifier_builder().create().map_err(|error| failed("create a notifier", &error))?;
        Ok(BareSender { publisher, notifier })
    }
}

impl Sender for BareSender {
    fn send(&mut self, block: &[f32]) -> anyhow::Result<()> {
        let loan =
            self.publisher.loan_slice_uninit(block.len()).map_err(|error| failed("loan a slice", &error))?;
        let mut message = loan.write_from_slice(block);
        *message.user_header_mut() = now_ns();
        message.send().map_err(|error| failed("send", &error))?;
        self.notifier.notify().map_err(|error| failed("notify", &error))?;
        Ok(())
    }
}

pub struct BareReceiver {
    subscriber: Subscriber<ipc::Service, [f32], u64>,
    listener: Listener<ipc::Service>,
}

impl BareReceiver {
    pub fn open(lane: Lane) -> anyhow::Result<BareReceiver> {
        let (blocks, wakes) = open(lane)?;
        let subscriber = blocks
            .subscriber_builder()
            .buffer_size(BLOCKS.buffer)
            .create()
            .map_err(|error| failed("create a subscriber", &error))?;
        let listener =
            wakes.listener_builder().create().map_err(|error| failed("create a listener", &error))?;
        Ok(BareReceiver { subscriber, listener })
    }
}

impl Receiver for BareReceiver {
    fn receive(&mut self) -> anyhow::Result<u64> {
        loop {
            if let Some(message) = self.subscriber.receive().map_err(|error| failed("receive", &error))? {
                return Ok(now_ns().saturating_sub(*message.user_header()));
            }
            self.listener.blocking_wait(|_| {}).map_err(|error| failed("wait", &error))?;
        }
    }
}
