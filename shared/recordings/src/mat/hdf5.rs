//! The part of HDF5 that MATLAB 7.3, h5py and hdf5storage write, after the HDF5 File Format Specification, version 3.0.
//!
//! ```text
//! 0    what MATLAB says of the file
//! 512  superblock ─▶ header of the root group ─▶ name and header of each variable
//!                     ├ symbol table: B-tree ─▶ nodes with addresses, names in a heap
//!                     └ or a message for each link
//! header of a variable: dimensions, type of the values, layout, filters, attributes such as MATLAB_class
//!     layout ─┬ compact: the values stand in the header
//!             ├ contiguous: they stand elsewhere, in one piece
//!             └ chunked: B-tree ─▶ pieces; each may be shuffled, compressed and have a checksum
//! ```
//! Addresses count from the superblock. Nothing in a file is believed: each address is checked against the file's length, and
//! no more is read than twice that length, so that parts that refer to each other end.

mod bytes;
mod chunks;
mod dataset;
mod filter;
mod group;
mod header;
#[cfg(test)]
mod tests;
mod tree;

use std::io::{Read, Seek, SeekFrom};

use super::problem::MatError;
use super::variable::{Place, Variable};
use bytes::Bytes;

pub(super) use dataset::Dataset;

const SIGNATURE: &[u8; 8] = b"\x89HDF\r\n\x1a\n";

/// An address that leads nowhere.
const UNDEFINED: u64 = u64::MAX;

const NOT_WRITTEN: &str = "part of a variable was never written";

/// Groups in which MATLAB keeps what variables refer to.
const INTERNAL: [&str; 2] = ["#refs#", "#subsystem#"];

/// Where the superblock of a file is; `None` if it has none.
pub(super) fn superblock(file: &mut (impl Read + Seek)) -> Result<Option<u64>, MatError> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut place = 0;
    while place + SIGNATURE.len() as u64 <= length {
        file.seek(SeekFrom::Start(place))?;
        let mut signature = [0; SIGNATURE.len()];
        file.read_exact(&mut signature)?;
        if signature == *SIGNATURE {
            return Ok(Some(place));
        }
        place = (2 * place).max(512);
    }
    Ok(None)
}

/// The variables of a file with its superblock at `base`.
pub(super) fn variables(file: &mut (impl Read + Seek), base: u64) -> Result<Vec<Variable>, MatError> {
    let mut reader = Reader::new(file, base)?;
    let root = root(&mut reader)?;
    let messages = header::messages(&mut reader, root)?;
    let mut variables = Vec::new();
    for (name, address) in group::links(&mut reader, &messages)? {
        if INTERNAL.contains(&name.as_str()) {
            continue;
        }
        let messages = header::messages(&mut reader, address)?;
        let found = dataset::describe(&messages)?;
        let (other, rows, columns, place) = match found {
            Ok(dataset) => (None, dataset.rows, dataset.columns, Place::Hdf5(Box::new(dataset))),
            Err(other) => (Some(other), 0, 0, Place::Nowhere),
        };
        variables.push(Variable { name, other, rows, columns, place });
    }
    Ok(variables)
}

/// The address of the header of the root group, as the superblock gives it.
fn root<R: Read + Seek>(reader: &mut Reader<'_, R>) -> Result<u64, MatError> {
    let block = reader.read_up_to(0, 96)?;
    let mut bytes = Bytes::new(&block);
    bytes.skip(SIGNATURE.len())?;
    let version = bytes.u8()?;
    let sizes = match version {
        0 | 1 => {
            bytes.skip(4)?;
            let sizes = [bytes.u8()?, bytes.u8()?];
            // More of the superblock, four addresses, and of the root's symbol its name.
            bytes.skip(if version == 0 { 9 } else { 13 } + 32 + 8)?;
            sizes
        }
        2 | 3 => {
            let sizes = [bytes.u8()?, bytes.u8()?];
            bytes.skip(1 + 24)?;
            sizes
        }
        _ => return Err(MatError::Hdf5("its superblock is of a newer version")),
    };
    if sizes != [8, 8] {
        return Err(MatError::Hdf5("its addresses are not of 8 bytes"));
    }
    bytes.u64()
}

/// Reads parts of a file by their addresses.
pub(super) struct Reader<'a, R> {
    file: &'a mut R,
    /// Where the superblock is.
    base: u64,
    /// Bytes from there to the end.
    length: u64,
    /// Bytes that may still be read.
    left: u64,
}

impl<'a, R: Read + Seek> Reader<'a, R> {
    pub(super) fn new(file: &'a mut R, base: u64) -> Result<Reader<'a, R>, MatError> {
        let length = file.seek(SeekFrom::End(0))?.saturating_sub(base);
        Ok(Reader { file, base, length, left: length.saturating_mul(2) })
    }

    fn read(&mut self, address: u64, bytes: u64) -> Result<Vec<u8>, MatError> {
        if address.checked_add(bytes).is_none_or(|end| end > self.length) {
            return Err(MatError::Damaged("it refers to what lies beyond its end"));
        }
        let left = self.left.checked_sub(bytes);
        self.left = left.ok_or(MatError::Damaged("its parts refer to each other in a circle"))?;
        self.file.seek(SeekFrom::Start(self.base + address))?;
        let mut part = vec![0; bytes as usize];
        self.file.read_exact(&mut part)?;
        Ok(part)
    }

    /// As [`Reader::read`], or fewer bytes at the end of the file.
    fn read_up_to(&mut self, address: u64, most: u64) -> Result<Vec<u8>, MatError> {
        self.read(address, most.min(self.length.saturating_sub(address)))
    }
}
