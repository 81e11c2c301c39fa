//! One connection to the amplifier: made, started, checked.

use std::error::Error;
use std::io::{self, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

use tendon_link::{
    ConnectError, Connector, Decode, Goodbye, Instants, Link, accept, check_rate, listen, read_before,
    stay_ready,
};
use tendon_otb::{Amplifier, Decoder, Dialling, Layout, OtbSettings, OtbSettingsError};
use tendon_source::{Offer, OfferedChannel};

/// How long one try waits for the amplifier to dial in, or to answer.
const DIALLING: Duration = Duration::from_secs(1);
/// How long a Sessantaquattro may take for the samples that show how wide an instant is.
const WIDTH: Duration = Duration::from_secs(5);
/// Time over which the rate is measured before the amplifier is used.
const CHECKED: Duration = Duration::from_secs(1);

/// Connects to one amplifier.
pub struct OtbConnector {
    amplifier: Amplifier,
    /// Where it is, or where it dials in.
    address: SocketAddr,
    /// Of an amplifier that dials in.
    listener: Option<TcpListener>,
}

/// Why there is no connector.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The amplifier has no such setting.
    #[error("acquisition.otb")]
    Settings(#[source] OtbSettingsError),
    /// Nothing can dial in here.
    #[error(
        "cannot wait for the {name} at {address} (acquisition.otb.address): does another program use this port, such as the \
         vendor's, or has this computer no such address?"
    )]
    Listen {
        /// The amplifier.
        name: &'static str,
        /// Where.
        address: SocketAddr,
        /// The system's reason.
        source: io::Error,
    },
}

impl OtbConnector {
    /// For the amplifier of these settings, at this rate.
    ///
    /// # Errors
    ///
    /// [`OpenError`].
    pub fn new(settings: &OtbSettings, rate_hz: f64) -> Result<OtbConnector, OpenError> {
        let amplifier = settings.amplifier(rate_hz).map_err(OpenError::Settings)?;
        let address = settings.address_of(&amplifier);
        let listener = match amplifier.dialling() {
            Dialling::Device { .. } => {
                let failed = |source| OpenError::Listen { name: amplifier.name(), address, source };
                Some(listen(address).map_err(failed)?)
            }
            Dialling::Computer { .. } => None,
        };
        Ok(OtbConnector { amplifier, address, listener })
    }

    /// The stream to the amplifier and where it is.
    fn dial(&self) -> Result<(TcpStream, SocketAddr), ConnectError> {
        let (name, address) = (self.amplifier.name(), self.address);
        let Some(listener) = &self.listener else {
            let dialled = TcpStream::connect_timeout(&address, DIALLING);
            let stream = dialled.map_err(|error| {
                ConnectError::not_yet(format!(
                    "the {name} does not answer at {address} ({error}): is it on, and has this computer an address in its \
                     network?"
                ))
            })?;
            return Ok((stream, address));
        };
        accept(listener, DIALLING).map_err(ConnectError::not_yet)?.ok_or_else(|| {
            ConnectError::not_yet(format!(
                "waiting for the {name} to dial in at {address}: switch it on, and join its Wi-Fi network, or make it join this \
                 computer's and name this computer on its web page"
            ))
        })
    }

    /// The layout of its instants, and the bytes that were read to find it.
    fn layout(&self, stream: &TcpStream) -> Result<(Layout, Vec<u8>), ConnectError> {
        let mut layout = self.amplifier.layout(0);
        let mut bytes = Vec::new();
        if !matches!(self.amplifier, Amplifier::Sessantaquattro(_)) {
            return Ok((layout, bytes));
        }
        let until = Instant::now() + WIDTH;
        let mut buffer = [0; 4096];
        loop {
            let found = tendon_otb::find_accessories(layout.emg_channels, &bytes);
            if let Some(accessories) = found.map_err(ConnectError::unfit)? {
                layout = self.amplifier.layout(accessories);
                return Ok((layout, bytes));
            }
            match read_before(stream, &mut buffer, until).map_err(ConnectError::not_yet)? {
                Some(count) if count > 0 => bytes.extend_from_slice(&buffer[..count]),
                _ => {
                    let text = format!("the {} dialled in but sends no samples", self.amplifier.name());
                    return Err(ConnectError::not_yet(text));
                }
            }
        }
    }
}

impl Connector for OtbConnector {
    fn connect(&mut self) -> Result<Link, ConnectError> {
        let (mut stream, peer) = self.dial()?;
        let name = format!("{} at {}", self.amplifier.name(), peer.ip());
        let broken =
            |error: io::Error| ConnectError::not_yet(format!("{name}: the connection broke ({error})"));
        stream.set_nodelay(true).map_err(broken)?;
        stay_ready(&stream).map_err(broken)?;
        if matches!(self.amplifier, Amplifier::Quattrocento(_)) {
            // If it was left streaming, what comes would not begin with an instant.
            stream.write_all(&self.amplifier.stop_word()).map_err(broken)?;
        }
        stream.write_all(&self.amplifier.start_word()).map_err(broken)?;
        let goodbye = Goodbye {
            stream: OwnedFd::from(stream.try_clone().map_err(broken)?),
            bytes: self.amplifier.stop_word(),
        };
        let (layout, bytes) = self.layout(&stream)?;
        let mut decoder = OtbDecoder(Decoder::new(layout));
        decoder.push(&bytes, &mut |_| {}).map_err(ConnectError::not_yet)?;
        check_rate(&stream, &mut decoder, layout.emg_channels, layout.rate_hz, CHECKED)
            .map_err(|error| ConnectError::not_yet(Unchecked { name: name.clone(), source: error }))?;
        Ok(Link {
            goodbye: Some(goodbye),
            stream: stream.into(),
            decoder: Box::new(decoder),
            offer: offer(&layout),
            name,
            shows_losses: true,
        })
    }

    fn listener(&self) -> Option<&TcpListener> {
        self.listener.as_ref()
    }
}

/// An amplifier whose first second is not as it should be.
#[derive(Debug, thiserror::Error)]
#[error("{name}")]
struct Unchecked {
    name: String,
    source: tendon_link::RateError,
}

/// What the amplifier measures: its EMG channels, counted from 1 as on its connectors.
fn offer(layout: &Layout) -> Offer {
    let channels = (1..=layout.emg_channels).map(|number| OfferedChannel {
        name: format!("EMG {number}"),
        unit: "mV".to_owned(),
        is_emg: true,
    });
    Offer { sample_rate_hz: layout.rate_hz, channels: channels.collect() }
}

struct OtbDecoder(Decoder);

impl Decode for OtbDecoder {
    fn push(
        &mut self,
        bytes: &[u8],
        take: &mut dyn FnMut(Instants<'_>),
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        let decoded = self.0.push(bytes, |run| {
            take(Instants { first_sample: run.first_sample, instants: run.instants_mv });
        });
        Ok(decoded?)
    }
}
