//! One connection to the server: sensors asked for, started, checked.

use std::error::Error;
use std::io::{self, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::fd::OwnedFd;
use std::time::{Duration, Instant};

use tendon_delsys::{DelsysSettings, Replies, SLOTS, command, frame_rate_hz, holds_one_muscle, is_yes};
use tendon_link::{ConnectError, Connector, Goodbye, Link, check_rate, read_before, stay_ready};
use tendon_source::{Offer, OfferedChannel};

use crate::decode::SlotDecoder;

/// How long one try waits for the server.
const DIALLING: Duration = Duration::from_secs(1);
/// How long the server may take for a reply. Its hardware answers to START.
const REPLY: Duration = Duration::from_secs(5);
/// Time over which the rate is measured: 2000 Hz and 1926 Hz, which servers confuse, differ clearly then.
const CHECKED: Duration = Duration::from_secs(2);
/// What the server is set to: little-endian, all sensors at one rate, no triggers.
const SET_UP: [&str; 5] =
    ["ENDIAN LITTLE", "BACKWARDS COMPATIBILITY ON", "UPSAMPLE ON", "TRIGGER START OFF", "TRIGGER STOP OFF"];

/// Connects to one server.
pub struct DelsysConnector {
    commands: SocketAddr,
    emg: SocketAddr,
}

type Reason = Box<dyn Error + Send + Sync>;

/// What the server says to a command.
#[derive(Debug, thiserror::Error)]
enum DialogError {
    #[error("the Trigno server at {address}: the connection broke")]
    Broken { address: SocketAddr, source: io::Error },
    #[error(
        "the Trigno server at {address} does not answer to {asked}: is this the Trigno Control Utility, and its base connected?"
    )]
    Silent { address: SocketAddr, asked: String },
    #[error(
        "the Trigno server at {address} answers `{reply}` to {asked}: end what else measures with it, and try again"
    )]
    Refused { address: SocketAddr, asked: String, reply: String },
    #[error("the Trigno server at {address}")]
    Reply { address: SocketAddr, source: tendon_delsys::ReplyError },
}

impl DelsysConnector {
    /// For the server of these settings.
    pub fn new(settings: &DelsysSettings) -> DelsysConnector {
        DelsysConnector {
            commands: SocketAddr::new(settings.address, settings.command_port),
            emg: SocketAddr::new(settings.address, settings.emg_port),
        }
    }
}

impl Connector for DelsysConnector {
    fn connect(&mut self) -> Result<Link, ConnectError> {
        let mut dialog = Dialog::open(self.commands)?;
        // A run that was left going would not take settings. When none is, this is an error that means nothing.
        dialog.ask("STOP").map_err(ConnectError::not_yet)?;
        for setting in SET_UP {
            dialog.obey(setting).map_err(ConnectError::not_yet)?;
        }
        let slots = dialog.sensors()?;
        let interval = dialog.ask("FRAME INTERVAL?").map_err(ConnectError::not_yet)?;
        let samples = dialog.ask("MAX SAMPLES EMG?").map_err(ConnectError::not_yet)?;
        let rate_hz = frame_rate_hz(&interval, &samples).map_err(ConnectError::unfit)?;
        let emg = dial(self.emg)?;
        let goodbye = Goodbye {
            stream: OwnedFd::from(dialog.stream.try_clone().map_err(ConnectError::not_yet)?),
            bytes: [command("STOP"), command("QUIT")].concat(),
        };
        dialog.obey("START").map_err(ConnectError::not_yet)?;
        let mut decoder = SlotDecoder::new(rate_hz, &slots);
        let name = format!("Trigno at {}", self.emg.ip());
        check_rate(&emg, &mut decoder, slots.len(), rate_hz, CHECKED)
            .map_err(|source| ConnectError::not_yet(Unchecked { name: name.clone(), source }))?;
        check_slots(&decoder)?;
        decoder.watch();
        let offered = |slot: usize| OfferedChannel {
            name: format!("slot {}", slot + 1),
            unit: "V".to_owned(),
            is_emg: true,
        };
        Ok(Link {
            goodbye: Some(goodbye),
            stream: emg.into(),
            decoder: Box::new(decoder),
            offer: Offer { sample_rate_hz: rate_hz, channels: slots.into_iter().map(offered).collect() },
            name,
            shows_losses: false,
        })
    }
}

/// A server whose first seconds are not as they should be.
#[derive(Debug, thiserror::Error)]
#[error("{name}")]
struct Unchecked {
    name: String,
    source: tendon_link::RateError,
}

/// Whether samples come in the columns of the paired slots and in no others: documents disagree on the columns.
fn check_slots(decoder: &SlotDecoder) -> Result<(), ConnectError> {
    let (silent, unexpected) = decoder.misplaced();
    let list = |slots: &[usize]| slots.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    if !unexpected.is_empty() {
        return Err(ConnectError::unfit(format!(
            "samples come in columns {} though no sensor is paired there: pair the sensors again in the Trigno Control Utility, \
             from slot 1 on",
            list(&unexpected)
        )));
    }
    if !silent.is_empty() {
        return Err(ConnectError::not_yet(format!(
            "the sensors in slots {} send nothing: take them out of the charger, or unpair them",
            list(&silent)
        )));
    }
    Ok(())
}

fn dial(address: SocketAddr) -> Result<TcpStream, ConnectError> {
    let dialled = TcpStream::connect_timeout(&address, DIALLING);
    let stream = dialled.map_err(|error| {
        ConnectError::not_yet(format!(
            "the Trigno server does not answer at {address} ({error}): does the Trigno Control Utility run there, and does its \
             firewall let this computer in (acquisition.delsys)?"
        ))
    })?;
    stream.set_nodelay(true).and_then(|()| stay_ready(&stream)).map_err(ConnectError::not_yet)?;
    Ok(stream)
}

/// Commands and their replies.
struct Dialog {
    address: SocketAddr,
    stream: TcpStream,
    replies: Replies,
}

impl Dialog {
    fn open(address: SocketAddr) -> Result<Dialog, ConnectError> {
        let mut dialog = Dialog { address, stream: dial(address)?, replies: Replies::default() };
        // The greeting.
        dialog.reply("a connection").map_err(ConnectError::not_yet)?;
        Ok(dialog)
    }

    fn ask(&mut self, text: &str) -> Result<String, DialogError> {
        let address = self.address;
        self.stream.write_all(&command(text)).map_err(|source| DialogError::Broken { address, source })?;
        self.reply(text)
    }

    fn obey(&mut self, text: &str) -> Result<(), DialogError> {
        let reply = self.ask(text)?;
        if reply.starts_with("OK") {
            return Ok(());
        }
        Err(DialogError::Refused { address: self.address, asked: text.to_owned(), reply })
    }

    fn reply(&mut self, asked: &str) -> Result<String, DialogError> {
        let address = self.address;
        let until = Instant::now() + REPLY;
        let mut buffer = [0; 1024];
        loop {
            let reply = self.replies.next_reply().map_err(|source| DialogError::Reply { address, source })?;
            if let Some(reply) = reply {
                return Ok(reply);
            }
            match read_before(&self.stream, &mut buffer, until) {
                Ok(Some(count)) if count > 0 => self.replies.push(&buffer[..count]),
                Ok(_) => return Err(DialogError::Silent { address, asked: asked.to_owned() }),
                Err(source) => return Err(DialogError::Broken { address, source }),
            }
        }
    }

    /// Slots with a sensor, counted from 0.
    fn sensors(&mut self) -> Result<Vec<usize>, ConnectError> {
        let mut slots = Vec::new();
        for slot in 0..SLOTS {
            let number = slot + 1;
            let paired = self.ask(&format!("SENSOR {number} PAIRED?")).map_err(ConnectError::not_yet)?;
            if !is_yes(&paired) {
                continue;
            }
            let kind = self.ask(&format!("SENSOR {number} TYPE?")).map_err(ConnectError::not_yet)?;
            if !holds_one_muscle(&kind) {
                let text = format!(
                    "the sensor in slot {number} has several EMG channels (type {kind}): which columns they have is not certain \
                     enough; use sensors with one, or the Lab Streaming Layer"
                );
                return Err(ConnectError::unfit(text));
            }
            slots.push(slot);
        }
        if slots.is_empty() {
            let reason: Reason = "no sensor is paired: pair them in the Trigno Control Utility".into();
            return Err(ConnectError::NotYet(reason));
        }
        Ok(slots)
    }
}
