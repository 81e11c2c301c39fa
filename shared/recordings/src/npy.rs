//! Arrays in NumPy's file format (`numpy.lib.format`): written row by row as version 1.0, and read in place.
//!
//! ```text
//! \x93NUMPY 1 0 | header length | {'descr': '<f4', 'fortran_order': False, 'shape': (n, …), }   \n | data …
//! ```
//! The number of rows is only known at the end, so the header is written with room to spare and again at the
//! end.

use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use crate::mapped::MappedFile;

/// A multiple of 64, as the format asks, that leaves room for any number of rows.
const HEADER_BYTES: usize = 192;

const BUFFER_BYTES: usize = 1 << 18;

/// What an array can hold.
pub(crate) trait Element: Copy + bytemuck::Pod {
    /// NumPy's name of the type: byte order, kind, bytes.
    const DESCRIPTION: &'static str;
}

// Arrays are written and read as they are in memory.
const _: () = assert!(cfg!(target_endian = "little"), "arrays are little-endian");

impl Element for f32 {
    const DESCRIPTION: &'static str = "<f4";
}

impl Element for u8 {
    const DESCRIPTION: &'static str = "|u1";
}

impl Element for u16 {
    const DESCRIPTION: &'static str = "<u2";
}

impl Element for u32 {
    const DESCRIPTION: &'static str = "<u4";
}

/// An array `[n, …]` being written, n growing.
pub(crate) struct NpyWriter<T> {
    file: BufWriter<File>,
    row_shape: Vec<usize>,
    elements: u64,
    /// Of the bytes since the last flush.
    checksum: crc32fast::Hasher,
    element: std::marker::PhantomData<T>,
}

impl<T: Element> NpyWriter<T> {
    /// Begins an array of rows of shape `row_shape` (empty: rows are single values) in a new file.
    pub(crate) fn create(path: &Path, row_shape: &[usize]) -> io::Result<NpyWriter<T>> {
        let mut writer = NpyWriter::of(File::create(path)?, row_shape);
        writer.write_header()?;
        Ok(writer)
    }

    /// Goes on with the array at `path`, or begins it. `blocks` are the rows and the checksum of what was written
    /// from one flush to the next; the array keeps those that are as they were, up to the first that is not. The
    /// result is also how many it keeps.
    pub(crate) fn resume(
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
    pub(crate) fn rows(&self) -> u64 {
        self.elements / self.row_elements() as u64
    }

    /// Appends values, in the order of the array's indices.
    pub(crate) fn write(&mut self, values: &[T]) -> io::Result<()> {
        let bytes = bytemuck::cast_slice(values);
        self.checksum.update(bytes);
        self.elements += values.len() as u64;
        self.file.write_all(bytes)
    }

    /// Hands what was written to the system, so that the end of this process does not lose it. The result is the
    /// CRC-32 of what was appended since the last flush, or since rows were taken back.
    pub(crate) fn flush(&mut self) -> io::Result<u32> {
        self.file.flush()?;
        Ok(std::mem::take(&mut self.checksum).finalize())
    }

    /// Takes back all rows but the first `rows`.
    pub(crate) fn truncate(&mut self, rows: u64) -> io::Result<()> {
        self.elements = rows * self.row_elements() as u64;
        let bytes = HEADER_BYTES as u64 + self.elements * size_of::<T>() as u64;
        self.file.seek(SeekFrom::Start(bytes))?;
        self.checksum.reset();
        self.file.get_ref().set_len(bytes)
    }

    /// Ends the array: only now does its file tell how many rows it has.
    pub(crate) fn finish(mut self) -> io::Result<()> {
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

/// An array `[n, …]` of a file, mapped into memory.
#[derive(Debug)]
pub(crate) struct MappedArray<T> {
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
    /// What is wrong with the file, as a sentence.
    pub(crate) fn open(path: &Path, row_dimensions: usize) -> Result<MappedArray<T>, String> {
        let file = MappedFile::open(path).map_err(|error| error.to_string())?;
        let header = Header::parse(file.bytes())?;
        if header.description != T::DESCRIPTION {
            return Err(format!("it holds values of type {}, not {}", header.description, T::DESCRIPTION));
        }
        let Some((&rows, row_shape)) = header.shape.split_first() else {
            return Err("it holds a single value, not an array".to_owned());
        };
        if row_shape.len() != row_dimensions {
            return Err(format!("it has {} dimensions, not {}", header.shape.len(), row_dimensions + 1));
        }
        let expected =
            header.shape.iter().try_fold(size_of::<T>(), |bytes, length| bytes.checked_mul(*length));
        let data = &file.bytes()[header.bytes..];
        if expected != Some(data.len()) {
            return Err(format!(
                "{} bytes of data do not make an array {:?}: is it complete?",
                data.len(),
                header.shape
            ));
        }
        bytemuck::try_cast_slice::<u8, T>(data)
            .map_err(|error| format!("its data cannot be read in place ({error}): write it with NumPy"))?;
        let row_shape = row_shape.to_vec();
        Ok(MappedArray { data_start: header.bytes, rows, row_shape, file, element: std::marker::PhantomData })
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    pub(crate) fn row_shape(&self) -> &[usize] {
        &self.row_shape
    }

    /// Row `index`, in the order of the array's indices.
    ///
    /// # Panics
    /// When there is no such row.
    pub(crate) fn row(&self, index: usize) -> &[T] {
        let values: &[T] = bytemuck::cast_slice(&self.file.bytes()[self.data_start..]);
        let length: usize = self.row_shape.iter().product();
        &values[index * length..][..length]
    }

    /// Says that all rows before `index` have been read.
    pub(crate) fn release_before(&mut self, index: usize) {
        let length: usize = self.row_shape.iter().product();
        self.file.release_before(self.data_start + index * length * size_of::<T>());
    }
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
    /// What is wrong with it, as a sentence.
    pub fn parse(file: &[u8]) -> Result<Header, String> {
        let broken = || "it is no NumPy array (.npy), or its header is damaged".to_owned();
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
            return Err("it is in Fortran order: save it with numpy.ascontiguousarray".to_owned());
        }
        let (shape, _) =
            value("shape").and_then(|value| value.strip_prefix('(')?.split_once(')')).ok_or_else(broken)?;
        let shape = shape
            .split(',')
            .map(str::trim)
            .filter(|length| !length.is_empty())
            .map(|length| length.parse().map_err(|_| broken()))
            .collect::<Result<Vec<usize>, String>>()?;
        Ok(Header { description, shape, bytes })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::{any, prop, proptest};

    use super::*;

    fn written(values: &[f32]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("array.npy");
        let mut writer = NpyWriter::<f32>::create(&path, &[2, 3]).unwrap();
        writer.write(values).unwrap();
        writer.finish().unwrap();
        (folder, path)
    }

    #[test]
    fn what_is_written_is_read_in_place() {
        let values: Vec<f32> = (0..18).map(|value| value as f32 * 0.5).collect();
        let (_folder, path) = written(&values);
        let mut array = MappedArray::<f32>::open(&path, 2).unwrap();
        assert_eq!((array.rows(), array.row_shape()), (3, &[2, 3][..]));
        assert_eq!(array.row(2), &values[12..]);
        array.release_before(2);
        assert_eq!(array.row(0), &values[..6]);
    }

    #[test]
    fn what_does_not_fit_is_refused_in_words() {
        let (_folder, path) = written(&[0.0; 12]);
        let refused = |found: Result<MappedArray<f32>, String>| found.map(|_| ()).unwrap_err();
        assert!(MappedArray::<u8>::open(&path, 2).map(|_| ()).unwrap_err().contains("type <f4, not |u1"));
        assert!(refused(MappedArray::open(&path, 1)).contains("3 dimensions, not 2"));
        let complete = std::fs::read(&path).unwrap();
        std::fs::write(&path, &complete[..complete.len() - 4]).unwrap();
        assert!(refused(MappedArray::open(&path, 2)).contains("is it complete?"));
        std::fs::write(&path, b"PK\x03\x04").unwrap();
        assert!(refused(MappedArray::open(&path, 2)).contains("no NumPy array"));
    }

    #[test]
    fn a_header_of_numpy_itself_is_read() {
        let dictionary = "{'descr': '|u1', 'fortran_order': False, 'shape': (5,), }\n";
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((dictionary.len() as u16).to_le_bytes());
        bytes.extend(dictionary.as_bytes());
        let header = Header::parse(&bytes).unwrap();
        assert_eq!((header.description.as_str(), header.shape, header.bytes), ("|u1", vec![5], bytes.len()));
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_header_panic(tail in prop::collection::vec(any::<u8>(), 0..200), version in 0..5_u8) {
            let mut bytes = b"\x93NUMPY".to_vec();
            bytes.push(version);
            bytes.extend(tail);
            let _ = Header::parse(&bytes);
        }
    }

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
