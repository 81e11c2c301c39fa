//! Replies of the arm: the state byte that comes with each, and the values that were asked for.

use crate::error::Source;
use crate::frame::{Frame, LONGEST_BODY, PROTOCOL, encode_header};

/// State bits that come with every reply.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StateByte(pub u8);

impl StateByte {
    /// The request was invalid or failed.
    pub const INVALID: u8 = 0x08;
    /// The arm is not ready to move.
    pub const NOT_READY: u8 = 0x10;
    /// A warning is pending.
    pub const WARNING: u8 = 0x20;
    /// An error is pending.
    pub const ERROR: u8 = 0x40;

    /// Whether the request was invalid or failed.
    pub fn is_invalid(self) -> bool {
        self.0 & Self::INVALID != 0
    }

    /// Whether the arm is not ready to move: it ignores motion.
    pub fn is_not_ready(self) -> bool {
        self.0 & Self::NOT_READY != 0
    }

    /// Whether a warning is pending.
    pub fn has_warning(self) -> bool {
        self.0 & Self::WARNING != 0
    }

    /// Whether an error is pending.
    pub fn has_error(self) -> bool {
        self.0 & Self::ERROR != 0
    }
}

/// The answer to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reply<'a> {
    /// The request it answers.
    pub transaction: u16,
    /// The register of that request.
    pub register: u8,
    /// State bits of the arm.
    pub state: StateByte,
    /// The requested values.
    pub parameters: &'a [u8],
}

/// A frame that is not a reply, or a reply without the requested values.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplyError {
    /// Another protocol.
    #[error("reply {transaction} has protocol {protocol} instead of 2: is this the control port of an xArm?")]
    Protocol {
        /// Its transaction id.
        transaction: u16,
        /// Its protocol.
        protocol: u16,
    },
    /// No state byte.
    #[error(
        "reply {transaction} has a body of {length} bytes and no state byte: is this the control port of an xArm?"
    )]
    Truncated {
        /// Its transaction id.
        transaction: u16,
        /// Bytes of its body.
        length: usize,
    },
    /// Too few parameters.
    #[error(
        "the reply of register {register:#04x} has {found} bytes of values instead of {expected}: \
         the firmware may be of another generation, update it"
    )]
    Short {
        /// The register.
        register: u8,
        /// Bytes wanted.
        expected: usize,
        /// Bytes there.
        found: usize,
    },
    /// A value out of its range.
    #[error(
        "the reply of register {register:#04x} holds {value}, which is no {what}: update the firmware or Tendon"
    )]
    Value {
        /// The register.
        register: u8,
        /// What the value should have been.
        what: &'static str,
        /// The value.
        value: String,
    },
    /// The gripper or its line refused.
    #[error(
        "the gripper answered with Modbus exception {code}: check that an xArm gripper (address 8) is mounted, \
         and its cable"
    )]
    Gripper {
        /// Modbus exception code.
        code: u8,
    },
}

impl<'a> Reply<'a> {
    /// The reply in a frame.
    ///
    /// # Errors
    /// [`ReplyError::Protocol`] or [`ReplyError::Truncated`] if the frame is none.
    pub fn parse(frame: &Frame<'a>) -> Result<Reply<'a>, ReplyError> {
        let &Frame { transaction, protocol, body } = frame;
        if protocol != PROTOCOL {
            return Err(ReplyError::Protocol { transaction, protocol });
        }
        match *body {
            [register, state, ref parameters @ ..] => {
                Ok(Reply { transaction, register, state: StateByte(state), parameters })
            }
            _ => Err(ReplyError::Truncated { transaction, length: body.len() }),
        }
    }

    /// Appends the bytes of this reply under a protocol number.
    ///
    /// # Panics
    /// If there are more parameters than fit into [`LONGEST_BODY`] bytes.
    pub fn encode(&self, protocol: u16, into: &mut Vec<u8>) {
        assert!(self.parameters.len() + 2 <= LONGEST_BODY, "{} bytes of values", self.parameters.len());
        encode_header(into, self.transaction, protocol, 2 + self.parameters.len());
        into.extend_from_slice(&[self.register, self.state.0]);
        into.extend_from_slice(self.parameters);
    }

    /// The text of [`crate::Command::GetVersion`] or [`crate::Command::GetSerialNumber`].
    ///
    /// # Errors
    /// [`ReplyError::Value`] if it is no ASCII text.
    pub fn text(&self) -> Result<&'a str, ReplyError> {
        let end = self.parameters.iter().position(|&byte| byte == 0).unwrap_or(self.parameters.len());
        let text = &self.parameters[..end];
        match std::str::from_utf8(text) {
            Ok(text) if text.is_ascii() => Ok(text),
            _ => Err(ReplyError::Value {
                register: self.register,
                what: "ASCII text",
                value: String::from_utf8_lossy(text).into_owned(),
            }),
        }
    }

    /// The one byte of [`crate::Command::GetState`].
    ///
    /// # Errors
    /// [`ReplyError::Short`] without it, [`ReplyError::Value`] if it names no state.
    pub fn arm_state(&self) -> Result<crate::ArmState, ReplyError> {
        let [number] = self.array::<1>()?;
        crate::ArmState::from_number(number).ok_or_else(|| ReplyError::Value {
            register: self.register,
            what: "state of the arm",
            value: number.to_string(),
        })
    }

    /// The error and the warning code of [`crate::Command::GetErrors`]; 0 is none.
    ///
    /// # Errors
    /// [`ReplyError::Short`] without them.
    pub fn codes(&self) -> Result<(u8, u8), ReplyError> {
        let [error, warning] = self.array::<2>()?;
        Ok((error, warning))
    }

    /// Number of queued commands, of [`crate::Command::GetCommandCount`].
    ///
    /// # Errors
    /// [`ReplyError::Short`] without it.
    pub fn command_count(&self) -> Result<u16, ReplyError> {
        Ok(u16::from_be_bytes(self.array::<2>()?))
    }

    /// The values of [`crate::Command::GetPose`] (6: mm, then rad roll pitch yaw) or
    /// [`crate::Command::GetJoints`] (7: rad).
    ///
    /// # Errors
    /// [`ReplyError::Short`] if there are fewer, [`ReplyError::Value`] if one is not finite.
    pub fn floats<const COUNT: usize>(&self) -> Result<[f32; COUNT], ReplyError> {
        let expected = 4 * COUNT;
        let bytes = self.parameters.get(..expected).ok_or_else(|| self.short(expected))?;
        let mut values = [0.0; COUNT];
        for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(4)) {
            *value = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
            if !value.is_finite() {
                return Err(ReplyError::Value {
                    register: self.register,
                    what: "finite number",
                    value: value.to_string(),
                });
            }
        }
        Ok(values)
    }

    /// The values of a Modbus read from the gripper: `COUNT` bytes, without address, function and count.
    ///
    /// # Errors
    /// [`ReplyError::Gripper`] if the gripper refused, [`ReplyError::Short`] if bytes are missing.
    pub fn gripper_values<const COUNT: usize>(&self) -> Result<[u8; COUNT], ReplyError> {
        match *self.parameters {
            [_, _, function, code, ..] if function & 0x80 != 0 => Err(ReplyError::Gripper { code }),
            [_, _, 0x03, count, ref values @ ..] if usize::from(count) == COUNT && values.len() >= COUNT => {
                let mut array = [0; COUNT];
                array.copy_from_slice(&values[..COUNT]);
                Ok(array)
            }
            _ => Err(self.short(4 + COUNT)),
        }
    }

    /// The position of the gripper in pulses, of [`crate::GripperRequest::GetPosition`].
    ///
    /// # Errors
    /// As [`Reply::gripper_values`].
    pub fn gripper_position_pulses(&self) -> Result<i32, ReplyError> {
        Ok(i32::from_be_bytes(self.gripper_values()?))
    }

    /// Whether the gripper moves, of [`crate::GripperRequest::GetStatus`].
    ///
    /// # Errors
    /// As [`Reply::gripper_values`]; firmware of the gripper before 3.4.3 does not know it.
    pub fn gripper_moves(&self) -> Result<bool, ReplyError> {
        let [_, status] = self.gripper_values()?;
        Ok(status & 0x03 == crate::gripper::MOVING)
    }

    /// Whether the gripper accepted a write.
    ///
    /// # Errors
    /// [`ReplyError::Gripper`] if it refused, [`ReplyError::Short`] if it did not answer.
    pub fn gripper_took_it(&self) -> Result<(), ReplyError> {
        match *self.parameters {
            [_, _, function, code, ..] if function & 0x80 != 0 => Err(ReplyError::Gripper { code }),
            [_, _, 0x10, ..] => Ok(()),
            _ => Err(self.short(7)),
        }
    }

    fn array<const COUNT: usize>(&self) -> Result<[u8; COUNT], ReplyError> {
        let bytes = self.parameters.get(..COUNT).ok_or_else(|| self.short(COUNT))?;
        let mut array = [0; COUNT];
        array.copy_from_slice(bytes);
        Ok(array)
    }

    fn short(&self, expected: usize) -> ReplyError {
        ReplyError::Short { register: self.register, expected, found: self.parameters.len() }
    }
}

/// The fault in a reply to [`crate::Command::GetErrors`], if any. An error takes precedence over a warning.
///
/// # Errors
/// As [`Reply::codes`].
pub fn fault(reply: &Reply<'_>) -> Result<Option<crate::Fault>, ReplyError> {
    let (error, warning) = reply.codes()?;
    Ok(crate::Fault::new(Source::Controller, error).or_else(|| crate::Fault::new(Source::Warning, warning)))
}
