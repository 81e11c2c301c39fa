//! EMG recordings: read without being loaded, replayed at a session's rate, cut into windows to train on.
//!
//! ```text
//! file ─▶ memory map ─▶ table (line by line) ─┐
//! file ─▶ memory map ─▶ table                ─┴▶ source: frames + cue ─▶ replay: blocks at the session's rate
//!                                                   │                      └─▶ dataset: windows.npy, labels.npy, …
//!                                                   └─▶ check: the whole recording read once, refused or summed up
//! ```
//! A recording is one text file with a line a sample and a column a channel, or several that follow on
//! without a gap, each with the *cue* its person was given: what can be replayed is in [`RecordingSource::open`].
//! Data sets are also made of MAT-files and of tables with labels: see [`dataset::list`].
//!
//! Nothing is allocated a sample once a recording is open, and memory use does not grow with its length.
#![deny(unsafe_code)]

pub mod dataset;
mod error;
mod labels;
mod mapped;
pub mod mat;
pub mod npy;
mod ozdemir;
mod replay;
mod source;
mod stored;
pub mod table;
mod three_dc;

pub use error::RecordingError;
pub use replay::{ReplayBlock, ReplayStream};
pub use source::{CueSpan, Frame, Notice, RecordingSettings, RecordingSource, Segment, Summary, check};
pub use stored::{StoredDataset, StoredDatasetError};
pub use table::Channel;
pub use three_dc::{
    SAMPLE_RATE_HZ as THREE_DC_SAMPLE_RATE_HZ, is_three_dc, repetitions as three_dc_repetitions,
};
