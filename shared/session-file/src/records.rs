//! The messages of a file that are JSON, one type each.

use serde::{Deserialize, Serialize};
use tendon_messages::{
    CommandHeader, MeasurementHeader, PredictionHeader, STAGE_COUNT, Stage, StateHeader, Trace,
    WindowContext, WindowHeader,
};

use crate::block::Block;
use crate::number::Number;

/// Origin and times of a message, as in its header.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceRecord {
    /// Sequence number on the topic.
    pub sequence: u64,
    /// When the newest sample behind it was captured, CLOCK_MONOTONIC ns.
    pub captured_ns: u64,
    /// When each stage received what led to it; 0 where it was not reached.
    pub received_ns: [u64; STAGE_COUNT],
    /// When each stage published.
    pub published_ns: [u64; STAGE_COUNT],
}

impl From<Trace> for TraceRecord {
    fn from(trace: Trace) -> TraceRecord {
        let Trace { sequence, captured_ns, received_ns, published_ns } = trace;
        TraceRecord { sequence, captured_ns, received_ns, published_ns }
    }
}

impl TraceRecord {
    /// When that stage published.
    pub(crate) fn published_by(&self, stage: Stage) -> u64 {
        self.published_ns[stage.index()]
    }
}

/// What is known of a window beside its samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContextRecord {
    /// Index of its first sample since the source began.
    pub first_sample: u64,
    /// Class number of the true gesture at its newest sample.
    pub truth: Option<u8>,
    /// Since which sample that gesture is made.
    pub truth_since_sample: u64,
    /// Replaced samples in it.
    pub replaced_samples: u32,
    /// Rest that the activity detector still needs, ms.
    pub calibration_left_ms: u32,
    /// 0 calibrating, 1 rest, 2 move.
    pub activity: u8,
}

impl From<WindowContext> for ContextRecord {
    fn from(context: WindowContext) -> ContextRecord {
        ContextRecord {
            first_sample: context.first_sample,
            truth: context.truth.gesture(),
            truth_since_sample: context.truth.since_sample(),
            replaced_samples: context.replaced_samples,
            calibration_left_ms: context.calibration_left_ms,
            activity: context.activity,
        }
    }
}

/// A window, without its samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WindowRecord {
    /// Origin and times.
    pub trace: TraceRecord,
    /// What is known of it.
    pub context: ContextRecord,
}

impl WindowRecord {
    /// A window as it was received.
    pub fn of(header: &WindowHeader) -> WindowRecord {
        WindowRecord { trace: header.trace.into(), context: header.context.into() }
    }
}

/// What was recognised in a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictionRecord {
    /// Origin and times.
    pub trace: TraceRecord,
    /// The window.
    pub context: ContextRecord,
    /// Above 1, the window is unlike every gesture of the calibration.
    pub novelty: Number,
    /// By class number.
    pub probabilities: Vec<Number>,
    /// By class number, from 0 to 1.
    pub efforts: Vec<Number>,
}

impl PredictionRecord {
    /// A prediction as it was received.
    pub fn of(header: &PredictionHeader, payload: &[f32]) -> PredictionRecord {
        let (probabilities, efforts) = payload.split_at(payload.len() / 2);
        PredictionRecord {
            trace: header.trace.into(),
            context: header.context.into(),
            novelty: Number(header.novelty),
            probabilities: numbers(probabilities),
            efforts: numbers(efforts),
        }
    }
}

/// What was decided on a window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommandRecord {
    /// Origin and times.
    pub trace: TraceRecord,
    /// The window.
    pub context: ContextRecord,
    /// Class number of the window's gesture, before the vote.
    pub gesture: u8,
    /// Class number of the gesture acted on.
    pub voted: u8,
    /// Probability of `gesture`.
    pub confidence: Number,
    /// The mode that is on.
    pub mode: u8,
    /// Whose axes the twist is along: 0 the base's, 1 the tool's.
    pub frame: u8,
    /// 1 if it is not clear which gesture is made.
    pub is_unsure: u8,
    /// The place, from 1, of the mode that was ordered, and taken with this window; 0 if none was.
    #[serde(default)]
    pub ordered_mode: u8,
    /// How often the gripper was asked to change sides since the decision process began.
    pub gripper_toggles: u32,
    /// mm/s along, then rad/s about x, y, z.
    pub twist: Vec<Number>,
}

impl CommandRecord {
    /// A command as it was received.
    pub fn of(header: &CommandHeader, payload: &[f32]) -> CommandRecord {
        CommandRecord {
            trace: header.trace.into(),
            context: header.context.into(),
            gesture: header.gesture,
            voted: header.voted,
            confidence: Number(header.confidence),
            mode: header.mode,
            frame: header.frame,
            is_unsure: header.is_unsure,
            ordered_mode: header.ordered_mode,
            gripper_toggles: header.gripper_toggles,
            twist: numbers(payload),
        }
    }
}

/// A state of the arm.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StateRecord {
    /// Origin and times; of the command acted on.
    pub trace: TraceRecord,
    /// Joint angles, rad.
    pub joints_rad: Vec<Number>,
    /// Position of the flange, mm.
    pub position_mm: Vec<Number>,
    /// Roll, pitch, yaw of the flange, rad.
    pub orientation_rad: Vec<Number>,
    /// Speed of the flange, mm/s.
    pub speed_mm_per_s: Number,
    /// In xArm gripper pulses.
    pub gripper_position: Number,
    /// Class number of the gesture acted on.
    pub gesture: u8,
    /// Its probability.
    pub confidence: Number,
    /// Whether the arm may move: a `Permission` as number.
    pub permission: u8,
    /// Why it may not: a `StopReason` as number, 0 for none.
    pub stop_reason: u8,
    /// Error code of the arm's controller.
    pub fault_code: u8,
    /// An `ArmPhase` as number.
    pub arm_phase: u8,
    /// What keeps the arm from following in full, 0 for nothing.
    pub hindrance: u8,
    /// Distance from the start position, mm.
    pub start_distance_mm: Number,
    /// The mode that is on.
    pub mode: u8,
    /// 1 if it is not clear which gesture is made.
    pub is_unsure: u8,
}

impl StateRecord {
    /// A state as it was received.
    pub fn of(header: &StateHeader, payload: &[f32]) -> StateRecord {
        let part = |from: usize, to: usize| numbers(payload.get(from..to).unwrap_or_default());
        StateRecord {
            trace: header.trace.into(),
            joints_rad: part(0, 7),
            position_mm: part(7, 10),
            orientation_rad: part(10, 13),
            speed_mm_per_s: Number(header.speed_mm_per_s),
            gripper_position: Number(header.gripper_position),
            gesture: header.gesture,
            confidence: Number(header.confidence),
            permission: header.permission,
            stop_reason: header.stop_reason,
            fault_code: header.fault_code,
            arm_phase: header.arm_phase,
            hindrance: header.hindrance,
            start_distance_mm: Number(header.start_distance_mm),
            mode: header.mode,
            is_unsure: header.is_unsure,
        }
    }
}

/// Counts of one process so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasurementRecord {
    /// Sequence number of the batch.
    pub sequence: u64,
    /// Name of the stage.
    pub stage: String,
    /// Which process: another one after a restart.
    pub process_id: u64,
    /// Messages received.
    pub received: u64,
    /// Messages published.
    pub published: u64,
    /// Messages lost on the way to it.
    pub lost: u64,
    /// Sequence number of the first message it received, if it received any.
    pub first_sequence: u64,
    /// Sequence number after that of the newest one.
    pub next_sequence: u64,
    /// Messages that were too old to act upon.
    pub stale: u64,
    /// At the source: samples that it lost.
    pub lost_samples: u64,
    /// At the source: how much faster its clock counts, ppm.
    pub clock_drift_ppm: Option<f64>,
    /// NaN and infinite samples replaced.
    pub replaced_samples: u64,
    /// When it was done with its first message, CLOCK_MONOTONIC ns; 0 before.
    pub first_message_ns: u64,
    /// When it was done with its newest message.
    pub newest_message_ns: u64,
    /// 1 when the source has come to its end.
    pub finished: u8,
}

impl MeasurementRecord {
    /// The head of a batch as it was received.
    pub fn of(header: &MeasurementHeader) -> MeasurementRecord {
        let drift_ppm = header.clock_drift_ppm;
        MeasurementRecord {
            sequence: header.trace.sequence,
            stage: Stage::from_number(header.stage).map_or("", Stage::name).to_owned(),
            process_id: header.process_id,
            received: header.received,
            published: header.published,
            lost: header.lost,
            first_sequence: header.first_sequence,
            next_sequence: header.next_sequence,
            stale: header.stale,
            lost_samples: header.lost_samples,
            clock_drift_ppm: Some(drift_ppm).filter(|drift_ppm| drift_ppm.is_finite()),
            replaced_samples: header.replaced_samples,
            first_message_ns: header.first_message_ns,
            newest_message_ns: header.newest_message_ns,
            finished: header.finished,
        }
    }
}

/// Whose word an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// The supervisor's: a stop and its reason, a stage that was started again, a stage that hangs.
    Session,
    /// A person's, by `tendon note`.
    Note,
    /// The recorder's: what it lost.
    Recording,
}

/// Something that was said of the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Event {
    /// When, CLOCK_MONOTONIC ns.
    pub at_ns: u64,
    /// Whose word it is.
    pub kind: EventKind,
    /// What was said.
    pub text: String,
}

/// The true gesture, from a sample on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cue {
    /// Since which sample of the source it is made.
    pub since_sample: u64,
    /// When the block that says so was captured, CLOCK_MONOTONIC ns.
    pub captured_ns: u64,
    /// Its class number; `null` if nobody knows it.
    pub class_number: Option<u8>,
    /// Its name.
    pub gesture: Option<String>,
}

/// A message of the file.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// Raw samples.
    Block(Block),
    /// A window, without its samples.
    Window(WindowRecord),
    /// What was recognised.
    Prediction(PredictionRecord),
    /// What was decided.
    Command(CommandRecord),
    /// What the arm did.
    State(StateRecord),
    /// What a process counted.
    Measurement(MeasurementRecord),
    /// What was said.
    Event(Event),
    /// What was asked for.
    Cue(Cue),
}

fn numbers(values: &[f32]) -> Vec<Number> {
    values.iter().copied().map(Number).collect()
}
