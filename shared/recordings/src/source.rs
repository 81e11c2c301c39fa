//! A recording as a stream of frames: one sample of every chosen channel, and the cue in force.

mod frames;

use std::path::Path;

use serde::{Deserialize, Serialize};
use tendon_signal::{UnitError, canonical_unit, unit_factor};

use crate::column_labels;
use crate::error::RecordingError;
use crate::layout::segments;
use crate::recorder::{RecordedSession, is_recorded};
use crate::segment::{Notice, Segment};
use crate::signals::{Signals, is_signals};
use crate::table::{self, Channel, Column, ColumnKind, Table, TimingRemark};
use crate::text::Text;
use crate::three_dc;

pub use frames::Frame;
use frames::Missing;

/// Most frames to read at once: enough to make the overhead negligible, few enough to stay in the fastest cache.
pub(crate) const FRAMES_AT_ONCE: usize = 256;

/// How a recording is to be read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingSettings {
    /// Which channels, in the order they shall have.
    pub channels: Vec<Channel>,
    /// Sampling rate of a plain table, in Hz. Not needed where the layout states it, as 3DC does.
    #[serde(default)]
    pub sample_rate_hz: Option<f64>,
    /// Of a 3DC folder, only this repetition; all in order if not given.
    #[serde(default)]
    pub repetition: Option<u32>,
    /// Of a plain table, the column that says what was done; found by its name if not given.
    #[serde(default)]
    pub label_column: Option<Channel>,
}

/// An open recording. Its files are mapped one after the other as they are reached.
#[derive(Debug)]
pub struct RecordingSource {
    segments: Vec<Segment>,
    notices: Vec<Notice>,
    sample_rate_hz: f64,
    channels: usize,
    samples: Samples,
    /// The segment of the last frame.
    segment: usize,
    /// Frames read of the file of that segment.
    position: u64,
    /// Samples that are missing before the next frame.
    lost_samples: u64,
    missing: Missing,
}

/// Where the samples are.
#[derive(Debug)]
enum Samples {
    /// In a text file, the one of the current segment, with its unit, and what each chosen column is multiplied by to have
    /// it; none if they all have it.
    Table { table: Table, text: Text, unit: String, factors: Vec<f32> },
    /// In memory: the chosen channels, all of the same length.
    Columns(Columns),
}

/// Channels that have been loaded.
#[derive(Debug)]
pub(crate) struct Columns {
    /// The chosen ones.
    pub(crate) samples: Vec<Vec<f32>>,
    /// Their numbers in the file.
    pub(crate) chosen: Vec<usize>,
    /// All channels of the file by name, or by number from 0.
    pub(crate) names: Vec<String>,
    /// Unit of the samples; empty if it is not known.
    pub(crate) unit: String,
}

impl RecordingSource {
    /// Opens the recording at `path`. The layout follows from its name:
    ///
    /// | path | recording |
    /// |---|---|
    /// | a folder with files `3dc_EMG_gesture_R_G.txt` | these joined by R, then G; or only those of `settings.repetition` |
    /// | one such file | that gesture of that repetition |
    /// | a file `.edf`, `.bdf`, `.xdf` or `.xdfz` | its [`Signals`], with the cues that its annotations or markers give |
    /// | any other `.csv`, `.tsv`, `.txt` | a plain table (see [`table`](crate::table)), with cues only if a column says what was done, at the rate that it tells, that a `session.toml` of Tendon beside it states, or `settings.sample_rate_hz` |
    ///
    /// # Errors
    /// When the path has no known layout, the settings do not fit, or the first file cannot be opened. What is
    /// wrong further on shows when it is read: [`check()`](crate::check()) reads all of it.
    pub fn open(path: &Path, settings: &RecordingSettings) -> Result<RecordingSource, RecordingError> {
        if is_signals(path) && !path.is_dir() {
            if settings.repetition.is_some() {
                return Err(RecordingError::RepetitionOfFile { file: path.to_owned() });
            }
            if settings.label_column.is_some() {
                return Err(RecordingError::OwnCues { path: path.to_owned() });
            }
            return RecordingSource::of_signals(path, None, &settings.channels, settings.sample_rate_hz);
        }
        let mut notices = Vec::new();
        let segments = segments(path, settings, &mut notices)?;
        let given_hz = settings.sample_rate_hz;
        let mut source = if segments[0].repetition.is_some() {
            if settings.label_column.is_some() {
                return Err(RecordingError::OwnCues { path: path.to_owned() });
            }
            let sample_rate_hz = sample_rate(path, Some(three_dc::SAMPLE_RATE_HZ), given_hz)?;
            let (text, _) = Text::open(&segments[0].file)?;
            let table = Table::open(text.bytes(), &settings.channels);
            let table = table.map_err(RecordingError::table(&segments[0].file))?;
            let samples = Samples::Table { table, text, unit: String::new(), factors: Vec::new() };
            RecordingSource::of(samples, settings.channels.len(), segments, Vec::new(), sample_rate_hz)
        } else {
            let recorded_hz = RecordedSession::beside(path)?.map(|session| session.sample_rate_hz);
            let given_hz = match recorded_hz {
                Some(_) => Some(sample_rate(path, recorded_hz, given_hz)?),
                None => given_hz,
            };
            RecordingSource::of_labelled_table(
                segments,
                &settings.channels,
                given_hz,
                settings.label_column.as_ref(),
            )?
        };
        source.notices.splice(..0, notices);
        Ok(source)
    }

    /// Opens the table that `segments`, at least one, divide; a single one without a cue is divided by a column of labels, if
    /// there is one. Its rate is what it states or what its column of time shows;
    /// `given_hz` must not differ by more than 1 %, and holds where the table does not tell.
    ///
    /// # Errors
    /// When the file cannot be opened, lacks a channel, or has no rate or another one.
    pub fn of_table(
        segments: Vec<Segment>,
        channels: &[Channel],
        given_hz: Option<f64>,
    ) -> Result<RecordingSource, RecordingError> {
        RecordingSource::of_labelled_table(segments, channels, given_hz, None)
    }

    /// The same, divided by `label_column` if that is given.
    fn of_labelled_table(
        mut segments: Vec<Segment>,
        channels: &[Channel],
        given_hz: Option<f64>,
        label_column: Option<&Channel>,
    ) -> Result<RecordingSource, RecordingError> {
        let file = &segments[0].file.clone();
        let (text, notice) = Text::open(file)?;
        let mut notices: Vec<Notice> = notice.into_iter().collect();
        let mut table = Table::open(text.bytes(), channels).map_err(RecordingError::table(file))?;
        let mut own_hz = None;
        let mut unit = String::new();
        let mut factors = Vec::new();
        // Of a recording that Tendon made, all columns are channels.
        if label_column.is_some() || !is_recorded(file) {
            let columns = table::columns(text.bytes()).map_err(RecordingError::table(file))?;
            let labels = label_column.map(|column| table::find(&columns, column)).transpose();
            let labels = labels.map_err(RecordingError::table(file))?;
            let chosen = table.chosen_columns();
            let odd = chosen.iter().filter(|column| columns[**column].kind != ColumnKind::Muscle);
            let odd: Vec<_> = odd.map(|column| (table.name(*column), columns[*column].kind)).collect();
            if !odd.is_empty() {
                notices.push(Notice::NoMuscle { file: file.clone(), columns: odd });
            }
            (unit, factors) = common_unit(&columns, &chosen);
            if !factors.is_empty() {
                notices.push(Notice::UnitsDiffer { file: file.clone(), unit: unit.clone() });
            }
            let is_undivided = matches!(&segments[..], [Segment { repetition: None, end_sample: None, .. }]);
            if let Some(column) = labels.or(table::truth(&columns)).filter(|_| is_undivided) {
                let name = table.name(column);
                match column_labels::divide(file, text.bytes(), column) {
                    Some(labelled) => {
                        segments = labelled.segments;
                        notices.push(Notice::Labels { file: file.clone(), column: name.clone() });
                        if !labelled.left_out.is_empty() {
                            let labels = labelled.left_out.into_iter().collect();
                            notices.push(Notice::LabelsLeftOut { file: file.clone(), column: name, labels });
                        }
                    }
                    None if labels.is_some() => {
                        return Err(RecordingError::NoLabels { file: file.clone(), column: name });
                    }
                    None => {}
                }
            }
            let timing = table.watch_time(text.bytes(), &columns).map_err(RecordingError::table(file))?;
            own_hz = timing.rate_hz.filter(|_| !given_hz.is_some_and(|given| timing.allows(given)));
            if timing.rate_hz.is_none() && given_hz.is_none() && !timing.unclear_hz.is_empty() {
                return Err(RecordingError::SampleRateUnclear {
                    file: file.clone(),
                    stated: timing.unclear_hz,
                });
            }
            let is_guess = matches!(timing.remark, Some(TimingRemark::TakenAsMilliseconds { .. }));
            if is_guess && given_hz.is_some() {
                own_hz = None;
            } else if let Some(remark) = timing.remark {
                notices.push(Notice::Time { file: file.clone(), remark });
            }
        }
        let sample_rate_hz = sample_rate(file, own_hz, given_hz)?;
        let samples = Samples::Table { table, text, unit, factors };
        Ok(RecordingSource::of(samples, channels.len(), segments, notices, sample_rate_hz))
    }

    /// Opens the file at `path`, which describes itself (see [`is_signals`]), divided by its own cues, or as `segments` of it say.
    /// `given_hz` is the rate the user says, if any: it serves as a check.
    ///
    /// # Errors
    /// When the file cannot be read, lacks a channel, or has another rate than `given_hz`.
    pub fn of_signals(
        path: &Path,
        segments: Option<Vec<Segment>>,
        channels: &[Channel],
        given_hz: Option<f64>,
    ) -> Result<RecordingSource, RecordingError> {
        /// So much the rates of one amplifier's sheet and of its files may differ.
        const TOLERANCE: f64 = 0.01;
        let signals = Signals::read(path, channels)?;
        let actual_hz = signals.sample_rate_hz;
        let fits = |given_hz: &f64| (1.0 - TOLERANCE..=1.0 + TOLERANCE).contains(&(given_hz / actual_hz));
        if let Some(given_hz) = given_hz.filter(|given_hz| !fits(given_hz)) {
            return Err(RecordingError::SampleRateDiffers { path: path.to_owned(), actual_hz, given_hz });
        }
        let segments = match segments {
            Some(segments) => signals.divide(segments),
            None => signals.segments(path),
        };
        let Signals { columns: samples, chosen, names, unit, notices, .. } = signals;
        let columns = Columns { samples, chosen, names, unit };
        let mut source = RecordingSource::of_columns(columns, segments, actual_hz);
        source.notices = notices;
        Ok(source)
    }

    /// A recording that has been loaded: its channels, all of the same length, which are one file's that
    /// `segments`, at least one, divide.
    pub(crate) fn of_columns(
        columns: Columns,
        segments: Vec<Segment>,
        sample_rate_hz: f64,
    ) -> RecordingSource {
        let channels = columns.samples.len();
        let samples = Samples::Columns(columns);
        RecordingSource::of(samples, channels, segments, Vec::new(), sample_rate_hz)
    }

    fn of(
        samples: Samples,
        channels: usize,
        segments: Vec<Segment>,
        notices: Vec<Notice>,
        sample_rate_hz: f64,
    ) -> RecordingSource {
        let lost_samples = segments[0].samples_lost_before;
        RecordingSource {
            segments,
            notices,
            sample_rate_hz,
            channels,
            samples,
            segment: 0,
            position: 0,
            lost_samples,
            missing: Missing::default(),
        }
    }

    /// Frames read so far of the file that is being read.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Sampling rate in Hz.
    pub fn sample_rate_hz(&self) -> f64 {
        self.sample_rate_hz
    }

    /// Chosen channels: the length of a frame.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// The files of the recording in order; at least one.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Columns of the current file, chosen or not.
    pub fn file_channels(&self) -> usize {
        match &self.samples {
            Samples::Table { table, .. } => table.columns(),
            Samples::Columns(columns) => columns.names.len(),
        }
    }

    /// All columns of the current file, chosen or not: by name where it gives one, else by number from 0.
    pub fn file_names(&self) -> Vec<String> {
        match &self.samples {
            Samples::Table { table, .. } if table.names().is_empty() => {
                (0..table.columns()).map(|column| column.to_string()).collect()
            }
            Samples::Table { table, .. } => table.names().to_vec(),
            Samples::Columns(columns) => columns.names.clone(),
        }
    }

    /// Unit of the chosen channels in the file's words; empty if the file does not state one for all.
    pub fn unit(&self) -> &str {
        match &self.samples {
            Samples::Table { unit, .. } => unit,
            Samples::Columns(columns) => &columns.unit,
        }
    }

    /// Brings samples that are in the unit `from` to the unit `to`.
    ///
    /// # Errors
    /// When one of them is no known unit of voltage.
    pub fn convert(&mut self, from: &str, to: &str) -> Result<(), UnitError> {
        let factor = unit_factor(from, to)? as f32;
        match &mut self.samples {
            Samples::Table { unit, factors, .. } => {
                to.clone_into(unit);
                if factors.is_empty() && factor != 1.0 {
                    *factors = vec![1.0; self.channels];
                }
                factors.iter_mut().for_each(|own| *own *= factor);
            }
            Samples::Columns(Columns { samples, unit, .. }) => {
                to.clone_into(unit);
                samples.iter_mut().flatten().for_each(|sample| *sample *= factor);
            }
        }
        Ok(())
    }

    /// The chosen columns of the current file, in the order of a frame: by name where it gives one, else by number from 0.
    pub fn chosen(&self) -> Vec<String> {
        match &self.samples {
            Samples::Table { table, .. } => table.chosen(),
            Samples::Columns(Columns { chosen, names, .. }) => {
                chosen.iter().map(|number| names[*number].clone()).collect()
            }
        }
    }

    /// What its user should know: at first what was found when it was opened, at the end also what was found on the way.
    pub fn notices(&self) -> &[Notice] {
        &self.notices
    }
}

/// The unit of chosen columns, and what each is multiplied by to have it: if they state different ones, that of the first.
/// Nothing if they have it already, and no unit if they do not all have one that is known.
pub(crate) fn common_unit(columns: &[Column], chosen: &[usize]) -> (String, Vec<f32>) {
    let units = || chosen.iter().map(|column| columns[*column].unit.as_str());
    let first = units().find(|unit| !unit.is_empty()).unwrap_or_default();
    let is_first = |unit: &str| canonical_unit(unit) == canonical_unit(first);
    if units().all(is_first) {
        return (first.to_owned(), Vec::new());
    }
    if units().all(|unit| unit.is_empty() || is_first(unit)) {
        return (String::new(), Vec::new());
    }
    // A column without a unit is taken to have that of the first.
    let factor = |unit: &str| if unit.is_empty() { Ok(1.0) } else { unit_factor(unit, first) };
    let factors: Result<Vec<f64>, UnitError> = units().map(factor).collect();
    factors.map_or_else(
        |_| (String::new(), Vec::new()),
        |factors| (first.to_owned(), factors.into_iter().map(|factor| factor as f32).collect()),
    )
}

fn sample_rate(path: &Path, known_hz: Option<f64>, given_hz: Option<f64>) -> Result<f64, RecordingError> {
    match (known_hz, given_hz) {
        (Some(actual_hz), Some(given_hz)) if actual_hz != given_hz => {
            Err(RecordingError::SampleRateDiffers { path: path.to_owned(), actual_hz, given_hz })
        }
        (Some(hz), _) => Ok(hz),
        (None, Some(hz)) if hz.is_finite() && hz > 0.0 => Ok(hz),
        (None, Some(hz)) => Err(tendon_signal::DesignError::SampleRate(hz).into()),
        (None, None) => Err(RecordingError::SampleRateMissing { file: path.to_owned() }),
    }
}
