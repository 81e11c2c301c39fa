//! The recorder: an observer that writes a session to a file, and that nobody waits for.
//!
//! ```text
//! topics ──looked at every 10 ms──▶ this thread ─▶ bounded buffer ─▶ writing thread ─▶ FOLDER/WHEN-SESSION/session.mcap
//! tendon run ── standard input ───▶    │                               └─ closes a chunk every 0.4 s
//! tendon note ── socket ──────────▶    └── what did not fit, or came too fast, is counted and written as an event
//! ```
//!
//! In a session at full speed nothing that a stage decides by is lost: the publishers wait for this observer as for any other,
//! and it waits for the disk. States of the arm and measurements are not waited for. `tendon run` starts it; see
//! `tendon_session_file` for what they say to each other.

mod file;
mod topics;
mod writing;

use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Duration;

use anyhow::{Context, bail};
use clap::Parser;
use signal_hook::consts::{SIGTERM, SIGXFSZ};
use tendon_config::Config;
use tendon_process::{NoteSocket, keep_off_the_stages_core};
use tendon_session_file::{Event, EventKind, RecordingReport, RecordingStart, Said, TASK, Told};
use tendon_transport::{Delivery, Session, now_ns};

use crate::file::RecordingFile;
use crate::topics::Topics;
use crate::writing::{Item, WritingThread};

/// Time between two looks at the topics of a live session: the states of a moving arm come every 4 ms, and eight are kept.
const LIVE_LOOK: Duration = Duration::from_millis(10);
/// The same at full speed, where the publishers wait.
const LOSSLESS_LOOK: Duration = Duration::from_micros(500);

/// Command line, as `tendon run` gives it.
#[derive(Debug, Parser)]
#[command(version, about = "Records a Tendon session; `tendon run --record FOLDER` starts it.")]
struct Arguments {
    /// Configuration of the session.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Where a folder for this session is made.
    #[arg(long, value_name = "FOLDER")]
    folder: PathBuf,
}

fn main() -> ExitCode {
    match record(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "tendon recorder: error: {error:#}");
            ExitCode::from(2)
        }
    }
}

/// Records until standard input ends. What goes wrong once the file is there, its report says.
fn record(arguments: &Arguments) -> anyhow::Result<()> {
    let is_stopped = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(SIGTERM, is_stopped.clone()).context("cannot handle signals")?;
    // A limit on the size of files is then an error of writing, and no end of this process.
    signal_hook::flag::register(SIGXFSZ, Arc::default()).context("cannot handle signals")?;
    let configuration = tendon_input::read_text(&arguments.config, tendon_input::LARGEST_SETTINGS)
        .with_context(|| format!("cannot read {}", arguments.config.display()))?;
    let config = Config::parse(&configuration, &arguments.config)?;
    if config.delivery() == Delivery::Live {
        // Before any other thread begins.
        keep_off_the_stages_core();
    }
    let told = listen()?;
    let start = match told.recv() {
        Ok(Told::Start(start)) => start,
        _ => bail!(
            "the first line on standard input must be {{\"start\": …}}: `tendon run` starts this program"
        ),
    };
    let session = Session::join(&config.session, "recorder")?;
    let notes = NoteSocket::open(&config.session)?;
    let file = begin_file(arguments, &config, &configuration, &start)?;
    let path = file.path().to_owned();
    let is_lossless = config.delivery() == Delivery::Lossless;
    let writing = WritingThread::start(file, is_lossless).context("cannot start a thread")?;
    let topics = Topics::open(&session, &config)?;
    let mut recorder =
        Recorder { topics, writing, notes, told, is_stopped, is_lossless, is_ready: false, path };
    let failure = recorder.run().err().map(|error| format!("{error:#}"));
    let Recorder { topics, writing, path, .. } = recorder;
    let mut lost = topics.lost();
    for (topic, count) in writing.left_out() {
        *lost.entry(topic.to_owned()).or_default() += count;
    }
    // Nobody waits for a topic that is looked at no more.
    drop(topics);
    let written = writing.finish();
    let bytes = std::fs::metadata(&path).map_or(0, |metadata| metadata.len());
    let error = written.err().map(|error| format!("{error:#}")).or(failure);
    say(&Said::Ended(RecordingReport { path, bytes, lost, error }))
}

/// The lines of standard input, as they come. Their end closes the channel.
fn listen() -> anyhow::Result<Receiver<Told>> {
    let (sender, told) = channel();
    let hear = move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            // What this version does not know is nothing to it.
            if serde_json::from_str(&line).is_ok_and(|line| sender.send(line).is_err()) {
                return;
            }
        }
    };
    std::thread::Builder::new().name("hear".to_owned()).spawn(hear).context("cannot start a thread")?;
    Ok(told)
}

fn say(said: &Said) -> anyhow::Result<()> {
    let line = serde_json::to_string(said)?;
    // Nobody hears it where the supervisor is gone; the file is there all the same.
    let _ = writeln!(std::io::stdout(), "{line}");
    Ok(())
}

fn begin_file(
    arguments: &Arguments,
    config: &Config,
    configuration: &str,
    start: &RecordingStart,
) -> anyhow::Result<RecordingFile> {
    let mut file = RecordingFile::create(&arguments.folder, &config.session)?;
    match file.begin(configuration, start) {
        Ok(()) => Ok(file),
        Err(error) => {
            file.discard();
            Err(error)
        }
    }
}

struct Recorder {
    topics: Topics,
    writing: WritingThread,
    notes: NoteSocket,
    told: Receiver<Told>,
    is_stopped: Arc<AtomicBool>,
    is_lossless: bool,
    is_ready: bool,
    path: PathBuf,
}

impl Recorder {
    fn run(&mut self) -> anyhow::Result<()> {
        let look = if self.is_lossless { LOSSLESS_LOOK } else { LIVE_LOOK };
        loop {
            let is_over = self.hear() || self.is_stopped.load(Ordering::Relaxed);
            if !self.is_ready && self.topics.connect()? {
                say(&Said::Ready(self.path.clone()))?;
                self.is_ready = true;
            }
            self.topics.take(&mut self.writing)?;
            if is_over || self.writing.has_ended() {
                return Ok(());
            }
            std::thread::sleep(look);
        }
    }

    /// Takes what the supervisor and people say; whether the supervisor wants the file finished.
    fn hear(&mut self) -> bool {
        while let Some(note) = self.notes.receive() {
            let event = Event { at_ns: now_ns(), kind: EventKind::Note, text: note.text.clone() };
            self.writing.put(Item::Note(event, note));
        }
        self.writing.answer(&self.notes, &self.path);
        loop {
            match self.told.try_recv() {
                Ok(Told::Event(text)) => {
                    let event = Event { at_ns: now_ns(), kind: EventKind::Session, text };
                    self.writing.put(Item::Event(event));
                }
                Ok(Told::Ready(stages)) => self.writing.put(Item::Facts("stages", stages.to_string())),
                Ok(Told::Task(task)) => self.writing.put(Item::Facts(TASK, task.to_string())),
                Ok(Told::Start(_)) => {}
                Err(TryRecvError::Empty) => return false,
                Err(TryRecvError::Disconnected) => return true,
            }
        }
    }
}
