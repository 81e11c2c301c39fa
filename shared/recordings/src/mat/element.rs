//! Elements of a MAT-file: a tag that says type and length, and the values after it.

use std::io::Read;

use super::problem::MatError;

pub(super) const INT8: u32 = 1;
pub(super) const UINT8: u32 = 2;
pub(super) const INT16: u32 = 3;
pub(super) const UINT16: u32 = 4;
pub(super) const INT32: u32 = 5;
pub(super) const UINT32: u32 = 6;
pub(super) const SINGLE: u32 = 7;
pub(super) const DOUBLE: u32 = 9;
pub(super) const INT64: u32 = 12;
pub(super) const UINT64: u32 = 13;
pub(super) const MATRIX: u32 = 14;
pub(super) const COMPRESSED: u32 = 15;

/// Type and length of what follows; up to four bytes follow within the tag itself.
pub(super) struct Tag {
    pub(super) kind: u32,
    pub(super) bytes: u32,
    within: Option<[u8; 4]>,
}

impl Tag {
    pub(super) fn read(from: &mut (impl Read + ?Sized)) -> Result<Tag, MatError> {
        let [a, b, c, d, e, f, g, h] = read::<8>(from)?;
        let (kind, small_bytes) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
        match small_bytes {
            0 => {
                let bytes = u32::from_le_bytes([e, f, g, h]);
                Ok(Tag { kind: kind.into(), bytes, within: None })
            }
            1..=4 => Ok(Tag { kind: kind.into(), bytes: small_bytes.into(), within: Some([e, f, g, h]) }),
            _ => Err(MatError::Damaged("an element has no type")),
        }
    }

    /// The data and the padding to a multiple of eight after them. For short ones only.
    pub(super) fn read_data(&self, from: &mut dyn Read) -> Result<Vec<u8>, MatError> {
        if let Some(within) = self.within {
            return Ok(within[..self.bytes as usize].to_vec());
        }
        let mut data = vec![0; self.bytes.next_multiple_of(8) as usize];
        from.read_exact(&mut data)?;
        data.truncate(self.bytes as usize);
        Ok(data)
    }
}

/// The values of a matrix, one after the other.
pub(super) struct Values {
    kind: u32,
    pub(super) bytes: u64,
    within: Option<[u8; 4]>,
}

impl Values {
    pub(super) fn read_tag(matrix: &mut dyn Read) -> Result<Values, MatError> {
        let Tag { kind, bytes, within } = Tag::read(matrix)?;
        let values = Values { kind, bytes: bytes.into(), within };
        match kind {
            INT8 | UINT8 | INT16 | UINT16 | INT32 | UINT32 | SINGLE | DOUBLE | INT64 | UINT64 => Ok(values),
            _ => Err(MatError::Damaged("values have no known type")),
        }
    }

    /// Bytes of a value.
    pub(super) fn size(&self) -> usize {
        match self.kind {
            INT8 | UINT8 => 1,
            INT16 | UINT16 => 2,
            INT32 | UINT32 | SINGLE => 4,
            _ => 8,
        }
    }

    pub(super) fn next(&mut self, matrix: &mut dyn Read) -> Result<f64, MatError> {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..self.size()];
        match &mut self.within {
            Some(within) => {
                bytes.copy_from_slice(
                    within.get(..bytes.len()).ok_or(MatError::Damaged("a value is too long"))?,
                );
                within.rotate_left(bytes.len());
            }
            None => matrix.read_exact(bytes)?,
        }
        Ok(match (self.kind, &*bytes) {
            (INT8, &[a]) => f64::from(a as i8),
            (UINT8, &[a]) => f64::from(a),
            (INT16, &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
            (UINT16, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (INT32, &[a, b, c, d]) => f64::from(i32::from_le_bytes([a, b, c, d])),
            (UINT32, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (SINGLE, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (INT64, &[a, b, c, d, e, f, g, h]) => i64::from_le_bytes([a, b, c, d, e, f, g, h]) as f64,
            (UINT64, &[a, b, c, d, e, f, g, h]) => u64::from_le_bytes([a, b, c, d, e, f, g, h]) as f64,
            (_, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => return Err(MatError::Damaged("values have no known type")),
        })
    }
}

pub(super) fn read<const N: usize>(from: &mut (impl Read + ?Sized)) -> Result<[u8; N], MatError> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}
