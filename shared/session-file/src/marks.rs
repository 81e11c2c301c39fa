//! What a replay repeats beside the samples: which stage began anew with which window, and which windows a stage left out.
//!
//! ```text
//! recorded blocks ──▶ epochs of the source: it began anew where its sample numbers did not go on rising
//! measurements ─────▶ dsp began anew with this block: its first, by sequence number
//! predictions, commands: sequence numbers that start again ─▶ inference, decision began anew with this window
//! commands ─────────▶ decision was ordered to take a mode with this window
//! no window, prediction or command of it ─▶ dsp, inference or decision left it out: too old, lost, or not running
//! ```
//!
//! A recording that was begun in a running session starts between two windows. Its replay cuts windows where the recording has
//! them, and not from the first block.
//!
//! dsp reads the marks and hands on, in each window's context, what concerns the stages behind it. A message is tied to its
//! epoch by when the block behind it was published, which its trace says.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::Range;
use std::path::Path;

use tendon_messages::{ReplayMark, Stage};

use crate::reader::{Reader, SessionFileError};
use crate::records::{CommandRecord, MeasurementRecord, Message, TraceRecord};

/// Which window: how often the source had begun anew, and the window's first sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct KeyOfWindow {
    /// 0 at first, 1 more each time the source began anew.
    pub epoch: u32,
    /// Index of its first sample since the source began.
    pub first_sample: u64,
}

/// When the source began anew, by the times at which it published.
#[derive(Clone, Debug, Default)]
pub(crate) struct Epochs {
    /// When the first block of each was published.
    starts_ns: Vec<u64>,
    counter: EpochCounter,
}

impl Epochs {
    /// Takes the next block of the file; gives its epoch.
    pub(crate) fn take(&mut self, first_sample: u64, published_ns: u64) -> u32 {
        let epoch = self.counter.take(first_sample);
        if self.starts_ns.len() == epoch as usize {
            self.starts_ns.push(published_ns);
        }
        epoch
    }

    /// The window that a message with this trace is about.
    pub(crate) fn key(&self, trace: &TraceRecord, first_sample: u64) -> KeyOfWindow {
        let published_ns = trace.published_by(Stage::Acquisition);
        let begun = self.starts_ns.partition_point(|start_ns| *start_ns <= published_ns);
        KeyOfWindow { epoch: begun.saturating_sub(1) as u32, first_sample }
    }
}

/// Counts how often a source began anew, from its blocks one after the other.
#[derive(Clone, Copy, Debug, Default)]
struct EpochCounter {
    epoch: u32,
    last_first_sample: Option<u64>,
}

impl EpochCounter {
    fn take(&mut self, first_sample: u64) -> u32 {
        if self.last_first_sample.is_some_and(|last| first_sample <= last) {
            self.epoch += 1;
        }
        self.last_first_sample = Some(first_sample);
        self.epoch
    }
}

/// The marks of a recorded session, for dsp in its replay.
#[derive(Clone, Debug, Default)]
pub struct ReplayMarks {
    epochs: EpochCounter,
    /// Epoch and first sample of each block with which dsp began anew.
    restarts_of_dsp: HashSet<(u32, u64)>,
    windows: BTreeMap<KeyOfWindow, u8>,
    ordered_modes: BTreeMap<KeyOfWindow, u8>,
}

impl ReplayMarks {
    /// The marks of the file at `path`.
    ///
    /// # Errors
    ///
    /// When it cannot be read or is none of a session.
    pub fn read(path: &Path) -> Result<ReplayMarks, SessionFileError> {
        let mut gathered = Gathered::default();
        let mut reader = Reader::open(path)?.without_samples();
        while let Some(message) = reader.next_message()? {
            gathered.take(message);
        }
        Ok(gathered.marks())
    }

    /// Takes the next block of the replay; whether dsp began anew with it.
    pub fn begins_anew(&mut self, first_sample: u64) -> bool {
        let epoch = self.epochs.take(first_sample);
        self.restarts_of_dsp.contains(&(epoch, first_sample))
    }

    /// The [`ReplayMark`]s of a window of the newest block, for its context; `None` if dsp left it out.
    pub fn window(&self, first_sample: u64) -> Option<u8> {
        self.windows.get(&self.key(first_sample)).copied()
    }

    /// The mode that decision was ordered to take with a window of the newest block, for its context; 0 if none was.
    pub fn ordered_mode(&self, first_sample: u64) -> u8 {
        self.ordered_modes.get(&self.key(first_sample)).copied().unwrap_or_default()
    }

    fn key(&self, first_sample: u64) -> KeyOfWindow {
        KeyOfWindow { epoch: self.epochs.epoch, first_sample }
    }

    /// The first sample of the first window that begins with one of these; `None` if there is none.
    pub fn window_from(&self, first_samples: Range<u64>) -> Option<u64> {
        if first_samples.is_empty() {
            return None;
        }
        let mut windows = self.windows.range(self.key(first_samples.start)..self.key(first_samples.end));
        windows.next().map(|(key, _)| key.first_sample)
    }

    /// Whether the recording holds nothing that was made of any window, so that it does not tell which were left out.
    pub fn is_empty(&self) -> bool {
        self.windows.is_empty()
    }
}

/// A block, as far as a restart can be found by it.
#[derive(Clone, Copy, Debug)]
struct BlockSeen {
    sequence: u64,
    published_ns: u64,
    epoch: u32,
    first_sample: u64,
}

/// A prediction or a command, by which a restart of the stage that made it shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Made {
    published_ns: u64,
    sequence: u64,
    trace: usize,
}

/// What the file says, until all of it is known.
#[derive(Debug, Default)]
struct Gathered {
    epochs: Epochs,
    blocks: Vec<BlockSeen>,
    /// Of each dsp process, its first batch that says which block was its first.
    dsp: Vec<MeasurementRecord>,
    windows: Vec<(TraceRecord, u64)>,
    predictions: Vec<(TraceRecord, u64)>,
    commands: Vec<(TraceRecord, u64)>,
    /// First sample and mode of each command with which a mode was taken that had been ordered.
    ordered_modes: Vec<(TraceRecord, u64, u8)>,
}

impl Gathered {
    fn take(&mut self, message: Message) {
        match message {
            Message::Block(block) => {
                let epoch = self.epochs.take(block.first_sample, block.published_ns);
                self.blocks.push(BlockSeen {
                    sequence: block.sequence,
                    published_ns: block.published_ns,
                    epoch,
                    first_sample: block.first_sample,
                });
            }
            Message::Window(window) => self.windows.push((window.trace, window.context.first_sample)),
            Message::Prediction(prediction) => {
                self.predictions.push((prediction.trace, prediction.context.first_sample));
            }
            Message::Command(command) => {
                let CommandRecord { trace, context, ordered_mode, .. } = command;
                if ordered_mode != 0 {
                    self.ordered_modes.push((trace, context.first_sample, ordered_mode));
                }
                self.commands.push((trace, context.first_sample));
            }
            Message::Measurement(batch) if batch.stage == Stage::Dsp.name() && batch.received > 0 => {
                if self.dsp.iter().all(|seen| seen.process_id != batch.process_id) {
                    self.dsp.push(batch);
                }
            }
            Message::Measurement(_) | Message::State(_) | Message::Event(_) | Message::Cue(_) => {}
        }
    }

    fn marks(self) -> ReplayMarks {
        let keys = |made: &[(TraceRecord, u64)]| -> BTreeSet<KeyOfWindow> {
            made.iter().map(|(trace, first_sample)| self.epochs.key(trace, *first_sample)).collect()
        };
        let (predicted, commanded) = (keys(&self.predictions), keys(&self.commands));
        // What a later stage made of a window, the ones before it had taken, also if the recording lacks their word for it.
        let known = keys(&self.windows).into_iter().chain(predicted.clone()).chain(commanded.clone());
        let mut windows: BTreeMap<KeyOfWindow, u8> = known
            .map(|key| {
                let mark = match (predicted.contains(&key), commanded.contains(&key)) {
                    (_, true) => 0,
                    (true, false) => ReplayMark::LeftOutByDecision.bit(),
                    (false, false) => ReplayMark::LeftOutByInference.bit(),
                };
                (key, mark)
            })
            .collect();
        for (made, stage, mark) in [
            (&self.predictions, Stage::Inference, ReplayMark::InferenceBeganAnew),
            (&self.commands, Stage::Decision, ReplayMark::DecisionBeganAnew),
        ] {
            for (trace, first_sample) in began_anew(made, stage) {
                *windows.entry(self.epochs.key(trace, *first_sample)).or_default() |= mark.bit();
            }
        }
        let restarts_of_dsp = self.dsp.iter().skip(1).filter_map(|batch| self.first_block(batch)).collect();
        let ordered = self.ordered_modes.iter();
        let ordered_modes = ordered
            .map(|(trace, first_sample, mode)| (self.epochs.key(trace, *first_sample), *mode))
            .collect();
        ReplayMarks { epochs: EpochCounter::default(), restarts_of_dsp, windows, ordered_modes }
    }

    /// The first block that a dsp process took. Sequence numbers start again with the source, so it is the newest block of
    /// that number that was there by then.
    fn first_block(&self, batch: &MeasurementRecord) -> Option<(u32, u64)> {
        let is_it = |block: &&BlockSeen| {
            block.sequence == batch.first_sequence && block.published_ns <= batch.first_message_ns
        };
        self.blocks.iter().rfind(is_it).map(|block| (block.epoch, block.first_sample))
    }
}

/// The messages with which a stage's sequence numbers started again.
fn began_anew(made: &[(TraceRecord, u64)], stage: Stage) -> impl Iterator<Item = &(TraceRecord, u64)> {
    let mut in_order: Vec<Made> = made
        .iter()
        .enumerate()
        .map(|(place, (trace, _))| Made {
            published_ns: trace.published_by(stage),
            sequence: trace.sequence,
            trace: place,
        })
        .collect();
    in_order.sort_unstable();
    let restarts: Vec<usize> = in_order
        .windows(2)
        .filter(|pair| pair[1].sequence <= pair[0].sequence)
        .map(|pair| pair[1].trace)
        .collect();
    restarts.into_iter().map(|place| &made[place])
}
