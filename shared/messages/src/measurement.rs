//! What each process measures of its own messages, published for the supervisor and `tendon latency`.

use iceoryx2::prelude::ZeroCopySend;

use crate::numbered::numbered;
use crate::{GestureNumber, Trace};

/// One thing that a stage measured. It travels as a [`Measurement`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// A message that the stage took or, at the source, made.
    Message(MessageTimes),
    /// A window that decision turned into a command.
    Decision {
        /// Times of the prediction that was decided upon.
        times: MessageTimes,
        /// Capture of the window's first sample to the command's publication, ns.
        window_start_to_publish_ns: u64,
        /// Class number of the true gesture if the window lies wholly inside one.
        truth: Option<u8>,
        /// Class number of the window's recognised gesture, before the vote.
        gesture: u8,
    },
    /// A control tick of the robot.
    ControlTick {
        /// How late it was, ns.
        late_ns: u64,
    },
    /// A command that the robot gave to the arm's network.
    CommandToWire {
        /// Receipt of the command to the bytes given to the network, ns.
        took_ns: u64,
    },
}

/// The times of one message at one stage, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MessageTimes {
    /// Upstream's publish to this stage's receive; 0 at the source.
    pub transit_ns: u64,
    /// Receive to publish, or to the end of the work where nothing was due to be published. At the source:
    /// from the capture of the newest sample.
    pub work_ns: u64,
    /// Capture of the newest sample to this stage's publish; `None` when nothing was published.
    pub newest_sample_to_publish_ns: Option<u64>,
}

numbered! {
    /// What a [`Measurement`] holds.
    pub enum Kind {
        Message = 0,
        PublishedMessage = 1,
        Decision = 2,
        PublishedDecision = 3,
        ControlTick = 4,
        CommandToWire = 5,
    }
}

/// A [`Measured`] as it travels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
pub struct Measurement {
    /// By kind: transit, work, newest sample to publish, window start to publish; or one duration.
    durations_ns: [u64; 4],
    kind: u8,
    truth: GestureNumber,
    gesture: GestureNumber,
}

impl From<Measured> for Measurement {
    fn from(measured: Measured) -> Measurement {
        let nothing = Measurement {
            durations_ns: [0; 4],
            kind: Kind::Message.number(),
            truth: GestureNumber::NONE,
            gesture: GestureNumber::NONE,
        };
        let of_message = |times: MessageTimes, [alone, published]: [Kind; 2]| {
            let MessageTimes { transit_ns, work_ns, newest_sample_to_publish_ns } = times;
            Measurement {
                durations_ns: [transit_ns, work_ns, newest_sample_to_publish_ns.unwrap_or(0), 0],
                kind: newest_sample_to_publish_ns.map_or(alone, |_| published).number(),
                ..nothing
            }
        };
        match measured {
            Measured::Message(times) => of_message(times, [Kind::Message, Kind::PublishedMessage]),
            Measured::Decision { times, window_start_to_publish_ns, truth, gesture } => {
                let mut measurement = of_message(times, [Kind::Decision, Kind::PublishedDecision]);
                measurement.durations_ns[3] = window_start_to_publish_ns;
                measurement.truth = GestureNumber::new(truth);
                measurement.gesture = GestureNumber::new(Some(gesture));
                measurement
            }
            Measured::ControlTick { late_ns } => {
                Measurement { durations_ns: [late_ns, 0, 0, 0], kind: Kind::ControlTick.number(), ..nothing }
            }
            Measured::CommandToWire { took_ns } => Measurement {
                durations_ns: [took_ns, 0, 0, 0],
                kind: Kind::CommandToWire.number(),
                ..nothing
            },
        }
    }
}

impl Measurement {
    /// What was measured; `None` for what no sender of ours writes.
    pub fn measured(&self) -> Option<Measured> {
        let [first, second, third, fourth] = self.durations_ns;
        let times = |newest_sample_to_publish_ns| MessageTimes {
            transit_ns: first,
            work_ns: second,
            newest_sample_to_publish_ns,
        };
        let decision = |times| {
            let (truth, gesture) = (self.truth.get(), self.gesture.get()?);
            Some(Measured::Decision { times, window_start_to_publish_ns: fourth, truth, gesture })
        };
        match Kind::from_number(self.kind)? {
            Kind::Message => Some(Measured::Message(times(None))),
            Kind::PublishedMessage => Some(Measured::Message(times(Some(third)))),
            Kind::Decision => decision(times(None)),
            Kind::PublishedDecision => decision(times(Some(third))),
            Kind::ControlTick => Some(Measured::ControlTick { late_ns: first }),
            Kind::CommandToWire => Some(Measured::CommandToWire { took_ns: first }),
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
    /// At the source: samples of each channel that it lost, by gaps in its own numbers.
    pub lost_samples: u64,
    /// At the source: how much faster than CLOCK_MONOTONIC its clock counts, in parts per million; NaN when it has none
    /// or that is not known yet.
    pub clock_drift_ppm: f64,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_measured_reads_back_also_when_it_took_no_time() {
        let times = |newest_sample_to_publish_ns| MessageTimes {
            transit_ns: 3,
            work_ns: 0,
            newest_sample_to_publish_ns,
        };
        let decision =
            |times, truth| Measured::Decision { times, window_start_to_publish_ns: 7, truth, gesture: 5 };
        for measured in [
            Measured::Message(times(None)),
            Measured::Message(times(Some(0))),
            decision(times(Some(9)), Some(0)),
            decision(times(None), None),
            Measured::ControlTick { late_ns: 0 },
            Measured::CommandToWire { took_ns: 0 },
        ] {
            assert_eq!(Measurement::from(measured).measured(), Some(measured));
        }
        let foreign = Measurement { kind: 77, ..Measured::ControlTick { late_ns: 1 }.into() };
        assert_eq!(foreign.measured(), None);
    }
}
