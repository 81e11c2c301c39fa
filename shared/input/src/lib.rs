//! Files that a command is given to read.
//!
//! ```text
//! path ─▶ a regular file? ─▶ open ─▶ still one? ─▶ small enough? ─▶ read
//!           └── named pipe, device, socket, folder: refused by name, without being opened
//! ```
//!
//! A named pipe without a writer would be waited for forever, and a device such as /dev/zero has no end. So everything
//! that a user names as input goes through here. Small files are read whole, up to a bound that fits their kind;
//! recordings and arrays, which are mapped or streamed, may have any size.
#![forbid(unsafe_code)]

use std::fs::{self, File, FileType, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use nix::fcntl::OFlag;

/// Largest file of settings, such as `tendon.toml` or a profile, in bytes: 1 MB.
pub const LARGEST_SETTINGS: u64 = 1 << 20;
/// Largest list that belongs to recordings, such as `labels.csv` or a data set's manifest, in bytes: 256 MB.
pub const LARGEST_LIST: u64 = 256 << 20;
/// Largest model, in bytes: 512 MB.
pub const LARGEST_MODEL: u64 = 512 << 20;

/// Why a file cannot be input, although the system would open it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum InputProblem {
    /// Something else than a regular file.
    #[error("it is a {0}: name a regular file")]
    NotRegular(&'static str),
    /// A file beyond the bound of its kind.
    #[error("it is larger than {} MB, the most that a file of this kind may have: is it the right one?", bytes >> 20)]
    TooLarge {
        /// The bound.
        bytes: u64,
    },
}

impl From<InputProblem> for io::Error {
    fn from(problem: InputProblem) -> io::Error {
        io::Error::new(io::ErrorKind::InvalidInput, problem)
    }
}

/// Opens a regular file of any size, to be mapped or streamed.
///
/// # Errors
///
/// What the system says, or which kind of thing that is no regular file the path names.
pub fn open(path: &Path) -> io::Result<File> {
    // Before it is opened: opening alone can wait, or set a device in motion.
    check_kind(fs::metadata(path)?.file_type())?;
    // A file that was replaced by a pipe in the meantime must not be waited for either.
    let file = OpenOptions::new().read(true).custom_flags(OFlag::O_NONBLOCK.bits()).open(path)?;
    check_kind(file.metadata()?.file_type())?;
    Ok(file)
}

/// Checks that a file that something else will read is a regular one of at most `largest` bytes, and can be opened.
///
/// # Errors
///
/// As [`open`], or that the file is too large.
pub fn check(path: &Path, largest: u64) -> io::Result<()> {
    check_size(&open(path)?, largest)
}

/// Reads a regular file of at most `largest` bytes.
///
/// # Errors
///
/// As [`check`].
pub fn read(path: &Path, largest: u64) -> io::Result<Vec<u8>> {
    read_file(&open(path)?, largest)
}

/// Reads a regular file of at most `largest` bytes of UTF-8.
///
/// # Errors
///
/// As [`check`], or that it is no text.
pub fn read_text(path: &Path, largest: u64) -> io::Result<String> {
    String::from_utf8(read(path, largest)?)
        .map_err(|error| io::Error::new(io::ErrorKind::InvalidData, error.utf8_error()))
}

/// Reads an open file of at most `largest` bytes, from where it stands.
///
/// # Errors
///
/// What the system says, or that the file is too large.
pub fn read_file(file: &File, largest: u64) -> io::Result<Vec<u8>> {
    check_size(file, largest)?;
    let mut bytes = Vec::new();
    // A file may grow while it is read, and those of the kernel do not tell their size.
    file.take(largest + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > largest {
        return Err(InputProblem::TooLarge { bytes: largest }.into());
    }
    Ok(bytes)
}

fn check_size(file: &File, largest: u64) -> io::Result<()> {
    if file.metadata()?.len() > largest {
        return Err(InputProblem::TooLarge { bytes: largest }.into());
    }
    Ok(())
}

fn check_kind(kind: FileType) -> io::Result<()> {
    let name = if kind.is_file() {
        return Ok(());
    } else if kind.is_dir() {
        "folder"
    } else if kind.is_fifo() {
        "pipe"
    } else if kind.is_socket() {
        "socket"
    } else {
        "device"
    };
    Err(InputProblem::NotRegular(name).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(path: &Path) -> String {
        read(path, LARGEST_SETTINGS).unwrap_err().to_string()
    }

    #[test]
    fn what_is_no_regular_file_is_refused_by_its_kind_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&pipe, &link).unwrap();
        for (path, kind) in [
            (pipe.as_path(), "pipe"),
            (&link, "pipe"),
            (&socket, "socket"),
            (folder.path(), "folder"),
            (Path::new("/dev/zero"), "device"),
        ] {
            assert_eq!(refusal(path), format!("it is a {kind}: name a regular file"));
            assert!(open(path).is_err() && check(path, LARGEST_MODEL).is_err());
        }
    }

    #[test]
    fn a_file_is_read_up_to_its_bound() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, "text").unwrap();
        assert_eq!(read_text(&path, 4).unwrap(), "text");
        assert!(read(&path, 3).unwrap_err().to_string().contains("larger than 0 MB"));
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert!(refusal(&path).contains("larger than 1 MB"), "{}", refusal(&path));
        assert!(check(&path, LARGEST_MODEL).is_err());
        open(&path).unwrap();
    }

    #[test]
    fn a_link_to_a_file_is_followed_and_what_is_not_there_is_not_found() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "text").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert_eq!(read(&link, 10).unwrap(), b"text");
        fs::remove_file(&file).unwrap();
        assert_eq!(read(&link, 10).unwrap_err().kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn text_is_utf_8() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        fs::write(&path, b"\xff\xfe").unwrap();
        assert_eq!(read_text(&path, 10).unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
