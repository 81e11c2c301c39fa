//! A file that is written whole or not at all, by way of a temporary one beside it.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File, OpenOptions, Permissions, TryLockError};
use std::io::{self, BufWriter, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use serde::Serialize;
use tempfile::NamedTempFile;

use crate::error::OutputError;

/// Permissions of a new file, less the umask.
const MODE: u32 = 0o666;
/// Those of a file with what belongs to a person.
const PRIVATE_MODE: u32 = 0o600;

/// A file to be written.
#[derive(Clone, Debug)]
pub struct OutputFile {
    path: PathBuf,
    /// The file itself where `path` is a symbolic link to it.
    target: PathBuf,
    pub(crate) state: State,
    /// Permissions of the new file, less the umask.
    mode: u32,
    /// Whether a file that came to be since the check stays.
    is_new: bool,
    /// A pipe stays open from the check on: its reader would take it for ended.
    pipe: Option<Arc<File>>,
}

/// What is there before the file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Nothing,
    File,
    /// A device or a pipe.
    Special,
}

impl OutputFile {
    /// Checks that the file can be written, without changing anything.
    ///
    /// # Errors
    ///
    /// When the folder is missing or not writable, or the path names a folder, or a pipe that nobody reads.
    pub fn check(path: &Path) -> Result<OutputFile, OutputError> {
        let owned = || path.to_owned();
        // The link and not its target would be replaced.
        let target = fs::canonicalize(path).unwrap_or_else(|_| owned());
        let mut pipe = None;
        let state = match fs::metadata(&target) {
            Ok(metadata) if metadata.is_dir() => return Err(OutputError::IsFolder { path: owned() }),
            Ok(metadata) if metadata.is_file() => State::File,
            Ok(metadata) => {
                if metadata.file_type().is_fifo() {
                    pipe = Some(Arc::new(open_special(&target).map_err(|source| {
                        if source.raw_os_error() == Some(Errno::ENXIO as i32) {
                            OutputError::NobodyReads { path: owned() }
                        } else {
                            OutputError::Write { path: owned(), source }
                        }
                    })?));
                }
                State::Special
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => State::Nothing,
            Err(source) => return Err(OutputError::Write { path: owned(), source }),
        };
        let file = OutputFile { path: owned(), target, state, mode: MODE, is_new: false, pipe };
        if state == State::Special {
            return Ok(file);
        }
        let folder = file.folder();
        if !folder.is_dir() {
            return Err(OutputError::NoFolder { path: owned(), folder: folder.to_owned() });
        }
        file.temporary().map(drop)?;
        Ok(file)
    }

    /// The same file, which nobody but its owner will read or write: it holds what belongs to a person.
    #[must_use]
    pub fn private(self) -> OutputFile {
        OutputFile { mode: PRIVATE_MODE, ..self }
    }

    /// The same file, which is written only where nothing is yet: also one that comes to be after the check is not replaced.
    #[must_use]
    pub fn only_new(self) -> OutputFile {
        OutputFile { is_new: true, ..self }
    }

    /// Where the file goes.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether a file is there already, which will be replaced.
    pub fn replaces(&self) -> bool {
        self.state == State::File
    }

    /// Writes the file: `write` fills it. Until it is complete, what was there before stays.
    ///
    /// # Errors
    ///
    /// When it cannot be written, for instance because the disk is full.
    pub fn write(&self, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), OutputError> {
        if self.state == State::Special {
            let file = match &self.pipe {
                Some(pipe) => pipe.try_clone(),
                None => open_special(&self.target),
            };
            return file.and_then(|mut file| fill(&mut file, write)).map_err(|source| self.error(source));
        }
        self.remove_left_over();
        let mut temporary = self.temporary()?;
        fill(temporary.as_file_mut(), write)
            .and_then(|()| temporary.as_file().sync_all())
            .map_err(|source| self.error(source))?;
        if self.is_new { self.put_new(temporary) } else { self.put(temporary) }?;
        // So that the new name, too, survives a loss of power. Some file systems cannot; the file is whole all the same.
        let _ = File::open(self.folder()).and_then(|folder| folder.sync_all());
        Ok(())
    }

    /// Writes bytes.
    ///
    /// # Errors
    ///
    /// As [`OutputFile::write`].
    pub fn write_bytes(&self, bytes: &[u8]) -> Result<(), OutputError> {
        self.write(|out| out.write_all(bytes))
    }

    /// Writes JSON, indented. Numbers that are not finite become `null`.
    ///
    /// # Errors
    ///
    /// As [`OutputFile::write`].
    pub fn write_json(&self, content: &impl Serialize) -> Result<(), OutputError> {
        let mut bytes = serde_json::to_vec_pretty(content)
            .map_err(|error| OutputError::Content { path: self.path.clone(), reason: error.to_string() })?;
        bytes.push(b'\n');
        self.write_bytes(&bytes)
    }

    /// Puts the finished file in place of what is there.
    fn put(&self, finished: NamedTempFile) -> Result<(), OutputError> {
        finished.persist(&self.target).map(drop).map_err(|error| self.error(error.error))
    }

    /// Puts the finished file where nothing is.
    fn put_new(&self, finished: NamedTempFile) -> Result<(), OutputError> {
        let refused = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => OutputError::Exists { path: self.path.clone() },
            _ => self.error(source),
        };
        match finished.persist_noclobber(&self.target) {
            Ok(_) => Ok(()),
            Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Err(refused(error.error)),
            // The file system can neither rename so nor link. An empty file takes the place first: only one can make it.
            Err(error) => {
                File::create_new(&self.target).map_err(refused)?;
                self.put(error.file).inspect_err(|_| drop(fs::remove_file(&self.target)))
            }
        }
    }

    fn folder(&self) -> &Path {
        match self.target.parent() {
            None => Path::new("/"),
            Some(folder) if folder.as_os_str().is_empty() => Path::new("."),
            Some(folder) => folder,
        }
    }

    /// A temporary file beside the target, locked, and gone when dropped.
    fn temporary(&self) -> Result<NamedTempFile, OutputError> {
        loop {
            let file = tempfile::Builder::new()
                .prefix(&self.temporary_prefix())
                .permissions(Permissions::from_mode(self.mode))
                .tempfile_in(self.folder())
                .map_err(|source| self.error(source))?;
            // Before the lock, another command may have taken it for left over.
            let is_taken = matches!(file.as_file().try_lock(), Err(TryLockError::WouldBlock));
            let is_there = file.as_file().metadata().is_ok_and(|metadata| metadata.nlink() > 0);
            if is_there && !is_taken {
                return Ok(file);
            }
        }
    }

    /// What the names of temporary files for this target begin with.
    fn temporary_prefix(&self) -> OsString {
        /// Bytes of the target's name, so that the whole is no longer than a name may be.
        const MOST: usize = 100;
        let name = self.target.file_name().unwrap_or_default().as_bytes();
        let mut prefix = OsString::from(TEMPORARY);
        prefix.push(OsStr::from_bytes(&name[..name.len().min(MOST)]));
        prefix.push("-");
        prefix
    }

    /// Removes temporary files for this target that nobody writes any more. What cannot be removed stays.
    fn remove_left_over(&self) {
        let prefix = self.temporary_prefix();
        for entry in fs::read_dir(self.folder()).into_iter().flatten().flatten() {
            let is_temporary = entry.file_name().as_bytes().starts_with(prefix.as_bytes())
                && entry.file_type().is_ok_and(|kind| kind.is_file());
            let file = is_temporary.then(|| OpenOptions::new().write(true).open(entry.path()).ok()).flatten();
            // The lock is kept until the file is gone.
            if let Some(file) = file
                && file.try_lock().is_ok()
            {
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    fn error(&self, source: io::Error) -> OutputError {
        OutputError::Write { path: self.path.clone(), source }
    }
}

/// What the name of a temporary file begins with.
const TEMPORARY: &str = ".tendon-";

/// Whether a file of this name is a temporary one of this crate: a program that is killed while it writes leaves it.
pub fn is_temporary(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(TEMPORARY.as_bytes())
}

/// Opens a device or a pipe. A named pipe that nobody reads is refused at once: waiting for its reader would keep the
/// command from ending.
fn open_special(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().write(true).custom_flags(OFlag::O_NONBLOCK.bits()).open(path)?;
    let flags = OFlag::from_bits_truncate(fcntl(&file, FcntlArg::F_GETFL)?);
    fcntl(&file, FcntlArg::F_SETFL(flags - OFlag::O_NONBLOCK))?;
    Ok(file)
}

fn fill(file: &mut File, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut buffered = BufWriter::new(file);
    write(&mut buffered)?;
    buffered.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::collect;
    use crate::folder::OutputFolder;

    #[test]
    fn a_pipe_that_nobody_reads_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        assert!(matches!(OutputFile::check(&path), Err(OutputError::NobodyReads { .. })));
    }

    #[test]
    fn the_reader_of_a_pipe_waits_from_the_check_to_the_end_of_what_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let reader = std::thread::spawn({
            let path = path.clone();
            move || fs::read_to_string(path).unwrap()
        });
        let output = loop {
            if let Ok(output) = OutputFile::check(&path) {
                break output;
            }
            std::thread::yield_now();
        };
        output.write(|file| file.write_all(b"report")).unwrap();
        drop(output);
        assert_eq!(reader.join().unwrap(), "report");
    }

    #[test]
    fn a_new_file_is_written_and_nothing_else_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.json");
        let file = OutputFile::check(&path).unwrap();
        assert!(!file.replaces() && !path.exists(), "checking changes nothing");
        file.write_json(&[f64::NAN, f64::INFINITY, 1.5]).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "[\n  null,\n  null,\n  1.5\n]\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o400, 0o400);
        assert!(OutputFile::check(&path).unwrap().replaces());
    }

    #[test]
    fn what_belongs_to_a_person_is_for_its_owner_alone_whatever_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("person.json");
        fs::write(&path, "before").unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
        OutputFile::check(&path).unwrap().private().write_bytes(b"after").unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn what_was_there_stays_until_the_new_file_is_complete() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.json");
        fs::write(&path, "old").unwrap();
        let file = OutputFile::check(&path).unwrap();
        let failed = file.write(|out| {
            out.write_all(b"new")?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        });
        assert!(matches!(failed, Err(OutputError::Write { .. })));
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        file.write_bytes(b"new").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_that_came_to_be_after_the_check_stays_where_only_a_new_one_is_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.xdf");
        let [first, second] = [(); 2].map(|()| OutputFile::check(&path).unwrap().only_new());
        let late = second.write(|out| {
            out.write_all(b"second")?;
            first.write_bytes(b"first").map_err(io::Error::other)
        });
        assert!(matches!(late, Err(OutputError::Exists { .. })), "{late:?}");
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_a_killed_command_has_left_of_the_same_file_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            (File::create(&path).unwrap(), path)
        };
        let (_, left) = file(".tendon-session.xdf-a1b2c3");
        let (being_written, other_command) = file(".tendon-session.xdf-d4e5f6");
        being_written.try_lock().unwrap();
        let (_, other_file) = file(".tendon-other.xdf-a1b2c3");
        let target = OutputFile::check(&folder.path().join("session.xdf")).unwrap();
        target.write_bytes(b"whole").unwrap();
        assert_eq!(fs::read(target.path()).unwrap(), b"whole");
        assert!(!left.exists() && other_command.exists() && other_file.exists());
        let names_of =
            |target: &OutputFile| target.temporary().unwrap().path().file_name().unwrap().to_owned();
        let long = OutputFile::check(&folder.path().join("\u{e9}".repeat(120))).unwrap();
        assert!(is_temporary(&names_of(&target)) && is_temporary(&names_of(&long)));
    }

    #[test]
    fn a_link_is_followed_and_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        OutputFile::check(&link).unwrap().write_bytes(b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&real).unwrap(), "new");
    }

    #[test]
    fn what_cannot_be_written_is_refused_by_name_before_anything_starts() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| OutputFile::check(path).unwrap_err().to_string();
        assert!(refused(folder.path()).contains("is a folder"));
        assert!(refused(&folder.path().join("missing/report.json")).contains("there is no folder"));
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        assert!(refused(&file.join("report.json")).contains("report.json"));
        assert!(matches!(OutputFolder::check(&file), Err(OutputError::NotAFolder { .. })));
        assert!(matches!(OutputFolder::check(&file.join("x")), Err(OutputError::Write { .. })));
        OutputFolder::check(&folder.path().join("a/b")).unwrap();
        assert!(!folder.path().join("a").exists(), "checking changes nothing");
    }

    #[test]
    fn a_full_device_is_an_error_and_every_other_output_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let full = OutputFile::check(Path::new("/dev/full")).unwrap();
        let good = OutputFile::check(&folder.path().join("good")).unwrap();
        let errors = collect([full.write_bytes(b"x"), good.write_bytes(b"x"), full.write_json(&1)])
            .unwrap_err()
            .to_string();
        assert_eq!(errors.lines().count(), 2, "{errors}");
        assert!(errors.starts_with("cannot write /dev/full: "), "{errors}");
        assert!(good.path().exists());
    }
}
