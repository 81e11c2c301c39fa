//! Settings of the arm, as `[robot.arm]` in a configuration holds them.

use serde::{Deserialize, Serialize};

use crate::kinematics::{JointVector, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, XArm7};
use crate::ramp::{
    ANGULAR_ACCELERATION_RAD_PER_S2, ANGULAR_SPEED_LIMIT_RAD_PER_S, MOST_AVERAGED_STEPS, MotionBounds,
};
use crate::step::STEP_S;
use crate::velocity::{SMALLEST_SINGULAR_VALUE, smallest_singular_value};

/// The longest time from the speed limit to rest, in s. All of it is foreseen in every step.
const LONGEST_BRAKING_S: f64 = 2.0;

/// The least width of the workspace in mm: motion ends a little before its faces.
const LEAST_WORKSPACE_MM: f64 = 10.0;

/// Greatest values that an arm near a person may have: the watchdog, so that silence moves it no further than 30 mm at
/// 100 mm/s; the speed, 250 mm/s, at which ISO 10218-1 lets a person stand beside; accelerations and jerks ten times
/// the defaults'; the gripper's own greatest speed; and the corners of a workspace box that is still within the arm's reach,
/// as the largest of their coordinates without its sign.
const REAL_ARM_LIMITS: [(&str, f64); 7] = [
    ("watchdog_ms", 300.0),
    ("linear_speed_limit_mm_per_s", 250.0),
    ("linear_acceleration_mm_per_s2", 5000.0),
    ("linear_jerk_mm_per_s3", 100_000.0),
    ("gripper_speed_pulses_per_s", 5000.0),
    ("workspace_min_mm", 1000.0),
    ("workspace_max_mm", 1000.0),
];

/// How fast the arm may move, where it starts, and when silence stops it. Unknown keys are errors; keys
/// left out take their defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ArmSettings {
    /// Greatest linear speed of the flange in mm/s. Default 100.
    pub linear_speed_limit_mm_per_s: f64,
    /// Greatest linear acceleration in mm/s². Default 500. Only a stop is quicker ([`crate::STOP_NS`]).
    pub linear_acceleration_mm_per_s2: f64,
    /// Greatest linear jerk in mm/s³. Default 10 000: the acceleration is reached in 50 ms, and a change of velocity
    /// takes 2 · acceleration / jerk = 100 ms longer than without this limit. Only a stop is quicker.
    pub linear_jerk_mm_per_s3: f64,
    /// The arm stops when no command has come for this long, in ms. Default 150.
    pub watchdog_ms: u64,
    /// Lower corner of the workspace box, which the flange never leaves: x, y, z in the base frame in mm. A
    /// gripper reaches further than the flange. Default 200, −400, 150.
    pub workspace_min_mm: [f64; 3],
    /// Upper corner of the workspace box in mm. Default 600, 400, 650.
    pub workspace_max_mm: [f64; 3],
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
            linear_jerk_mm_per_s3: 10_000.0,
            watchdog_ms: 150,
            workspace_min_mm: [200.0, -400.0, 150.0],
            workspace_max_mm: [600.0, 400.0, 650.0],
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
    /// Too gentle: motion must be foreseen until it ends.
    #[error("{key} is {value}: give at least {least}")]
    TooGentle {
        /// The key of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The least value that goes with the other settings.
        least: f64,
    },
    /// More than a real arm near a person may have.
    #[error("{key} is {value}: a real arm near a person may have at most {most}")]
    TooMuchForRealArm {
        /// The key of the setting.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The greatest value.
        most: f64,
    },
    /// A workspace without room.
    #[error(
        "workspace_min_mm has {axis} = {min_mm} and workspace_max_mm {max_mm}: give finite numbers, the first one \
         smaller by 10 mm or more"
    )]
    NoWorkspace {
        /// The axis, `x`, `y` or `z`.
        axis: char,
        /// Its lower limit.
        min_mm: f64,
        /// Its upper limit.
        max_mm: f64,
    },
    /// A start posture out of the workspace.
    #[error(
        "start_joints_deg puts the flange at {axis} = {position_mm:.1} mm, out of the workspace from {min_mm} to \
         {max_mm}: widen workspace_min_mm or workspace_max_mm, or start elsewhere"
    )]
    OutOfWorkspace {
        /// The axis, `x`, `y` or `z`.
        axis: char,
        /// The start position on it.
        position_mm: f64,
        /// Its lower limit.
        min_mm: f64,
        /// Its upper limit.
        max_mm: f64,
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
            ("linear_jerk_mm_per_s3", self.linear_jerk_mm_per_s3),
            ("watchdog_ms", self.watchdog_ms as f64),
            ("gripper_speed_pulses_per_s", self.gripper_speed_pulses_per_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(ArmSettingsError::NotPositive { key, value });
            }
        }
        let acceleration = self.linear_acceleration_mm_per_s2;
        for (key, value, least) in [
            (
                "linear_acceleration_mm_per_s2",
                acceleration,
                self.linear_speed_limit_mm_per_s / LONGEST_BRAKING_S,
            ),
            (
                "linear_jerk_mm_per_s3",
                self.linear_jerk_mm_per_s3,
                2.0 * acceleration / (MOST_AVERAGED_STEPS as f64 * STEP_S),
            ),
        ] {
            if value < least {
                return Err(ArmSettingsError::TooGentle { key, value, least });
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

    /// Checks what a real arm near a person may have; [`ArmSettings::check`] comes first.
    ///
    /// # Errors
    /// [`ArmSettingsError::TooMuchForRealArm`] names the first key that is above its greatest value.
    pub fn check_for_real_arm(&self) -> Result<(), ArmSettingsError> {
        let values = [
            self.watchdog_ms as f64,
            self.linear_speed_limit_mm_per_s,
            self.linear_acceleration_mm_per_s2,
            self.linear_jerk_mm_per_s3,
            self.gripper_speed_pulses_per_s,
            farthest_mm(self.workspace_min_mm),
            farthest_mm(self.workspace_max_mm),
        ];
        match REAL_ARM_LIMITS.into_iter().zip(values).find(|((_, most), value)| value > most) {
            Some(((key, most), value)) => Err(ArmSettingsError::TooMuchForRealArm { key, value, most }),
            None => Ok(()),
        }
    }

    /// Joint angles at the start in rad.
    pub fn start_joints_rad(&self) -> JointVector {
        JointVector::from(self.start_joints_deg.map(f64::to_radians))
    }

    /// Nanoseconds without a command after which the arm slows to rest.
    pub fn watchdog_ns(&self) -> u64 {
        self.watchdog_ms.saturating_mul(1_000_000)
    }

    /// Bounds of the linear motion in mm/s, mm/s² and mm/s³.
    pub fn linear_bounds(&self) -> MotionBounds {
        MotionBounds {
            speed: self.linear_speed_limit_mm_per_s,
            acceleration: self.linear_acceleration_mm_per_s2,
            jerk: self.linear_jerk_mm_per_s3,
        }
    }

    /// Bounds of the angular motion in rad/s, rad/s² and rad/s³. The moving average is that of the linear motion.
    pub fn angular_bounds(&self) -> MotionBounds {
        let averaged_s = self.averaged_steps() as f64 * STEP_S;
        MotionBounds {
            speed: ANGULAR_SPEED_LIMIT_RAD_PER_S,
            acceleration: ANGULAR_ACCELERATION_RAD_PER_S2,
            jerk: 2.0 * ANGULAR_ACCELERATION_RAD_PER_S2 / averaged_s,
        }
    }

    /// The length of the ramp's moving average: 2a/j, in whole steps.
    pub(crate) fn averaged_steps(&self) -> usize {
        let steps = 2.0 * self.linear_acceleration_mm_per_s2 / self.linear_jerk_mm_per_s3 / STEP_S;
        // Less a rounding error, which would cost a step.
        ((steps - 1e-9).ceil() as usize).max(1)
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
        let arm = XArm7::new();
        let position_mm = arm.flange_pose_m(&joints_rad).translation.vector * 1e3;
        for (index, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
            let (min_mm, max_mm) = (self.workspace_min_mm[index], self.workspace_max_mm[index]);
            if !((max_mm - min_mm).is_finite() && max_mm - min_mm >= LEAST_WORKSPACE_MM) {
                return Err(ArmSettingsError::NoWorkspace { axis, min_mm, max_mm });
            }
            let position_mm = position_mm[index];
            if !(min_mm..=max_mm).contains(&position_mm) {
                return Err(ArmSettingsError::OutOfWorkspace { axis, position_mm, min_mm, max_mm });
            }
        }
        let smallest = smallest_singular_value(&arm, &joints_rad);
        if smallest < SMALLEST_SINGULAR_VALUE {
            return Err(ArmSettingsError::Singular { smallest });
        }
        Ok(())
    }
}

fn farthest_mm(corner_mm: [f64; 3]) -> f64 {
    corner_mm.into_iter().map(f64::abs).fold(0.0, f64::max)
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
    fn the_moving_average_is_as_long_as_the_jerk_needs() {
        let steps = |linear_jerk_mm_per_s3| {
            ArmSettings { linear_jerk_mm_per_s3, ..ArmSettings::default() }.averaged_steps()
        };
        assert_eq!([10_000.0, 9_999.0, 1000.0, 1e9].map(steps), [25, 26, MOST_AVERAGED_STEPS, 1]);
        assert!((ArmSettings::default().angular_bounds().jerk - 50.0).abs() < 1e-9);
    }

    #[test]
    fn unknown_keys_are_refused() {
        let error = serde_json::from_str::<ArmSettings>(r#"{"watchdog": 150}"#).unwrap_err();
        assert!(error.to_string().contains("watchdog_ms"), "{error}");
    }

    #[test]
    fn what_disarms_the_watchdog_or_is_too_fast_near_a_person_is_refused() {
        let check = |settings: ArmSettings| settings.check_for_real_arm().map_err(|error| error.to_string());
        let default = ArmSettings::default;
        assert_eq!(check(default()), Ok(()));
        let slow = check(ArmSettings { watchdog_ms: 10_000, ..default() }).unwrap_err();
        assert_eq!(slow, "watchdog_ms is 10000: a real arm near a person may have at most 300");
        let fast = check(ArmSettings { linear_speed_limit_mm_per_s: 1500.0, ..default() }).unwrap_err();
        assert!(fast.starts_with("linear_speed_limit_mm_per_s is 1500:"), "{fast}");
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
        let slow = ArmSettings { linear_acceleration_mm_per_s2: 49.0, ..default() };
        assert_eq!(check(slow), "linear_acceleration_mm_per_s2 is 49: give at least 50");
        let soft = ArmSettings { linear_jerk_mm_per_s3: 999.0, ..default() };
        assert_eq!(check(soft), "linear_jerk_mm_per_s3 is 999: give at least 1000");
        let empty = ArmSettings { workspace_max_mm: [600.0, -400.0, 650.0], ..default() };
        assert!(check(empty).starts_with("workspace_min_mm has y = -400 and workspace_max_mm -400: give"));
        let unbounded = ArmSettings { workspace_max_mm: [f64::INFINITY, 400.0, 650.0], ..default() };
        assert!(check(unbounded).contains("workspace_max_mm inf: give finite"));
        let elsewhere = ArmSettings { workspace_min_mm: [200.0, -400.0, 370.0], ..default() };
        assert!(check(elsewhere).contains("the flange at z = 362."));
        let limit = ArmSettings { start_joints_deg: [0.0, 0.0, 0.0, -20.0, 0.0, 0.0, 0.0], ..default() };
        assert!(check(limit).contains("joint 4 is -20: give an angle from -11.0 to 225.0"));
        let singular =
            ArmSettings { start_joints_deg: [0.0; 7], workspace_min_mm: [200.0, -400.0, 100.0], ..default() };
        assert!(check(singular).contains("singularity"));
    }
}
