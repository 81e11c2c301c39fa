//! The plainest way: a Unix datagram socket, one datagram a block.

use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};

use super::{Bytes, Lane, Receiver, Sender};

fn path(lane: Lane, directory: &Path) -> PathBuf {
    directory.join(format!("socket-{}", lane.channels))
}

pub struct SocketSender {
    socket: UnixDatagram,
    bytes: Bytes,
}

impl SocketSender {
    pub fn open(lane: Lane, directory: &Path) -> anyhow::Result<SocketSender> {
        let socket = UnixDatagram::unbound().context("cannot make a Unix socket")?;
        socket.connect(path(lane, directory)).context("cannot connect to the receiver's Unix socket")?;
        Ok(SocketSender { socket, bytes: Bytes::of(lane) })
    }
}

impl Sender for SocketSender {
    fn send(&mut self, block: &[f32]) -> anyhow::Result<()> {
        self.socket.send(self.bytes.write(block)).context("cannot send to the Unix socket")?;
        Ok(())
    }
}

pub struct SocketReceiver {
    socket: UnixDatagram,
    bytes: Bytes,
}

impl SocketReceiver {
    pub fn open(lane: Lane, directory: &Path) -> anyhow::Result<SocketReceiver> {
        let socket = UnixDatagram::bind(path(lane, directory)).context("cannot bind a Unix socket")?;
        Ok(SocketReceiver { socket, bytes: Bytes::of(lane) })
    }
}

impl Receiver for SocketReceiver {
    fn receive(&mut self) -> anyhow::Result<u64> {
        let length = self.socket.recv(&mut self.bytes.0).context("cannot receive from the Unix socket")?;
        let transit_ns = self.bytes.transit_ns();
        ensure!(length == self.bytes.0.len(), "a datagram of {length} bytes came, none of this lane's");
        Ok(transit_ns)
    }
}
