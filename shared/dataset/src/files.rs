//! Names of the files of a data set.

pub(crate) const WINDOWS: &str = "windows.npy";
pub(crate) const LABELS: &str = "labels.npy";
pub(crate) const PEOPLE: &str = "people.npy";
pub(crate) const REPETITIONS: &str = "repetitions.npy";
pub(crate) const RECORDINGS: &str = "recordings.npy";
pub(crate) const STARTS: &str = "starts.npy";
pub(crate) const SPLITS: &str = "splits.npy";
pub(crate) const MANIFEST: &str = "manifest.json";
/// What a build has finished so far; gone once the data set is complete.
pub(crate) const PROGRESS: &str = "progress.jsonl";

/// All that a data set consists of, finished or not.
pub const ALL: [&str; 9] =
    [WINDOWS, LABELS, PEOPLE, REPETITIONS, RECORDINGS, STARTS, SPLITS, MANIFEST, PROGRESS];
