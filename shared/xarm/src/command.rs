//! Commands to the arm, each with its register and parameters.

use std::fmt;

use crate::frame;
use crate::gripper::{self, GripperRequest};

/// How the arm is controlled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Planned motion to target positions.
    Position = 0,
    /// A stream of joint positions.
    Servo = 1,
    /// Teaching: moved by hand.
    Teach = 2,
    /// Joint velocities.
    JointVelocity = 4,
    /// Velocity of the flange.
    CartesianVelocity = 5,
    /// Target joint positions; the newest replaces the one before.
    JointOnline = 6,
    /// Target poses; the newest replaces the one before.
    CartesianOnline = 7,
}

impl Mode {
    /// The mode of this number.
    pub fn from_number(number: u8) -> Option<Mode> {
        use Mode::*;
        [Position, Servo, Teach, JointVelocity, CartesianVelocity, JointOnline, CartesianOnline]
            .into_iter()
            .find(|&mode| mode as u8 == number)
    }
}

/// An order that changes the state of the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StateOrder {
    /// Ready for motion.
    Run = 0,
    /// Pause.
    Pause = 3,
    /// Stop at once and forget all that is queued.
    Stop = 4,
    /// Decelerate, then stop.
    SlowAndStop = 6,
}

impl StateOrder {
    /// The order of this number.
    pub fn from_number(number: u8) -> Option<StateOrder> {
        use StateOrder::*;
        [Run, Pause, Stop, SlowAndStop].into_iter().find(|&order| order as u8 == number)
    }
}

/// The state that the arm reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmState {
    /// In motion.
    Running = 1,
    /// Ready for motion.
    Ready = 2,
    /// Paused.
    Paused = 3,
    /// Stopped: motion is ignored until [`StateOrder::Run`].
    Stopped = 4,
    /// The mode or another setting was changed: motion is ignored until [`StateOrder::Run`].
    ConfigurationChanged = 5,
}

impl ArmState {
    /// The state of this number.
    pub fn from_number(number: u8) -> Option<ArmState> {
        use ArmState::*;
        [Running, Ready, Paused, Stopped, ConfigurationChanged]
            .into_iter()
            .find(|&state| state as u8 == number)
    }

    /// Whether the arm follows velocities in this state.
    pub fn is_ready(self) -> bool {
        matches!(self, ArmState::Running | ArmState::Ready)
    }
}

impl fmt::Display for ArmState {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            ArmState::Running => "running",
            ArmState::Ready => "ready",
            ArmState::Paused => "paused",
            ArmState::Stopped => "stopped",
            ArmState::ConfigurationChanged => {
                "waiting to be set running after a change of its mode or settings"
            }
        })
    }
}

/// The frame of a flange velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TwistFrame {
    /// The base frame.
    Base = 0,
    /// The tool frame.
    Tool = 1,
}

/// Numbers of the arm's registers.
pub mod register {
    #![allow(missing_docs, reason = "each is the command of the same name")]
    pub const GET_VERSION: u8 = 0x01;
    pub const GET_SERIAL_NUMBER: u8 = 0x02;
    pub const ENABLE: u8 = 0x0B;
    pub const SET_STATE: u8 = 0x0C;
    pub const GET_STATE: u8 = 0x0D;
    pub const GET_COMMAND_COUNT: u8 = 0x0E;
    pub const GET_ERRORS: u8 = 0x0F;
    pub const CLEAR_ERROR: u8 = 0x10;
    pub const CLEAR_WARNING: u8 = 0x11;
    pub const SET_MODE: u8 = 0x13;
    pub const GET_POSE: u8 = 0x29;
    pub const GET_JOINTS: u8 = 0x2A;
    pub const SET_REDUCED_SPEED: u8 = 0x2F;
    pub const SET_REDUCED_MODE: u8 = 0x32;
    pub const SET_BOUNDARY: u8 = 0x34;
    pub const SET_FENCE: u8 = 0x3B;
    pub const JOINT_VELOCITY: u8 = 0x51;
    pub const CARTESIAN_VELOCITY: u8 = 0x52;
    pub const GRIPPER: u8 = 0x7C;
}

/// All axes, in [`Command::Enable`].
pub const ALL_AXES: u8 = 8;

/// One request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// The firmware's version: [`crate::reply::Reply::text`].
    GetVersion,
    /// The serial number: [`crate::reply::Reply::text`].
    GetSerialNumber,
    /// Switch the motor of an axis (1 to 7, [`ALL_AXES`]) on or off; takes seconds.
    Enable {
        /// Which axis.
        axis: u8,
        /// On or off.
        on: bool,
    },
    /// Run, pause or stop.
    SetState(StateOrder),
    /// State of the arm: [`crate::reply::Reply::arm_state`].
    GetState,
    /// Number of queued commands: [`crate::reply::Reply::command_count`].
    GetCommandCount,
    /// Error and warning code: [`crate::reply::Reply::codes`].
    GetErrors,
    /// Clear the error; the arm must then be enabled and set running anew.
    ClearError,
    /// Clear the warning.
    ClearWarning,
    /// Change the mode; the arm must then be set running.
    SetMode(Mode),
    /// Pose of the flange: [`crate::reply::Reply::floats`], 6.
    GetPose,
    /// Joint angles: [`crate::reply::Reply::floats`], 7.
    GetJoints,
    /// Greatest linear speed of the flange in reduced mode, in mm/s.
    SetReducedSpeed(f32),
    /// Reduced mode on or off.
    SetReducedMode(bool),
    /// The box that the flange may move in, in mm: x highest and lowest, then y, then z.
    SetBoundary([i32; 6]),
    /// Enforce that box or not.
    SetFence(bool),
    /// Joint velocities, in mode 4.
    JointVelocity {
        /// Joint 1 first, in rad/s.
        velocities_rad_per_s: [f32; 7],
        /// Whether all joints reach their velocity at the same time.
        synchronous: bool,
        /// Time after which the arm comes to rest by itself, in s. 0 or `None`: never.
        duration_s: Option<f32>,
    },
    /// Velocity of the flange, in mode 5.
    CartesianVelocity {
        /// Linear along x, y, z in mm/s, then angular about x, y, z in rad/s.
        twist: [f32; 6],
        /// The frame of `twist`.
        frame: TwistFrame,
        /// Time after which the arm comes to rest by itself, in s. 0 or `None`: never.
        duration_s: Option<f32>,
    },
    /// A request to the gripper.
    Gripper(GripperRequest),
}

/// A request that is not one of [`Command`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// Nothing behind the header.
    #[error("a request without a register: it must have a body of one byte or more")]
    Empty,
    /// A register that no [`Command`] uses.
    #[error("register {0:#04x} is not known")]
    UnknownRegister(u8),
    /// Parameters of another length or range.
    #[error("register {register:#04x} does not take these {length} bytes of parameters")]
    Parameters {
        /// The register.
        register: u8,
        /// Bytes of parameters.
        length: usize,
    },
}

impl Command {
    /// The register that this command goes to.
    pub fn register(&self) -> u8 {
        match self {
            Command::GetVersion => register::GET_VERSION,
            Command::GetSerialNumber => register::GET_SERIAL_NUMBER,
            Command::Enable { .. } => register::ENABLE,
            Command::SetState(_) => register::SET_STATE,
            Command::GetState => register::GET_STATE,
            Command::GetCommandCount => register::GET_COMMAND_COUNT,
            Command::GetErrors => register::GET_ERRORS,
            Command::ClearError => register::CLEAR_ERROR,
            Command::ClearWarning => register::CLEAR_WARNING,
            Command::SetMode(_) => register::SET_MODE,
            Command::GetPose => register::GET_POSE,
            Command::GetJoints => register::GET_JOINTS,
            Command::SetReducedSpeed(_) => register::SET_REDUCED_SPEED,
            Command::SetReducedMode(_) => register::SET_REDUCED_MODE,
            Command::SetBoundary(_) => register::SET_BOUNDARY,
            Command::SetFence(_) => register::SET_FENCE,
            Command::JointVelocity { .. } => register::JOINT_VELOCITY,
            Command::CartesianVelocity { .. } => register::CARTESIAN_VELOCITY,
            Command::Gripper(_) => register::GRIPPER,
        }
    }

    /// Appends the bytes of this request.
    pub fn encode(&self, transaction: u16, into: &mut Vec<u8>) {
        let mut parameters = Parameters { bytes: [0; 40], length: 0 };
        match *self {
            Command::GetVersion
            | Command::GetSerialNumber
            | Command::GetState
            | Command::GetCommandCount
            | Command::GetErrors
            | Command::ClearError
            | Command::ClearWarning
            | Command::GetPose
            | Command::GetJoints => {}
            Command::Enable { axis, on } => parameters.push(&[axis, on.into()]),
            Command::SetState(order) => parameters.push(&[order as u8]),
            Command::SetMode(mode) => parameters.push(&[mode as u8]),
            Command::SetReducedSpeed(speed_mm_per_s) => parameters.push(&speed_mm_per_s.to_le_bytes()),
            Command::SetReducedMode(on) | Command::SetFence(on) => parameters.push(&[on.into()]),
            Command::SetBoundary(limits_mm) => {
                limits_mm.iter().for_each(|limit| parameters.push(&limit.to_le_bytes()));
            }
            Command::JointVelocity { velocities_rad_per_s, synchronous, duration_s } => {
                velocities_rad_per_s.iter().for_each(|value| parameters.push(&value.to_le_bytes()));
                parameters.push(&[synchronous.into()]);
                duration_s.iter().for_each(|value| parameters.push(&value.to_le_bytes()));
            }
            Command::CartesianVelocity { twist, frame, duration_s } => {
                twist.iter().for_each(|value| parameters.push(&value.to_le_bytes()));
                parameters.push(&[frame as u8]);
                duration_s.iter().for_each(|value| parameters.push(&value.to_le_bytes()));
            }
            Command::Gripper(request) => {
                parameters.push(&[gripper::LINE, gripper::ADDRESS]);
                request.encode(&mut parameters);
            }
        }
        frame::encode_request(into, transaction, self.register(), parameters.bytes());
    }

    /// The command in the body of a request.
    ///
    /// # Errors
    /// [`CommandError`] if it is none of these.
    pub fn decode(body: &[u8]) -> Result<Command, CommandError> {
        let [register, parameters @ ..] = body else { return Err(CommandError::Empty) };
        let register = *register;
        let wrong = CommandError::Parameters { register, length: parameters.len() };
        let plain = |command| if parameters.is_empty() { Ok(command) } else { Err(wrong) };
        match register {
            register::GET_VERSION => plain(Command::GetVersion),
            register::GET_SERIAL_NUMBER => plain(Command::GetSerialNumber),
            register::GET_STATE => plain(Command::GetState),
            register::GET_COMMAND_COUNT => plain(Command::GetCommandCount),
            register::GET_ERRORS => plain(Command::GetErrors),
            register::CLEAR_ERROR => plain(Command::ClearError),
            register::CLEAR_WARNING => plain(Command::ClearWarning),
            register::GET_POSE => plain(Command::GetPose),
            register::GET_JOINTS => plain(Command::GetJoints),
            register::ENABLE => match *parameters {
                [axis @ 1..=8, on @ 0..=1] => Ok(Command::Enable { axis, on: on == 1 }),
                _ => Err(wrong),
            },
            register::SET_STATE => {
                let order = one(parameters).and_then(StateOrder::from_number);
                order.map(Command::SetState).ok_or(wrong)
            }
            // Newer clients of the vendor send a second byte, a parameter of collision detection.
            register::SET_MODE => match *parameters {
                [mode] | [mode, _] => Mode::from_number(mode).map(Command::SetMode).ok_or(wrong),
                _ => Err(wrong),
            },
            register::SET_REDUCED_SPEED => {
                let [speed] = floats(parameters).ok_or(wrong)?;
                if parameters.len() == 4 { Ok(Command::SetReducedSpeed(speed)) } else { Err(wrong) }
            }
            register::SET_REDUCED_MODE => {
                one(parameters).and_then(flag).map(Command::SetReducedMode).ok_or(wrong)
            }
            register::SET_FENCE => one(parameters).and_then(flag).map(Command::SetFence).ok_or(wrong),
            register::SET_BOUNDARY => match words(parameters) {
                Some(limits) if parameters.len() == 24 => {
                    Ok(Command::SetBoundary(limits.map(i32::from_le_bytes)))
                }
                _ => Err(wrong),
            },
            register::JOINT_VELOCITY => {
                let velocities_rad_per_s = floats(parameters).ok_or(wrong)?;
                let (synchronous, duration_s) = velocity_end(&parameters[28..]).ok_or(wrong)?;
                Ok(Command::JointVelocity { velocities_rad_per_s, synchronous, duration_s })
            }
            register::CARTESIAN_VELOCITY => {
                let twist = floats(parameters).ok_or(wrong)?;
                let (in_tool, duration_s) = velocity_end(&parameters[24..]).ok_or(wrong)?;
                let frame = if in_tool { TwistFrame::Tool } else { TwistFrame::Base };
                Ok(Command::CartesianVelocity { twist, frame, duration_s })
            }
            register::GRIPPER => match parameters {
                [gripper::LINE, gripper::ADDRESS, modbus @ ..] => {
                    GripperRequest::decode(modbus).map(Command::Gripper).ok_or(wrong)
                }
                _ => Err(wrong),
            },
            _ => Err(CommandError::UnknownRegister(register)),
        }
    }
}

/// The parameters of one request; 33 bytes are the most that any has.
pub(crate) struct Parameters {
    bytes: [u8; 40],
    length: usize,
}

impl Parameters {
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.bytes[self.length..self.length + bytes.len()].copy_from_slice(bytes);
        self.length += bytes.len();
    }

    pub(crate) fn push_read(&mut self, register: u16, words: u8) {
        self.push(&[gripper::MODBUS_READ]);
        self.push(&register.to_be_bytes());
        self.push(&[0, words]);
    }

    fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

fn one(parameters: &[u8]) -> Option<u8> {
    match *parameters {
        [value] => Some(value),
        _ => None,
    }
}

pub(crate) fn flag(value: u8) -> Option<bool> {
    match value {
        0 => Some(false),
        1 => Some(true),
        _ => None,
    }
}

/// Words of four bytes at the beginning.
fn words<const COUNT: usize>(bytes: &[u8]) -> Option<[[u8; 4]; COUNT]> {
    let bytes = bytes.get(..4 * COUNT)?;
    let mut words = [[0; 4]; COUNT];
    for (word, bytes) in words.iter_mut().zip(bytes.chunks_exact(4)) {
        word.copy_from_slice(bytes);
    }
    Some(words)
}

/// Finite numbers at the beginning.
fn floats<const COUNT: usize>(bytes: &[u8]) -> Option<[f32; COUNT]> {
    let values = words(bytes)?.map(f32::from_le_bytes);
    values.iter().all(|value| value.is_finite()).then_some(values)
}

/// What follows the velocities: a flag and perhaps a duration in s.
fn velocity_end(bytes: &[u8]) -> Option<(bool, Option<f32>)> {
    match bytes {
        [end] => Some((flag(*end)?, None)),
        [end, duration @ ..] if duration.len() == 4 => {
            let [duration_s] = floats(duration)?;
            Some((flag(*end)?, Some(duration_s)))
        }
        _ => None,
    }
}
