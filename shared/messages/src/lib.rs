//! What the processes say to each other.
//!
//! ```text
//! topic         header             payload
//! blocks        BlockHeader        f32 [channels × samples]   raw EMG as acquired
//! windows       WindowHeader       f32 [channels × samples]   filtered EMG, the classifier's input tensor
//! predictions   PredictionHeader   f32 [2 × gestures]         probability of every gesture, then effort of every gesture
//! commands      CommandHeader      f32 [6]                    twist: mm/s along x y z, rad/s about x y z, of base or tool
//! states        StateHeader        f32 [7 + 6]                joints (rad), then position (mm) and roll pitch yaw (rad)
//! measurements  MeasurementHeader  Measurement [n]            what one process measured of its messages
//! ```
//!
//! Every header starts with a [`Trace`]: the message's sequence number, when its newest sample was captured,
//! and when each stage so far received and published what led to it. Any consumer can therefore compute
//! every hop's transit, every stage's work and the age of the newest sample.
//!
//! Arrays of samples are channel-major, so a window in shared memory is the tensor `[1, channels, samples]`.
#![forbid(unsafe_code)]

mod arm;
mod measurement;
mod numbered;
mod permission;
mod topic;

pub use arm::{ArmPhase, Hindrance};
pub use measurement::{Measured, Measurement, MeasurementHeader, MessageTimes};
pub use permission::{Permission, PermissionChanges, StopReason};
pub use topic::{BLOCKS, COMMANDS, MEASUREMENTS, PREDICTIONS, STATES, Topic, WINDOWS};

use iceoryx2::prelude::ZeroCopySend;

use crate::numbered::numbered;

/// Number of stages on the path of a sample.
pub const STAGE_COUNT: usize = Stage::ALL.len();

numbered! {
    /// A process on the path of a sample, in the order of that path.
    pub enum Stage {
        /// Samples in: simulated, replayed or from an amplifier.
        Acquisition = 0,
        /// Filters, activity detection, windows.
        Dsp = 1,
        /// Class probabilities of a window.
        Inference = 2,
        /// Vote, gripper and velocity map.
        Decision = 3,
        /// The arm, simulated or real.
        Robot = 4,
    }
}

impl Stage {
    /// Index into the arrays of a [`Trace`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The stage's name, which is also its process's: `acquisition`, `dsp`, …
    pub const fn name(self) -> &'static str {
        match self {
            Stage::Acquisition => "acquisition",
            Stage::Dsp => "dsp",
            Stage::Inference => "inference",
            Stage::Decision => "decision",
            Stage::Robot => "robot",
        }
    }

    /// The stage that feeds this one; `None` for the first.
    pub fn upstream(self) -> Option<Stage> {
        self.number().checked_sub(1).and_then(Stage::from_number)
    }
}

/// Where a message comes from and when: the common head of every header.
///
/// All times are CLOCK_MONOTONIC in ns; 0 means that the stage has not been reached. Times of a stage are
/// set by the ports of `tendon-transport`, never by hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
pub struct Trace {
    /// Sequence number of the message on its topic, from 0, without gaps at the publisher.
    pub sequence: u64,
    /// When the newest sample behind this message was captured. Simulated and replayed samples carry the
    /// time they were due, so lateness of the source shows.
    pub captured_ns: u64,
    /// When each stage received the message that led to this one.
    pub received_ns: [u64; STAGE_COUNT],
    /// When each stage published.
    pub published_ns: [u64; STAGE_COUNT],
}

/// A capture time further ahead than this is wrong, ns: all stages read the same clock.
const AHEAD_NS: u64 = 1_000_000;

impl Trace {
    /// Whether the newest sample is older than `stale_ns` at `now_ns`, or its capture time cannot be right because it lies ahead.
    pub fn is_stale(&self, stale_ns: u64, now_ns: u64) -> bool {
        self.captured_ns > now_ns.saturating_add(AHEAD_NS)
            || now_ns.saturating_sub(self.captured_ns) > stale_ns
    }
}

/// A header that starts with a [`Trace`].
pub trait Traced: Copy + Default + core::fmt::Debug + ZeroCopySend + 'static {
    /// The trace.
    fn trace(&self) -> &Trace;
    /// The trace, to be filled in by the publisher.
    fn trace_mut(&mut self) -> &mut Trace;
}

macro_rules! traced {
    ($($header:ty),+) => {
        $(impl Traced for $header {
            fn trace(&self) -> &Trace {
                &self.trace
            }
            fn trace_mut(&mut self) -> &mut Trace {
                &mut self.trace
            }
        })+
    };
}

traced!(BlockHeader, WindowHeader, PredictionHeader, CommandHeader, StateHeader, MeasurementHeader);

/// Class number of rest. The others are places in the session's list of gestures.
pub const REST: u8 = 0;

/// A gesture's class number as it travels, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
struct GestureNumber(u8);

impl GestureNumber {
    const NONE: GestureNumber = GestureNumber(u8::MAX);

    fn new(gesture: Option<u8>) -> GestureNumber {
        gesture.map_or(GestureNumber::NONE, GestureNumber)
    }

    fn get(self) -> Option<u8> {
        (self != GestureNumber::NONE).then_some(self.0)
    }
}

/// The gesture that was really made, as the source knows it. It travels for scoring only: no stage decides
/// by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
pub struct Truth {
    since_sample: u64,
    gesture: GestureNumber,
}

impl Truth {
    /// The gesture with this class number has been made since that sample; `None`: nobody knows which.
    pub fn new(gesture: Option<u8>, since_sample: u64) -> Truth {
        Truth { since_sample, gesture: GestureNumber::new(gesture) }
    }

    /// Class number of the gesture at the newest sample, if it is known.
    pub fn gesture(&self) -> Option<u8> {
        self.gesture.get()
    }

    /// Index of the sample since which the gesture has been the same.
    pub fn since_sample(&self) -> u64 {
        self.since_sample
    }
}

impl Default for Truth {
    fn default() -> Self {
        Truth::new(None, 0)
    }
}

/// Header of a block of raw samples; payload `f32 [channels × samples]`, channel-major.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
pub struct BlockHeader {
    /// Origin and times.
    pub trace: Trace,
    /// Index of the block's first sample since the source began.
    pub first_sample: u64,
    /// Sampling rate in Hz.
    pub sample_rate_hz: f64,
    /// The true gesture at the block's newest sample.
    pub truth: Truth,
    /// Number of channels.
    pub channels: u32,
    /// Samples of each channel.
    pub samples: u32,
    /// NaN and infinite samples among the payload. They stay in the block, which is the signal as acquired;
    /// dsp replaces them.
    pub non_finite_samples: u32,
}

/// Header of a window of filtered samples; payload `f32 [channels × samples]`, channel-major.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
pub struct WindowHeader {
    /// Origin and times.
    pub trace: Trace,
    /// What decision and scoring need to know of the window.
    pub context: WindowContext,
    /// How unlike muscles the least likely channel is: above 1, an electrode is off.
    pub novelty: f32,
    /// Number of channels.
    pub channels: u32,
    /// Samples of each channel.
    pub samples: u32,
}

/// What is known of a window besides its samples; goes unchanged from dsp to decision.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
pub struct WindowContext {
    /// Index of the window's first sample since the source began.
    pub first_sample: u64,
    /// When the window's first sample was captured, CLOCK_MONOTONIC ns.
    pub first_captured_ns: u64,
    /// The true gesture at the window's newest sample.
    pub truth: Truth,
    /// Replaced (NaN, infinite) samples inside the window; a window with any is treated as rest.
    pub replaced_samples: u32,
    /// How much more rest the activity detector needs before it tells rest from movement, ms; 0 once it is calibrated.
    pub calibration_left_ms: u32,
    /// The activity detector's word at the window's newest sample: an [`Activity`] as number.
    pub activity: u8,
    /// What the stages behind dsp are to repeat in the replay of a recorded session: bits of [`ReplayMark`]s; 0 in a live
    /// session.
    pub replay_marks: u8,
    /// The mode that decision was ordered to take with this window when a recorded session was recorded, to be repeated in its
    /// replay: as [`CommandHeader::ordered_mode`]; 0 in a live session.
    pub ordered_mode: u8,
}

/// What a stage did with a window when a session was recorded, and repeats when it is replayed: one bit of
/// [`WindowContext::replay_marks`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayMark {
    /// The inference process was started again: this window is its first.
    InferenceBeganAnew = 1,
    /// The decision process was started again: this window is its first.
    DecisionBeganAnew = 2,
    /// Inference left the window out, or did not get it.
    LeftOutByInference = 4,
    /// Decision left the window out, or did not get it.
    LeftOutByDecision = 8,
}

impl ReplayMark {
    /// Its bit.
    pub const fn bit(self) -> u8 {
        self as u8
    }
}

impl WindowContext {
    /// Whether the window carries this mark.
    pub fn is_marked(&self, mark: ReplayMark) -> bool {
        self.replay_marks & mark.bit() != 0
    }

    /// The true gesture's class number if the window lies wholly inside it, else `None`.
    pub fn gesture_throughout(&self) -> Option<u8> {
        self.truth.gesture().filter(|_| self.truth.since_sample <= self.first_sample)
    }
}

numbered! {
    /// What the activity detector says, as it travels in [`WindowContext::activity`].
    pub enum Activity {
        /// The first seconds at rest are still being measured.
        Calibrating = 0,
        /// The muscles are at rest.
        Rest = 1,
        /// The muscles are active.
        Move = 2,
    } otherwise Calibrating
}

/// Header of a prediction; payload `f32 [2 × gestures]`: the probability of every gesture of the session by class number, 0
/// for those the model does not know; then how hard the contraction is if it is that gesture, from 0 at rest to 1 at a
/// comfortable contraction, 1 if the model does not tell.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
pub struct PredictionHeader {
    /// Origin and times.
    pub trace: Trace,
    /// The window that was classified.
    pub context: WindowContext,
    /// How strange the window is: above 1, it is unlike all gestures of the person's calibration, or an electrode is off.
    pub novelty: f32,
}

/// Header of a command; payload `f32 [6]`, the twist in the frame that the header names: mm/s along x, y, z, then
/// rad/s about x, y, z.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
pub struct CommandHeader {
    /// Origin and times.
    pub trace: Trace,
    /// The window behind the command.
    pub context: WindowContext,
    /// Probability of [`CommandHeader::gesture`], 0 to 1.
    pub confidence: f32,
    /// Class number of this window's gesture, before the vote.
    pub gesture: u8,
    /// How often the gripper was asked to change sides since the decision process began. A count survives the loss of
    /// a message; whether the gripper opens or closes then is for the robot to say, which knows where it stands.
    pub gripper_toggles: u32,
    /// Class number of the gesture acted on, after the vote.
    pub voted: u8,
    /// Whose axes the twist is along and about: a [`TwistFrame`] as number.
    pub frame: u8,
    /// The mode that is on: its place among the modes of the settings.
    pub mode: u8,
    /// 1 if it is not clear which gesture is made, and the arm rests for that.
    pub is_unsure: u8,
    /// The place, from 1, of the mode that was ordered, and taken with this window; 0 if none was.
    pub ordered_mode: u8,
}

numbered! {
    /// Whose axes a twist is along and about, as it travels in [`CommandHeader::frame`].
    pub enum TwistFrame {
        /// Those of the arm's base.
        Base = 0,
        /// Those of the flange.
        Tool = 1,
    } otherwise Base
}

/// Length of a command's payload.
pub const TWIST_LENGTH: usize = 6;

/// Labels and units of a command where others read it: the twist, then the probability of its gesture.
pub const COMMAND_CHANNELS: [(&str, &str); TWIST_LENGTH + 1] = [
    ("x", "mm/s"),
    ("y", "mm/s"),
    ("z", "mm/s"),
    ("about x", "rad/s"),
    ("about y", "rad/s"),
    ("about z", "rad/s"),
    ("confidence", "1"),
];

/// Length of a state's payload: seven joints (rad), position (mm), roll, pitch, yaw (rad).
pub const STATE_LENGTH: usize = 13;

/// Header of the arm's state; payload `f32 [13]`, see [`STATE_LENGTH`].
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
pub struct StateHeader {
    /// Origin and times; of the command acted on.
    pub trace: Trace,
    /// Speed of the flange in mm/s.
    pub speed_mm_per_s: f32,
    /// Gripper position in xArm gripper pulses (850 open, -10 closed); NaN when there is none or it has not told.
    pub gripper_position: f32,
    /// Probability of the last command's gesture, 0 to 1.
    pub confidence: f32,
    /// Class number of the gesture acted on.
    pub gesture: u8,
    /// Whether the arm may move: a [`Permission`] as number.
    pub permission: u8,
    /// Why it may not: a [`StopReason`] as number, 0 for none.
    pub stop_reason: u8,
    /// With [`StopReason::ArmFault`], the error code of the arm's controller.
    pub fault_code: u8,
    /// How far the arm is: an [`ArmPhase`] as number.
    pub arm_phase: u8,
    /// What keeps the arm from following the last command in full: the number of a [`Hindrance`], 0 for nothing.
    pub hindrance: u8,
    /// Distance of the flange from its start position in mm while the arm goes there or waits to; else 0.
    pub start_distance_mm: f32,
    /// How much more rest the activity detector needs, ms; 0 where the strategy does not need it, or it is calibrated.
    pub calibration_left_ms: u32,
    /// The mode that is on: its place among the modes of the settings.
    pub mode: u8,
    /// 1 if it is not clear which gesture is made, and the arm rests for that.
    pub is_unsure: u8,
}
