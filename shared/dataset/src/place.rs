//! Where a data set is built, and how it comes to its place.
//!
//! ```text
//! OUT.unfinished  progress.jsonl, windows.npy, …      OUT  the data set that stood there before, whole
//!        │
//!        └─ once all is written, one step of the file system: exchange, or rename where nothing stood
//!
//! OUT.unfinished  the data set from before, removed   OUT  the new one
//! ```
//! So a build that fails or is killed at any moment leaves the old or the new data set at OUT. What it leaves at
//! OUT.unfinished is continued by the same command, and removed by another one.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{AT_FDCWD, RenameFlags, renameat2};
use tendon_identity::{PersonId, list_of};

use crate::error::DatasetError;
use crate::files::{ALL, MANIFEST, PROGRESS};
use crate::manifest::Manifest;

/// What the name of the folder ends with in which a data set is built.
const UNFINISHED: &str = ".unfinished";

/// The folder of a data set that is to be built.
#[derive(Debug)]
pub(crate) struct Place {
    /// Where the data set shall stand.
    out: PathBuf,
    /// Where it is built, beside it.
    unfinished: PathBuf,
}

/// Whether a data set can be built for `out_dir`, without changing anything. `replaces` says whether a finished one that stands
/// there may be replaced.
///
/// # Errors
/// When a finished data set stands there that must stay, or something lies there that is no part of one.
pub fn check_place(out_dir: &Path, replaces: bool) -> Result<(), DatasetError> {
    Place::check(out_dir, replaces).map(drop)
}

impl Place {
    /// As [`check_place`].
    pub(crate) fn check(out_dir: &Path, replaces: bool) -> Result<Place, DatasetError> {
        // A link stays: what it leads to is replaced.
        let out = fs::canonicalize(out_dir).unwrap_or_else(|_| out_dir.to_owned());
        let Some(name) = out.file_name() else {
            return Err(DatasetError::NoName { out_dir: out_dir.to_owned() });
        };
        let mut unfinished = OsString::from(name);
        unfinished.push(UNFINISHED);
        let place = Place { unfinished: out.with_file_name(unfinished), out };
        place.check_content()?;
        if !replaces && place.out.join(MANIFEST).exists() {
            let content = content_of(&place.out);
            return Err(DatasetError::Finished { out_dir: out_dir.to_owned(), content });
        }
        check_files(&place.unfinished)?;
        Ok(place)
    }

    /// Refuses a folder with other things in it: they would be moved with the data set that stands there.
    fn check_content(&self) -> Result<(), DatasetError> {
        let entries = match fs::read_dir(&self.out) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(reason) => return Err(DatasetError::Write { path: self.out.clone(), reason }),
        };
        for entry in entries {
            let entry = entry.map_err(|reason| DatasetError::Write { path: self.out.clone(), reason })?;
            let name = entry.file_name();
            if !ALL.iter().any(|part| name == *part) && !tendon_output::is_temporary(&name) {
                return Err(DatasetError::OtherFiles { path: entry.path(), out_dir: self.out.clone() });
            }
        }
        check_files(&self.out)
    }

    /// The folder in which the data set is built.
    pub(crate) fn unfinished(&self) -> &Path {
        &self.unfinished
    }

    /// Makes that folder; empty, unless it holds an unfinished build.
    pub(crate) fn make(&self) -> Result<(), DatasetError> {
        let write_error = |reason| DatasetError::Write { path: self.unfinished.clone(), reason };
        fs::create_dir_all(&self.unfinished).map_err(write_error)?;
        if self.unfinished.join(PROGRESS).exists() {
            remove_temporary(&self.unfinished).map_err(write_error)
        } else {
            remove_files(&self.unfinished).map_err(write_error)
        }
    }

    /// Puts the data set, which is complete, where it shall stand, and removes the one that stood there.
    pub(crate) fn take(&self) -> Result<(), DatasetError> {
        self.check_content()?;
        let [from, to] = [&self.unfinished, &self.out].map(PathBuf::as_path);
        let place_error = |reason: io::Error| DatasetError::Place {
            out_dir: self.out.clone(),
            unfinished: self.unfinished.clone(),
            reason,
        };
        match renameat2(AT_FDCWD, from, AT_FDCWD, to, RenameFlags::RENAME_EXCHANGE) {
            Ok(()) => {}
            Err(Errno::ENOENT) => fs::rename(from, to).map_err(place_error)?,
            Err(error) => return Err(place_error(error.into())),
        }
        let finish = || {
            remove_file(&self.out.join(PROGRESS))?;
            if from.exists() {
                remove_files(from)?;
                fs::remove_dir(from)?;
            }
            Ok(())
        };
        finish().map_err(|reason| DatasetError::Write { path: self.unfinished.clone(), reason })
    }
}

/// Refuses a folder in which something else than a file lies where one of a data set is to be: opening a pipe, for instance,
/// would wait forever.
fn check_files(folder: &Path) -> Result<(), DatasetError> {
    let is_other = |path: &PathBuf| path.metadata().is_ok_and(|metadata| !metadata.is_file());
    match ALL.map(|name| folder.join(name)).into_iter().find(is_other) {
        Some(path) => Err(DatasetError::NotAFile { path }),
        None => Ok(()),
    }
}

fn remove_files(folder: &Path) -> io::Result<()> {
    ALL.iter().try_for_each(|name| remove_file(&folder.join(name)))?;
    remove_temporary(folder)
}

/// Removes what a build left that was killed while it wrote a file.
fn remove_temporary(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if tendon_output::is_temporary(&entry.file_name()) {
            remove_file(&entry.path())?;
        }
    }
    Ok(())
}

fn remove_file(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// What a finished data set holds, in words.
fn content_of(folder: &Path) -> String {
    let Ok(manifest) = Manifest::read(folder) else {
        return "its manifest cannot be read".to_owned();
    };
    let people: Vec<PersonId> = manifest.windows_per_person.keys().copied().collect();
    let gestures: Vec<&str> = manifest.windows_per_gesture.keys().map(String::as_str).collect();
    let date = manifest.provenance.started_at.split('T').next().filter(|date| !date.is_empty());
    format!(
        "people {}; {} windows of {}{}",
        list_of(&people),
        manifest.windows,
        gestures.join(", "),
        date.map_or_else(String::new, |date| format!("; built on {date}"))
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(folder: &Path, names: &[&str]) {
        fs::create_dir_all(folder).unwrap();
        names.iter().for_each(|name| fs::write(folder.join(name), *name).unwrap());
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_new_data_set_takes_the_place_of_the_old_one_or_of_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("windows");
        for has_old in [false, true] {
            let place = Place::check(&out, has_old).unwrap();
            place.make().unwrap();
            write(place.unfinished(), &[MANIFEST, PROGRESS, "labels.npy"]);
            place.take().unwrap();
            assert_eq!(names(&out), ["labels.npy", MANIFEST]);
            assert_eq!(names(folder.path()), ["windows"]);
        }
    }

    #[test]
    fn what_stands_there_is_not_moved_unasked() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("windows");
        write(&out, &[MANIFEST]);
        let refused = Place::check(&out, false).unwrap_err().to_string();
        assert!(refused.contains("holds a finished data set") && refused.contains("--force"), "{refused}");
        write(&out, &["notes.txt"]);
        let refused = Place::check(&out, true).unwrap_err().to_string();
        assert!(refused.contains("notes.txt is no part of a data set"), "{refused}");
        let refused = Place::check(Path::new("/"), true).unwrap_err().to_string();
        assert!(refused.contains("name a folder"), "{refused}");
    }

    #[test]
    fn what_a_killed_build_leaves_is_gone_on_with_or_removed() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("windows");
        let place = Place::check(&out, false).unwrap();
        // Killed while it was built.
        write(place.unfinished(), &[PROGRESS, "windows.npy", ".tendon-a1b2c3"]);
        place.make().unwrap();
        assert_eq!(names(place.unfinished()), [PROGRESS, "windows.npy"]);
        // Killed after the exchange: the old data set is left, and the new one still has its progress.
        fs::remove_file(place.unfinished().join(PROGRESS)).unwrap();
        write(&out, &[MANIFEST, PROGRESS, ".tendon-a1b2c3"]);
        let place = Place::check(&out, true).unwrap();
        place.make().unwrap();
        assert!(names(place.unfinished()).is_empty());
        write(place.unfinished(), &[MANIFEST, PROGRESS]);
        place.take().unwrap();
        assert_eq!(
            (names(&out), names(folder.path())),
            (vec![MANIFEST.to_owned()], vec!["windows".to_owned()])
        );
    }
}
