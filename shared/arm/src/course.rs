//! Whether an arm is where its commands have led it.
//!
//! ```text
//! told velocities, summed up ─▶ where it should be ─┐
//! reported position ────────────────────────────────┴─▶ off by more than lag, tolerance and a share of the way? off course
//! ```
//!
//! The sum begins anew whenever the arm has come to rest, or may not have heard what it was told. So it also finds an arm
//! that stands still through short motions with rests between them, and single joints on the way to the start position.

use nalgebra::Vector3;

use crate::kinematics::JointVector;
use crate::told::{OFF_SHARE, TOOL_REACH_MM, Told, ToldRange};
use crate::violation::LimitViolation;

/// An arm follows so late, in s, apart from the network.
const LAG_S: f64 = 0.2;
/// The flange may be off by so much, in mm, however short its way is.
const OFF_MM: f64 = 10.0;
/// A joint may be off by so much, in rad, and by this share of its way.
const JOINT_OFF_RAD: f64 = 0.02;
const JOINT_OFF_SHARE: f64 = 0.1;

/// What was told since the arm was last known to be where it should.
#[derive(Clone, Copy, Debug)]
struct Leg {
    from_mm: Vector3<f64>,
    from_rad: JointVector,
    /// Sum of the told velocities, and the length of the way.
    told_mm: Vector3<f64>,
    path_mm: f64,
    turned_rad: f64,
    told_rad: JointVector,
    fastest_rad_per_s: f64,
    /// What was told last.
    told: Told,
}

/// Compares the reported position with the sum of what was told.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Course {
    leg: Option<Leg>,
}

impl Course {
    /// Forgets everything: the arm is where it should be.
    pub fn begin_anew(&mut self) {
        self.leg = None;
    }

    /// Whether there is something to compare with.
    pub fn is_begun(&self) -> bool {
        self.leg.is_some()
    }

    /// Takes a report, `passed_s` after the one before, and what is told from now on. The arm may still be following any
    /// of what was told in the `recent` past.
    ///
    /// # Errors
    /// [`LimitViolation::OffCourse`] or [`LimitViolation::JointOffCourse`].
    pub fn check(
        &mut self,
        passed_s: f64,
        position_mm: &Vector3<f64>,
        joints_rad: &JointVector,
        told: &Told,
        recent: &ToldRange,
    ) -> Result<(), LimitViolation> {
        let Some(leg) = &mut self.leg else {
            self.leg = Some(Leg {
                from_mm: *position_mm,
                from_rad: *joints_rad,
                told_mm: Vector3::zeros(),
                path_mm: 0.0,
                turned_rad: 0.0,
                told_rad: JointVector::zeros(),
                fastest_rad_per_s: 0.0,
                told: *told,
            });
            return Ok(());
        };
        let before = std::mem::replace(&mut leg.told, *told);
        let linear_mm_per_s = Vector3::from(before.velocity.linear_mm_per_s);
        leg.told_mm += linear_mm_per_s * passed_s;
        leg.path_mm += linear_mm_per_s.norm() * passed_s;
        leg.turned_rad += before.velocity.angular_speed_rad_per_s() * passed_s;
        let lag_s = LAG_S + recent.silent_ns as f64 * 1e-9;
        let off_mm = (position_mm - leg.from_mm - leg.told_mm).norm();
        let turned_rad = leg.turned_rad + lag_s * recent.angular_rad_per_s;
        let most_mm =
            OFF_MM + OFF_SHARE * leg.path_mm + lag_s * recent.linear_mm_per_s + TOOL_REACH_MM * turned_rad;
        if off_mm > most_mm {
            return Err(LimitViolation::OffCourse { off_mm });
        }
        let Some(velocities_rad_per_s) = before.joints_rad_per_s else { return Ok(()) };
        leg.told_rad += velocities_rad_per_s * passed_s;
        leg.fastest_rad_per_s = leg.fastest_rad_per_s.max(velocities_rad_per_s.amax());
        for joint in 0..7 {
            let told_rad = leg.told_rad[joint];
            let off_rad = (joints_rad[joint] - leg.from_rad[joint] - told_rad).abs();
            let most_rad = JOINT_OFF_RAD + JOINT_OFF_SHARE * told_rad.abs() + lag_s * leg.fastest_rad_per_s;
            if off_rad > most_rad {
                return Err(LimitViolation::JointOffCourse {
                    joint: joint + 1,
                    off_deg: off_rad.to_degrees(),
                });
            }
        }
        Ok(())
    }
}
