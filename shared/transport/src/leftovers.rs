//! What sessions leave behind in shared memory and in the folders of run-time state.

use std::path::PathBuf;
use std::time::Duration;

use iceoryx2::prelude::{CallbackProgression, Node, NodeState, ipc};
use tendon_paths::runtime_folders;

use crate::lock::SessionLock;
use crate::session::{SessionName, own_user, shared_memory_directory};

/// A segment of shared memory that is empty for so long has lost its maker.
const LONGEST_EMPTY: Duration = Duration::from_secs(1);

/// Files that this user's sessions have in shared memory and in the folders of run-time state.
#[derive(Debug, Default)]
pub struct Leftovers {
    /// Paths of the files.
    pub files: Vec<PathBuf>,
    /// Their size in bytes.
    pub bytes: u64,
}

/// What became of the files that a session left behind.
#[derive(Debug, Default)]
pub struct Removed {
    /// How many are gone.
    pub files: usize,
    /// Those that could not be removed.
    pub kept: Vec<PathBuf>,
}

impl Leftovers {
    /// What `session` has there at the moment, alive or not.
    pub fn of(session: &SessionName) -> Leftovers {
        Leftovers::with_prefix(&session.prefix())
    }

    /// What there is of the session of `lock` beside the lock itself.
    pub fn beside(lock: &SessionLock) -> Leftovers {
        let mut leftovers = Leftovers::of(lock.session());
        let own = lock.run_file();
        leftovers.files.retain(|file| *file != own);
        leftovers.bytes -= std::fs::metadata(own).map_or(0, |metadata| metadata.len()).min(leftovers.bytes);
        leftovers
    }

    /// What all sessions of this user have there, those in use included.
    pub fn of_all_sessions() -> Leftovers {
        Leftovers::with_prefix(&format!("tendon.{}.", own_user()))
    }

    fn with_prefix(prefix: &str) -> Leftovers {
        let mut leftovers = Leftovers::default();
        let mut folders = vec![shared_memory_directory().to_owned()];
        folders.extend(runtime_folders().iter().map(|folder| folder.path().to_owned()));
        while let Some(folder) = folders.pop() {
            let Ok(entries) = std::fs::read_dir(&folder) else { continue };
            for entry in entries.flatten() {
                let path = entry.path();
                let is_in_memory = path.starts_with(shared_memory_directory());
                // Of the entry itself: links are not followed.
                match entry.metadata() {
                    Ok(metadata) if metadata.is_dir() && !is_in_memory => folders.push(path),
                    Ok(metadata) if entry.file_name().to_string_lossy().starts_with(prefix) => {
                        leftovers.bytes += metadata.len();
                        leftovers.files.push(path);
                    }
                    _ => {}
                }
            }
        }
        leftovers
    }

    /// The sessions that these files belong to.
    pub fn sessions(&self) -> Vec<SessionName> {
        let mut names: Vec<SessionName> = Vec::new();
        for file in &self.files {
            let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let session = name.split('.').nth(2).and_then(|name| name.parse().ok());
            if let Some(session) = session.filter(|session| !names.contains(session)) {
                names.push(session);
            }
        }
        names
    }

    /// Removes everything that the session of `lock` left behind. The caller has reaped all of its processes: files of
    /// living ones would be pulled from under them.
    pub fn remove(lock: &SessionLock) -> Removed {
        let session = lock.session();
        let before = Leftovers::beside(lock).files.len();
        Leftovers::remove_empty_segments(session, Duration::ZERO);
        // Then iceoryx2's own way, which knows in which order things go; then what even that left.
        Leftovers::remove_dead_nodes(session);
        for file in Leftovers::beside(lock).files {
            // What vanishes meanwhile needs no removing; what resists is counted below.
            let _ = std::fs::remove_file(file);
        }
        let kept = Leftovers::beside(lock).files;
        Removed { files: before.saturating_sub(kept.len()), kept }
    }

    /// A process that was killed while it made a segment of shared memory leaves it empty, and iceoryx2 0.10 would wait
    /// for ever for it to be filled. A living one fills it within microseconds.
    fn remove_empty_segments(session: &SessionName, older_than: Duration) {
        for file in Leftovers::of(session).files {
            let is_left_empty = std::fs::metadata(&file).is_ok_and(|metadata| {
                let age = metadata.modified().ok().and_then(|modified| modified.elapsed().ok());
                metadata.is_file() && metadata.len() == 0 && age.unwrap_or_default() >= older_than
            });
            if is_left_empty && file.starts_with(shared_memory_directory()) {
                let _ = std::fs::remove_file(file);
            }
        }
    }

    /// Removes what dead processes left in `session` while others live in it: their ports give way to those of the
    /// processes that stand in for them. The dead must have been reaped. What cannot be removed now goes with the
    /// session.
    pub fn remove_of_the_dead(session: &SessionName) {
        Leftovers::remove_empty_segments(session, LONGEST_EMPTY);
        Leftovers::remove_dead_nodes(session);
    }

    fn remove_dead_nodes(session: &SessionName) {
        for folder in runtime_folders() {
            let _ = Node::<ipc::Service>::list(&session.config(folder.path()), |state| {
                if let NodeState::Dead(dead) = state {
                    let _ = dead.try_remove_stale_resources();
                }
                CallbackProgression::Continue
            });
        }
    }
}
