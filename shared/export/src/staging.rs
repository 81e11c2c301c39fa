//! Files that appear together, once all of them are whole.
//!
//! ```text
//! FOLDER/.tendon-a1b2c3/signal.csv ──keep──▶ FOLDER/signal.csv      gone again if the export fails
//! ```
//!
//! Files and new folders are for this user alone: they hold a person's data.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io::{BufWriter, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::ExportError;

/// Bytes that are gathered before they are written.
const BUFFER: usize = 1 << 16;

/// A folder that is being filled.
#[derive(Debug)]
pub struct Staging {
    folder: PathBuf,
    temporary: TempDir,
    /// Relative to the folder.
    files: Vec<PathBuf>,
}

impl Staging {
    /// Begins to fill `folder`, which is made if it is not there.
    ///
    /// # Errors
    ///
    /// [`ExportError::Write`].
    pub fn begin(folder: &Path) -> Result<Staging, ExportError> {
        let failed = ExportError::writing(folder);
        make_private(folder).map_err(&failed)?;
        let temporary = tempfile::Builder::new()
            .prefix(".tendon-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir_in(folder)
            .map_err(&failed)?;
        Ok(Staging { folder: folder.to_owned(), temporary, files: Vec::new() })
    }

    /// Whether there is anything in the folder. `false` where there is no folder.
    ///
    /// # Errors
    ///
    /// [`ExportError::Write`] where it cannot be looked at, or is no folder.
    pub fn is_occupied(folder: &Path) -> Result<bool, ExportError> {
        match fs::read_dir(folder) {
            Ok(mut entries) => Ok(entries.next().is_some()),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(false),
            Err(error) => Err(ExportError::writing(folder)(error)),
        }
    }

    /// Makes a file; `file` is relative to the folder. Flush it before [`Staging::keep`].
    ///
    /// # Errors
    ///
    /// [`ExportError::Write`].
    pub fn create(&mut self, file: impl AsRef<Path>) -> Result<BufWriter<File>, ExportError> {
        let path = self.temporary.path().join(&file);
        let failed = ExportError::writing(&self.folder.join(&file));
        path.parent().map_or(Ok(()), make_private).map_err(&failed)?;
        let opened = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path);
        let opened = opened.map_err(&failed)?;
        self.files.push(file.as_ref().to_owned());
        Ok(BufWriter::with_capacity(BUFFER, opened))
    }

    /// Makes a file of these bytes.
    ///
    /// # Errors
    ///
    /// [`ExportError::Write`].
    pub fn write(&mut self, file: impl AsRef<Path>, bytes: &[u8]) -> Result<(), ExportError> {
        use std::io::Write;
        let failed = ExportError::writing(&self.folder.join(&file));
        let mut opened = self.create(file)?;
        opened.write_all(bytes).and_then(|()| opened.flush()).map_err(failed)
    }

    /// Puts all files into the folder, in place of those of the same names.
    ///
    /// # Errors
    ///
    /// [`ExportError::Write`].
    pub fn keep(self) -> Result<(), ExportError> {
        for file in &self.files {
            let (from, to) = (self.temporary.path().join(file), self.folder.join(file));
            File::open(&from)
                .and_then(|file| file.sync_all())
                .and_then(|()| to.parent().map_or(Ok(()), make_private))
                .and_then(|()| fs::rename(&from, &to))
                .map_err(ExportError::writing(&to))?;
        }
        Ok(())
    }
}

fn make_private(folder: &Path) -> std::io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)
}
