//! What an arm reports, held against its limits.

use nalgebra::Vector3;

use crate::ArmSettings;
use crate::kinematics::{JointVector, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD};

/// A reported joint angle may be so far beyond its limit, in rad.
const JOINT_TOLERANCE_RAD: f64 = 0.01;

/// A reported position may be so far out of the workspace, in mm.
const BOX_TOLERANCE_MM: f64 = 2.0;

/// Speed is measured between reports that are at least this far apart, in ns: one that comes 50 ms late, on a busy
/// machine, must not look like a fast arm.
const SPEED_OVER_NS: u64 = 100_000_000;

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

/// Watches the reports of an arm: that it stays within joint limits, workspace and speed, whatever it was told.
///
/// It is software: it is not safety-rated and replaces no emergency stop.
#[derive(Clone, Debug)]
pub struct Guard {
    workspace_min_mm: [f64; 3],
    workspace_max_mm: [f64; 3],
    most_mm_per_s: f64,
    /// Time (ns) and position (mm) from which speed is measured.
    speed_from: Option<(u64, [f64; 3])>,
    was_inside: bool,
}

impl Guard {
    /// A guard without history. Half as much again as the speed limit, and 20 mm/s, count as too fast.
    pub fn new(settings: &ArmSettings) -> Guard {
        Guard {
            workspace_min_mm: settings.workspace_min_mm,
            workspace_max_mm: settings.workspace_max_mm,
            most_mm_per_s: 1.5 * settings.linear_speed_limit_mm_per_s + 20.0,
            speed_from: None,
            was_inside: false,
        }
    }

    /// Checks a report of joint angles (rad) and flange position (mm) that was made at `now_ns`.
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
        position_mm: [f64; 3],
    ) -> Result<(), LimitViolation> {
        for joint in 0..7 {
            let lowest_rad = LOWER_LIMITS_RAD[joint] - JOINT_TOLERANCE_RAD;
            let highest_rad = UPPER_LIMITS_RAD[joint] + JOINT_TOLERANCE_RAD;
            if !(lowest_rad..=highest_rad).contains(&joints_rad[joint]) {
                let angle_deg = joints_rad[joint].to_degrees();
                return Err(LimitViolation::JointLimit { joint: joint + 1, angle_deg });
            }
        }
        let outside = ['x', 'y', 'z'].into_iter().enumerate().find(|(index, _)| {
            let lowest_mm = self.workspace_min_mm[*index] - BOX_TOLERANCE_MM;
            let highest_mm = self.workspace_max_mm[*index] + BOX_TOLERANCE_MM;
            !(lowest_mm..=highest_mm).contains(&position_mm[*index])
        });
        match outside {
            None => self.was_inside = true,
            Some((index, axis)) if self.was_inside || position_mm[index].is_nan() => {
                return Err(LimitViolation::WorkspaceBox { axis, position_mm: position_mm[index] });
            }
            Some(_) => {}
        }
        let (from_ns, from_mm) = *self.speed_from.get_or_insert((now_ns, position_mm));
        let passed_ns = now_ns.saturating_sub(from_ns);
        if passed_ns >= SPEED_OVER_NS {
            self.speed_from = Some((now_ns, position_mm));
            let way_mm = (Vector3::from(position_mm) - Vector3::from(from_mm)).norm();
            let speed_mm_per_s = way_mm / (passed_ns as f64 * 1e-9);
            if speed_mm_per_s > self.most_mm_per_s {
                return Err(LimitViolation::OverSpeed { speed_mm_per_s });
            }
        }
        Ok(())
    }

    /// Forgets where the arm was: for a new connection, or when the guard did not watch for a while.
    pub fn reset(&mut self) {
        self.speed_from = None;
        self.was_inside = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn guard() -> (Guard, JointVector) {
        let settings = ArmSettings::default();
        (Guard::new(&settings), settings.start_joints_rad())
    }

    #[test]
    fn an_arm_within_its_limits_passes() {
        let (mut guard, joints) = guard();
        for report in 0..100 {
            let x_mm = 350.0 + 100.0 * (report as f64 * 0.01);
            assert_eq!(guard.check(report * 10 * MS, &joints, [x_mm, 0.0, 362.0]), Ok(()));
        }
        assert!(guard.check(1000 * MS, &joints, [450.0, 401.9, 362.0]).is_err());
        guard.reset();
        assert_eq!(guard.check(1004 * MS, &joints, [450.0, 401.9, 362.0]), Ok(()));
    }

    #[test]
    fn a_joint_beyond_its_limit_is_named() {
        let (mut guard, mut joints) = guard();
        joints[3] = UPPER_LIMITS_RAD[3] + 0.009;
        assert_eq!(guard.check(0, &joints, [386.0, 0.0, 362.0]), Ok(()));
        joints[3] = UPPER_LIMITS_RAD[3] + 0.011;
        let violation = guard.check(0, &joints, [386.0, 0.0, 362.0]).unwrap_err();
        assert!(matches!(violation, LimitViolation::JointLimit { joint: 4, .. }));
        assert!(
            violation.to_string().contains("joint 4 is at 225.6°")
                && violation.to_string().contains("tendon arm")
        );
        joints[3] = f64::NAN;
        assert!(guard.check(0, &joints, [386.0, 0.0, 362.0]).is_err());
    }

    #[test]
    fn a_flange_that_leaves_the_workspace_is_named_and_may_come_back() {
        let (mut guard, joints) = guard();
        for (axis, position_mm) in
            [('x', [197.0, 0.0, 300.0]), ('y', [300.0, 403.0, 300.0]), ('z', [300.0, 0.0, f64::NAN])]
        {
            assert_eq!(guard.check(0, &joints, [300.0, 0.0, 300.0]), Ok(()));
            let violation = guard.check(0, &joints, position_mm).unwrap_err();
            assert!(matches!(violation, LimitViolation::WorkspaceBox { axis: found, .. } if found == axis));
            guard.reset();
            assert_eq!(guard.check(0, &joints, position_mm).is_ok(), !position_mm[2].is_nan());
        }
    }

    #[test]
    fn too_fast_is_found_over_100_ms() {
        let (mut guard, joints) = guard();
        let at = |speed_mm_per_s: f64, ms: u64| [300.0 + speed_mm_per_s * ms as f64 * 1e-3, 0.0, 300.0];
        for ms in (0..=2000).step_by(4) {
            assert_eq!(guard.check(ms * MS, &joints, at(100.0, ms)), Ok(()));
        }
        guard.reset();
        let found_ms = (0..1000).step_by(4).find(|&ms| guard.check(ms * MS, &joints, at(175.0, ms)).is_err());
        assert_eq!(found_ms, Some(100));
        // A jump within less than 100 ms is an outlier of the report, or shows in the next measurement.
        guard.reset();
        assert_eq!(guard.check(0, &joints, [300.0, 0.0, 300.0]), Ok(()));
        assert_eq!(guard.check(4 * MS, &joints, [305.0, 0.0, 300.0]), Ok(()));
        assert_eq!(guard.check(52 * MS, &joints, [305.0, 0.0, 300.0]), Ok(()));
    }
}
