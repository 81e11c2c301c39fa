//! The records of an MCAP file one after the other, also behind a damaged length.
//!
//! ```text
//! magic │ opcode, length, content │ opcode, length, content │ …       the content of a chunk is records, too
//!                   └─ wrong: nothing tells where the next record begins. What comes next is the first chunk
//!                      whose sizes and checksum agree, or the end of the data.
//! ```
//!
//! Nothing is allocated once the longest record has been read.

use std::io::{self, Read};
use std::ops::Range;

use crc32fast::Hasher;
use mcap::records::op;

/// First bytes of every MCAP file.
pub(crate) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Bytes read at a time.
pub(crate) const PIECE: usize = 1 << 16;
/// Longest record; one that says it is longer is damaged. A model is the largest thing in a file.
const LONGEST_RECORD: u64 = 256 << 20;
/// Opcode and length.
const HEAD: usize = 1 + 8;
/// What stands in a chunk before its records: two times, their size, their checksum, no compression, their size.
const HEAD_OF_CHUNK: usize = 8 + 8 + 8 + 4 + 4 + 8;
/// Content of the record that ends the data: a checksum.
const DATA_END: u64 = 4;

/// What comes next in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Framed {
    /// A record; its content is what [`Framing::content`] gives for this range.
    Record { opcode: u8, content: Range<usize> },
    /// Bytes that were passed over, as they say nothing that can be true.
    Damage,
}

/// Takes a file apart.
#[derive(Debug)]
pub(crate) struct Framing<R> {
    input: R,
    bytes: Vec<u8>,
    /// Where in `bytes` comes what was not looked at yet.
    next: usize,
    /// Where a whole chunk is searched from, before anything else.
    search_from: Option<usize>,
    has_magic: bool,
    bytes_read: u64,
    bytes_passed_over: u64,
    /// Of all that was forgotten.
    checksum: Hasher,
}

impl<R: Read> Framing<R> {
    pub(crate) fn new(input: R) -> Framing<R> {
        let bytes = Vec::with_capacity(4 * PIECE);
        Framing {
            input,
            bytes,
            next: 0,
            search_from: None,
            has_magic: false,
            bytes_read: 0,
            bytes_passed_over: 0,
            checksum: Hasher::new(),
        }
    }

    /// Bytes so far in which nothing was found.
    pub(crate) fn bytes_passed_over(&self) -> u64 {
        self.bytes_passed_over
    }

    /// Bytes read so far.
    pub(crate) fn bytes_read(&self) -> u64 {
        self.bytes_read
    }

    /// The content of the record that was given last.
    pub(crate) fn content(&self, content: Range<usize>) -> &[u8] {
        &self.bytes[content]
    }

    /// The checksum of the file up to the record with this content, which was given last.
    pub(crate) fn checksum_before(&self, content: &Range<usize>) -> u32 {
        let mut checksum = self.checksum.clone();
        checksum.update(&self.bytes[..content.start - HEAD]);
        checksum.finalize()
    }

    /// The records in the content of a chunk, for [`Framing::next_in`]; `None` if they are damaged.
    pub(crate) fn records_of_chunk(&self, content: Range<usize>) -> Option<Range<usize>> {
        is_whole_chunk(&self.bytes[content.clone()]).then_some(content.start + HEAD_OF_CHUNK..content.end)
    }

    /// Takes the next of `records`: its opcode and content; `None` at their end.
    pub(crate) fn next_in(&self, records: &mut Range<usize>) -> Option<(u8, Range<usize>)> {
        let start = records.start + HEAD;
        let length = (start <= records.end).then(|| number_at(&self.bytes, start - 8) as usize)?;
        let end = start.checked_add(length).filter(|end| *end <= records.end)?;
        let opcode = self.bytes[records.start];
        records.start = end;
        Some((opcode, start..end))
    }

    /// What comes next; `None` at the end, where the file was cut, or if it is no MCAP file.
    pub(crate) fn next(&mut self) -> io::Result<Option<Framed>> {
        if let Some(from) = self.search_from.take() {
            return Ok(self.find_whole(from)?.then_some(Framed::Damage));
        }
        if !self.has_magic {
            self.has_magic = self.has(MAGIC.len())? && self.bytes.starts_with(&MAGIC);
            if !self.has_magic {
                return Ok(None);
            }
            self.next = MAGIC.len();
        }
        self.forget_before_next();
        if !self.has(self.next + HEAD)? {
            return Ok(None);
        }
        let Some((opcode, length)) = self.head(self.next) else {
            let _ = self.find_whole(self.next + 1)?;
            return Ok(Some(Framed::Damage));
        };
        let content = self.next + HEAD..self.next + HEAD + length;
        if !self.has(content.end)? {
            return Ok(self.find_whole(self.next + 1)?.then_some(Framed::Damage));
        }
        // The length of a chunk is right if the sizes in it agree. One that is not may end anywhere, at a record, too.
        if opcode == op::CHUNK && !has_sizes_of_chunk(&self.bytes[content.clone()], length) {
            let _ = self.find_whole(self.next + 1)?;
            return Ok(Some(Framed::Damage));
        }
        // Any other length is right if a record, or nothing, comes behind it.
        if self.has(content.end + HEAD)? && self.head(content.end).is_none() {
            self.search_from = Some(if opcode == op::CHUNK { content.end } else { self.next + 1 });
        }
        self.next = content.end;
        Ok(Some(Framed::Record { opcode, content }))
    }

    /// Goes to the first whole chunk or end of the data that begins at `from` or behind it; whether there is one. If not, nothing
    /// comes next.
    fn find_whole(&mut self, from: usize) -> io::Result<bool> {
        self.bytes_passed_over += from.saturating_sub(self.next) as u64;
        self.next = from;
        while self.has(self.next + HEAD)? {
            let is_whole = match self.head(self.next) {
                Some((op::CHUNK, length)) => {
                    let content = self.next + HEAD..self.next + HEAD + length;
                    self.has(content.start + HEAD_OF_CHUNK)?
                        && has_sizes_of_chunk(&self.bytes[content.start..], length)
                        && self.has(content.end)?
                        && is_whole_chunk(&self.bytes[content])
                }
                Some((op::DATA_END, length)) => {
                    let behind = self.next + HEAD + length;
                    length as u64 == DATA_END && self.has(behind + HEAD)? && self.head(behind).is_some()
                }
                _ => false,
            };
            if is_whole {
                return Ok(true);
            }
            self.next += 1;
            self.bytes_passed_over += 1;
            self.forget_before_next();
        }
        Ok(false)
    }

    /// Opcode and length of the record that begins at `place`; `None` for what no record begins with.
    fn head(&self, place: usize) -> Option<(u8, usize)> {
        let opcode = self.bytes[place];
        let length = number_at(&self.bytes, place + 1);
        let is_possible = (op::HEADER..=op::DATA_END).contains(&opcode) && length <= LONGEST_RECORD;
        is_possible.then_some((opcode, length as usize))
    }

    /// Reads on until `bytes` has so many; whether the file has.
    fn has(&mut self, length: usize) -> io::Result<bool> {
        while self.bytes.len() < length {
            let before = self.bytes.len();
            self.bytes.resize(before + PIECE, 0);
            let read = self.input.read(&mut self.bytes[before..]);
            self.bytes.truncate(before + read.as_ref().copied().unwrap_or(0));
            match read {
                Ok(0) => return Ok(false),
                Ok(count) => self.bytes_read += count as u64,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }

    fn forget_before_next(&mut self) {
        if self.next >= PIECE {
            self.checksum.update(&self.bytes[..self.next]);
            self.bytes.drain(..self.next);
            self.next = 0;
        }
    }
}

fn number_at(bytes: &[u8], place: usize) -> u64 {
    let mut number = [0; 8];
    number.copy_from_slice(&bytes[place..place + 8]);
    u64::from_le_bytes(number)
}

/// Whether the sizes at the beginning of a chunk of this length agree with it. None of ours is compressed.
fn has_sizes_of_chunk(content: &[u8], length: usize) -> bool {
    let records = length.checked_sub(HEAD_OF_CHUNK).map(|records| records as u64);
    records.is_some_and(|records| number_at(content, 16) == records && number_at(content, 32) == records)
}

/// Whether sizes and checksum of a chunk are right.
fn is_whole_chunk(content: &[u8]) -> bool {
    has_sizes_of_chunk(content, content.len())
        && content[24..28] == crc32fast::hash(&content[HEAD_OF_CHUNK..]).to_le_bytes()
}
