//! ZeroMQ: PUSH to PULL over `ipc://`, its input-output threads scheduled as the process that starts them.

use std::path::Path;

use anyhow::{Context, ensure};

use super::{Bytes, Lane, Receiver, Sender};

fn address(lane: Lane, directory: &Path) -> String {
    format!("ipc://{}/zeromq-{}", directory.display(), lane.channels)
}

pub struct ZeromqSender {
    socket: zmq::Socket,
    bytes: Bytes,
}

impl ZeromqSender {
    pub fn open(lane: Lane, directory: &Path) -> anyhow::Result<ZeromqSender> {
        let socket = zmq::Context::new().socket(zmq::PUSH).context("cannot make a ZeroMQ socket")?;
        socket.connect(&address(lane, directory)).context("cannot connect to the ZeroMQ receiver")?;
        Ok(ZeromqSender { socket, bytes: Bytes::of(lane) })
    }
}

impl Sender for ZeromqSender {
    fn send(&mut self, block: &[f32]) -> anyhow::Result<()> {
        self.socket.send(self.bytes.write(block), 0).context("cannot send through ZeroMQ")
    }
}

pub struct ZeromqReceiver {
    socket: zmq::Socket,
    bytes: Bytes,
}

impl ZeromqReceiver {
    pub fn open(lane: Lane, directory: &Path) -> anyhow::Result<ZeromqReceiver> {
        let socket = zmq::Context::new().socket(zmq::PULL).context("cannot make a ZeroMQ socket")?;
        socket.bind(&address(lane, directory)).context("cannot bind a ZeroMQ socket")?;
        Ok(ZeromqReceiver { socket, bytes: Bytes::of(lane) })
    }
}

impl Receiver for ZeromqReceiver {
    fn receive(&mut self) -> anyhow::Result<u64> {
        let length = self.socket.recv_into(&mut self.bytes.0, 0).context("cannot receive from ZeroMQ")?;
        let transit_ns = self.bytes.transit_ns();
        ensure!(length == self.bytes.0.len(), "a message of {length} bytes came, none of this lane's");
        Ok(transit_ns)
    }
}
