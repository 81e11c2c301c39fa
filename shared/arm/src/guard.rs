//! What an arm reports, held against its limits.

use nalgebra::Vector3;

use crate::ArmSettings;
use crate::kinematics::{JointLimits, JointVector, XArm7};

/// A reported joint angle may be so far beyond its limit, in rad.
const JOINT_TOLERANCE_RAD: f64 = 0.01;

/// A reported position may be so far out of the workspace, in mm.
const BOX_TOLERANCE_MM: f64 = 2.0;

/// Speed is measured between reports that are at least this far apart, in ns: one that comes 50 ms late, on a busy
/// machine, must not look like a fast arm.
const SPEED_OVER_NS: u64 = 100_000_000;

/// Positions are kept for speeds at least this far apart, in ns.
const KEPT_EVERY_NS: u64 = 8_000_000;

/// As many positions as lie within [`SPEED_OVER_NS`], and some for reports that come late.
const KEPT: usize = 24;

/// An arm commanded to rest may be as fast as this, in mm/s: what the noise of its reports may look like.
const CREEP_MM_PER_S: f64 = 10.0;

/// After so long at commanded rest, in ns, the arm must be at rest: a stop takes 80 ms, the way of commands and reports
/// some more, and the arm's own deceleration from full speed up to 0.25 s.
const BRAKING_NS: u64 = 350_000_000;

/// An arm is not where, or not as fast, as it should be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LimitViolation {
    /// A joint is beyond its limit, or its angle not a number.
    #[error(
        "joint {joint} is at {angle_deg:.1}°, beyond its limit: drive it back within its range by hand or with the \
         vendor's software, then run `tendon arm`"
    )]
    JointLimit {
        /// Number of the joint, 1 to 7.
        joint: usize,
        /// Its angle in degrees.
        angle_deg: f64,
    },
    /// The flange is out of the workspace, or its position not a number.
    #[error(
        "the flange is at {axis} = {position_mm:.1} mm, out of the workspace: drive it back inside (or widen \
         workspace_min_mm and workspace_max_mm), then run `tendon arm`"
    )]
    WorkspaceBox {
        /// The axis, `x`, `y` or `z`.
        axis: char,
        /// The position on it in mm.
        position_mm: f64,
    },
    /// The flange moves though the arm is commanded to rest.
    #[error(
        "the flange moves at {speed_mm_per_s:.0} mm/s though the arm is commanded to rest: find out what drives or \
         pulls it, then run `tendon arm`"
    )]
    Creeping {
        /// Its mean speed over 0.1 s in mm/s.
        speed_mm_per_s: f64,
    },
    /// The flange is faster than any command allows.
    #[error(
        "the flange moves at {speed_mm_per_s:.0} mm/s, faster than it was told: find out what else drives the arm, \
         then run `tendon arm`"
    )]
    OverSpeed {
        /// Its mean speed between two reports in mm/s.
        speed_mm_per_s: f64,
    },
}

/// Watches the reports of an arm: that it stays within joint limits, workspace and speed, whatever it was told, and at
/// rest while it is commanded to. The position of the flange is that of our own kinematics: what the arm calls its
/// position is that of a tool.
///
/// It is software: it is not safety-rated and replaces no emergency stop.
#[derive(Clone, Debug)]
pub struct Guard {
    arm: XArm7,
    joint_limits: JointLimits,
    workspace_min_mm: [f64; 3],
    workspace_max_mm: [f64; 3],
    most_mm_per_s: f64,
    /// Times (ns) and positions (mm) from which speed is measured, the oldest at `next`.
    kept: [(u64, Vector3<f64>); KEPT],
    next: usize,
    count: usize,
    /// Since when the arm has been commanded to rest.
    resting_since_ns: Option<u64>,
    was_inside: bool,
}

impl Guard {
    /// A guard without history. Half as much again as the speed limit, and 20 mm/s, count as too fast.
    pub fn new(settings: &ArmSettings) -> Guard {
        Guard {
            arm: XArm7::new(),
            joint_limits: JointLimits::default(),
            workspace_min_mm: settings.workspace_min_mm,
            workspace_max_mm: settings.workspace_max_mm,
            most_mm_per_s: 1.5 * settings.linear_speed_limit_mm_per_s + 20.0,
            kept: [(0, Vector3::zeros()); KEPT],
            next: 0,
            count: 0,
            resting_since_ns: None,
            was_inside: false,
        }
    }

    /// Holds the joints against these limits from now on; before, [`JointLimits::default`].
    pub fn set_joint_limits(&mut self, limits: JointLimits) {
        self.joint_limits = limits;
    }

    /// Checks a report of joint angles (rad) that was looked at at `now_ns`. `is_at_rest`: the arm is commanded to rest
    /// then.
    ///
    /// A flange that was outside the workspace from the beginning, or since [`Guard::reset`], may be there until it is
    /// inside for the first time: otherwise nothing could drive it back.
    ///
    /// # Errors
    /// The first [`LimitViolation`] found.
    pub fn check(
        &mut self,
        now_ns: u64,
        joints_rad: &JointVector,
        is_at_rest: bool,
    ) -> Result<(), LimitViolation> {
        self.check_joints(joints_rad)?;
        let position_mm = self.arm.flange_pose_m(joints_rad).translation.vector * 1e3;
        self.check_box(&position_mm)?;
        self.check_speed(now_ns, position_mm, is_at_rest)
    }

    fn check_joints(&self, joints_rad: &JointVector) -> Result<(), LimitViolation> {
        for joint in 0..7 {
            let lowest_rad = self.joint_limits.lower_rad[joint] - JOINT_TOLERANCE_RAD;
            let highest_rad = self.joint_limits.upper_rad[joint] + JOINT_TOLERANCE_RAD;
            if !(lowest_rad..=highest_rad).contains(&joints_rad[joint]) {
                let angle_deg = joints_rad[joint].to_degrees();
                return Err(LimitViolation::JointLimit { joint: joint + 1, angle_deg });
            }
        }
        Ok(())
    }

    fn check_box(&mut self, position_mm: &Vector3<f64>) -> Result<(), LimitViolation> {
        let outside = ['x', 'y', 'z'].into_iter().enumerate().find(|(index, _)| {
            let lowest_mm = self.workspace_min_mm[*index] - BOX_TOLERANCE_MM;
            let highest_mm = self.workspace_max_mm[*index] + BOX_TOLERANCE_MM;
            !(lowest_mm..=highest_mm).contains(&position_mm[*index])
        });
        match outside {
            None => self.was_inside = true,
            Some((index, axis)) if self.was_inside => {
                return Err(LimitViolation::WorkspaceBox { axis, position_mm: position_mm[index] });
            }
            Some(_) => {}
        }
        Ok(())
    }

    fn check_speed(
        &mut self,
        now_ns: u64,
        position_mm: Vector3<f64>,
        is_at_rest: bool,
    ) -> Result<(), LimitViolation> {
        if is_at_rest {
            self.resting_since_ns.get_or_insert(now_ns);
        } else {
            self.resting_since_ns = None;
        }
        let Some((from_ns, from_mm)) = self.position_before(now_ns) else {
            self.keep(now_ns, position_mm);
            return Ok(());
        };
        self.keep(now_ns, position_mm);
        let speed_mm_per_s = (position_mm - from_mm).norm() / ((now_ns - from_ns) as f64 * 1e-9);
        if speed_mm_per_s > self.most_mm_per_s {
            return Err(LimitViolation::OverSpeed { speed_mm_per_s });
        }
        // All of the time over which the speed was measured lies after the braking.
        let has_braked = self.resting_since_ns.is_some_and(|since_ns| from_ns >= since_ns + BRAKING_NS);
        if has_braked && speed_mm_per_s > CREEP_MM_PER_S {
            return Err(LimitViolation::Creeping { speed_mm_per_s });
        }
        Ok(())
    }

    /// The newest position kept that is old enough to measure speed from.
    fn position_before(&self, now_ns: u64) -> Option<(u64, Vector3<f64>)> {
        let is_old_enough =
            |&&(at_ns, _): &&(u64, Vector3<f64>)| now_ns.saturating_sub(at_ns) >= SPEED_OVER_NS;
        self.kept[..self.count].iter().filter(is_old_enough).max_by_key(|(at_ns, _)| *at_ns).copied()
    }

    fn keep(&mut self, now_ns: u64, position_mm: Vector3<f64>) {
        let newest_ns = self.kept[(self.next + KEPT - 1) % KEPT].0;
        if self.count == 0 || now_ns.saturating_sub(newest_ns) >= KEPT_EVERY_NS {
            self.kept[self.next] = (now_ns, position_mm);
            self.next = (self.next + 1) % KEPT;
            self.count = (self.count + 1).min(KEPT);
        }
    }

    /// Forgets where the arm was: for a new connection, or when the guard did not watch for a while.
    pub fn reset(&mut self) {
        self.count = 0;
        self.next = 0;
        self.resting_since_ns = None;
        self.was_inside = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Twist;
    use crate::kinematics::UPPER_LIMITS_RAD;
    use crate::velocity::joint_velocities;

    const MS: u64 = 1_000_000;

    fn guard() -> (Guard, JointVector) {
        let settings = ArmSettings::default();
        (Guard::new(&settings), settings.start_joints_rad())
    }

    /// Joints (rad) every 4 ms of an arm whose flange moves along an axis at this speed from the start.
    fn moving(axis: usize, speed_mm_per_s: f64) -> impl Iterator<Item = (u64, JointVector)> {
        let (arm, mut joints_rad) = (XArm7::new(), ArmSettings::default().start_joints_rad());
        let mut twist = Twist::ZERO;
        twist.linear_mm_per_s[axis] = speed_mm_per_s;
        (0..).map(move |step| {
            let now = joints_rad;
            joints_rad += joint_velocities(&arm, &joints_rad, &twist).rad_per_s * 4e-3;
            (step * 4 * MS, now)
        })
    }

    #[test]
    fn an_arm_within_its_limits_passes() {
        let (mut guard, _) = guard();
        assert!(
            moving(1, 100.0).take(900).all(|(now_ns, joints)| guard.check(now_ns, &joints, false).is_ok())
        );
    }

    #[test]
    fn a_joint_beyond_its_limit_is_named() {
        let (mut guard, mut joints) = guard();
        joints[3] = UPPER_LIMITS_RAD[3] + 0.009;
        assert_eq!(guard.check(0, &joints, false), Ok(()));
        joints[3] = UPPER_LIMITS_RAD[3] + 0.011;
        let violation = guard.check(0, &joints, false).unwrap_err();
        assert!(matches!(violation, LimitViolation::JointLimit { joint: 4, .. }));
        assert!(
            violation.to_string().contains("joint 4 is at 225.6°")
                && violation.to_string().contains("tendon arm")
        );
        joints[3] = f64::NAN;
        assert!(guard.check(0, &joints, false).is_err());
        // The limits are those of the arm that is there.
        let (mut guard, mut joints) = self::guard();
        joints[1] = 2.035;
        assert_eq!(guard.check(0, &joints, false), Ok(()));
        let mut limits = JointLimits::default();
        limits.upper_rad[1] = 2.0246;
        guard.set_joint_limits(limits);
        assert!(matches!(guard.check(0, &joints, false), Err(LimitViolation::JointLimit { joint: 2, .. })));
    }

    #[test]
    fn a_flange_that_leaves_the_workspace_is_named_and_may_come_back() {
        let (mut guard, _) = guard();
        let found = moving(2, 100.0)
            .find_map(|(now_ns, joints)| Some((guard.check(now_ns, &joints, false).err()?, joints)));
        let (violation, outside) = found.unwrap();
        assert!(matches!(violation, LimitViolation::WorkspaceBox { axis: 'z', .. }));
        guard.reset();
        assert_eq!(guard.check(0, &outside, false), Ok(()));
        assert_eq!(guard.check(4 * MS, &ArmSettings::default().start_joints_rad(), false), Ok(()));
        assert!(guard.check(8 * MS, &outside, false).is_err());
    }

    #[test]
    fn too_fast_is_found_over_100_ms() {
        let (mut guard, joints) = guard();
        let found = moving(1, 175.0).find(|(now_ns, joints)| guard.check(*now_ns, joints, false).is_err());
        assert_eq!(found.unwrap().0, 100 * MS);
        // A jump within less than 100 ms is an outlier of the report, or shows in the next measurement.
        guard.reset();
        let (_, aside) = moving(1, 100.0).nth(12).unwrap();
        assert_eq!(guard.check(0, &joints, false), Ok(()));
        assert_eq!(guard.check(4 * MS, &aside, false), Ok(()));
        assert_eq!(guard.check(52 * MS, &aside, false), Ok(()));
    }

    #[test]
    fn an_arm_that_creeps_at_commanded_rest_is_found_within_100_ms_of_the_braking() {
        for (speed_mm_per_s, found_ms) in [(20.0, Some(452)), (60.0, Some(452)), (9.0, None)] {
            let (mut guard, _) = guard();
            let mut creeping = moving(1, speed_mm_per_s).take(1000);
            let found = creeping.find(|(now_ns, joints)| guard.check(*now_ns, joints, true).is_err());
            assert_eq!(found.map(|(now_ns, _)| now_ns / MS), found_ms, "{speed_mm_per_s} mm/s");
        }
        // One that comes to rest in time does not, whatever it was commanded before.
        let (mut guard, _) = guard();
        for (now_ns, joints) in moving(1, 100.0).take(100) {
            assert_eq!(guard.check(now_ns, &joints, false), Ok(()));
        }
        let (begin_ns, resting) = moving(1, 100.0).nth(160).unwrap();
        for (now_ns, joints) in moving(1, 100.0).take(160).skip(100) {
            assert_eq!(guard.check(now_ns, &joints, true), Ok(()));
        }
        for step in 0..500 {
            assert_eq!(guard.check(begin_ns + step * 4 * MS, &resting, true), Ok(()));
        }
    }
}
