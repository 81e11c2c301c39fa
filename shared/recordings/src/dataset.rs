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
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_signal::{
    DesignError, EmgFilter, Envelope, FilterSettings, OnsetSettings, WindowInput, WindowSettings, find_onset,
};

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

/// A file that windows were cut from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingEntry {
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
    /// Rate that samples are counted at, Hz: the data set's.
    pub sample_rate_hz: f64,
    /// Samples of the file at that rate.
    pub samples: usize,
    /// Where the movement begins; `null` for rest and where none was found.
    pub onset_sample: Option<usize>,
    /// Where the first window begins: the margin before the onset, the fixed cut-off, or where rest has settled.
    pub start_sample: usize,
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
    let mut repetitions = Vec::new();
    for given in recordings {
        let mut folders = Vec::new();
        gather_folders(given, &mut folders);
        if folders.is_empty() {
            return Err(DatasetError::Unplaced { folder: given.clone() });
        }
        for (folder, origin) in folders {
            for repetition in three_dc::repetitions(&folder)? {
                repetitions.push((folder.clone(), origin.clone(), repetition));
            }
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

/// The folders of recordings at or below `folder`, in the order of people and sessions: `train` comes before `test`.
fn gather_folders(folder: &Path, found: &mut Vec<(PathBuf, Origin)>) {
    if let Some(origin) = Origin::of_folder(folder) {
        found.push((folder.to_owned(), origin));
        return;
    }
    // A folder that cannot be listed holds nothing for us; if nothing is found at all, that is an error.
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    for entry in entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir())) {
        gather_folders(&entry.path(), found);
    }
    found.sort_by_key(|(_, origin)| (origin.person, origin.session.repetition_of_both(0)));
}

/// The data set being written.
struct Builder<'a> {
    settings: &'a DatasetSettings,
    out_dir: &'a Path,
    windows: NpyWriter<f32>,
    labels: NpyWriter<u8>,
    people: NpyWriter<u16>,
    repetitions: NpyWriter<u8>,
    recordings: NpyWriter<u32>,
    starts: NpyWriter<u32>,
    manifest: Manifest,
}

impl<'a> Builder<'a> {
    fn create(settings: &'a DatasetSettings, out_dir: &'a Path) -> Result<Builder<'a>, DatasetError> {
        let channels = settings.channels.len();
        let WindowSettings { window_samples, increment_samples } = settings.windows;
        // What would otherwise only show at the first recording, as a reason to skip it.
        if let Some(filter) = &settings.filter {
            EmgFilter::new(filter, channels, settings.sample_rate_hz)?;
        }
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
            recordings: NpyWriter::create(&path(RECORDINGS), &[]).map_err(write_error(&path(RECORDINGS)))?,
            starts: NpyWriter::create(&path(STARTS), &[]).map_err(write_error(&path(STARTS)))?,
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
        let filter = self.settings.filter.as_ref();
        let mut filter = filter.map(|filter| EmgFilter::new(filter, channels, rate_hz)).transpose()?;
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
                    if let Some(filter) = &mut filter {
                        replaced_samples += filter.process(channel, samples);
                    }
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
        let (onset_sample, start_sample) = match gesture {
            Gesture::Rest => (None, samples_of_ms(self.settings.rest_start_ms)),
            _ => match find_onset(&self.settings.onset, signal, channels, rate_hz)? {
                Some(onset) => (Some(onset.sample), onset.start_sample),
                None => (None, samples_of_ms(self.settings.fallback_ms)),
            },
        };
        let envelope = match self.settings.input {
            WindowInput::Raw => None,
            WindowInput::Envelope => {
                Some(envelope_of(signal, samples, self.settings.onset.envelope_ms, rate_hz)?)
            }
        };
        let content = envelope.as_deref().unwrap_or(signal);
        let WindowSettings { window_samples, increment_samples } = self.settings.windows;
        let first_window = self.manifest.windows;
        let recording = self.manifest.recordings.len() as u32;
        let mut first = start_sample;
        while first.saturating_add(window_samples) <= samples {
            for channel in content.chunks_exact(samples) {
                self.windows
                    .write(&channel[first..first + window_samples])
                    .map_err(write_error(&self.out_dir.join(WINDOWS)))?;
            }
            self.labels.write(&[gesture as u8]).map_err(write_error(&self.out_dir.join(LABELS)))?;
            self.people.write(&[origin.person]).map_err(write_error(&self.out_dir.join(PEOPLE)))?;
            self.repetitions
                .write(&[origin.session.repetition_of_both(repetition)])
                .map_err(write_error(&self.out_dir.join(REPETITIONS)))?;
            self.recordings.write(&[recording]).map_err(write_error(&self.out_dir.join(RECORDINGS)))?;
            self.starts.write(&[first as u32]).map_err(write_error(&self.out_dir.join(STARTS)))?;
            self.manifest.windows += 1;
            first = first.saturating_add(increment_samples);
        }
        let windows = self.manifest.windows - first_window;
        if windows == 0 {
            let left = samples.saturating_sub(start_sample);
            let reason =
                format!("{left} samples after the start of the gesture, a window has {window_samples}");
            self.skip(segment, reason);
            return Ok(());
        }
        let fallback = gesture != Gesture::Rest && onset_sample.is_none();
        self.manifest.fallbacks += u64::from(fallback);
        *self.manifest.windows_per_gesture.entry(gesture.name().to_owned()).or_default() += windows;
        *self.manifest.windows_per_person.entry(origin.person).or_default() += windows;
        self.manifest.recordings.push(RecordingEntry {
            file: segment.file.clone(),
            person: origin.person,
            session: origin.session.name().to_owned(),
            repetition,
            gesture,
            sample_rate_hz: rate_hz,
            samples,
            onset_sample,
            start_sample,
            fallback,
            first_window,
            windows,
        });
        Ok(())
    }

    fn skip(&mut self, segment: &Segment, reason: String) {
        self.manifest.skipped.push(SkippedEntry { path: segment.file.clone(), reason });
    }

    fn finish(mut self) -> Result<Manifest, DatasetError> {
        let recordings = &self.manifest.recordings;
        let of_gesture = |gesture: Gesture| {
            let statistics = OnsetStatistics::of(recordings.iter().filter(|entry| entry.gesture == gesture));
            (gesture.name().to_owned(), statistics)
        };
        let total = ("total".to_owned(), OnsetStatistics::of(recordings.iter()));
        self.manifest.onsets = Gesture::ACTIVE.into_iter().map(of_gesture).chain([total]).collect();
        let path = |name| self.out_dir.join(name);
        self.windows.finish().map_err(write_error(&path(WINDOWS)))?;
        self.labels.finish().map_err(write_error(&path(LABELS)))?;
        self.people.finish().map_err(write_error(&path(PEOPLE)))?;
        self.repetitions.finish().map_err(write_error(&path(REPETITIONS)))?;
        self.recordings.finish().map_err(write_error(&path(RECORDINGS)))?;
        self.starts.finish().map_err(write_error(&path(STARTS)))?;
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

pub(crate) const WINDOWS: &str = "windows.npy";
pub(crate) const LABELS: &str = "labels.npy";
pub(crate) const PEOPLE: &str = "people.npy";
pub(crate) const REPETITIONS: &str = "repetitions.npy";
pub(crate) const RECORDINGS: &str = "recordings.npy";
pub(crate) const STARTS: &str = "starts.npy";
pub(crate) const MANIFEST: &str = "manifest.json";

/// The moving RMS of every channel of a recording, which begins anew.
fn envelope_of(
    signal: &[f32],
    samples: usize,
    envelope_ms: f64,
    rate_hz: f64,
) -> Result<Vec<f32>, DesignError> {
    let mut envelope = Vec::with_capacity(signal.len());
    for channel in signal.chunks_exact(samples.max(1)) {
        let mut tracker = Envelope::new(envelope_ms, rate_hz)?;
        envelope.extend(channel.iter().map(|&sample| tracker.push(sample)));
    }
    Ok(envelope)
}

fn write_error(path: &Path) -> impl FnOnce(io::Error) -> DatasetError + '_ {
    |reason| DatasetError::Write { path: path.to_owned(), reason }
}
