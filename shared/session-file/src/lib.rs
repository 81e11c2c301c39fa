//! The file of a recorded session: one MCAP file with everything as it happened.
//!
//! ```text
//! session.mcap   header: profile "tendon"
//!                metadata   session: name, version of this format, how CLOCK_MONOTONIC becomes the time of day
//!                           provenance; stages (what each said when it was ready, channels and unit among it);
//!                           task (how it went)
//!                attachments   tendon.toml (as run), model, rest_move_model, person
//!                messages   blocks        tendon-block: see `block.rs`; bit for bit
//!                           windows       context of each window; its samples follow from the blocks
//!                           predictions   probabilities, efforts, novelty
//!                           commands      decision and twist
//!                           states        the arm
//!                           measurements  counts of each process, and which process it is
//!                           events        stops with their reasons, restarts, notes, what the recording lost
//!                           cues          the true gesture, when it changes
//! ```
//!
//! All but the blocks are JSON with a schema, so viewers plot them. A number that is NaN is `null`, an infinite one is
//! `"inf"` or `"-inf"`; every other `f32` reads back bit for bit. The times inside messages are CLOCK_MONOTONIC in ns, as in
//! every header; the log and publish times of the file are the time of day.
//!
//! A chunk is closed at least every half second, so a file whose writer was killed lacks no more than that; and at 96 KiB, so
//! a damaged byte spoils no more than that.
#![forbid(unsafe_code)]

mod block;
mod compare;
mod conversation;
mod framing;
mod marks;
mod number;
mod reader;
mod records;
mod schemas;
#[cfg(test)]
mod tests;
mod writer;

pub use block::Block;
pub use compare::{Comparison, Difference, Differences, compare};
pub use conversation::{RecordingReport, RecordingStart, Said, Told};
pub use marks::{KeyOfWindow, ReplayMarks};
pub use number::Number;
pub use reader::{Head, Reader, Record, SessionFileError, is_session_file};
pub use records::{
    CommandRecord, ContextRecord, Cue, Event, EventKind, MeasurementRecord, Message, PredictionRecord,
    StateRecord, TraceRecord, WindowRecord,
};
pub use writer::{WriteError, Writer};

/// Profile in the header of the file.
pub const PROFILE: &str = "tendon";
/// Version of what the file holds.
pub const VERSION: &str = "1";
/// Name of the file in the folder of a recorded session.
pub const FILE_NAME: &str = "session.mcap";
/// Name of the attached configuration.
pub const CONFIGURATION: &str = "tendon.toml";
/// Name of the attached model of the gestures.
pub const MODEL: &str = "model";
/// Name of the attached model of rest and move.
pub const REST_MOVE_MODEL: &str = "rest_move_model";
/// Name of the attached person.
pub const PERSON: &str = "person";
/// Name of the metadata that say how a task went.
pub const TASK: &str = "task";
