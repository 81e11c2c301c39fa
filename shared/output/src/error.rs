//! What can keep a file from being written.

use std::fmt::{self, Display};
use std::io;
use std::path::PathBuf;

/// Why a file cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The folder of the file does not exist.
    #[error("{}: there is no folder {}: make it first (mkdir -p), or name another", path.display(), folder.display())]
    NoFolder {
        /// The file.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
    },
    /// The path names a folder.
    #[error("{} is a folder: name a file in it", path.display())]
    IsFolder {
        /// The path.
        path: PathBuf,
    },
    /// A folder is wanted, and the path names something else.
    #[error("{} is no folder: name another", path.display())]
    NotAFolder {
        /// The path.
        path: PathBuf,
    },
    /// Two outputs would go to one place.
    #[error("{} is named for two outputs: give each a path of its own", path.display())]
    Twice {
        /// The file or folder.
        path: PathBuf,
    },
    /// One output would need the file of another to be a folder.
    #[error("{} lies below {}, which is the file of another output: name another path", path.display(), file.display())]
    BelowFile {
        /// The file or folder that cannot be made.
        path: PathBuf,
        /// The file.
        file: PathBuf,
    },
    /// An output would replace what the command reads.
    #[error("{} is also what the command reads: write to another file", path.display())]
    IsInput {
        /// The file.
        path: PathBuf,
    },
    /// Something came to be there while the command ran.
    #[error("{} came to be there meanwhile, and stays as it is: name another file, or add --force", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A named pipe without a reader.
    #[error("nobody reads the pipe {}: start its reader first, or name a file", path.display())]
    NobodyReads {
        /// The pipe.
        path: PathBuf,
    },
    /// The system refuses.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The content cannot be made.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// All errors of the files of one command, each on a line of its own.
#[derive(Debug)]
pub struct OutputErrors(Vec<OutputError>);

impl Display for OutputErrors {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, error) in self.0.iter().enumerate() {
            let separator = if index == 0 { "" } else { "\n" };
            write!(out, "{separator}{error}")?;
            let mut cause = std::error::Error::source(error);
            while let Some(error) = cause {
                write!(out, ": {error}")?;
                cause = error.source();
            }
        }
        Ok(())
    }
}

impl std::error::Error for OutputErrors {}

/// Gathers the errors of several outputs. The iterator runs to its end, so every output is written.
///
/// # Errors
///
/// Everything that failed.
pub fn collect(results: impl IntoIterator<Item = Result<(), OutputError>>) -> Result<(), OutputErrors> {
    let errors: Vec<OutputError> = results.into_iter().filter_map(Result::err).collect();
    if errors.is_empty() { Ok(()) } else { Err(OutputErrors(errors)) }
}
