//! Arrays in NumPy's file format, version 1.0 (`numpy.lib.format`), written row by row.
//!
//! ```text
//! \x93NUMPY 1 0 | header length | {'descr': '<f4', 'fortran_order': False, 'shape': (n, …), }   \n | data …
//! ```
//! The number of rows is only known at the end, so the header is written with room to spare and again at the
//! end.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// A multiple of 64, as the format asks, that leaves room for any number of rows.
const HEADER_BYTES: usize = 192;

/// What an array can hold.
pub(crate) trait Element: Copy {
    /// NumPy's name of the type: byte order, kind, bytes.
    const DESCRIPTION: &'static str;

    /// Writes the value in that byte order.
    fn write(self, writer: &mut impl Write) -> io::Result<()>;
}

impl Element for f32 {
    const DESCRIPTION: &'static str = "<f4";

    fn write(self, writer: &mut impl Write) -> io::Result<()> {
        writer.write_all(&self.to_le_bytes())
    }
}

impl Element for u8 {
    const DESCRIPTION: &'static str = "|u1";

    fn write(self, writer: &mut impl Write) -> io::Result<()> {
        writer.write_all(&[self])
    }
}

impl Element for u16 {
    const DESCRIPTION: &'static str = "<u2";

    fn write(self, writer: &mut impl Write) -> io::Result<()> {
        writer.write_all(&self.to_le_bytes())
    }
}

/// An array `[n, …]` being written, n growing.
pub(crate) struct NpyWriter<T> {
    file: BufWriter<File>,
    row_shape: Vec<usize>,
    elements: u64,
    element: std::marker::PhantomData<T>,
}

impl<T: Element> NpyWriter<T> {
    /// Begins an array of rows of shape `row_shape` (empty: rows are single values) in a new file.
    pub(crate) fn create(path: &Path, row_shape: &[usize]) -> io::Result<NpyWriter<T>> {
        let file = BufWriter::with_capacity(1 << 18, File::create(path)?);
        let row_shape = row_shape.to_vec();
        let mut writer = NpyWriter { file, row_shape, elements: 0, element: std::marker::PhantomData };
        writer.write_header()?;
        Ok(writer)
    }

    /// Appends values, in the order of the array's indices.
    pub(crate) fn write(&mut self, values: &[T]) -> io::Result<()> {
        for &value in values {
            value.write(&mut self.file)?;
        }
        self.elements += values.len() as u64;
        Ok(())
    }

    /// Ends the array: only now does its file tell how many rows it has.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(0))?;
        self.write_header()?;
        self.file.flush()
    }

    fn write_header(&mut self) -> io::Result<()> {
        let row_elements: usize = self.row_shape.iter().product();
        let rows = self.elements / row_elements as u64;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_says_what_was_written_and_the_data_follow_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("array.npy");
        let mut writer = NpyWriter::<f32>::create(&path, &[2, 3]).unwrap();
        writer.write(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        writer.write(&[6.0, -1.0, -2.0, -3.0, -4.0, -5.0, -6.5]).unwrap();
        writer.finish().unwrap();

        let bytes = std::fs::read(&path).unwrap();
        let (header, data) = bytes.split_at(HEADER_BYTES);
        assert_eq!(&header[..10], [0x93, b'N', b'U', b'M', b'P', b'Y', 1, 0, 182, 0]);
        let text = std::str::from_utf8(&header[10..]).unwrap();
        assert_eq!(text.trim_end(), "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2, 3,), }");
        assert!(text.ends_with('\n'));
        let values: Vec<f32> =
            data.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
        assert_eq!(values, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -1.0, -2.0, -3.0, -4.0, -5.0, -6.5]);
    }
}
