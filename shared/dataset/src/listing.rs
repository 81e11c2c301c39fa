//! Finds the recordings below the given paths, in any known layout.

mod problem;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tendon_identity::PersonId;
use tendon_recordings::labels::{self, LabelledFile, is_table};
use tendon_recordings::{
    Channel, Notice, RecordedSession, RecordingError, RecordingSettings, RecordingSource, Segment, Signals,
    SkippedEntry, SkippedKind, is_signals, labels_left_out, muscles, ozdemir, three_dc, unit_of_table,
};
use tendon_signal::{canonical_unit, unit_factor};

use crate::recording::{Content, Recording, Units};
use crate::settings::DatasetSettings;

pub use problem::ListingError;

/// How recordings lie on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Layout {
    /// `ParticipantP/{train,test}/EMG/3dc_EMG_gesture_R_G.txt`, at 1000 Hz.
    ThreeDc,
    /// Ozdemir 2022, a `.mat` file a person.
    OzdemirMat,
    /// Ozdemir 2022, a file a trial: `P<person>_C<cycle>_G<gesture>.csv`.
    OzdemirTrials,
    /// Your own: text tables and a `labels.csv`, or files with cues inside.
    Labelled,
}

impl Layout {
    /// The data set that the layout belongs to, in which its people have their numbers; `None` for your own recordings,
    /// whose numbers mean nothing elsewhere.
    pub fn data_set(self) -> Option<&'static str> {
        match self {
            Layout::ThreeDc => Some(three_dc::DATA_SET),
            Layout::OzdemirMat | Layout::OzdemirTrials => Some(ozdemir::DATA_SET),
            Layout::Labelled => None,
        }
    }

    /// Unit of the samples of that data set; `None` for your own recordings.
    fn unit(self) -> Option<&'static str> {
        match self {
            Layout::ThreeDc => Some(three_dc::UNIT),
            Layout::OzdemirMat | Layout::OzdemirTrials => Some("mV"),
            Layout::Labelled => None,
        }
    }

    /// How many electrodes an armband has that go around the whole arm, numbered in order; `None` where that is not so.
    pub fn electrodes_around_arm(self) -> Option<usize> {
        match self {
            Layout::ThreeDc => Some(three_dc::ELECTRODES),
            Layout::OzdemirMat | Layout::OzdemirTrials | Layout::Labelled => None,
        }
    }
}

impl fmt::Display for Layout {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Layout::ThreeDc => "3DC",
            Layout::OzdemirMat => "Ozdemir 2022 (.mat)",
            Layout::OzdemirTrials => "Ozdemir 2022 (a .csv a trial)",
            Layout::Labelled => "recordings with labels",
        })
    }
}

/// What [`list`] found.
#[derive(Clone, Debug, PartialEq)]
pub struct Recordings {
    /// The layout of them all.
    pub layout: Layout,
    /// The recordings, in the order of a data set's windows.
    pub recordings: Vec<Recording>,
    /// What looks like a recording, but cannot be used, and why.
    pub skipped: Vec<SkippedEntry>,
    /// Unit of the samples in its canonical spelling; empty if the recordings do not tell it.
    pub unit: String,
}

/// Lists the recordings at or below `paths`. The layout follows from what is found there:
///
/// | found | recordings |
/// |---|---|
/// | a folder `ParticipantP/{train,test}/EMG` | 3DC: its files `3dc_EMG_gesture_R_G.txt`, each repetition R joined; the `IMU` folder beside it is passed over |
/// | files `.mat` | Ozdemir 2022: one a person |
/// | files `P<person>_C<cycle>_G<gesture>.csv` | Ozdemir 2022: one a trial |
/// | a folder with `labels.csv` | the tables and other files that it names |
/// | files `.edf`, `.bdf`, `.xdf`, `.xdfz` | each by itself, with its annotations or markers that name gestures |
/// | other tables, if `settings` name a column of labels | each by itself, with the gestures of that column |
///
/// Files that look like recordings but match none of these are listed as skipped. Links to folders are followed; of each path, a
/// folder is looked at once, however many links lead to it.
///
/// # Errors
/// When there is no recording below one of the paths or none that can be used, the layouts differ, the same recording is
/// found twice, a name is not UTF-8, the settings do not fit the recordings (filtered before or not, no sampling rate, no table
/// for a column of labels),
/// `labels.csv` is wrong, or a folder cannot be read.
pub fn list(settings: &DatasetSettings, paths: &[PathBuf]) -> Result<Recordings, ListingError> {
    let mut found = Found { takes_tables: settings.label_column.is_some(), ..Found::default() };
    for path in paths {
        let skipped_before = found.skipped.len();
        found.entered.clear();
        if found.gather(path, true)? == 0 {
            let hint = found.skipped.get(skipped_before);
            let hint = hint.map(|skipped| format!(" ({}: {})", skipped.path.display(), skipped.reason));
            return Err(ListingError::NoRecordings { path: path.clone(), hint: hint.unwrap_or_default() });
        }
    }
    let Some((layout, first)) = found.candidates.first().cloned() else {
        return Err(ListingError::NoRecordings { path: PathBuf::new(), hint: String::new() });
    };
    if let Some((other, second)) = found.candidates.iter().find(|(other, _)| *other != layout).cloned() {
        return Err(ListingError::SeveralLayouts { first, layout, second, other });
    }
    if let Some((_, path)) = found.candidates.iter().find(|(_, path)| path.to_str().is_none()) {
        return Err(ListingError::NotUtf8 { path: path.clone() });
    }
    let is_labelled_table = |(layout, path): &(Layout, PathBuf)| {
        *layout == Layout::Labelled && path.is_file() && !is_signals(path)
    };
    if found.takes_tables && !found.candidates.iter().any(is_labelled_table) {
        return Err(ListingError::NoTable { path: first, layout });
    }
    let mut skipped = found.skipped;
    let mut unit = layout.unit().unwrap_or_default().to_owned();
    let candidates: Vec<PathBuf> = found.candidates.into_iter().map(|(_, path)| path).collect();
    let recordings = match layout {
        Layout::ThreeDc => three_dc_recordings(&candidates, &mut skipped)?,
        Layout::OzdemirMat => {
            check_filtered(settings, &candidates)?;
            mat_recordings(&candidates, &mut skipped)?
        }
        Layout::OzdemirTrials => {
            check_filtered(settings, &candidates)?;
            trial_recordings(&candidates)?
        }
        Layout::Labelled => labelled_recordings(settings, &candidates, &mut skipped, &mut unit)?,
    };
    if recordings.is_empty() {
        let first_reason = skipped.first().map_or("they hold no trials".to_owned(), ToString::to_string);
        return Err(ListingError::NoneUsable { first_reason });
    }
    Ok(Recordings { layout, recordings, skipped, unit })
}

/// Folders and files by their names.
#[derive(Default)]
struct Found {
    /// Whether tables say themselves what was done.
    takes_tables: bool,
    candidates: Vec<(Layout, PathBuf)>,
    /// The candidates as the system names them.
    seen: BTreeSet<PathBuf>,
    /// The folders below the present path that were looked into, as the system names them.
    entered: BTreeSet<PathBuf>,
    skipped: Vec<SkippedEntry>,
}

impl Found {
    /// Looks at `path` and below; the result is how many candidates are there.
    fn gather(&mut self, path: &Path, is_given: bool) -> Result<usize, ListingError> {
        if path.is_dir() {
            // Links lead to the same folder twice, or back up.
            if !self.entered.insert(real(path)) {
                return Ok(0);
            }
            if three_dc::origin_through_links(path).is_some() {
                if !three_dc::holds_emg(path)? {
                    self.skip(path, SkippedKind::OtherFile, "it holds no EMG");
                    return Ok(0);
                }
                return Ok(self.add(Layout::ThreeDc, path));
            }
            if path.join(labels::FILE_NAME).is_file() {
                return Ok(self.add(Layout::Labelled, path));
            }
            let mut count = 0;
            let (links, others): (Vec<_>, Vec<_>) =
                entries(path)?.into_iter().partition(|entry| entry.is_symlink());
            // A folder is known by its own name rather than by that of a link.
            for entry in others.iter().chain(&links) {
                count += self.gather(entry, false)?;
            }
            return Ok(count);
        }
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mat")) {
            return Ok(self.add(Layout::OzdemirMat, path));
        }
        if ozdemir::trial_of_name(path).is_some() {
            return Ok(self.add(Layout::OzdemirTrials, path));
        }
        if is_signals(path) {
            return Ok(self.add(Layout::Labelled, path));
        }
        if path.file_name().is_some_and(|name| name == labels::FILE_NAME) {
            return Ok(self.add(Layout::Labelled, path.parent().unwrap_or(Path::new("."))));
        }
        if is_given {
            path.metadata().map_err(unreadable(path))?;
        }
        // Texts of other kinds, such as a README.txt, lie beside recordings.
        let is_three_dc = three_dc::parse_file_name(path).is_some();
        let is_text =
            !is_given && path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("txt"));
        if self.takes_tables && is_table(path) && !is_three_dc {
            return Ok(self.add(Layout::Labelled, path));
        }
        if is_three_dc {
            self.skip(
                path,
                SkippedKind::OtherFile,
                "its folder is not ParticipantP/train/EMG or ParticipantP/test/EMG",
            );
        } else if is_table(path) && !is_text {
            self.skip(path, SkippedKind::NoLabel, &unlabelled(path));
        }
        Ok(0)
    }

    fn add(&mut self, layout: Layout, path: &Path) -> usize {
        if self.seen.insert(real(path)) {
            self.candidates.push((layout, path.to_owned()));
        } else {
            self.skip(path, SkippedKind::Twice, "it was given twice and is used once");
        }
        1
    }

    fn skip(&mut self, path: &Path, kind: SkippedKind, reason: &str) {
        self.skipped.push(SkippedEntry { path: path.to_owned(), kind, reason: reason.to_owned() });
    }
}

/// What to do with a table of which nothing says what it shows.
fn unlabelled(table: &Path) -> String {
    let labels = table.with_file_name(labels::FILE_NAME);
    if labels.is_file() {
        return format!("give its folder, so that {} says what it shows", labels.display());
    }
    format!(
        "its name is not P<person>_C<cycle>_G<gesture>.csv, and no labels.csv names it: write one beside it, with the \
         header {} and a line for each trial, and give the folder; or, if a column of it says what was done, name that with \
         --label-column",
        labels::COLUMNS.join(",")
    )
}

fn unreadable(path: &Path) -> impl FnOnce(io::Error) -> ListingError + '_ {
    |reason| RecordingError::Open { path: path.to_owned(), reason }.into()
}

/// A file or folder as the system names it, without links.
fn real(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

/// What a folder holds, in order.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, ListingError> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable(folder))? {
        entries.push(entry.map_err(unreadable(folder))?.path());
    }
    entries.sort();
    Ok(entries)
}

/// The repetitions in EMG folders.
fn three_dc_recordings(
    folders: &[PathBuf],
    skipped: &mut Vec<SkippedEntry>,
) -> Result<Vec<Recording>, ListingError> {
    let mut by_origin = BTreeMap::new();
    for folder in folders {
        let Some(origin) = three_dc::origin_through_links(folder) else { continue };
        if let Some(first) = by_origin.insert(origin, folder) {
            let (person, session) = origin;
            let what = format!("the {} session of person {person}", session.name());
            return Err(ListingError::Twice { what, first: first.clone(), second: folder.clone() });
        }
    }
    let mut recordings = Vec::new();
    for ((person, session), folder) in by_origin {
        let repetitions = three_dc::repetitions(folder)?;
        let names = "3dc_EMG_gesture_R_G.txt with R from 0 and G from 0 to 10";
        if repetitions.is_empty() {
            let reason = format!("it holds no files {names}");
            skipped.push(SkippedEntry { path: folder.clone(), kind: SkippedKind::NoTrial, reason });
        }
        for path in entries(folder)? {
            if is_table(&path) && three_dc::parse_file_name(&path).is_none() {
                let reason = format!("its name is not {names}");
                skipped.push(SkippedEntry { path, kind: SkippedKind::OtherFile, reason });
            }
        }
        recordings.extend(repetitions.into_iter().map(|repetition| Recording {
            path: folder.clone(),
            person: person.into(),
            session: session.name().to_owned(),
            repetitions_before: session.repetitions_before(),
            content: Content::ThreeDc { repetition },
        }));
    }
    Ok(recordings)
}

/// Refuses recordings whose folders say that they were filtered before if they are to be filtered, and those that
/// were not if they are not.
fn check_filtered(settings: &DatasetSettings, files: &[PathBuf]) -> Result<(), ListingError> {
    let is_filtered = settings.filter.is_none();
    match files.iter().find(|file| ozdemir::is_filtered(file) == Some(!is_filtered)) {
        Some(file) if is_filtered => Err(ListingError::NotFiltered { file: file.clone() }),
        Some(file) => Err(ListingError::Filtered { file: file.clone() }),
        None => Ok(()),
    }
}

/// Session of layouts that have only one.
const ONLY_SESSION: &str = "1";

fn mat_recordings(
    files: &[PathBuf],
    skipped: &mut Vec<SkippedEntry>,
) -> Result<Vec<Recording>, ListingError> {
    let mut by_person = BTreeMap::new();
    for file in files {
        let reason = match ozdemir::person(file) {
            Ok(Some(person)) => match by_person.insert(person, file) {
                None => continue,
                Some(first) => {
                    let what = format!("person {person}");
                    return Err(ListingError::Twice { what, first: first.clone(), second: file.clone() });
                }
            },
            Ok(None) => "neither its variable iD nor a number in its name identifies the person".to_owned(),
            Err(error) => error.below(file),
        };
        skipped.push(SkippedEntry { path: file.clone(), kind: SkippedKind::Unreadable, reason });
    }
    let recording = |(person, file): (u16, &PathBuf)| Recording {
        path: file.clone(),
        person: person.into(),
        session: ONLY_SESSION.to_owned(),
        repetitions_before: 0,
        content: Content::OzdemirMat,
    };
    Ok(by_person.into_iter().map(recording).collect())
}

fn trial_recordings(files: &[PathBuf]) -> Result<Vec<Recording>, ListingError> {
    let mut by_trial = BTreeMap::new();
    for file in files {
        let Some(trial) = ozdemir::trial_of_name(file) else { continue };
        if let Some(first) = by_trial.insert(trial, file) {
            let ozdemir::Trial { person, cycle, gesture } = trial;
            let what = format!("gesture {gesture} of cycle {cycle} of person {person}");
            return Err(ListingError::Twice { what, first: first.clone(), second: file.clone() });
        }
    }
    let recording = |(trial, file): (ozdemir::Trial, &PathBuf)| Recording {
        path: file.clone(),
        person: trial.person.into(),
        session: ONLY_SESSION.to_owned(),
        repetitions_before: 0,
        content: Content::Table {
            segments: vec![Segment {
                file: file.clone(),
                repetition: Some(trial.cycle.into()),
                cue: ozdemir::gesture(trial.gesture),
                end_sample: None,
                samples_lost_before: 0,
            }],
            default_hz: Some(ozdemir::SAMPLE_RATE_HZ),
            units: Units::default(),
        },
    };
    Ok(by_trial.into_iter().map(recording).collect())
}

/// Whom the recorder of earlier versions labelled everybody's recordings with; whose they are stands beside the labels.
const EARLIER_RECORDER: PersonId = PersonId::Number(1);

/// Whether nothing in a table tells its sampling rate. What else is wrong with it shows when it is read.
fn tells_no_rate(file: &LabelledFile) -> bool {
    let opened = RecordingSource::of_table(file.segments.clone(), &[Channel::Index(0)], None);
    matches!(opened, Err(RecordingError::SampleRateMissing { .. }))
}

fn labelled_recordings(
    settings: &DatasetSettings,
    folders: &[PathBuf],
    skipped: &mut Vec<SkippedEntry>,
    unit: &mut String,
) -> Result<Vec<Recording>, ListingError> {
    // Each with the rate that its folder states, and its unit.
    let mut files: Vec<(LabelledFile, Option<f64>, String)> = Vec::new();
    let mut folder_of_file = BTreeMap::new();
    for folder in folders {
        if folder.is_file() {
            match own_cues(settings, folder, skipped) {
                Ok((file, own_unit)) => {
                    let own_unit = take_unit(folder, &own_unit, unit, skipped);
                    files.extend(own_unit.map(|own_unit| (file, None, own_unit)));
                }
                Err(entry) => skipped.push(entry),
            }
            continue;
        }
        let recorded = RecordedSession::read(folder)?;
        let default_hz = recorded.as_ref().map(|session| session.sample_rate_hz);
        for mut file in labels::read(folder, settings.recording_rate_hz.or(default_hz), skipped)? {
            let is_rate_known = settings.recording_rate_hz.or(default_hz).is_some();
            if !is_rate_known && !is_signals(&file.path) && tells_no_rate(&file) {
                return Err(ListingError::NoRate { labels: folder.join(labels::FILE_NAME) });
            }
            let own_unit = match &recorded {
                Some(recorded) => recorded.unit.clone(),
                None if is_signals(&file.path) => read_signals(settings, &file.path)?.unit,
                // What is wrong with a table shows when it is read.
                None => unit_of_table(&file.path, &settings.channels).unwrap_or_default(),
            };
            let Some(own_unit) = take_unit(&file.path, &own_unit, unit, skipped) else { continue };
            if let Some(session) = recorded.as_ref().filter(|_| file.person == EARLIER_RECORDER) {
                file.person = session.person;
            }
            if let Some(first) = folder_of_file.insert(real(&file.path), folder) {
                let what = file.path.display().to_string();
                return Err(ListingError::Twice { what, first: first.clone(), second: folder.clone() });
            }
            files.push((file, default_hz, own_unit));
        }
    }
    // Of each person the sessions, in the order in which they are named, and how many repetitions a session has.
    let mut sessions: BTreeMap<PersonId, (Vec<String>, u32)> = BTreeMap::new();
    for (file, ..) in &files {
        let (names, repetitions) = sessions.entry(file.person).or_default();
        if !names.contains(&file.session) {
            names.push(file.session.clone());
        }
        *repetitions = (*repetitions).max(file.last_repetition() + 1);
    }
    let mut recordings = Vec::new();
    for (LabelledFile { path, person, session, segments }, default_hz, own) in files {
        let (names, repetitions) = &sessions[&person];
        if names.len() as u32 * repetitions > u32::from(u8::MAX) + 1 {
            return Err(ListingError::TooManyRepetitions { person });
        }
        let place = names.iter().position(|name| *name == session).unwrap_or(0) as u32;
        let units = Units { own, wanted: unit.clone() };
        let content = match is_signals(&path) {
            // Those of the folder's labels; its own cues are found again when it is opened.
            true => {
                let segments = folder_of_file.contains_key(&real(&path)).then_some(segments);
                Content::Signals { segments, units }
            }
            false => Content::Table { segments, default_hz, units },
        };
        recordings.push(Recording {
            path,
            person,
            session,
            repetitions_before: place * repetitions,
            content,
        });
    }
    Ok(recordings)
}

/// A file that says itself what was done when, and its unit, or why it cannot be used. Labels that are left out of it are listed.
fn own_cues(
    settings: &DatasetSettings,
    file: &Path,
    skipped: &mut Vec<SkippedEntry>,
) -> Result<(LabelledFile, String), SkippedEntry> {
    let entry = |kind, reason: String| SkippedEntry { path: file.to_owned(), kind, reason };
    let read = if is_signals(file) {
        read_signals(settings, file).map(|signals| (signals.segments(file), signals.unit, Vec::new()))
    } else {
        labelled_table(settings, file)
    };
    let (segments, own_unit, notices) = read.map_err(|error| match error {
        RecordingError::SampleRateMissing { .. } => entry(
            SkippedKind::Unreadable,
            "it does not state its sampling rate: give it with --recording-rate-hz, e.g. 2000".to_owned(),
        ),
        error => entry(SkippedKind::Unreadable, error.below(file)),
    })?;
    if segments.iter().all(|segment| segment.cue.is_none()) {
        return Err(entry(
            SkippedKind::NoLabel,
            "no annotation or marker in it names a gesture: write a labels.csv beside it that says what it shows".to_owned(),
        ));
    }
    let (person, session) = labels::origin_of_name(file).ok_or_else(|| {
        entry(
            SkippedKind::Person,
            format!(
                "neither its name nor its folder's says whose it is: call it sub-PERSON_….{}, or put it into a folder with the \
                 person's name",
                file.extension().unwrap_or_default().display()
            ),
        )
    })?;
    skipped.extend(notices.iter().filter_map(|notice| match notice {
        Notice::LabelsLeftOut { column, labels, .. } => {
            Some(entry(SkippedKind::OtherLabels, labels_left_out(column, labels)))
        }
        _ => None,
    }));
    Ok((LabelledFile { path: file.to_owned(), person, session, segments }, own_unit))
}

/// The canonical spelling of a file's unit `own`, which becomes `unit` if that is empty; `None` if it cannot be converted to
/// `unit`, so that the file cannot be used. Says if it is to be converted.
fn take_unit(file: &Path, own: &str, unit: &mut String, skipped: &mut Vec<SkippedEntry>) -> Option<String> {
    let own = canonical_unit(own);
    if unit.is_empty() {
        own.clone_into(unit);
    }
    if !own.is_empty() && own != unit {
        let is_convertible = unit_factor(own, unit).is_ok();
        let (kind, reason) = match is_convertible {
            true => (
                SkippedKind::Notice,
                format!("its samples are in {own} and are converted to {unit}, as the first has it"),
            ),
            false => (
                SkippedKind::Other,
                format!("its samples are in {own}, those of others in {unit}: give them separately"),
            ),
        };
        skipped.push(SkippedEntry { path: file.to_owned(), kind, reason });
        if !is_convertible {
            return None;
        }
    }
    Some(own.to_owned())
}

/// A file that describes itself, with its unit. Where nobody has chosen yet, the channels of `settings` may not be there: then
/// its first one, of which the unit says nothing about EMG.
fn read_signals(settings: &DatasetSettings, file: &Path) -> Result<Signals, RecordingError> {
    Signals::read(file, &settings.channels).or_else(|_| {
        let mut first = Signals::read(file, &[Channel::Index(0)])?;
        first.unit.clear();
        Ok(first)
    })
}

/// The trials of a table by its column of labels, its unit, and what its user should know. Where nobody has chosen yet, the
/// channels of `settings` may not be there: then its unit is not known.
fn labelled_table(
    settings: &DatasetSettings,
    file: &Path,
) -> Result<(Vec<Segment>, String, Vec<Notice>), RecordingError> {
    let open = |channels: Vec<Channel>| {
        let settings = RecordingSettings {
            channels,
            sample_rate_hz: settings.recording_rate_hz,
            repetition: None,
            label_column: settings.label_column.clone(),
        };
        RecordingSource::open(file, &settings)
    };
    let (source, unit) = match open(settings.channels.clone()) {
        Ok(source) => {
            let unit = source.unit().to_owned();
            (source, unit)
        }
        Err(_) => {
            let mut channels = muscles(file, settings.label_column.as_ref())?;
            channels.truncate(1);
            if channels.is_empty() {
                channels.push(Channel::Index(0));
            }
            (open(channels)?, String::new())
        }
    };
    Ok((source.segments().to_vec(), unit, source.notices().to_vec()))
}
