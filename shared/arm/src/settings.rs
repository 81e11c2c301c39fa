//! Settings of the arm, as `[robot.arm]` in a configuration holds them.

use serde::{Deserialize, Serialize};

use crate::kinematics::{JointVector, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, XArm7};
use crate::velocity::{SMALLEST_SINGULAR_VALUE, smallest_singular_value};

/// How fast the arm may move, where it starts, and when silence stops it. Unknown keys are errors; keys
/// left out take their defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmSettings {
    /// Greatest linear speed of the flange in mm/s. Default 100.
    pub linear_speed_limit_mm_per_s: f64,
    /// Greatest linear acceleration of the commanded motion in mm/s². Default 500. Only the slowing before a joint
    /// limit or a singularity may be quicker, since the limit comes first.
    pub linear_acceleration_mm_per_s2: f64,
    /// The arm slows to rest when no command has come for this long, in ms. Default 150.
    pub watchdog_ms: u64,
    /// Joint angles at the start in degrees, joint 1 first. Default 0, −15, 0, 45, 0, 60, 0: the flange
    /// looks down from (386, 0, 362) mm with the elbow bent. From there it can go 200 mm along ±y and ±z, with
    /// every joint 25° or more off its limits and the smallest singular value above 0.16.
    pub start_joints_deg: [f64; 7],
    /// Gripper position when open, in pulses (the unit of the xArm gripper). Default 850.
    pub gripper_open_pulses: f64,
    /// Gripper position when closed, in pulses. Default −10.
    pub gripper_closed_pulses: f64,
    /// Speed of the gripper in pulses/s. Default 1500.
    pub gripper_speed_pulses_per_s: f64,
}

impl Default for ArmSettings {
    fn default() -> ArmSettings {
        ArmSettings {
            linear_speed_limit_mm_per_s: 100.0,
            linear_acceleration_mm_per_s2: 500.0,
            watchdog_ms: 150,
            start_joints_deg: [0.0, -15.0, 0.0, 45.0, 0.0, 60.0, 0.0],
            gripper_open_pulses: 850.0,
            gripper_closed_pulses: -10.0,
            gripper_speed_pulses_per_s: 1500.0,
        }
    }
}

/// Settings that no arm can follow.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ArmSettingsError {
    /// A quantity that must be positive is not.
    #[error("{key} is {value}: give a finite number above 0")]
    NotPositive {
        /// The key of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// A gripper position outside the range of the gripper.
    #[error("{key} is {value}: give a position from -10 (closed) to 850 (open) pulses")]
    GripperPosition {
        /// The key of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// A start angle outside the limits of its joint.
    #[error(
        "start_joints_deg: joint {joint} is {angle_deg}: give an angle from {lower_deg:.1} to {upper_deg:.1}"
    )]
    JointLimit {
        /// Number of the joint, 1 to 7.
        joint: usize,
        /// The angle asked for.
        angle_deg: f64,
        /// Lower limit of the joint.
        lower_deg: f64,
        /// Upper limit of the joint.
        upper_deg: f64,
    },
    /// A start posture from which some twists are impossible.
    #[error(
        "start_joints_deg is in or near a singularity (smallest singular value {smallest:.4}, needed \
         {SMALLEST_SINGULAR_VALUE}): bend joints 4 and 6 further, as in the default posture"
    )]
    Singular {
        /// Smallest singular value of the Jacobian in that posture.
        smallest: f64,
    },
}

impl ArmSettings {
    /// Checks every value.
    ///
    /// # Errors
    /// [`ArmSettingsError`] names the first key that cannot be followed.
    pub fn check(&self) -> Result<(), ArmSettingsError> {
        for (key, value) in [
            ("linear_speed_limit_mm_per_s", self.linear_speed_limit_mm_per_s),
            ("linear_acceleration_mm_per_s2", self.linear_acceleration_mm_per_s2),
            ("watchdog_ms", self.watchdog_ms as f64),
            ("gripper_speed_pulses_per_s", self.gripper_speed_pulses_per_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(ArmSettingsError::NotPositive { key, value });
            }
        }
        for (key, value) in [
            ("gripper_open_pulses", self.gripper_open_pulses),
            ("gripper_closed_pulses", self.gripper_closed_pulses),
        ] {
            if !(-10.0..=850.0).contains(&value) {
                return Err(ArmSettingsError::GripperPosition { key, value });
            }
        }
        self.check_start()
    }

    /// Joint angles at the start in rad.
    pub fn start_joints_rad(&self) -> JointVector {
        JointVector::from(self.start_joints_deg.map(f64::to_radians))
    }

    /// Nanoseconds without a command after which the arm slows to rest.
    pub fn watchdog_ns(&self) -> u64 {
        self.watchdog_ms.saturating_mul(1_000_000)
    }

    fn check_start(&self) -> Result<(), ArmSettingsError> {
        let joints_rad = self.start_joints_rad();
        for joint in 0..7 {
            let (lower, upper) = (LOWER_LIMITS_RAD[joint], UPPER_LIMITS_RAD[joint]);
            if !(lower..=upper).contains(&joints_rad[joint]) {
                return Err(ArmSettingsError::JointLimit {
                    joint: joint + 1,
                    angle_deg: self.start_joints_deg[joint],
                    lower_deg: lower.to_degrees(),
                    upper_deg: upper.to_degrees(),
                });
            }
        }
        let smallest = smallest_singular_value(&XArm7::new(), &joints_rad);
        if smallest < SMALLEST_SINGULAR_VALUE {
            return Err(ArmSettingsError::Singular { smallest });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_sound_and_survive_serialization() {
        let settings = ArmSettings::default();
        assert_eq!(settings.check(), Ok(()));
        let text = serde_json::to_string(&settings).unwrap();
        assert_eq!(serde_json::from_str::<ArmSettings>(&text).unwrap(), settings);
        assert_eq!(serde_json::from_str::<ArmSettings>("{}").unwrap(), settings);
    }

    #[test]
    fn unknown_keys_are_refused() {
        let error = serde_json::from_str::<ArmSettings>(r#"{"watchdog": 150}"#).unwrap_err();
        assert!(error.to_string().contains("watchdog_ms"), "{error}");
    }

    #[test]
    fn values_that_cannot_be_followed_are_named() {
        let default = ArmSettings::default;
        let check = |settings: ArmSettings| settings.check().unwrap_err().to_string();
        assert!(check(ArmSettings { watchdog_ms: 0, ..default() }).starts_with("watchdog_ms is 0"));
        let speed = ArmSettings { linear_speed_limit_mm_per_s: f64::NAN, ..default() };
        assert!(check(speed).starts_with("linear_speed_limit_mm_per_s is NaN"));
        let gripper = ArmSettings { gripper_open_pulses: 900.0, ..default() };
        assert!(check(gripper).starts_with("gripper_open_pulses is 900"));
        let limit = ArmSettings { start_joints_deg: [0.0, 0.0, 0.0, -20.0, 0.0, 0.0, 0.0], ..default() };
        assert!(check(limit).contains("joint 4 is -20: give an angle from -11.0 to 225.0"));
        let singular = ArmSettings { start_joints_deg: [0.0; 7], ..default() };
        assert!(check(singular).contains("singularity"));
    }
}
