//! What is done to the values of a chunk before they are written: reordered, compressed, given a checksum.

use std::io::Read;

use flate2::bufread::ZlibDecoder;

use super::bytes::Bytes;
use crate::mat::problem::MatError;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    Deflate,
    /// First all first bytes of the values, of so many bytes each, then all second ones …
    Shuffle(usize),
    Fletcher32,
    /// Any other.
    Unknown,
}

/// The filters that a message names, in the order in which they are applied when the file is written.
pub(super) fn read(mut bytes: Bytes<'_>) -> Result<Vec<Filter>, MatError> {
    let version = bytes.u8()?;
    let count = bytes.u8()?;
    if version == 1 {
        bytes.skip(6)?;
    }
    let mut filters = Vec::new();
    for _ in 0..count {
        let id = bytes.u16()?;
        // Of the newer version only unknown filters have names.
        let mut name = if version == 1 || id >= 256 { usize::from(bytes.u16()?) } else { 0 };
        bytes.skip(2)?;
        let values = usize::from(bytes.u16()?);
        if version == 1 {
            name = name.next_multiple_of(8);
        }
        bytes.skip(name)?;
        let mut values = Bytes::new(bytes.take(4 * (values + if version == 1 { values % 2 } else { 0 }))?);
        filters.push(match id {
            1 => Filter::Deflate,
            2 => Filter::Shuffle(values.u32()? as usize),
            3 => Filter::Fletcher32,
            _ => Filter::Unknown,
        });
    }
    Ok(filters)
}

/// Undoes the filters: `bytes` become at most `most`. A bit of `left_out` says that its filter was not applied.
pub(super) fn undo(
    filters: &[Filter],
    left_out: u32,
    mut bytes: Vec<u8>,
    most: usize,
) -> Result<Vec<u8>, MatError> {
    /// Room for checksums within what was compressed.
    const MORE: usize = 64;
    for (number, filter) in filters.iter().enumerate().rev() {
        if left_out & 1_u32.checked_shl(number as u32).unwrap_or(0) != 0 {
            continue;
        }
        bytes = match filter {
            Filter::Deflate => {
                let mut values = Vec::new();
                let stream = ZlibDecoder::new(bytes.as_slice());
                stream.take((most + MORE) as u64).read_to_end(&mut values)?;
                values
            }
            Filter::Shuffle(size) => unshuffled(&bytes, *size),
            Filter::Fletcher32 => checked(bytes)?,
            Filter::Unknown => {
                return Err(MatError::Hdf5("its values are compressed otherwise than by deflate"));
            }
        };
    }
    Ok(bytes)
}

fn unshuffled(bytes: &[u8], size: usize) -> Vec<u8> {
    let count = bytes.len().checked_div(size).unwrap_or(0);
    let (shuffled, rest) = bytes.split_at(count * size);
    let mut values = Vec::with_capacity(bytes.len());
    for value in 0..count {
        values.extend(shuffled.iter().skip(value).step_by(count));
    }
    values.extend(rest);
    values
}

/// The bytes before their checksum, Fletcher's over words of 16 bits.
fn checked(mut bytes: Vec<u8>) -> Result<Vec<u8>, MatError> {
    let end = bytes.len().checked_sub(4).ok_or(MatError::Damaged("a checksum is missing"))?;
    let written = bytes.split_off(end);
    let (mut sum, mut sum_of_sums) = (0_u32, 0_u32);
    for word in bytes.chunks(2) {
        let word = u32::from(word[0]) << 8 | u32::from(*word.get(1).unwrap_or(&0));
        sum = (sum + word) % 0xFFFF;
        sum_of_sums = (sum_of_sums + sum) % 0xFFFF;
    }
    let written = Bytes::new(&written).u32()?;
    let is_same = |sum: u32, written: u32| sum == written % 0xFFFF;
    if is_same(sum, written & 0xFFFF) && is_same(sum_of_sums, written >> 16) {
        Ok(bytes)
    } else {
        Err(MatError::Damaged("a checksum differs"))
    }
}
