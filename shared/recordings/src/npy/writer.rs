//! An array that is written row by row.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use super::Element;

/// A multiple of 64, as the format asks, that leaves room for any number of rows.
pub(super) const HEADER_BYTES: usize = 192;

const BUFFER_BYTES: usize = 1 << 18;

/// An array `[n, …]` being written, n growing.
pub struct NpyWriter<T> {
    file: BufWriter<File>,
    row_shape: Vec<usize>,
    elements: u64,
    /// Of the bytes since the last flush.
    checksum: crc32fast::Hasher,
    element: std::marker::PhantomData<T>,
}

impl<T: Element> NpyWriter<T> {
    /// Begins an array of rows of shape `row_shape` (empty: rows are single values) in a new file.
    ///
    /// # Errors
    /// What the system says.
    pub fn create(path: &Path, row_shape: &[usize]) -> io::Result<NpyWriter<T>> {
        let mut writer = NpyWriter::of(File::create(path)?, row_shape);
        writer.write_header()?;
        Ok(writer)
    }

    /// Goes on with the array at `path`, or begins it. `blocks` are the rows and the checksum of what was written
    /// from one flush to the next; the array keeps those that are as they were, up to the first that is not. The
    /// result is also how many it keeps.
    ///
    /// # Errors
    /// What the system says.
    pub fn resume(
        path: &Path,
        row_shape: &[usize],
        blocks: &[(u64, u32)],
    ) -> io::Result<(NpyWriter<T>, usize)> {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut writer = NpyWriter::of(file, row_shape);
        let row_bytes = (writer.row_elements() * size_of::<T>()) as u64;
        let mut reader = BufReader::with_capacity(BUFFER_BYTES, writer.file.get_ref().try_clone()?);
        reader.seek(SeekFrom::Start(HEADER_BYTES as u64))?;
        let mut kept = 0;
        for &(rows, checksum) in blocks {
            let bytes = rows * row_bytes;
            if checksum_of((&mut reader).take(bytes))? != (bytes, checksum) {
                break;
            }
            writer.elements += rows * writer.row_elements() as u64;
            kept += 1;
        }
        let rows = writer.rows();
        writer.file.seek(SeekFrom::Start(0))?;
        writer.write_header()?;
        writer.truncate(rows)?;
        Ok((writer, kept))
    }

    fn of(file: File, row_shape: &[usize]) -> NpyWriter<T> {
        NpyWriter {
            file: BufWriter::with_capacity(BUFFER_BYTES, file),
            row_shape: row_shape.to_vec(),
            elements: 0,
            checksum: crc32fast::Hasher::new(),
            element: std::marker::PhantomData,
        }
    }

    fn row_elements(&self) -> usize {
        self.row_shape.iter().product()
    }

    /// Rows so far.
    pub fn rows(&self) -> u64 {
        self.elements / self.row_elements() as u64
    }

    /// Appends values, in the order of the array's indices.
    ///
    /// # Errors
    /// What the system says.
    pub fn write(&mut self, values: &[T]) -> io::Result<()> {
        let bytes = bytemuck::cast_slice(values);
        self.checksum.update(bytes);
        self.elements += values.len() as u64;
        self.file.write_all(bytes)
    }

    /// Hands what was written to the system, so that the end of this process does not lose it. The result is the
    /// CRC-32 of what was appended since the last flush, or since rows were taken back.
    ///
    /// # Errors
    /// What the system says.
    pub fn flush(&mut self) -> io::Result<u32> {
        self.file.flush()?;
        Ok(std::mem::take(&mut self.checksum).finalize())
    }

    /// Takes back all rows but the first `rows`.
    ///
    /// # Errors
    /// What the system says.
    pub fn truncate(&mut self, rows: u64) -> io::Result<()> {
        self.elements = rows * self.row_elements() as u64;
        let bytes = HEADER_BYTES as u64 + self.elements * size_of::<T>() as u64;
        self.file.seek(SeekFrom::Start(bytes))?;
        self.checksum.reset();
        self.file.get_ref().set_len(bytes)
    }

    /// Ends the array: only now does its file tell how many rows it has.
    ///
    /// # Errors
    /// What the system says.
    pub fn finish(mut self) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        self.write_header()?;
        self.file.flush()
    }

    fn write_header(&mut self) -> io::Result<()> {
        let rows = self.rows();
        let row_shape: String = self.row_shape.iter().map(|length| format!(" {length},")).collect();
        let descr = T::DESCRIPTION;
        let dictionary =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({rows},{row_shape}), }}");
        let padded_bytes = HEADER_BYTES - 10;
        self.file.write_all(b"\x93NUMPY\x01\x00")?;
        self.file.write_all(&(padded_bytes as u16).to_le_bytes())?;
        writeln!(self.file, "{dictionary:<width$}", width = padded_bytes - 1)
    }
}

/// How many bytes there are, and their CRC-32.
fn checksum_of(mut bytes: impl Read) -> io::Result<(u64, u32)> {
    let mut checksum = crc32fast::Hasher::new();
    let mut buffer = vec![0; BUFFER_BYTES];
    let mut count = 0;
    loop {
        let read = bytes.read(&mut buffer)?;
        if read == 0 {
            return Ok((count, checksum.finalize()));
        }
        count += read as u64;
        checksum.update(&buffer[..read]);
    }
}
