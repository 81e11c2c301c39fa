//! What each process measures of its own messages, published for the supervisor and `tendon latency`.

use iceoryx2::prelude::ZeroCopySend;

use crate::{NO_GESTURE, Trace};

/// One message as a stage saw it. Durations in ns; 0 where the stage did not get that far.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
pub struct Measurement {
    /// Upstream's publish to this stage's receive; 0 at the source.
    pub transit_ns: u64,
    /// Receive to publish, or to the end of the work where nothing was due to be published. At the source:
    /// from the time the newest sample was due.
    pub work_ns: u64,
    /// Capture of the newest sample to this stage's publish; 0 when nothing was published.
    pub newest_sample_to_publish_ns: u64,
    /// Capture of the window's first sample to this stage's publish; only decision gives it.
    pub window_start_to_publish_ns: u64,
    /// How late the robot's control tick was, at least 1; only the robot's ticks give it, and nothing else.
    pub tick_lateness_ns: u64,
    /// From the receipt of a command to the bytes given to the arm's network, at least 1; only a robot with an arm on a
    /// network gives it, and nothing else.
    pub command_to_wire_ns: u64,
    /// The true gesture's class number if the window lies wholly inside it; only decision gives it.
    pub truth: u8,
    /// The window's recognised gesture, before the vote; only decision gives it.
    pub gesture: u8,
}

impl Default for Measurement {
    fn default() -> Self {
        Measurement {
            transit_ns: 0,
            work_ns: 0,
            newest_sample_to_publish_ns: 0,
            window_start_to_publish_ns: 0,
            tick_lateness_ns: 0,
            command_to_wire_ns: 0,
            truth: NO_GESTURE,
            gesture: NO_GESTURE,
        }
    }
}

/// Header of a batch of measurements: whose they are, and its counts since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
pub struct MeasurementHeader {
    /// Sequence number of the batch; the rest of the trace is unused.
    pub trace: Trace,
    /// Process id of the sender, which tells a restarted stage from the one before.
    pub process_id: u64,
    /// Messages received.
    pub received: u64,
    /// Messages published on the stage's own topic.
    pub published: u64,
    /// Messages lost on the way to this stage, by gaps in their sequence numbers.
    pub lost: u64,
    /// Sequence number of the first message received, if any was: what came before it, this process cannot miss.
    pub first_sequence: u64,
    /// Sequence number that follows that of the newest message received, if any was.
    pub next_sequence: u64,
    /// Messages not acted on because their newest sample was too old; at the source: blocks skipped because
    /// the process could not keep up.
    pub stale: u64,
    /// NaN and infinite samples replaced.
    pub replaced_samples: u64,
    /// Heap allocations of the process since it began.
    pub allocations: u64,
    /// When the stage was done with its first message, CLOCK_MONOTONIC ns; 0 before.
    pub first_message_ns: u64,
    /// When the stage was done with its newest message, CLOCK_MONOTONIC ns; 0 before the first.
    pub newest_message_ns: u64,
    /// 1 when the source has come to its end (a recording that is not looped).
    pub finished: u8,
    /// Index of the sender's [`Stage`](crate::Stage).
    pub stage: u8,
}
