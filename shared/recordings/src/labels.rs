//! The layout of one's own recordings: text tables, and `labels.csv` beside them, which tells what they show.
//!
//! ```text
//! file,person,session,repetition,gesture,start_sample,end_sample
//! anna/monday.csv,1,monday,0,rest,0,10000          one line a trial; samples are counted from 0 in the file,
//! anna/monday.csv,1,monday,0,extension,12000,20000 at its own rate; the end is no longer part of the trial
//! ben.csv,2,,1,grip,,                              no start, no end: the whole file
//! ```
//! Columns may stand in any order; `session`, `start_sample` and `end_sample` may be left out. All trials of a file
//! are of one person and session: the filter runs through the file without a break.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;

use crate::dataset::SkippedEntry;
use crate::source::Segment;

/// Name of the file.
pub(crate) const FILE_NAME: &str = "labels.csv";

const COLUMNS: [&str; 7] =
    ["file", "person", "session", "repetition", "gesture", "start_sample", "end_sample"];
/// Of these, those that must be there.
const REQUIRED: [&str; 4] = ["file", "person", "repetition", "gesture"];

/// The session where none is given.
const ONLY_SESSION: &str = "1";

/// A place in a labels file that cannot be used, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}, line {line}: {problem}", .path.display())]
pub struct LabelsError {
    path: PathBuf,
    /// Counted from 1, the header included.
    line: u64,
    problem: String,
}

/// A file that has labels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LabelledFile {
    pub(crate) path: PathBuf,
    pub(crate) person: u16,
    pub(crate) session: String,
    /// Its trials, and what lies between them.
    pub(crate) segments: Vec<Segment>,
}

impl LabelledFile {
    /// The largest repetition of its trials.
    pub(crate) fn last_repetition(&self) -> u32 {
        self.segments.iter().filter_map(|segment| segment.repetition).max().unwrap_or(0)
    }
}

/// A line.
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
    person: u16,
    session: String,
    labels: Vec<Label>,
}

/// Reads `labels.csv` of `folder`. Labels that cannot be used, because their file is not there or their gesture is
/// none of the six, are skipped, and so are tables at or below the folder that no label names.
///
/// # Errors
/// The first line that is wrong.
pub(crate) fn read(folder: &Path, skipped: &mut Vec<SkippedEntry>) -> Result<Vec<LabelledFile>, LabelsError> {
    let path = folder.join(FILE_NAME);
    let wrong = |line: u64, problem: String| LabelsError { path: path.clone(), line, problem };
    let text = fs::read(&path).map_err(|error| wrong(1, format!("cannot be read ({error})")))?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text));
    let columns = columns_of(reader.headers().map_err(|error| wrong(1, error.to_string()))?)
        .map_err(|problem| wrong(1, problem))?;

    let mut files: Vec<PathBuf> = Vec::new();
    let mut labels_of: BTreeMap<PathBuf, Labels> = BTreeMap::new();
    for record in reader.records() {
        let record = record
            .map_err(|error| wrong(error.position().map_or(1, csv::Position::line), error.to_string()))?;
        let line = record.position().map_or(1, csv::Position::line);
        let cell = |column: &str| columns.get(column).and_then(|&index| record.get(index)).unwrap_or("");
        let name = cell("file");
        if name.is_empty() {
            return Err(wrong(
                line,
                "names no file: give its path, from the folder of labels.csv on".to_owned(),
            ));
        }
        let number = |column: &'static str, largest: u64| -> Result<u64, LabelsError> {
            let text = cell(column);
            text.parse().ok().filter(|&number| number <= largest).ok_or_else(|| {
                wrong(line, format!("{column} = `{text}`: give a whole number of 0 to {largest}"))
            })
        };
        let person = number("person", u16::MAX.into())? as u16;
        let repetition = number("repetition", u8::MAX.into())? as u32;
        let start_sample = match cell("start_sample") {
            "" => 0,
            _ => number("start_sample", u64::MAX)?,
        };
        let end_sample = match cell("end_sample") {
            "" => None,
            _ => Some(number("end_sample", u64::MAX)?),
        };
        if end_sample.is_some_and(|end| end <= start_sample) {
            let problem = format!("the trial ends (end_sample) where it has not begun ({start_sample})");
            return Err(wrong(line, problem));
        }
        let session = match cell("session") {
            "" => ONLY_SESSION,
            session => session,
        };

        let file = folder.join(name);
        if !labels_of.contains_key(&file) {
            files.push(file.clone());
        }
        let labels = labels_of.entry(file.clone()).or_insert_with(|| Labels {
            line,
            person,
            session: session.to_owned(),
            labels: Vec::new(),
        });
        if (labels.person, labels.session.as_str()) != (person, session) {
            return Err(wrong(
                line,
                format!(
                    "{name} is of person {person}, session {session} here, but of person {}, session {} in line \
                     {}: a file is one person's, made in one session",
                    labels.person, labels.session, labels.line
                ),
            ));
        }
        match cell("gesture").to_ascii_lowercase().parse::<Gesture>() {
            Ok(gesture) => {
                labels.labels.push(Label { line, repetition, gesture, start_sample, end_sample });
            }
            Err(_) => {
                let known = Gesture::ALL.map(Gesture::name).join(", ");
                let reason =
                    format!("{FILE_NAME}, line {line}: gesture `{}` is none of {known}", cell("gesture"));
                skipped.push(SkippedEntry { path: file, reason });
            }
        }
    }

    list_unlabelled(folder, &path, &labels_of, skipped);
    let mut labelled = Vec::new();
    for file in files {
        let Some(Labels { line, person, session, mut labels }) = labels_of.remove(&file) else { continue };
        if !file.is_file() {
            let reason = format!("{FILE_NAME}, line {line}, names it, but there is no such file");
            skipped.push(SkippedEntry { path: file, reason });
            continue;
        }
        labels.sort_by_key(|label| label.start_sample);
        for pair in labels.windows(2) {
            if pair[0].end_sample.is_none_or(|end| end > pair[1].start_sample) {
                let (first, second) = (pair[0].line.min(pair[1].line), pair[0].line.max(pair[1].line));
                let problem = format!("its trial and that of line {first} share samples of the same file");
                return Err(wrong(second, problem));
            }
        }
        if !labels.is_empty() {
            let segments = segments(&file, &labels);
            labelled.push(LabelledFile { path: file, person, session, segments });
        }
    }
    Ok(labelled)
}

/// Where each known column stands.
fn columns_of(header: &csv::StringRecord) -> Result<BTreeMap<&'static str, usize>, String> {
    let mut columns = BTreeMap::new();
    for (index, name) in header.iter().enumerate() {
        let Some(known) = COLUMNS.into_iter().find(|known| name.eq_ignore_ascii_case(known)) else {
            return Err(format!("unknown column `{name}`: the columns are {}", COLUMNS.join(",")));
        };
        if columns.insert(known, index).is_some() {
            return Err(format!("column `{known}` is there twice: leave one out"));
        }
    }
    match REQUIRED.into_iter().find(|required| !columns.contains_key(required)) {
        Some(missing) => Err(format!("there is no column `{missing}`: begin with {}", COLUMNS.join(","))),
        None => Ok(columns),
    }
}

/// The trials of a file, in order, and what lies between them.
fn segments(file: &Path, labels: &[Label]) -> Vec<Segment> {
    let between = |end_sample| Segment { file: file.to_owned(), repetition: None, cue: None, end_sample };
    let mut segments = Vec::new();
    let mut end_sample = Some(0);
    for label in labels {
        if end_sample != Some(label.start_sample) {
            segments.push(between(Some(label.start_sample)));
        }
        end_sample = label.end_sample;
        let repetition = Some(label.repetition);
        segments.push(Segment { file: file.to_owned(), repetition, cue: Some(label.gesture), end_sample });
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
        } else if is_table(&path) && path != labels_path && !labels_of.contains_key(&path) {
            let reason = format!("{} has no label for it", labels_path.display());
            skipped.push(SkippedEntry { path, reason });
        }
    }
}

/// Whether a file's name is that of a table.
pub(crate) fn is_table(path: &Path) -> bool {
    path.extension().is_some_and(|extension| {
        ["csv", "tsv", "txt"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    })
}
