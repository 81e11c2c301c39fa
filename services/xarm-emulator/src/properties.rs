//! Which arm is played: what it says it is, and what somebody set on its controller.

use tendon_xarm::{Firmware, Identity, Setup};

/// Who the emulated arm is. The default is an xArm7 of 2021 as delivered.
#[derive(Clone, Debug, PartialEq)]
pub struct Properties {
    /// Number of joints that the arm claims to have. It moves as an xArm7 whatever it claims.
    pub axes: u8,
    /// The vendor's number of the model; 7 is the xArm7.
    pub model: u8,
    /// Version of the firmware. One before 1.8.0 ignores the duration of velocities.
    pub firmware: Firmware,
    /// Serial number. Its third to sixth character are the generation, which decides the joint limits.
    pub serial_number: String,
    /// TCP offset, load, sensitivities and mounting.
    pub setup: Setup,
}

impl Default for Properties {
    fn default() -> Properties {
        Properties {
            axes: 7,
            model: Identity::XARM7,
            firmware: Firmware { major: 1, minor: 12, revision: 10 },
            serial_number: "XI130000000000".to_owned(),
            setup: Setup::default(),
        }
    }
}

impl Properties {
    /// The text of register 0x01.
    pub fn version(&self) -> String {
        let Properties { axes, model, firmware, serial_number, .. } = self;
        let arm: String = serial_number.chars().take(6).collect();
        format!("{axes},{model},{arm},AC1300,v{firmware}")
    }

    /// What a client reads from this arm.
    pub(crate) fn identity(&self) -> Option<Identity> {
        Identity::parse(&self.version(), &self.serial_number).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_an_arm_that_the_client_drives() {
        let properties = Properties::default();
        assert_eq!(properties.version(), "7,7,XI1300,AC1300,v1.12.10");
        let identity = properties.identity().unwrap();
        assert_eq!((identity.check(), identity.serial_number.as_str()), (Ok(()), "XI130000000000"));
    }
}
