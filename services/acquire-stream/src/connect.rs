//! One connection of a program: accepted, its header read, its samples checked.

use std::error::Error;
use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use tendon_link::{
    ConnectError, Connector, Decode, Instants, Link, accept, check_rate, listen, read_before, stay_ready,
};
use tendon_source::{Offer, OfferedChannel};
use tendon_stream::{Decoder, Header, StreamSettings};

/// How long one try waits for a program.
const DIALLING: Duration = Duration::from_secs(1);
/// How long a program may take for its header.
const HEADER: Duration = Duration::from_secs(2);
/// Time over which the rate is measured before the program is used.
const CHECKED: Duration = Duration::from_secs(1);

/// Waits for programs that send samples.
pub struct StreamConnector {
    address: SocketAddr,
    listener: TcpListener,
}

/// Nobody can connect here.
#[derive(Debug, thiserror::Error)]
#[error(
    "cannot wait for a program at {address} (acquisition.stream.address): does another program use this port, or has this \
     computer no such address?"
)]
pub struct ListenError {
    address: SocketAddr,
    source: io::Error,
}

/// A program whose samples are not as they should be.
#[derive(Debug, thiserror::Error)]
#[error("{name}")]
struct Unfit {
    name: String,
    source: Box<dyn Error + Send + Sync>,
}

impl StreamConnector {
    /// Listens.
    ///
    /// # Errors
    ///
    /// [`ListenError`].
    pub fn new(settings: &StreamSettings) -> Result<StreamConnector, ListenError> {
        let address = settings.address;
        let listener = listen(address).map_err(|source| ListenError { address, source })?;
        Ok(StreamConnector { address, listener })
    }
}

impl Connector for StreamConnector {
    fn connect(&mut self) -> Result<Link, ConnectError> {
        let accepted = accept(&self.listener, DIALLING).map_err(ConnectError::not_yet)?;
        let Some((stream, peer)) = accepted else {
            let address = self.address;
            let text =
                format!("waiting for a program that sends samples to {address} (docs/amplifier.md has one)");
            return Err(ConnectError::not_yet(text));
        };
        let name = format!("the program at {peer}");
        let unfit = |source: Box<dyn Error + Send + Sync>| {
            ConnectError::not_yet(Unfit { name: name.clone(), source })
        };
        stay_ready(&stream).map_err(|error| unfit(error.into()))?;
        let (header, bytes) = read_header(&stream).map_err(unfit)?;
        let channels = header.channels.len();
        let mut decoder = StreamDecoder(Decoder::new(channels, header.rate_hz));
        decoder.push(&bytes, &mut |_| {}).map_err(unfit)?;
        check_rate(&stream, &mut decoder, channels, header.rate_hz, CHECKED)
            .map_err(|error| unfit(error.into()))?;
        let offered = |name: String| OfferedChannel { name, unit: header.unit.clone(), is_emg: true };
        Ok(Link {
            goodbye: None,
            stream: stream.into(),
            decoder: Box::new(decoder),
            offer: Offer {
                sample_rate_hz: header.rate_hz,
                channels: header.channels.into_iter().map(offered).collect(),
            },
            name: if header.name.is_empty() { name } else { format!("{} at {peer}", header.name) },
            shows_losses: true,
        })
    }

    fn listener(&self) -> Option<&TcpListener> {
        Some(&self.listener)
    }
}

/// The header, and the bytes that came after it.
fn read_header(stream: &TcpStream) -> Result<(Header, Vec<u8>), Box<dyn Error + Send + Sync>> {
    let until = Instant::now() + HEADER;
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        if let Some((header, length)) = Header::parse(&bytes)? {
            return Ok((header, bytes.split_off(length)));
        }
        match read_before(stream, &mut buffer, until)? {
            Some(count) if count > 0 => bytes.extend_from_slice(&buffer[..count]),
            Some(_) => return Err("it hung up before it sent its header".into()),
            None => return Err("it connected but sent no header: one line of JSON comes first".into()),
        }
    }
}

struct StreamDecoder(Decoder);

impl Decode for StreamDecoder {
    fn push(
        &mut self,
        bytes: &[u8],
        take: &mut dyn FnMut(Instants<'_>),
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        let decoded = self.0.push(bytes, |run| {
            take(Instants { first_sample: run.first_sample, instants: run.instants });
        });
        Ok(decoded?)
    }
}
