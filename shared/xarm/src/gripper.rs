//! Requests to the gripper: Modbus RTU without checksum, inside register 0x7C of the arm.
//!
//! ```text
//! 09 │ 08        │ 10       │ 07 00       │ 00 02 │ 04    │ 00 00 03 52
//! line  address    write      register      words   bytes   850 pulses, big-endian
//! ```

use crate::command::{Parameters, flag};

/// A request to the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GripperRequest {
    /// Switch its motor on or off.
    Enable(bool),
    /// Its mode: 0 is motion to positions.
    SetMode(u16),
    /// Its speed, as the vendor counts it: 1 to 5000.
    SetSpeed(u16),
    /// Move to this position in pulses: about −10 (closed) to 850 (open).
    MoveTo(i32),
    /// Where it is, in pulses.
    GetPosition,
    /// Whether it stands (0), moves (1) or holds something (2), in the lowest two bits.
    GetStatus,
    /// Its error code.
    GetError,
}

/// Numbers of the gripper's registers.
pub mod register {
    /// Motion status.
    pub const STATUS: u16 = 0x0000;
    /// Error code.
    pub const ERROR: u16 = 0x000F;
    /// Motor on or off.
    pub const ENABLE: u16 = 0x0100;
    /// Mode.
    pub const MODE: u16 = 0x0101;
    /// Speed.
    pub const SPEED: u16 = 0x0303;
    /// Target position, two registers.
    pub const TARGET: u16 = 0x0700;
    /// Position, two registers.
    pub const POSITION: u16 = 0x0702;
}

/// Who is meant on the RS485 line behind register 0x7C.
pub const LINE: u8 = 0x09;
/// Modbus address of the gripper on that line.
pub const ADDRESS: u8 = 0x08;
/// In the lowest two bits of the status: the fingers stand.
pub const STANDING: u8 = 0;
/// In the lowest two bits of the status: the fingers move.
pub const MOVING: u8 = 1;
/// In the lowest two bits of the status: the fingers hold something.
pub const HOLDING: u8 = 2;
/// Modbus function: read registers.
pub const MODBUS_READ: u8 = 0x03;
/// Modbus function: write registers.
pub const MODBUS_WRITE: u8 = 0x10;

impl GripperRequest {
    pub(crate) fn encode(self, parameters: &mut Parameters) {
        use register::*;
        let mut write = |register: u16, words: u8, value: &[u8]| {
            parameters.push(&[MODBUS_WRITE]);
            parameters.push(&register.to_be_bytes());
            parameters.push(&[0, words, 2 * words]);
            parameters.push(value);
        };
        match self {
            GripperRequest::Enable(on) => write(ENABLE, 1, &u16::from(on).to_be_bytes()),
            GripperRequest::SetMode(mode) => write(MODE, 1, &mode.to_be_bytes()),
            GripperRequest::SetSpeed(speed) => write(SPEED, 1, &speed.to_be_bytes()),
            GripperRequest::MoveTo(pulses) => write(TARGET, 2, &pulses.to_be_bytes()),
            GripperRequest::GetPosition => parameters.push_read(POSITION, 2),
            GripperRequest::GetStatus => parameters.push_read(STATUS, 1),
            GripperRequest::GetError => parameters.push_read(ERROR, 1),
        }
    }

    pub(crate) fn decode(modbus: &[u8]) -> Option<GripperRequest> {
        use register::*;
        match *modbus {
            [MODBUS_WRITE, r0, r1, 0, 1, 2, v0, v1] => {
                let value = u16::from_be_bytes([v0, v1]);
                match u16::from_be_bytes([r0, r1]) {
                    ENABLE => flag(u8::try_from(value).ok()?).map(GripperRequest::Enable),
                    MODE => Some(GripperRequest::SetMode(value)),
                    SPEED => Some(GripperRequest::SetSpeed(value)),
                    _ => None,
                }
            }
            [MODBUS_WRITE, r0, r1, 0, 2, 4, v0, v1, v2, v3] if u16::from_be_bytes([r0, r1]) == TARGET => {
                Some(GripperRequest::MoveTo(i32::from_be_bytes([v0, v1, v2, v3])))
            }
            [MODBUS_READ, r0, r1, 0, words] => match (u16::from_be_bytes([r0, r1]), words) {
                (POSITION, 2) => Some(GripperRequest::GetPosition),
                (STATUS, 1) => Some(GripperRequest::GetStatus),
                (ERROR, 1) => Some(GripperRequest::GetError),
                _ => None,
            },
            _ => None,
        }
    }
}
