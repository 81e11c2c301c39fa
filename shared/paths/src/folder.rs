//! Folders that only this user can write to, and the files in them.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use nix::dir::Dir;
use nix::errno::Errno;
use nix::fcntl::{OFlag, open, openat, renameat};
use nix::sys::stat::{FileStat, Mode, SFlag, fchmod, fstat};
use nix::unistd::{Uid, UnlinkatFlags, User, geteuid, unlinkat};

/// Room that a run-time folder must leave for the paths of iceoryx2's Unix sockets in it, of which the kernel takes 107
/// bytes: `/tendon.UID.NAME.PORT.event` with a name of 24 characters and a port of 39 digits, without the UID.
const SOCKET_NAME_LENGTH: usize = 79;
/// Longest path of a Unix socket (unix(7)).
const MAXIMUM_SOCKET_PATH: usize = 107;

/// Largest file that is read, in bytes: state is small, and what is larger is none of ours.
const LARGEST_FILE: u64 = 1 << 20;

/// Why a folder or a file in it cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    /// It belongs to somebody else, who may have forged what is in it.
    #[error("{path} belongs to {owner}, not to you: remove it, or ask {owner} to", path = path.display())]
    OtherOwner {
        /// The folder or file.
        path: PathBuf,
        /// Name of its owner.
        owner: String,
    },
    /// Others can write to it.
    #[error("others can write to {path} (mode {mode:04o}): run `chmod go-w {path}`", path = path.display())]
    Writable {
        /// The folder or file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// Not everybody can leave files in it, or others could remove them.
    #[error("{path} has mode {mode:04o} and needs mode 1777: remove it, or run `chmod 1777 {path}`", path = path.display())]
    NotShared {
        /// The folder.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// A link, or no directory where one is expected, or no regular file.
    #[error("{path} is a link or of another kind than expected: remove it", path = path.display())]
    WrongKind {
        /// The folder or file.
        path: PathBuf,
    },
    /// A note is to be left, and something is there that this user cannot replace.
    #[error("{path} is in the way: remove it, with root's help if it belongs to somebody else", path = path.display())]
    InTheWay {
        /// Where the note goes.
        path: PathBuf,
    },
    /// There is nowhere to keep lasting state.
    #[error("this user has no home folder: set {variable} to a folder of this user")]
    NoHome {
        /// The variable of the environment that names another folder.
        variable: &'static str,
    },
    /// The system refused.
    #[error("cannot use {path}", path = path.display())]
    System {
        /// The folder or file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
}

impl PathError {
    pub(crate) fn system(path: &Path, error: impl Into<std::io::Error>) -> PathError {
        PathError::System { path: path.to_owned(), source: error.into() }
    }

    /// Whether a shared folder may look like this to others while its creator has not opened it to all yet.
    pub(crate) fn may_be_just_created(&self) -> bool {
        match self {
            PathError::NotShared { .. } => true,
            PathError::System { source, .. } => source.kind() == std::io::ErrorKind::PermissionDenied,
            _ => false,
        }
    }
}

/// Name of a user, or the number if it has none.
pub fn user_name(user: u32) -> String {
    let known = User::from_uid(Uid::from_raw(user)).ok().flatten();
    known.map_or_else(|| format!("user {user}"), |known| known.name)
}

/// A directory that belongs to this user and that nobody else may enter.
#[derive(Debug)]
pub struct PrivateFolder {
    path: PathBuf,
    folder: OwnedFd,
}

impl PrivateFolder {
    /// Opens the folder at `path`, and creates it first if it is missing (its parents, too).
    ///
    /// # Errors
    ///
    /// [`PathError`] if it is a link, belongs to somebody else or can be written by others.
    pub fn open(path: &Path) -> Result<PrivateFolder, PathError> {
        if let Some(parent) = path.parent() {
            let made = std::fs::DirBuilder::new().recursive(true).mode(0o700).create(parent);
            made.map_err(|error| PathError::system(parent, error))?;
        }
        match std::fs::DirBuilder::new().mode(0o700).create(path) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(PathError::system(path, error)),
            _ => PrivateFolder::open_existing(path),
        }
    }

    /// Opens the folder at `path` if it is there.
    ///
    /// # Errors
    ///
    /// As [`PrivateFolder::open`]; [`PathError::System`] if it is missing.
    pub fn open_existing(path: &Path) -> Result<PrivateFolder, PathError> {
        let flags = OFlag::O_DIRECTORY | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC;
        let folder = match open(path, flags, Mode::empty()) {
            Err(Errno::ELOOP | Errno::ENOTDIR) => {
                return Err(PathError::WrongKind { path: path.to_owned() });
            }
            opened => opened.map_err(|error| PathError::system(path, error))?,
        };
        let status = fstat(&folder).map_err(|error| PathError::system(path, error))?;
        check(path, &status, SFlag::S_IFDIR)?;
        if status.st_mode & 0o077 != 0 {
            // Nobody else could have written to it; nobody else need look into it either.
            fchmod(&folder, Mode::S_IRWXU).map_err(|error| PathError::system(path, error))?;
        }
        Ok(PrivateFolder { path: path.to_owned(), folder })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the file `name` holds; `None` if there is none.
    ///
    /// # Errors
    ///
    /// [`PathError`] if it cannot be read, or is not a file that only this user can write to.
    pub fn read(&self, name: &str) -> Result<Option<Vec<u8>>, PathError> {
        let path = self.path.join(name);
        let file = match self.open_file(name, OFlag::O_RDONLY) {
            Err(PathError::System { source, .. }) if source.kind() == ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        let bytes = tendon_input::read_file(&file, LARGEST_FILE);
        bytes.map(Some).map_err(|error| PathError::system(&path, error))
    }

    /// Replaces what the file `name` holds. After a crash it holds either all of the old bytes or all of the new ones.
    ///
    /// # Errors
    ///
    /// [`PathError::System`] if it cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), PathError> {
        let path = self.path.join(name);
        let failed = |error: std::io::Error| PathError::system(&path, error);
        let temporary = format!("{name}.new-{}", std::process::id());
        self.remove(&temporary)?;
        let mut file = self.open_file(&temporary, OFlag::O_WRONLY | OFlag::O_CREAT | OFlag::O_EXCL)?;
        let written = file.write_all(bytes).and_then(|()| file.sync_all()).and_then(|()| {
            renameat(&self.folder, temporary.as_str(), &self.folder, name)?;
            File::from(self.folder.try_clone()?).sync_all()
        });
        if written.is_err() {
            let _ = self.remove(&temporary);
        }
        written.map_err(failed)
    }

    /// Removes the file `name`, if there is one.
    ///
    /// # Errors
    ///
    /// [`PathError::System`] if it stays.
    pub fn remove(&self, name: &str) -> Result<(), PathError> {
        match unlinkat(&self.folder, name, UnlinkatFlags::NoRemoveDir) {
            Ok(()) | Err(Errno::ENOENT) => {
                File::from(self.folder.try_clone().map_err(|error| PathError::system(&self.path, error))?)
                    .sync_all()
                    .map_err(|error| PathError::system(&self.path, error))
            }
            Err(error) => Err(PathError::system(&self.path.join(name), error)),
        }
    }

    /// The names of all files in it, in no order.
    ///
    /// # Errors
    ///
    /// [`PathError::System`] if it cannot be read.
    pub fn names(&self) -> Result<Vec<String>, PathError> {
        let failed = |error: std::io::Error| PathError::system(&self.path, error);
        // Not a duplicate of the descriptor: that would share how far it was read.
        let again = openat(&self.folder, ".", OFlag::O_DIRECTORY | OFlag::O_CLOEXEC, Mode::empty());
        let mut entries = again.and_then(Dir::from_fd).map_err(|error| failed(error.into()))?;
        let mut names = Vec::new();
        for entry in entries.iter() {
            let entry = entry.map_err(|error| failed(error.into()))?;
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
        names.retain(|name| name != "." && name != "..");
        Ok(names)
    }

    /// Opens the file `name`; a new one is for this user alone.
    fn open_file(&self, name: &str, flags: OFlag) -> Result<File, PathError> {
        let path = self.path.join(name);
        // O_NONBLOCK: a pipe that somebody put there must not hold us up.
        let flags = flags | OFlag::O_NOFOLLOW | OFlag::O_CLOEXEC | OFlag::O_NONBLOCK;
        let file = match openat(self.folder.as_fd(), name, flags, Mode::S_IRUSR | Mode::S_IWUSR) {
            Err(Errno::ELOOP) => return Err(PathError::WrongKind { path }),
            opened => opened.map_err(|error| PathError::system(&path, error))?,
        };
        let status = fstat(&file).map_err(|error| PathError::system(&path, error))?;
        check(&path, &status, SFlag::S_IFREG)?;
        Ok(File::from(file))
    }
}

/// Whether this user alone can have written it, and it is what it should be.
fn check(path: &Path, status: &FileStat, kind: SFlag) -> Result<(), PathError> {
    let path = path.to_owned();
    if SFlag::from_bits_truncate(status.st_mode & SFlag::S_IFMT.bits()) != kind {
        return Err(PathError::WrongKind { path });
    }
    if status.st_uid != geteuid().as_raw() {
        return Err(PathError::OtherOwner { path, owner: user_name(status.st_uid) });
    }
    if status.st_mode & 0o022 != 0 {
        return Err(PathError::Writable { path, mode: status.st_mode & 0o7777 });
    }
    Ok(())
}

/// The folder of run-time state, such as sockets: `$XDG_RUNTIME_DIR/tendon` if that variable names a directory of this
/// user that nobody else may enter, else `/tmp/tendon-UID`.
///
/// # Errors
///
/// [`PathError`] if the folder cannot be trusted.
pub fn runtime_folder() -> Result<PrivateFolder, PathError> {
    PrivateFolder::open(&runtime_path(std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from)))
}

/// All folders in which this user's sessions may have left run-time state, whatever the environment was then.
pub fn runtime_folders() -> Vec<PrivateFolder> {
    let user = geteuid();
    let given = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let paths =
        BTreeSet::from([runtime_path(given), format!("/run/user/{user}/tendon").into(), fallback_path()]);
    paths.iter().filter_map(|path| PrivateFolder::open_existing(path).ok()).collect()
}

fn fallback_path() -> PathBuf {
    format!("/tmp/tendon-{}", geteuid()).into()
}

fn fits_sockets(folder: &Path) -> bool {
    let user_length = geteuid().to_string().len();
    folder.as_os_str().len() + SOCKET_NAME_LENGTH + user_length <= MAXIMUM_SOCKET_PATH
}

fn runtime_path(given: Option<PathBuf>) -> PathBuf {
    let is_private = |path: &PathBuf| {
        let status = std::fs::symlink_metadata(path);
        status.is_ok_and(|status| {
            status.is_dir() && status.uid() == geteuid().as_raw() && status.mode() & 0o077 == 0
        })
    };
    let own = given.filter(|path| path.is_absolute()).filter(is_private).map(|path| path.join("tendon"));
    own.filter(|path| fits_sockets(path)).unwrap_or_else(fallback_path)
}

/// The folder of lasting state: `$XDG_STATE_HOME/tendon`, else `.local/state/tendon` in this user's home. A folder that
/// belongs to somebody else, such as the home that `sudo` may leave in the environment, is passed over.
///
/// # Errors
///
/// [`PathError`] if there is no home, or the folder cannot be trusted.
pub fn state_folder() -> Result<PrivateFolder, PathError> {
    let given = |name| std::env::var_os(name).map(PathBuf::from);
    PrivateFolder::open(&lasting_path(
        given("XDG_STATE_HOME"),
        given("HOME"),
        ".local/state",
        "XDG_STATE_HOME",
    )?)
}

/// The folder of what the user keeps: `$XDG_DATA_HOME/tendon`, else `.local/share/tendon` in this user's home. Folders of
/// others are passed over as in [`state_folder`].
///
/// # Errors
///
/// As [`state_folder`].
pub fn data_folder() -> Result<PrivateFolder, PathError> {
    let given = |name| std::env::var_os(name).map(PathBuf::from);
    PrivateFolder::open(&lasting_path(
        given("XDG_DATA_HOME"),
        given("HOME"),
        ".local/share",
        "XDG_DATA_HOME",
    )?)
}

/// The folder of records of how this user left each arm.
///
/// # Errors
///
/// As [`state_folder`].
pub fn arm_record_folder() -> Result<PrivateFolder, PathError> {
    PrivateFolder::open(&state_folder()?.path().join("arms"))
}

/// `given` by the environment as `variable`, else `below_home` in the home.
fn lasting_path(
    given: Option<PathBuf>,
    home: Option<PathBuf>,
    below_home: &str,
    variable: &'static str,
) -> Result<PathBuf, PathError> {
    let is_own = |path: &PathBuf| {
        // The nearest folder that is there already.
        let there = path.ancestors().find_map(|folder| std::fs::metadata(folder).ok());
        path.is_absolute() && there.is_some_and(|status| status.uid() == geteuid().as_raw())
    };
    let registered = || User::from_uid(geteuid()).ok().flatten().map(|user| user.dir);
    let below_home = |home: PathBuf| home.join(below_home);
    let folder = given.filter(is_own);
    let folder = folder.or_else(|| home.filter(is_own).or_else(registered).map(below_home));
    folder.map(|folder| folder.join("tendon")).ok_or(PathError::NoHome { variable })
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    fn set_mode(path: &Path, mode: u32) {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    }

    #[test]
    fn a_folder_is_made_for_this_user_alone_and_keeps_files() {
        let place = tempfile::tempdir().unwrap();
        let folder = PrivateFolder::open(&place.path().join("a/b/tendon")).unwrap();
        assert_eq!(std::fs::metadata(folder.path()).unwrap().mode() & 0o777, 0o700);
        assert_eq!(folder.read("arm").unwrap(), None);
        folder.write("arm", b"stopped").unwrap();
        folder.write("arm", b"left in good order").unwrap();
        assert_eq!(folder.read("arm").unwrap().unwrap(), b"left in good order");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays");
        assert_eq!(folder.names().unwrap(), ["arm"]);
        assert_eq!(folder.names().unwrap(), ["arm"], "read again from the beginning");
        folder.remove("arm").unwrap();
        folder.remove("arm").unwrap();
        assert_eq!(folder.read("arm").unwrap(), None);
    }

    #[test]
    fn planted_folders_are_refused_by_name() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("tendon");
        let target = place.path().join("target");
        std::fs::create_dir(&target).unwrap();
        symlink(&target, &path).unwrap();
        let error = PrivateFolder::open(&path).unwrap_err();
        assert!(matches!(error, PathError::WrongKind { .. }), "{error}");
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "").unwrap();
        assert!(matches!(PrivateFolder::open(&path), Err(PathError::WrongKind { .. })));
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        set_mode(&path, 0o777);
        let error = PrivateFolder::open(&path).unwrap_err();
        assert!(
            error.to_string().contains("others can write") && error.to_string().contains("0777"),
            "{error}"
        );
        // What only others could look into is tightened.
        set_mode(&path, 0o755);
        PrivateFolder::open(&path).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().mode() & 0o777, 0o700);
        if geteuid().is_root() {
            std::os::unix::fs::chown(&path, Some(65_534), None).unwrap();
            let error = PrivateFolder::open(&path).unwrap_err();
            assert!(matches!(error, PathError::OtherOwner { .. }), "{error}");
        }
    }

    #[test]
    fn planted_files_are_neither_read_nor_followed() {
        let place = tempfile::tempdir().unwrap();
        let folder = PrivateFolder::open(&place.path().join("tendon")).unwrap();
        let victim = place.path().join("victim");
        std::fs::write(&victim, "precious").unwrap();
        symlink(&victim, folder.path().join("arm")).unwrap();
        assert!(matches!(folder.read("arm"), Err(PathError::WrongKind { .. })));
        folder.write("arm", b"new").unwrap();
        assert_eq!(std::fs::read(&victim).unwrap(), b"precious");
        assert_eq!(folder.read("arm").unwrap().unwrap(), b"new");
        File::create(folder.path().join("huge")).unwrap().set_len(1 << 40).unwrap();
        set_mode(&folder.path().join("huge"), 0o600);
        assert!(matches!(folder.read("huge"), Err(PathError::System { .. })), "it is not read into memory");
        set_mode(&folder.path().join("arm"), 0o666);
        assert!(matches!(folder.read("arm"), Err(PathError::Writable { .. })));
        nix::unistd::mkfifo(&folder.path().join("pipe"), Mode::S_IRWXU).unwrap();
        assert!(matches!(folder.read("pipe"), Err(PathError::WrongKind { .. })));
    }

    #[test]
    fn the_environment_is_followed_only_to_folders_of_this_user() {
        // Short, as the paths of sockets have to be.
        let place = tempfile::Builder::new().prefix("t").rand_bytes(4).tempdir_in("/tmp").unwrap();
        let given = place.path().to_owned();
        set_mode(&given, 0o700);
        assert_eq!(runtime_path(Some(given.clone())), given.join("tendon"));
        set_mode(&given, 0o755);
        for bad in [Some(given.clone()), None, Some("relative".into()), Some("/no/such".into())] {
            assert_eq!(runtime_path(bad), fallback_path());
        }
        set_mode(&given, 0o700);
        let long = given.join("a-name-so-long-that-sockets-do-not-fit");
        std::fs::create_dir(&long).unwrap();
        set_mode(&long, 0o700);
        assert_eq!(runtime_path(Some(long)), fallback_path());

        let state_path = |given, home| lasting_path(given, home, ".local/state", "XDG_STATE_HOME");
        assert_eq!(state_path(Some(given.clone()), None).unwrap(), given.join("tendon"));
        let below_home = given.join(".local/state/tendon");
        assert_eq!(state_path(None, Some(given.clone())).unwrap(), below_home);
        assert_eq!(state_path(Some("relative".into()), Some(given.clone())).unwrap(), below_home);
        if geteuid().is_root() {
            std::os::unix::fs::chown(&given, Some(65_534), None).unwrap();
            let root = User::from_uid(geteuid()).unwrap().unwrap().dir;
            assert_eq!(
                state_path(Some(given.clone()), Some(given)).unwrap(),
                root.join(".local/state/tendon")
            );
        }
    }
}
