//! What the supervisor and the recorder say to each other, a line of JSON each.
//!
//! ```text
//! tendon run ── Told: start, ready, event, task ──▶ standard input of tendon-recorder; its end means: finish the file
//!            ◀── Said: ready, ended ───────── standard output
//! ```

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tendon_provenance::Provenance;

/// What a recording begins with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RecordingStart {
    /// Program, machine, settings, models.
    pub provenance: Provenance,
    /// Models and person: the name of the attachment, and the file.
    pub files: BTreeMap<String, PathBuf>,
}

/// What the recorder is told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Told {
    /// What to write first.
    Start(Box<RecordingStart>),
    /// What the stages said when they were ready, by name.
    Ready(serde_json::Value),
    /// How the task of the session went, as its report says it; the last that is told.
    Task(serde_json::Value),
    /// Something unusual happened in the session.
    Event(String),
}

/// What came of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingReport {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Messages that the recorder was too slow for, by topic; only those of which there are any.
    pub lost: BTreeMap<String, u64>,
    /// Why it ended before the session or the key; `null` otherwise.
    pub error: Option<String>,
}

/// What the recorder says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// It records to this file: all topics are open, and nothing of them is missed from now on.
    Ready(PathBuf),
    /// The file is closed.
    Ended(RecordingReport),
}
