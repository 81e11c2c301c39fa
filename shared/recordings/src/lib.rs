//! EMG recordings: read without being loaded, replayed at a session's rate, and written as they are made.
//!
//! ```text
//! file ─▶ memory map ─▶ table (line by line) ─┐
//! file ─▶ memory map ─▶ table                ─┴▶ source: frames + cue ─▶ replay: blocks at the session's rate
//! MAT-file, EDF, BDF, XDF ─▶ columns ───────────▶   │
//!                                                   └─▶ check: the whole recording read once, refused or summed up
//! ```
//! A recording is one text file with a line a sample and a column a channel, or several that follow on
//! without a gap, each with the *cue* its person was given: what can be replayed is in [`RecordingSource::open`].
//!
//! How files lie on disk is a *layout*: [`three_dc`], [`ozdemir`], or tables with [`labels`]. A layout turns names and
//! contents into [`Segment`]s, from which a [`RecordingSource`] is opened.
//!
//! [`Recorder`] writes tables with labels.
//!
//! Nothing is allocated a sample once a recording is open, and memory use does not grow with the length of a table. Of other files
//! the chosen channels come into memory.
#![deny(unsafe_code)]

mod check;
mod column_labels;
pub mod edf;
mod error;
pub mod labels;
mod layout;
mod mapped;
pub mod mat;
mod muscles;
pub mod npy;
pub mod ozdemir;
mod ratio;
mod recorder;
mod replay;
mod segment;
mod signals;
mod source;
pub mod table;
mod text;
pub mod three_dc;
pub mod xdf;

pub use check::{CueSpan, LONGEST_SILENCE_S, Summary, check};
pub use error::RecordingError;
pub use muscles::{first_muscles, muscles, unit_of_table};
pub use recorder::{RecordedSession, RecordedTrial, Recorder, RecorderError, SimulatedFrom};
pub use replay::{ReplayBlock, ReplayStream};
pub use segment::{Notice, Segment, SkippedEntry, SkippedKind, labels_left_out, summed_up};
pub use signals::{Cue, Gap, Signals, SignalsError, is_signals};
pub use source::{Frame, RecordingSettings, RecordingSource};
pub use table::{Channel, ColumnKind};
