//! SHA-256 of models and recordings.

use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::ProvenanceError;

/// Bytes read at a time.
const PIECE: usize = 1 << 16;

/// A file and its SHA-256.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileHash {
    /// The file.
    pub path: String,
    /// SHA-256 of its content, in hexadecimal digits.
    pub sha256: String,
}

impl FileHash {
    /// Reads `path`.
    ///
    /// # Errors
    ///
    /// When it cannot be read.
    pub fn of(path: &Path) -> Result<FileHash, ProvenanceError> {
        let (sha256, _) = file_sha256(path)?;
        Ok(FileHash { path: path.display().to_string(), sha256 })
    }
}

/// Recordings and their SHA-256.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingHash {
    /// The file or folder; of several, all of them, separated by `:`.
    pub path: String,
    /// How many files there are.
    pub files: u64,
    /// Their size.
    pub bytes: u64,
    /// Of one file its SHA-256. Of more, that of the list of all files, one line `SHA256  PATH` each, sorted by path:
    /// in a folder, `find . -type f -printf '%P\n' | LC_ALL=C sort | xargs -d '\n' sha256sum | sha256sum`.
    pub sha256: String,
}

impl RecordingHash {
    /// Reads everything at `paths`.
    ///
    /// # Errors
    ///
    /// When a file cannot be read.
    pub fn of(paths: &[PathBuf]) -> Result<RecordingHash, ProvenanceError> {
        let mut lines = Vec::new();
        let mut bytes = 0;
        let mut last = String::new();
        for root in paths {
            let mut files = Vec::new();
            list_files(root, &mut files)?;
            for file in files {
                let (sha256, length) = file_sha256(&file)?;
                let relative = file.strip_prefix(root).unwrap_or(&file);
                lines.push((relative.to_string_lossy().into_owned(), sha256.clone()));
                bytes += length;
                last = sha256;
            }
        }
        lines.sort();
        let is_one_file = matches!(paths, [path] if path.is_file());
        let sha256 = if is_one_file {
            last
        } else {
            let list: String = lines.iter().map(|(path, sha256)| format!("{sha256}  {path}\n")).collect();
            hexadecimal(&Sha256::digest(list))
        };
        let path = paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(":");
        Ok(RecordingHash { path, files: lines.len() as u64, bytes, sha256 })
    }
}

/// All files at or below `path`.
fn list_files(path: &Path, files: &mut Vec<PathBuf>) -> Result<(), ProvenanceError> {
    let failed = |reason| ProvenanceError::Read { path: path.to_owned(), reason };
    if !path.is_dir() {
        files.push(path.to_owned());
        return Ok(());
    }
    for entry in fs::read_dir(path).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let kind = entry.file_type().map_err(failed)?;
        // A link to a folder above would never end.
        if kind.is_dir() {
            list_files(&entry.path(), files)?;
        } else if entry.path().is_file() {
            files.push(entry.path());
        }
    }
    Ok(())
}

/// SHA-256 and length of a file.
fn file_sha256(path: &Path) -> Result<(String, u64), ProvenanceError> {
    let read = || -> io::Result<(String, u64)> {
        let mut file = tendon_input::open(path)?;
        let mut hash = Sha256::new();
        let mut piece = vec![0; PIECE];
        let mut length = 0;
        loop {
            let count = file.read(&mut piece)?;
            if count == 0 {
                return Ok((hexadecimal(&hash.finalize()), length));
            }
            hash.update(&piece[..count]);
            length += count as u64;
        }
    };
    read().map_err(|reason| ProvenanceError::Read { path: path.to_owned(), reason })
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_sha256sum() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("b.txt");
        fs::write(&file, "abc").unwrap();
        // FIPS 180-4's example.
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(FileHash::of(&file).unwrap().sha256, abc);
        assert_eq!(RecordingHash::of(std::slice::from_ref(&file)).unwrap().sha256, abc);
        fs::create_dir(folder.path().join("a")).unwrap();
        fs::write(folder.path().join("a/c.txt"), "").unwrap();
        let whole = RecordingHash::of(&[folder.path().to_owned()]).unwrap();
        assert_eq!((whole.files, whole.bytes), (2, 3));
        // printf '%s  a/c.txt\n%s  b.txt\n' $(sha256sum </dev/null) … | sha256sum
        let list = format!(
            "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855  a/c.txt\n{abc}  b.txt\n"
        );
        assert_eq!(whole.sha256, hexadecimal(&Sha256::digest(list)));
        let error = FileHash::of(Path::new("/nowhere")).unwrap_err();
        let error = error.to_string();
        assert!(
            error.starts_with("cannot open /nowhere: ")
                && error.ends_with("; check the path and its permissions")
        );
    }
}
