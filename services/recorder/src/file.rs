//! The file on the disk: where it lies, who may read it, and whether it is still there.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::BufWriter;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::{Context, ensure};
use tendon_session_file::{CONFIGURATION, FILE_NAME, Message, RecordingStart, Writer};
use tendon_transport::{SessionName, now_ns};

/// Largest model or person that is attached.
const LARGEST_ATTACHMENT: u64 = 200 << 20;
/// Sessions of one name that may begin in the same second.
const MOST_OF_A_SECOND: u32 = 100;

/// The file of a recording, for this user alone: it is a person's data.
#[derive(Debug)]
pub struct RecordingFile {
    path: PathBuf,
    /// Device and number of the file that is written to.
    identity: (u64, u64),
    writer: Writer<BufWriter<File>>,
}

impl RecordingFile {
    /// Makes `folder/WHEN-SESSION/session.mcap`, and `folder` if it is not there.
    pub fn create(folder: &Path, session: &SessionName) -> anyhow::Result<RecordingFile> {
        let private =
            |recursive, path: &Path| DirBuilder::new().recursive(recursive).mode(0o700).create(path);
        private(true, folder)
            .with_context(|| format!("cannot make the folder {} for the recording", folder.display()))?;
        let now = humantime::format_rfc3339_seconds(SystemTime::now()).to_string().replace(':', "-");
        let mut number = 1;
        let own = loop {
            let suffix = if number == 1 { String::new() } else { format!("-{number}") };
            let own = folder.join(format!("{now}-{session}{suffix}"));
            match private(false, &own) {
                Ok(()) => break own,
                Err(error)
                    if error.kind() == std::io::ErrorKind::AlreadyExists && number < MOST_OF_A_SECOND =>
                {
                    number += 1;
                }
                Err(error) => {
                    let place = format!("cannot make the folder {} for the recording", own.display());
                    return Err(error).context(place);
                }
            }
        };
        let file = RecordingFile::create_in(&own, session);
        if file.is_err() {
            remove_empty(&own);
        }
        file
    }

    fn create_in(own: &Path, session: &SessionName) -> anyhow::Result<RecordingFile> {
        let path = std::path::absolute(own.join(FILE_NAME)).context("cannot tell the current folder")?;
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&path)
            .with_context(|| format!("cannot make {}", path.display()))?;
        let metadata = file.metadata().with_context(|| format!("cannot look at {}", path.display()))?;
        let writer = Writer::begin(BufWriter::new(file), &session.to_string(), now_ns())
            .with_context(|| format!("cannot write {}", path.display()))?;
        Ok(RecordingFile { path, identity: (metadata.dev(), metadata.ino()), writer })
    }

    /// Removes the file and its folder: nothing was recorded.
    pub fn discard(self) {
        self.path.parent().into_iter().for_each(remove_empty);
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes what every file begins with.
    pub fn begin(&mut self, configuration: &str, start: &RecordingStart) -> anyhow::Result<()> {
        let provenance = serde_json::to_string(&start.provenance)?;
        let place = || format!("cannot write {}", self.path.display());
        self.writer.metadata("provenance", [("json", provenance)]).with_context(place)?;
        self.writer
            .attach(CONFIGURATION, "application/toml", configuration.as_bytes())
            .with_context(place)?;
        for (name, path) in &start.files {
            let bytes = tendon_input::read(path, LARGEST_ATTACHMENT)
                .with_context(|| format!("cannot read {} for the recording", path.display()))?;
            self.writer.attach(name, "application/octet-stream", &bytes).with_context(place)?;
        }
        self.flush()
    }

    /// Writes a message that was received then.
    pub fn write(&mut self, message: &Message, received_ns: u64) -> anyhow::Result<()> {
        self.writer
            .write(message, received_ns)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Writes JSON under a name.
    pub fn facts(&mut self, name: &str, json: String) -> anyhow::Result<()> {
        let written = self.writer.metadata(name, [("json", json)]);
        written.with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Closes the chunk, and looks whether the file is still where it was made.
    pub fn flush(&mut self) -> anyhow::Result<()> {
        self.writer.flush().with_context(|| format!("cannot write {}", self.path.display()))?;
        let there = std::fs::metadata(&self.path).ok().map(|metadata| (metadata.dev(), metadata.ino()));
        ensure!(
            there == Some(self.identity),
            "{} was deleted or moved while it was written",
            self.path.display()
        );
        Ok(())
    }

    /// Ends the file with its index.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.flush()?;
        self.writer.finish().with_context(|| format!("cannot write {}", self.path.display()))
    }
}

/// Removes the folder of a recording that could not begin. What cannot be removed stays; why it could not begin is what to tell.
fn remove_empty(own: &Path) {
    let _ = std::fs::remove_file(own.join(FILE_NAME));
    let _ = std::fs::remove_dir(own);
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use tendon_session_file::Head;

    use super::*;

    #[test]
    fn the_file_is_for_this_user_alone_and_two_of_a_second_do_not_meet() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("sessions");
        let session: SessionName = "tendon".parse().unwrap();
        let paths = [(); 3].map(|()| {
            let mut file = RecordingFile::create(&folder, &session).unwrap();
            file.begin("session = \"tendon\"", &RecordingStart::default()).unwrap();
            let path = file.path().to_owned();
            file.finish().unwrap();
            path
        });
        assert!(paths[0] != paths[1] && paths[1] != paths[2]);
        for path in paths {
            let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
            assert_eq!((mode(&path), mode(path.parent().unwrap())), (0o600, 0o700));
            assert_eq!(Head::read(&path).unwrap().configuration, "session = \"tendon\"");
        }
    }

    #[test]
    fn a_file_that_was_deleted_is_noticed_and_a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let session: SessionName = "tendon".parse().unwrap();
        let mut file = RecordingFile::create(folder.path(), &session).unwrap();
        file.flush().unwrap();
        std::fs::remove_file(file.path()).unwrap();
        assert!(file.flush().unwrap_err().to_string().contains("was deleted or moved"));
        let kept = std::fs::read_dir(folder.path()).unwrap().count();
        RecordingFile::create(folder.path(), &session).unwrap().discard();
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            kept,
            "one that could not begin leaves nothing"
        );
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, "").unwrap();
        let error = RecordingFile::create(&blocked.join("sessions"), &session).unwrap_err();
        assert!(error.to_string().contains("file/sessions"), "{error:#}");
    }
}
