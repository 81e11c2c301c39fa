//! Whether the files through which the processes of a session reach each other are still there.

use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::time::SystemTime;

use tendon_messages::{BLOCKS, COMMANDS, MEASUREMENTS, PREDICTIONS, STATES, WINDOWS};
use tendon_paths::runtime_folder;

use crate::session::SessionName;
use crate::wake::page_path;

/// Paths of a running session that stay until its end: one file a topic in shared memory, and the run-time folder.
/// Whatever deletes the session's files deletes these, too. What is mapped or open goes on working then, but no stage
/// that is started again and no observer finds the others.
#[derive(Debug)]
pub struct SharedFiles {
    pages: Vec<Watched>,
    run_time_folder: Option<Watched>,
}

#[derive(Debug)]
struct Watched {
    path: PathBuf,
    /// Device and number of what was there first, and when it was made: another of the same name is not it, even if it
    /// has been given the same number.
    inode: Option<(u64, u64, Option<SystemTime>)>,
}

impl Watched {
    fn new(path: PathBuf) -> Watched {
        Watched { path, inode: None }
    }

    /// Whether it was there once and is gone.
    fn is_deleted(&mut self) -> bool {
        let metadata = std::fs::metadata(&self.path).ok();
        let inode = metadata.map(|metadata| (metadata.dev(), metadata.ino(), metadata.created().ok()));
        self.inode = self.inode.or(inode);
        self.inode != inode
    }
}

impl SharedFiles {
    /// Those of `session`, which this process supervises.
    pub fn of(session: &SessionName) -> SharedFiles {
        let topics =
            [BLOCKS.name, WINDOWS.name, PREDICTIONS.name, COMMANDS.name, STATES.name, MEASUREMENTS.name];
        SharedFiles {
            pages: topics.map(|topic| Watched::new(page_path(session, topic))).into(),
            run_time_folder: runtime_folder().ok().map(|folder| Watched::new(folder.path().to_owned())),
        }
    }

    /// The first file in shared memory that was there once and is gone.
    pub fn deleted(&mut self) -> Option<PathBuf> {
        // All are looked at, so that each is known to have been there.
        let mut deleted = None;
        for page in &mut self.pages {
            if page.is_deleted() {
                deleted.get_or_insert_with(|| page.path.clone());
            }
        }
        deleted
    }

    /// The run-time folder if it was there once and is gone. It is given once.
    pub fn deleted_run_time_folder(&mut self) -> Option<PathBuf> {
        self.run_time_folder.take_if(Watched::is_deleted).map(|folder| folder.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_there_yet_is_not_deleted() {
        let session: SessionName = format!("files-{}", std::process::id()).parse().unwrap();
        let mut files = SharedFiles::of(&session);
        assert_eq!(files.deleted(), None);
        let page = page_path(&session, STATES.name);
        std::fs::write(&page, "").unwrap();
        assert_eq!(files.deleted(), None);
        std::fs::remove_file(&page).unwrap();
        assert_eq!(files.deleted(), Some(page));
    }

    #[test]
    fn a_folder_that_vanishes_is_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let mut watched = Watched::new(folder.path().to_owned());
        assert!(!watched.is_deleted());
        let path = folder.path().to_owned();
        folder.close().unwrap();
        assert!(watched.is_deleted());
        // Another of the same name is not that one.
        std::fs::write(&path, "").unwrap();
        assert!(watched.is_deleted());
        std::fs::remove_file(&path).unwrap();
    }
}
