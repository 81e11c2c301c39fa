//! What the file is made of, chunk by chunk.

use super::stream::Stream;
use crate::signals::SignalsError;

/// What a boundary chunk holds.
pub(super) const BOUNDARY: [u8; 16] =
    [0x43, 0xa5, 0x46, 0xdc, 0xcb, 0xf5, 0x41, 0x0f, 0xb3, 0x0e, 0xd5, 0x46, 0x73, 0x83, 0xcb, 0xe4];

/// The file, sorted.
#[derive(Default)]
pub(super) struct Contents<'a> {
    /// The streams, in the order in which they are announced.
    pub(super) streams: Vec<Stream>,
    /// Chunks of samples with their stream, without its number.
    pub(super) samples: Vec<(u32, &'a [u8])>,
    /// Of a stream, when its clock was looked at, and what to add to its stamps, in s.
    pub(super) offsets: Vec<(u32, f64, f64)>,
    /// Streams that were closed.
    feet: Vec<u32>,
    /// Bytes that could not be understood.
    pub(super) damaged_bytes: u64,
}

impl<'a> Contents<'a> {
    pub(super) fn read(bytes: &'a [u8]) -> Result<Contents<'a>, SignalsError> {
        if !bytes.starts_with(b"XDF:") {
            return Err(SignalsError::OtherKind("XDF"));
        }
        let mut contents = Contents::default();
        let mut chunks = Chunks { bytes, position: 4, damaged_bytes: 0 };
        while let Some((tag, content)) = chunks.next() {
            contents.take(tag, content);
        }
        contents.damaged_bytes = chunks.damaged_bytes;
        Ok(contents)
    }

    fn take(&mut self, tag: u16, content: &'a [u8]) -> Option<()> {
        let (id, rest) = content.split_first_chunk()?;
        let id = u32::from_le_bytes(*id);
        match tag {
            2 => {
                let stream = Stream::read(id, std::str::from_utf8(rest).ok()?)?;
                // A number that is announced again is the same stream.
                if self.streams.iter().all(|known| known.id != id) {
                    self.streams.push(stream);
                }
            }
            3 => self.samples.push((id, rest)),
            4 => {
                let (at_s, rest) = rest.split_first_chunk()?;
                let (offset_s, _) = rest.split_first_chunk()?;
                let (at_s, offset_s) = (f64::from_le_bytes(*at_s), f64::from_le_bytes(*offset_s));
                if at_s.is_finite() && offset_s.is_finite() {
                    self.offsets.push((id, at_s, offset_s));
                }
            }
            6 => self.feet.push(id),
            _ => {}
        }
        Some(())
    }

    /// Whether the recording of a stream was ended, and not cut off.
    pub(super) fn has_foot(&self, stream: u32) -> bool {
        self.feet.contains(&stream)
    }
}

/// The chunks one after the other.
struct Chunks<'a> {
    bytes: &'a [u8],
    position: usize,
    damaged_bytes: u64,
}

impl<'a> Chunks<'a> {
    /// The next chunk: its tag and its content. Where there is none, all up to the next boundary is passed over.
    fn next(&mut self) -> Option<(u16, &'a [u8])> {
        loop {
            let rest = self.bytes.get(self.position..).filter(|rest| !rest.is_empty())?;
            if let Some((tag, content, after)) = chunk(rest) {
                self.position = self.bytes.len() - after.len();
                return Some((tag, content));
            }
            let boundary = rest.windows(BOUNDARY.len()).position(|window| window == BOUNDARY)?;
            self.damaged_bytes += boundary as u64;
            self.position += boundary + BOUNDARY.len();
        }
    }
}

/// The first chunk and what comes after it.
fn chunk(bytes: &[u8]) -> Option<(u16, &[u8], &[u8])> {
    let (length, rest) = length(bytes)?;
    let (chunk, after) = rest.split_at_checked(length)?;
    let (tag, content) = chunk.split_first_chunk()?;
    let tag = u16::from_le_bytes(*tag);
    let is_boundary = content == BOUNDARY;
    // What is called so and holds something else is damage.
    ((1..=6).contains(&tag) && (tag == 5) == is_boundary).then_some((tag, content, after))
}

/// A length of 1, 4 or 8 bytes, and what comes after it.
pub(super) fn length(bytes: &[u8]) -> Option<(usize, &[u8])> {
    let (size, rest) = bytes.split_first()?;
    let (length, rest) = match size {
        1 => rest.split_first().map(|(length, rest)| (u64::from(*length), rest))?,
        4 => rest.split_first_chunk().map(|(length, rest)| (u32::from_le_bytes(*length).into(), rest))?,
        8 => rest.split_first_chunk().map(|(length, rest)| (u64::from_le_bytes(*length), rest))?,
        _ => return None,
    };
    Some((usize::try_from(length).ok()?, rest))
}
