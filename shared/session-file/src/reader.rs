//! Reading the file of a session, also one that was cut or damaged: all that lies in whole chunks.
//!
//! ```text
//! records of the file: header, metadata, attachments, chunks ──checksum──▶ records of the chunk: channels, messages
//!                                                        └── wrong: left out and counted; what comes behind is read
//! ```
//!
//! Metadata have no checksum of their own. That of the whole file, which the end of the data holds, tells that they are damaged.
//!
//! `framing.rs` says where each record begins, also behind one whose length is damaged.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap::records::{Record as McapRecord, op};

use crate::block::Block;
use crate::framing::{Framed, Framing, MAGIC};
use crate::records::Message;
use crate::schemas::{CHANNELS, ChannelKind};
use crate::{CONFIGURATION, PROFILE, VERSION};

/// Why the file of a session cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SessionFileError {
    /// The system refused.
    #[error("cannot read {}: check the path and its permissions", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// It is no file of a session.
    #[error("{}: this is not the file of a recorded session: `tendon run --record FOLDER` makes one", path.display())]
    NotOne {
        /// The file.
        path: PathBuf,
    },
    /// It is of another version of this format.
    #[error("{}: version {version} of the format, this program reads version {VERSION}: use a newer Tendon", path.display())]
    Version {
        /// The file.
        path: PathBuf,
        /// The version that it says.
        version: String,
    },
    /// What every such file begins with is missing.
    #[error("{}: the recording was cut or damaged at its beginning: it holds no {what}", path.display())]
    Beginning {
        /// The file.
        path: PathBuf,
        /// What is missing.
        what: &'static str,
    },
}

/// Whether the file begins as every MCAP file does. `false` also for what cannot be read.
pub fn is_session_file(path: &Path) -> bool {
    let mut magic = [0; MAGIC.len()];
    tendon_input::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok() && magic == MAGIC
}

/// A record of the file.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// An attached file.
    Attachment {
        /// Its name.
        name: String,
        /// What it holds.
        bytes: Vec<u8>,
    },
    /// Facts under a name.
    Metadata {
        /// Their name.
        name: String,
        /// The facts.
        facts: BTreeMap<String, String>,
    },
    /// A message.
    Message(Message),
}

/// A record of the file whose message, if it is one, was not looked into.
enum Raw {
    Attached(Record),
    Message(ChannelKind, Range<usize>),
}

/// What a file begins with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Head {
    /// The configuration as run, the text of a `tendon.toml`.
    pub configuration: String,
    /// The other attached files, by name.
    pub files: BTreeMap<String, Vec<u8>>,
    /// Whether all of it is there. `false` where the file is damaged or cut in it, so that a file may be missing.
    pub is_whole: bool,
}

impl Head {
    /// Reads the beginning of the file at `path`.
    ///
    /// # Errors
    ///
    /// [`SessionFileError`].
    pub fn read(path: &Path) -> Result<Head, SessionFileError> {
        let mut head = Head::default();
        let mut reader = Reader::open(path)?.without_samples();
        while let Some(record) = reader.next()? {
            match record {
                Record::Attachment { name, bytes } if name == CONFIGURATION => {
                    head.configuration = String::from_utf8_lossy(&bytes).into_owned();
                }
                Record::Attachment { name, bytes } => drop(head.files.insert(name, bytes)),
                Record::Metadata { .. } => {}
                Record::Message(_) => {
                    head.is_whole = true;
                    break;
                }
            }
        }
        head.is_whole = (head.is_whole || reader.is_whole()) && reader.damaged_pieces() == 0;
        if head.configuration.is_empty() {
            return Err(SessionFileError::Beginning { path: path.to_owned(), what: "configuration" });
        }
        Ok(head)
    }
}

/// Reads a file from its beginning to its end, or to where it was cut. What is damaged is left out. It never panics, whatever
/// the file holds.
pub struct Reader<R> {
    path: PathBuf,
    framing: Framing<R>,
    /// Records of the chunk that is being read, as far as they have not been.
    chunk: Option<Range<usize>>,
    /// By the id in the file.
    channels: HashMap<u16, ChannelKind>,
    with_samples: bool,
    has_header: bool,
    is_over: bool,
    is_whole: bool,
    is_damaged_elsewhere: bool,
    damaged_pieces: u64,
    /// Of chunks whose place is known.
    damaged_bytes: u64,
}

impl<R> std::fmt::Debug for Reader<R> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Reader").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Reader<File> {
    /// Opens the file at `path`.
    ///
    /// # Errors
    ///
    /// [`SessionFileError::Read`]; [`Reader::next`] says whether it is a file of a session.
    pub fn open(path: &Path) -> Result<Self, SessionFileError> {
        let file = tendon_input::open(path)
            .map_err(|source| SessionFileError::Read { path: path.to_owned(), source })?;
        Ok(Reader::new(file, path))
    }
}

impl<R: Read> Reader<R> {
    /// Reads from `input`; `path` is for messages.
    pub fn new(input: R, path: &Path) -> Reader<R> {
        Reader {
            path: path.to_owned(),
            framing: Framing::new(input),
            chunk: None,
            channels: HashMap::new(),
            with_samples: true,
            has_header: false,
            is_over: false,
            is_whole: false,
            is_damaged_elsewhere: false,
            damaged_pieces: 0,
            damaged_bytes: 0,
        }
    }

    /// Leaves out the samples of blocks, for who needs only their headers.
    #[must_use]
    pub fn without_samples(self) -> Reader<R> {
        Reader { with_samples: false, ..self }
    }

    /// Whether the end was reached that [`crate::Writer::finish`] wrote. `false` for a file that was cut, or is not read yet.
    pub fn is_whole(&self) -> bool {
        self.is_whole
    }

    /// Pieces, each a chunk, an attached file or bytes between two chunks, that are damaged and were left out so far.
    pub fn damaged_pieces(&self) -> u64 {
        self.damaged_pieces
    }

    /// Whether a whole file is damaged though none of its pieces is: in what has no checksum of its own, such as the metadata.
    /// Known at the end of the file.
    pub fn is_damaged_elsewhere(&self) -> bool {
        self.is_damaged_elsewhere
    }

    /// Bytes of these pieces.
    pub fn damaged_bytes(&self) -> u64 {
        self.damaged_bytes + self.framing.bytes_passed_over()
    }

    /// Bytes read so far.
    pub fn bytes_read(&self) -> u64 {
        self.framing.bytes_read()
    }

    /// The next message; what else there is in between is passed over.
    ///
    /// # Errors
    ///
    /// As [`Reader::next`].
    pub fn next_message(&mut self) -> Result<Option<Message>, SessionFileError> {
        loop {
            match self.next()? {
                None => return Ok(None),
                Some(Record::Message(message)) => return Ok(Some(message)),
                Some(_) => {}
            }
        }
    }

    /// Reads the next block into `block`, and passes over everything else. Whether there is one. Nothing is allocated for a
    /// block once the largest one and the longest piece of the file have been read.
    ///
    /// # Errors
    ///
    /// As [`Reader::next`].
    pub fn next_block(&mut self, block: &mut Block) -> Result<bool, SessionFileError> {
        while let Some(raw) = self.next_raw()? {
            if let Raw::Message(ChannelKind::Blocks, bytes) = raw
                && block.read(self.framing.content(bytes), self.with_samples)
            {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The next record; `None` at the end, or where the file was cut. What is damaged and messages that are none of ours are
    /// passed over.
    ///
    /// # Errors
    ///
    /// [`SessionFileError`] when it cannot be read, or is no file of a session.
    #[expect(clippy::should_implement_trait, reason = "it can fail, and is read with `while let`")]
    pub fn next(&mut self) -> Result<Option<Record>, SessionFileError> {
        while let Some(raw) = self.next_raw()? {
            match raw {
                Raw::Attached(record) => return Ok(Some(record)),
                Raw::Message(kind, bytes) => {
                    if let Some(message) = message(kind, self.framing.content(bytes), self.with_samples) {
                        return Ok(Some(Record::Message(message)));
                    }
                }
            }
        }
        Ok(None)
    }

    fn next_raw(&mut self) -> Result<Option<Raw>, SessionFileError> {
        while !self.is_over {
            if let Some((kind, bytes)) = self.next_of_chunk() {
                return Ok(Some(Raw::Message(kind, bytes)));
            }
            let next = self.framing.next();
            let next = next.map_err(|source| SessionFileError::Read { path: self.path.clone(), source })?;
            let (opcode, content) = match next {
                None => break,
                Some(Framed::Record { opcode, content }) => (opcode, content),
                Some(Framed::Damage) => {
                    self.damaged_pieces += 1;
                    continue;
                }
            };
            if opcode == op::CHUNK {
                self.chunk = self.framing.records_of_chunk(content.clone());
                if self.chunk.is_none() {
                    self.leave_out(&content);
                }
                continue;
            }
            // The index of a chunk says nothing new.
            if opcode == op::MESSAGE_INDEX {
                continue;
            }
            match parse(opcode, self.framing.content(content.clone())) {
                Ok(McapRecord::Header(header)) if header.profile != PROFILE => break,
                Ok(McapRecord::Header(_)) => self.has_header = true,
                Ok(McapRecord::Attachment { header, data, .. }) => {
                    let (name, bytes) = (header.name, data.into_owned());
                    return Ok(Some(Raw::Attached(Record::Attachment { name, bytes })));
                }
                Ok(McapRecord::Metadata(metadata)) => {
                    let (name, facts) = (metadata.name, metadata.metadata);
                    let version = facts.get("version").filter(|_| name == "session");
                    if let Some(version) = version.filter(|version| *version != VERSION) {
                        let version = version.clone();
                        return Err(SessionFileError::Version { path: self.path.clone(), version });
                    }
                    return Ok(Some(Raw::Attached(Record::Metadata { name, facts })));
                }
                // So does the index of the file, which comes behind it.
                Ok(McapRecord::DataEnd(end)) => {
                    self.is_whole = true;
                    // 0 where the writer did not count.
                    let is_right =
                        [0, self.framing.checksum_before(&content)].contains(&end.data_section_crc);
                    self.is_damaged_elsewhere = !is_right && self.damaged_pieces == 0;
                    break;
                }
                // No writer of ours writes anything else outside a chunk.
                Ok(_) | Err(_) => self.leave_out(&content),
            }
        }
        self.is_over = true;
        if self.has_header {
            return Ok(None);
        }
        Err(SessionFileError::NotOne { path: self.path.clone() })
    }

    fn leave_out(&mut self, content: &Range<usize>) {
        self.damaged_pieces += 1;
        self.damaged_bytes += content.len() as u64;
    }

    /// The next message of the chunk, and of which kind it is; `None` at the chunk's end.
    fn next_of_chunk(&mut self) -> Option<(ChannelKind, Range<usize>)> {
        let records = self.chunk.as_mut()?;
        while let Some((opcode, content)) = self.framing.next_in(records) {
            match parse(opcode, self.framing.content(content.clone())) {
                Ok(McapRecord::Channel(channel)) => {
                    let kind = CHANNELS.into_iter().find(|kind| kind.topic() == channel.topic);
                    self.channels.extend(kind.map(|kind| (channel.id, kind)));
                }
                Ok(McapRecord::Message { header, data }) => {
                    if let Some(kind) = kind_of(&self.channels, header.channel_id) {
                        return Some((kind, content.end - data.len()..content.end));
                    }
                }
                Ok(_) | Err(_) => {}
            }
        }
        self.chunk = None;
        None
    }
}

/// What a record says. The crate's own function panics on an attachment that is shorter than it says.
fn parse(opcode: u8, content: &[u8]) -> mcap::McapResult<McapRecord<'_>> {
    if opcode == op::ATTACHMENT && !is_whole_attachment(content) {
        return Err(mcap::McapError::UnexpectedEof);
    }
    mcap::parse_record(opcode, content)
}

/// Whether what an attachment says of its lengths fits into it: two times, name, media type, data, checksum.
fn is_whole_attachment(content: &[u8]) -> bool {
    let after_text = |text: &mut &[u8]| {
        let (length, rest) = text.split_first_chunk::<4>()?;
        *text = rest.get(u32::from_le_bytes(*length) as usize..)?;
        Some(())
    };
    let data_length = || {
        let mut rest = content.get(16..)?;
        after_text(&mut rest)?;
        after_text(&mut rest)?;
        let (length, data) = rest.split_first_chunk::<8>()?;
        Some((u64::from_le_bytes(*length), data.len().checked_sub(4)? as u64))
    };
    data_length().is_some_and(|(said, there)| said <= there)
}

/// What the file says of this channel; where the piece that says it is damaged, as [`crate::Writer`] numbers them.
fn kind_of(channels: &HashMap<u16, ChannelKind>, id: u16) -> Option<ChannelKind> {
    if channels.is_empty() {
        return CHANNELS.get(usize::from(id).checked_sub(1)?).copied();
    }
    channels.get(&id).copied()
}

/// Reads a message; `None` for what no writer of ours writes.
fn message(kind: ChannelKind, bytes: &[u8], with_samples: bool) -> Option<Message> {
    fn json<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Option<T> {
        serde_json::from_slice(bytes).ok()
    }
    match kind {
        ChannelKind::Blocks => Block::decode(bytes, with_samples).map(Message::Block),
        ChannelKind::Windows => json(bytes).map(Message::Window),
        ChannelKind::Predictions => json(bytes).map(Message::Prediction),
        ChannelKind::Commands => json(bytes).map(Message::Command),
        ChannelKind::States => json(bytes).map(Message::State),
        ChannelKind::Measurements => json(bytes).map(Message::Measurement),
        ChannelKind::Events => json(bytes).map(Message::Event),
        ChannelKind::Cues => json(bytes).map(Message::Cue),
    }
}
