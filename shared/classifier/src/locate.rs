//! Where the runtime library and the models that come with Tendon are.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::ClassifierError;

/// Where `scripts/fetch-onnxruntime` puts the library, from the top of the project.
const FETCHED_LIBRARY: &str = ".cache/onnxruntime/libonnxruntime.so";

/// The runtime library to use: `configured`, otherwise `ORT_DYLIB_PATH`, otherwise `libonnxruntime.so` beside
/// the program, otherwise what `scripts/fetch-onnxruntime` fetched in a folder above the program.
///
/// # Errors
///
/// [`ClassifierError::NoRuntimeLibrary`], or [`ClassifierError::RuntimeLibrary`] if the configured library
/// is not there or no file that can be read.
pub fn runtime_library(configured: Option<&Path>) -> Result<PathBuf, ClassifierError> {
    let from_environment = || std::env::var_os("ORT_DYLIB_PATH").filter(|path| !path.is_empty());
    if let Some(named) = configured.map(Path::to_owned).or_else(|| from_environment().map(PathBuf::from)) {
        return match tendon_input::open(&named) {
            Ok(_) => Ok(named),
            Err(error) => {
                let is_missing = error.kind() == ErrorKind::NotFound;
                let reason = if is_missing { "there is no such file".to_owned() } else { error.to_string() };
                Err(ClassifierError::RuntimeLibrary { path: named, reason })
            }
        };
    }
    find_above_program("libonnxruntime.so")
        .or_else(|| find_above_program(FETCHED_LIBRARY))
        .ok_or(ClassifierError::NoRuntimeLibrary)
}

/// The model `models/{file}` in a folder above the program.
///
/// # Errors
///
/// [`ClassifierError::NoModel`].
pub fn model_beside_program(file: &str) -> Result<PathBuf, ClassifierError> {
    find_above_program(&format!("models/{file}"))
        .ok_or_else(|| ClassifierError::NoModel { file: file.to_owned() })
}

fn find_above_program(relative: &str) -> Option<PathBuf> {
    let program = std::env::current_exe().ok()?;
    program.ancestors().skip(1).map(|folder| folder.join(relative)).find(|path| path.is_file())
}
