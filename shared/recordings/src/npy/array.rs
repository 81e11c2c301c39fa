//! An array that is read in place.

use std::path::Path;

use super::{Element, Header, NpyError};
use crate::mapped::MappedFile;

/// An array `[n, …]` of a file, mapped into memory.
#[derive(Debug)]
pub struct MappedArray<T> {
    file: MappedFile,
    data_start: usize,
    rows: usize,
    row_shape: Vec<usize>,
    element: std::marker::PhantomData<T>,
}

impl<T: Element> MappedArray<T> {
    /// Maps the array at `path`, whose rows must have `row_dimensions` dimensions.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn open(path: &Path, row_dimensions: usize) -> Result<MappedArray<T>, NpyError> {
        let file = MappedFile::open(path).map_err(NpyError::Read)?;
        let header = Header::parse(file.bytes())?;
        if header.description != T::DESCRIPTION {
            return Err(NpyError::Type { found: header.description, expected: T::DESCRIPTION });
        }
        let Some((&rows, row_shape)) = header.shape.split_first() else {
            return Err(NpyError::SingleValue);
        };
        if row_shape.len() != row_dimensions {
            return Err(NpyError::Dimensions { found: header.shape.len(), expected: row_dimensions + 1 });
        }
        let expected =
            header.shape.iter().try_fold(size_of::<T>(), |bytes, length| bytes.checked_mul(*length));
        let data = &file.bytes()[header.bytes..];
        if expected != Some(data.len()) {
            return Err(NpyError::Incomplete { bytes: data.len(), shape: header.shape });
        }
        bytemuck::try_cast_slice::<u8, T>(data).map_err(|_| NpyError::Unaligned)?;
        let row_shape = row_shape.to_vec();
        Ok(MappedArray { data_start: header.bytes, rows, row_shape, file, element: std::marker::PhantomData })
    }

    /// Rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Length of each dimension of a row.
    pub fn row_shape(&self) -> &[usize] {
        &self.row_shape
    }

    /// Row `index`, in the order of the array's indices.
    ///
    /// # Panics
    /// When there is no such row.
    pub fn row(&self, index: usize) -> &[T] {
        let values: &[T] = bytemuck::cast_slice(&self.file.bytes()[self.data_start..]);
        let length: usize = self.row_shape.iter().product();
        &values[index * length..][..length]
    }

    /// Says that all rows before `index` have been read.
    pub fn release_before(&mut self, index: usize) {
        let length: usize = self.row_shape.iter().product();
        self.file.release_before(self.data_start + index * length * size_of::<T>());
    }
}
