//! The layout for your own recordings: text tables, and a `labels.csv` in the same folder that says what they show.
//!
//! ```text
//! file,person,session,repetition,gesture,start_sample,end_sample
//! anna/monday.csv,1,monday,0,rest,0,10000          one line a trial; samples are counted from 0 in the file,
//! anna/monday.csv,1,monday,0,extension,12000,20000 at its own rate; the end sample is not part of the trial
//! ben.csv,ben,,1,grip,,                            no start, no end: the whole file; a person is a number or a name
//! ```
//! Columns may stand in any order, separated by `,`, `;` or tabs; `session`, `start_sample`, `end_sample` and `asked` may be
//! left out. `start_s` and `end_s` count seconds from the file's first sample instead. What stands in
//! `asked`, for people, says how the gesture was asked for. All trials of a file
//! are of one person and session: the filter runs through the file without a break.
//!
//! People may have any names. What [`PersonId`] cannot take becomes a form that it can: `Anna B.` is `anna-b`.

mod clock;
mod problem;
mod row;

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;
use tendon_identity::{NoPersonId, PersonId};

use crate::segment::{Segment, SkippedEntry, SkippedKind};
use crate::signals::is_signals;

use clock::{FileClock, Place};
use row::{Row, columns_of};

pub use problem::{LabelsError, LabelsProblem};

/// Name of the file.
pub const FILE_NAME: &str = "labels.csv";

/// Its columns.
pub const COLUMNS: [&str; 8] =
    ["file", "person", "session", "repetition", "gesture", "start_sample", "end_sample", "asked"];
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
    start: Place,
    end: Option<Place>,
}

/// Whose file it is, by its first label, and its labels.
struct Labels {
    line: u64,
    person: PersonId,
    session: String,
    labels: Vec<Label>,
}

/// Reads `labels.csv` of `folder`. `given_hz` is the rate of tables that do not tell theirs. Labels that cannot be used, because their file is missing or their gesture is
/// none of the six, are skipped, and so are tables at or below the folder that no label names.
///
/// # Errors
/// The first line that is wrong.
pub fn read(
    folder: &Path,
    given_hz: Option<f64>,
    skipped: &mut Vec<SkippedEntry>,
) -> Result<Vec<LabelledFile>, LabelsError> {
    let path = folder.join(FILE_NAME);
    let wrong = |line: u64, problem| LabelsError { path: path.clone(), line, problem };
    let text = tendon_input::read(&path, tendon_input::LARGEST_LIST)
        .map_err(|error| wrong(1, LabelsProblem::Read(error)))?;
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&text);
    let first_line = text.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let separator = [b'\t', b';'].into_iter().find(|separator| first_line.contains(separator));
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(separator.unwrap_or(b','))
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(text);
    let header = reader.headers().map_err(|error| wrong(1, LabelsProblem::Csv(error)))?;
    let columns = columns_of(header).map_err(|problem| wrong(1, problem))?;

    let mut labels = LabelsOfFiles { given_hz, ..LabelsOfFiles::default() };
    for record in reader.records() {
        let record = record.map_err(|error| {
            wrong(error.position().map_or(1, csv::Position::line), LabelsProblem::Csv(error))
        })?;
        let line = record.position().map_or(1, csv::Position::line);
        let row = Row::read(&columns, &record).map_err(|problem| wrong(line, problem))?;
        labels.add(folder, line, row, skipped).map_err(|problem| wrong(line, problem))?;
    }
    skipped.extend(labels.renamed(&path));
    list_unlabelled(folder, &path, &labels.of_file, skipped);
    labels.into_files(skipped).map_err(|(line, problem)| wrong(line, problem))
}

/// The labels read so far, by file.
#[derive(Default)]
struct LabelsOfFiles {
    /// In the order in which labels name them.
    files: Vec<PathBuf>,
    of_file: BTreeMap<PathBuf, Labels>,
    /// Everybody, with the name that the labels give.
    people: BTreeMap<PersonId, String>,
    /// Rate of tables that do not tell theirs.
    given_hz: Option<f64>,
}

impl LabelsOfFiles {
    fn add(
        &mut self,
        folder: &Path,
        line: u64,
        row: Row,
        skipped: &mut Vec<SkippedEntry>,
    ) -> Result<(), LabelsProblem> {
        let person = self.person(&row.person)?;
        let mut file = folder.join(&row.file);
        // As Windows writes it.
        if row.file.contains('\\') && !file.exists() {
            file = folder.join(row.file.replace('\\', "/"));
        }
        if !self.of_file.contains_key(&file) {
            self.files.push(file.clone());
        }
        let labels = self.of_file.entry(file.clone()).or_insert_with(|| Labels {
            line,
            person,
            session: row.session.clone(),
            labels: Vec::new(),
        });
        if (labels.person, &labels.session) != (person, &row.session) {
            let origin = |person: PersonId, session: &str| format!("person {person}, session {session}");
            return Err(LabelsProblem::OtherOrigin {
                file: row.file,
                origin: origin(person, &row.session),
                first_origin: origin(labels.person, &labels.session),
                first_line: labels.line,
            });
        }
        let Row { repetition, start, end, .. } = row;
        match row.gesture.to_ascii_lowercase().parse::<Gesture>() {
            Ok(gesture) => {
                labels.labels.push(Label { line, repetition, gesture, start, end });
            }
            Err(error) => {
                let reason = format!("{FILE_NAME}, line {line}: {error}");
                skipped.push(SkippedEntry { path: file, kind: SkippedKind::OtherGesture, reason });
            }
        }
        Ok(())
    }

    /// Who is meant by a name.
    fn person(&mut self, name: &str) -> Result<PersonId, LabelsProblem> {
        let person = person_of_name(name).map_err(LabelsProblem::NoPerson)?;
        let first = self.people.entry(person).or_insert_with(|| name.to_owned());
        if first != name {
            let names = format!("`{first}` and `{name}`");
            return Err(LabelsProblem::SamePerson { names, person: person.to_string() });
        }
        Ok(person)
    }

    /// A word about everybody who has another name here than in the labels.
    fn renamed(&self, labels: &Path) -> Vec<SkippedEntry> {
        let other = self.people.iter().filter(|(person, name)| person.to_string() != **name);
        let entry = |(person, name): (&PersonId, &String)| SkippedEntry {
            path: labels.to_owned(),
            kind: SkippedKind::Notice,
            reason: format!("`{name}` is called {person}"),
        };
        other.map(entry).collect()
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
            let in_seconds = |label: &Label| {
                [Some(label.start), label.end]
                    .iter()
                    .flatten()
                    .any(|place| matches!(place, Place::Seconds(_)))
            };
            let clock =
                labels.iter().any(in_seconds).then(|| FileClock::read(&file, self.given_hz)).transpose();
            let clock = match clock {
                Ok(clock) => clock,
                Err(error) => {
                    let (kind, reason) = (SkippedKind::Unreadable, error.below(&file));
                    skipped.push(SkippedEntry { path: file, kind, reason });
                    continue;
                }
            };
            for label in &mut labels {
                label.start = Place::Sample(label.start.sample(clock.as_ref()));
                label.end = label.end.map(|end| Place::Sample(end.sample(clock.as_ref())));
            }
            let start = |label: &Label| label.start.sample(None);
            labels.sort_by_key(start);
            for pair in labels.windows(2) {
                if pair[0].end.is_none_or(|end| end.sample(None) > start(&pair[1])) {
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

/// Who is meant by a name: a number or name as it stands, else the form of it that [`PersonId`] can take, in small letters, with
/// `-` for what is none of its characters.
fn person_of_name(name: &str) -> Result<PersonId, NoPersonId> {
    name.parse().or_else(|error| {
        let lower = name.to_lowercase();
        let words = lower.split(|character: char| !(character.is_ascii_alphanumeric() || character == '_'));
        let safe = words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join("-");
        safe.parse().map_err(|_| error)
    })
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
        let start_sample = label.start.sample(None);
        if end_sample != Some(start_sample) {
            segments.push(between(Some(start_sample)));
        }
        end_sample = label.end.map(|end| end.sample(None));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn read_labels(labels: &str) -> Result<(Vec<LabelledFile>, Vec<SkippedEntry>), String> {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("anna")).unwrap();
        // 100 ms are missing after 200 ms.
        let row = |row: usize| {
            format!("{:.3},{}\n", (row + if row < 200 { 0 } else { 100 }) as f64 / 1000.0, row * 37 % 11)
        };
        let table = "t_s,EMG\n".to_owned() + &(0..1000).map(row).collect::<String>();
        fs::write(folder.path().join("anna/monday.csv"), table).unwrap();
        fs::write(folder.path().join(FILE_NAME), labels).unwrap();
        let mut skipped = Vec::new();
        let files = read(folder.path(), None, &mut skipped).map_err(|error| error.to_string())?;
        Ok((files, skipped))
    }

    fn ends(files: &[LabelledFile]) -> Vec<(bool, Option<u64>)> {
        files[0].segments.iter().map(|segment| (segment.repetition.is_some(), segment.end_sample)).collect()
    }

    #[test]
    fn labels_may_have_other_separators_seconds_and_paths_of_windows() {
        for labels in [
            "file;person;repetition;gesture;start_s;end_s\nanna\\monday.csv;1;0;rest;0,1;0,2\nanna\\monday.csv;1;0;grip;0.5;\n",
            "file\tperson\trepetition\tgesture\tstart_sample\tend_sample\tstart_s\nanna/monday.csv\t1\t0\trest\t100\t200\n\
             anna/monday.csv\t1\t0\tgrip\t\t\t0.5\n",
        ] {
            let (files, skipped) = read_labels(labels).unwrap();
            assert_eq!(skipped, []);
            let expected = [(false, Some(100)), (true, Some(200)), (false, Some(400)), (true, None)];
            assert_eq!(ends(&files), expected, "{labels}");
        }
        // What begins in the gap begins after it.
        let labels = "file,person,repetition,gesture,start_s,end_s\nanna/monday.csv,1,0,rest,0.25,0.35\n";
        assert_eq!(
            ends(&read_labels(labels).unwrap().0),
            [(false, Some(200)), (true, Some(250)), (false, None)]
        );
    }

    #[test]
    fn wrong_places_are_refused() {
        let refused = |cells: &str| {
            let header = "file,person,repetition,gesture,start_sample,end_sample,start_s,end_s";
            read_labels(&format!("{header}\nanna/monday.csv,1,0,rest,{cells}\n")).unwrap_err()
        };
        for (cells, part) in [
            ("10,20,0.1,", "start_sample and start_s are both given"),
            (",,soon,", "start_s = `soon`: give a number of seconds"),
            (",,-1,", "start_s = `-1`"),
            (",,0.2,0.2", "the trial ends at or before its start (0.2)"),
            ("5,4,,", "the trial ends at or before its start (5)"),
        ] {
            let message = refused(cells);
            assert!(message.contains(part), "{cells}: {message}");
        }
    }

    #[test]
    fn people_may_have_any_names_that_stay_apart() {
        let labels =
            |person: &str| format!("file,person,repetition,gesture\nanna/monday.csv,{person},0,rest\n");
        let (files, skipped) = read_labels(&labels("Anna B.")).unwrap();
        assert_eq!(files[0].person.to_string(), "anna-b");
        assert!(skipped[0].reason.contains("`Anna B.` is called anna-b"), "{skipped:?}");
        let (files, skipped) = read_labels(&labels("007")).unwrap();
        assert_eq!((files[0].person.to_string().as_str(), skipped), ("007", Vec::new()));
        let refused = read_labels(&(labels("Anna B.") + "anna/monday.csv,anna-b,1,grip\n")).unwrap_err();
        assert!(refused.contains("line 3: `Anna B.` and `anna-b` would both be called anna-b"), "{refused}");
        let refused = read_labels(&labels("\u{738b}")).unwrap_err();
        assert!(refused.contains("identifies no person"), "{refused}");
    }

    #[test]
    fn a_file_that_is_not_there_is_named_with_its_line() {
        let labels = "file,person,repetition,gesture\nanna/tuesday.csv,1,0,rest\n";
        let (files, skipped) = read_labels(labels).unwrap();
        assert_eq!(files, []);
        let entry = skipped.iter().find(|entry| entry.path.ends_with("anna/tuesday.csv")).unwrap();
        assert!(entry.reason.contains("labels.csv, line 2, names it, but there is no such file"), "{entry}");
    }
}
