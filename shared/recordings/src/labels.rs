//! The layout for your own recordings: text tables, and a `labels.csv` in the same folder that says what they show.
//!
//! ```text
//! file,person,session,repetition,gesture,start_sample,end_sample
//! anna/monday.csv,1,monday,0,rest,0,10000          one line a trial; samples are counted from 0 in the file,
//! anna/monday.csv,1,monday,0,extension,12000,20000 at its own rate; the end sample is not part of the trial
//! ben.csv,ben,,1,grip,,                            no start, no end: the whole file; a person is a number or a name
//! ```
//! Columns may stand in any order; `session`, `start_sample`, `end_sample` and `asked` may be left out. What stands in
//! `asked`, for people, says how the gesture was asked for. All trials of a file
//! are of one person and session: the filter runs through the file without a break.

mod problem;

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;
use tendon_identity::PersonId;

use crate::segment::{Segment, SkippedEntry, SkippedKind};
use crate::signals::is_signals;

pub use problem::{LabelsError, LabelsProblem};

/// Name of the file.
pub const FILE_NAME: &str = "labels.csv";

/// Its columns.
pub const COLUMNS: [&str; 8] =
    ["file", "person", "session", "repetition", "gesture", "start_sample", "end_sample", "asked"];
/// Of these, those that must be there.
const REQUIRED: [&str; 4] = ["file", "person", "repetition", "gesture"];

/// The session where none is given.
const ONLY_SESSION: &str = "1";

/// A file that has labels.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelledFile {
    /// The table.
    pub path: PathBuf,
    /// Whose it is.
    pub person: PersonId,
    /// When it was recorded, in the user's words.
    pub session: String,
    /// Its trials, and what lies between them.
    pub segments: Vec<Segment>,
}

impl LabelledFile {
    /// The largest repetition of its trials.
    pub fn last_repetition(&self) -> u32 {
        self.segments.iter().filter_map(|segment| segment.repetition).max().unwrap_or(0)
    }
}

/// A trial, as a line of the file says it.
struct Label {
    line: u64,
    repetition: u32,
    gesture: Gesture,
    start_sample: u64,
    end_sample: Option<u64>,
}

/// Whose file it is, by its first label, and its labels.
struct Labels {
    line: u64,
    person: PersonId,
    session: String,
    labels: Vec<Label>,
}

/// Reads `labels.csv` of `folder`. Labels that cannot be used, because their file is missing or their gesture is
/// none of the six, are skipped, and so are tables at or below the folder that no label names.
///
/// # Errors
/// The first line that is wrong.
pub fn read(folder: &Path, skipped: &mut Vec<SkippedEntry>) -> Result<Vec<LabelledFile>, LabelsError> {
    let path = folder.join(FILE_NAME);
    let wrong = |line: u64, problem| LabelsError { path: path.clone(), line, problem };
    let text = tendon_input::read(&path, tendon_input::LARGEST_LIST)
        .map_err(|error| wrong(1, LabelsProblem::Read(error)))?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text));
    let header = reader.headers().map_err(|error| wrong(1, LabelsProblem::Csv(error)))?;
    let columns = columns_of(header).map_err(|problem| wrong(1, problem))?;

    let mut labels = LabelsOfFiles::default();
    for record in reader.records() {
        let record = record.map_err(|error| {
            wrong(error.position().map_or(1, csv::Position::line), LabelsProblem::Csv(error))
        })?;
        let line = record.position().map_or(1, csv::Position::line);
        let row = Row::read(&columns, &record).map_err(|problem| wrong(line, problem))?;
        labels.add(folder, line, row, skipped).map_err(|problem| wrong(line, problem))?;
    }
    list_unlabelled(folder, &path, &labels.of_file, skipped);
    labels.into_files(skipped).map_err(|(line, problem)| wrong(line, problem))
}

/// A line's cells.
struct Row {
    file: String,
    person: PersonId,
    session: String,
    repetition: u32,
    gesture: String,
    start_sample: u64,
    end_sample: Option<u64>,
}

impl Row {
    fn read(columns: &BTreeMap<&str, usize>, record: &csv::StringRecord) -> Result<Row, LabelsProblem> {
        let cell = |column: &str| columns.get(column).and_then(|&index| record.get(index)).unwrap_or("");
        let number = |column: &'static str, largest: u64| {
            let text = cell(column);
            text.parse()
                .ok()
                .filter(|&number: &u64| number <= largest)
                .ok_or_else(|| LabelsProblem::NotANumber { column, text: text.to_owned(), largest })
        };
        let sample = |column: &'static str| match cell(column) {
            "" => Ok(None),
            _ => number(column, u64::MAX).map(Some),
        };
        if cell("file").is_empty() {
            return Err(LabelsProblem::NoFile);
        }
        let person = cell("person").parse().map_err(LabelsProblem::NoPerson)?;
        let repetition = number("repetition", u8::MAX.into())? as u32;
        let (start_sample, end_sample) = (sample("start_sample")?.unwrap_or(0), sample("end_sample")?);
        if end_sample.is_some_and(|end| end <= start_sample) {
            return Err(LabelsProblem::EndsBeforeStart { start_sample });
        }
        let session = if cell("session").is_empty() { ONLY_SESSION } else { cell("session") };
        Ok(Row {
            file: cell("file").to_owned(),
            person,
            session: session.to_owned(),
            repetition,
            gesture: cell("gesture").to_owned(),
            start_sample,
            end_sample,
        })
    }
}

/// The labels read so far, by file.
#[derive(Default)]
struct LabelsOfFiles {
    /// In the order in which labels name them.
    files: Vec<PathBuf>,
    of_file: BTreeMap<PathBuf, Labels>,
}

impl LabelsOfFiles {
    fn add(
        &mut self,
        folder: &Path,
        line: u64,
        row: Row,
        skipped: &mut Vec<SkippedEntry>,
    ) -> Result<(), LabelsProblem> {
        let file = folder.join(&row.file);
        if !self.of_file.contains_key(&file) {
            self.files.push(file.clone());
        }
        let labels = self.of_file.entry(file.clone()).or_insert_with(|| Labels {
            line,
            person: row.person,
            session: row.session.clone(),
            labels: Vec::new(),
        });
        if (labels.person, &labels.session) != (row.person, &row.session) {
            let origin = |person: PersonId, session: &str| format!("person {person}, session {session}");
            return Err(LabelsProblem::OtherOrigin {
                file: row.file,
                origin: origin(row.person, &row.session),
                first_origin: origin(labels.person, &labels.session),
                first_line: labels.line,
            });
        }
        let Row { repetition, start_sample, end_sample, .. } = row;
        match row.gesture.to_ascii_lowercase().parse::<Gesture>() {
            Ok(gesture) => {
                labels.labels.push(Label { line, repetition, gesture, start_sample, end_sample });
            }
            Err(error) => {
                let reason = format!("{FILE_NAME}, line {line}: {error}");
                skipped.push(SkippedEntry { path: file, kind: SkippedKind::OtherGesture, reason });
            }
        }
        Ok(())
    }

    /// The files with their trials in order; or the line that is wrong, and why.
    fn into_files(
        mut self,
        skipped: &mut Vec<SkippedEntry>,
    ) -> Result<Vec<LabelledFile>, (u64, LabelsProblem)> {
        let mut labelled = Vec::new();
        for file in self.files {
            let Some(Labels { line, person, session, mut labels }) = self.of_file.remove(&file) else {
                continue;
            };
            if let Err(error) = tendon_input::open(&file) {
                let is_missing = error.kind() == ErrorKind::NotFound;
                let problem = if is_missing { "there is no such file".to_owned() } else { error.to_string() };
                let kind = if is_missing { SkippedKind::NotThere } else { SkippedKind::Unreadable };
                let reason = format!("{FILE_NAME}, line {line}, names it, but {problem}");
                skipped.push(SkippedEntry { path: file, kind, reason });
                continue;
            }
            labels.sort_by_key(|label| label.start_sample);
            for pair in labels.windows(2) {
                if pair[0].end_sample.is_none_or(|end| end > pair[1].start_sample) {
                    let (first, second) = (pair[0].line.min(pair[1].line), pair[0].line.max(pair[1].line));
                    return Err((second, LabelsProblem::Overlap { other_line: first }));
                }
            }
            if !labels.is_empty() {
                let segments = segments(&file, &labels);
                labelled.push(LabelledFile { path: file, person, session, segments });
            }
        }
        Ok(labelled)
    }
}

/// Where each known column stands.
fn columns_of(header: &csv::StringRecord) -> Result<BTreeMap<&'static str, usize>, LabelsProblem> {
    let mut columns = BTreeMap::new();
    for (index, name) in header.iter().enumerate() {
        let Some(known) = COLUMNS.into_iter().find(|known| name.eq_ignore_ascii_case(known)) else {
            return Err(LabelsProblem::UnknownColumn { name: name.to_owned() });
        };
        if columns.insert(known, index).is_some() {
            return Err(LabelsProblem::ColumnTwice(known));
        }
    }
    match REQUIRED.into_iter().find(|required| !columns.contains_key(required)) {
        Some(name) => Err(LabelsProblem::MissingColumn { name }),
        None => Ok(columns),
    }
}

/// The trials of a file, in order, and what lies between them.
fn segments(file: &Path, labels: &[Label]) -> Vec<Segment> {
    let part = |repetition, cue, end_sample| Segment {
        file: file.to_owned(),
        repetition,
        cue,
        end_sample,
        samples_lost_before: 0,
    };
    let between = |end_sample| part(None, None, end_sample);
    let mut segments = Vec::new();
    let mut end_sample = Some(0);
    for label in labels {
        if end_sample != Some(label.start_sample) {
            segments.push(between(Some(label.start_sample)));
        }
        end_sample = label.end_sample;
        segments.push(part(Some(label.repetition), Some(label.gesture), end_sample));
    }
    if end_sample.is_some() {
        segments.push(between(None));
    }
    segments
}

/// Lists tables that no label names.
fn list_unlabelled(
    folder: &Path,
    labels_path: &Path,
    labels_of: &BTreeMap<PathBuf, Labels>,
    skipped: &mut Vec<SkippedEntry>,
) {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        if path.is_dir() && !path.is_symlink() {
            list_unlabelled(&path, labels_path, labels_of, skipped);
        } else if (is_table(&path) || is_signals(&path))
            && path != labels_path
            && !labels_of.contains_key(&path)
        {
            let reason = format!("{} has no label for it", labels_path.display());
            skipped.push(SkippedEntry { path, kind: SkippedKind::NoLabel, reason });
        }
    }
}

/// Whose a recording is and of which session, by its name: `sub-anna_ses-2_task-grasp_emg.bdf` is of `anna`, as BIDS and LabRecorder
/// name files, any other of the person whose name its folder has. `None` if neither is the name of a person.
pub fn origin_of_name(path: &Path) -> Option<(PersonId, String)> {
    let stem = path.file_stem()?.to_str()?;
    let named = |name: &str| name.to_ascii_lowercase().parse().ok();
    if let Some((person, session)) = stem.strip_prefix("sub-").and_then(|rest| rest.split_once('_')) {
        return Some((named(person)?, session.to_owned()));
    }
    let folder = path.canonicalize().ok()?;
    Some((named(folder.parent()?.file_name()?.to_str()?)?, stem.to_owned()))
}

/// Whether a file's name is that of a table.
pub fn is_table(path: &Path) -> bool {
    path.extension().is_some_and(|extension| {
        ["csv", "tsv", "txt"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    })
}
