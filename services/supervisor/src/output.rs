//! What commands print: on standard output, which may be closed or full, and on standard error.

use std::fmt::Display;
use std::io::{self, Write};

use anyhow::Context;

/// Prints a line, or several, to standard output. Whoever reads it may stop doing so (`tendon evaluate … | head`):
/// that is no fault, and the rest is not printed.
///
/// # Errors
///
/// When standard output cannot be written for another reason, such as a full disk.
pub fn print(text: impl Display) -> anyhow::Result<()> {
    let mut output = io::stdout().lock();
    match writeln!(output, "{text}").and_then(|()| output.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result.context("cannot write to standard output"),
    }
}

/// Says something to the person who waits, on standard error; where that is closed, to nobody.
pub fn tell(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}
