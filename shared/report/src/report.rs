//! The report of a session, as JSON with stable keys.

use std::collections::BTreeMap;
use std::time::Duration;

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use tendon_gesture::GestureSet;
use tendon_messages::Stage;
use tendon_provenance::Provenance;
use tendon_session_file::RecordingReport;
use tendon_zones::TaskReport;

use crate::measurements::{SessionMeasurements, Summary};

/// What `tendon run` reports. The JSON keys are a contract with other programs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Session name.
    pub session: String,
    /// How long samples flowed, s.
    pub duration_s: f64,
    /// `simulate` or `replay`.
    pub source: String,
    /// `simulate` or `xarm`.
    pub robot: String,
    /// File of the model.
    pub model: String,
    /// The strategy's name.
    pub strategy: String,
    /// What the kernel granted, by stage.
    pub scheduling: BTreeMap<String, String>,
    /// Transit of every hop.
    pub hops: Vec<Hop>,
    /// Work of every stage.
    pub work: Vec<Work>,
    /// Capture of the newest sample to the command's publication.
    pub newest_sample_to_command: LatencySummary,
    /// Capture of the window's first sample to the command's publication.
    pub window_start_to_command: WindowStartSummary,
    /// How late the robot's control ticks were while the arm moved: 250 Hz are wanted.
    pub control_tick: LatencySummary,
    /// The robot's receipt of a command to the bytes given to the arm's network, for commands that moved the arm; empty
    /// with the simulated arm.
    pub command_to_wire: LatencySummary,
    /// Messages published and lost, by topic.
    pub messages: BTreeMap<String, MessageCounts>,
    /// Blocks that the source left out because it could not keep up: they are on no topic.
    pub skipped_blocks: u64,
    /// Samples of each channel that the source lost.
    #[serde(default)]
    pub lost_samples: u64,
    /// How much faster than this computer's clock the source's own counts, in parts per million. Missing when it has none
    /// or that did not become known. Samples are never resampled because of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock_drift_ppm: Option<f64>,
    /// Samples that were NaN or infinite and replaced.
    pub replaced_samples: u64,
    /// Batches of measurements that came too fast to be gathered. Their messages are in `messages`, but in no latency.
    #[serde(default)]
    pub lost_measurement_batches: u64,
    /// Heap allocations of every stage since it was warm (those of ONNX Runtime itself not counted).
    pub allocations: BTreeMap<String, u64>,
    /// How well gestures were recognised, by the truth that travels beside the samples.
    pub recognition: Recognition,
    /// How much faster than the recording a replay at full speed went: seconds of samples per second.
    /// Missing for a live session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub replay_x_real_time: Option<f64>,
    /// How the target-zone task went. Missing for a session without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<TaskReport>,
    /// Stages that ended and were started again.
    pub restarts: u64,
    /// Processor time of every process, s; that of `tendon` itself as `supervisor`.
    pub cpu_s: BTreeMap<String, f64>,
    /// Proportional resident memory of every process, MB (shared pages are divided among those who share).
    pub memory_mb: BTreeMap<String, f64>,
    /// Where the arm ended, mm in its base frame.
    pub final_position_mm: [f64; 3],
    /// How the session ended.
    #[serde(default)]
    pub outcome: Outcome,
    /// Why it broke off or did not start; `null` otherwise.
    #[serde(default)]
    pub error: Option<String>,
    /// What was unusual, in the order in which it happened.
    #[serde(default)]
    pub events: Vec<SessionEvent>,
    /// What the session was recorded to, one for each time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub recordings: Vec<RecordingReport>,
    /// Program, machine, settings, models and recording.
    #[serde(default)]
    pub provenance: Provenance,
}

/// How a session ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// It ran until its time or its recording was over, or somebody ended it.
    #[default]
    Completed,
    /// It ran, and something ended it before its time.
    BrokeOff,
    /// It ended before all stages were ready: nothing was measured.
    NotStarted,
}

/// Something unusual in a session: a stage that hung or was started again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionEvent {
    /// When, s after samples began to flow.
    pub at_s: f64,
    /// What happened, as it was said on the terminal.
    pub text: String,
}

/// What a session knows of itself beside what its stages measured.
#[derive(Clone, Debug, Default)]
pub struct SessionFacts {
    /// Session name.
    pub session: String,
    /// How long samples flowed.
    pub duration: Duration,
    /// `simulate` or `replay`.
    pub source: String,
    /// `simulate` or `xarm`.
    pub robot: String,
    /// File of the model.
    pub model: String,
    /// The strategy's name.
    pub strategy: String,
    /// The session's gestures.
    pub gestures: GestureSet,
    /// What the kernel granted, by stage.
    pub scheduling: BTreeMap<String, String>,
    /// Seconds of samples in a block if the session was a replay at full speed.
    pub full_speed_block_s: Option<f64>,
    /// How the target-zone task went, if there was one.
    pub task: Option<TaskReport>,
    /// Stages that ended and were started again.
    pub restarts: u64,
    /// Processor time of every process, s; that of `tendon` itself as `supervisor`.
    pub cpu_s: BTreeMap<String, f64>,
    /// Proportional resident memory of every process, MB.
    pub memory_mb: BTreeMap<String, f64>,
    /// Where the arm ended, mm in its base frame.
    pub final_position_mm: [f64; 3],
    /// How the session ended.
    pub outcome: Outcome,
    /// Why it broke off or did not start.
    pub error: Option<String>,
    /// What was unusual, in the order in which it happened.
    pub events: Vec<SessionEvent>,
    /// What the session was recorded to.
    pub recordings: Vec<RecordingReport>,
    /// Program, machine, settings, models and recording.
    pub provenance: Provenance,
}

/// Transit of a hop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hop {
    /// The stage that published.
    pub from: String,
    /// The stage that received.
    pub to: String,
    /// Publish to receive.
    #[serde(flatten)]
    pub transit: LatencySummary,
}

/// Work of a stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// The stage.
    pub stage: String,
    /// Receive to publish.
    #[serde(flatten)]
    pub work: LatencySummary,
}

/// Count and percentiles of durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LatencySummary {
    /// How many.
    pub count: u64,
    /// Median, µs.
    pub p50_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// 99.9th percentile, µs.
    pub p999_us: f64,
    /// Longest, µs.
    pub max_us: f64,
}

impl LatencySummary {
    /// Summary of a histogram in ns.
    pub fn of(histogram: &Histogram<u64>) -> LatencySummary {
        let us = |ns: u64| ns as f64 / 1e3;
        LatencySummary {
            count: histogram.len(),
            p50_us: us(histogram.value_at_quantile(0.5)),
            p99_us: us(histogram.value_at_quantile(0.99)),
            p999_us: us(histogram.value_at_quantile(0.999)),
            max_us: us(histogram.max()),
        }
    }
}

/// The paper's latency: window start to command sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WindowStartSummary {
    /// How many.
    pub count: u64,
    /// Mean, ms.
    pub mean_ms: f64,
    /// Standard deviation, ms.
    pub sd_ms: f64,
    /// Shortest, ms.
    pub min_ms: f64,
    /// Median, ms.
    pub median_ms: f64,
    /// Longest, ms.
    pub max_ms: f64,
}

impl WindowStartSummary {
    /// Summary of durations in ns.
    pub fn of(durations: &Summary) -> WindowStartSummary {
        let milliseconds = |ns: f64| ns / 1e6;
        let histogram = &durations.histogram;
        WindowStartSummary {
            count: histogram.len(),
            mean_ms: milliseconds(durations.mean_ns()),
            sd_ms: milliseconds(durations.standard_deviation_ns()),
            min_ms: milliseconds(if histogram.is_empty() { 0 } else { histogram.min() } as f64),
            median_ms: milliseconds(histogram.value_at_quantile(0.5) as f64),
            max_ms: milliseconds(histogram.max() as f64),
        }
    }
}

/// Messages of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MessageCounts {
    /// Published.
    pub published: u64,
    /// Lost before the next stage took them.
    pub lost: u64,
    /// Taken by the next stage but too old to act on.
    pub stale: u64,
}

/// How well gestures were recognised, window by window, before the vote. Only windows that lie wholly inside
/// one gesture (or rest) count.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recognition {
    /// Windows.
    pub windows: u64,
    /// Of these, recognised.
    pub correct: u64,
    /// By true gesture.
    pub per_gesture: BTreeMap<String, GestureRecognition>,
}

/// How well one gesture was recognised.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GestureRecognition {
    /// Windows.
    pub windows: u64,
    /// Of these, recognised.
    pub correct: u64,
    /// Windows by recognised gesture.
    pub recognised_as: BTreeMap<String, u64>,
}

impl Recognition {
    fn of(
        gestures: &GestureSet,
        recognised: &[[u64; GestureSet::MAXIMUM]; GestureSet::MAXIMUM],
    ) -> Recognition {
        let mut recognition = Recognition::default();
        for (number, (truth, row)) in gestures.iter().zip(recognised).enumerate() {
            let windows: u64 = row.iter().sum();
            if windows == 0 {
                continue;
            }
            let correct = row[number];
            recognition.windows += windows;
            recognition.correct += correct;
            let recognised_as = gestures
                .iter()
                .zip(row)
                .filter(|(_, count)| **count > 0)
                .map(|(gesture, count)| (gesture.name().to_owned(), *count))
                .collect();
            recognition
                .per_gesture
                .insert(truth.name().to_owned(), GestureRecognition { windows, correct, recognised_as });
        }
        recognition
    }
}

/// Topic that a stage publishes.
fn topic(stage: Stage) -> &'static str {
    match stage {
        Stage::Acquisition => "blocks",
        Stage::Dsp => "windows",
        Stage::Inference => "predictions",
        Stage::Decision => "commands",
        Stage::Robot => "states",
    }
}

impl Report {
    /// The report of a session that has ended.
    pub fn new(facts: SessionFacts, measurements: &SessionMeasurements) -> Report {
        let replay_x_real_time = facts.full_speed_block_s.map(|block_s| {
            let blocks = measurements.counts(Stage::Acquisition).published;
            blocks as f64 * block_s / measurements.flow().as_secs_f64().max(1e-9)
        });
        let hops = Stage::ALL.into_iter().filter_map(|stage| {
            Some(Hop {
                from: stage.upstream()?.name().to_owned(),
                to: stage.name().to_owned(),
                transit: LatencySummary::of(measurements.transit(stage)),
            })
        });
        let work = Stage::ALL.into_iter().map(|stage| Work {
            stage: stage.name().to_owned(),
            work: LatencySummary::of(measurements.work(stage)),
        });
        let messages = Stage::ALL.into_iter().filter_map(|stage| {
            let upstream = stage.upstream()?;
            let taken = measurements.counts(stage);
            let counts = MessageCounts {
                published: measurements.counts(upstream).published,
                lost: taken.lost,
                stale: taken.stale,
            };
            Some((topic(upstream).to_owned(), counts))
        });
        Report {
            session: facts.session,
            duration_s: facts.duration.as_secs_f64(),
            source: facts.source,
            robot: facts.robot,
            model: facts.model,
            strategy: facts.strategy,
            scheduling: facts.scheduling,
            hops: hops.collect(),
            work: work.collect(),
            newest_sample_to_command: LatencySummary::of(&measurements.newest_sample_to_command),
            window_start_to_command: WindowStartSummary::of(&measurements.window_start_to_command),
            control_tick: LatencySummary::of(&measurements.control_tick),
            command_to_wire: LatencySummary::of(&measurements.command_to_wire),
            messages: messages.collect(),
            skipped_blocks: measurements.counts(Stage::Acquisition).stale,
            lost_samples: measurements.counts(Stage::Acquisition).lost_samples,
            clock_drift_ppm: measurements.clock_drift_ppm(),
            replaced_samples: measurements.counts(Stage::Dsp).replaced_samples,
            lost_measurement_batches: measurements.lost_batches(),
            allocations: Stage::ALL
                .into_iter()
                .map(|stage| (stage.name().to_owned(), measurements.allocations(stage)))
                .collect(),
            recognition: Recognition::of(&facts.gestures, &measurements.recognised),
            replay_x_real_time,
            task: facts.task,
            restarts: facts.restarts,
            cpu_s: facts.cpu_s,
            memory_mb: facts.memory_mb,
            final_position_mm: facts.final_position_mm,
            outcome: facts.outcome,
            error: facts.error,
            events: facts.events,
            recordings: facts.recordings,
            provenance: facts.provenance,
        }
    }
}

#[cfg(test)]
mod tests {
    use tendon_gesture::Gesture;

    use super::*;
    use tendon_messages::{Measured, MeasurementHeader, MessageTimes};

    #[test]
    fn the_report_has_the_keys_that_other_programs_read() {
        let mut measurements = SessionMeasurements::default();
        let decision = MeasurementHeader {
            stage: Stage::Decision.number(),
            received: 2,
            published: 2,
            ..MeasurementHeader::default()
        };
        let times =
            MessageTimes { transit_ns: 20_000, work_ns: 5_000, newest_sample_to_publish_ns: Some(400_000) };
        let seen = |gesture: Gesture| {
            let (truth, gesture) = (Some(1), gesture.paper_number().unwrap());
            Measured::Decision { times, window_start_to_publish_ns: 300_000_000, truth, gesture }.into()
        };
        measurements.absorb(&decision, &[seen(Gesture::EXTENSION), seen(Gesture::GRIP)]);
        let report = Report::new(SessionFacts::default(), &measurements);
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["hops"][2]["from"], "inference");
        assert_eq!(json["hops"][2]["to"], "decision");
        assert_eq!(json["hops"][2]["count"], 2);
        // Three significant digits: the histogram's resolution.
        assert!((json["hops"][2]["p999_us"].as_f64().unwrap() - 20.0).abs() < 0.02);
        assert_eq!(json["work"][3]["stage"], "decision");
        assert_eq!(json["newest_sample_to_command"]["count"], 2);
        assert_eq!(json["window_start_to_command"]["mean_ms"], 300.0);
        assert_eq!(json["messages"]["commands"]["published"], 2);
        assert_eq!(json["messages"]["blocks"]["lost"], 0);
        assert_eq!(json["recognition"]["windows"], 2);
        assert_eq!(json["recognition"]["correct"], 1);
        assert_eq!(json["recognition"]["per_gesture"]["extension"]["recognised_as"]["grip"], 1);
        let all = [
            "session",
            "duration_s",
            "source",
            "robot",
            "model",
            "strategy",
            "scheduling",
            "hops",
            "work",
            "newest_sample_to_command",
            "window_start_to_command",
            "control_tick",
            "command_to_wire",
            "messages",
            "skipped_blocks",
            "lost_samples",
            "replaced_samples",
            "allocations",
            "recognition",
            "restarts",
            "cpu_s",
            "memory_mb",
            "final_position_mm",
            "outcome",
            "error",
            "events",
            "provenance",
        ];
        for key in all {
            assert!(json.get(key).is_some(), "`{key}` is missing");
        }
        for key in ["count", "p50_us", "p99_us", "p999_us", "max_us"] {
            assert!(json["work"][0][key].is_number() && json["control_tick"][key].is_number(), "`{key}`");
        }
        for key in ["count", "mean_ms", "sd_ms", "min_ms", "median_ms", "max_ms"] {
            assert!(json["window_start_to_command"][key].is_number(), "`{key}`");
        }
        assert!(json.get("replay_x_real_time").is_none() && json.get("task").is_none());
        assert!(report.table().contains("recognition  1 of 2 windows inside a gesture (50.0 %)"));
    }
    #[test]
    fn a_report_goes_through_json_unchanged() {
        let mut report = Report::new(SessionFacts::default(), &SessionMeasurements::default());
        report.provenance = Provenance::begin(tendon_provenance::Program { version: "1", commit: "2" });
        report.final_position_mm = [386.123_456, -0.1, 1.0 / 3.0];
        report.replay_x_real_time = Some(1234.5);
        let text = serde_json::to_string(&report).unwrap();
        assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
    }

    #[test]
    fn what_is_no_number_is_null_in_json() {
        let mut report = Report::new(SessionFacts::default(), &SessionMeasurements::default());
        report.cpu_s.insert("dsp".to_owned(), f64::NAN);
        report.duration_s = f64::INFINITY;
        let json = serde_json::to_value(&report).unwrap();
        assert!(json["cpu_s"]["dsp"].is_null() && json["duration_s"].is_null());
        assert!(!serde_json::to_string(&report).unwrap().contains("NaN"));
    }
}
