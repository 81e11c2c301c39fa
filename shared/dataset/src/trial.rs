//! The trials that windows are cut from, and how their onsets were found.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_signal::WindowSettings;

/// A trial that windows were cut from: a file, or a part of one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingEntry {
    /// The file.
    pub file: PathBuf,
    /// Whose it is.
    pub person: PersonId,
    /// When it was made: `train` or `test` of 3DC.
    pub session: String,
    /// Repetition within the session.
    pub repetition: u32,
    /// Repetition counted through all sessions of the person, as in `repetitions.npy`.
    pub repetition_of_all: u8,
    /// What the person was asked to do.
    pub gesture: Gesture,
    /// Rate that samples are counted at, Hz: the data set's.
    pub sample_rate_hz: f64,
    /// Where the trial begins within its file, at that rate: 0 if it is the whole file.
    pub first_sample: u64,
    /// Samples of the trial at that rate.
    pub samples: usize,
    /// Where within the trial the movement begins; `null` for rest and where none was found.
    pub onset_sample: Option<usize>,
    /// Where within the trial the first window begins: the margin before the onset, the fixed cut-off, or where rest has settled.
    pub start_sample: usize,
    /// Whether the fixed cut-off stands in for an onset that was not found.
    pub fallback: bool,
    /// Index of its first window in the arrays.
    pub first_window: u64,
    /// Its windows.
    pub windows: u64,
}

impl RecordingEntry {
    /// Where within the trial its windows begin.
    pub(crate) fn starts(&self, windows: &WindowSettings) -> impl Iterator<Item = usize> + use<> {
        (self.start_sample..).step_by(windows.increment_samples).take(self.windows as usize)
    }
}

/// How onsets were found. Times are from the cue to the onset itself, without the margin, in ms; 0 of none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OnsetStatistics {
    /// Recordings of a movement.
    pub recordings: u64,
    /// Those without an onset.
    pub fallbacks: u64,
    /// Their share, in percent.
    pub fallback_percent: f64,
    /// Mean onset.
    pub mean_ms: f64,
    /// Standard deviation (of the sample).
    pub sd_ms: f64,
    /// Earliest onset.
    pub min_ms: f64,
    /// Latest onset.
    pub max_ms: f64,
}

impl OnsetStatistics {
    pub(crate) fn of<'a>(recordings: impl Iterator<Item = &'a RecordingEntry>) -> OnsetStatistics {
        let mut statistics = OnsetStatistics::default();
        let mut onsets_ms = Vec::new();
        for entry in recordings.filter(|entry| entry.gesture != Gesture::REST) {
            statistics.recordings += 1;
            statistics.fallbacks += u64::from(entry.fallback);
            onsets_ms.extend(entry.onset_sample.map(|onset| onset as f64 * 1e3 / entry.sample_rate_hz));
        }
        let count = onsets_ms.len() as f64;
        if !onsets_ms.is_empty() {
            statistics.mean_ms = onsets_ms.iter().sum::<f64>() / count;
            statistics.min_ms = onsets_ms.iter().copied().fold(f64::INFINITY, f64::min);
            statistics.max_ms = onsets_ms.iter().copied().fold(0.0, f64::max);
        }
        if onsets_ms.len() > 1 {
            let squares: f64 = onsets_ms.iter().map(|onset| (onset - statistics.mean_ms).powi(2)).sum();
            statistics.sd_ms = (squares / (count - 1.0)).sqrt();
        }
        if statistics.recordings > 0 {
            statistics.fallback_percent = 100.0 * statistics.fallbacks as f64 / statistics.recordings as f64;
        }
        statistics
    }
}
