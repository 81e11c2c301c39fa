//! What can go wrong while a data set is built.

use std::io;
use std::path::{Path, PathBuf};

use tendon_output::OutputError;
use tendon_signal::DesignError;

use crate::listing::ListingError;
use crate::split::SplitError;

/// Why no data set could be built.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// No recordings that could be used together.
    #[error(transparent)]
    Listing(#[from] ListingError),
    /// Settings that do not fit.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// People who cannot be held out.
    #[error(transparent)]
    Split(#[from] SplitError),
    /// All windows are held out.
    #[error(
        "nothing is left to train on: all windows are of those held out ({held_out}); hold out fewer people, sessions or repetitions"
    )]
    NothingToTrain {
        /// What is held out, in words.
        held_out: String,
    },
    /// The build was broken off.
    #[error("interrupted: run the same command again to continue the build in {}", .unfinished.display())]
    Interrupted {
        /// Folder of the unfinished data set.
        unfinished: PathBuf,
    },
    /// A finished data set stands there, and nobody asked to replace it.
    #[error(
        "{} holds a finished data set ({content}): add --force to replace it, or choose another folder",
        .out_dir.display()
    )]
    Finished {
        /// Folder of the data set.
        out_dir: PathBuf,
        /// What it holds, in words.
        content: String,
    },
    /// A folder with other things in it.
    #[error("{} is no part of a data set: give a folder of its own instead of {}", .path.display(), .out_dir.display())]
    OtherFiles {
        /// What lies there.
        path: PathBuf,
        /// The folder.
        out_dir: PathBuf,
    },
    /// A path that ends without the name of a folder.
    #[error("{} cannot be the folder of a data set: name a folder", .out_dir.display())]
    NoName {
        /// The path.
        out_dir: PathBuf,
    },
    /// The data set is complete, but cannot be put where it shall stand.
    #[error(
        "cannot put the finished data set in the place of {} ({reason}): move that away and run the same command again, \
         which takes what is in {}",
        .out_dir.display(), .unfinished.display()
    )]
    Place {
        /// Where it shall stand.
        out_dir: PathBuf,
        /// Where it is.
        unfinished: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// Another process builds there.
    #[error("another build is writing to {}: wait for it, or choose another folder", .unfinished.display())]
    InUse {
        /// Folder of the unfinished data set.
        unfinished: PathBuf,
    },
    /// A file of the data set that cannot be written.
    #[error("cannot write {}: {reason}; check that there is room and that you may write there", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// Something else than a file lies where one of the data set is to be written.
    #[error("{} is no regular file: remove it, or choose another folder", .path.display())]
    NotAFile {
        /// What lies there.
        path: PathBuf,
    },
    /// The manifest cannot be written.
    #[error(transparent)]
    Manifest(#[from] OutputError),
    /// Not a single window.
    #[error(
        "no window could be cut from any recording; the first of {recordings} was left out because: {first_reason}"
    )]
    NoWindows {
        /// Recordings found.
        recordings: usize,
        /// Why the first one was left out.
        first_reason: String,
    },
}

/// What did not let `path` be written.
pub(crate) fn write_error(path: &Path) -> impl FnOnce(io::Error) -> DatasetError + '_ {
    |reason| DatasetError::Write { path: path.to_owned(), reason }
}
