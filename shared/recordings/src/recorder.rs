//! Writes a recording as it is made, so that one that breaks off holds all that came before.
//!
//! ```text
//! folder/session.toml   whose, when, channels, rate, unit, source          first of all
//!        emg-1.csv      samples as acquired, a column a channel            as they come
//!        emg-2.csv      what follows a gap: no file spans missing samples
//!        labels.csv     the trials so far, see `labels`                    anew after every trial
//! ```

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_paths::{PathError, PrivateFolder};
use tendon_signal::FilterSettings;

use crate::labels::{COLUMNS, FILE_NAME};

/// Name of the file that says what was recorded.
const SESSION_FILE: &str = "session.toml";
/// What it begins with.
const FORMAT: &str = "tendon-recording";
/// Version of the format.
const VERSION: u32 = 1;
/// Largest such file, bytes.
const LARGEST: u64 = 1 << 20;

/// What a recording is of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedSession {
    format: String,
    version: u32,
    /// Whose it is.
    pub person: PersonId,
    /// When it began, RFC 3339 in UTC. It names the session in the labels.
    pub at: String,
    /// The channels by name.
    pub channels: Vec<String>,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Unit of the samples; empty if it is not known.
    pub unit: String,
    /// Where the samples come from, in words.
    pub source: String,
    /// Version of the program that recorded.
    pub program_version: String,
    /// The commit it was built from.
    pub commit: String,
    /// Whose recordings a simulated person was fitted to; `None` for a real one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulated: Option<SimulatedFrom>,
    /// The filter of the session. The samples are as acquired, before any filter.
    pub filter: FilterSettings,
}

/// Somebody of a data set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedFrom {
    /// The data set, such as `3DC`.
    pub data_set: String,
    /// The person's number there.
    pub number: u16,
}

/// Why a recording cannot be written, or read back.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// A folder or file of it cannot be used.
    #[error(transparent)]
    Path(#[from] PathError),
    /// Samples cannot be written.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The description is not one of ours.
    #[error("{}: this does not describe a recording ({reason}): record again", path.display())]
    Session {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

impl RecordedSession {
    /// A recording that begins now. The program's version and commit are left empty.
    pub fn new(person: PersonId, at: &str, channels: Vec<String>, sample_rate_hz: f64) -> RecordedSession {
        RecordedSession {
            format: FORMAT.to_owned(),
            version: VERSION,
            person,
            at: at.to_owned(),
            channels,
            sample_rate_hz,
            unit: String::new(),
            source: String::new(),
            program_version: String::new(),
            commit: String::new(),
            simulated: None,
            filter: FilterSettings::default(),
        }
    }

    /// Reads what a recording is of whose file is at `path`, or a file below it; `None` for one that Tendon did not record.
    ///
    /// # Errors
    ///
    /// [`RecorderError::Session`] if the description cannot be understood.
    pub fn beside(path: &Path) -> Result<Option<RecordedSession>, RecorderError> {
        path.parent().map_or(Ok(None), RecordedSession::read)
    }

    /// Reads what the recording in `folder` is of; `None` where none was recorded.
    ///
    /// # Errors
    ///
    /// [`RecorderError::Session`] if the description cannot be understood.
    pub fn read(folder: &Path) -> Result<Option<RecordedSession>, RecorderError> {
        let path = folder.join(SESSION_FILE);
        if !path.exists() {
            return Ok(None);
        }
        let wrong = |reason: String| RecorderError::Session { path: path.clone(), reason };
        let text = tendon_input::read_text(&path, LARGEST).map_err(|error| wrong(error.to_string()))?;
        let session: RecordedSession =
            toml::from_str(&text).map_err(|error| wrong(error.message().to_owned()))?;
        let RecordedSession { format, version, channels, sample_rate_hz, .. } = &session;
        if format != FORMAT || *version != VERSION {
            return Err(wrong(format!(
                "format {format}, version {version}, not {FORMAT}, version {VERSION}"
            )));
        }
        if channels.is_empty() || !(*sample_rate_hz > 0.0 && sample_rate_hz.is_finite()) {
            return Err(wrong("it has no channels or no sampling rate".to_owned()));
        }
        Ok(Some(session))
    }
}

/// A trial of a recording that is being made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordedTrial {
    /// What was made.
    pub gesture: Gesture,
    /// For the how manieth time, from 0.
    pub repetition: u32,
    /// What the person was asked, in words.
    pub asked: String,
    /// Its first sample, by the source's count.
    pub start_sample: u64,
    /// The first sample after it.
    pub end_sample: u64,
}

/// Writes samples and labels.
#[derive(Debug)]
pub struct Recorder {
    folder: PrivateFolder,
    session: RecordedSession,
    /// Files that were there before.
    earlier_files: usize,
    /// Lines of the labels that were there before, with their gesture.
    earlier_labels: Vec<(Gesture, String)>,
    files: Vec<Part>,
    file: Option<File>,
    /// Lines that are not written yet, whole ones only.
    lines: Vec<u8>,
    trials: Vec<RecordedTrial>,
}

/// Samples without a gap between them.
#[derive(Clone, Copy, Debug)]
struct Part {
    first_sample: u64,
    end_sample: u64,
}

impl Recorder {
    /// Makes the folder, which nobody else may enter, and describes the recording in it.
    ///
    /// # Errors
    ///
    /// [`RecorderError`] if it cannot be written.
    pub fn create(folder: &Path, session: RecordedSession) -> Result<Recorder, RecorderError> {
        let folder = PrivateFolder::open(folder)?;
        let text = toml::to_string(&session).expect("names and numbers: nothing that TOML cannot say");
        folder.write(SESSION_FILE, text.as_bytes())?;
        Ok(Recorder::of(folder, session))
    }

    /// Adds to the recording in `folder`: new files, and labels beside those that are there.
    ///
    /// # Errors
    ///
    /// [`RecorderError`] if there is none, or its labels cannot be read.
    pub fn resume(folder: &Path) -> Result<Recorder, RecorderError> {
        let wrong = |path: PathBuf, reason: String| RecorderError::Session { path, reason };
        let session = RecordedSession::read(folder)?;
        let session =
            session.ok_or_else(|| wrong(folder.join(SESSION_FILE), "there is no such file".to_owned()))?;
        let mut recorder = Recorder::of(PrivateFolder::open_existing(folder)?, session);
        while folder.join(part_name(recorder.earlier_files + 1)).exists() {
            recorder.earlier_files += 1;
        }
        let labels = folder.join(FILE_NAME);
        let bytes = recorder.folder.read(FILE_NAME)?.unwrap_or_default();
        let text = String::from_utf8(bytes).map_err(|error| wrong(labels.clone(), error.to_string()))?;
        let place = COLUMNS.iter().position(|column| *column == "gesture").unwrap_or(0);
        for line in text.lines().skip(1) {
            let gesture = line.split(',').nth(place).and_then(|name| name.parse().ok());
            let gesture = gesture
                .ok_or_else(|| wrong(labels.clone(), format!("the line `{line}` names no gesture")))?;
            recorder.earlier_labels.push((gesture, line.to_owned()));
        }
        Ok(recorder)
    }

    fn of(folder: PrivateFolder, session: RecordedSession) -> Recorder {
        Recorder {
            folder,
            session,
            earlier_files: 0,
            earlier_labels: Vec::new(),
            files: Vec::new(),
            file: None,
            lines: Vec::new(),
            trials: Vec::new(),
        }
    }

    /// What is recorded.
    pub fn session(&self) -> &RecordedSession {
        &self.session
    }

    /// Takes back the labels of a gesture that were there before. Its samples stay.
    ///
    /// # Errors
    ///
    /// [`RecorderError`] if the labels cannot be written.
    pub fn forget_earlier(&mut self, gesture: Gesture) -> Result<(), RecorderError> {
        self.earlier_labels.retain(|(other, _)| *other != gesture);
        self.write_labels()
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Takes a block, channel-major, whose first sample has this number at the source. What does not follow the block
    /// before begins a new file. A sample that is not a number is written as 0: its trial must not be labelled.
    ///
    /// # Errors
    ///
    /// [`RecorderError::Write`].
    pub fn push(&mut self, first_sample: u64, block: &[f32]) -> Result<(), RecorderError> {
        let samples = block.len() / self.session.channels.len();
        let follows = self.files.last().is_some_and(|part| part.end_sample == first_sample);
        if !follows {
            self.flush()?;
            self.files.push(Part { first_sample, end_sample: first_sample });
            self.file = Some(self.open_part()?);
            self.lines.extend_from_slice(self.session.channels.join(",").as_bytes());
            self.lines.push(b'\n');
        }
        for sample in 0..samples {
            for (channel, values) in block.chunks_exact(samples).enumerate() {
                let value = if values[sample].is_finite() { values[sample] } else { 0.0 };
                let separator = if channel == 0 { "" } else { "," };
                // Writing to memory cannot fail; the shortest text that is read back as the same number.
                let _ = write!(self.lines, "{separator}{value}");
            }
            self.lines.push(b'\n');
        }
        if let Some(part) = self.files.last_mut() {
            part.end_sample = first_sample + samples as u64;
        }
        Ok(())
    }

    /// Hands all samples to the system, which keeps them even if this program is killed.
    ///
    /// # Errors
    ///
    /// [`RecorderError::Write`], for instance because the disk is full.
    pub fn flush(&mut self) -> Result<(), RecorderError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        let written = file.write_all(&self.lines);
        self.lines.clear();
        written.map_err(|source| RecorderError::Write { path: self.part_path(), source })
    }

    /// Labels a trial; `false` if samples of it are missing, and it is not labelled.
    ///
    /// # Errors
    ///
    /// [`RecorderError`] if samples or labels cannot be written.
    pub fn label(&mut self, trial: RecordedTrial) -> Result<bool, RecorderError> {
        if self.part_of(&trial).is_none() {
            return Ok(false);
        }
        self.trials.push(trial);
        self.write_labels()?;
        Ok(true)
    }

    /// Takes back the labels of the trials that `is_spoilt` names. Their samples stay.
    ///
    /// # Errors
    ///
    /// [`RecorderError`] if the labels cannot be written.
    pub fn unlabel(
        &mut self,
        mut is_spoilt: impl FnMut(&RecordedTrial) -> bool,
    ) -> Result<(), RecorderError> {
        self.trials.retain(|trial| !is_spoilt(trial));
        self.write_labels()
    }

    /// The trials that are labelled.
    pub fn trials(&self) -> &[RecordedTrial] {
        &self.trials
    }

    /// Number, from 1, of the new file that holds all of a trial.
    fn part_of(&self, trial: &RecordedTrial) -> Option<usize> {
        let holds =
            |part: &Part| part.first_sample <= trial.start_sample && trial.end_sample <= part.end_sample;
        self.files.iter().position(holds).map(|place| place + 1)
    }

    fn write_labels(&mut self) -> Result<(), RecorderError> {
        // A label never names samples that are not there.
        self.flush()?;
        let mut text = COLUMNS.join(",") + "\n";
        for (_, line) in &self.earlier_labels {
            text += &format!("{line}\n");
        }
        for trial in &self.trials {
            let Some(number) = self.part_of(trial) else { continue };
            let RecordedTrial { gesture, repetition, asked, start_sample, end_sample } = trial;
            let first = self.files[number - 1].first_sample;
            text += &format!(
                "{},{},{},{repetition},{gesture},{},{},{asked}\n",
                part_name(self.earlier_files + number),
                self.session.person,
                self.session.at,
                start_sample - first,
                end_sample - first
            );
        }
        Ok(self.folder.write(FILE_NAME, text.as_bytes())?)
    }

    fn open_part(&self) -> Result<File, RecorderError> {
        let path = self.part_path();
        let opened = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&path);
        opened.map_err(|source| RecorderError::Write { path, source })
    }

    /// The file that is written to.
    fn part_path(&self) -> PathBuf {
        self.folder().join(part_name(self.earlier_files + self.files.len()))
    }
}

/// Whether a table is part of a recording that was made by [`Recorder`], which ends every line.
pub(crate) fn is_recorded(table: &Path) -> bool {
    table.with_file_name(SESSION_FILE).is_file()
}

fn part_name(number: usize) -> String {
    format!("emg-{number}.csv")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RecordingSettings;
    use crate::labels;
    use crate::table::{Channel, Row, Table};

    fn session() -> RecordedSession {
        let channels = ["flexor", "extensor"].map(str::to_owned).to_vec();
        RecordedSession::new("anna".parse().unwrap(), "2026-01-02T03:04:05Z", channels, 2000.0)
    }

    fn trial(gesture: Gesture, start_sample: u64, end_sample: u64) -> RecordedTrial {
        RecordedTrial { gesture, repetition: 0, asked: "firm".to_owned(), start_sample, end_sample }
    }

    fn read(folder: &Path, file: &str) -> Vec<Vec<f32>> {
        let text = std::fs::read(folder.join(file)).unwrap();
        let channels = [Channel::Name("flexor".to_owned()), Channel::Name("extensor".to_owned())];
        let mut table = Table::open(&text, &channels).unwrap();
        let (mut rows, mut row) = (Vec::new(), vec![0.0; 2]);
        while table.next_row(&text, &mut row).unwrap() == Row::Samples {
            rows.push(row.clone());
        }
        rows
    }

    #[test]
    fn samples_are_read_back_to_the_bit_and_trials_by_their_place_in_the_file() {
        let place = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(&place.path().join("take"), session()).unwrap();
        let block = [1.0e-7_f32, -0.1, 3.402e38, 7.0, 1.0 / 3.0, -2048.0];
        recorder.push(500, &block).unwrap();
        recorder.push(503, &[0.0; 20]).unwrap();
        assert!(recorder.label(trial(Gesture::REST, 501, 510)).unwrap());
        let folder = recorder.folder().to_owned();
        let rows = read(&folder, "emg-1.csv");
        assert_eq!(rows.len(), 13);
        assert_eq!(rows[..3], [[block[0], block[3]], [block[1], block[4]], [block[2], block[5]]]);
        let files = labels::read(&folder, None, &mut Vec::new()).unwrap();
        let origin = (files[0].person.to_string(), files[0].session.as_str());
        assert_eq!((files.len(), origin), (1, ("anna".to_owned(), "2026-01-02T03:04:05Z")));
        let segment = &files[0].segments[1];
        assert_eq!((segment.cue, segment.end_sample), (Some(Gesture::REST), Some(10)));
        assert_eq!(files[0].segments[0].end_sample, Some(1));
        assert_eq!(RecordedSession::read(&folder).unwrap(), Some(session()));
        assert_eq!(RecordedSession::read(place.path()).unwrap(), None);
    }

    #[test]
    fn a_gap_begins_a_new_file_and_no_trial_spans_it() {
        let place = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(place.path(), session()).unwrap();
        recorder.push(0, &[1.0; 20]).unwrap();
        recorder.push(15, &[2.0; 20]).unwrap();
        assert!(!recorder.label(trial(Gesture::GRIP, 5, 20)).unwrap());
        assert!(recorder.label(trial(Gesture::GRIP, 16, 25)).unwrap());
        assert!(recorder.label(trial(Gesture::REST, 0, 10)).unwrap());
        assert_eq!(read(place.path(), "emg-2.csv"), vec![vec![2.0; 2]; 10]);
        let files = labels::read(place.path(), None, &mut Vec::new()).unwrap();
        assert_eq!(files.len(), 2);
        recorder.unlabel(|trial| trial.gesture == Gesture::GRIP).unwrap();
        let files = labels::read(place.path(), None, &mut Vec::new()).unwrap();
        assert_eq!(files.len(), 1);
        assert_eq!(read(place.path(), "emg-2.csv").len(), 10, "samples stay");
    }

    #[test]
    fn a_gesture_is_recorded_once_more_beside_what_is_there() {
        let place = tempfile::tempdir().unwrap();
        let mut first = Recorder::create(place.path(), session()).unwrap();
        first.push(0, &[1.0; 80]).unwrap();
        for (gesture, start) in [(Gesture::REST, 0), (Gesture::GRIP, 10), (Gesture::ULNAR, 20)] {
            assert!(first.label(trial(gesture, start, start + 5)).unwrap());
        }
        drop(first);
        let mut second = Recorder::resume(place.path()).unwrap();
        assert_eq!(second.session(), &session());
        second.push(7000, &[2.0; 40]).unwrap();
        assert!(second.label(trial(Gesture::GRIP, 7005, 7015)).unwrap());
        second.forget_earlier(Gesture::GRIP).unwrap();
        let files = labels::read(place.path(), None, &mut Vec::new()).unwrap();
        let made = |file: usize| -> Vec<Gesture> {
            files[file].segments.iter().filter_map(|segment| segment.cue).collect()
        };
        assert_eq!((made(0), made(1)), (vec![Gesture::REST, Gesture::ULNAR], vec![Gesture::GRIP]));
        assert_eq!(read(place.path(), "emg-1.csv").len(), 40);
        assert_eq!(read(place.path(), "emg-2.csv"), vec![vec![2.0; 2]; 20]);
        let missing = Recorder::resume(&place.path().join("none")).unwrap_err().to_string();
        assert!(missing.contains("there is no such file"), "{missing}");
    }

    #[test]
    fn what_was_flushed_is_there_and_ends_with_a_whole_line_though_nothing_was_closed() {
        let place = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(place.path(), session()).unwrap();
        recorder.push(0, &[1.5; 200]).unwrap();
        recorder.flush().unwrap();
        recorder.push(100, &[f32::NAN; 2]).unwrap();
        assert_eq!(read(place.path(), "emg-1.csv").len(), 100);
        std::mem::forget(recorder);
        assert_eq!(read(place.path(), "emg-1.csv").len(), 100);
    }

    #[test]
    fn a_last_line_that_is_cut_short_is_left_out_of_a_recording_of_ours_and_of_no_other() {
        let place = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::create(place.path(), session()).unwrap();
        let samples: Vec<f32> = (0..200).map(|sample| if sample % 3 == 0 { 0.5 } else { 1.25 }).collect();
        recorder.push(0, &samples).unwrap();
        recorder.flush().unwrap();
        let file = place.path().join("emg-1.csv");
        let whole = std::fs::read_to_string(&file).unwrap();
        let settings = RecordingSettings {
            channels: vec![Channel::Index(0)],
            sample_rate_hz: Some(2000.0),
            ..RecordingSettings::default()
        };
        // The disk may be full within a number, where the line still looks whole, and at its very beginning.
        for (rest, cut_lines) in [("1.25,1", 1), ("1.2", 1), ("", 0)] {
            std::fs::write(&file, format!("{whole}{rest}")).unwrap();
            let summary = crate::check(&file, &settings).unwrap();
            assert_eq!((summary.samples, summary.notices.len()), (100, cut_lines), "{rest}");
            for notice in summary.notices {
                let notice = notice.to_string();
                assert!(notice.contains("100 lines of samples before it were read"), "{notice}");
            }
        }
        // A line within the table, or a table of somebody else, stays an error.
        std::fs::write(&file, format!("{whole}1.2\n1.25,1.25\n")).unwrap();
        assert!(crate::check(&file, &settings).is_err());
        std::fs::remove_file(place.path().join(SESSION_FILE)).unwrap();
        std::fs::write(&file, format!("{whole}1.2")).unwrap();
        assert!(crate::check(&file, &settings).unwrap_err().to_string().contains("truncated"));
    }

    #[test]
    fn a_description_that_makes_no_sense_is_refused() {
        let place = tempfile::tempdir().unwrap();
        for text in ["", "format = \"x\"", "person = 1"] {
            std::fs::write(place.path().join(SESSION_FILE), text).unwrap();
            let refused = RecordedSession::read(place.path()).unwrap_err().to_string();
            assert!(refused.contains("session.toml") && refused.contains("record again"), "{refused}");
        }
        let later = RecordedSession { version: 2, ..session() };
        std::fs::write(place.path().join(SESSION_FILE), toml::to_string(&later).unwrap()).unwrap();
        assert!(RecordedSession::read(place.path()).unwrap_err().to_string().contains("version 2"));
    }
}
