//! What commands print, on standard output, which may be closed or full, and on standard error; and the files they are
//! asked to write.

use std::fmt::{self, Display, Write as _};
use std::io::{self, Write};
use std::path::Path;

use anyhow::Context;
use tendon_evaluation::LeftOut;
use tendon_output::OutputFile;
use tendon_recordings::SkippedKind;

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

/// What was left out, a line for each kind: how much, and the first of it. `details` says where all of it is listed.
pub fn summed_up<T: fmt::Display>(left_out: &[(SkippedKind, T)], details: &str) -> String {
    let mut text = format!("left out ({details}):");
    for (kind, count) in SkippedKind::count(left_out.iter().map(|(kind, _)| *kind)) {
        let first = left_out.iter().find(|(own, _)| *own == kind).map(|(_, first)| first);
        let first = first.map_or_else(String::new, ToString::to_string);
        let such_as = if count == 1 { "" } else { "such as " };
        let _ = write!(text, "\n  {}: {such_as}{first}", kind.counted(count));
    }
    text
}

/// The same of an evaluation, whose JSON lists it all.
pub fn left_out(left_out: &[LeftOut]) -> String {
    let left_out: Vec<(SkippedKind, &LeftOut)> =
        left_out.iter().map(|left_out| (left_out.kind, left_out)).collect();
    summed_up(&left_out, "--json FILE lists all of it")
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
    fn what_was_left_out_is_told_in_a_line_for_each_kind() {
        let entry = |kind: SkippedKind, reason: &str| LeftOut { kind, reason: reason.to_owned() };
        let mut skipped = vec![entry(SkippedKind::NoLabel, "a.csv: labels.csv has no label for it")];
        skipped.extend((0..120).map(|line| entry(SkippedKind::OtherGesture, &format!("b.csv: line {line}"))));
        let text = left_out(&skipped);
        assert_eq!(
            text.lines().collect::<Vec<_>>(),
            [
                "left out (--json FILE lists all of it):",
                "  120 trials of other gestures: such as b.csv: line 0",
                "  1 file without labels: a.csv: labels.csv has no label for it",
            ]
        );
    }
}
