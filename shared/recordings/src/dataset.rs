//! Windows to train on, cut from 3DC recordings by the code that runs live.
//!
//! ```text
//! repetition ─▶ replay at the session's rate ─▶ filter, causal and without a break over the whole repetition
//!
//! file of a gesture  |~~ rest ~~|margin|═══════════════ gesture ═══════════════|
//!                               ▲ onset (or a fixed cut-off if none is found)
//! windows                       [──────]  [──────]
//!                                  [──────]  …  each wholly between the onset and the end of the file
//! ```
//! The classifier sees live just such windows: the filter has been running, and no look into the future is
//! taken, but for the choice of where a gesture begins.
//!
//! # What is written
//! | file | content |
//! |---|---|
//! | `windows.npy` | float32 `[n, channels, window]`, filtered or its envelope, in the recording's unit |
//! | `labels.npy` | uint8 `[n]`, class numbers of [`Gesture`] |
//! | `people.npy` | uint16 `[n]`, the number P of the folder `ParticipantP` |
//! | `repetitions.npy` | uint8 `[n]`, 0 to 3 in `train`, 4 to 7 in `test` |
//! | `recordings.npy` | uint32 `[n]`, the window's recording: its place in the manifest's `recordings` |
//! | `starts.npy` | uint32 `[n]`, the window's first sample within that recording, at the data set's rate |
//! | `manifest.json` | [`Manifest`]: settings, counts, and what became of each file |

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File};
use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_signal::{
    DesignError, EmgFilter, FilterSettings, OnsetSettings, WindowInput, WindowSettings, find_onset,
};

use crate::error::RecordingError;
use crate::npy::{Element, NpyWriter};
use crate::table::Channel;

mod cut;
mod listing;

pub use cut::{Cut, CutWindow, cut};
pub use listing::{Recording, Recordings, list};

use cut::{Outcome, Trial, trials};

/// How windows are made. The defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatasetSettings {
    /// Which channels of the recordings, in order.
    pub channels: Vec<Channel>,
    /// Sampling rate of the windows, in Hz: the session's.
    pub sample_rate_hz: f64,
    /// The session's filter; `null` for recordings that are filtered already.
    pub filter: Option<FilterSettings>,
    /// What the windows hold.
    pub input: WindowInput,
    /// Length and distance of the windows.
    pub windows: WindowSettings,
    /// How the start of a movement is found.
    pub onset: OnsetSettings,
    /// Where a gesture is taken to begin if no onset is found, in ms from the cue; 0 keeps the whole recording.
    pub fallback_ms: f64,
    /// How much of the start of rest is left out, in ms: the movement before it dies away.
    pub rest_start_ms: f64,
}

impl Default for DatasetSettings {
    fn default() -> DatasetSettings {
        DatasetSettings {
            channels: [0, 3, 5, 8].map(Channel::Index).to_vec(),
            sample_rate_hz: 2000.0,
            filter: Some(FilterSettings::default()),
            input: WindowInput::Raw,
            windows: WindowSettings::default(),
            onset: OnsetSettings::default(),
            fallback_ms: 500.0,
            rest_start_ms: 500.0,
        }
    }
}

impl DatasetSettings {
    /// What would otherwise only show at the first recording, as a reason to leave it out.
    fn check(&self) -> Result<(), DesignError> {
        let channels = self.channels.len();
        if let Some(filter) = &self.filter {
            EmgFilter::new(filter, channels, self.sample_rate_hz)?;
        }
        find_onset(&self.onset, &[], channels, self.sample_rate_hz)?;
        let WindowSettings { window_samples, increment_samples } = self.windows;
        for (setting, samples, example) in
            [("window_samples", window_samples, 600), ("increment_samples", increment_samples, 150)]
        {
            if samples == 0 {
                return Err(DesignError::NoSamples { setting, example });
            }
        }
        for (setting, value) in [("fallback_ms", self.fallback_ms), ("rest_start_ms", self.rest_start_ms)] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(DesignError::Duration { setting, value, example: 500.0 });
            }
        }
        Ok(())
    }
}

/// What was made of which recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The settings it was made with.
    pub settings: DatasetSettings,
    /// Windows in all.
    pub windows: u64,
    /// Windows of each gesture, by name.
    pub windows_per_gesture: BTreeMap<String, u64>,
    /// Windows of each person, by number.
    pub windows_per_person: BTreeMap<u16, u64>,
    /// Gesture files, rest not counted, in which no onset was found.
    pub fallbacks: u64,
    /// How onsets were found, by gesture, and over all as `total`: the paper's table of fallbacks.
    pub onsets: BTreeMap<String, OnsetStatistics>,
    /// Every file that was used, in the order of the windows.
    pub recordings: Vec<RecordingEntry>,
    /// Every file or repetition that was not used.
    pub skipped: Vec<SkippedEntry>,
    /// What the user should know about the recordings.
    pub notices: Vec<String>,
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
    fn of<'a>(recordings: impl Iterator<Item = &'a RecordingEntry>) -> OnsetStatistics {
        let mut statistics = OnsetStatistics::default();
        let mut onsets_ms = Vec::new();
        for entry in recordings.filter(|entry| entry.gesture != Gesture::Rest) {
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

/// A trial that windows were cut from: a file, or a part of one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingEntry {
    /// The file.
    pub file: PathBuf,
    /// Number of the person.
    pub person: u16,
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

/// A file, a part of one, or a whole recording that was left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkippedEntry {
    /// The file, or the folder of the recording.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

impl fmt::Display for SkippedEntry {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.path.display(), self.reason)
    }
}

/// How far [`build`] has come: told after each recording.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Recordings done.
    pub done: usize,
    /// Recordings in all.
    pub total: usize,
    /// The file or folder of the recording just done.
    pub path: &'a Path,
    /// Windows so far.
    pub windows: u64,
}

/// Why no data set could be built.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A folder that cannot be listed.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Settings that do not fit.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// A path that is not `ParticipantP/{train,test}/EMG`.
    #[error(
        "{} does not tell its person and session: give folders ParticipantP/train/EMG or ParticipantP/test/EMG \
         with 3DC recordings",
        .folder.display()
    )]
    Unplaced {
        /// The path.
        folder: PathBuf,
    },
    /// A file of the data set that cannot be written.
    #[error("cannot write {}: {reason}; check that there is room and that you may write there", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// Not a single window.
    #[error(
        "no window could be cut from {recordings} recordings; the first was left out because: {first_reason}"
    )]
    NoWindows {
        /// Folders given.
        recordings: usize,
        /// Why the first file was skipped.
        first_reason: String,
    },
}

/// Cuts the windows of all `recordings`, 3DC folders `ParticipantP/{train,test}/EMG` or folders above such, and
/// writes the data set to `out_dir`, which is created. Recordings that cannot be used are left out and listed in the
/// manifest.
///
/// # Errors
/// When a path is no such folder, the settings do not fit, or the data set cannot be written. The manifest is
/// written last: a folder without it holds no complete data set.
pub fn build(
    settings: &DatasetSettings,
    recordings: &[PathBuf],
    out_dir: &Path,
    progress: &mut dyn FnMut(Progress<'_>),
) -> Result<Manifest, DatasetError> {
    settings.check()?;
    let found = list(recordings)?;
    let mut builder = Builder::create(settings, out_dir)?;
    builder.manifest.skipped = found.skipped;
    let total = found.recordings.len();
    for (index, recording) in found.recordings.iter().enumerate() {
        builder.add(recording)?;
        let windows = builder.manifest.windows;
        progress(Progress { done: index + 1, total, path: &recording.path, windows });
    }
    if builder.manifest.windows == 0 {
        let first_reason = match builder.manifest.skipped.first() {
            Some(skipped) => format!("{}: {}", skipped.path.display(), skipped.reason),
            None => "the folders hold no files 3dc_EMG_gesture_R_G.txt".to_owned(),
        };
        return Err(DatasetError::NoWindows { recordings: total, first_reason });
    }
    builder.finish()
}

/// The data set being written.
struct Builder<'a> {
    settings: &'a DatasetSettings,
    out_dir: &'a Path,
    windows: NpyWriter<f32>,
    manifest: Manifest,
}

impl<'a> Builder<'a> {
    fn create(settings: &'a DatasetSettings, out_dir: &'a Path) -> Result<Builder<'a>, DatasetError> {
        fs::create_dir_all(out_dir).map_err(write_error(out_dir))?;
        let manifest_path = out_dir.join(MANIFEST);
        match fs::remove_file(&manifest_path) {
            Err(reason) if reason.kind() != io::ErrorKind::NotFound => {
                return Err(write_error(&manifest_path)(reason));
            }
            _ => {}
        }
        let windows_path = out_dir.join(WINDOWS);
        let row_shape = [settings.channels.len(), settings.windows.window_samples];
        Ok(Builder {
            settings,
            out_dir,
            windows: NpyWriter::create(&windows_path, &row_shape).map_err(write_error(&windows_path))?,
            manifest: Manifest {
                settings: settings.clone(),
                windows: 0,
                windows_per_gesture: BTreeMap::new(),
                windows_per_person: BTreeMap::new(),
                fallbacks: 0,
                onsets: BTreeMap::new(),
                recordings: Vec::new(),
                skipped: Vec::new(),
                notices: Vec::new(),
            },
        })
    }

    /// Adds the windows of one recording; one that cannot be read to its end is left out whole.
    fn add(&mut self, recording: &Recording) -> Result<(), DatasetError> {
        let (mut used, mut skipped) = (Vec::new(), Vec::new());
        let mut window = vec![0.0; self.settings.channels.len() * self.settings.windows.window_samples];
        let first_window = self.manifest.windows;
        let mut written = Ok(());
        let result = trials(self.settings, recording, &mut |outcome| {
            match outcome {
                Outcome::Skipped(entry) => skipped.push(entry),
                Outcome::Trial(trial) => {
                    written = self.write(&trial, &mut window);
                    if written.is_err() {
                        return ControlFlow::Break(());
                    }
                    used.push(RecordingEntry {
                        first_window: self.manifest.windows - trial.entry.windows,
                        ..trial.entry
                    });
                }
            }
            ControlFlow::Continue(())
        });
        written.map_err(write_error(&self.out_dir.join(WINDOWS)))?;
        match result {
            Ok(notices) => {
                self.manifest.recordings.extend(used);
                self.manifest.skipped.extend(skipped);
                self.manifest.notices.extend(notices);
            }
            Err(error) => {
                self.windows.truncate(first_window).map_err(write_error(&self.out_dir.join(WINDOWS)))?;
                self.manifest.windows = first_window;
                self.manifest.skipped.push(recording.skipped(&error));
            }
        }
        Ok(())
    }

    fn write(&mut self, trial: &Trial, window: &mut [f32]) -> io::Result<()> {
        for start_sample in trial.entry.starts(&self.settings.windows) {
            trial.copy_window(start_sample, &self.settings.windows, window);
            self.windows.write(window)?;
            self.manifest.windows += 1;
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Manifest, DatasetError> {
        let manifest = &mut self.manifest;
        for entry in &manifest.recordings {
            manifest.fallbacks += u64::from(entry.fallback);
            *manifest.windows_per_gesture.entry(entry.gesture.name().to_owned()).or_default() +=
                entry.windows;
            *manifest.windows_per_person.entry(entry.person).or_default() += entry.windows;
        }
        let recordings = &manifest.recordings;
        let of_gesture = |gesture: Gesture| {
            let statistics = OnsetStatistics::of(recordings.iter().filter(|entry| entry.gesture == gesture));
            (gesture.name().to_owned(), statistics)
        };
        let total = ("total".to_owned(), OnsetStatistics::of(recordings.iter()));
        manifest.onsets = Gesture::ACTIVE.into_iter().map(of_gesture).chain([total]).collect();

        self.windows.finish().map_err(write_error(&self.out_dir.join(WINDOWS)))?;
        let rows = || {
            let windows = &self.settings.windows;
            recordings
                .iter()
                .enumerate()
                .flat_map(|(index, entry)| entry.starts(windows).map(move |start| (index, entry, start)))
        };
        write_array(self.out_dir, LABELS, rows().map(|(_, entry, _)| entry.gesture as u8))?;
        write_array(self.out_dir, PEOPLE, rows().map(|(_, entry, _)| entry.person))?;
        write_array(self.out_dir, REPETITIONS, rows().map(|(_, entry, _)| entry.repetition_of_all))?;
        write_array(self.out_dir, RECORDINGS, rows().map(|(index, _, _)| index as u32))?;
        write_array(self.out_dir, STARTS, rows().map(|(_, _, start)| start as u32))?;
        let manifest_path = self.out_dir.join(MANIFEST);
        let write_manifest = || {
            let mut file = io::BufWriter::new(File::create(&manifest_path)?);
            serde_json::to_writer_pretty(&mut file, &self.manifest)?;
            io::Write::flush(&mut file)
        };
        write_manifest().map_err(write_error(&manifest_path))?;
        Ok(self.manifest)
    }
}

/// Writes an array of single values.
fn write_array<T: Element>(
    folder: &Path,
    name: &str,
    values: impl Iterator<Item = T>,
) -> Result<(), DatasetError> {
    let path = folder.join(name);
    let write = || {
        let mut writer = NpyWriter::create(&path, &[])?;
        for value in values {
            writer.write(&[value])?;
        }
        writer.finish()
    };
    write().map_err(write_error(&path))
}

pub(crate) const WINDOWS: &str = "windows.npy";
pub(crate) const LABELS: &str = "labels.npy";
pub(crate) const PEOPLE: &str = "people.npy";
pub(crate) const REPETITIONS: &str = "repetitions.npy";
pub(crate) const RECORDINGS: &str = "recordings.npy";
pub(crate) const STARTS: &str = "starts.npy";
pub(crate) const MANIFEST: &str = "manifest.json";

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> DatasetError + '_ {
    |reason| DatasetError::Write { path: path.to_owned(), reason }
}
