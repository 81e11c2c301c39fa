//! Values in chunks of one size, each filtered by itself and found by a B-tree.
//!
//! ```text
//!            rows of MATLAB's
//!          ┌───────┬───────┬───────┐
//! columns  │   1   │   2   │   3 ░░│     the order in which the tree has them;
//!          ├───────┼───────┼───────┤     ░ beyond the last row or column, not used
//!          │   4 ░░│   5 ░░│   6 ░░│
//!          └───────┴───────┴───────┘
//! ```

use std::io::{Read, Seek};

use super::bytes::Bytes;
use super::dataset::Dataset;
use super::filter::{self, Filter};
use super::tree::{Child, Node};
use super::{NOT_WRITTEN, Reader, UNDEFINED};
use crate::mat::problem::{MatError, OTHER_COUNT};
use crate::mat::variable::Visit;

/// Largest chunk in bytes: MATLAB's have less than a thousandth of it.
const LARGEST: usize = 1 << 28;

/// How the values of a matrix lie in chunks.
#[derive(Clone, Debug)]
pub(super) struct Chunking {
    tree: u64,
    filters: Vec<Filter>,
    /// Length of a chunk in MATLAB's columns and rows.
    columns: usize,
    rows: usize,
    /// Dimensions of the matrix in the file.
    rank: usize,
}

/// A chunk as the tree gives it.
struct Chunk {
    first_column: u64,
    first_row: u64,
    bytes: u64,
    /// Filters that were not applied, a bit each.
    left_out: u32,
    address: u64,
}

impl Chunking {
    /// Reads the rest of the layout of a matrix of this many dimensions.
    pub(super) fn read(
        mut bytes: Bytes<'_>,
        rank: usize,
        value_bytes: usize,
        filters: Vec<Filter>,
    ) -> Result<Chunking, MatError> {
        const DAMAGED: MatError = MatError::Damaged("the pieces of a variable have no size");
        // The size of a value counts as one more dimension.
        if usize::from(bytes.u8()?) != rank + 1 {
            return Err(DAMAGED);
        }
        let tree = bytes.u64()?;
        let mut lengths = Vec::new();
        for _ in 0..=rank {
            lengths.push(bytes.u32()? as usize);
        }
        let (columns, rows) = match lengths[..] {
            [rows, size] if size == value_bytes => (1, rows),
            [columns, rows, size] if size == value_bytes => (columns, rows),
            _ => return Err(DAMAGED),
        };
        if columns == 0 || rows == 0 {
            return Err(DAMAGED);
        }
        Ok(Chunking { tree, filters, columns, rows, rank })
    }

    /// Gives the values of the `chosen` columns of `matrix`.
    pub(super) fn read_values<R: Read + Seek>(
        &self,
        matrix: &Dataset,
        reader: &mut Reader<'_, R>,
        chosen: &[usize],
        visit: &mut Visit<'_>,
    ) -> Result<(), MatError> {
        let size = matrix.number.bytes;
        let whole = self.columns.checked_mul(self.rows).and_then(|values| values.checked_mul(size));
        let whole = whole
            .filter(|bytes| *bytes <= LARGEST)
            .ok_or(MatError::Hdf5("its values lie in pieces of more than 256 MiB"))?;
        let mut chunks = Vec::new();
        if self.tree != UNDEFINED {
            self.list(reader, self.tree, None, &mut chunks)?;
        }
        let mut chunks = chunks.into_iter();
        for first_column in (0..matrix.columns).step_by(self.columns) {
            let chosen = chosen.iter().filter(|column| (first_column..).contains(*column));
            let chosen: Vec<usize> =
                chosen.filter(|column| **column - first_column < self.columns).copied().collect();
            for first_row in (0..matrix.rows).step_by(self.rows) {
                let is_here = |chunk: &Chunk| {
                    (chunk.first_column, chunk.first_row) == (first_column as u64, first_row as u64)
                };
                let chunk = chunks.next().filter(is_here).ok_or(MatError::Damaged(NOT_WRITTEN))?;
                if chosen.is_empty() {
                    continue;
                }
                let stored = reader.read(chunk.address, chunk.bytes)?;
                let values = filter::undo(&self.filters, chunk.left_out, stored, whole)?;
                if values.len() != whole {
                    return Err(MatError::Damaged(OTHER_COUNT));
                }
                let rows = self.rows.min(matrix.rows - first_row);
                for column in &chosen {
                    let start = (column - first_column) * self.rows * size;
                    matrix.visit_run(*column, &values[start..start + rows * size], visit)?;
                }
            }
        }
        Ok(())
    }

    /// Appends the chunks below a node of the tree.
    fn list<R: Read + Seek>(
        &self,
        reader: &mut Reader<'_, R>,
        address: u64,
        level: Option<u8>,
        chunks: &mut Vec<Chunk>,
    ) -> Result<(), MatError> {
        const KIND: u8 = 1;
        let node = Node::read(reader, address, KIND, level, 8 + 8 * (self.rank + 1))?;
        for Child { key, address: child } in node.children {
            if let Some(below) = node.level.checked_sub(1) {
                self.list(reader, child, Some(below), chunks)?;
                continue;
            }
            let mut key = Bytes::new(&key);
            let (bytes, left_out) = (u64::from(key.u32()?), key.u32()?);
            let first_column = if self.rank == 2 { key.u64()? } else { 0 };
            let first_row = key.u64()?;
            chunks.push(Chunk { first_column, first_row, bytes, left_out, address: child });
        }
        Ok(())
    }
}
