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
//! | `windows.npy` | float32 `[n, channels, window]`, filtered, in the recording's unit |
//! | `labels.npy` | uint8 `[n]`, class numbers of [`Gesture`] |
//! | `people.npy` | uint16 `[n]`, the number P of the folder `ParticipantP` |
//! | `repetitions.npy` | uint8 `[n]`, 0 to 3 in `train`, 4 to 7 in `test` |
//! | `manifest.json` | [`Manifest`]: settings, counts, and what became of each file |

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_signal::{DesignError, EmgFilter, FilterSettings, OnsetSettings, WindowSettings, find_onset};

use crate::error::RecordingError;
use crate::npy::NpyWriter;
use crate::replay::ReplayStream;
use crate::source::{RecordingSettings, Segment, check};
use crate::table::Channel;
use crate::three_dc;

/// How windows are made. The defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DatasetSettings {
    /// Which channels of the recordings, in order.
    pub channels: Vec<Channel>,
    /// Sampling rate of the windows, in Hz: the session's.
    pub sample_rate_hz: f64,
    /// The session's filter.
    pub filter: FilterSettings,
    /// Length and distance of the windows.
    pub windows: WindowSettings,
    /// How the start of a movement is found.
    pub onset: OnsetSettings,
    /// Where a gesture is taken to begin if no onset is found, in ms from the cue.
    pub fallback_ms: f64,
    /// How much of the start of rest is left out, in ms: the movement before it dies away.
    pub rest_start_ms: f64,
}

impl Default for DatasetSettings {
    fn default() -> DatasetSettings {
        DatasetSettings {
            channels: [0, 3, 5, 8].map(Channel::Index).to_vec(),
            sample_rate_hz: 2000.0,
            filter: FilterSettings::default(),
            windows: WindowSettings::default(),
            onset: OnsetSettings::default(),
            fallback_ms: 500.0,
            rest_start_ms: 500.0,
        }
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
    /// Every file that was used, in the order of the windows.
    pub files: Vec<FileEntry>,
    /// Every file or repetition that was not used.
    pub skipped: Vec<SkippedEntry>,
    /// What the user should know about the recordings.
    pub notices: Vec<String>,
}

/// A file that windows were cut from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FileEntry {
    /// The file.
    pub file: PathBuf,
    /// Number of the person.
    pub person: u16,
    /// `train` or `test`.
    pub session: String,
    /// Repetition within the session, 0 to 3.
    pub repetition: u32,
    /// What the person was asked to do.
    pub gesture: Gesture,
    /// Samples of the file at the data set's rate.
    pub samples: usize,
    /// Where the movement begins, margin included; `null` for rest and where none was found.
    pub onset_sample: Option<usize>,
    /// Whether the fixed cut-off stands in for an onset that was not found.
    pub fallback: bool,
    /// Index of its first window in the arrays.
    pub first_window: u64,
    /// Its windows.
    pub windows: u64,
}

/// A file, or a whole repetition, that was left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkippedEntry {
    /// The file, or the folder of the repetition.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

/// How far [`build`] has come: told after each repetition.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Repetitions done.
    pub done: usize,
    /// Repetitions in all.
    pub total: usize,
    /// Folder of the repetition just done.
    pub folder: &'a Path,
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

/// Whose recording it is and when it was made.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Origin {
    person: u16,
    session: Session,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Session {
    Train,
    Test,
}

impl Session {
    fn name(self) -> &'static str {
        match self {
            Session::Train => "train",
            Session::Test => "test",
        }
    }

    /// The repetition counted through both sessions, each of which has four.
    fn repetition_of_both(self, repetition: u32) -> u8 {
        let before = match self {
            Session::Train => 0,
            Session::Test => 4,
        };
        u8::try_from(before + repetition).unwrap_or(u8::MAX)
    }
}

impl Origin {
    /// Reads person and session from `…/ParticipantP/{train,test}/EMG`.
    fn of_folder(folder: &Path) -> Option<Origin> {
        let session_folder = folder.parent()?;
        let session = match session_folder.file_name()?.to_str()? {
            "train" => Session::Train,
            "test" => Session::Test,
            _ => return None,
        };
        let person =
            session_folder.parent()?.file_name()?.to_str()?.strip_prefix("Participant")?.parse().ok()?;
        Some(Origin { person, session })
    }
}

/// Cuts the windows of all `recordings`, 3DC folders `ParticipantP/{train,test}/EMG`, and writes the data set
/// to `out_dir`, which is created. Recordings that cannot be used are left out and listed in the manifest.
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
    let mut repetitions = Vec::new();
    for folder in recordings {
        let origin =
            Origin::of_folder(folder).ok_or_else(|| DatasetError::Unplaced { folder: folder.clone() })?;
        for repetition in three_dc::repetitions(folder)? {
            repetitions.push((folder, origin.clone(), repetition));
        }
    }
    let mut builder = Builder::create(settings, out_dir)?;
    for (index, (folder, origin, repetition)) in repetitions.iter().enumerate() {
        builder.add_repetition(folder, origin, *repetition)?;
        let windows = builder.manifest.windows;
        progress(Progress { done: index + 1, total: repetitions.len(), folder, windows });
    }
    if builder.manifest.windows == 0 {
        let first_reason = match builder.manifest.skipped.first() {
            Some(skipped) => format!("{}: {}", skipped.path.display(), skipped.reason),
            None => "the folders hold no files 3dc_EMG_gesture_R_G.txt".to_owned(),
        };
        return Err(DatasetError::NoWindows { recordings: recordings.len(), first_reason });
    }
    builder.finish()
}

/// The data set being written.
struct Builder<'a> {
    settings: &'a DatasetSettings,
    out_dir: &'a Path,
    windows: NpyWriter<f32>,
    labels: NpyWriter<u8>,
    people: NpyWriter<u16>,
    repetitions: NpyWriter<u8>,
    manifest: Manifest,
}

impl<'a> Builder<'a> {
    fn create(settings: &'a DatasetSettings, out_dir: &'a Path) -> Result<Builder<'a>, DatasetError> {
        let channels = settings.channels.len();
        let WindowSettings { window_samples, increment_samples } = settings.windows;
        // What would otherwise only show at the first recording, as a reason to skip it.
        EmgFilter::new(&settings.filter, channels, settings.sample_rate_hz)?;
        find_onset(&settings.onset, &[], channels, settings.sample_rate_hz)?;
        for (setting, samples, example) in
            [("window_samples", window_samples, 600), ("increment_samples", increment_samples, 150)]
        {
            if samples == 0 {
                return Err(DesignError::NoSamples { setting, example }.into());
            }
        }
        for (setting, value) in
            [("fallback_ms", settings.fallback_ms), ("rest_start_ms", settings.rest_start_ms)]
        {
            if !(value.is_finite() && value >= 0.0) {
                return Err(DesignError::Duration { setting, value, example: 500.0 }.into());
            }
        }

        fs::create_dir_all(out_dir).map_err(write_error(out_dir))?;
        let manifest_path = out_dir.join(MANIFEST);
        match fs::remove_file(&manifest_path) {
            Err(reason) if reason.kind() != io::ErrorKind::NotFound => {
                return Err(write_error(&manifest_path)(reason));
            }
            _ => {}
        }
        let path = |name| out_dir.join(name);
        Ok(Builder {
            settings,
            out_dir,
            windows: NpyWriter::create(&path(WINDOWS), &[channels, window_samples])
                .map_err(write_error(&path(WINDOWS)))?,
            labels: NpyWriter::create(&path(LABELS), &[]).map_err(write_error(&path(LABELS)))?,
            people: NpyWriter::create(&path(PEOPLE), &[]).map_err(write_error(&path(PEOPLE)))?,
            repetitions: NpyWriter::create(&path(REPETITIONS), &[])
                .map_err(write_error(&path(REPETITIONS)))?,
            manifest: Manifest {
                settings: settings.clone(),
                windows: 0,
                windows_per_gesture: BTreeMap::new(),
                windows_per_person: BTreeMap::new(),
                fallbacks: 0,
                files: Vec::new(),
                skipped: Vec::new(),
                notices: Vec::new(),
            },
        })
    }

    /// Adds the windows of one repetition; a repetition with anything wrong is skipped whole.
    fn add_repetition(
        &mut self,
        folder: &Path,
        origin: &Origin,
        repetition: u32,
    ) -> Result<(), DatasetError> {
        let settings = RecordingSettings {
            channels: self.settings.channels.clone(),
            sample_rate_hz: None,
            repetition: Some(repetition),
        };
        let summary = match check(folder, &settings) {
            Ok(summary) => summary,
            Err(error) => {
                let reason = format!("repetition {repetition}: {error}");
                self.manifest.skipped.push(SkippedEntry { path: folder.to_owned(), reason });
                return Ok(());
            }
        };
        self.manifest.notices.extend(summary.notices.iter().map(ToString::to_string));

        let channels = self.settings.channels.len();
        let rate_hz = self.settings.sample_rate_hz;
        let mut filter = EmgFilter::new(&self.settings.filter, channels, rate_hz)?;
        let mut stream = ReplayStream::open(folder, &settings, rate_hz, 1)?;
        let segments = stream.source().segments().to_vec();
        let mut frame = vec![0.0; channels];
        let mut signal: Vec<Vec<f32>> = vec![Vec::new(); channels];
        let mut segment = 0;
        loop {
            let block = stream.next_block(&mut frame)?;
            if block.is_none_or(|block| block.segment != segment) {
                let mut replaced_samples = 0;
                for (channel, samples) in signal.iter_mut().enumerate() {
                    replaced_samples += filter.process(channel, samples);
                }
                self.add_segment(origin, &segments[segment], &signal.concat(), replaced_samples)?;
                signal.iter_mut().for_each(Vec::clear);
            }
            let Some(block) = block else { return Ok(()) };
            segment = block.segment;
            for (samples, &sample) in signal.iter_mut().zip(&frame) {
                samples.push(sample);
            }
        }
    }

    /// Adds the windows of one file; `signal` is filtered, `[channels × samples]`.
    fn add_segment(
        &mut self,
        origin: &Origin,
        segment: &Segment,
        signal: &[f32],
        replaced_samples: u32,
    ) -> Result<(), DatasetError> {
        let (Some(gesture), Some((repetition, _))) = (segment.cue, segment.three_dc) else {
            self.skip(segment, "its gesture is none of the six".to_owned());
            return Ok(());
        };
        if replaced_samples > 0 {
            self.skip(segment, format!("{replaced_samples} samples are beyond what any amplifier gives"));
            return Ok(());
        }
        let channels = self.settings.channels.len();
        let rate_hz = self.settings.sample_rate_hz;
        let samples = signal.len() / channels;
        let samples_of_ms = |ms: f64| (ms * 1e-3 * rate_hz).round() as usize;
        let (onset_sample, start) = match gesture {
            Gesture::Rest => (None, samples_of_ms(self.settings.rest_start_ms)),
            _ => {
                let onset = find_onset(&self.settings.onset, signal, channels, rate_hz)?;
                (onset, onset.unwrap_or(samples_of_ms(self.settings.fallback_ms)))
            }
        };
        let WindowSettings { window_samples, increment_samples } = self.settings.windows;
        let first_window = self.manifest.windows;
        let mut first = start;
        while first.saturating_add(window_samples) <= samples {
            for channel in signal.chunks_exact(samples) {
                self.windows
                    .write(&channel[first..first + window_samples])
                    .map_err(write_error(&self.out_dir.join(WINDOWS)))?;
            }
            self.labels.write(&[gesture as u8]).map_err(write_error(&self.out_dir.join(LABELS)))?;
            self.people.write(&[origin.person]).map_err(write_error(&self.out_dir.join(PEOPLE)))?;
            self.repetitions
                .write(&[origin.session.repetition_of_both(repetition)])
                .map_err(write_error(&self.out_dir.join(REPETITIONS)))?;
            self.manifest.windows += 1;
            first = first.saturating_add(increment_samples);
        }
        let windows = self.manifest.windows - first_window;
        if windows == 0 {
            let left = samples.saturating_sub(start);
            let reason =
                format!("{left} samples after the start of the gesture, a window has {window_samples}");
            self.skip(segment, reason);
            return Ok(());
        }
        let fallback = gesture != Gesture::Rest && onset_sample.is_none();
        self.manifest.fallbacks += u64::from(fallback);
        *self.manifest.windows_per_gesture.entry(gesture.name().to_owned()).or_default() += windows;
        *self.manifest.windows_per_person.entry(origin.person).or_default() += windows;
        self.manifest.files.push(FileEntry {
            file: segment.file.clone(),
            person: origin.person,
            session: origin.session.name().to_owned(),
            repetition,
            gesture,
            samples,
            onset_sample,
            fallback,
            first_window,
            windows,
        });
        Ok(())
    }

    fn skip(&mut self, segment: &Segment, reason: String) {
        self.manifest.skipped.push(SkippedEntry { path: segment.file.clone(), reason });
    }

    fn finish(self) -> Result<Manifest, DatasetError> {
        let path = |name| self.out_dir.join(name);
        self.windows.finish().map_err(write_error(&path(WINDOWS)))?;
        self.labels.finish().map_err(write_error(&path(LABELS)))?;
        self.people.finish().map_err(write_error(&path(PEOPLE)))?;
        self.repetitions.finish().map_err(write_error(&path(REPETITIONS)))?;
        let manifest_path = path(MANIFEST);
        let write_manifest = || {
            let mut file = io::BufWriter::new(File::create(&manifest_path)?);
            serde_json::to_writer_pretty(&mut file, &self.manifest)?;
            io::Write::flush(&mut file)
        };
        write_manifest().map_err(write_error(&manifest_path))?;
        Ok(self.manifest)
    }
}

const WINDOWS: &str = "windows.npy";
const LABELS: &str = "labels.npy";
const PEOPLE: &str = "people.npy";
const REPETITIONS: &str = "repetitions.npy";
const MANIFEST: &str = "manifest.json";

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> DatasetError + '_ {
    |reason| DatasetError::Write { path: path.to_owned(), reason }
}
