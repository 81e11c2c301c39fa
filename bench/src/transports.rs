//! The ways a block can go from one process to another, all measured by the same rule: transit is from right
//! before the sender's call that hands the message over to right after the receiver has it.

mod bare_iceoryx2;
mod tendon;
mod unix_socket;
#[cfg(feature = "peers")]
mod zeromq;

use std::path::Path;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use tendon_transport::{SessionName, now_ns};

/// A way to hand over messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Transport {
    /// `tendon_transport`'s ports and the stages' own blocking wait.
    Tendon,
    /// iceoryx2's publish-subscribe with an event, and nothing of ours.
    BareIceoryx2,
    /// A Unix datagram socket.
    UnixSocket,
    /// ZeroMQ, PUSH to PULL over `ipc://`.
    #[cfg(feature = "peers")]
    Zeromq,
}

impl Transport {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Transport::Tendon => "tendon",
            Transport::BareIceoryx2 => "bare iceoryx2",
            Transport::UnixSocket => "Unix socket",
            #[cfg(feature = "peers")]
            Transport::Zeromq => "ZeroMQ",
        }
    }
}

/// One sender-receiver pair of processes: a transport and the size of its messages.
#[derive(Clone, Copy, Debug)]
pub struct Lane {
    /// The transport.
    pub transport: Transport,
    /// Channels of a block.
    pub channels: usize,
}

/// Samples of each channel in a block.
pub const BLOCK_SAMPLES: usize = 10;

impl Lane {
    /// All lanes, in the order they take turns.
    pub fn all() -> Vec<Lane> {
        Transport::value_variants()
            .iter()
            .flat_map(|transport| [4, 64].map(|channels| Lane { transport: *transport, channels }))
            .collect()
    }

    /// Samples of all channels in a block.
    pub fn block_length(self) -> usize {
        self.channels * BLOCK_SAMPLES
    }

    /// The session the lane's blocks go through. The names are fixed, so that two benchmarks cannot disturb
    /// each other unnoticed.
    pub fn session_name(self) -> SessionName {
        let name = format!("bench-{}", self.channels);
        name.parse().expect("the name is made of letters, a hyphen and digits")
    }

    /// The receiving end; `directory` is for sockets. Opened before the sending end.
    pub fn receiver(self, directory: &Path) -> anyhow::Result<Box<dyn Receiver>> {
        Ok(match self.transport {
            Transport::Tendon => Box::new(tendon::TendonReceiver::open(self)?),
            Transport::BareIceoryx2 => Box::new(bare_iceoryx2::BareReceiver::open(self)?),
            Transport::UnixSocket => Box::new(unix_socket::SocketReceiver::open(self, directory)?),
            #[cfg(feature = "peers")]
            Transport::Zeromq => Box::new(zeromq::ZeromqReceiver::open(self, directory)?),
        })
    }

    /// The sending end.
    pub fn sender(self, directory: &Path) -> anyhow::Result<Box<dyn Sender>> {
        Ok(match self.transport {
            Transport::Tendon => Box::new(tendon::TendonSender::open(self)?),
            Transport::BareIceoryx2 => Box::new(bare_iceoryx2::BareSender::open(self)?),
            Transport::UnixSocket => Box::new(unix_socket::SocketSender::open(self, directory)?),
            #[cfg(feature = "peers")]
            Transport::Zeromq => Box::new(zeromq::ZeromqSender::open(self, directory)?),
        })
    }
}

/// The sending end of a lane.
pub trait Sender {
    /// Sends a block, stamped with the time of sending.
    fn send(&mut self, block: &[f32]) -> anyhow::Result<()>;
}

/// The receiving end of a lane.
pub trait Receiver {
    /// Sleeps until the next message is there and returns its transit in ns.
    fn receive(&mut self) -> anyhow::Result<u64>;
}

/// A message where it has to be bytes: 8 of the stamp, then the samples.
struct Bytes(Vec<u8>);

const STAMP_SIZE: usize = size_of::<u64>();

impl Bytes {
    fn of(lane: Lane) -> Bytes {
        Bytes(vec![0; STAMP_SIZE + lane.block_length() * size_of::<f32>()])
    }

    /// Writes the block, then the time.
    fn write(&mut self, block: &[f32]) -> &[u8] {
        let (stamp, samples) = self.0.split_at_mut(STAMP_SIZE);
        for (bytes, sample) in samples.chunks_exact_mut(size_of::<f32>()).zip(block) {
            bytes.copy_from_slice(&sample.to_ne_bytes());
        }
        stamp.copy_from_slice(&now_ns().to_ne_bytes());
        &self.0
    }

    /// Time since the message was stamped, in ns.
    fn transit_ns(&self) -> u64 {
        let received_ns = now_ns();
        let stamp = self.0.first_chunk().expect("`Bytes::of` makes room for the stamp");
        received_ns.saturating_sub(u64::from_ne_bytes(*stamp))
    }
}
