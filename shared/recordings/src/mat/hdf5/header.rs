//! The header of a group or variable: messages, each of which says one thing about it.
//!
//! ```text
//! version 1   16 bytes │ message, message, …        continued elsewhere by a message that says where
//! version 2   OHDR …   │ message, message, … │ checksum         continued in blocks OCHK … checksum
//! ```

use std::io::{Read, Seek};

use super::Reader;
use super::bytes::Bytes;
use crate::mat::problem::MatError;

pub(super) const DATASPACE: u16 = 0x01;
pub(super) const LINK_INFO: u16 = 0x02;
pub(super) const DATATYPE: u16 = 0x03;
pub(super) const LINK: u16 = 0x06;
pub(super) const LAYOUT: u16 = 0x08;
pub(super) const FILTERS: u16 = 0x0B;
pub(super) const ATTRIBUTE: u16 = 0x0C;
const CONTINUATION: u16 = 0x10;
pub(super) const SYMBOL_TABLE: u16 = 0x11;

/// Flag of a message that stands elsewhere, as a type that several variables have.
const SHARED: u8 = 0x02;

pub(super) struct Message {
    pub(super) kind: u16,
    pub(super) data: Vec<u8>,
}

/// What the first message of a kind says.
pub(super) fn find(messages: &[Message], kind: u16) -> Option<Bytes<'_>> {
    messages.iter().find(|message| message.kind == kind).map(|message| Bytes::new(&message.data))
}

/// How messages begin.
#[derive(Clone, Copy)]
struct Form {
    is_second: bool,
    has_order: bool,
}

/// The messages of the header at `address`, without those that stand elsewhere.
pub(super) fn messages<R: Read + Seek>(
    reader: &mut Reader<'_, R>,
    address: u64,
) -> Result<Vec<Message>, MatError> {
    const LONGEST_BEGINNING: u64 = 34;
    let beginning = reader.read_up_to(address, LONGEST_BEGINNING)?;
    let mut bytes = Bytes::new(&beginning);
    let is_second = beginning.starts_with(b"OHDR");
    let mut form = Form { is_second, has_order: false };
    let length = if is_second {
        bytes.skip(5)?;
        let flags = bytes.u8()?;
        form.has_order = flags & 0x04 != 0;
        let times = if flags & 0x20 != 0 { 16 } else { 0 };
        let attributes = if flags & 0x10 != 0 { 4 } else { 0 };
        bytes.skip(times + attributes)?;
        bytes.number(1 << (flags & 0x03))?
    } else {
        if bytes.u8()? != 1 {
            return Err(MatError::Damaged("a header is of no known version"));
        }
        bytes.skip(7)?;
        let length = u64::from(bytes.u32()?);
        bytes.skip(4)?;
        length
    };
    let start = address + (beginning.len() - bytes.len()) as u64;
    let mut blocks = vec![reader.read(start, length)?];
    let mut messages = Vec::new();
    while let Some(block) = blocks.pop() {
        let mut bytes = Bytes::new(&block);
        // What is left at the end is too short for a message.
        while bytes.len() >= 4 {
            let Some((message, flags)) = form.read(&mut bytes)? else { break };
            if flags & SHARED != 0 {
                continue;
            }
            if message.kind != CONTINUATION {
                messages.push(message);
                continue;
            }
            let mut place = Bytes::new(&message.data);
            let block = reader.read(place.u64()?, place.u64()?)?;
            blocks.push(if form.is_second { within(&block)?.to_vec() } else { block });
        }
    }
    Ok(messages)
}

/// The messages of a block, between its letters and its checksum.
fn within(block: &[u8]) -> Result<&[u8], MatError> {
    let mut bytes = Bytes::new(block);
    bytes.expect(b"OCHK")?;
    bytes.take(bytes.len().saturating_sub(4))
}

impl Form {
    /// The next message and its flags; `None` where there is no room for one.
    fn read(self, bytes: &mut Bytes<'_>) -> Result<Option<(Message, u8)>, MatError> {
        let head = match (self.is_second, self.has_order) {
            (false, _) => 8,
            (true, false) => 4,
            (true, true) => 6,
        };
        if bytes.len() < head {
            return Ok(None);
        }
        let kind = if self.is_second { u16::from(bytes.u8()?) } else { bytes.u16()? };
        let length = bytes.u16()?;
        let flags = bytes.u8()?;
        bytes.skip(if self.is_second { head - 4 } else { 3 })?;
        let data = bytes.take(length.into())?.to_vec();
        Ok(Some((Message { kind, data }, flags)))
    }
}
