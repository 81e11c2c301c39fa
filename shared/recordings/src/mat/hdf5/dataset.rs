//! A matrix of numbers in an HDF5 file: its dimensions, its type, and where its values are.

use std::io::{Read, Seek};

use super::bytes::Bytes;
use super::chunks::Chunking;
use super::filter;
use super::header::{
    ATTRIBUTE, DATASPACE, DATATYPE, FILTERS, LAYOUT, LINK_INFO, Message, SYMBOL_TABLE, find,
};
use super::{NOT_WRITTEN, Reader, UNDEFINED};
use crate::mat::problem::{MatError, OTHER_COUNT};
use crate::mat::variable::Visit;

/// Values that are read at once.
const AT_ONCE: u64 = 1 << 14;

/// A matrix whose values have not been read yet. A column of MATLAB's is a row of HDF5's, one value after the other.
#[derive(Clone, Debug)]
pub(in crate::mat) struct Dataset {
    pub(in crate::mat) rows: usize,
    pub(in crate::mat) columns: usize,
    pub(super) number: Number,
    layout: Layout,
}

#[derive(Clone, Debug)]
enum Layout {
    Compact(Vec<u8>),
    Contiguous {
        address: u64,
    },
    Chunked(Chunking),
    /// Why the values cannot be read.
    Unknown(&'static str),
}

/// How a number is written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Number {
    pub(super) bytes: usize,
    is_float: bool,
    is_signed: bool,
    is_big_endian: bool,
}

/// Kinds of types, by their number in the file.
const INTEGER: u8 = 0;
const FLOAT: u8 = 1;
const COMPOUND: u8 = 6;

/// The matrix of real numbers that a header describes, or what else it is in words.
pub(super) fn describe(messages: &[Message]) -> Result<Result<Dataset, String>, MatError> {
    let class = attribute(messages, b"MATLAB_class")?.map(|class| {
        let class = class.split(|byte| *byte == 0).next().unwrap_or_default();
        String::from_utf8_lossy(class).into_owned()
    });
    let other = |words: &str| Ok(Err(words.to_owned()));
    let is_group = find(messages, SYMBOL_TABLE).or(find(messages, LINK_INFO)).is_some();
    let is_sparse = attribute(messages, b"MATLAB_sparse")?.is_some();
    match class.as_deref() {
        _ if is_sparse => return other("a sparse matrix"),
        Some("cell") => return other("a cell array"),
        Some("struct") => return other("a structure"),
        Some("char") => return other("text"),
        Some("function_handle") => return other("a function handle"),
        None if is_group => return other("a structure"),
        Some(
            "double" | "single" | "logical" | "int8" | "uint8" | "int16" | "uint16" | "int32" | "uint32"
            | "int64" | "uint64",
        )
        | None => {}
        Some(class) => return Ok(Err(format!("of the MATLAB class {class}"))),
    }
    let (Some(space), Some(kind)) = (find(messages, DATASPACE), find(messages, DATATYPE)) else {
        return other("of a type that is not known");
    };
    let number = match Number::read(kind)? {
        Ok(number) => number,
        Err(COMPOUND) if class.is_some() => return other("a matrix of complex numbers"),
        Err(_) => return other("of a type that is not known"),
    };
    let is_empty =
        attribute(messages, b"MATLAB_empty")?.is_some_and(|flag| flag.iter().any(|byte| *byte != 0));
    let Some(lengths) = dimensions(space)?.filter(|_| !is_empty) else { return other("empty") };
    if lengths.contains(&0) {
        return other("empty");
    }
    let (columns, rows) = match lengths[..] {
        [] => (1, 1),
        [rows] => (1, rows),
        [columns, rows] => (columns, rows),
        _ => return other("an array of more than two dimensions"),
    };
    let layout = Layout::read(messages, lengths.len(), number.bytes)?;
    Ok(Ok(Dataset { rows: rows as usize, columns: columns as usize, number, layout }))
}

/// What the attribute of this name holds.
fn attribute<'a>(messages: &'a [Message], wanted: &[u8]) -> Result<Option<&'a [u8]>, MatError> {
    for message in messages.iter().filter(|message| message.kind == ATTRIBUTE) {
        let mut bytes = Bytes::new(&message.data);
        let version = bytes.u8()?;
        bytes.skip(1)?;
        let lengths = [bytes.u16()?, bytes.u16()?, bytes.u16()?].map(usize::from);
        bytes.skip(if version == 3 { 1 } else { 0 })?;
        // Only the first version fills its parts up.
        let [name, kind, space] =
            lengths.map(|length| if version == 1 { length.next_multiple_of(8) } else { length });
        let name = &bytes.take(name)?[..lengths[0]];
        bytes.skip(kind)?;
        bytes.skip(space)?;
        if name.strip_suffix(b"\0").unwrap_or(name) == wanted {
            return Ok(Some(bytes.take(bytes.len())?));
        }
    }
    Ok(None)
}

/// The dimensions; `None` if there are no values at all.
fn dimensions(mut bytes: Bytes<'_>) -> Result<Option<Vec<u64>>, MatError> {
    let version = bytes.u8()?;
    let count = bytes.u8()?;
    bytes.skip(1)?;
    const NULL: u8 = 2;
    if version == 1 {
        bytes.skip(5)?;
    } else if bytes.u8()? == NULL {
        return Ok(None);
    }
    (0..count).map(|_| bytes.u64()).collect::<Result<_, _>>().map(Some)
}

impl Number {
    /// How numbers of a type are written; the kind of the type if it is none of numbers.
    fn read(mut bytes: Bytes<'_>) -> Result<Result<Number, u8>, MatError> {
        let kind = bytes.u8()? & 0x0F;
        let bits = bytes.u8()?;
        bytes.skip(2)?;
        let size = bytes.u32()? as usize;
        let (offset, precision) = match kind {
            INTEGER | FLOAT => (bytes.u16()?, usize::from(bytes.u16()?)),
            _ => return Ok(Err(kind)),
        };
        let is_whole = offset == 0 && precision == 8 * size;
        let is_known = match kind {
            FLOAT => matches!(size, 4 | 8),
            _ => matches!(size, 1 | 2 | 4 | 8),
        };
        if !(is_whole && is_known) {
            return Ok(Err(kind));
        }
        Ok(Ok(Number {
            bytes: size,
            is_float: kind == FLOAT,
            is_signed: bits & 0x08 != 0,
            is_big_endian: bits & 0x01 != 0,
        }))
    }

    /// The number in as many bytes as one has.
    fn value(self, bytes: &[u8]) -> f64 {
        let fold = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        let bits =
            if self.is_big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) };
        let unused = 64 - 8 * self.bytes as u32;
        match (self.is_float, self.bytes) {
            (true, 4) => f64::from(f32::from_bits(bits as u32)),
            (true, _) => f64::from_bits(bits),
            (false, _) if self.is_signed => ((bits << unused) as i64 >> unused) as f64,
            (false, _) => bits as f64,
        }
    }
}

impl Layout {
    fn read(messages: &[Message], rank: usize, value_bytes: usize) -> Result<Layout, MatError> {
        const COMPACT: u8 = 0;
        const CONTIGUOUS: u8 = 1;
        let filters = find(messages, FILTERS).map_or(Ok(Vec::new()), filter::read)?;
        let mut bytes = find(messages, LAYOUT).ok_or(MatError::Damaged("a variable has no values"))?;
        let version = bytes.u8()?;
        if !matches!(version, 3..=5) {
            return Ok(Layout::Unknown("its values lie as in files from before 2005"));
        }
        match bytes.u8()? {
            COMPACT => {
                let length = bytes.u16()?;
                Ok(Layout::Compact(bytes.take(length.into())?.to_vec()))
            }
            CONTIGUOUS => Ok(Layout::Contiguous { address: bytes.u64()? }),
            _ if version != 3 => Ok(Layout::Unknown("its values lie in pieces of a newer kind")),
            _ => Ok(Layout::Chunked(Chunking::read(bytes, rank, value_bytes, filters)?)),
        }
    }
}

impl Dataset {
    /// Gives the values of the `chosen` columns, each of which must be there.
    pub(in crate::mat) fn read<R: Read + Seek>(
        &self,
        reader: &mut Reader<'_, R>,
        chosen: &[usize],
        visit: &mut Visit<'_>,
    ) -> Result<(), MatError> {
        match &self.layout {
            Layout::Compact(values) => {
                let column_bytes = self.rows.checked_mul(self.number.bytes);
                let column_bytes = column_bytes.filter(|bytes| {
                    bytes.checked_mul(self.columns).is_some_and(|expected| expected == values.len())
                });
                let column_bytes = column_bytes.ok_or(MatError::Damaged(OTHER_COUNT))?;
                for column in chosen {
                    let start = column * column_bytes;
                    self.visit_run(*column, &values[start..start + column_bytes], visit)?;
                }
                Ok(())
            }
            Layout::Contiguous { address: UNDEFINED } => Err(MatError::Damaged(NOT_WRITTEN)),
            Layout::Contiguous { address } => {
                let (rows, size) = (self.rows as u64, self.number.bytes as u64);
                for column in chosen {
                    let mut row = 0;
                    while row < rows {
                        let count = AT_ONCE.min(rows - row);
                        let before =
                            (*column as u64).checked_mul(rows).and_then(|values| values.checked_add(row));
                        let before = before.and_then(|values| values.checked_mul(size)).unwrap_or(UNDEFINED);
                        let values = reader.read(address.saturating_add(before), count * size)?;
                        self.visit_run(*column, &values, visit)?;
                        row += count;
                    }
                }
                Ok(())
            }
            Layout::Chunked(chunking) => chunking.read_values(self, reader, chosen, visit),
            Layout::Unknown(why) => Err(MatError::Hdf5(why)),
        }
    }

    /// Gives values that follow on each other in a column.
    pub(super) fn visit_run(
        &self,
        column: usize,
        values: &[u8],
        visit: &mut Visit<'_>,
    ) -> Result<(), MatError> {
        values.chunks_exact(self.number.bytes).try_for_each(|value| visit(column, self.number.value(value)))
    }
}
