//! Files that appear together, once all of them are whole.
//!
//! ```text
//! FOLDER   locked, so that nothing else is exported into it meanwhile
//! FOLDER/.tendon-a1b2c3/signal.csv ──keep──▶ FOLDER/signal.csv
//!            └── gone again if the export fails; if it is killed, the next one removes it
//! ```
//!
//! Files and new folders are for this user alone: they hold a person's data.

use std::ffi::OsStr;
use std::fs::{self, DirBuilder, File, OpenOptions, Permissions, TryLockError};
use std::io::{BufWriter, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::ExportError;

/// Bytes that are gathered before they are written.
const BUFFER: usize = 1 << 16;
/// What the name of a folder with unfinished files begins with.
const UNFINISHED: &str = ".tendon-";

/// A folder that is being filled.
#[derive(Debug)]
pub struct Staging {
    folder: PathBuf,
    /// The folder, locked until this is dropped or the process ends.
    _claim: File,
    temporary: TempDir,
    /// Relative to the folder.
    files: Vec<PathBuf>,
    /// Whether the folder was made for this and has nothing in it yet.
    is_new: bool,
}

impl Staging {
    /// Begins to fill `folder`, which is made if it is not there, and removes what an export that was killed has left in it.
    ///
    /// # Errors
    ///
    /// [`ExportError::Busy`] while something else is exported into it, [`ExportError::Write`].
    pub fn begin(folder: &Path) -> Result<Staging, ExportError> {
        let failed = ExportError::writing(folder);
        let is_new = !folder.exists();
        make_private(folder).map_err(&failed)?;
        let claim = File::open(folder).map_err(&failed)?;
        // A file system without locks is no reason to export nothing.
        if let Err(TryLockError::WouldBlock) = claim.try_lock() {
            return Err(ExportError::Busy { path: folder.to_owned() });
        }
        for entry in fs::read_dir(folder).map_err(&failed)?.flatten() {
            if is_unfinished_export(&entry.path()) {
                fs::remove_dir_all(entry.path()).map_err(&failed)?;
            }
        }
        let temporary = tempfile::Builder::new()
            .prefix(UNFINISHED)
            .permissions(Permissions::from_mode(0o700))
            .tempdir_in(folder)
            .map_err(&failed)?;
        Ok(Staging { folder: folder.to_owned(), _claim: claim, temporary, files: Vec::new(), is_new })
    }

    /// Whether there is anything in the folder but what unfinished exports have left. `false` where there is no folder.
    ///
    /// # Errors
    ///
    /// [`ExportError::Write`] where it cannot be looked at, or is no folder.
    pub fn is_occupied(folder: &Path) -> Result<bool, ExportError> {
        match fs::read_dir(folder) {
            Ok(entries) => Ok(entries.flatten().any(|entry| !is_unfinished_export(&entry.path()))),
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
    pub fn keep(mut self) -> Result<(), ExportError> {
        for file in &self.files {
            let (from, to) = (self.temporary.path().join(file), self.folder.join(file));
            File::open(&from)
                .and_then(|file| file.sync_all())
                .and_then(|()| to.parent().map_or(Ok(()), make_private))
                .and_then(|()| fs::rename(&from, &to))
                .map_err(ExportError::writing(&to))?;
            self.is_new = false;
        }
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if self.is_new {
            // What cannot be removed stays; the error of the export is the one to tell.
            let _ = fs::remove_dir_all(self.temporary.path());
            let _ = fs::remove_dir(&self.folder);
        }
    }
}

/// Whether this is a folder with the unfinished files of an export, which runs or was killed.
pub fn is_unfinished_export(path: &Path) -> bool {
    let is_named_so = |name: &OsStr| name.as_encoded_bytes().starts_with(UNFINISHED.as_bytes());
    path.file_name().is_some_and(is_named_so)
        && path.symlink_metadata().is_ok_and(|metadata| metadata.is_dir())
}

fn make_private(folder: &Path) -> std::io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)
}
