//! What all stages of a session measured, as histograms.

use std::time::Duration;

use hdrhistogram::Histogram;
use tendon_gesture::GestureSet;
use tendon_messages::{Measured, Measurement, MeasurementHeader, MessageTimes, STAGE_COUNT, Stage};

/// Longest duration a histogram tells apart from longer ones, ns.
const LONGEST_NS: u64 = 60_000_000_000;
/// Significant digits of a histogram's values.
const SIGNIFICANT_DIGITS: u8 = 3;

/// Messages after which a stage is warm: its ports have met, its buffers have their size.
const WARM_UP_MESSAGES: u64 = 10;

/// A stage's counts since the session began, over restarts. The newest 200 ms of a process that was killed are not
/// known: what it took then counts as lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Messages received.
    pub received: u64,
    /// Messages published on its own topic.
    pub published: u64,
    /// Messages lost on the way to the stage.
    pub lost: u64,
    /// Messages not acted on because they were too old; at the source: blocks it skipped.
    pub stale: u64,
    /// Samples of each channel that the source lost.
    pub lost_samples: u64,
    /// NaN and infinite samples replaced.
    pub replaced_samples: u64,
}

impl Counts {
    fn plus(self, header: &MeasurementHeader) -> Counts {
        Counts {
            received: self.received + header.received,
            published: self.published + header.published,
            lost: self.lost + header.lost,
            stale: self.stale + header.stale,
            lost_samples: self.lost_samples + header.lost_samples,
            replaced_samples: self.replaced_samples + header.replaced_samples,
        }
    }
}

/// Mean and standard deviation of durations, exact, and their histogram.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The durations in ns.
    pub histogram: Histogram<u64>,
    mean_ns: f64,
    squares: f64,
}

impl Summary {
    fn new() -> Summary {
        Summary { histogram: duration_histogram(), mean_ns: 0.0, squares: 0.0 }
    }

    /// Welford's running mean and sum of squared deviations (Knuth, The Art of Computer Programming 2, 4.2.2).
    fn record(&mut self, duration_ns: u64) {
        self.histogram.saturating_record(duration_ns);
        let deviation = duration_ns as f64 - self.mean_ns;
        self.mean_ns += deviation / self.histogram.len() as f64;
        self.squares += deviation * (duration_ns as f64 - self.mean_ns);
    }

    /// Mean in ns, 0 of nothing.
    pub fn mean_ns(&self) -> f64 {
        self.mean_ns
    }

    /// Standard deviation in ns (of the sample), 0 of less than two.
    pub fn standard_deviation_ns(&self) -> f64 {
        let count = self.histogram.len();
        if count < 2 { 0.0 } else { (self.squares / (count - 1) as f64).sqrt() }
    }
}

#[derive(Clone, Debug)]
struct StageMeasurements {
    transit: Histogram<u64>,
    work: Histogram<u64>,
    process_id: u64,
    before_restart: Counts,
    /// Sequence number of the message that the process before would have taken next, until its successor takes one.
    expected_sequence: Option<u64>,
    newest: MeasurementHeader,
    /// Batches missing between others, by their sequence numbers.
    lost_batches: u64,
    /// Allocations of the process when it was warm; `None` before.
    allocations_when_warm: Option<u64>,
    /// Allocations of the process since, as long as the session ran.
    allocations: u64,
}

/// What all stages of a session measured.
#[derive(Clone, Debug)]
pub struct SessionMeasurements {
    is_ending: bool,
    stages: [StageMeasurements; STAGE_COUNT],
    /// Capture of the newest sample to the command's publication.
    pub newest_sample_to_command: Histogram<u64>,
    /// Capture of the window's first sample to the command's publication: the paper's latency.
    pub window_start_to_command: Summary,
    /// How late the robot's control ticks were, in motion.
    pub control_tick: Histogram<u64>,
    /// The robot's receipt of a command to the bytes given to the arm's network.
    pub command_to_wire: Histogram<u64>,
    /// Windows by class number of the true and of the recognised gesture, of those that lie wholly inside one gesture.
    pub recognised: [[u64; GestureSet::MAXIMUM]; GestureSet::MAXIMUM],
}

/// An empty histogram of durations: 1 ns to one minute, in three significant digits.
pub fn duration_histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LONGEST_NS, SIGNIFICANT_DIGITS)
        .expect("the bounds are constants that hdrhistogram accepts: tested")
}

impl Default for SessionMeasurements {
    fn default() -> Self {
        let stage = || StageMeasurements {
            transit: duration_histogram(),
            work: duration_histogram(),
            process_id: 0,
            before_restart: Counts::default(),
            expected_sequence: None,
            newest: MeasurementHeader::default(),
            lost_batches: 0,
            allocations_when_warm: None,
            allocations: 0,
        };
        SessionMeasurements {
            is_ending: false,
            stages: std::array::from_fn(|_| stage()),
            newest_sample_to_command: duration_histogram(),
            window_start_to_command: Summary::new(),
            control_tick: duration_histogram(),
            command_to_wire: duration_histogram(),
            recognised: Default::default(),
        }
    }
}

impl SessionMeasurements {
    /// How much faster than CLOCK_MONOTONIC the source's clock counts, in parts per million; `None` when it has none or
    /// that is not known.
    pub fn clock_drift_ppm(&self) -> Option<f64> {
        let newest = &self.stages[Stage::Acquisition.index()].newest;
        (newest.published > 0 && newest.clock_drift_ppm.is_finite()).then_some(newest.clock_drift_ppm)
    }

    /// Takes a batch of a stage's measurements. Batches of a stage that does not exist are passed over.
    pub fn absorb(&mut self, header: &MeasurementHeader, batch: &[Measurement]) {
        let Some(stage) = Stage::from_number(header.stage) else {
            return;
        };
        let kept = &mut self.stages[stage.index()];
        if kept.process_id != header.process_id {
            kept.before_restart = kept.before_restart.plus(&kept.newest);
            if kept.newest.received > 0 {
                kept.expected_sequence = Some(kept.newest.next_sequence);
            }
            kept.process_id = header.process_id;
            kept.allocations_when_warm = None;
        } else {
            let next = kept.newest.trace.sequence + 1;
            kept.lost_batches += header.trace.sequence.saturating_sub(next);
        }
        kept.newest = *header;
        if let (Some(expected), 1..) = (kept.expected_sequence, header.received) {
            // What came while the stage was gone. Smaller numbers are of a publisher that began anew as well.
            let first = header.first_sequence;
            kept.before_restart.lost += first.checked_sub(expected).unwrap_or(first);
            kept.expected_sequence = None;
        }
        let has_received = header.received >= WARM_UP_MESSAGES || stage.upstream().is_none();
        if kept.allocations_when_warm.is_none() && has_received && header.published >= WARM_UP_MESSAGES {
            kept.allocations_when_warm = Some(header.allocations);
        }
        if let (Some(when_warm), false) = (kept.allocations_when_warm, self.is_ending) {
            kept.allocations = header.allocations - when_warm;
        }
        for measured in batch.iter().filter_map(Measurement::measured) {
            self.record(stage, measured);
        }
    }

    fn record(&mut self, stage: Stage, measured: Measured) {
        let times = match measured {
            Measured::ControlTick { late_ns } => return self.control_tick.saturating_record(late_ns),
            Measured::CommandToWire { took_ns } => return self.command_to_wire.saturating_record(took_ns),
            Measured::Message(times) => times,
            Measured::Decision { times, window_start_to_publish_ns, truth, gesture } => {
                self.record_command(times, window_start_to_publish_ns, truth, gesture);
                times
            }
        };
        let kept = &mut self.stages[stage.index()];
        if stage.upstream().is_some() {
            kept.transit.saturating_record(times.transit_ns);
        }
        kept.work.saturating_record(times.work_ns);
    }

    fn record_command(
        &mut self,
        times: MessageTimes,
        window_start_to_publish_ns: u64,
        truth: Option<u8>,
        gesture: u8,
    ) {
        let Some(newest_sample_to_publish_ns) = times.newest_sample_to_publish_ns else { return };
        self.newest_sample_to_command.saturating_record(newest_sample_to_publish_ns);
        self.window_start_to_command.record(window_start_to_publish_ns);
        let row = truth.and_then(|truth| self.recognised.get_mut(usize::from(truth)));
        if let Some(count) = row.and_then(|row| row.get_mut(usize::from(gesture))) {
            *count += 1;
        }
    }

    /// A stage's counts, over restarts.
    pub fn counts(&self, stage: Stage) -> Counts {
        let kept = &self.stages[stage.index()];
        kept.before_restart.plus(&kept.newest)
    }

    /// Batches of measurements that came too fast to be gathered.
    pub fn lost_batches(&self) -> u64 {
        self.stages.iter().map(|stage| stage.lost_batches).sum()
    }

    /// Upstream's publish to this stage's receive.
    pub fn transit(&self, stage: Stage) -> &Histogram<u64> {
        &self.stages[stage.index()].transit
    }

    /// Receive to publish.
    pub fn work(&self, stage: Stage) -> &Histogram<u64> {
        &self.stages[stage.index()].work
    }

    /// From now on stages are being stopped: those that lose a neighbour may allocate.
    pub fn ending(&mut self) {
        self.is_ending = true;
    }

    /// Heap allocations of a stage's process from when it was warm until [`SessionMeasurements::ending`].
    pub fn allocations(&self, stage: Stage) -> u64 {
        self.stages[stage.index()].allocations
    }

    /// How long messages flowed, from the source's first to the robot's newest.
    pub fn flow(&self) -> Duration {
        let first_ns = self.stages[Stage::Acquisition.index()].newest.first_message_ns;
        let newest_ns = self.stages[Stage::Robot.index()].newest.newest_message_ns;
        Duration::from_nanos(newest_ns.saturating_sub(first_ns))
    }

    /// Whether the source has come to its end.
    pub fn has_finished(&self) -> bool {
        self.stages[Stage::Acquisition.index()].newest.finished != 0
    }

    /// Whether the source has come to its end and everything it published has gone all the way: every stage
    /// has taken what the one before published.
    pub fn is_drained(&self) -> bool {
        self.has_finished()
            && Stage::ALL.iter().all(|stage| {
                stage.upstream().is_none_or(|upstream| {
                    let taken = self.counts(*stage);
                    taken.received + taken.lost >= self.counts(upstream).published
                })
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(stage: Stage, process_id: u64, received: u64, published: u64) -> MeasurementHeader {
        MeasurementHeader {
            stage: stage.number(),
            process_id,
            received,
            published,
            ..MeasurementHeader::default()
        }
    }

    #[test]
    fn mean_and_deviation_are_exact() {
        let mut summary = Summary::new();
        [300_100_000, 300_200_000, 300_600_000].iter().for_each(|duration| summary.record(*duration));
        assert!((summary.mean_ns() - 300_300_000.0).abs() < 1e-3);
        // numpy.std([300.1, 300.2, 300.6], ddof=1) = 0.2645751311 ms
        assert!((summary.standard_deviation_ns() - 264_575.131_1).abs() < 1e-3);
    }

    #[test]
    fn counts_add_up_over_a_restart() {
        let mut session = SessionMeasurements::default();
        session.absorb(&header(Stage::Dsp, 1, 10, 2), &[]);
        session.absorb(&header(Stage::Dsp, 1, 20, 3), &[]);
        session.absorb(&header(Stage::Dsp, 2, 5, 1), &[]);
        assert_eq!(session.counts(Stage::Dsp), Counts { received: 25, published: 4, ..Counts::default() });
    }

    #[test]
    fn a_batch_that_is_missing_between_others_is_counted() {
        let mut session = SessionMeasurements::default();
        let mut numbered = |process_id, sequence| {
            let mut batch = header(Stage::Dsp, process_id, 0, 0);
            batch.trace.sequence = sequence;
            session.absorb(&batch, &[]);
        };
        // An observer that joins late has missed nothing, nor has a process that begins anew.
        for (process_id, sequence) in [(1, 7), (1, 8), (1, 11), (2, 0), (2, 1), (2, 3)] {
            numbered(process_id, sequence);
        }
        assert_eq!(session.lost_batches(), 3);
    }

    #[test]
    fn what_was_published_while_a_stage_was_gone_is_lost() {
        let mut session = SessionMeasurements::default();
        let numbered = |process_id, received, first_sequence, next_sequence| MeasurementHeader {
            first_sequence,
            next_sequence,
            ..header(Stage::Dsp, process_id, received, 0)
        };
        session.absorb(&MeasurementHeader { lost: 3, ..numbered(1, 17, 0, 20) }, &[]);
        session.absorb(&numbered(2, 0, 0, 0), &[]);
        assert_eq!(session.counts(Stage::Dsp).lost, 3, "nothing is known yet");
        session.absorb(&numbered(2, 5, 50, 55), &[]);
        session.absorb(&numbered(2, 6, 50, 56), &[]);
        assert_eq!(session.counts(Stage::Dsp).lost, 33);
        // Together with the stage before, which numbers from 0 again.
        session.absorb(&numbered(3, 4, 2, 6), &[]);
        assert_eq!(session.counts(Stage::Dsp).lost, 35);
    }

    #[test]
    fn a_session_is_drained_when_every_stage_has_taken_everything() {
        let mut session = SessionMeasurements::default();
        for stage in Stage::ALL {
            session.absorb(&header(stage, 1, 7, 7), &[]);
        }
        assert!(!session.is_drained(), "the source goes on");
        session.absorb(&MeasurementHeader { finished: 1, ..header(Stage::Acquisition, 1, 0, 8) }, &[]);
        assert!(!session.is_drained(), "a block is under way");
        session.absorb(&header(Stage::Dsp, 1, 8, 7), &[]);
        assert!(session.is_drained());
    }

    #[test]
    fn what_no_stage_of_ours_sent_is_passed_over() {
        let mut session = SessionMeasurements::default();
        let times = MessageTimes { newest_sample_to_publish_ns: Some(5), ..MessageTimes::default() };
        let wild = Measured::Decision { times, window_start_to_publish_ns: 9, truth: Some(77), gesture: 200 };
        let wild = wild.into();
        session.absorb(&MeasurementHeader { stage: 9, ..MeasurementHeader::default() }, &[wild]);
        session.absorb(&header(Stage::Decision, 1, 1, 1), &[wild]);
        assert_eq!(session.recognised, <[[u64; 13]; 13]>::default());
        assert_eq!(session.newest_sample_to_command.len(), 1);
    }
}
