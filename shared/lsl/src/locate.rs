//! Where liblsl is.

use std::path::{Path, PathBuf};

use crate::LslError;

/// Names the library, if no setting does.
const VARIABLE: &str = "LSL_LIBRARY";
/// Where `scripts/fetch-libraries` puts it, from the top of the project.
const FETCHED: &str = ".cache/lsl/liblsl.so";

/// The liblsl to use: `configured` (`acquisition.lsl.library`), otherwise `LSL_LIBRARY`, otherwise `liblsl.so` beside the
/// program or in a folder above it, otherwise what `scripts/fetch-libraries` fetched there. An absolute path: the library is
/// never looked for in the current folder.
///
/// # Errors
///
/// [`LslError::NoLibrary`], or [`LslError::Library`] when the one that was named is not there.
pub fn find_library(configured: Option<&Path>) -> Result<PathBuf, LslError> {
    let from_environment = || std::env::var_os(VARIABLE).filter(|path| !path.is_empty()).map(PathBuf::from);
    if let Some(named) = configured.map(Path::to_owned).or_else(from_environment) {
        if !named.is_file() {
            return Err(LslError::Library { path: named, reason: "there is no such file".to_owned() });
        }
        let reason = |error: std::io::Error| error.to_string();
        return std::path::absolute(&named)
            .map_err(|error| LslError::Library { path: named, reason: reason(error) });
    }
    above_program("liblsl.so").or_else(|| above_program(FETCHED)).ok_or(LslError::NoLibrary)
}

fn above_program(relative: &str) -> Option<PathBuf> {
    let program = std::env::current_exe().ok()?;
    program.ancestors().skip(1).map(|folder| folder.join(relative)).find(|path| path.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_library_that_is_named_and_not_there_is_refused_with_the_way_to_one() {
        let refused = find_library(Some(Path::new("/nowhere/liblsl.so"))).unwrap_err().to_string();
        assert!(refused.starts_with("/nowhere/liblsl.so: cannot be used as liblsl"), "{refused}");
        assert!(refused.contains("scripts/fetch-libraries lsl"), "{refused}");
    }
}
