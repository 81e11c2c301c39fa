//! Whether the outputs of a command get in each other's way.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::OutputError;
use crate::file::{OutputFile, State};
use crate::folder::OutputFolder;

/// Checks that no two outputs of a command go to the same place, that none needs the file of another to be a folder, and
/// that no file is one of `inputs`, which the command reads. A file in the folder of another output is fine.
///
/// # Errors
///
/// [`OutputError::Twice`], [`OutputError::BelowFile`] and [`OutputError::IsInput`].
pub fn check_distinct<'a>(
    files: impl IntoIterator<Item = &'a OutputFile>,
    folders: impl IntoIterator<Item = &'a OutputFolder>,
    inputs: impl IntoIterator<Item = &'a Path>,
) -> Result<(), OutputError> {
    // Anything may be written to a device or a pipe.
    let files: Vec<&OutputFile> = files.into_iter().filter(|file| file.state != State::Special).collect();
    let inputs: Vec<PathBuf> = inputs.into_iter().map(resolved).collect();
    if let Some(file) = files.iter().find(|file| inputs.contains(&resolved(file.path()))) {
        return Err(OutputError::IsInput { path: file.path().to_owned() });
    }
    let paths: Vec<&Path> = files.iter().map(|file| file.path()).collect();
    let folders: Vec<&Path> = folders.into_iter().map(OutputFolder::path).collect();
    let all: Vec<PathBuf> = paths.iter().chain(&folders).map(|path| resolved(path)).collect();
    for (index, &path) in paths.iter().chain(&folders).enumerate() {
        let target = &all[index];
        if all[..index].contains(target) {
            return Err(OutputError::Twice { path: path.to_owned() });
        }
        let is_below = |&file: &usize| *target != all[file] && target.starts_with(&all[file]);
        if let Some(above) = (0..paths.len()).find(is_below) {
            return Err(OutputError::BelowFile { path: path.to_owned(), file: paths[above].to_owned() });
        }
    }
    Ok(())
}

/// The path as the system names it, as far as it exists: without links and dots.
fn resolved(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    for folder in absolute.ancestors() {
        if let Ok(real) = fs::canonicalize(folder) {
            let rest = absolute.strip_prefix(folder).unwrap_or(Path::new(""));
            // `join` of nothing would add a slash.
            return if rest.as_os_str().is_empty() { real } else { real.join(rest) };
        }
    }
    absolute
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_outputs_in_one_place_are_refused_however_they_are_named() {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("real")).unwrap();
        std::os::unix::fs::symlink("real", place.path().join("link")).unwrap();
        let file = |name: &str| OutputFile::check(&place.path().join(name)).unwrap();
        let folder = |name: &str| OutputFolder::check(&place.path().join(name)).unwrap();
        let distinct = |files: &[&str], folders: &[&str]| {
            let files: Vec<OutputFile> = files.iter().map(|name| file(name)).collect();
            let folders: Vec<OutputFolder> = folders.iter().map(|name| folder(name)).collect();
            check_distinct(&files, &folders, [])
        };
        assert!(distinct(&["a", "b", "real/a"], &["c"]).is_ok());
        assert!(distinct(&["real/a"], &["real"]).is_ok(), "a file in another output's folder is fine");
        for (files, folders) in [
            (&["a", "a"][..], &[][..]),
            (&["a", "./a"], &[]),
            (&["real/a", "link/a"], &[]),
            (&["a"], &["a"]),
            (&["real/a"], &["link/./a"]),
        ] {
            let refused = distinct(files, folders);
            assert!(matches!(refused, Err(OutputError::Twice { .. })), "{files:?}, {folders:?}: {refused:?}");
        }
        let refused = distinct(&["a"], &["a/figures"]);
        assert!(matches!(refused, Err(OutputError::BelowFile { .. })), "{refused:?}");
    }

    #[test]
    fn an_output_that_is_an_input_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let (input, link) = (place.path().join("input"), place.path().join("link"));
        fs::write(&input, "precious").unwrap();
        std::os::unix::fs::symlink("input", &link).unwrap();
        let file = OutputFile::check(&link).unwrap();
        let refused = check_distinct([&file], [], [input.as_path()]);
        assert!(matches!(refused, Err(OutputError::IsInput { .. })), "{refused:?}");
        check_distinct([&file], [], [place.path()]).unwrap();
    }
}
