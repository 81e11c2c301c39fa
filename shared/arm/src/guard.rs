//! What an arm reports, held against its limits and against what it was told.
//!
//! ```text
//! told velocity    ____/▔▔▔▔▔▔▔▔\______        An arm follows late and smoothly. So its mean velocity lies between the
//! reported           ____/▔▔▔▔▔▔▔▔\____        least and the greatest that it was told in the time in which it was
//!                   |◀ lag ▶|◀ span ▶| now     measured (span) and just before (lag), whatever smooths and delays it.
//! ```

use std::collections::VecDeque;

use nalgebra::Vector3;

use crate::course::Course;
use crate::kinematics::{JointLimits, JointVector, XArm7};
use crate::told::{OFF_SHARE, TOOL_REACH_MM, Told, ToldRange};
use crate::violation::LimitViolation;
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

/// After so long at commanded rest, in ns, the arm must be at rest: a stop takes 80 ms, the way of commands and reports
/// some more, and the arm's own deceleration from full speed up to 0.25 s.
const BRAKING_NS: u64 = 350_000_000;

/// The measured velocity may lie outside the told range by this much, in mm/s, plus [`OFF_SHARE`] of the greatest told
/// speed.
const OFF_MM_PER_S: f64 = 20.0;

/// An arm that gives no sign of life for so long, in ns, may have come to rest by itself: a velocity lasts no longer.
const UNHEARD_NS: u64 = 150_000_000;

/// A way is measured from a report that is no older than this, in ns: after a stall the arm is elsewhere by now.
const FRESH_NS: u64 = 50_000_000;

/// What the arm was told is not known if the guard has not looked for so long, in ns.
const GAP_NS: u64 = 100_000_000;

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
        let told_range = ToldRange::of(told, may_be_unheard);
        self.keep(reported_ns, position_mm, told_range);
        self.check_speed(reported_ns, &position_mm)?;
        self.check_drift(now_ns, &position_mm, told.velocity, passed_ns)?;
        self.check_velocity(reported_ns, &position_mm)?;
        if may_be_unheard {
            self.course.begin_anew();
            return Ok(());
        }
        let is_fresh = now_ns.saturating_sub(reported_ns) <= FRESH_NS;
        if self.course.is_begun() || is_fresh {
            let recent = self.recent(reported_ns, told_range);
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

    /// All that the arm may still be following.
    fn recent(&self, reported_ns: u64, told: ToldRange) -> ToldRange {
        let recent = self.kept.iter().rev().take_while(|kept| kept.at_ns + BRAKING_NS >= reported_ns);
        recent.fold(told, |recent, kept| recent.joined(&kept.told))
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
mod tests;
