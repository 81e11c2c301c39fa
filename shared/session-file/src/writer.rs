//! Writing the file of a session.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::time::SystemTime;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, WriteOptions};
use tendon_messages::Stage;

use crate::records::Message;
use crate::schemas::{BLOCK_ENCODING, CHANNELS, ChannelKind, JSON_ENCODING};
use crate::{PROFILE, VERSION};

/// Bytes after which a chunk is closed, whatever the time: what a damaged byte spoils in a replay at full speed.
const LARGEST_CHUNK: u64 = 96 << 10;

/// The file cannot be written any further.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The system refused, such as for a full disk.
    #[error(transparent)]
    System(#[from] std::io::Error),
    /// The file's own rules forbid it.
    #[error(transparent)]
    Format(McapError),
}

impl From<McapError> for WriteError {
    fn from(error: McapError) -> WriteError {
        match error {
            McapError::Io(error) => WriteError::System(error),
            error => WriteError::Format(error),
        }
    }
}

/// Writes the file of a session: what is attached first, then messages, in any order, then [`Writer::finish`]. What was
/// written before the last [`Writer::flush`] can be read, however the writer ends.
pub struct Writer<W: Write + Seek> {
    file: mcap::Writer<W>,
    /// By the place of the channel.
    channels: [u16; CHANNELS.len()],
    /// Messages of each channel so far.
    counts: [u32; CHANNELS.len()],
    /// From CLOCK_MONOTONIC to the time of day, ns.
    offset_ns: u64,
    bytes: Vec<u8>,
}

impl<W: Write + Seek> std::fmt::Debug for Writer<W> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Writer").field("counts", &self.counts).finish_non_exhaustive()
    }
}

impl<W: Write + Seek> Writer<W> {
    /// Begins the file of the session `name` at `now_ns` of CLOCK_MONOTONIC.
    ///
    /// # Errors
    ///
    /// [`WriteError`].
    pub fn begin(output: W, name: &str, now_ns: u64) -> Result<Writer<W>, WriteError> {
        // Each chunk is gathered in memory and written at once: a file that was cut has whole ones and one piece.
        let options = WriteOptions::new().compression(None).profile(PROFILE).disable_seeking(true);
        let options = options.chunk_size(Some(LARGEST_CHUNK));
        let mut file = options.create(output)?;
        let since_1970 = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let offset_ns = (since_1970.as_nanos() as u64).saturating_sub(now_ns);
        let mut channels = [0; CHANNELS.len()];
        for (kind, id) in CHANNELS.into_iter().zip(&mut channels) {
            let (name, encoding, text) = kind.schema();
            let schema = file.add_schema(name, encoding, &text)?;
            let encoding = if kind == ChannelKind::Blocks { BLOCK_ENCODING } else { JSON_ENCODING };
            *id = file.add_channel(schema, kind.topic(), encoding, &BTreeMap::new())?;
        }
        let mut writer = Writer {
            file,
            channels,
            counts: [0; CHANNELS.len()],
            offset_ns,
            bytes: Vec::with_capacity(4096),
        };
        let facts = [
            ("version", VERSION.to_owned()),
            ("session", name.to_owned()),
            ("monotonic_to_time_of_day_ns", offset_ns.to_string()),
        ];
        writer.metadata("session", facts)?;
        Ok(writer)
    }

    /// Attaches the bytes of a file.
    ///
    /// # Errors
    ///
    /// [`WriteError`].
    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8]) -> Result<(), WriteError> {
        let attachment = Attachment {
            log_time: self.offset_ns,
            create_time: self.offset_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(bytes),
        };
        Ok(self.file.attach(&attachment)?)
    }

    /// Writes facts under a name.
    ///
    /// # Errors
    ///
    /// [`WriteError`].
    pub fn metadata<const N: usize>(
        &mut self,
        name: &str,
        facts: [(&str, String); N],
    ) -> Result<(), WriteError> {
        let metadata = facts.map(|(key, value)| (key.to_owned(), value)).into();
        Ok(self.file.write_metadata(&Metadata { name: name.to_owned(), metadata })?)
    }

    /// Writes a message, received at `now_ns` of CLOCK_MONOTONIC.
    ///
    /// # Errors
    ///
    /// [`WriteError`].
    pub fn write(&mut self, message: &Message, now_ns: u64) -> Result<(), WriteError> {
        self.bytes.clear();
        let bytes = &mut self.bytes;
        let (published_ns, json) = match message {
            Message::Block(block) => {
                block.encode(bytes);
                (block.published_ns, Ok(()))
            }
            Message::Window(window) => {
                (window.trace.published_by(Stage::Dsp), serde_json::to_writer(bytes, window))
            }
            Message::Prediction(prediction) => {
                (prediction.trace.published_by(Stage::Inference), serde_json::to_writer(bytes, prediction))
            }
            Message::Command(command) => {
                (command.trace.published_by(Stage::Decision), serde_json::to_writer(bytes, command))
            }
            Message::State(state) => {
                (state.trace.published_by(Stage::Robot), serde_json::to_writer(bytes, state))
            }
            Message::Measurement(measurement) => (now_ns, serde_json::to_writer(bytes, measurement)),
            Message::Event(event) => (event.at_ns, serde_json::to_writer(bytes, event)),
            Message::Cue(cue) => (cue.captured_ns, serde_json::to_writer(bytes, cue)),
        };
        json.map_err(|error| WriteError::System(error.into()))?;
        let place = ChannelKind::of(message) as usize;
        let header = MessageHeader {
            channel_id: self.channels[place],
            sequence: self.counts[place],
            log_time: now_ns.saturating_add(self.offset_ns),
            publish_time: published_ns.saturating_add(self.offset_ns),
        };
        self.counts[place] = self.counts[place].wrapping_add(1);
        Ok(self.file.write_to_known_channel(&header, &self.bytes)?)
    }

    /// Closes the chunk: what was written until now can be read, however this program ends.
    ///
    /// # Errors
    ///
    /// [`WriteError`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        Ok(self.file.flush()?)
    }

    /// Ends the file with its index.
    ///
    /// # Errors
    ///
    /// [`WriteError`].
    pub fn finish(&mut self) -> Result<(), WriteError> {
        self.file.finish()?;
        Ok(())
    }
}
