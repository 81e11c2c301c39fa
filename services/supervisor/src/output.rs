//! What commands print on standard output: a reader that leaves (`tendon doctor | head`) or a full disk makes no command
//! panic, and the exit code says what was lost.

use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::sync::OnceLock;

use anyhow::Context;

/// Why standard output takes no more.
static FAILURE: OnceLock<std::io::Error> = OnceLock::new();

/// Prints a line. After a failure nothing more is printed.
pub fn line(text: impl Display) {
    if FAILURE.get().is_none()
        && let Err(error) = writeln!(std::io::stdout(), "{text}")
    {
        let _ = FAILURE.set(error);
    }
}

/// Whether nothing more can be printed.
pub fn has_failed() -> bool {
    FAILURE.get().is_some()
}

/// Whether everything that was to be printed was, or nobody was there to read it.
///
/// # Errors
///
/// When the system refused to write, such as on a full disk.
pub fn result() -> anyhow::Result<()> {
    match FAILURE.get() {
        Some(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(std::io::Error::from(error.kind())).context("cannot write to standard output")
        }
        _ => Ok(()),
    }
}
