//! Whether the arm, braked from where it is, comes to rest within its limits.
//!
//! A state from which the arm can still brake in time is called viable (Aubin, Viability Theory, 1991). Motion goes
//! from viable state to viable state: it takes a step only if the run-down after it keeps the limits. Then
//! braking always does, and the edges of the workspace are approached at the ordinary deceleration.
//!
//! The limits are the workspace box, the joint limits, the joint speed limit and the distance to singularities, each a
//! margin inside the hard limit. The box is checked at every step of the run-down. Joints are predicted in a
//! few pieces by the law of [`crate::velocity`] and the midpoint rule, which the margins cover.
//!
//! An arm that is beyond a margin may go no further, and one that is beyond a hard limit must come nearer: so it
//! can always be driven back.

use nalgebra::{Vector3, Vector6};

use crate::ArmSettings;
use crate::kinematics::{JOINT_SPEED_LIMIT_RAD_PER_S, JointLimits, JointVector, XArm7};
use crate::step::{STEP_S, part};
use crate::velocity::{JOINT_MARGIN_RAD, Posture, SMALLEST_SINGULAR_VALUE};

/// Motion ends this far before a face of the workspace box, in mm: the way in 30 ms, by which a report may be late, at
/// 100 mm/s.
const BOX_MARGIN_MM: f64 = 3.0;

/// Motion ends this far before singularity distances that count as singular.
const SINGULARITY_MARGIN: f64 = 0.01;

/// A joint predicted to be faster than this, in rad/s, is too fast.
const JOINT_SPEED_MARGIN_RAD_PER_S: f64 = 0.9 * JOINT_SPEED_LIMIT_RAD_PER_S;

/// Joints are predicted in pieces of the way no longer than this, in m and rad.
const PIECE_M_RAD: f64 = 0.01;

/// Singularity distances that differ by less than this share differ by rounding errors.
const ROUNDING: f64 = 1e-9;

/// A limit that keeps a velocity from being followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// A face of the workspace box.
    WorkspaceFace {
        /// 0 for x, 1 for y, 2 for z.
        axis: usize,
        /// The face at the upper corner's side.
        is_upper: bool,
    },
    /// The limit of a joint.
    JointLimit {
        /// Number of the joint, 1 to 7.
        joint: usize,
    },
    /// A singularity, or joint angles that are not finite.
    Singularity,
    /// A joint would have to be too fast.
    JointSpeed,
}

/// The limits of an arm.
#[derive(Clone, Debug)]
pub(crate) struct Limits {
    arm: XArm7,
    pub(crate) joints: JointLimits,
    workspace_min_mm: Vector3<f64>,
    workspace_max_mm: Vector3<f64>,
}

impl Limits {
    pub fn new(settings: &ArmSettings) -> Limits {
        Limits {
            arm: XArm7::new(),
            joints: JointLimits::default(),
            workspace_min_mm: settings.workspace_min_mm.into(),
            workspace_max_mm: settings.workspace_max_mm.into(),
        }
    }

    /// The limits as they apply in a posture (rad); `None` if an angle is not finite.
    pub fn at(&self, joints_rad: &JointVector) -> Option<LimitsHere<'_>> {
        let posture = Posture::new(&self.arm, joints_rad)?;
        Some(LimitsHere { limits: self, joints_rad: *joints_rad, posture })
    }
}

/// The limits as they apply in one posture.
pub(crate) struct LimitsHere<'a> {
    limits: &'a Limits,
    joints_rad: JointVector,
    posture: Posture,
}

impl LimitsHere<'_> {
    /// Whether the arm may take these velocities (mm/s above rad/s), one a step, the last of them zero.
    ///
    /// # Errors
    /// The first limit on the way.
    pub fn permit(&self, velocities: impl Iterator<Item = Vector6<f64>>) -> Result<(), Obstacle> {
        let position_mm = self.posture.position_m * 1e3;
        let Limits { workspace_min_mm, workspace_max_mm, joints, .. } = self.limits;
        let lowest_mm = workspace_min_mm.add_scalar(BOX_MARGIN_MM).inf(&position_mm);
        let highest_mm = workspace_max_mm.add_scalar(-BOX_MARGIN_MM).sup(&position_mm);
        let face = |(axis, is_upper)| Obstacle::WorkspaceFace { axis, is_upper };
        let joint = |(joint, _)| Obstacle::JointLimit { joint: joint + 1 };

        let (mut joints_rad, mut posture, mut end_mm) = (self.joints_rad, self.posture, position_mm);
        let mut piece = Piece::default();
        for velocity in velocities {
            end_mm += part(&velocity, 0) * STEP_S;
            if let Some(beyond) = beyond(&end_mm, &lowest_mm, &highest_mm) {
                return Err(face(beyond));
            }
            let velocity = to_m(&velocity);
            if piece.length >= PIECE_M_RAD || piece.way.dot(&velocity) < 0.0 {
                (joints_rad, posture) = self.follow(&joints_rad, &posture, &piece)?;
                piece = Piece::default();
            }
            piece.add(&velocity);
        }
        let (joints_rad, posture) = self.follow(&joints_rad, &posture, &piece)?;

        if let Some(away) = leads_away(&position_mm, &end_mm, workspace_min_mm, workspace_max_mm) {
            return Err(face(away));
        }
        if let Some(away) = leads_away(&self.joints_rad, &joints_rad, &joints.lower_rad, &joints.upper_rad) {
            return Err(joint(away));
        }
        let (singular, distance) = (SMALLEST_SINGULAR_VALUE, self.posture.singularity_distance);
        let is_clear = distance >= singular || posture.singularity_distance > distance;
        if is_clear { Ok(()) } else { Err(Obstacle::Singularity) }
    }

    /// The joint angles (rad) and the posture after a piece of the way.
    fn follow(
        &self,
        joints_rad: &JointVector,
        posture: &Posture,
        piece: &Piece,
    ) -> Result<(JointVector, Posture), Obstacle> {
        let way = |posture: &Posture| -> Result<JointVector, Obstacle> {
            let task = posture.task(&piece.way);
            // The joints share the way of the flange, hence its speed.
            let fastest_rad_per_s = task.amax() * piece.peak_speed / piece.way.norm().max(f64::MIN_POSITIVE);
            if fastest_rad_per_s <= JOINT_SPEED_MARGIN_RAD_PER_S {
                Ok(task + posture.centring(&task))
            } else {
                Err(Obstacle::JointSpeed)
            }
        };
        let middle = self.within(joints_rad + way(posture)? * 0.5)?;
        let end_rad = joints_rad + way(&middle)?;
        Ok((end_rad, self.within(end_rad)?))
    }

    /// The posture with these joint angles (rad), if it is within the limits or no further beyond than the present one.
    fn within(&self, joints_rad: JointVector) -> Result<Posture, Obstacle> {
        let JointLimits { lower_rad, upper_rad } = self.limits.joints;
        let lowest = lower_rad.add_scalar(JOINT_MARGIN_RAD).inf(&self.joints_rad);
        let highest = upper_rad.add_scalar(-JOINT_MARGIN_RAD).sup(&self.joints_rad);
        if let Some((joint, _)) = beyond(&joints_rad, &lowest, &highest) {
            return Err(Obstacle::JointLimit { joint: joint + 1 });
        }
        let nearest = (SMALLEST_SINGULAR_VALUE + SINGULARITY_MARGIN)
            .min(self.posture.singularity_distance * (1.0 - ROUNDING));
        Posture::new(&self.limits.arm, &joints_rad)
            .filter(|posture| posture.singularity_distance >= nearest)
            .ok_or(Obstacle::Singularity)
    }
}

/// A piece of the way of the flange that is nearly straight.
#[derive(Default)]
struct Piece {
    /// The displacement, in m above rad.
    way: Vector6<f64>,
    /// Its length, turns included.
    length: f64,
    /// The greatest speed on it.
    peak_speed: f64,
}

impl Piece {
    /// Adds a step at this velocity, in m/s above rad/s.
    fn add(&mut self, velocity: &Vector6<f64>) {
        let speed = velocity.norm();
        self.way += velocity * STEP_S;
        self.length += speed * STEP_S;
        self.peak_speed = self.peak_speed.max(speed);
    }
}

/// The first value that is not within its limits, and whether it is above; one that is not a number is not within.
fn beyond<const N: usize>(
    values: &nalgebra::SVector<f64, N>,
    lowest: &nalgebra::SVector<f64, N>,
    highest: &nalgebra::SVector<f64, N>,
) -> Option<(usize, bool)> {
    let outside = (0..N).find(|&index| !(lowest[index]..=highest[index]).contains(&values[index]))?;
    Some((outside, values[outside] > highest[outside]))
}

/// The first value that is beyond a limit now and will not be nearer to it at the end, and whether it is above.
fn leads_away<const N: usize>(
    now: &nalgebra::SVector<f64, N>,
    end: &nalgebra::SVector<f64, N>,
    lowest: &nalgebra::SVector<f64, N>,
    highest: &nalgebra::SVector<f64, N>,
) -> Option<(usize, bool)> {
    (0..N).find_map(|index| {
        let (now, end) = (now[index], end[index]);
        let (is_below, is_above) = (now < lowest[index], now > highest[index]);
        ((is_below && end <= now) || (is_above && end >= now)).then_some((index, is_above))
    })
}

/// A velocity in mm/s above rad/s as one in m/s above rad/s.
fn to_m(velocity: &Vector6<f64>) -> Vector6<f64> {
    velocity.component_mul(&Vector6::new(1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_velocity_that_asks_too_much_speed_of_a_joint_is_refused() {
        let limits = Limits::new(&ArmSettings {
            workspace_min_mm: [-2000.0; 3],
            workspace_max_mm: [2000.0; 3],
            ..ArmSettings::default()
        });
        // Joint 6 nearly aligns the axes of joints 5 and 7.
        let joints_rad = JointVector::from([0.0, -0.3, 0.0, 0.8, 0.3, 0.06, 0.0]);
        let here = limits.at(&joints_rad).unwrap();
        let svd = limits.arm.jacobian(&joints_rad).svd(true, false);
        let hardest = svd.u.unwrap().column(svd.singular_values.imin()).into_owned();
        // One step, so that its way is too short to meet another limit.
        let permits = |speed: f64| {
            let velocity = (hardest * speed).component_mul(&Vector6::new(1e3, 1e3, 1e3, 1.0, 1.0, 1.0));
            here.permit([velocity, Vector6::zeros()].into_iter()) != Err(Obstacle::JointSpeed)
        };
        let joint_speed = here.posture.task(&hardest).amax();
        let fastest = JOINT_SPEED_MARGIN_RAD_PER_S / joint_speed;
        assert!(permits(0.9 * fastest) && permits(-0.9 * fastest));
        assert!(!permits(1.1 * fastest) && !permits(-1.1 * fastest));
    }
}
