//! What is kept of a person in a folder and all folders below. Links are never followed, so nothing outside is found.

use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use serde_json::Value;
use tendon_classifier::trained_on;
use tendon_export::{TABLES, participant_of};
use tendon_features::Cohort;
use tendon_output::OutputFile;
use tendon_people::{PersonName, name_in};
use tendon_recordings::RecordedSession;
use tendon_session_file::{Head, PERSON, is_session_file};

use super::bytes_below;

/// Folders below folders that are looked through.
const DEEPEST: usize = 32;
/// Largest file whose text is looked at.
const LARGEST_TEXT: u64 = 64 << 20;

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
                remove_if_empty(&self.path);
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

    /// Looks through `folder` and all folders below.
    pub fn search(&mut self, folder: &Path, name: &PersonName) -> anyhow::Result<()> {
        self.search_to(folder, name, DEEPEST)
    }

    fn search_to(&mut self, folder: &Path, name: &PersonName, deepest: usize) -> anyhow::Result<()> {
        if self.kept.iter().any(|kept| folder.starts_with(&kept.path) && matches!(kept.how, How::Folder)) {
            return Ok(());
        }
        if self.take_folder(folder, name) {
            return Ok(());
        }
        let entries =
            fs::read_dir(folder).with_context(|| format!("cannot look into {}", folder.display()))?;
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        for path in paths {
            let Ok(metadata) = path.symlink_metadata() else { continue };
            if metadata.is_dir() && deepest > 0 {
                self.search_to(&path, name, deepest - 1)?;
            } else if metadata.is_file() {
                self.take_file(&path, name);
            }
        }
        Ok(())
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
        let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        match ending.as_str() {
            "mcap" if is_session_file(path) => {
                let person = Head::read(path).ok().and_then(|mut head| head.files.remove(PERSON));
                let person = person.and_then(|person| name_in(&String::from_utf8_lossy(&person)));
                if person.as_ref() == Some(name) {
                    self.add(path, "a recorded session", How::File);
                }
            }
            "xdf" if beginning(path).contains(&format!("<person>{name}</person>")) => {
                self.add(path, "a session as XDF", How::File);
            }
            "toml" | "person" => {
                let text = text(path).filter(|text| text.starts_with("format = \"tendon-person\""));
                if text.and_then(|text| name_in(&text)).as_ref() == Some(name) {
                    self.add(path, "a person file", How::File);
                }
            }
            "tendon-prior" => {
                let cohort = tendon_input::read(path, LARGEST_TEXT)
                    .ok()
                    .and_then(|bytes| Cohort::from_bytes(&bytes).ok());
                let is_member = |cohort: Cohort| {
                    cohort.members().any(|member| member.data_set.is_empty() && member.person == name.id())
                };
                if cohort.is_some_and(is_member) {
                    self.leave(path, format!("a prior that {name} has a part in"));
                }
            }
            "onnx" => {
                let people = trained_on(path).map(|trained| trained.people_of(None).contains(&name.id()));
                if people.unwrap_or(false) {
                    self.leave(path, format!("a model that was trained on {name}"));
                }
            }
            "json" => {
                let of_person = |json: Value| json["windows_per_person"].get(name.as_str()).is_some();
                let is_own = |json: &Value| json["data_set"].is_null();
                if json(path).filter(is_own).is_some_and(of_person) {
                    self.leave(path, format!("a data set with windows of {name}"));
                }
            }
            _ => {}
        }
    }

    /// Says what stays. It may be found twice, in folders that overlap.
    fn leave(&mut self, path: &Path, what: String) {
        if self.left.iter().all(|(known, _)| known != path) {
            self.left.push((path.to_owned(), what));
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
        found.search(&inside, &name).unwrap();
        // Once more, as with a folder that is named twice.
        found.search(&inside, &name).unwrap();
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
        again.search(&inside, &name).unwrap();
        assert!(again.kept.is_empty(), "{:?}", again.kept);
        // A person whose folder is a link is left to its owner.
        symlink(&outside, inside.join("anna")).unwrap();
        assert!(again.take_person(&inside.join("anna")).is_err());
    }
}
