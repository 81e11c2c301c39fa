//! `tendon note`: a person's word on a running session, kept in its recording.

use clap::Args;
use tendon_process::{NoteError, leave_note};
use tendon_transport::SessionName;

use crate::Failure;
use crate::output::print;

/// Command line of `tendon note`.
#[derive(Debug, Args)]
pub struct Options {
    /// What to keep, such as "electrode 3 is loose".
    text: String,
    /// Name of the session.
    #[arg(long, default_value = "tendon")]
    session: SessionName,
}

/// Gives the note to the recorder, and says where it was written.
pub fn leave(options: &Options) -> Result<(), Failure> {
    let answer = leave_note(&options.session, &options.text).map_err(|error| match error {
        NoteError::NoAnswer(_) | NoteError::Socket { .. } => Failure::running(error),
        NoteError::Find(_) | NoteError::NotRecorded(_) | NoteError::Empty | NoteError::TooLong { .. } => {
            Failure::input(error)
        }
    })?;
    print(answer).map_err(Failure::running)
}
