//! The arm's error and warning codes, what they mean and what to do about them.
//!
//! Source: the code tables of the vendor's user manual and SDK.

use std::fmt;

/// Whose code it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The control box: the first byte of [`crate::Command::GetErrors`].
    Controller,
    /// A warning of the control box: the second byte.
    Warning,
    /// A joint's motor, which the codes 10 to 17 of the control box point to.
    Servo,
    /// The gripper.
    Gripper,
}

impl fmt::Display for Source {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Source::Controller => "arm error",
            Source::Warning => "arm warning",
            Source::Servo => "joint error",
            Source::Gripper => "gripper error",
        })
    }
}

/// A code other than 0. Its `Display` is one line: what it means and what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Whose code.
    pub source: Source,
    /// The code.
    pub code: u8,
}

/// Turn the arm off and on with the emergency stop button.
const RESTART: &str = "restart the arm: press its emergency stop button, then release it; if the code stays, \
                       ask the vendor's support";
/// Nothing that a user can do.
const SUPPORT: &str = "ask the vendor's support";

impl Fault {
    /// The fault of a code, `None` for 0.
    pub fn new(source: Source, code: u8) -> Option<Fault> {
        (code != 0).then_some(Fault { source, code })
    }

    /// What the code means.
    pub fn words(&self) -> &'static str {
        self.entry().0
    }

    /// What to do about it.
    pub fn remedy(&self) -> &'static str {
        self.entry().1
    }

    /// Whether the emergency stop is pressed, by whatever button or line.
    pub fn is_emergency_stop(&self) -> bool {
        self.source == Source::Controller && matches!(self.code, 1..=3)
    }

    fn entry(&self) -> (&'static str, &'static str) {
        match self.source {
            Source::Controller => controller(self.code),
            Source::Warning => warning(self.code),
            Source::Servo => servo(self.code),
            Source::Gripper => gripper(self.code),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} {}, {}: {}", self.source, self.code, self.words(), self.remedy())
    }
}

fn controller(code: u8) -> (&'static str, &'static str) {
    match code {
        1 => ("the emergency stop button is pressed", "release the button, then arm again"),
        2 => (
            "the emergency stop input of the control box is open",
            "close both EI inputs of the control box, then arm again",
        ),
        3 => {
            ("the emergency stop of the three-state switch is pressed", "release the switch, then arm again")
        }
        10 => ("a joint's motor reports an error", RESTART),
        11 => ("the motor of joint 1 reports an error", RESTART),
        12 => ("the motor of joint 2 reports an error", RESTART),
        13 => ("the motor of joint 3 reports an error", RESTART),
        14 => ("the motor of joint 4 reports an error", RESTART),
        15 => ("the motor of joint 5 reports an error", RESTART),
        16 => ("the motor of joint 6 reports an error", RESTART),
        17 => ("the motor of joint 7 reports an error", RESTART),
        18 => ("the force-torque sensor does not answer", "check that the sensor is mounted and its cable"),
        19 => (
            "the tool at the flange does not answer",
            "check that the gripper is mounted, its cable and its baud rate",
        ),
        21 => ("the kinematics have no solution", "choose another pose"),
        22 => (
            "the arm is about to collide with itself",
            "clear the error and move it away from itself by hand",
        ),
        23 => (
            "a joint is at its limit",
            "clear the error and move the joint back into its range, by hand or with the vendor's program",
        ),
        24 => {
            ("the speed is over its limit", "reduce the speed, or keep away from the edge of the workspace")
        }
        25 => ("the planned motion is impossible", "reduce the speed or choose another pose"),
        26 => ("the real-time system of the control box failed", SUPPORT),
        27 => ("the control box could not answer a command", RESTART),
        28 => ("the board in the flange does not answer", RESTART),
        30 => ("the measured speed is over its limit", SUPPORT),
        31 => (
            "a collision: the motor current is unusual",
            "look for what was touched and clear it, check payload and mounting settings, then arm again",
        ),
        32 => ("an arc cannot be computed from its points", "choose other points"),
        33 => ("the inputs and outputs of the control box failed", "check their wiring and their power"),
        34 => ("the recording of a motion took too long", "record a shorter one"),
        35 => (
            "the arm reached the safety boundary",
            "clear the error and move it back into its box, or widen the box",
        ),
        36 => ("too many delayed commands", "send fewer of them"),
        37 => ("unusual motion while moved by hand", "check payload and mounting settings, then arm again"),
        38 => ("a joint angle is not plausible", RESTART),
        39 => ("the power board does not answer itself", SUPPORT),
        40 => ("there are no joint angles for this motion", "choose another pose or direction"),
        41 => ("the friction file is damaged", RESTART),
        42 => ("the calibration file is damaged", RESTART),
        50..=52 => {
            ("the force-torque sensor failed", "check the sensor, its cable and its mounting, then arm again")
        }
        53 => ("the force-torque sensor is overloaded", "take the load away, then arm again"),
        60 => ("the linear speed is over its limit in servo mode", "send positions that are closer together"),
        110 => ("the board in the base does not answer", SUPPORT),
        111 => ("the device on the RS485 line of the control box does not answer", "check it and its cable"),
        _ => ("a code that Tendon does not know", "look it up in the manual of the arm's firmware"),
    }
}

fn warning(code: u8) -> (&'static str, &'static str) {
    match code {
        11 => ("the queue of commands is full", "send commands more slowly"),
        12 => (
            "a parameter of a command is wrong",
            "check what was sent; the firmware may be of another generation",
        ),
        13 => ("a command is not known", "update the firmware"),
        14 => ("a command has no solution", "choose another pose"),
        15 => ("the queue of Modbus requests is full", "send requests more slowly"),
        _ => ("a code that Tendon does not know", "look it up in the manual of the arm's firmware"),
    }
}

fn servo(code: u8) -> (&'static str, &'static str) {
    match code {
        10 => ("the current cannot be measured", RESTART),
        11 => ("the current is over its limit", RESTART),
        12 => ("the speed is over its limit", RESTART),
        14 => ("the position command is over its limit", RESTART),
        15 => ("the joint is too hot", "switch the arm off and let it cool"),
        16 => ("the encoder did not start", "let nothing push the arm while it starts; else restart it"),
        17 | 18 => {
            ("the encoder failed", "enable the arm again; if the code stays, ask the vendor's support")
        }
        19 => ("the encoder's battery is low", SUPPORT),
        20 | 21 => ("the motor driver failed", RESTART),
        22 => ("the encoder is not set up", SUPPORT),
        23 => ("the joint does not follow", "look for what blocks it; check payload and acceleration"),
        26 => ("the joint is beyond its upper limit", "move it back by hand"),
        27 => ("the joint is beyond its lower limit", "move it back by hand"),
        28 => ("the joint was commanded while not enabled", "enable the arm"),
        33 | 34 => ("the motor is overloaded", "stay within the rated payload"),
        35 | 36 => ("the motor and its driver do not match", RESTART),
        39 => ("the voltage is too high", "reduce the acceleration"),
        40 => {
            ("the voltage is too low", "check that the emergency stop is released; reduce the acceleration")
        }
        49 => ("the memory failed", RESTART),
        52 => ("the motor's angle was not found", RESTART),
        58 => ("no command came for too long", "check the cable between control box and arm"),
        _ => ("a code that Tendon does not know", RESTART),
    }
}

fn gripper(code: u8) -> (&'static str, &'static str) {
    const ENABLE: &str = "enable the gripper again; if the code stays, ask the vendor's support";
    match code {
        9 => ("the current cannot be measured", RESTART),
        11 => ("the current is over its limit", ENABLE),
        12 => ("the speed is over its limit", ENABLE),
        14 => ("the position command is over its limit", ENABLE),
        15 => ("the memory failed", ENABLE),
        20 | 21 => ("the motor driver failed", ENABLE),
        23 => ("the fingers do not follow", "look for what blocks them, then enable the gripper again"),
        25 => ("the position is out of range", "command −10 to 850 pulses"),
        26 => ("the fingers are out of range", SUPPORT),
        33 | 34 => ("the motor is overloaded", "grip less; if the code stays, ask the vendor's support"),
        36 => ("the motor driver is of the wrong type", SUPPORT),
        _ => ("a code that Tendon does not know", ENABLE),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_is_no_fault() {
        assert_eq!(Fault::new(Source::Controller, 0), None);
    }

    #[test]
    fn the_codes_people_meet_are_known() {
        let words = |code| Fault { source: Source::Controller, code }.to_string();
        assert_eq!(
            words(1),
            "arm error 1, the emergency stop button is pressed: release the button, then arm again"
        );
        for (code, word) in [
            (22, "itself"),
            (23, "limit"),
            (24, "speed"),
            (31, "collision"),
            (35, "boundary"),
            (40, "no joint angles"),
        ] {
            assert!(words(code).contains(word), "{}", words(code));
        }
    }
}
