//! Arrays in NumPy's file format (`numpy.lib.format`): written row by row as version 1.0, and read in place.
//!
//! ```text
//! \x93NUMPY 1 0 | header length | {'descr': '<f4', 'fortran_order': False, 'shape': (n, …), }   \n | data …
//! ```
//! The number of rows is only known at the end, so the header is written with room to spare and again at the
//! end.

mod array;
mod header;
mod writer;

pub use array::MappedArray;
pub use header::{Header, NpyError};
pub use writer::NpyWriter;

/// What an array can hold.
pub trait Element: Copy + bytemuck::Pod {
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

#[cfg(test)]
mod tests {
    use proptest::prelude::{any, prop, proptest};

    use super::writer::HEADER_BYTES;
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
        let refused = |found: Result<MappedArray<f32>, NpyError>| found.map(|_| ()).unwrap_err().to_string();
        assert!(
            MappedArray::<u8>::open(&path, 2)
                .map(|_| ())
                .unwrap_err()
                .to_string()
                .contains("type <f4, not |u1")
        );
        assert!(refused(MappedArray::open(&path, 1)).contains("3 dimensions, not 2"));
        let complete = std::fs::read(&path).unwrap();
        std::fs::write(&path, &complete[..complete.len() - 4]).unwrap();
        assert!(refused(MappedArray::open(&path, 2)).contains("is it complete?"));
        std::fs::write(&path, b"PK\x03\x04").unwrap();
        assert!(refused(MappedArray::open(&path, 2)).contains("not a NumPy array"));
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
