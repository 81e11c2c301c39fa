//! Builds the data set of many recordings on several threads; continues a build that was interrupted.

use std::io;
use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_output::OutputFile;
use tendon_provenance::Provenance;
use tendon_recordings::npy::{Element, MappedArray, NpyWriter};
use tendon_recordings::{SkippedEntry, SkippedKind};

use crate::cut::{Outcome, trials};
use crate::error::{DatasetError, write_error};
use crate::files::{LABELS, MANIFEST, PEOPLE, PROGRESS, RECORDINGS, REPETITIONS, SPLITS, STARTS, WINDOWS};
use crate::journal::{Earlier, Finished, Journal, JournalError};
use crate::listing::{Layout, Recordings, list};
use crate::manifest::{Content, Manifest, named_people};
use crate::ordered;
use crate::place::Place;
use crate::recording::Recording;
use crate::settings::DatasetSettings;
use crate::split::{self, HeldOut, Split};
use crate::trial::RecordingEntry;

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

/// How a data set is built from its settings and recordings.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BuildSettings {
    /// People held out: all their windows are for the test, and no others.
    pub test_people: Vec<PersonId>,
    /// Sessions held out of everybody, such as `test` of 3DC: all their windows are for the test.
    pub test_sessions: Vec<String>,
    /// Repetitions held out of everybody, counted through all sessions of the person: all their windows are for the test.
    pub test_repetitions: Vec<u8>,
    /// Seed of the choice of windows for validation.
    pub seed: u64,
    /// Recordings that are read at a time. The data set does not depend on it.
    pub threads: usize,
    /// Whether a finished data set that stands there is replaced.
    pub replaces: bool,
    /// Unit of the samples where the recordings do not tell it; empty if nobody knows.
    pub unit: String,
    /// Where the data set comes from, for its manifest.
    pub provenance: Provenance,
}

impl Default for BuildSettings {
    /// Nobody is held out; all processors, but no more than eight threads: each may hold a recording in memory.
    fn default() -> BuildSettings {
        let threads = std::thread::available_parallelism().map_or(1, NonZeroUsize::get).min(8);
        BuildSettings {
            test_people: Vec::new(),
            test_sessions: Vec::new(),
            test_repetitions: Vec::new(),
            seed: 0,
            threads,
            replaces: false,
            unit: String::new(),
            provenance: Provenance::default(),
        }
    }
}

/// Leaves out what the networks' classes do not cover: data sets number gestures as the paper does.
fn for_networks(outcome: Outcome) -> Outcome {
    let Outcome::Trial(trial) = outcome else { return outcome };
    if trial.entry.gesture.paper_number().is_some() {
        return Outcome::Trial(trial);
    }
    let known = Gesture::PAPER.map(|gesture| gesture.to_string()).join(", ");
    let gesture = trial.entry.gesture;
    Outcome::Skipped(SkippedEntry {
        path: trial.entry.file,
        kind: SkippedKind::OtherGesture,
        reason: format!("sample {}: gesture `{gesture}` is none of {known}", trial.entry.first_sample),
    })
}

/// Cuts the windows of all recordings that [`list`] finds at or below `paths` and writes the data set to `out_dir`,
/// which is created. Recordings that cannot be used are left out and listed in the manifest. Until all of it is written, beside
/// `out_dir`, what stood there stays.
///
/// A build that was interrupted, by `progress` or by the end of the process, goes on where it stopped when it is
/// begun again with the same settings and recordings; with others, all of it is made anew. The data set is the same
/// to the byte either way, but for the provenance in its manifest.
///
/// # Errors
/// When [`list`] gives one, the settings do not fit, nothing is left to train on, `progress` breaks off, the data set cannot be
/// written, or a finished one stands there and is not to be replaced.
pub fn build(
    settings: &DatasetSettings,
    building: &BuildSettings,
    paths: &[PathBuf],
    out_dir: &Path,
    progress: &mut dyn FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<Manifest, DatasetError> {
    settings.check()?;
    let place = Place::check(out_dir, building.replaces)?;
    let found = list(settings, paths)?;
    split::check_people(&building.test_people, found.layout, &found.recordings)?;
    split::check_sessions(&building.test_sessions, &found.recordings)?;
    let total = found.recordings.len();
    let (mut builder, is_other) = Builder::open(settings, &found, &place)?;
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
                    let outcome = for_networks(outcome);
                    let bytes = match &outcome {
                        Outcome::Trial(trial) => trial.bytes(),
                        Outcome::Skipped(_) => 0,
                    };
                    give(Step::Outcome(outcome), bytes)
                });
                // If the other side has stopped, nothing more is needed.
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
        return Err(DatasetError::Interrupted { unfinished: place.unfinished().to_owned() });
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
    layout: Layout,
    /// Unit of the samples, as far as the recordings tell it.
    unit: &'a str,
    place: &'a Place,
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
    /// Opens the unfinished data set at `place` to continue it, or starts a new one; and whether an unfinished build of
    /// something else was found there.
    fn open(
        settings: &'a DatasetSettings,
        found: &'a Recordings,
        place: &'a Place,
    ) -> Result<(Builder<'a>, bool), DatasetError> {
        place.make()?;
        let folder = place.unfinished();
        let (mut journal, earlier) =
            Journal::open(folder, settings, &found.recordings).map_err(|error| match error {
                JournalError::InUse => DatasetError::InUse { unfinished: folder.to_owned() },
                JournalError::Io(error) => write_error(&folder.join(PROGRESS))(error),
            })?;
        let is_other = earlier == Earlier::Other;
        let mut earlier = match earlier {
            Earlier::Same(finished) => finished,
            Earlier::None | Earlier::Other => Vec::new(),
        };
        let windows_path = folder.join(WINDOWS);
        let row_shape = [settings.channels.len(), settings.windows.window_samples];
        let blocks: Vec<(u64, u32)> =
            earlier.iter().map(|finished| (finished.windows, finished.checksum)).collect();
        let (windows, whole) =
            NpyWriter::resume(&windows_path, &row_shape, &blocks).map_err(write_error(&windows_path))?;
        earlier.truncate(whole);
        journal.keep_recordings(whole).map_err(write_error(&folder.join(PROGRESS)))?;
        let mut builder = Builder {
            settings,
            layout: found.layout,
            unit: &found.unit,
            place,
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
        for notice in finished.notices {
            // Such as one about the rate, which all recordings have.
            if !self.notices.contains(&notice) {
                self.notices.push(notice);
            }
        }
    }

    /// Takes in the next step; `Some` with the recordings finished so far when it ends one.
    fn take(&mut self, step: Step) -> Result<Option<usize>, DatasetError> {
        let folder = self.place.unfinished();
        let at_windows = |error| write_error(&folder.join(WINDOWS))(error);
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
        self.journal.push(&self.current).map_err(write_error(&folder.join(PROGRESS)))?;
        let finished = std::mem::take(&mut self.current);
        self.append(finished);
        Ok(Some(self.finished))
    }

    fn finish(self, building: &BuildSettings) -> Result<Manifest, DatasetError> {
        let Builder { settings, layout, unit, place, journal, windows, recordings, skipped, notices, .. } =
            self;
        let folder = place.unfinished();
        let count = windows.rows();
        if count == 0 {
            let first_reason = match skipped.first() {
                Some(skipped) => skipped.to_string(),
                None => "they hold no trials".to_owned(),
            };
            return Err(DatasetError::NoWindows { recordings: self.finished, first_reason });
        }
        let BuildSettings { test_people, test_sessions, test_repetitions, seed, .. } = building;
        let held_out = HeldOut { test_people, test_sessions, test_repetitions };
        held_out.check_repetitions(&recordings)?;
        let splits = split::splits(&recordings, &held_out, *seed);
        let split = split::entry_of(&splits, &recordings, &held_out, *seed);
        if split.windows.train == 0 {
            return Err(DatasetError::NothingToTrain { held_out: split.held_out });
        }
        let windows_path = folder.join(WINDOWS);
        windows.finish().map_err(write_error(&windows_path))?;
        write_arrays(settings, folder, &recordings, &splits)?;
        let mut stored = MappedArray::open(&windows_path, 2)
            .map_err(|error| write_error(&windows_path)(io::Error::other(error)))?;
        let statistics = split::statistics(&mut stored, &splits, &recordings);
        let unit = if unit.is_empty() { &building.unit } else { unit };
        let content = Content { layout, unit, windows: count, recordings, skipped, notices };
        let manifest = Manifest {
            provenance: building.provenance.clone(),
            ..Manifest::of(settings, content, split, statistics)
        };
        OutputFile::check(&folder.join(MANIFEST)).and_then(|file| file.write_json(&manifest))?;
        place.take()?;
        // Until here, no other build wrote to the folder.
        drop(journal);
        Ok(manifest)
    }
}

/// Writes what belongs to each window, in the order of the windows.
fn write_arrays(
    settings: &DatasetSettings,
    out_dir: &Path,
    recordings: &[RecordingEntry],
    splits: &[Split],
) -> Result<(), DatasetError> {
    let rows = || {
        recordings.iter().enumerate().flat_map(|(index, entry)| {
            entry.starts(&settings.windows).map(move |start| (index, entry, start))
        })
    };
    let label = |entry: &RecordingEntry| {
        entry.gesture.paper_number().expect("trials of other gestures were left out: for_networks")
    };
    write_array(out_dir, LABELS, rows().map(|(_, entry, _)| label(entry)))?;
    let named = named_people(recordings);
    let number = |person: PersonId| match person {
        PersonId::Number(number) => number,
        PersonId::Name(_) => {
            *named.iter().find(|(_, own)| **own == person).expect("everybody has a number").0
        }
    };
    write_array(out_dir, PEOPLE, rows().map(|(_, entry, _)| number(entry.person)))?;
    write_array(out_dir, REPETITIONS, rows().map(|(_, entry, _)| entry.repetition_of_all))?;
    write_array(out_dir, RECORDINGS, rows().map(|(index, _, _)| index as u32))?;
    write_array(out_dir, STARTS, rows().map(|(_, _, start)| start as u32))?;
    write_array(out_dir, SPLITS, splits.iter().map(|&split| split as u8))
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
