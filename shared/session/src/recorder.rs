//! The recorder of a session as its supervisor sees it: started, told, heard, ended. Nobody waits for it while the session
//! runs.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use tendon_paths::{PathError, data_folder};
use tendon_session_file::{RecordingReport, RecordingStart, Said, Told};

use crate::children::Event;

/// How long the recorder may take to write what it still has before it is killed.
const END_TIMEOUT: Duration = Duration::from_secs(10);

/// Where recordings by key go, in the folder of the user's own data.
const OWN_FOLDER: &str = "sessions";

/// Whether and where a session is recorded.
#[derive(Clone, Debug)]
pub struct RecordingPlan {
    /// Where each recording gets a folder of its own, from the beginning of the session on; `None`: only when somebody presses
    /// the key, and then where the user's own data are.
    pub folder: Option<PathBuf>,
    /// What each recording begins with.
    pub start: RecordingStart,
}

impl RecordingPlan {
    /// Where a recording goes that begins now.
    pub(crate) fn folder(&self) -> Result<PathBuf, PathError> {
        match &self.folder {
            Some(folder) => Ok(folder.clone()),
            None => Ok(data_folder()?.path().join(OWN_FOLDER)),
        }
    }
}

/// Something that the recorder said.
#[derive(Debug)]
pub(crate) enum Heard {
    Said(Said),
    /// It closed its standard output.
    Closed,
}

/// A recorder that runs. Dropping it lets it finish its file by itself.
#[derive(Debug)]
pub(crate) struct Recorder {
    process: Child,
    /// `None` once it is to finish.
    told: Option<ChildStdin>,
    /// The line that it is told last.
    last: Option<String>,
    heard: Receiver<Heard>,
    relay: JoinHandle<String>,
    /// The file, once it records.
    path: Option<PathBuf>,
    report: Option<RecordingReport>,
}

impl Recorder {
    /// Starts it by `command`. What it says also shows as [`Event::Recorder`]; `relay` passes on its standard error.
    pub(crate) fn start(
        mut command: Command,
        folder: &Path,
        start: &RecordingStart,
        events: &Sender<Event>,
        relay: impl FnOnce(std::process::ChildStderr) -> std::io::Result<JoinHandle<String>>,
    ) -> std::io::Result<Recorder> {
        let mut process = command
            .arg("--folder")
            .arg(folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let pipes = (process.stdin.take(), process.stdout.take(), process.stderr.take());
        let (Some(told), Some(output), Some(errors)) = pipes else {
            unreachable!("all three were asked for as pipes")
        };
        let relay = relay(errors)?;
        let heard = hear(output, events.clone())?;
        let mut recorder =
            Recorder { process, told: Some(told), last: None, heard, relay, path: None, report: None };
        recorder.tell(&Told::Start(Box::new(start.clone())));
        if let Some(told) = &recorder.told {
            // From now on a recorder that hangs misses what it is told, and nobody waits for it.
            fcntl(told, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        }
        Ok(recorder)
    }

    /// Tells it something, unless it is to finish.
    pub(crate) fn tell(&mut self, told: &Told) {
        if let (Some(pipe), Ok(line)) = (&mut self.told, serde_json::to_string(told)) {
            // One that has ended is heard to have.
            let _ = pipe.write_all(format!("{line}\n").as_bytes());
        }
    }

    /// What it is told last, before it finishes its file.
    pub(crate) fn tell_last(&mut self, told: &Told) {
        self.last = serde_json::to_string(told).ok();
    }

    /// Lets it finish its file.
    pub(crate) fn let_finish(&mut self) {
        let Some(mut pipe) = self.told.take() else { return };
        let Some(line) = self.last.take() else { return };
        // It may be longer than the pipe holds. One that hangs is killed later, which ends this thread, too.
        let tell = move || {
            let _ = fcntl(&pipe, FcntlArg::F_SETFL(OFlag::empty()));
            let _ = pipe.write_all(format!("{line}\n").as_bytes());
        };
        let _ = std::thread::Builder::new().name("tell recorder".to_owned()).spawn(tell);
    }

    /// Whether it was told to finish.
    pub(crate) fn is_finishing(&self) -> bool {
        self.told.is_none()
    }

    /// The next that it said, without waiting.
    pub(crate) fn take_heard(&mut self) -> Option<Heard> {
        let heard = self.heard.try_recv().ok()?;
        self.remember(&heard);
        Some(heard)
    }

    /// The file, once it records.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// Its process id.
    pub(crate) fn process_id(&self) -> u32 {
        self.process.id()
    }

    /// Lets it finish, waits for that, and gives what came of the recording and how the process ended. Call it at once after
    /// [`Heard::Closed`], and at the end of a session.
    pub(crate) fn end(mut self) -> (Option<RecordingReport>, Option<ExitStatus>, String) {
        self.let_finish();
        let begun = Instant::now();
        while let Ok(heard) = self.heard.recv_timeout(END_TIMEOUT.saturating_sub(begun.elapsed())) {
            self.remember(&heard);
        }
        if begun.elapsed() >= END_TIMEOUT {
            // One that ended meanwhile needs no killing.
            let _ = self.process.kill();
        }
        let status = self.process.wait().ok();
        let last_words = self.relay.join().unwrap_or_default();
        let unfinished = self.path.map(|path| RecordingReport {
            bytes: std::fs::metadata(&path).map_or(0, |metadata| metadata.len()),
            path,
            error: Some(match status {
                Some(status) => format!("the recorder ended ({status})"),
                None => "the recorder is gone".to_owned(),
            }),
            ..RecordingReport::default()
        });
        (self.report.or(unfinished), status, last_words)
    }

    fn remember(&mut self, heard: &Heard) {
        match heard {
            Heard::Said(Said::Ready(path)) => self.path = Some(path.clone()),
            Heard::Said(Said::Ended(report)) => self.report = Some(report.clone()),
            Heard::Closed => {}
        }
    }
}

/// Listens to what the recorder says, in a thread.
fn hear(output: ChildStdout, events: Sender<Event>) -> std::io::Result<Receiver<Heard>> {
    let (sender, heard) = channel();
    std::thread::Builder::new().name("hear recorder".to_owned()).spawn(move || {
        let said = BufReader::new(output).lines().map_while(Result::ok);
        let said = said.filter_map(|line| serde_json::from_str(&line).ok()).map(Heard::Said);
        for heard in said.chain(std::iter::once_with(|| Heard::Closed)) {
            // Nobody listens any more once the session is over.
            if sender.send(heard).is_ok() {
                let _ = events.send(Event::Recorder);
            }
        }
    })?;
    Ok(heard)
}
