//! What commands print, on standard output, which may be closed or full, and on standard error; and the files they are
//! asked to write.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::Path;

use anyhow::Context;
use tendon_output::OutputFile;

use crate::Failure;

/// Prints a line, or several, to standard output. Whoever reads it may stop doing so (`tendon evaluate … | head`):
/// that is not an error, and the rest is not printed.
///
/// # Errors
///
/// When standard output cannot be written for another reason, such as a full disk.
pub fn print(text: impl Display) -> anyhow::Result<()> {
    print_while_read(text).map(drop)
}

/// The same for a command that goes on until nobody reads any more: returns whether somebody still does.
///
/// # Errors
///
/// As [`print()`].
pub fn print_while_read(text: impl Display) -> anyhow::Result<bool> {
    let mut output = io::stdout().lock();
    match writeln!(output, "{text}").and_then(|()| output.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        result => result.map(|()| true).context("cannot write to standard output"),
    }
}

/// Tells the person who waits something, on standard error; without one, nothing happens.
pub fn tell(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Checks, before a command starts, a file that it is to write in the end, and says so if one is there that it will
/// replace.
///
/// # Errors
///
/// When it could not be written.
pub fn checked(path: Option<&Path>) -> Result<Option<OutputFile>, Failure> {
    let file = path.map(OutputFile::check).transpose().map_err(Failure::input)?;
    if let Some(file) = file.iter().find(|file| file.replaces()) {
        tell(format_args!("{} is there already and will be replaced", file.path().display()));
    }
    Ok(file)
}
