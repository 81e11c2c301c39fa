//! A folder that a command writes files into.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::error::OutputError;

/// A folder to write files into.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputFolder {
    path: PathBuf,
}

impl OutputFolder {
    /// Checks that the folder is there and writable, or can be made.
    ///
    /// # Errors
    ///
    /// When it cannot, or the path names a file.
    pub fn check(path: &Path) -> Result<OutputFolder, OutputError> {
        // Without links and dots, so that every folder above is a parent.
        let absolute = std::path::absolute(path)
            .map_err(|source| OutputError::Write { path: path.to_owned(), source })?;
        for folder in absolute.ancestors() {
            match fs::metadata(folder) {
                Ok(metadata) if metadata.is_dir() => {
                    tempfile::tempfile_in(folder)
                        .map_err(|source| OutputError::Write { path: path.to_owned(), source })?;
                    break;
                }
                Ok(_) => return Err(OutputError::NotAFolder { path: folder.to_owned() }),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(source) => return Err(OutputError::Write { path: path.to_owned(), source }),
            }
        }
        Ok(OutputFolder { path: path.to_owned() })
    }

    /// Where the folder is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the folder if it is not there.
    ///
    /// # Errors
    ///
    /// When it cannot be made.
    pub fn make(&self) -> Result<(), OutputError> {
        fs::create_dir_all(&self.path)
            .map_err(|source| OutputError::Write { path: self.path.clone(), source })
    }
}
