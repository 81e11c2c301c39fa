//! What an array's file says before its data.

use std::io;

/// Why a file cannot be read as an array.
#[derive(Debug, thiserror::Error)]
pub enum NpyError {
    /// The file cannot be opened.
    #[error("{0}")]
    Read(io::Error),
    /// Another kind of file.
    #[error("it is not a NumPy array (.npy), or its header is damaged")]
    NoArray,
    /// The first index is the fastest.
    #[error("it is in Fortran order: save it with numpy.ascontiguousarray")]
    FortranOrder,
    /// Values of another type.
    #[error("it holds values of type {found}, not {expected}")]
    Type {
        /// NumPy's name of the type.
        found: String,
        /// That of the type wanted.
        expected: &'static str,
    },
    /// An array without dimensions.
    #[error("it holds a single value, not an array")]
    SingleValue,
    /// Too many dimensions, or too few.
    #[error("it has {found} dimensions, not {expected}")]
    Dimensions {
        /// Its dimensions.
        found: usize,
        /// Those wanted.
        expected: usize,
    },
    /// More or fewer data than the header promises.
    #[error("{bytes} bytes of data do not make an array of {}: is it complete?", product(shape))]
    Incomplete {
        /// Bytes after the header.
        bytes: usize,
        /// The shape in the header.
        shape: Vec<usize>,
    },
    /// The data begin where no value of their type can.
    #[error("its data are not aligned to their type: save it with NumPy")]
    Unaligned,
}

/// `100 × 4`.
fn product(shape: &[usize]) -> String {
    shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(" × ")
}

/// What stands before the data.
#[derive(Debug, PartialEq, Eq)]
pub struct Header {
    /// NumPy's name of the type of a value, e.g. `<f4`.
    pub description: String,
    /// Length of each dimension.
    pub shape: Vec<usize>,
    /// Where the data begin, in bytes.
    pub bytes: usize,
}

impl Header {
    /// Reads the head of `file`: versions 1.0 to 3.0 with the dictionary that `numpy.save` writes.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(file: &[u8]) -> Result<Header, NpyError> {
        let broken = || NpyError::NoArray;
        let version = file.strip_prefix(b"\x93NUMPY").and_then(|rest| rest.first()).ok_or_else(broken)?;
        let (length, start) = match (version, file.get(8..)) {
            (1, Some([low, high, ..])) => (usize::from(u16::from_le_bytes([*low, *high])), 10),
            (2 | 3, Some([a, b, c, d, ..])) => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, 12),
            _ => return Err(broken()),
        };
        let bytes = start + length;
        let text =
            file.get(start..bytes).and_then(|text| std::str::from_utf8(text).ok()).ok_or_else(broken)?;
        let value = |key: &str| text.split_once(&format!("'{key}':")).map(|(_, value)| value.trim_start());
        let description = value("descr")
            .and_then(|value| value.strip_prefix('\'')?.split_once('\''))
            .map(|(description, _)| description.to_owned())
            .ok_or_else(broken)?;
        if !value("fortran_order").is_some_and(|value| value.starts_with("False")) {
            return Err(NpyError::FortranOrder);
        }
        let (shape, _) =
            value("shape").and_then(|value| value.strip_prefix('(')?.split_once(')')).ok_or_else(broken)?;
        let shape = shape
            .split(',')
            .map(str::trim)
            .filter(|length| !length.is_empty())
            .map(|length| length.parse().map_err(|_| broken()))
            .collect::<Result<Vec<usize>, NpyError>>()?;
        Ok(Header { description, shape, bytes })
    }
}
