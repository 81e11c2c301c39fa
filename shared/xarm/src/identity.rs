//! Who the arm is: number of axes, model, firmware and serial number, and whether this crate can drive it.
//!
//! ```text
//! register 0x01   "7,7,XI1305,AC1305,v2.5.0"          axes, model, arm, controller, firmware
//! register 0x02   "XI130506D01L04\0AC130510C02L05\0"  serial number of the arm, of its controller
//!                    └──┴── generation of the arm, which decides its joint limits
//! ```
//!
//! Sources: the vendor's `xarm-python-sdk` 1.18.4, `x3/base.py` (`_check_version`, `get_robot_sn`) for the two
//! texts, `x3/xarm.py` (`_is_out_of_joint_range`) and `core/config/x_config.py` (`JOINT_LIMITS`) for the limits.

use std::fmt;

/// Text of at most 40 bytes that needs no allocation; what is longer is cut off.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Text {
    bytes: [u8; Text::CAPACITY],
    length: u8,
}

impl Text {
    /// Bytes of the replies that hold texts.
    pub const CAPACITY: usize = 40;

    /// The printable ASCII characters of `text`; anything else becomes `?`.
    pub fn new(text: &str) -> Text {
        let mut bytes = [0; Text::CAPACITY];
        let mut length = 0;
        for (place, character) in bytes.iter_mut().zip(text.chars()) {
            *place =
                if character.is_ascii() && !character.is_ascii_control() { character as u8 } else { b'?' };
            length += 1;
        }
        Text { bytes, length }
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        // Only ASCII is ever stored.
        std::str::from_utf8(&self.bytes[..usize::from(self.length)]).unwrap_or_default()
    }
}

impl fmt::Display for Text {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.as_str())
    }
}

impl fmt::Debug for Text {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), formatter)
    }
}

/// Version of the arm's firmware. Versions compare in order of release.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Firmware {
    /// First number.
    pub major: u16,
    /// Second number.
    pub minor: u16,
    /// Third number.
    pub revision: u16,
}

impl Firmware {
    /// Older firmware ignores the `duration` of velocities (`vc_set_cartesian_velocity` in `x3/xarm.py`), so the
    /// arm would not come to rest by itself when the program or the cable is gone.
    pub const OLDEST_SUPPORTED: Firmware = Firmware { major: 1, minor: 8, revision: 0 };

    /// The version in a text such as `v1.12.10` or `2.5.0-beta`.
    pub fn parse(text: &str) -> Option<Firmware> {
        let mut numbers = text.trim().trim_start_matches(['v', 'V']).splitn(3, '.').map(|number| {
            let end = number.find(|character: char| !character.is_ascii_digit()).unwrap_or(number.len());
            number[..end].parse().ok()
        });
        let mut next = || numbers.next().flatten();
        Some(Firmware { major: next()?, minor: next()?, revision: next()? })
    }

    /// Whether velocities end after their duration.
    pub fn obeys_duration(self) -> bool {
        self >= Firmware::OLDEST_SUPPORTED
    }
}

impl fmt::Display for Firmware {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}.{}.{}", self.major, self.minor, self.revision)
    }
}

/// Why this crate does not drive an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unsupported {
    /// The version text has another form.
    #[error(
        "the arm's version `{0}` cannot be read (expected `7,7,XI1305,AC1305,v2.5.0` or similar): check that \
         robot.xarm.address is the control box of an xArm7, and update its firmware"
    )]
    Version(Text),
    /// Not an xArm7.
    #[error(
        "the arm has {0} axes, and Tendon drives the 7-axis xArm7 only: check robot.xarm.address, or connect an xArm7"
    )]
    Axes(u8),
    /// Seven axes with other kinematics.
    #[error(
        "the arm is a 7-axis model of type {0}, and Tendon knows the kinematics of type 7 (xArm7) only: check \
         robot.xarm.address, or connect an xArm7"
    )]
    Model(u8),
    /// The arm would not come to rest by itself.
    #[error(
        "the arm's firmware {0} is too old: before 1.8.0 an arm keeps moving when the program or the cable is gone; \
         update the firmware with the vendor's program (UFACTORY Studio)"
    )]
    Firmware(Firmware),
}

/// Lowest and highest angle of each joint in rad, joint 1 first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Lowest.
    pub lower_rad: [f64; 7],
    /// Highest.
    pub upper_rad: [f64; 7],
}

/// Who the arm is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Number of joints.
    pub axes: u8,
    /// The vendor's number of the model; 7 is the xArm7.
    pub model: u8,
    /// Serial number of the arm, at least its first six characters; empty if the arm has none.
    pub serial_number: Text,
    /// Serial number of the control box, at least its first six characters.
    pub controller: Text,
    /// Version of the firmware.
    pub firmware: Firmware,
}

impl Identity {
    /// The vendor's number of the xArm7 whose kinematics Tendon knows.
    pub const XARM7: u8 = 7;

    /// From the texts of registers 0x01 and 0x02; the second one may be empty.
    ///
    /// # Errors
    /// [`Unsupported::Version`] if the version has another form.
    pub fn parse(version: &str, serial_number: &str) -> Result<Identity, Unsupported> {
        let unreadable = Unsupported::Version(Text::new(version));
        let mut fields = version.splitn(5, ',').map(str::trim);
        let mut next = || fields.next().ok_or(unreadable);
        let axes = next()?.parse().map_err(|_| unreadable)?;
        let model = next()?.parse().map_err(|_| unreadable)?;
        let arm = next()?;
        let controller = next()?;
        let firmware = Firmware::parse(next()?).ok_or(unreadable)?;
        let serial_number = if serial_number.trim().is_empty() { arm } else { serial_number.trim() };
        Ok(Identity {
            axes,
            model,
            serial_number: Text::new(serial_number),
            controller: Text::new(controller),
            firmware,
        })
    }

    /// Whether this crate can drive the arm.
    ///
    /// # Errors
    /// [`Unsupported`] says why not, and what to do.
    pub fn check(&self) -> Result<(), Unsupported> {
        if self.axes != 7 {
            return Err(Unsupported::Axes(self.axes));
        }
        if self.model != Identity::XARM7 {
            return Err(Unsupported::Model(self.model));
        }
        if !self.firmware.obeys_duration() {
            return Err(Unsupported::Firmware(self.firmware));
        }
        Ok(())
    }

    /// The generation of the arm: the third to sixth character of its serial number, if they are digits.
    pub fn generation(&self) -> Option<u16> {
        let digits = self.serial_number.as_str().get(2..6)?;
        digits.bytes().all(|byte| byte.is_ascii_digit()).then(|| digits.parse().ok())?
    }

    /// The joint limits of an xArm7 of this generation. From 1305 on joints 2 and 4 have less room; an arm of
    /// unknown generation is taken for one of these.
    pub fn joint_limits(&self) -> JointLimits {
        const TURN: f64 = std::f64::consts::TAU;
        const HALF_TURN: f64 = std::f64::consts::PI;
        if self.generation().is_some_and(|generation| generation < 1305) {
            JointLimits {
                lower_rad: [-TURN, -2.059488, -TURN, -0.191986, -TURN, -1.692969, -TURN],
                upper_rad: [TURN, 2.094395, TURN, 3.92699, TURN, HALF_TURN, TURN],
            }
        } else {
            JointLimits {
                lower_rad: [-TURN, -2.042035, -TURN, -0.10472, -TURN, -1.692969, -TURN],
                upper_rad: [TURN, 2.024581, TURN, 3.92699, TURN, HALF_TURN, TURN],
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn identity(version: &str) -> Identity {
        Identity::parse(version, "XI130506D01L04").unwrap()
    }

    #[test]
    fn the_vendors_texts_are_read() {
        let identity = identity("7,7,XI1305,AC1305,v2.5.0");
        assert_eq!((identity.axes, identity.model), (7, 7));
        assert_eq!(identity.serial_number.as_str(), "XI130506D01L04");
        assert_eq!(identity.controller.as_str(), "AC1305");
        assert_eq!(identity.firmware, Firmware { major: 2, minor: 5, revision: 0 });
        assert_eq!(identity.check(), Ok(()));
        let without_serial_number = Identity::parse("7,7,XI1300,AC1300,v1.12.10", "").unwrap();
        assert_eq!(without_serial_number.serial_number.as_str(), "XI1300");
    }

    #[test]
    fn what_is_not_supported_is_refused_by_name() {
        let refusal = |version: &str| identity(version).check().unwrap_err();
        assert_eq!(refusal("6,6,XI1202,AC1302,v1.12.10"), Unsupported::Axes(6));
        assert_eq!(refusal("7,13,XI1305,AC1305,v2.5.0"), Unsupported::Model(13));
        let old = Firmware { major: 1, minor: 7, revision: 9 };
        assert_eq!(refusal("7,7,XI1300,AC1300,v1.7.9"), Unsupported::Firmware(old));
        assert!(refusal("7,7,XI1300,AC1300,v1.7.9").to_string().contains("firmware 1.7.9 is too old"));
        for supported in ["v1.8.0", "1.8.0", "v1.10.0-beta", "v2.0.0"] {
            assert_eq!(identity(&format!("7,7,XI1300,AC1300,{supported}")).check(), Ok(()), "{supported}");
        }
        for unreadable in
            ["", "v1.12.10", "7,7,XI1300,AC1300", "7,7,XI1300,AC1300,v1", "x,7,XI1300,AC1300,v1.8.0"]
        {
            let refused = Identity::parse(unreadable, "").unwrap_err();
            assert_eq!(refused, Unsupported::Version(Text::new(unreadable)));
        }
    }

    #[test]
    fn joint_limits_follow_the_serial_number() {
        let of = |serial_number: &str| {
            let identity = Identity::parse("7,7,,,v2.5.0", serial_number).unwrap();
            let limits = identity.joint_limits();
            [limits.lower_rad[1], limits.upper_rad[1], limits.lower_rad[3], limits.upper_rad[3]]
        };
        let wide = [-2.059488, 2.094395, -0.191986, 3.92699];
        let narrow = [-2.042035, 2.024581, -0.10472, 3.92699];
        assert_eq!((of("XI130406D01L04"), of("XF120000")), (wide, wide));
        assert_eq!((of("XI130506D01L04"), of("XI1400")), (narrow, narrow));
        // An unknown one might be new.
        assert_eq!((of(""), of("XIABCD"), of("XI")), (narrow, narrow, narrow));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(version in ".{0,60}", serial_number in ".{0,60}") {
            match Identity::parse(&version, &serial_number) {
                Ok(identity) => {
                    let _ = (identity.check(), identity.generation(), identity.joint_limits());
                    prop_assert!(identity.serial_number.as_str().len() <= Text::CAPACITY);
                }
                Err(refused) => prop_assert_eq!(refused, Unsupported::Version(Text::new(&version))),
            }
        }
    }
}
