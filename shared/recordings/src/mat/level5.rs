//! MAT-files of level 5.
//!
//! ```text
//! 124 bytes text and offsets | version 0x0100 | IM: little endian
//! type, bytes | data            a variable is a matrix (type 14) …
//! type, bytes | zlib stream     … or a compressed one (type 15), in which the same is found
//!   matrix: flags, dimensions, name, then the values column by column, in the smallest type that holds them
//! ```

use std::io::{BufReader, Read, Seek, SeekFrom};

use flate2::bufread::ZlibDecoder;

use super::element::{COMPRESSED, INT8, INT32, MATRIX, Tag, UINT32, Values, read};
use super::problem::{MatError, OTHER_COUNT};
use super::variable::{Place, Variable, Visit};

/// Class of objects whose contents only MATLAB understands.
const OPAQUE: u8 = 17;

/// MATLAB allows names of 63 bytes; what is longer is damage.
const MAX_NAME_BYTES: u32 = 1 << 12;

/// The variables of a file, which begins with its header of 128 bytes.
pub(super) fn variables(file: &mut (impl Read + Seek)) -> Result<Vec<Variable>, MatError> {
    let length = file.seek(SeekFrom::End(0))?;
    let mut variables = Vec::new();
    let mut position = 128;
    while position < length {
        file.seek(SeekFrom::Start(position))?;
        let tag = Tag::read(file)?;
        let next = position + 8 + u64::from(tag.bytes);
        if next > length {
            return Err(MatError::Damaged("it ends within a variable"));
        }
        if matches!(tag.kind, MATRIX | COMPRESSED) {
            variables.extend(Variable::read_head(&mut matrix(file, position)?, position)?);
        }
        position = next;
    }
    Ok(variables)
}

/// Gives the values of `variable`, whose element begins at `position`, up to the last of the `chosen` columns.
pub(super) fn read_values(
    file: &mut (impl Read + Seek),
    variable: &Variable,
    position: u64,
    chosen: &[usize],
    visit: &mut Visit<'_>,
) -> Result<(), MatError> {
    let mut matrix = matrix(file, position)?;
    Variable::read_head(&mut matrix, position)?;
    let mut values = Values::read_tag(&mut matrix)?;
    let (rows, columns) = (variable.rows, variable.columns);
    if values.bytes != rows as u64 * columns as u64 * values.size() as u64 {
        return Err(MatError::Damaged(OTHER_COUNT));
    }
    let end = chosen.iter().max().map_or(0, |last| last + 1);
    for column in 0..end {
        let is_chosen = chosen.contains(&column);
        for _ in 0..rows {
            let value = values.next(&mut matrix)?;
            if is_chosen {
                visit(column, value)?;
            }
        }
    }
    Ok(())
}

/// The matrix whose element begins at `position`, after its tag.
fn matrix(file: &mut (impl Read + Seek), position: u64) -> Result<Box<dyn Read + '_>, MatError> {
    file.seek(SeekFrom::Start(position))?;
    let tag = Tag::read(file)?;
    let element = BufReader::new(file.take(u64::from(tag.bytes)));
    if tag.kind == MATRIX {
        return Ok(Box::new(element));
    }
    let mut element = BufReader::new(ZlibDecoder::new(element));
    if Tag::read(&mut element)?.kind != MATRIX {
        return Err(MatError::Damaged("a compressed element is not a variable"));
    }
    Ok(Box::new(element))
}

impl Variable {
    /// Reads a matrix up to its values; `None` if it has no name or is no matrix at all.
    fn read_head(matrix: &mut dyn Read, position: u64) -> Result<Option<Variable>, MatError> {
        let flags = Tag::read(matrix)?;
        if flags.kind != UINT32 || flags.bytes != 8 {
            return Ok(None);
        }
        let [class, flags, ..] = read::<8>(matrix)?;
        if class == OPAQUE {
            return Variable::read_opaque(matrix).map(Some);
        }
        let dimensions = Tag::read(matrix)?;
        if dimensions.kind != INT32 || dimensions.bytes < 8 || dimensions.bytes > MAX_NAME_BYTES {
            return Err(MatError::Damaged("a variable has no dimensions"));
        }
        let lengths = dimensions.read_data(matrix)?;
        let mut lengths = lengths
            .chunks_exact(4)
            .map(|length| u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize);
        let (rows, columns) = (lengths.next().unwrap_or(0), lengths.next().unwrap_or(0));
        let is_flat = lengths.next().is_none();
        let name = read_name(matrix)?;
        const COMPLEX: u8 = 0x08;
        let other = match class {
            1 => Some("a cell array"),
            2 => Some("a structure"),
            3 => Some("an object"),
            4 => Some("text"),
            5 => Some("a sparse matrix"),
            // Double, single and the integers.
            6..=15 if flags & COMPLEX != 0 => Some("a matrix of complex numbers"),
            6..=15 if !is_flat => Some("an array of more than two dimensions"),
            6..=15 => None,
            16 => Some("a function handle"),
            _ => Some("of a class that is not known"),
        };
        Ok(Some(Variable {
            name,
            other: other.map(str::to_owned),
            rows,
            columns,
            place: Place::Element(position),
        }))
    }

    /// Reads the head of an object of a MATLAB class, such as `string` and `datetime`. After the flags, it has three names
    /// instead of dimensions and a name: its own, the system (`MCOS`, `java`) and the class.
    fn read_opaque(matrix: &mut dyn Read) -> Result<Variable, MatError> {
        let name = read_name(matrix)?;
        read_name(matrix)?;
        let class = read_name(matrix)?;
        let other = Some(format!("of the MATLAB class {class}"));
        Ok(Variable { name, other, rows: 0, columns: 0, place: Place::Nowhere })
    }
}

fn read_name(matrix: &mut dyn Read) -> Result<String, MatError> {
    let name = Tag::read(matrix)?;
    if name.kind != INT8 || name.bytes > MAX_NAME_BYTES {
        return Err(MatError::Damaged("a variable has no name"));
    }
    Ok(String::from_utf8_lossy(&name.read_data(matrix)?).into_owned())
}
