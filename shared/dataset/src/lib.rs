//! Windows to train on, cut from recordings by the code that runs live.
//!
//! ```text
//! paths ─▶ list: recordings of any layout
//! recording ─▶ replay at the session's rate ─▶ filter, causal and without a break over the whole recording
//!
//! trial                  |~~ rest ~~|margin|═══════════════ gesture ═══════════════|
//!                                   ▲ onset (or a fixed cut-off if none is found)
//! windows                           [──────]  [──────]
//!                                      [──────]  …  each wholly between the onset and the end of the trial
//! ```
//! The classifier sees live just such windows: the filter has been running, and no look into the future is
//! taken, except in choosing where a gesture begins. [`cut`] yields the windows of one recording without storing them;
//! [`build`] writes those of many.
//!
//! # What is written
//! | file | content |
//! |---|---|
//! | `windows.npy` | float32 `[n, channels, window]`, filtered or its envelope, in the recording's unit |
//! | `labels.npy` | uint8 `[n]`, class numbers of [`Gesture`](tendon_gesture::Gesture) |
//! | `people.npy` | uint16 `[n]`, number of the person; `named_people` in the manifest has the name of those who have one |
//! | `repetitions.npy` | uint8 `[n]`, the repetition counted through all sessions of the person: 0 to 3 in 3DC's `train`, 4 to 7 in its `test` |
//! | `recordings.npy` | uint32 `[n]`, the window's trial: its place in the manifest's `recordings` |
//! | `starts.npy` | uint32 `[n]`, the window's first sample within that trial, at the data set's rate |
//! | `splits.npy` | uint8 `[n]`, what the window is for: a [`Split`] |
//! | `manifest.json` | [`Manifest`]: settings, counts, and what became of each trial |
//!
//! A data set is built beside its place, in a folder with the ending `.unfinished`, where `progress.jsonl` records which
//! recordings are finished.
//!
//! ```text
//! settings ─▶ listing ─▶ recording ─▶ cut ─▶ build ─▶ windows.npy, manifest.json ─▶ stored
//!                                                └── ordered (threads), journal (interruptions), place, split (who tests)
//! ```
#![forbid(unsafe_code)]

mod build;
mod cut;
mod error;
mod files;
mod journal;
mod listing;
mod manifest;
mod ordered;
mod place;
mod recording;
mod settings;
mod split;
mod stored;
mod trial;

pub use build::{BuildSettings, Progress, build};
pub use cut::{Cut, CutWindow, cut};
pub use error::DatasetError;
pub use files::ALL as FILES;
pub use listing::{Layout, ListingError, Recordings, list};
pub use manifest::Manifest;
pub use place::check_place;
pub use recording::Recording;
pub use settings::DatasetSettings;
pub use split::{
    GestureStatistics, Split, SplitEntry, SplitError, SplitWindows, TrainingStatistics, VALIDATION_SHARE,
    share_recordings,
};
pub use stored::{StoredDataset, StoredDatasetError, StoredDatasetProblem};
pub use trial::{OnsetStatistics, RecordingEntry};
