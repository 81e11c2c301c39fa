//! The writing thread, and the bounded buffer before it. A disk that stalls holds up this thread and no other.

use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tendon_process::{NoteSocket, NoteText};
use tendon_session_file::{Event, Message};
use tendon_transport::now_ns;

use crate::file::RecordingFile;

/// Messages in the buffer: some ten seconds of a session.
const BUFFER: usize = 8192;
/// Time between two chunks: what a killed recorder loses, with the time it takes to write one.
const CHUNK_INTERVAL: Duration = Duration::from_millis(400);

/// What is to be written.
#[derive(Debug)]
pub enum Item {
    /// A message, and when it was received.
    Message(Message, u64),
    /// What the supervisor or the recorder says.
    Event(Event),
    /// What a person says, who waits until it is written.
    Note(Event, NoteText),
    /// JSON under a name: what the stages said when they were ready, how the task went.
    Facts(&'static str, String),
}

/// The thread that writes.
#[derive(Debug)]
pub struct WritingThread {
    items: SyncSender<Item>,
    noted: Receiver<NoteText>,
    thread: JoinHandle<anyhow::Result<()>>,
    /// Wait for room instead of leaving something out.
    waits: bool,
    /// Messages that did not fit, by topic.
    left_out: Vec<(&'static str, u64)>,
}

impl WritingThread {
    /// Starts to write to `file`. With `waits`, who puts something waits until there is room for it.
    pub fn start(file: RecordingFile, waits: bool) -> std::io::Result<WritingThread> {
        let (items, to_write) = sync_channel(BUFFER);
        let (has_noted, noted) = channel();
        let write = move || write(file, &to_write, |note| drop(has_noted.send(note)));
        let thread = std::thread::Builder::new().name("write".to_owned()).spawn(write)?;
        Ok(WritingThread { items, noted, thread, waits, left_out: Vec::new() })
    }

    /// Puts something into the buffer. What does not fit is counted.
    pub fn put(&mut self, item: Item) {
        if self.waits {
            // A thread that has ended says why in the end.
            let _ = self.items.send(item);
        } else if let Err(TrySendError::Full(Item::Message(message, _))) = self.items.try_send(item) {
            let topic = topic(&message);
            match self.left_out.iter_mut().find(|(other, _)| *other == topic) {
                Some((_, count)) => *count += 1,
                None => self.left_out.push((topic, 1)),
            }
        }
    }

    /// Messages that did not fit into the buffer, by topic.
    pub fn left_out(&self) -> impl Iterator<Item = (&'static str, u64)> {
        self.left_out.iter().copied()
    }

    /// Answers those whose notes have been written.
    pub fn answer(&self, notes: &NoteSocket, path: &Path) {
        for note in self.noted.try_iter() {
            notes.answer(&note, &format!("noted in {}", path.display()));
        }
    }

    /// Whether it has ended, because it could not go on.
    pub fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }

    /// Writes what is in the buffer, and ends the file.
    pub fn finish(self) -> anyhow::Result<()> {
        drop(self.items);
        self.thread
            .join()
            .unwrap_or_else(|_| Err(anyhow::anyhow!("the writing thread broke off: this is a defect")))
    }
}

fn write(
    mut file: RecordingFile,
    items: &Receiver<Item>,
    has_noted: impl Fn(NoteText),
) -> anyhow::Result<()> {
    let mut flushed = Instant::now();
    loop {
        let left = CHUNK_INTERVAL.saturating_sub(flushed.elapsed());
        match items.recv_timeout(left) {
            Ok(Item::Message(message, received_ns)) => file.write(&message, received_ns)?,
            Ok(Item::Event(event)) => file.write(&Message::Event(event), now_ns())?,
            Ok(Item::Note(event, note)) => {
                file.write(&Message::Event(event), now_ns())?;
                file.flush()?;
                has_noted(note);
            }
            Ok(Item::Facts(name, json)) => file.facts(name, json)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return file.finish(),
        }
        if flushed.elapsed() >= CHUNK_INTERVAL {
            file.flush()?;
            flushed = Instant::now();
        }
    }
}

fn topic(message: &Message) -> &'static str {
    match message {
        Message::Block(_) => "blocks",
        Message::Window(_) => "windows",
        Message::Prediction(_) => "predictions",
        Message::Command(_) => "commands",
        Message::State(_) => "states",
        Message::Measurement(_) => "measurements",
        Message::Event(_) => "events",
        Message::Cue(_) => "cues",
    }
}
