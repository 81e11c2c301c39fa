//! What is not scored or calibrated on, and why.

use std::fmt;

use serde::{Serialize, Serializer};
use tendon_dataset::Cut;
use tendon_recordings::{SkippedEntry, SkippedKind};

/// A recording, a trial or a person that was left out. In JSON, its reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOut {
    /// What it is, to sum it up by.
    pub kind: SkippedKind,
    /// What was left out and why, in words.
    pub reason: String,
}

impl LeftOut {
    /// A person.
    pub fn person(reason: String) -> LeftOut {
        LeftOut { kind: SkippedKind::Person, reason }
    }

    /// Something about a recording that was used all the same.
    pub(crate) fn notice(reason: String) -> LeftOut {
        LeftOut { kind: SkippedKind::Notice, reason }
    }
}

impl From<&SkippedEntry> for LeftOut {
    fn from(skipped: &SkippedEntry) -> LeftOut {
        LeftOut { kind: skipped.kind, reason: skipped.to_string() }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.reason)
    }
}

impl Serialize for LeftOut {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.reason)
    }
}

/// What was left out of a recording that was cut, and the words about it.
pub(crate) fn left_out_of(cut: &Cut) -> impl Iterator<Item = LeftOut> {
    let notices = cut.notices.iter().map(|notice| LeftOut::notice(notice.clone()));
    cut.skipped.iter().map(LeftOut::from).chain(notices)
}
