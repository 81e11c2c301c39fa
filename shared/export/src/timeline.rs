//! The time of everything in a session, on one axis: seconds since the first recorded sample.
//!
//! ```text
//! sample numbers   0 … 1999 │ gap │ 2600 … 4000      │ source began anew │ 0 … 900
//! time_s           0 … 1.0  │     │ 1.3  … 2.0       │                   │ 5.2 … 5.65
//!                  number / rate, so gaps stay gaps    clock: how long nothing came
//! clock, ns ──▶ time_s: from the newest block on, so that amplifier and computer may drift apart
//! ```
//!
//! A block that cannot have been captured when its source says so counts as captured when it was published.

use tendon_messages::Stage;
use tendon_session_file::{Block, TraceRecord};

/// A block is published no later than this after it was captured, ns; sessions act on far newer ones only.
const MOST_AGE_NS: u64 = 1_000_000_000;

/// When the newest sample of a block was captured, CLOCK_MONOTONIC ns: as its source says, if that can be.
pub(crate) fn captured_ns(block: &Block) -> u64 {
    let Block { captured_ns, published_ns, .. } = *block;
    let possible_ns = published_ns.saturating_sub(MOST_AGE_NS)..=published_ns;
    if possible_ns.contains(&captured_ns) { captured_ns } else { published_ns }
}

/// Where a block lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Time of its first sample, s.
    pub start_s: f64,
    /// Samples of the recording before it: the number of its first row.
    pub row: u64,
    /// Samples are missing before it, or the source began anew. `false` for the first block.
    pub is_behind_gap: bool,
}

/// Samples that the source counted without beginning anew.
#[derive(Clone, Copy, Debug)]
struct Epoch {
    /// When its first block was published.
    published_ns: u64,
    /// Number of its first recorded sample, and the time of that, s.
    first_sample: u64,
    start_s: f64,
}

/// The newest block.
#[derive(Clone, Copy, Debug)]
struct Newest {
    captured_ns: u64,
    /// Time of its newest sample, s.
    newest_s: f64,
    first_sample: u64,
    next_sample: u64,
}

/// Gives everything its time, from the blocks as they come in the file.
#[derive(Clone, Debug)]
pub struct Timeline {
    sample_rate_hz: f64,
    /// When the first sample was captured, CLOCK_MONOTONIC ns.
    begun_ns: u64,
    epochs: Vec<Epoch>,
    newest: Option<Newest>,
    rows: u64,
}

impl Timeline {
    /// A timeline of samples at this rate, the first of which will have been captured then, CLOCK_MONOTONIC ns.
    pub fn new(sample_rate_hz: f64, begun_ns: u64) -> Timeline {
        Timeline { sample_rate_hz, begun_ns, epochs: Vec::new(), newest: None, rows: 0 }
    }

    /// Takes the next block.
    pub fn take(&mut self, block: &Block) -> Placed {
        let samples = u64::from(block.samples);
        let captured_ns = captured_ns(block);
        let length_s = (samples as f64 - 1.0) / self.sample_rate_hz;
        let begins_anew = self.newest.is_none_or(|newest| block.first_sample <= newest.first_sample);
        let is_behind_gap = self.newest.is_some_and(|newest| newest.next_sample != block.first_sample);
        if begins_anew {
            let start_s = self.newest.map_or(0.0, |newest| {
                let clock_s = newest.newest_s + difference_s(captured_ns, newest.captured_ns) - length_s;
                // Time never runs backwards, however fast a replay was.
                clock_s.max(newest.newest_s + 1.0 / self.sample_rate_hz)
            });
            let (published_ns, first_sample) = (block.published_ns, block.first_sample);
            self.epochs.push(Epoch { published_ns, first_sample, start_s });
        }
        let start_s = self.epochs.last().map_or(0.0, |epoch| self.in_epoch_s(epoch, block.first_sample));
        let row = self.rows;
        self.rows += samples;
        self.newest = Some(Newest {
            captured_ns,
            newest_s: start_s + length_s,
            first_sample: block.first_sample,
            next_sample: block.first_sample.saturating_add(samples),
        });
        Placed { start_s, row, is_behind_gap }
    }

    /// Samples so far, of each channel.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Time after the newest sample, s; 0 before the first block.
    pub fn end_s(&self) -> f64 {
        self.newest.map_or(0.0, |newest| newest.newest_s + 1.0 / self.sample_rate_hz)
    }

    /// Time of a sample of the window that a message with this trace is about, s.
    pub fn sample_of_s(&self, trace: &TraceRecord, sample: u64) -> f64 {
        let published_ns = trace.published_ns[Stage::Acquisition.index()];
        let begun = self.epochs.partition_point(|epoch| epoch.published_ns <= published_ns);
        let epoch = self.epochs.get(begun.saturating_sub(1));
        epoch.map_or(0.0, |epoch| self.in_epoch_s(epoch, sample))
    }

    /// Time of a moment on CLOCK_MONOTONIC, s: as far from the newest sample as it is from when that was captured. Less
    /// than 0 before the first one.
    pub fn clock_s(&self, at_ns: u64) -> f64 {
        let (newest_s, captured_ns) =
            self.newest.map_or((0.0, self.begun_ns), |newest| (newest.newest_s, newest.captured_ns));
        newest_s + difference_s(at_ns, captured_ns)
    }

    fn in_epoch_s(&self, epoch: &Epoch, sample: u64) -> f64 {
        // A window may begin before the recording did.
        let behind = sample as i128 - i128::from(epoch.first_sample);
        epoch.start_s + behind as f64 / self.sample_rate_hz
    }
}

/// From `before_ns` to `after_ns`, s.
fn difference_s(after_ns: u64, before_ns: u64) -> f64 {
    (i128::from(after_ns) - i128::from(before_ns)) as f64 * 1e-9
}
