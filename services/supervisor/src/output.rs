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

/// How many reasons are shown of what was left out.
const REASONS_SHOWN: usize = 3;

/// What was left out, in a few lines: how many `things`, and why the first ones.
pub fn left_out(skipped: &[String], things: &str) -> String {
    let mut lines = vec![format!("{} {things} left out:", skipped.len())];
    lines.extend(skipped.iter().take(REASONS_SHOWN).map(|skipped| format!("  {skipped}")));
    let rest = skipped.len().saturating_sub(REASONS_SHOWN);
    if rest > 0 {
        lines.push(format!("  … and {rest} more; --json FILE lists them all"));
    }
    lines.join("\n")
}

/// A number of things: `1 person`, `2 people`.
pub fn counted(number: usize, one: &str, several: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { several })
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

/// The same for a file with what belongs to a person: nobody but its owner will read it.
///
/// # Errors
///
/// As [`checked`].
pub fn checked_private(path: Option<&Path>) -> Result<Option<OutputFile>, Failure> {
    Ok(checked(path)?.map(OutputFile::private))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_left_out_is_told_in_a_few_lines() {
        let skipped: Vec<String> = (0..200).map(|number| format!("{number}.csv: empty")).collect();
        let text = left_out(&skipped, "recordings");
        assert_eq!(
            text.lines().collect::<Vec<_>>(),
            [
                "200 recordings left out:",
                "  0.csv: empty",
                "  1.csv: empty",
                "  2.csv: empty",
                "  … and 197 more; --json FILE lists them all"
            ]
        );
        assert_eq!(left_out(&skipped[..3], "recordings").lines().count(), 4);
    }
}
