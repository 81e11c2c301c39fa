//! Numbers out of MATLAB's MAT-files: of level 5, which `save -v7`, `save -v6` and SciPy write, and of version 7.3, which
//! `save -v7.3` and hdf5storage write.
//!
//! ```text
//! level 5   a compressed element a variable       (level5, element)
//! 7.3       HDF5, a matrix a variable             (hdf5)
//! ```
//! Variables of MATLAB's own classes (text, cells, structures, objects such as `string` and `datetime`) are known by name only.
//!
//! A matrix is read as it is decompressed: of one of 1280000 × 4 only the columns asked for come into memory, as `f32`.

mod element;
mod hdf5;
mod level5;
mod problem;
mod variable;

use std::io::{Read, Seek, SeekFrom};

pub use problem::MatError;

use variable::{Place, Variable, Visit};

/// An open MAT-file.
#[derive(Debug)]
pub struct MatFile<R> {
    file: R,
    variables: Vec<Variable>,
    /// Where the HDF5 in it begins; 0 of level 5.
    superblock: u64,
}

impl<R: Read + Seek> MatFile<R> {
    /// Reads which variables `file` holds.
    ///
    /// # Errors
    /// When it is not a MAT-file of level 5 or version 7.3, or damaged.
    pub fn open(mut file: R) -> Result<MatFile<R>, MatError> {
        let mut header = [0; 128];
        if file.seek(SeekFrom::End(0))? < 128 {
            return Err(MatError::NoMatFile);
        }
        file.seek(SeekFrom::Start(0))?;
        file.read_exact(&mut header)?;
        match (&header[124..126], &header[126..]) {
            _ if header.starts_with(b"\x89HDF") => {}
            ([0x00, 0x02], b"IM") | ([0x02, 0x00], b"MI") => {}
            ([0x00, 0x01], b"IM") => {
                let variables = level5::variables(&mut file)?;
                return Ok(MatFile { file, variables, superblock: 0 });
            }
            ([0x01, 0x00], b"MI") => return Err(MatError::BigEndian),
            _ => return Err(MatError::NoMatFile),
        }
        let superblock = hdf5::superblock(&mut file)?;
        let superblock = superblock.ok_or(MatError::Damaged("it should hold HDF5, and holds none"))?;
        let variables = hdf5::variables(&mut file, superblock)?;
        Ok(MatFile { file, variables, superblock })
    }

    fn variable(&self, name: &'static str) -> Result<Variable, MatError> {
        self.variables.iter().find(|variable| variable.name == name).cloned().ok_or_else(|| {
            let names = self.variables.iter().map(|variable| variable.name.clone());
            let available = names.filter(|name| !name.is_empty()).collect();
            MatError::NoVariable { name, available }
        })
    }

    /// The single number that `name` holds; `None` if there is no such variable, or it holds something else.
    ///
    /// # Errors
    /// When the file is damaged there.
    pub fn number(&mut self, name: &'static str) -> Result<Option<f64>, MatError> {
        let Ok(variable) = self.variable(name) else { return Ok(None) };
        if variable.other.is_some() || (variable.rows, variable.columns) != (1, 1) {
            return Ok(None);
        }
        let mut number = None;
        self.read_values(&variable, &[0], &mut |_, value| {
            number = Some(value);
            Ok(())
        })?;
        Ok(number)
    }

    /// Rows and columns of the matrix `name`.
    ///
    /// # Errors
    /// When there is no such variable, or it is not a matrix of real numbers.
    pub fn shape(&self, name: &'static str) -> Result<(usize, usize), MatError> {
        let Variable { other, rows, columns, .. } = self.variable(name)?;
        if let Some(found) = other {
            return Err(MatError::Shape { name, found, expected: "a matrix of real numbers" });
        }
        Ok((rows, columns))
    }

    /// Columns of the matrix `name`, in the order of `channels` (from 0). A matrix with more columns than rows
    /// must be transposed before it is saved.
    ///
    /// # Errors
    /// When there is no such variable or column, it is not a matrix of real numbers, a value is not finite, or the
    /// file is damaged.
    pub fn columns(&mut self, name: &'static str, channels: &[usize]) -> Result<Vec<Vec<f32>>, MatError> {
        let (rows, columns) = self.shape(name)?;
        if columns > rows {
            let found = format!("{rows} × {columns}");
            return Err(MatError::Shape { name, found, expected: "samples × channels: transpose it" });
        }
        if let Some(&channel) = channels.iter().find(|&&channel| channel >= columns) {
            return Err(MatError::NoColumn { name, channel, columns: columns.max(1) });
        }
        let places = |channel: usize| channels.iter().filter(move |&&chosen| chosen == channel).count();
        if let Some(&channel) = channels.iter().find(|&&channel| places(channel) > 1) {
            return Err(MatError::ChosenTwice(channel));
        }
        // No more room at once than a damaged length can do harm with.
        let room = rows.min(1 << 24);
        let mut samples: Vec<Vec<f32>> = channels.iter().map(|_| Vec::with_capacity(room)).collect();
        let variable = self.variable(name)?;
        self.read_values(&variable, channels, &mut |column, value| {
            let place = channels.iter().position(|channel| *channel == column);
            let Some(samples) = place.and_then(|place| samples.get_mut(place)) else { return Ok(()) };
            let value = value as f32;
            if !value.is_finite() {
                return Err(MatError::NotFinite { row: samples.len(), column });
            }
            samples.push(value);
            Ok(())
        })?;
        Ok(samples)
    }

    /// Gives the values of the `chosen` columns of `variable`.
    fn read_values(
        &mut self,
        variable: &Variable,
        chosen: &[usize],
        visit: &mut Visit<'_>,
    ) -> Result<(), MatError> {
        match &variable.place {
            Place::Element(position) => {
                level5::read_values(&mut self.file, variable, *position, chosen, visit)
            }
            Place::Hdf5(dataset) => {
                dataset.read(&mut hdf5::Reader::new(&mut self.file, self.superblock)?, chosen, visit)
            }
            Place::Nowhere => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::element::{DOUBLE, INT8, INT32, MATRIX, UINT8, UINT32};
    use super::*;

    /// Made by `tests/golden/make_mat.py`: `data` 6 × 4, value = 10 row + column + 0.25, `fs` 2000, `iD` 7,
    /// `labels` and `units` as text; `counts` 3 × 2 of whole numbers, which are stored in a byte each.
    const COMPRESSED_FILE: &[u8] = include_bytes!("../tests/golden/compressed.mat");
    const PLAIN_FILE: &[u8] = include_bytes!("../tests/golden/plain.mat");

    fn open(bytes: &[u8]) -> Result<MatFile<Cursor<&[u8]>>, MatError> {
        MatFile::open(Cursor::new(bytes))
    }

    #[test]
    fn columns_come_in_the_order_chosen() {
        for bytes in [COMPRESSED_FILE, PLAIN_FILE] {
            let mut mat = open(bytes).unwrap();
            assert_eq!(mat.shape("data").unwrap(), (6, 4));
            let columns = mat.columns("data", &[2, 0]).unwrap();
            let expected = [2.25, 0.25]
                .map(|first: f32| (0..6).map(|row| first + 10.0 * row as f32).collect::<Vec<_>>());
            assert_eq!(columns, expected);
            assert_eq!(mat.number("fs").unwrap(), Some(2000.0));
            assert_eq!(mat.number("iD").unwrap(), Some(7.0));
            assert_eq!((mat.number("units").unwrap(), mat.number("none").unwrap()), (None, None));
            assert_eq!(mat.columns("counts", &[0, 1]).unwrap(), [[1.0, 3.0, 5.0], [2.0, 4.0, 6.0]]);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_in_words() {
        let message = |result: Result<Vec<Vec<f32>>, MatError>| result.unwrap_err().to_string();
        let mut mat = open(PLAIN_FILE).unwrap();
        assert!(message(mat.columns("data", &[4])).contains("no channel 4"));
        assert!(message(mat.columns("data", &[1, 1])).contains("chosen twice"));
        assert!(message(mat.columns("signal", &[0])).contains("(it has: data, fs"));
        assert!(message(mat.columns("wide", &[0])).contains("transpose it"));
        assert!(message(mat.columns("gap", &[0])).contains("sample 1 of channel 0 is not finite"));
        assert!(mat.columns("gap", &[1]).is_ok());
        assert!(message(mat.columns("units", &[0])).contains("not a matrix of real numbers"));
    }

    /// An element: its type, its length, its data filled up to eight bytes.
    fn element(kind: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    /// A variable of MATLAB's class number `class`.
    fn variable(class: u8, parts: &[(u32, &[u8])]) -> Vec<u8> {
        let flags = element(UINT32, &[class, 0, 0, 0, 0, 0, 0, 0]);
        let parts: Vec<Vec<u8>> = parts.iter().map(|(kind, data)| element(*kind, data)).collect();
        element(MATRIX, &[flags, parts.concat()].concat())
    }

    #[test]
    fn variables_of_matlabs_own_classes_are_passed_over_and_named_when_asked_for() {
        let size = [2_i32, 1].map(i32::to_le_bytes);
        let size = size.as_flattened();
        let object = variable(13, &[(INT32, size), (INT8, b""), (UINT32, &[0; 8])]);
        let opaque = |name: &[u8], class: &[u8]| {
            variable(17, &[(INT8, name), (INT8, b"MCOS"), (INT8, class), (MATRIX, &object[8..])])
        };
        let of_class = |class: u8, name: &[u8]| variable(class, &[(INT32, size), (INT8, name)]);
        let numbers = [1.5_f64, 2.5].map(f64::to_le_bytes);
        let mut bytes = PLAIN_FILE[..128].to_vec();
        bytes.extend(opaque(b"data", b"string"));
        bytes.extend(opaque(b"when", b"datetime"));
        bytes.extend(of_class(1, b"cells"));
        bytes.extend(of_class(2, b"head"));
        bytes.extend(of_class(3, b"thing"));
        bytes.extend(of_class(16, b"f"));
        bytes.extend(variable(6, &[(INT32, size), (INT8, b"emg"), (DOUBLE, numbers.as_flattened())]));
        // What objects refer to lies in a variable without a name.
        bytes.extend(variable(9, &[(INT32, size), (INT8, b""), (UINT8, &[0, 1])]));
        let mut mat = open(&bytes).unwrap();
        assert_eq!(mat.columns("emg", &[0]).unwrap(), [[1.5, 2.5]]);
        let mut message = |name: &'static str| mat.columns(name, &[0]).unwrap_err().to_string();
        let data = "variable `data` is of the MATLAB class string, not a matrix of real numbers";
        assert_eq!(message("data"), data);
        for (name, found) in [
            ("when", "of the MATLAB class datetime"),
            ("cells", "a cell array"),
            ("head", "a structure"),
            ("thing", "an object"),
            ("f", "a function handle"),
        ] {
            assert!(message(name).starts_with(&format!("variable `{name}` is {found}, not")), "{name}");
        }
        assert!(message("signal").ends_with("(it has: data, when, cells, head, thing, f, emg)"));
        for length in 128..bytes.len() {
            let _ = open(&bytes[..length]);
        }
    }

    #[test]
    fn other_files_are_told_apart() {
        let mut newer = PLAIN_FILE.to_vec();
        newer[124..128].copy_from_slice(b"\x00\x02IM");
        assert!(open(&newer).unwrap_err().to_string().contains("it should hold HDF5"));
        newer[124..128].copy_from_slice(b"\x01\x00MI");
        assert!(matches!(open(&newer), Err(MatError::BigEndian)));
        assert!(matches!(open(b"1,2,3\n"), Err(MatError::NoMatFile)));
        assert!(matches!(open(&[b' '; 200]), Err(MatError::NoMatFile)));
    }

    #[test]
    fn a_file_cut_off_anywhere_is_an_error_or_lacks_variables() {
        for bytes in [COMPRESSED_FILE, PLAIN_FILE] {
            for length in 0..bytes.len() {
                if let Ok(mut mat) = open(&bytes[..length]) {
                    let _ = (mat.columns("data", &[0, 3]), mat.number("iD"));
                    assert!(mat.variables.len() < 8, "{length} bytes");
                }
            }
        }
    }

    proptest! {
        #[test]
        fn no_damage_makes_it_panic(
            is_compressed: bool,
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            let mut bytes = if is_compressed { COMPRESSED_FILE } else { PLAIN_FILE }.to_vec();
            for (place, value) in damage {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            if let Ok(mut mat) = open(&bytes) {
                let _ = mat.number("fs");
                if let Ok(columns) = mat.columns("data", &[0, 3]) {
                    prop_assert!(columns.iter().flatten().all(|sample| sample.is_finite()));
                }
            }
        }
    }
}
