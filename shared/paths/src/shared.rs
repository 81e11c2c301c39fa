//! A folder in which every user of this machine leaves notes that all others can read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use nix::dir::Dir;
use nix::errno::Errno;
use nix::fcntl::{AtFlags, OFlag, open, openat};
use nix::sys::stat::{Mode, SFlag, fchmod, fstat, fstatat};
use nix::unistd::{UnlinkatFlags, geteuid, unlinkat};

use crate::PathError;

/// Where all users of this machine note that they have used an arm. It outlasts a restart.
const ARMS: &str = "/var/tmp/tendon-arms";
/// Longest note, bytes.
const MAXIMUM_NOTE_LENGTH: u64 = 4096;
/// What everybody may do in the folder, and with a note.
const FOLDER_MODE: Mode = Mode::from_bits_truncate(0o1777);
const NOTE_MODE: Mode = Mode::from_bits_truncate(0o644);
/// How long a process that has just created the folder may take to open it to all, and the time between two looks.
const CREATION: Duration = Duration::from_millis(500);
const CREATION_LOOK: Duration = Duration::from_millis(10);

/// A folder in which everybody can create files and only root and the folder's owner, who created it, can remove those
/// of others (mode 1777, as `/tmp` has). A note is a file `SUBJECT.UID` that belongs to that user, or it is none.
#[derive(Debug)]
pub struct SharedFolder {
    path: PathBuf,
    folder: OwnedFd,
}

/// The folder in which every user leaves a note about each arm that it has used.
///
/// # Errors
///
/// As [`SharedFolder::open`].
pub fn shared_arm_folder() -> Result<SharedFolder, PathError> {
    SharedFolder::open(Path::new(ARMS))
}

impl SharedFolder {
    /// Opens the folder at `path`, and creates it first if it is missing.
    ///
    /// # Errors
    ///
    /// [`PathError`] if it is a link or no folder, or if users could change the files of others in it.
    pub fn open(path: &Path) -> Result<SharedFolder, PathError> {
        let is_new = match std::fs::create_dir(path) {
            Ok(()) => true,
            Err(error) if error.kind() == ErrorKind::AlreadyExists => false,
            Err(error) => return Err(PathError::system(path, error)),
        };
        let begun = Instant::now();
        loop {
            match SharedFolder::open_existing(path, is_new) {
                Err(error) if error.may_be_just_created() && begun.elapsed() < CREATION => {
                    sleep(CREATION_LOOK);
                }
                opened => return opened,
            }
        }
    }

    fn open_existing(path: &Path, is_new: bool) -> Result<SharedFolder, PathError> {
        let flags = OFlag::O_DIRECTORY | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC;
        let folder = match open(path, flags, Mode::empty()) {
            Err(Errno::ELOOP | Errno::ENOTDIR) => {
                return Err(PathError::WrongKind { path: path.to_owned() });
            }
            opened => opened.map_err(|error| PathError::system(path, error))?,
        };
        if is_new {
            // The umask has kept others out.
            fchmod(&folder, FOLDER_MODE).map_err(|error| PathError::system(path, error))?;
        }
        let mode = fstat(&folder).map_err(|error| PathError::system(path, error))?.st_mode & 0o7777;
        if mode != FOLDER_MODE.bits() {
            return Err(PathError::NotShared { path: path.to_owned(), mode });
        }
        Ok(SharedFolder { path: path.to_owned(), folder })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces this user's note on `subject`.
    ///
    /// # Errors
    ///
    /// [`PathError`] if it cannot be written.
    pub fn leave_note(&self, subject: &str, note: &str) -> Result<(), PathError> {
        let name = format!("{subject}.{}", geteuid());
        let path = self.path.join(&name);
        let failed = |error: std::io::Error| PathError::system(&path, error);
        match unlinkat(&self.folder, name.as_str(), UnlinkatFlags::NoRemoveDir) {
            Ok(()) | Err(Errno::ENOENT) => {}
            // A folder, or what somebody else has put there.
            Err(Errno::EISDIR | Errno::EPERM | Errno::EACCES) => return Err(PathError::InTheWay { path }),
            Err(error) => return Err(failed(error.into())),
        }
        let flags = OFlag::O_WRONLY | OFlag::O_CREAT | OFlag::O_EXCL | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC;
        let file = openat(&self.folder, name.as_str(), flags, NOTE_MODE);
        let mut file = File::from(file.map_err(|error| failed(error.into()))?);
        // The umask has kept others out.
        fchmod(&file, NOTE_MODE).map_err(|error| failed(error.into()))?;
        file.write_all(note.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)
    }

    /// The notes of all users on `subject`, by user; `None` for one that cannot be read, because its user lets nobody or
    /// has put something else there. What does not belong to the user it names is passed over.
    ///
    /// # Errors
    ///
    /// [`PathError`] if the folder cannot be read.
    pub fn notes(&self, subject: &str) -> Result<BTreeMap<u32, Option<String>>, PathError> {
        let failed = |error: std::io::Error| PathError::system(&self.path, error);
        let again = self.folder.try_clone().map_err(failed)?;
        let mut entries = Dir::from_fd(again).map_err(|error| failed(error.into()))?;
        let mut notes = BTreeMap::new();
        for entry in entries.iter() {
            let entry = entry.map_err(|error| failed(error.into()))?;
            let name = entry.file_name().to_string_lossy();
            let user = name.strip_prefix(subject).and_then(|rest| rest.strip_prefix('.')?.parse().ok());
            if let Some(user) = user
                && let Some(note) = self.read_note(&name, user)?
            {
                notes.insert(user, note);
            }
        }
        Ok(notes)
    }

    /// `None` for what does not belong to this user, and `Some(None)` for what does and cannot be read as a note: nobody can
    /// lock others out by what they put here.
    fn read_note(&self, name: &str, user: u32) -> Result<Option<Option<String>>, PathError> {
        let status = match fstatat(&self.folder, name, AtFlags::AT_SYMLINK_NOFOLLOW) {
            Err(Errno::ENOENT) => return Ok(None),
            status => status.map_err(|error| PathError::system(&self.path.join(name), error))?,
        };
        if status.st_uid != user {
            return Ok(None);
        }
        let flags = OFlag::O_RDONLY | OFlag::O_NOFOLLOW | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
        let Ok(file) = openat(&self.folder, name, flags, Mode::empty()) else { return Ok(Some(None)) };
        // It may be another by now.
        let is_note = fstat(&file).is_ok_and(|status| {
            status.st_mode & SFlag::S_IFMT.bits() == SFlag::S_IFREG.bits() && status.st_uid == user
        });
        let mut note = Vec::new();
        let is_read = is_note && File::from(file).take(MAXIMUM_NOTE_LENGTH).read_to_end(&mut note).is_ok();
        Ok(Some(is_read.then(|| String::from_utf8_lossy(&note).into_owned())))
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    use super::*;

    #[test]
    fn notes_are_kept_by_subject_and_user_and_only_their_users_count() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("notes");
        let folder = SharedFolder::open(&path).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o7777, 0o1777);
        assert!(folder.notes("arm").unwrap().is_empty());
        folder.leave_note("arm", "one").unwrap();
        folder.leave_note("arm-2", "other").unwrap();
        SharedFolder::open(&path).unwrap().leave_note("arm", "two").unwrap();
        let me = geteuid().as_raw();
        assert_eq!(folder.notes("arm").unwrap(), BTreeMap::from([(me, Some("two".to_owned()))]));
        // What does not belong to the user it names is none.
        std::fs::write(path.join("arm.4242"), "forged").unwrap();
        symlink("/etc/passwd", path.join("arm.4243")).unwrap();
        nix::unistd::mkfifo(&path.join("arm.4244"), Mode::S_IRWXU).unwrap();
        assert_eq!(folder.notes("arm").unwrap().len(), 1);
        if geteuid().is_root() {
            chown(path.join("arm.4242"), Some(4242), None).unwrap();
            assert_eq!(folder.notes("arm").unwrap()[&4242].as_deref(), Some("forged"));
        }
    }

    #[test]
    fn what_a_user_has_put_there_instead_of_a_note_counts_as_one_that_cannot_be_read() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("notes");
        let folder = SharedFolder::open(&path).unwrap();
        let me = geteuid().as_raw();
        let own = path.join(format!("arm.{me}"));
        let unreadable = BTreeMap::from([(me, None)]);
        let socket = std::os::unix::net::UnixListener::bind(&own).unwrap();
        assert_eq!(folder.notes("arm").unwrap(), unreadable, "a socket");
        drop(socket);
        folder.leave_note("arm", "one").unwrap();
        assert_eq!(folder.notes("arm").unwrap(), BTreeMap::from([(me, Some("one".to_owned()))]));
        std::fs::remove_file(&own).unwrap();
        symlink("/etc/passwd", &own).unwrap();
        assert_eq!(folder.notes("arm").unwrap(), unreadable, "a link");
        std::fs::remove_file(&own).unwrap();
        nix::unistd::mkfifo(&own, Mode::S_IRWXU).unwrap();
        assert_eq!(folder.notes("arm").unwrap(), unreadable, "a pipe");
        std::fs::remove_file(&own).unwrap();
        std::fs::create_dir(&own).unwrap();
        assert_eq!(folder.notes("arm").unwrap(), unreadable, "a folder");
        let error = folder.leave_note("arm", "two").unwrap_err().to_string();
        assert!(error.contains(&own.display().to_string()) && error.contains("remove it"), "{error}");
    }

    #[test]
    fn a_folder_that_another_process_is_just_creating_is_waited_for() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("notes");
        std::fs::create_dir(&path).unwrap();
        let opened = std::thread::spawn({
            let path = path.clone();
            move || SharedFolder::open(&path)
        });
        sleep(2 * CREATION_LOOK);
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o1777)).unwrap();
        opened.join().unwrap().unwrap();
    }

    #[test]
    fn a_folder_that_is_none_for_all_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("notes");
        std::fs::create_dir(&path).unwrap();
        for mode in [0o700, 0o777] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            let error = SharedFolder::open(&path).unwrap_err();
            assert!(error.to_string().contains("mode 1777"), "{error}");
        }
        let link = place.path().join("link");
        symlink(&path, &link).unwrap();
        assert!(matches!(SharedFolder::open(&link), Err(PathError::WrongKind { .. })));
    }
}
