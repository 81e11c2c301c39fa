//! Numbers out of MATLAB's MAT-files, level 5: what `save -v7`, `save -v6` and SciPy write.
//!
//! ```text
//! 124 bytes text and offsets | version 0x0100 | IM: little endian
//! type, bytes | data            a variable is a matrix (type 14) …
//! type, bytes | zlib stream     … or a compressed one (type 15), in which the same is found
//!   matrix: flags, dimensions, name, then the values column by column, in the smallest type that holds them
//! ```
//! Variables of MATLAB's own classes (text, cells, structures, objects such as `string` and `datetime`) are known by name only.
//!
//! A matrix is read column by column as it is decompressed: of one of 1280000 × 4 only the columns asked for come
//! into memory, as `f32`.

mod element;
mod problem;

use std::io::{BufReader, Read, Seek, SeekFrom};

use flate2::bufread::ZlibDecoder;

pub use problem::MatError;

use element::{COMPRESSED, INT8, INT32, MATRIX, Tag, UINT32, Values, read};

/// An open MAT-file.
#[derive(Debug)]
pub struct MatFile<R> {
    file: R,
    variables: Vec<Variable>,
}

/// A variable of the file, its values not yet read.
#[derive(Clone, Debug)]
struct Variable {
    name: String,
    /// What it is, if no full matrix of real numbers.
    other: Option<String>,
    rows: usize,
    columns: usize,
    /// Where its element begins in the file: the tag.
    position: u64,
}

/// Class of objects whose contents only MATLAB understands.
const OPAQUE: u8 = 17;

/// MATLAB allows names of 63 bytes; what is longer is damage.
const MAX_NAME_BYTES: u32 = 1 << 12;

impl<R: Read + Seek> MatFile<R> {
    /// Reads which variables `file` holds.
    ///
    /// # Errors
    /// When it is not a MAT-file of level 5, or damaged.
    pub fn open(file: R) -> Result<MatFile<R>, MatError> {
        let mut mat = MatFile { file, variables: Vec::new() };
        let length = mat.file.seek(SeekFrom::End(0))?;
        mat.file.seek(SeekFrom::Start(0))?;
        let mut header = [0; 128];
        if length < 128 {
            return Err(MatError::NoMatFile);
        }
        mat.file.read_exact(&mut header)?;
        match (&header[124..126], &header[126..]) {
            _ if header.starts_with(b"\x89HDF") => return Err(MatError::Hdf5),
            ([0x00, 0x02], b"IM") | ([0x02, 0x00], b"MI") => return Err(MatError::Hdf5),
            ([0x00, 0x01], b"IM") => {}
            ([0x01, 0x00], b"MI") => return Err(MatError::BigEndian),
            _ => return Err(MatError::NoMatFile),
        }
        let mut position = 128;
        while position < length {
            mat.file.seek(SeekFrom::Start(position))?;
            let tag = Tag::read(&mut mat.file)?;
            let next = position + 8 + u64::from(tag.bytes);
            if next > length {
                return Err(MatError::Damaged("it ends within a variable"));
            }
            if matches!(tag.kind, MATRIX | COMPRESSED) {
                let variable = Variable::read_head(&mut mat.matrix(position)?, position)?;
                mat.variables.extend(variable);
            }
            position = next;
        }
        Ok(mat)
    }

    /// The matrix whose element begins at `position`, after its tag.
    fn matrix(&mut self, position: u64) -> Result<Box<dyn Read + '_>, MatError> {
        self.file.seek(SeekFrom::Start(position))?;
        let tag = Tag::read(&mut self.file)?;
        let element = BufReader::new((&mut self.file).take(u64::from(tag.bytes)));
        if tag.kind == MATRIX {
            return Ok(Box::new(element));
        }
        let mut element = BufReader::new(ZlibDecoder::new(element));
        if Tag::read(&mut element)?.kind != MATRIX {
            return Err(MatError::Damaged("a compressed element is not a variable"));
        }
        Ok(Box::new(element))
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
        let mut matrix = self.matrix(variable.position)?;
        Variable::read_head(&mut matrix, variable.position)?;
        let mut values = Values::read_tag(&mut matrix)?;
        Ok(Some(values.next(&mut matrix)?))
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
        let variable = self.variable(name)?;
        let mut matrix = self.matrix(variable.position)?;
        Variable::read_head(&mut matrix, variable.position)?;
        let mut values = Values::read_tag(&mut matrix)?;
        if values.bytes != rows as u64 * columns as u64 * values.size() as u64 {
            return Err(MatError::Damaged("the values are not as many as the dimensions say"));
        }
        let mut chosen = vec![Vec::new(); channels.len()];
        for column in 0..=channels.iter().copied().max().unwrap_or(0) {
            let place = channels.iter().position(|&channel| channel == column);
            // No more room at once than a damaged length can do harm with.
            let mut samples = Vec::with_capacity(if place.is_some() { rows.min(1 << 24) } else { 0 });
            for row in 0..rows {
                let value = values.next(&mut matrix)? as f32;
                if place.is_some() {
                    if !value.is_finite() {
                        return Err(MatError::NotFinite { row, column });
                    }
                    samples.push(value);
                }
            }
            if let Some(place) = place {
                chosen[place] = samples;
            }
        }
        Ok(chosen)
    }
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
            return Variable::read_opaque(matrix, position).map(Some);
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
        Ok(Some(Variable { name, other: other.map(str::to_owned), rows, columns, position }))
    }

    /// Reads the head of an object of a MATLAB class, such as `string` and `datetime`. After the flags, it has three names
    /// instead of dimensions and a name: its own, the system (`MCOS`, `java`) and the class.
    fn read_opaque(matrix: &mut dyn Read, position: u64) -> Result<Variable, MatError> {
        let name = read_name(matrix)?;
        read_name(matrix)?;
        let class = read_name(matrix)?;
        let other = Some(format!("of the MATLAB class {class}"));
        Ok(Variable { name, other, rows: 0, columns: 0, position })
    }
}

fn read_name(matrix: &mut dyn Read) -> Result<String, MatError> {
    let name = Tag::read(matrix)?;
    if name.kind != INT8 || name.bytes > MAX_NAME_BYTES {
        return Err(MatError::Damaged("a variable has no name"));
    }
    Ok(String::from_utf8_lossy(&name.read_data(matrix)?).into_owned())
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use proptest::prelude::*;

    use super::element::{DOUBLE, UINT8};
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
        assert!(open(&newer).unwrap_err().to_string().contains("save -v7"));
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
