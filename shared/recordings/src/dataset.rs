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
//! taken, but for the choice of where a gesture begins. [`cut`] gives the windows of a recording in passing, [`build`]
//! writes those of many.
//!
//! # What is written
//! | file | content |
//! |---|---|
//! | `windows.npy` | float32 `[n, channels, window]`, filtered or its envelope, in the recording's unit |
//! | `labels.npy` | uint8 `[n]`, class numbers of [`Gesture`] |
//! | `people.npy` | uint16 `[n]`, number of the person |
//! | `repetitions.npy` | uint8 `[n]`, the repetition counted through all sessions of the person: 0 to 3 in 3DC's `train`, 4 to 7 in its `test` |
//! | `recordings.npy` | uint32 `[n]`, the window's trial: its place in the manifest's `recordings` |
//! | `starts.npy` | uint32 `[n]`, the window's first sample within that trial, at the data set's rate |
//! | `splits.npy` | uint8 `[n]`, what the window is for: a [`Split`] |
//! | `manifest.json` | [`Manifest`]: settings, counts, and what became of each trial |
//!
//! While it is built, `progress.jsonl` tells which recordings are finished.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File};
use std::io;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_signal::{
    DesignError, EmgFilter, FilterSettings, OnsetSettings, WindowInput, WindowSettings, find_onset,
};

use crate::error::RecordingError;
use crate::labels::LabelsError;
use crate::npy::{Element, MappedArray, NpyWriter};
use crate::table::Channel;

mod cut;
mod journal;
mod listing;
mod ordered;
mod split;

pub use cut::{Cut, CutWindow, cut};
pub use listing::{Layout, Recording, Recordings, list};
pub use split::{GestureStatistics, Split, SplitEntry, SplitWindows, TrainingStatistics, VALIDATION_SHARE};

use cut::{Outcome, trials};
use journal::{Earlier, Finished, Journal, JournalError};

/// How windows are made. The defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatasetSettings {
    /// Which channels of the recordings, in order.
    pub channels: Vec<Channel>,
    /// Sampling rate of the recordings, in Hz, where they do not tell it.
    pub recording_rate_hz: Option<f64>,
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
            recording_rate_hz: None,
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
        if let Some(rate_hz) =
            self.recording_rate_hz.filter(|rate_hz| !(rate_hz.is_finite() && *rate_hz > 0.0))
        {
            return Err(DesignError::SampleRate(rate_hz));
        }
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
    /// Trials, rest not counted, in which no onset was found.
    pub fallbacks: u64,
    /// How onsets were found, by gesture, and over all as `total`: the paper's table of fallbacks.
    pub onsets: BTreeMap<String, OnsetStatistics>,
    /// What the windows are for.
    pub split: SplitEntry,
    /// What the windows for training hold.
    pub training_statistics: TrainingStatistics,
    /// Every trial that was used, in the order of the windows.
    pub recordings: Vec<RecordingEntry>,
    /// Everything that was not used.
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

/// How far [`build`] has come.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// It begins.
    Begun {
        /// Recordings in all.
        total: usize,
        /// Those that an earlier build had finished.
        resumed: usize,
        /// Their windows.
        windows: u64,
        /// Whether an earlier build had not come to its end, but was of other settings or recordings.
        is_other: bool,
    },
    /// A recording is finished.
    Recording {
        /// Recordings finished.
        done: usize,
        /// Recordings in all.
        total: usize,
        /// The file or folder of the one just finished.
        path: &'a Path,
        /// Windows so far.
        windows: u64,
    },
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
    /// Labels that cannot be used.
    #[error(transparent)]
    Labels(#[from] LabelsError),
    /// A path without recordings.
    #[error(
        "{}: no recordings found{hint}; give folders ParticipantP/train/EMG or ParticipantP/test/EMG (3DC), files \
         .mat or P<person>_C<cycle>_G<gesture>.csv (Ozdemir 2022), a folder with tables and a labels.csv, or a \
         folder above such",
        .path.display()
    )]
    NoRecordings {
        /// The path.
        path: PathBuf,
        /// What lies there instead, if anything, in brackets.
        hint: String,
    },
    /// Recordings of several data sets: their people, channels and units have nothing to do with each other.
    #[error(
        "{} is of the layout {layout}, but {} of {other}: build a data set of each",
        .first.display(), .second.display()
    )]
    SeveralLayouts {
        /// The first path.
        first: PathBuf,
        /// Its layout.
        layout: Layout,
        /// A path of another layout.
        second: PathBuf,
        /// That layout.
        other: Layout,
    },
    /// The same recording from two places.
    #[error("{what} is in {} and in {}: leave one of them out", .first.display(), .second.display())]
    Twice {
        /// What is there twice.
        what: String,
        /// The first place.
        first: PathBuf,
        /// The second.
        second: PathBuf,
    },
    /// Recordings that are to be filtered, but were already.
    #[error("{} lies in a folder `filtered`: give --filtered, or the recordings in `raw`", .file.display())]
    Filtered {
        /// The first such file.
        file: PathBuf,
    },
    /// Recordings that are not to be filtered, but should be.
    #[error(
        "{} lies in a folder `raw`: leave out --filtered, or give the recordings in `filtered`",
        .file.display()
    )]
    NotFiltered {
        /// The first such file.
        file: PathBuf,
    },
    /// Tables with labels, whose sampling rate was not given.
    #[error(
        "the files that {} names do not tell their sampling rate: give --recording-rate-hz, e.g. 2000",
        .labels.display()
    )]
    NoRate {
        /// The labels file.
        labels: PathBuf,
    },
    /// More repetitions than `repetitions.npy` can number.
    #[error(
        "the repetitions of person {person}, counted through all sessions, are more than 256: number them from 0 in \
         each session"
    )]
    TooManyRepetitions {
        /// The person.
        person: u16,
    },
    /// Somebody to hold out who is not there.
    #[error("there is no person {person} to hold out: choose among {}", list_of(.known))]
    UnknownTestPerson {
        /// The number asked for.
        person: u16,
        /// The people there are.
        known: Vec<u16>,
    },
    /// Everybody is held out.
    #[error("all people ({}) are held out: leave at least one to train on", list_of(.known))]
    EverybodyHeldOut {
        /// The people there are.
        known: Vec<u16>,
    },
    /// Two people who must stay together.
    #[error(
        "people {} and {} of 3DC share recordings (part of one's files are copies of the other's): hold out both or \
         neither",
        .people[0], .people[1]
    )]
    TwinsDivided {
        /// The two.
        people: [u16; 2],
    },
    /// All windows are held out.
    #[error(
        "nothing is left to train on: all windows are of those held out ({}); hold out fewer people",
        list_of(.test_people)
    )]
    NothingToTrain {
        /// The people held out.
        test_people: Vec<u16>,
    },
    /// The build was broken off.
    #[error("interrupted: the same command goes on where {} stands", .out_dir.display())]
    Interrupted {
        /// Folder of the data set.
        out_dir: PathBuf,
    },
    /// Another process builds there.
    #[error("another build is writing to {}: wait for it, or choose another folder", .out_dir.display())]
    InUse {
        /// Folder of the data set.
        out_dir: PathBuf,
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
        /// Recordings found.
        recordings: usize,
        /// Why the first one was left out.
        first_reason: String,
    },
}

/// How a data set is built from its settings and recordings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildSettings {
    /// People all of whose windows are for the test; nobody else's are.
    pub test_people: Vec<u16>,
    /// Seed of the choice of windows for validation.
    pub seed: u64,
    /// Recordings that are read at a time. The data set does not depend on it.
    pub threads: usize,
}

impl Default for BuildSettings {
    /// Nobody is held out; all processors, but no more than eight threads: each may hold a recording in memory.
    fn default() -> BuildSettings {
        let threads = std::thread::available_parallelism().map_or(1, NonZeroUsize::get).min(8);
        BuildSettings { test_people: Vec::new(), seed: 0, threads }
    }
}

/// Cuts the windows of all recordings that [`list`] finds at or below `paths` and writes the data set to `out_dir`,
/// which is created. Recordings that cannot be used are left out and listed in the manifest.
///
/// A build that was interrupted, by `progress` or by the end of the process, goes on where it stopped when it is
/// begun again with the same settings and recordings; with others, all of it is made anew. The data set is the same
/// to the byte either way.
///
/// # Errors
/// When [`list`] gives one, the settings do not fit, nothing is left to train on, `progress` breaks off, or the data
/// set cannot be written. The manifest is written last: a folder without it holds no complete data set.
pub fn build(
    settings: &DatasetSettings,
    building: &BuildSettings,
    paths: &[PathBuf],
    out_dir: &Path,
    progress: &mut dyn FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Manifest, DatasetError> {
    settings.check()?;
    let found = list(settings, paths)?;
    split::check_people(&building.test_people, found.layout, &found.recordings)?;
    let total = found.recordings.len();
    let (mut builder, is_other) = Builder::open(settings, &found, out_dir)?;
    let resumed = builder.finished;
    let begun = Progress::Begun { total, resumed, windows: builder.windows.rows(), is_other };
    let mut flow = progress(begun);
    let mut result = Ok(());
    if flow.is_continue() {
        let remaining: Vec<&Recording> = found.recordings[resumed..].iter().collect();
        ordered::in_order(
            building.threads,
            &remaining,
            |recording, give| {
                let given = trials(settings, recording, &mut |outcome| {
                    let bytes = match &outcome {
                        Outcome::Trial(trial) => trial.bytes(),
                        Outcome::Skipped(_) => 0,
                    };
                    give(Step::Outcome(outcome), bytes)
                });
                // Should the other side have broken off, nobody needs this.
                let notices = given.map(|(notices, _)| notices).map_err(|error| recording.skipped(&error));
                let _ = give(Step::End(notices), 0);
            },
            |step| match builder.take(step) {
                Ok(None) => ControlFlow::Continue(()),
                Ok(Some(done)) => {
                    let path = &found.recordings[done - 1].path;
                    flow =
                        progress(Progress::Recording { done, total, path, windows: builder.windows.rows() });
                    flow
                }
                Err(error) => {
                    result = Err(error);
                    ControlFlow::Break(())
                }
            },
        );
    }
    result?;
    if flow.is_break() {
        return Err(DatasetError::Interrupted { out_dir: out_dir.to_owned() });
    }
    builder.finish(building)
}

/// What a thread gives that cuts a recording.
enum Step {
    /// What became of a trial.
    Outcome(Outcome),
    /// The recording was read to its end, with these notices, or has to be left out whole.
    End(Result<Vec<String>, SkippedEntry>),
}

/// The data set being written.
struct Builder<'a> {
    settings: &'a DatasetSettings,
    out_dir: &'a Path,
    journal: Journal,
    windows: NpyWriter<f32>,
    /// Recordings that are finished.
    finished: usize,
    recordings: Vec<RecordingEntry>,
    skipped: Vec<SkippedEntry>,
    notices: Vec<String>,
    /// The recording whose trials are coming.
    current: Finished,
    /// A window.
    window: Vec<f32>,
}

impl<'a> Builder<'a> {
    /// Opens the data set in `out_dir` to go on with it, or begins it; and whether something else was found there
    /// that had not come to its end.
    fn open(
        settings: &'a DatasetSettings,
        found: &Recordings,
        out_dir: &'a Path,
    ) -> Result<(Builder<'a>, bool), DatasetError> {
        fs::create_dir_all(out_dir).map_err(write_error(out_dir))?;
        let (mut journal, earlier) =
            Journal::open(out_dir, settings, &found.recordings).map_err(|error| match error {
                JournalError::InUse => DatasetError::InUse { out_dir: out_dir.to_owned() },
                JournalError::Io(error) => write_error(&out_dir.join(journal::FILE_NAME))(error),
            })?;
        let manifest_path = out_dir.join(MANIFEST);
        match fs::remove_file(&manifest_path) {
            Err(reason) if reason.kind() != io::ErrorKind::NotFound => {
                return Err(write_error(&manifest_path)(reason));
            }
            _ => {}
        }
        let is_other = earlier == Earlier::Other;
        let mut earlier = match earlier {
            Earlier::Same(finished) => finished,
            Earlier::None | Earlier::Other => Vec::new(),
        };
        let windows_path = out_dir.join(WINDOWS);
        let row_shape = [settings.channels.len(), settings.windows.window_samples];
        let blocks: Vec<(u64, u32)> =
            earlier.iter().map(|finished| (finished.windows, finished.checksum)).collect();
        let (windows, whole) =
            NpyWriter::resume(&windows_path, &row_shape, &blocks).map_err(write_error(&windows_path))?;
        earlier.truncate(whole);
        journal.keep_recordings(whole).map_err(write_error(&out_dir.join(journal::FILE_NAME)))?;
        let mut builder = Builder {
            settings,
            out_dir,
            journal,
            windows,
            finished: 0,
            recordings: Vec::new(),
            skipped: found.skipped.clone(),
            notices: Vec::new(),
            current: Finished::default(),
            window: vec![0.0; row_shape.iter().product()],
        };
        for finished in earlier {
            builder.append(finished);
        }
        Ok((builder, is_other))
    }

    fn append(&mut self, finished: Finished) {
        self.finished += 1;
        self.recordings.extend(finished.trials);
        self.skipped.extend(finished.skipped);
        self.notices.extend(finished.notices);
    }

    /// Takes in the next step; `Some` with the recordings finished so far when it ends one.
    fn take(&mut self, step: Step) -> Result<Option<usize>, DatasetError> {
        let at_windows = |error| write_error(&self.out_dir.join(WINDOWS))(error);
        match step {
            Step::Outcome(Outcome::Skipped(skipped)) => {
                self.current.skipped.push(skipped);
                return Ok(None);
            }
            Step::Outcome(Outcome::Trial(trial)) => {
                let first_window = self.windows.rows();
                for start_sample in trial.entry.starts(&self.settings.windows) {
                    trial.copy_window(start_sample, &self.settings.windows, &mut self.window);
                    self.windows.write(&self.window).map_err(at_windows)?;
                }
                self.current.windows += trial.entry.windows;
                self.current.trials.push(RecordingEntry { first_window, ..trial.entry });
                return Ok(None);
            }
            Step::End(Ok(notices)) => self.current.notices = notices,
            Step::End(Err(skipped)) => {
                let before = self.windows.rows() - self.current.windows;
                self.windows.truncate(before).map_err(at_windows)?;
                self.current = Finished { skipped: vec![skipped], ..Finished::default() };
            }
        }
        self.current.checksum = self.windows.flush().map_err(at_windows)?;
        self.journal
            .push(&self.current)
            .map_err(|error| write_error(&self.out_dir.join(journal::FILE_NAME))(error))?;
        let finished = std::mem::take(&mut self.current);
        self.append(finished);
        Ok(Some(self.finished))
    }

    fn finish(self, building: &BuildSettings) -> Result<Manifest, DatasetError> {
        let Builder { settings, out_dir, journal, windows, recordings, skipped, notices, .. } = self;
        let count = windows.rows();
        if count == 0 {
            let first_reason = match skipped.first() {
                Some(skipped) => format!("{}: {}", skipped.path.display(), skipped.reason),
                None => "they hold no trials".to_owned(),
            };
            return Err(DatasetError::NoWindows { recordings: self.finished, first_reason });
        }
        let splits = split::splits(&recordings, &building.test_people, building.seed);
        let split = split::entry_of(&splits, &recordings, &building.test_people, building.seed);
        if split.windows.train == 0 {
            return Err(DatasetError::NothingToTrain { test_people: split.test_people });
        }
        let windows_path = out_dir.join(WINDOWS);
        windows.finish().map_err(write_error(&windows_path))?;
        let rows = || {
            recordings.iter().enumerate().flat_map(|(index, entry)| {
                entry.starts(&settings.windows).map(move |start| (index, entry, start))
            })
        };
        write_array(out_dir, LABELS, rows().map(|(_, entry, _)| entry.gesture as u8))?;
        write_array(out_dir, PEOPLE, rows().map(|(_, entry, _)| entry.person))?;
        write_array(out_dir, REPETITIONS, rows().map(|(_, entry, _)| entry.repetition_of_all))?;
        write_array(out_dir, RECORDINGS, rows().map(|(index, _, _)| index as u32))?;
        write_array(out_dir, STARTS, rows().map(|(_, _, start)| start as u32))?;
        write_array(out_dir, SPLITS, splits.iter().map(|&split| split as u8))?;
        let mut stored = MappedArray::open(&windows_path, 2)
            .map_err(|problem| write_error(&windows_path)(io::Error::other(problem)))?;
        let training_statistics = split::statistics(&mut stored, &splits, &recordings);

        let mut windows_per_gesture = BTreeMap::new();
        let mut windows_per_person = BTreeMap::new();
        for entry in &recordings {
            *windows_per_gesture.entry(entry.gesture.name().to_owned()).or_default() += entry.windows;
            *windows_per_person.entry(entry.person).or_default() += entry.windows;
        }
        let of_gesture = |gesture: Gesture| {
            let statistics = OnsetStatistics::of(recordings.iter().filter(|entry| entry.gesture == gesture));
            (gesture.name().to_owned(), statistics)
        };
        let total = ("total".to_owned(), OnsetStatistics::of(recordings.iter()));
        let manifest = Manifest {
            settings: settings.clone(),
            windows: count,
            windows_per_gesture,
            windows_per_person,
            fallbacks: recordings.iter().filter(|entry| entry.fallback).count() as u64,
            onsets: Gesture::ACTIVE.into_iter().map(of_gesture).chain([total]).collect(),
            split,
            training_statistics,
            recordings,
            skipped,
            notices,
        };
        let manifest_path = out_dir.join(MANIFEST);
        let write_manifest = || {
            let mut file = io::BufWriter::new(File::create(&manifest_path)?);
            serde_json::to_writer_pretty(&mut file, &manifest)?;
            io::Write::flush(&mut file)
        };
        write_manifest().map_err(write_error(&manifest_path))?;
        journal.remove(out_dir).map_err(write_error(&out_dir.join(journal::FILE_NAME)))?;
        Ok(manifest)
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
pub(crate) const SPLITS: &str = "splits.npy";
pub(crate) const MANIFEST: &str = "manifest.json";

fn list_of(people: &[u16]) -> String {
    people.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> DatasetError + '_ {
    |reason| DatasetError::Write { path: path.to_owned(), reason }
}
