//! A recorded session as a source: its blocks exactly as they were, gaps and new beginnings of its source among them.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::ensure;
use tendon_config::AcquisitionSettings;
use tendon_process::{Ready, SignalDescription};
use tendon_session_file::{Block as RecordedBlock, Message, Reader, Record, is_session_file};
use tendon_source::{Block, Next, Source, SourceError, Wait};
use tendon_transport::{Delivery, now_ns};

/// Whether the recording to replay is that of a session.
pub fn is_recorded_session(settings: &AcquisitionSettings) -> bool {
    settings.replay.path.as_deref().is_some_and(is_session_file)
}

/// The blocks of a recorded session.
#[derive(Debug)]
pub struct RecordedSession {
    path: PathBuf,
    reader: Reader<File>,
    /// The block that was read last.
    block: RecordedBlock,
    delivery: Delivery,
    /// When the first block was captured in the recording.
    first_captured_ns: u64,
    /// When its replay is due, at its true pace.
    start_ns: u64,
    duration_s: f64,
    is_whole: bool,
    is_damaged_elsewhere: bool,
    damaged_pieces: u64,
    damaged_bytes: u64,
    /// What its source said that it measures.
    signal: Option<SignalDescription>,
}

impl RecordedSession {
    /// Opens it, once it has been read through, so that one that does not fit is refused before anything moves.
    pub fn open(settings: &AcquisitionSettings, delivery: Delivery) -> anyhow::Result<RecordedSession> {
        let path = settings.replay.path.as_deref().unwrap_or(Path::new(""));
        let mut reader = Reader::open(path)?.without_samples();
        let mut captured_ns: Option<(u64, u64)> = None;
        let mut signal = None;
        while let Some(record) = reader.next()? {
            match record {
                Record::Message(Message::Block(block)) => {
                    check(path, &block, settings)?;
                    let (first_ns, _) = captured_ns.unwrap_or((block.captured_ns, block.captured_ns));
                    captured_ns = Some((first_ns, block.captured_ns));
                }
                Record::Metadata { name, facts } if name == "stages" => signal = recorded_signal(&facts),
                _ => {}
            }
        }
        let Some((first_ns, last_ns)) = captured_ns else {
            anyhow::bail!("{}: there is no block of samples in this recording", path.display());
        };
        Ok(RecordedSession {
            path: path.to_owned(),
            reader: Reader::open(path)?,
            block: RecordedBlock::default(),
            delivery,
            first_captured_ns: first_ns,
            start_ns: 0,
            duration_s: last_ns.saturating_sub(first_ns) as f64 / 1e9,
            is_whole: reader.is_whole(),
            is_damaged_elsewhere: reader.is_damaged_elsewhere(),
            damaged_pieces: reader.damaged_pieces(),
            damaged_bytes: reader.damaged_bytes(),
            signal,
        })
    }

    /// What to tell the user.
    pub fn description(&self) -> String {
        let damaged = match self.damaged_pieces {
            0 if self.is_damaged_elsewhere => {
                ", damaged outside its samples, so what it says of the session may be wrong".to_owned()
            }
            0 => String::new(),
            pieces => format!(", damaged, {pieces} of its pieces ({} bytes) left out", self.damaged_bytes),
        };
        let cut = if self.is_whole { "" } else { ", cut before its end" };
        format!("recorded session {}, {:.1} s{damaged}{cut}", self.path.display(), self.duration_s)
    }

    /// What the source of the recorded session said that it measures.
    pub fn signal(&self) -> Option<SignalDescription> {
        self.signal.clone()
    }
}

/// What the source said that it measures, out of what all stages said when they were ready.
fn recorded_signal(facts: &BTreeMap<String, String>) -> Option<SignalDescription> {
    let stages: BTreeMap<String, Ready> = serde_json::from_str(facts.get("json")?).ok()?;
    stages.into_iter().find_map(|(_, ready)| ready.signal)
}

/// Refuses a block that the session has no room for.
fn check(path: &Path, block: &RecordedBlock, settings: &AcquisitionSettings) -> anyhow::Result<()> {
    let (channels, samples) = (block.channels as usize, block.samples as usize);
    ensure!(
        channels == settings.channels && block.sample_rate_hz == settings.sample_rate_hz,
        "{}: recorded with {channels} channels at {} Hz, this session has {} at {} Hz: leave acquisition.channels and \
         acquisition.sample_rate_hz as they were",
        path.display(),
        block.sample_rate_hz,
        settings.channels,
        settings.sample_rate_hz
    );
    ensure!(
        samples <= settings.block_samples,
        "{}: it has blocks of {samples} samples, this session has {}: leave acquisition.block_samples as it was",
        path.display(),
        settings.block_samples
    );
    Ok(())
}

impl Source for RecordedSession {
    fn start(&mut self) -> Result<(), SourceError> {
        self.start_ns = now_ns();
        Ok(())
    }

    fn wait(&self) -> Wait<'_> {
        match self.delivery {
            Delivery::Live => Wait::Nothing,
            // Always due, but orders are looked at in between.
            Delivery::Lossless => Wait::Until(0),
        }
    }

    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError> {
        if !self.reader.next_block(&mut self.block).map_err(SourceError::new)? {
            return Ok(Next::End);
        }
        let block = &self.block;
        samples[..block.values.len()].copy_from_slice(&block.values);
        let (captured_ns, publish_at_ns) = match self.delivery {
            Delivery::Live => {
                let due_ns = self.start_ns + block.captured_ns.saturating_sub(self.first_captured_ns);
                (due_ns, due_ns)
            }
            Delivery::Lossless => (now_ns(), 0),
        };
        Ok(Next::Block(Block {
            first_sample: block.first_sample,
            samples: block.samples as usize,
            captured_ns,
            publish_at_ns,
            truth: block.truth,
        }))
    }
}
