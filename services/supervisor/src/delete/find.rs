//! What is kept of a person in a folder and all folders below. Links are never followed, so nothing outside is found.

use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use anyhow::ensure;
use serde_json::Value;
use tendon_classifier::trained_on;
use tendon_export::{TABLES, is_unfinished_export, participant_of};
use tendon_features::Cohort;
use tendon_output::{OutputFile, is_temporary};
use tendon_people::{PersonName, name_in};
use tendon_recordings::RecordedSession;
use tendon_session_file::{FILE_NAME, Head, PERSON, is_session_file};

use super::bytes_below;

/// Folders below folders that are looked through.
const DEEPEST: usize = 32;
/// Largest file whose text is looked at.
const LARGEST_TEXT: u64 = 64 << 20;

/// The file that a data set has beside its manifest.
const WINDOWS: &str = "windows.npy";

/// Something that is kept of a person.
#[derive(Debug)]
pub struct Kept {
    pub path: PathBuf,
    pub what: &'static str,
    pub bytes: u64,
    how: How,
}

/// How it is deleted.
#[derive(Debug)]
enum How {
    /// The file, and its folder if that is empty then.
    File,
    /// The folder with all that is in it.
    Folder,
    /// These files of the folder, and the folder if it is empty then.
    Files(Vec<PathBuf>),
    /// A person of a BIDS data set: the folder, and the line of the table.
    Participant { table: PathBuf, id: String },
}

impl Kept {
    /// Deletes it. What is gone already is no failure.
    pub fn delete(&self) -> std::io::Result<()> {
        match &self.how {
            How::File => {
                gone(fs::remove_file(&self.path))?;
                self.path.parent().into_iter().for_each(remove_if_empty);
                Ok(())
            }
            How::Folder => gone(fs::remove_dir_all(&self.path)),
            How::Files(files) => {
                files.iter().try_for_each(|file| gone(fs::remove_file(file)))?;
                // A file in a BIDS data set lies in folders of its subject, its session and its kind.
                let depth = if files.contains(&self.path) { 4 } else { 1 };
                self.path.ancestors().take(depth).for_each(remove_if_empty);
                Ok(())
            }
            How::Participant { table, id } => {
                gone(fs::remove_dir_all(&self.path))?;
                let text = fs::read_to_string(table)?;
                let others = text.lines().filter(|line| line.split('\t').next() != Some(id));
                let others: String = others.map(|line| format!("{line}\n")).collect();
                let table = OutputFile::check(table).map_err(std::io::Error::other)?.private();
                table.write_bytes(others.as_bytes()).map_err(std::io::Error::other)
            }
        }
    }
}

fn gone(result: std::io::Result<()>) -> std::io::Result<()> {
    result.or_else(|error| if error.kind() == ErrorKind::NotFound { Ok(()) } else { Err(error) })
}

fn remove_if_empty(folder: &Path) {
    // One that is not empty stays.
    let _ = fs::remove_dir(folder);
}

/// What was found.
#[derive(Debug, Default)]
pub struct Found {
    pub kept: Vec<Kept>,
    /// What learnt from the person, and others with it.
    pub left: Vec<(PathBuf, String)>,
    /// What could not be looked at, and why.
    pub unknown: Vec<(PathBuf, String)>,
}

impl Found {
    /// Takes the folder in which a person is kept, if it is there.
    pub fn take_person(&mut self, folder: &Path) -> anyhow::Result<()> {
        match folder.symlink_metadata() {
            Err(_) => Ok(()),
            Ok(metadata) => {
                ensure!(
                    metadata.is_dir(),
                    "{} is a link, or no folder: remove it yourself, with what it points to",
                    folder.display()
                );
                self.add(folder, "person and recordings of the calibration", How::Folder);
                Ok(())
            }
        }
    }

    /// Looks through `folder` and all folders below. What cannot be looked at is named in `unknown`.
    pub fn search(&mut self, folder: &Path, name: &PersonName) {
        self.search_to(folder, name, DEEPEST);
    }

    fn search_to(&mut self, folder: &Path, name: &PersonName, deepest: usize) {
        if self.kept.iter().any(|kept| folder.starts_with(&kept.path) && matches!(kept.how, How::Folder)) {
            return;
        }
        if is_unfinished_export(folder) {
            self.take_unfinished(folder, name);
            return;
        }
        if self.take_folder(folder, name) {
            return;
        }
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) => return self.cannot_read(folder, &error),
        };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        for path in paths {
            let Ok(metadata) = path.symlink_metadata() else { continue };
            if metadata.is_dir() && deepest > 0 {
                self.search_to(&path, name, deepest - 1);
            } else if metadata.is_file() {
                self.take_file(&path, name);
            }
        }
    }

    /// Takes what an export of the person that was killed has left.
    fn take_unfinished(&mut self, folder: &Path, name: &PersonName) {
        let session = json(&folder.join("session.json"));
        let participants = text(&folder.join("participants.tsv"));
        if session.is_none() && participants.is_none() {
            let why = "an export that was broken off; it does not tell whose it is".to_owned();
            return note(&mut self.unknown, folder, why);
        }
        let is_table = session.is_some_and(|session| session["person"] == name.as_str());
        let participant = participants.and_then(|text| participant_of(&text, name.as_str()));
        if is_table || participant.is_some_and(|id| folder.join(id).is_dir()) {
            self.add(folder, "an export that was broken off", How::Folder);
        }
    }

    /// Takes a folder that is the person's as a whole; whether it is.
    fn take_folder(&mut self, folder: &Path, name: &PersonName) -> bool {
        if RecordedSession::read(folder)
            .is_ok_and(|session| session.is_some_and(|session| session.person == name.id()))
        {
            self.add(folder, "recordings of a calibration", How::Folder);
            return true;
        }
        let of_person = |json: &Value| json["person"] == name.as_str() && json["recording"].is_object();
        if json(&folder.join("session.json")).is_some_and(|json| of_person(&json)) {
            let files = TABLES.iter().map(|table| folder.join(table)).filter(|file| file.is_file()).collect();
            self.add(folder, "a session as tables", How::Files(files));
        }
        let table = folder.join("participants.tsv");
        let participant = text(&table).and_then(|text| participant_of(&text, name.as_str()));
        if let Some(id) = participant {
            let path = folder.join(&id);
            if path.symlink_metadata().is_ok_and(|metadata| metadata.is_dir()) {
                self.add(&path, "sessions in a BIDS data set", How::Participant { table, id });
            }
        }
        false
    }

    fn take_file(&mut self, path: &Path, name: &PersonName) {
        let is_covered = |kept: &Kept| match &kept.how {
            How::Files(files) => files.iter().any(|file| file == path),
            How::Folder | How::Participant { .. } => path.starts_with(&kept.path),
            How::File => false,
        };
        if self.kept.iter().any(is_covered) {
            return;
        }
        let name_of_file = path.file_name().unwrap_or_default();
        let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        // Whatever its name, it may hold a session.
        if let Err(error) = tendon_input::open(path) {
            return self.cannot_read(path, &error);
        }
        if is_session_file(path) || name_of_file == FILE_NAME {
            return self.take_recording(path, name);
        }
        match ending.as_str() {
            "xdf" if is_xdf_of(path, name) => self.add(path, "a session as XDF", How::File),
            "bdf" if is_bdf_of(path, name) => {
                self.add(path, "a session as BDF", How::Files(with_sidecars(path)));
            }
            "toml" | "person" if is_person_file_of(path, name) => self.add(path, "a person file", How::File),
            // What a program that was killed was writing.
            _ if is_temporary(name_of_file) && (is_xdf_of(path, name) || is_person_file_of(path, name)) => {
                self.add(path, "a file that was not written to its end", How::File);
            }
            "tendon-prior" => self.take_prior(path, name),
            "onnx" => self.take_model(path, name),
            "json" => self.take_data_set(path, name),
            _ => {}
        }
    }

    fn take_recording(&mut self, path: &Path, name: &PersonName) {
        let damaged = || "a recording that is damaged; it does not tell whose it is".to_owned();
        let Ok(mut head) = Head::read(path) else { return note(&mut self.unknown, path, damaged()) };
        match head.files.remove(PERSON).map(|person| name_in(&String::from_utf8_lossy(&person))) {
            Some(Some(person)) if person == *name => self.add(path, "a recorded session", How::File),
            Some(Some(_)) => {}
            None if head.is_whole => {}
            None | Some(None) => note(&mut self.unknown, path, damaged()),
        }
    }

    fn take_prior(&mut self, path: &Path, name: &PersonName) {
        let bytes = tendon_input::read(path, LARGEST_TEXT).ok();
        let Some(cohort) = bytes.and_then(|bytes| Cohort::from_bytes(&bytes).ok()) else { return };
        let members: Vec<bool> =
            cohort.members().map(|member| member.data_set.is_empty() && member.person == name.id()).collect();
        if members.iter().all(|is_person| *is_person) && !members.is_empty() {
            self.add(path, "a prior of this person alone", How::File);
        } else if members.contains(&true) {
            note(&mut self.left, path, format!("a prior that {name} has a part in"));
        }
    }

    fn take_model(&mut self, path: &Path, name: &PersonName) {
        let Ok(trained) = trained_on(path) else { return };
        let people = trained.people_of(None);
        if trained.is_own() && people.iter().all(|person| *person == name.id()) && !people.is_empty() {
            self.add(path, "a model of this person alone", How::File);
        } else if people.contains(&name.id()) {
            note(&mut self.left, path, format!("a model that was trained on {name}"));
        }
    }

    /// Takes a data set by its manifest.
    fn take_data_set(&mut self, path: &Path, name: &PersonName) {
        let Some(manifest) = json(path).filter(|json| json["data_set"].is_null()) else { return };
        let Some(people) = manifest["windows_per_person"].as_object() else { return };
        if !people.contains_key(name.as_str()) {
            return;
        }
        let folder = path.parent().filter(|folder| folder.join(WINDOWS).is_file());
        match folder {
            Some(folder) if people.len() == 1 => {
                let files = tendon_dataset::FILES.iter().map(|file| folder.join(file));
                let files = files.filter(|file| file.is_file()).collect();
                self.add(folder, "a data set of this person alone", How::Files(files));
            }
            _ => note(&mut self.left, path, format!("a data set with windows of {name}")),
        }
    }

    fn cannot_read(&mut self, path: &Path, error: &std::io::Error) {
        // Of a process that ended meanwhile, for instance.
        if error.kind() != ErrorKind::NotFound {
            note(&mut self.unknown, path, error.to_string());
        }
    }

    fn add(&mut self, path: &Path, what: &'static str, how: How) {
        if self.kept.iter().any(|kept| kept.path == path) {
            return;
        }
        let bytes = match &how {
            How::Files(files) => files.iter().map(|file| bytes_below(file)).sum(),
            How::File | How::Folder | How::Participant { .. } => bytes_below(path),
        };
        self.kept.push(Kept { path: path.to_owned(), what, bytes, how });
    }
}

/// Notes something about a path. It may be found twice, in folders that overlap.
fn note(notes: &mut Vec<(PathBuf, String)>, path: &Path, text: String) {
    if notes.iter().all(|(known, _)| known != path) {
        notes.push((path.to_owned(), text));
    }
}

fn is_xdf_of(path: &Path, name: &PersonName) -> bool {
    let beginning = beginning(path);
    beginning.starts_with("XDF:") && beginning.contains(&format!("<person>{name}</person>"))
}

fn is_person_file_of(path: &Path, name: &PersonName) -> bool {
    let text = text(path).filter(|text| text.starts_with("format = \"tendon-person\""));
    text.and_then(|text| name_in(&text)).as_ref() == Some(name)
}

/// Whether it is a session of the person that Tendon exported, wherever it lies: its header names patient and equipment.
fn is_bdf_of(path: &Path, name: &PersonName) -> bool {
    let beginning = beginning(path);
    beginning.contains(&format!("BIOSEMI{name} X X X ")) && beginning.contains(" X X Tendon")
}

/// The file, and those beside it of the same recording: `sub-anna_task-zones_emg.bdf`, `…_events.tsv`.
fn with_sidecars(recording: &Path) -> Vec<PathBuf> {
    let file = recording.file_name().unwrap_or_default().to_string_lossy();
    let Some(beginning) = file.strip_suffix("emg.bdf") else { return vec![recording.to_owned()] };
    let beside =
        recording.parent().and_then(|folder| fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let is_of_it =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(beginning));
    beside.map(|entry| entry.path()).filter(is_of_it).collect()
}

fn text(path: &Path) -> Option<String> {
    // Its own folder was found without links, and so is it.
    let is_file = path.symlink_metadata().is_ok_and(|metadata| metadata.is_file());
    if is_file { tendon_input::read_text(path, LARGEST_TEXT).ok() } else { None }
}

fn json(path: &Path) -> Option<Value> {
    serde_json::from_str(&text(path)?).ok()
}

/// The first kilobytes of a file, as text.
fn beginning(path: &Path) -> String {
    let mut bytes = Vec::new();
    let read = tendon_input::open(path).and_then(|file| file.take(4096).read_to_end(&mut bytes));
    if read.is_err() { String::new() } else { String::from_utf8_lossy(&bytes).into_owned() }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use tendon_session_file::{CONFIGURATION, Writer};

    use super::*;

    fn session_of(file: &Path, person: &str) {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        let mut writer = Writer::begin(fs::File::create(file).unwrap(), "test", 0).unwrap();
        writer.attach(CONFIGURATION, "application/toml", b"session = \"test\"\n").unwrap();
        let text = format!("format = \"tendon-person\"\nversion = 1\n\nname = \"{person}\"\n");
        writer.attach(PERSON, "application/octet-stream", text.as_bytes()).unwrap();
        writer.finish().unwrap();
        fs::write(file.with_extension("toml"), text).unwrap();
    }

    fn write(file: &Path, text: &str) {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, text).unwrap();
    }

    #[test]
    fn all_that_names_the_person_is_found_and_deleted_and_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let (inside, outside) = (place.path().join("inside"), place.path().join("outside"));
        session_of(&inside.join("a/session.mcap"), "anna");
        session_of(&inside.join("b/session.mcap"), "anna-2");
        session_of(&outside.join("session.mcap"), "anna");
        symlink(&outside, inside.join("link")).unwrap();
        symlink(outside.join("session.mcap"), inside.join("linked.mcap")).unwrap();
        write(&inside.join("anna/person.toml"), "format = \"tendon-person\"\n");
        symlink(&outside, inside.join("anna/link")).unwrap();
        write(&inside.join("tables/session.json"), r#"{"person":"anna","recording":{}}"#);
        write(&inside.join("tables/signal.csv"), "time_s\n");
        write(&inside.join("tables/mine.txt"), "mine");
        write(
            &inside.join("study/participants.tsv"),
            "participant_id\tpseudonym\nsub-anna\tanna\nsub-ben\tben\n",
        );
        write(&inside.join("study/sub-anna/emg/anna.bdf"), "");
        write(&inside.join("study/sub-ben/emg/ben.bdf"), "");
        write(&inside.join("s.xdf"), "XDF:<info><person>anna</person></info>");
        write(&inside.join("other.xdf"), "XDF:<info><person>anna-2</person></info>");
        write(
            &inside.join("set/manifest.json"),
            r#"{"data_set":null,"windows_per_person":{"anna":3,"ben":4}}"#,
        );
        let name: PersonName = "anna".parse().unwrap();
        let mut found = Found::default();
        found.take_person(&inside.join("anna")).unwrap();
        found.search(&inside, &name);
        // Once more, as with a folder that is named twice.
        found.search(&inside, &name);
        let mut paths: Vec<&Path> =
            found.kept.iter().map(|kept| kept.path.strip_prefix(&inside).unwrap()).collect();
        paths.sort();
        let expected = ["a/session.mcap", "a/session.toml", "anna", "s.xdf", "study/sub-anna", "tables"];
        assert_eq!(paths, expected.map(Path::new));
        assert_eq!(found.left.len(), 1, "{:?}", found.left);
        assert!(found.left[0].0.ends_with("set/manifest.json"));
        found.kept.iter().for_each(|kept| kept.delete().unwrap());
        for gone in ["a", "anna", "s.xdf", "study/sub-anna", "tables/session.json", "tables/signal.csv"] {
            assert!(!inside.join(gone).exists(), "{gone}");
        }
        for stays in [
            "b/session.mcap",
            "tables/mine.txt",
            "study/sub-ben/emg/ben.bdf",
            "other.xdf",
            "set/manifest.json",
        ] {
            assert!(inside.join(stays).exists(), "{stays}");
        }
        assert!(outside.join("session.mcap").exists());
        let participants = fs::read_to_string(inside.join("study/participants.tsv")).unwrap();
        assert_eq!(participants, "participant_id\tpseudonym\nsub-ben\tben\n");
        let mut again = Found::default();
        again.search(&inside, &name);
        assert!(again.kept.is_empty(), "{:?}", again.kept);
        // A person whose folder is a link is left to its owner.
        symlink(&outside, inside.join("anna")).unwrap();
        assert!(again.take_person(&inside.join("anna")).is_err());
    }

    #[test]
    fn what_is_damaged_or_unfinished_or_cannot_be_read_is_deleted_or_named() {
        let place = tempfile::tempdir().unwrap();
        let inside = place.path();
        session_of(&inside.join("whole/session.mcap"), "anna");
        let bytes = fs::read(inside.join("whole/session.mcap")).unwrap();
        let text = bytes.windows(4).position(|part| part == b"anna").unwrap();
        for (folder, place) in [("person", text), ("magic", 1), ("profile", 20)] {
            let mut damaged = bytes.clone();
            damaged[place] ^= 1;
            fs::create_dir(inside.join(folder)).unwrap();
            fs::write(inside.join(folder).join("session.mcap"), damaged).unwrap();
        }
        for copy in ["session.mcap.bak", "session", "x.bin"] {
            fs::write(inside.join("whole").join(copy), &bytes).unwrap();
        }
        session_of(&inside.join("other/session.mcap"), "ben");
        fs::copy(inside.join("other/session.mcap"), inside.join("other/session.bak")).unwrap();
        write(&inside.join("tables/.tendon-a1b2c3/session.json"), r#"{"person":"anna","recording":{}}"#);
        write(&inside.join("tables/.tendon-a1b2c3/signal.csv"), "time_s\n");
        let people = "participant_id\tpseudonym\nsub-anna\tanna\nsub-ben\tben\n";
        for (folder, subject) in [("study/.tendon-a1b2c3", "sub-anna"), ("study/.tendon-d4e5f6", "sub-ben")] {
            write(&inside.join(folder).join("participants.tsv"), people);
            write(&inside.join(folder).join(subject).join("emg/x_emg.bdf"), "");
        }
        write(&inside.join("old/.tendon-a1b2c3/signal.csv"), "time_s\n");
        write(&inside.join(".tendon-x1y2z3"), "XDF:<info><person>anna</person></info>");
        // Of a data set whose table of people was emptied.
        let bdf = "BIOSEMIanna X X X                Startdate 04-MAY-2026 X X Tendon_1.2.3";
        write(&inside.join("lost/sub-anna/ses-1/emg/sub-anna_ses-1_task-a_emg.bdf"), bdf);
        write(&inside.join("lost/sub-anna/ses-1/emg/sub-anna_ses-1_task-a_events.tsv"), "");
        write(&inside.join("lost/participants.tsv"), "");
        write(&inside.join("set/manifest.json"), r#"{"data_set":null,"windows_per_person":{"anna":3}}"#);
        write(&inside.join("set/windows.npy"), "");
        let name: PersonName = "anna".parse().unwrap();
        let mut found = Found::default();
        found.search(inside, &name);
        found.cannot_read(&inside.join("locked"), &ErrorKind::PermissionDenied.into());
        let relative = |paths: Vec<&PathBuf>| -> Vec<String> {
            let mut paths: Vec<String> = paths
                .iter()
                .map(|path| path.strip_prefix(inside).unwrap().to_string_lossy().into_owned())
                .collect();
            paths.sort();
            paths
        };
        assert_eq!(
            relative(found.kept.iter().map(|kept| &kept.path).collect()),
            [
                ".tendon-x1y2z3",
                "lost/sub-anna/ses-1/emg/sub-anna_ses-1_task-a_emg.bdf",
                "set",
                "study/.tendon-a1b2c3",
                "tables/.tendon-a1b2c3",
                "whole/session",
                "whole/session.mcap",
                "whole/session.mcap.bak",
                "whole/session.toml",
                "whole/x.bin",
            ]
        );
        assert_eq!(
            relative(found.unknown.iter().map(|(path, _)| path).collect()),
            [
                "locked",
                "magic/session.mcap",
                "old/.tendon-a1b2c3",
                "person/session.mcap",
                "profile/session.mcap"
            ]
        );
        assert!(found.left.is_empty(), "{:?}", found.left);
        found.kept.iter().for_each(|kept| kept.delete().unwrap());
        for gone in [
            ".tendon-x1y2z3",
            "lost/sub-anna",
            "set",
            "study/.tendon-a1b2c3",
            "tables/.tendon-a1b2c3",
            "whole",
        ] {
            assert!(!inside.join(gone).exists(), "{gone}");
        }
        assert!(inside.join("study/.tendon-d4e5f6").exists() && inside.join("other/session.mcap").exists());
    }
}
