//! The threads of the two report connections.

use std::io::{ErrorKind, Read};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::{ClientSettings, Shared, lock};
use crate::report::{Decoder, Kind};

/// A report connection without data for so long is made anew.
const SILENCE: Duration = Duration::from_secs(1);

/// Reads the reports of one connection, and connects again whenever it breaks.
pub(super) fn read_reports(shared: &Shared, settings: &ClientSettings, kind: Kind, address: SocketAddr) {
    while !shared.ended.load(Ordering::SeqCst) {
        let connected = TcpStream::connect_timeout(&address, settings.connect_timeout).and_then(|stream| {
            stream.set_read_timeout(Some(SILENCE))?;
            Ok(stream)
        });
        if let Ok(mut stream) = connected {
            read_connection(shared, &mut stream, kind);
        }
        if !shared.ended.load(Ordering::SeqCst) {
            std::thread::sleep(settings.reconnect_period);
        }
    }
}

/// Until the connection breaks, falls silent, or the client ends.
fn read_connection(shared: &Shared, stream: &mut TcpStream, kind: Kind) {
    let mut buffer = [0; 4096];
    let mut decoder = Decoder::new(kind);
    while !shared.ended.load(Ordering::SeqCst) {
        let length = match stream.read(&mut buffer) {
            Ok(0) => return,
            Ok(length) => length,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        let mut input = &buffer[..length];
        while let Some(report) = decoder.next_report(&mut input) {
            if lock(&shared.known).take_report(&report) {
                shared.wake();
            }
        }
    }
}
