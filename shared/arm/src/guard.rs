//! What an arm reports, held against its limits and against what it was told.
//!
//! ```text
//! told velocity    ____/▔▔▔▔▔▔▔▔\______        An arm follows late and smoothly. So its mean velocity lies between the
//! reported           ____/▔▔▔▔▔▔▔▔\____        least and the greatest that it was told in the time in which it was
//!                   |◀ lag ▶|◀ span ▶| now     measured (span) and just before (lag), whatever smooths and delays it.
//! ```

use std::collections::VecDeque;

use nalgebra::Vector3;

use crate::course::{Course, Recent};
use crate::kinematics::{JointLimits, JointVector, XArm7};
use crate::{ArmSettings, Twist};

/// A reported joint angle may be so far beyond its limit, in rad.
const JOINT_TOLERANCE_RAD: f64 = 0.01;

/// A reported position may be so far out of the workspace, in mm.
const BOX_TOLERANCE_MM: f64 = 2.0;

/// Speed is measured between reports that are at least this far apart, in ns: one that comes 50 ms late, on a busy
/// machine, must not look like a fast arm.
const SPEED_OVER_NS: u64 = 100_000_000;

/// The velocity is measured over this time at least, in ns, to be held against what the arm was told: a report that
/// comes 50 ms late is then off by a sixth.
const VELOCITY_OVER_NS: u64 = 300_000_000;

/// Positions are kept for speeds at least this far apart, in ns.
const KEPT_EVERY_NS: u64 = 8_000_000;

/// As many positions as lie within [`VELOCITY_OVER_NS`] and [`BRAKING_NS`], and some for reports that come late.
const KEPT: usize = 96;

/// An arm commanded to rest may be as fast as this, in mm/s: what the noise of its reports may look like.
const CREEP_MM_PER_S: f64 = 10.0;

/// An arm commanded to rest may drift so far, in mm: what somebody who leans on it bends it by.
const DRIFT_MM: f64 = 5.0;

/// A slower flange, in mm/s, is told to rest: at a limit the velocity is never quite zero.
const REST_MM_PER_S: f64 = 1.0;

/// After so long at commanded rest, in ns, the arm must be at rest: a stop takes 80 ms, the way of commands and reports
/// some more, and the arm's own deceleration from full speed up to 0.25 s.
const BRAKING_NS: u64 = 350_000_000;

/// The measured velocity may lie outside the told range by this much, in mm/s, plus this share of the greatest told
/// speed.
const OFF_MM_PER_S: f64 = 20.0;
pub(crate) const OFF_SHARE: f64 = 0.3;

/// How far the tip of a tool, which a told rotation keeps in place, may be from the flange, in mm.
pub(crate) const TOOL_REACH_MM: f64 = 300.0;

/// An arm that gives no sign of life for so long, in ns, may have come to rest by itself: a velocity lasts no longer.
const UNHEARD_NS: u64 = 150_000_000;

/// A way is measured from a report that is no older than this, in ns: after a stall the arm is elsewhere by now.
const FRESH_NS: u64 = 50_000_000;

/// What the arm was told is not known if the guard has not looked for so long, in ns.
const GAP_NS: u64 = 100_000_000;

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
    /// The flange crept away while the arm was commanded to rest.
    #[error(
        "the flange moved by {way_mm:.0} mm while the arm was commanded to rest: find out what drives or pulls it, \
         then run `tendon arm`"
    )]
    Drifted {
        /// How far it is from where it came to rest, in mm.
        way_mm: f64,
    },
    /// The flange does not move as it was told.
    #[error(
        "the flange moves along {axis} at {measured_mm_per_s:.0} mm/s and was told {lowest_mm_per_s:.0} to \
         {highest_mm_per_s:.0}: find out what holds or pulls the arm, or slows it in its own settings, then run \
         `tendon arm`"
    )]
    NotFollowing {
        /// The axis, `x`, `y` or `z`.
        axis: char,
        /// Its mean velocity along it over 0.3 s in mm/s.
        measured_mm_per_s: f64,
        /// The least velocity along it that it was told, in mm/s.
        lowest_mm_per_s: f64,
        /// The greatest.
        highest_mm_per_s: f64,
    },
    /// The flange is not where its commands have led it.
    #[error(
        "the flange is {off_mm:.0} mm from where its commands have led it: find out what holds or pulls the arm, then run \
         `tendon arm`"
    )]
    OffCourse {
        /// How far off it is, in mm.
        off_mm: f64,
    },
    /// A joint is not where its commands have led it.
    #[error(
        "joint {joint} is {off_deg:.0}° from where its commands have led it: find out what holds or pulls the arm, then \
         run `tendon arm`"
    )]
    JointOffCourse {
        /// Number of the joint, 1 to 7.
        joint: usize,
        /// How far off it is, in degrees.
        off_deg: f64,
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

/// What an arm was told since the guard last looked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// The velocity of the flange.
    pub velocity: Twist,
    /// The velocities of the joints, if it was told these.
    pub joints_rad_per_s: Option<JointVector>,
    /// For how long the arm has given no sign of life, in ns.
    pub silent_ns: u64,
}

impl Told {
    /// A velocity of the flange, told to an arm that answers at once.
    pub fn velocity(velocity: Twist) -> Told {
        Told { velocity, joints_rad_per_s: None, silent_ns: 0 }
    }

    fn is_rest(&self) -> bool {
        let Told { velocity, joints_rad_per_s, .. } = self;
        joints_rad_per_s.is_none_or(|velocities| velocities == JointVector::zeros())
            && velocity.linear_speed_mm_per_s() < REST_MM_PER_S
            && velocity.angular_speed_rad_per_s() * TOOL_REACH_MM < REST_MM_PER_S
    }
}

/// The velocities told in some time.
#[derive(Clone, Copy, Debug)]
struct ToldRange {
    /// Along x, y and z in mm/s.
    lowest_mm_per_s: Vector3<f64>,
    highest_mm_per_s: Vector3<f64>,
    /// The greatest speeds.
    linear_mm_per_s: f64,
    angular_rad_per_s: f64,
    /// The longest silence of the arm.
    silent_ns: u64,
}

impl ToldRange {
    fn of(told: &Told, may_be_unheard: bool) -> ToldRange {
        let linear_mm_per_s = Vector3::from(told.velocity.linear_mm_per_s);
        let zero = Vector3::zeros();
        let (or_lowest, or_highest) =
            if may_be_unheard { (zero, zero) } else { (linear_mm_per_s, linear_mm_per_s) };
        ToldRange {
            lowest_mm_per_s: linear_mm_per_s.inf(&or_lowest),
            highest_mm_per_s: linear_mm_per_s.sup(&or_highest),
            linear_mm_per_s: linear_mm_per_s.norm(),
            angular_rad_per_s: told.velocity.angular_speed_rad_per_s(),
            silent_ns: told.silent_ns,
        }
    }

    fn joined(self, other: &ToldRange) -> ToldRange {
        ToldRange {
            lowest_mm_per_s: self.lowest_mm_per_s.inf(&other.lowest_mm_per_s),
            highest_mm_per_s: self.highest_mm_per_s.sup(&other.highest_mm_per_s),
            linear_mm_per_s: self.linear_mm_per_s.max(other.linear_mm_per_s),
            angular_rad_per_s: self.angular_rad_per_s.max(other.angular_rad_per_s),
            silent_ns: self.silent_ns.max(other.silent_ns),
        }
    }
}

/// Where the flange was, and what it was told from then on.
#[derive(Clone, Copy, Debug)]
struct Kept {
    at_ns: u64,
    position_mm: Vector3<f64>,
    told: ToldRange,
}

impl Kept {
    fn velocity_to_mm_per_s(&self, now_ns: u64, position_mm: &Vector3<f64>) -> Vector3<f64> {
        (position_mm - self.position_mm) / ((now_ns - self.at_ns) as f64 * 1e-9)
    }
}

/// Watches the reports of an arm: that it stays within joint limits, workspace and speed, whatever it was told, that it
/// moves as it was told, and rests while it is told to. The position of the flange is that of our own kinematics: what the
/// arm calls its position is that of a tool.
///
/// It is software: it is not safety-rated and replaces no emergency stop.
#[derive(Clone, Debug)]
pub struct Guard {
    arm: XArm7,
    joint_limits: JointLimits,
    workspace_min_mm: [f64; 3],
    workspace_max_mm: [f64; 3],
    most_mm_per_s: f64,
    /// The oldest first.
    kept: VecDeque<Kept>,
    looked_ns: u64,
    /// Since when the arm has been commanded to rest.
    resting_since_ns: Option<u64>,
    /// Where the flange came to rest, mm.
    rested_at_mm: Option<Vector3<f64>>,
    course: Course,
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
            kept: VecDeque::with_capacity(KEPT),
            looked_ns: 0,
            resting_since_ns: None,
            rested_at_mm: None,
            course: Course::default(),
            was_inside: false,
        }
    }

    /// Holds the joints against these limits from now on; before, [`JointLimits::default`].
    pub fn set_joint_limits(&mut self, limits: JointLimits) {
        self.joint_limits = limits;
    }

    /// Checks the newest report of joint angles (rad) at `now_ns`. It came at `reported_ns`, and the arm has been told
    /// `told`.
    ///
    /// A flange that was outside the workspace from the beginning, or since [`Guard::reset`], may be there until it is
    /// inside for the first time: otherwise nothing could drive it back.
    ///
    /// # Errors
    /// The first [`LimitViolation`] found.
    pub fn check(
        &mut self,
        now_ns: u64,
        reported_ns: u64,
        joints_rad: &JointVector,
        told: &Told,
    ) -> Result<(), LimitViolation> {
        self.check_joints(joints_rad)?;
        let position_mm = self.arm.flange_pose_m(joints_rad).translation.vector * 1e3;
        self.check_box(&position_mm)?;
        let passed_ns = now_ns.saturating_sub(self.looked_ns);
        self.looked_ns = now_ns;
        if told.is_rest() {
            self.resting_since_ns.get_or_insert(now_ns);
        } else {
            self.resting_since_ns = None;
        }
        let may_be_unheard = told.silent_ns > UNHEARD_NS || passed_ns > GAP_NS;
        self.keep(reported_ns, position_mm, ToldRange::of(told, may_be_unheard));
        self.check_speed(reported_ns, &position_mm)?;
        self.check_drift(now_ns, &position_mm, told.velocity, passed_ns)?;
        self.check_velocity(reported_ns, &position_mm)?;
        if may_be_unheard {
            self.course.begin_anew();
            return Ok(());
        }
        let is_fresh = now_ns.saturating_sub(reported_ns) <= FRESH_NS;
        if self.course.is_begun() || is_fresh {
            let recent = self.recent(reported_ns);
            self.course.check(passed_ns as f64 * 1e-9, &position_mm, joints_rad, told, &recent)?;
        }
        if self.has_braked(now_ns) {
            self.course.begin_anew();
        }
        Ok(())
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

    fn check_speed(&self, now_ns: u64, position_mm: &Vector3<f64>) -> Result<(), LimitViolation> {
        let Some(from) = self.kept_before(now_ns, SPEED_OVER_NS) else { return Ok(()) };
        let speed_mm_per_s = from.velocity_to_mm_per_s(now_ns, position_mm).norm();
        if speed_mm_per_s > self.most_mm_per_s {
            return Err(LimitViolation::OverSpeed { speed_mm_per_s });
        }
        // All of the time over which the speed was measured lies after the braking.
        let has_braked = self.resting_since_ns.is_some_and(|since_ns| from.at_ns >= since_ns + BRAKING_NS);
        if has_braked && speed_mm_per_s > CREEP_MM_PER_S {
            return Err(LimitViolation::Creeping { speed_mm_per_s });
        }
        Ok(())
    }

    fn check_drift(
        &mut self,
        now_ns: u64,
        position_mm: &Vector3<f64>,
        told_velocity: Twist,
        passed_ns: u64,
    ) -> Result<(), LimitViolation> {
        if !self.has_braked(now_ns) {
            self.rested_at_mm = None;
            return Ok(());
        }
        let rested_at_mm = self.rested_at_mm.get_or_insert(*position_mm);
        // At a limit the velocity is small and not zero.
        *rested_at_mm += Vector3::from(told_velocity.linear_mm_per_s) * (passed_ns as f64 * 1e-9);
        let way_mm = (position_mm - *rested_at_mm).norm();
        if way_mm > DRIFT_MM {
            return Err(LimitViolation::Drifted { way_mm });
        }
        Ok(())
    }

    /// Whether the arm has been told to rest for so long that it must be at rest.
    fn has_braked(&self, now_ns: u64) -> bool {
        self.resting_since_ns.is_some_and(|since_ns| now_ns >= since_ns + BRAKING_NS)
    }

    /// What the arm may still be following.
    fn recent(&self, reported_ns: u64) -> Recent {
        let recent = self.kept.iter().rev().take_while(|kept| kept.at_ns + BRAKING_NS >= reported_ns);
        let none = Recent { linear_mm_per_s: 0.0, angular_rad_per_s: 0.0, silent_s: 0.0 };
        recent.fold(none, |recent, kept| Recent {
            linear_mm_per_s: recent.linear_mm_per_s.max(kept.told.linear_mm_per_s),
            angular_rad_per_s: recent.angular_rad_per_s.max(kept.told.angular_rad_per_s),
            silent_s: recent.silent_s.max(kept.told.silent_ns as f64 * 1e-9),
        })
    }

    /// See the picture at the top.
    fn check_velocity(&self, now_ns: u64, position_mm: &Vector3<f64>) -> Result<(), LimitViolation> {
        let Some(from) = self.kept_before(now_ns, VELOCITY_OVER_NS) else { return Ok(()) };
        // The range that was told from the newest time on that lies before the lag.
        let Some(first) = self.kept.iter().rposition(|kept| kept.at_ns + BRAKING_NS <= from.at_ns) else {
            return Ok(());
        };
        let told = self.kept.range(first..).fold(self.kept[first].told, |told, kept| told.joined(&kept.told));
        let off_mm_per_s =
            OFF_MM_PER_S + OFF_SHARE * told.linear_mm_per_s + TOOL_REACH_MM * told.angular_rad_per_s;
        let measured = from.velocity_to_mm_per_s(now_ns, position_mm);
        for (index, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
            let lowest_mm_per_s = told.lowest_mm_per_s[index];
            let highest_mm_per_s = told.highest_mm_per_s[index];
            let permitted = lowest_mm_per_s - off_mm_per_s..=highest_mm_per_s + off_mm_per_s;
            if !permitted.contains(&measured[index]) {
                let measured_mm_per_s = measured[index];
                return Err(LimitViolation::NotFollowing {
                    axis,
                    measured_mm_per_s,
                    lowest_mm_per_s,
                    highest_mm_per_s,
                });
            }
        }
        Ok(())
    }

    /// The newest position kept that is at least so old.
    fn kept_before(&self, now_ns: u64, age_ns: u64) -> Option<&Kept> {
        self.kept.iter().rev().find(|kept| now_ns.saturating_sub(kept.at_ns) >= age_ns)
    }

    fn keep(&mut self, now_ns: u64, position_mm: Vector3<f64>, told: ToldRange) {
        if let Some(newest) = self.kept.back_mut() {
            newest.told = newest.told.joined(&told);
            if now_ns.saturating_sub(newest.at_ns) < KEPT_EVERY_NS {
                return;
            }
        }
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(Kept { at_ns: now_ns, position_mm, told });
    }

    /// Forgets where the arm was: for a new connection, or when the guard did not watch for a while.
    pub fn reset(&mut self) {
        self.kept.clear();
        self.resting_since_ns = None;
        self.rested_at_mm = None;
        self.course.begin_anew();
        self.was_inside = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::UPPER_LIMITS_RAD;
    use crate::velocity::joint_velocities;

    const MS: u64 = 1_000_000;
    const REST: Told = Told { velocity: Twist::ZERO, joints_rad_per_s: None, silent_ns: 0 };

    fn guard() -> (Guard, JointVector) {
        let settings = ArmSettings::default();
        (Guard::new(&settings), settings.start_joints_rad())
    }

    fn along(axis: usize, speed_mm_per_s: f64) -> Twist {
        let mut twist = Twist::ZERO;
        twist.linear_mm_per_s[axis] = speed_mm_per_s;
        twist
    }

    /// Joints (rad) every 4 ms of an arm that moves at the velocity of each step from the start.
    fn path(twist_of: impl Fn(u64) -> Twist) -> impl Iterator<Item = (u64, JointVector)> {
        let (arm, mut joints_rad) = (XArm7::new(), ArmSettings::default().start_joints_rad());
        (0..).map(move |step| {
            let now = joints_rad;
            joints_rad += joint_velocities(&arm, &joints_rad, &twist_of(step)).rad_per_s * 4e-3;
            (step * 4 * MS, now)
        })
    }

    fn moving(axis: usize, speed_mm_per_s: f64) -> impl Iterator<Item = (u64, JointVector)> {
        path(move |_| along(axis, speed_mm_per_s))
    }

    /// When, in ms, something is first found of an arm that moves and is told such velocities in each step.
    fn found_ms(
        steps: usize,
        moves: impl Fn(u64) -> Twist,
        told: impl Fn(u64) -> Told,
    ) -> Option<(u64, LimitViolation)> {
        let (mut guard, _) = guard();
        path(moves).take(steps).enumerate().find_map(|(step, (now_ns, joints_rad))| {
            let violation = guard.check(now_ns, now_ns, &joints_rad, &told(step as u64)).err()?;
            Some((now_ns / MS, violation))
        })
    }

    #[test]
    fn an_arm_within_its_limits_passes() {
        let told = |_| Told::velocity(along(1, 100.0));
        assert_eq!(found_ms(900, |_| along(1, 100.0), told), None);
    }

    #[test]
    fn a_joint_beyond_its_limit_is_named() {
        let (mut guard, mut joints) = guard();
        joints[3] = UPPER_LIMITS_RAD[3] + 0.009;
        assert_eq!(guard.check(0, 0, &joints, &REST), Ok(()));
        joints[3] = UPPER_LIMITS_RAD[3] + 0.011;
        let violation = guard.check(0, 0, &joints, &REST).unwrap_err();
        assert!(matches!(violation, LimitViolation::JointLimit { joint: 4, .. }));
        assert!(
            violation.to_string().contains("joint 4 is at 225.6°")
                && violation.to_string().contains("tendon arm")
        );
        joints[3] = f64::NAN;
        assert!(guard.check(0, 0, &joints, &REST).is_err());
        // The limits are those of the arm that is there.
        let (mut guard, mut joints) = self::guard();
        joints[1] = 2.035;
        assert_eq!(guard.check(0, 0, &joints, &REST), Ok(()));
        let mut limits = JointLimits::default();
        limits.upper_rad[1] = 2.0246;
        guard.set_joint_limits(limits);
        assert!(matches!(
            guard.check(0, 0, &joints, &REST),
            Err(LimitViolation::JointLimit { joint: 2, .. })
        ));
    }

    #[test]
    fn a_flange_that_leaves_the_workspace_is_named_and_may_come_back() {
        let (mut guard, _) = guard();
        let told = Told::velocity(along(2, 100.0));
        let found = moving(2, 100.0)
            .find_map(|(now_ns, joints)| Some((guard.check(now_ns, now_ns, &joints, &told).err()?, joints)));
        let (violation, outside) = found.unwrap();
        assert!(matches!(violation, LimitViolation::WorkspaceBox { axis: 'z', .. }));
        guard.reset();
        assert_eq!(guard.check(0, 0, &outside, &told), Ok(()));
        guard.course.begin_anew();
        assert_eq!(guard.check(4 * MS, 4 * MS, &ArmSettings::default().start_joints_rad(), &told), Ok(()));
        guard.course.begin_anew();
        assert!(guard.check(8 * MS, 8 * MS, &outside, &told).is_err());
    }

    #[test]
    fn too_fast_is_found_over_100_ms() {
        let told = |_| Told::velocity(along(1, 100.0));
        let (found_ms, violation) = found_ms(100, |_| along(1, 175.0), told).unwrap();
        assert_eq!(found_ms, 100);
        assert!(matches!(violation, LimitViolation::OverSpeed { .. }));
        // A jump within less than 100 ms is an outlier of the report, or shows in the next measurement.
        let (mut guard, joints) = guard();
        let (_, aside) = moving(1, 100.0).nth(12).unwrap();
        assert_eq!(guard.check(0, 0, &joints, &REST), Ok(()));
        assert_eq!(guard.check(4 * MS, 4 * MS, &aside, &REST), Ok(()));
        assert_eq!(guard.check(52 * MS, 52 * MS, &aside, &REST), Ok(()));
    }

    #[test]
    fn an_arm_that_creeps_at_commanded_rest_is_found_within_100_ms_of_the_braking() {
        for (speed_mm_per_s, expected_ms) in [(20.0, Some(452)), (60.0, Some(168))] {
            let found = found_ms(1000, |_| along(1, speed_mm_per_s), |_| REST);
            assert_eq!(found.map(|(at_ms, _)| at_ms), expected_ms, "{speed_mm_per_s} mm/s");
        }
        // A slower one is found once it has moved by 5 mm.
        let (found_at_ms, violation) = found_ms(1000, |_| along(1, 5.0), |_| REST).unwrap();
        assert!((1350..1370).contains(&found_at_ms), "{found_at_ms}");
        assert!(matches!(violation, LimitViolation::Drifted { .. }));
        // One that comes to rest in time does not, whatever it was commanded before.
        let late = |lag: u64| {
            move |step: u64| match step.checked_sub(lag) {
                Some(0..100) => along(1, 100.0),
                _ => Twist::ZERO,
            }
        };
        assert_eq!(found_ms(1000, late(60), |step| Told::velocity(late(0)(step))), None);
        // Nor does one that follows a command so slow that it counts as rest.
        assert_eq!(found_ms(5000, |_| along(1, 0.9), |_| Told::velocity(along(1, 0.9))), None);
    }

    #[test]
    fn an_arm_that_does_not_move_as_it_is_told_is_found_before_it_is_far() {
        let told = |_| Told::velocity(along(2, 50.0));
        for (moves, axis, within_ms) in [
            (along(2, 0.0), 'z', 660),
            (along(2, -50.0), 'z', 660),
            (Twist { linear_mm_per_s: [0.0, 60.0, 50.0], ..Twist::ZERO }, 'y', 660),
            (along(2, 100.0), 'z', 660),
        ] {
            let (at_ms, violation) = found_ms(1000, |_| moves, told).unwrap();
            assert!(at_ms <= within_ms, "{moves:?}: {at_ms} ms");
            let is_named = match violation {
                LimitViolation::NotFollowing { axis: found, .. } => found == axis,
                LimitViolation::OffCourse { .. } => true,
                _ => false,
            };
            assert!(is_named, "{violation}");
        }
        // In the middle of a long motion it takes less: the arm begins to go sideways after 2 s.
        let aside = |step: u64| Twist {
            linear_mm_per_s: [0.0, if step < 500 { 0.0 } else { 100.0 }, 50.0],
            ..Twist::ZERO
        };
        let (at_ms, _) = found_ms(1000, aside, told).unwrap();
        assert!((2050..=2150).contains(&at_ms), "{at_ms}");
    }

    #[test]
    fn an_arm_that_follows_late_smoothly_or_not_quite_passes() {
        // To and fro at full speed, as no ramp would command it.
        let square = |step: u64| along(1, if (step / 150).is_multiple_of(2) { 100.0 } else { -100.0 });
        let told = |step: u64| Told::velocity(square(step));
        for lag_steps in [0, 10, 60] {
            let late = move |step: u64| square(step.saturating_sub(lag_steps));
            assert_eq!(found_ms(3000, late, told), None, "{lag_steps} steps late");
        }
        let smooth = |step: u64| {
            let last = (0..60).map(|back| square(step.saturating_sub(back)).linear_mm_per_s[1]);
            along(1, last.sum::<f64>() / 60.0)
        };
        assert_eq!(found_ms(3000, smooth, told), None);
        assert_eq!(found_ms(500, |_| along(1, 60.0), |_| Told::velocity(along(1, 100.0))), None);
        // A rotation about the tip of a tool moves the flange.
        let turn = Twist { angular_rad_per_s: [0.0, 0.0, 0.5], ..Twist::ZERO };
        assert_eq!(found_ms(400, |_| along(1, 100.0), |_| Told::velocity(turn)), None);
        // One that may not have heard what it was told may rest.
        let unheard = |_| Told { silent_ns: 200 * MS, ..Told::velocity(along(1, 100.0)) };
        assert_eq!(found_ms(1000, |_| Twist::ZERO, unheard), None);
    }

    #[test]
    fn an_arm_that_is_held_through_short_motions_with_rests_is_found() {
        for (motion, rest) in [(125, 125), (150, 100), (100, 60)] {
            let told = |step: u64| {
                Told::velocity(along(0, if step % (motion + rest) < motion { 50.0 } else { 0.0 }))
            };
            let (at_ms, violation) = found_ms(2000, |_| Twist::ZERO, told).unwrap();
            assert!(matches!(violation, LimitViolation::OffCourse { .. }), "{violation}");
            assert!(at_ms < 2000, "{motion} and {rest} steps: {at_ms} ms");
        }
    }

    /// Whoever looks again after a stall sees an old report first.
    #[test]
    fn a_guard_that_stood_still_does_not_measure_from_an_old_report() {
        let (mut guard, _) = guard();
        let moving: Vec<(u64, JointVector)> = moving(1, 100.0).take(300).collect();
        for (now_ns, joints_rad) in &moving[..100] {
            let told = Told::velocity(along(1, 100.0));
            assert_eq!(guard.check(*now_ns, *now_ns, joints_rad, &told), Ok(()));
        }
        let (stalled_ns, old_rad) = moving[99];
        let (resumed_ns, new_rad) = (stalled_ns + 140 * MS, moving[134].1);
        for step in 0..3 {
            let now_ns = resumed_ns + step * 4 * MS;
            assert_eq!(guard.check(now_ns, stalled_ns, &old_rad, &REST), Ok(()));
        }
        for step in 3..500 {
            let now_ns = resumed_ns + step * 4 * MS;
            assert_eq!(guard.check(now_ns, now_ns, &new_rad, &REST), Ok(()), "{step}");
        }
    }

    /// Reports that come late, and then all at once, look like no fast arm.
    #[test]
    fn late_reports_are_measured_from_when_they_came() {
        let (mut guard, _) = guard();
        let told = Told::velocity(along(1, 100.0));
        let path: Vec<(u64, JointVector)> = moving(1, 100.0).take(800).collect();
        let mut reported = 0;
        for (step, (now_ns, _)) in path.iter().enumerate() {
            // Every second the reports stop for 200 ms.
            if step % 250 >= 50 {
                reported = step;
            }
            let (reported_ns, joints_rad) = path[reported];
            let silent_ns = now_ns - reported_ns;
            let told = Told { silent_ns, ..told };
            assert_eq!(guard.check(*now_ns, reported_ns, &joints_rad, &told), Ok(()), "{step}");
        }
    }

    #[test]
    fn an_arm_on_a_slow_network_that_is_held_is_found() {
        let told = |_| Told { silent_ns: 120 * MS, ..Told::velocity(along(1, 50.0)) };
        let (at_ms, _) = found_ms(2000, |_| Twist::ZERO, told).unwrap();
        assert!(at_ms < 1000, "{at_ms}");
    }

    #[test]
    fn single_joints_that_go_elsewhere_are_found() {
        let rates = JointVector::from([0.17, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1]);
        let told = Told { joints_rad_per_s: Some(rates), ..REST };
        for (name, moves) in [
            ("held", JointVector::zeros()),
            ("joint 7 reversed", JointVector::from([0.17, 0.0, 0.0, 0.0, 0.0, 0.0, -0.1])),
            ("joint 2 turns as well", JointVector::from([0.17, 0.1, 0.0, 0.0, 0.0, 0.0, 0.1])),
        ] {
            let (mut guard, mut joints_rad) = guard();
            // What the flange is told does not matter here: the flange may go anywhere.
            guard.most_mm_per_s = f64::INFINITY;
            let found = (0..1000_u64).find_map(|step| {
                let here = guard.arm.jacobian(&joints_rad) * moves;
                let told = Told { velocity: Twist::from_vector_m(&here), ..told };
                let violation = guard.check(step * 4 * MS, step * 4 * MS, &joints_rad, &told).err();
                joints_rad += moves * 4e-3;
                violation.map(|violation| (step * 4, violation))
            });
            let (at_ms, violation) = found.unwrap();
            assert!(matches!(violation, LimitViolation::JointOffCourse { .. }), "{name}: {violation}");
            assert!(at_ms < 1500, "{name}: {at_ms} ms");
        }
    }
}
