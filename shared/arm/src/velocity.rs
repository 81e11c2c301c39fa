//! From a twist to joint velocities, within the limits of the joints and calm near singularities.
//!
//! ```text
//! joint velocities = a · (damped inverse of the Jacobian) · twist  +  b · joint centring
//! ```
//!
//! - **Damped inverse.** Damped least squares gives Jᵀ (J Jᵀ + λ² I)⁻¹. How near a singularity is, is measured by
//!   [`singularity_distance`]. From σ₀ = [`SMALLEST_SINGULAR_VALUE`] on, the damping is zero and the inverse the
//!   pseudo-inverse; nearer it grows by λ² = σ₀² − distance² (Nakamura and Hanafusa, 1986, who measure the
//!   nearness by manipulability).
//! - **Joint centring.** The seventh degree of freedom draws the joints to the middle of their ranges within
//!   the null space of J, which leaves the flange alone (Liégeois, 1977). It is in proportion to the joint
//!   speed that the twist asks for, so that the way of the joints depends on the way of the flange and not on its
//!   speed. It fades out towards singularities and before it would press a joint to its limit: there a twist
//!   and its opposite lead along the same way.
//! - **Last resort.** `a` and `b`, both in 0..=1, are the greatest that keep the joint speed limits, and keep the speed
//!   towards a joint limit below [`APPROACH_RATE_PER_S`] times the distance left (a velocity damper: Faverjon
//!   and Tournassoud, 1987). [`crate::Motion`] asks for no twist that needs it, but for postures beyond the limits.
//!
//! The Jacobian mixes metres and radians; metres and radians suit an arm of this reach (0.7 m).

use nalgebra::{Cholesky, Matrix6, Vector3, Vector6};

use crate::Twist;
use crate::kinematics::{
    JOINT_SPEED_LIMIT_RAD_PER_S, Jacobian, JointVector, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, XArm7,
};

/// Singular values of the Jacobian below this count as singular: damping sets in.
pub const SMALLEST_SINGULAR_VALUE: f64 = 0.04;

/// The speed of a joint towards a limit is at most this times the distance left to it. An integration step must
/// be shorter than its inverse, 10 ms.
pub const APPROACH_RATE_PER_S: f64 = 100.0;

/// Centring joint speed over task joint speed, for joints half a range off centre.
const CENTRING_SHARE: f64 = 0.5;

/// Motion ends this far before a joint limit, in rad.
pub(crate) const JOINT_MARGIN_RAD: f64 = 0.02;

/// Centring is absent up to the first singularity distance, and whole from the second on.
const CENTRING_FADES: [f64; 2] = [0.05, 0.1];

/// At this distance to a limit, in rad, centring presses a joint towards the limit no faster than the task moves all
/// joints together; nearer in proportion.
const CENTRING_ROOM_RAD: f64 = 0.2;

/// Joint velocities that follow a twist as far as the limits allow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointVelocities {
    /// Joint velocities in rad/s.
    pub rad_per_s: JointVector,
    /// How much of the twist was allowed (`a` above): 1 all of it, 0 none.
    pub scale: f64,
}

/// Rates (rad/s) towards a limit below this are rounding errors and not held against it.
const NEGLIGIBLE_RATE: f64 = 1e-9;

/// Joint velocities for a finite twist of the flange, in a posture within the joint limits (rad).
///
/// Where [`singularity_distance`] is at least [`SMALLEST_SINGULAR_VALUE`], the flange moves at exactly
/// `scale · twist`.
pub fn joint_velocities(arm: &XArm7, joints_rad: &JointVector, twist: &Twist) -> JointVelocities {
    let Some(posture) = Posture::new(arm, joints_rad) else {
        return JointVelocities { rad_per_s: JointVector::zeros(), scale: 0.0 };
    };
    let task = posture.task(&twist.to_vector_m());
    let (lowest, highest) = allowed_rates(joints_rad);
    let scale = greatest_share(&JointVector::zeros(), &task, &lowest, &highest);
    // The centring follows the motion it accompanies: no motion, no centring.
    let task = task * scale;
    let centring = posture.centring(&task);
    let centring_share = greatest_share(&task, &centring, &lowest, &highest);
    JointVelocities { rad_per_s: task + centring * centring_share, scale }
}

/// The smallest singular value of the Jacobian in this posture (rad): 0 in a singularity.
pub fn smallest_singular_value(arm: &XArm7, joints_rad: &JointVector) -> f64 {
    arm.jacobian(joints_rad).singular_values().min()
}

/// How far a posture (rad) is from a singularity: 1/‖J⁺‖ in the Frobenius norm, that is (Σ σᵢ⁻²)^−½. It is at
/// most the smallest singular value, close to it near a singularity, 0 in one, and unlike it smooth everywhere.
pub fn singularity_distance(arm: &XArm7, joints_rad: &JointVector) -> f64 {
    Posture::new(arm, joints_rad).map_or(0.0, |posture| posture.singularity_distance)
}

/// What a posture does to velocities.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Posture {
    joints_rad: JointVector,
    jacobian: Jacobian,
    /// (J Jᵀ + λ² I)⁻¹.
    inverse: Matrix6<f64>,
    /// Position of the flange in m.
    pub position_m: Vector3<f64>,
    /// See [`singularity_distance`].
    pub singularity_distance: f64,
}

impl Posture {
    /// `None` if an angle (rad) is not finite.
    pub fn new(arm: &XArm7, joints_rad: &JointVector) -> Option<Posture> {
        let (jacobian, position_m) = arm.jacobian_and_position_m(joints_rad);
        let gram = jacobian * jacobian.transpose();
        let mut singularity_distance = 0.0;
        // In a singularity there is no factor, or one of rounding errors, whose distance is next to zero.
        let mut inverse = Matrix6::zeros();
        if let Some(factor) = Cholesky::new(gram) {
            inverse = factor.inverse();
            singularity_distance = inverse.trace().powf(-0.5);
        }
        let damping = SMALLEST_SINGULAR_VALUE.powi(2) - singularity_distance.powi(2);
        if damping > 0.0 || damping.is_nan() {
            inverse = Cholesky::new(gram + Matrix6::identity() * damping)?.inverse();
        }
        Some(Posture { joints_rad: *joints_rad, jacobian, inverse, position_m, singularity_distance })
    }

    /// Joint velocities (rad/s) that move the flange at this velocity (m/s above rad/s), or small
    /// displacements likewise.
    pub fn task(&self, velocity: &Vector6<f64>) -> JointVector {
        self.jacobian.tr_mul(&(self.inverse * velocity))
    }

    /// The centring that accompanies joint velocities or displacements of the task.
    pub fn centring(&self, task: &JointVector) -> JointVector {
        let [absent, whole] = CENTRING_FADES;
        let clearance = ((self.singularity_distance - absent) / (whole - absent)).clamp(0.0, 1.0);
        let speed = task.norm();
        let pull = offset_from_centre(&self.joints_rad) * (-CENTRING_SHARE * clearance * speed);
        let centring = pull - self.task(&(self.jacobian * pull));
        let below =
            (self.joints_rad - LOWER_LIMITS_RAD).add_scalar(-JOINT_MARGIN_RAD) * speed / CENTRING_ROOM_RAD;
        let above =
            (UPPER_LIMITS_RAD - self.joints_rad).add_scalar(-JOINT_MARGIN_RAD) * speed / CENTRING_ROOM_RAD;
        let zero = JointVector::zeros();
        centring * greatest_share(&zero, &centring, &-below.sup(&zero), &above.sup(&zero))
    }
}

/// Where each joint is in its range: −1 at the lower limit, 0 in the middle, 1 at the upper limit.
fn offset_from_centre(joints_rad: &JointVector) -> JointVector {
    let centre = (UPPER_LIMITS_RAD + LOWER_LIMITS_RAD) * 0.5;
    let half_range = (UPPER_LIMITS_RAD - LOWER_LIMITS_RAD) * 0.5;
    (joints_rad - centre).component_div(&half_range)
}

/// The lowest (never positive) and highest (never negative) allowed joint velocities in rad/s.
fn allowed_rates(joints_rad: &JointVector) -> (JointVector, JointVector) {
    let approach = |distance: f64| (APPROACH_RATE_PER_S * distance).clamp(0.0, JOINT_SPEED_LIMIT_RAD_PER_S);
    (
        (LOWER_LIMITS_RAD - joints_rad).map(|below| -approach(-below)),
        (UPPER_LIMITS_RAD - joints_rad).map(approach),
    )
}

/// The greatest share in 0..=1 for which `base + share · step` stays between `lowest` and `highest`, given
/// that `base` does.
fn greatest_share(
    base: &JointVector,
    step: &JointVector,
    lowest: &JointVector,
    highest: &JointVector,
) -> f64 {
    let mut share: f64 = 1.0;
    for index in 0..step.len() {
        let room = match step[index] {
            rate if rate > NEGLIGIBLE_RATE => highest[index] - base[index],
            rate if rate < -NEGLIGIBLE_RATE => lowest[index] - base[index],
            _ => continue,
        };
        share = share.min(room / step[index]);
    }
    share.max(0.0)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::kinematics::any_posture;

    fn any_twist() -> impl Strategy<Value = Twist> {
        (prop::array::uniform3(-300.0..300.0_f64), prop::array::uniform3(-1.0..1.0_f64))
            .prop_map(|(linear_mm_per_s, angular_rad_per_s)| Twist { linear_mm_per_s, angular_rad_per_s })
    }

    #[test]
    fn the_singularity_distance_is_below_the_smallest_singular_value_and_near_it_near_a_singularity() {
        let arm = XArm7::new();
        for bend in [0.0, 0.001, 0.01, 0.05, 0.1, 0.3, 0.6] {
            let joints = JointVector::from([0.3, bend, 0.4, bend, 0.5, bend, 0.6]);
            let (distance, smallest) =
                (singularity_distance(&arm, &joints), smallest_singular_value(&arm, &joints));
            // Squaring the Jacobian leaves half of the digits.
            assert!(distance <= smallest + 1e-7, "{distance} {smallest}");
            assert!(distance >= smallest / 6.0_f64.sqrt() - 1e-7, "{distance} {smallest}");
        }
        assert!(singularity_distance(&arm, &JointVector::zeros()) < 1e-7);
        assert_eq!(singularity_distance(&arm, &JointVector::repeat(f64::NAN)), 0.0);
    }

    #[test]
    fn with_all_joints_zero_the_arm_is_singular_and_answers_calmly() {
        let arm = XArm7::new();
        let zero = JointVector::zeros();
        assert!(smallest_singular_value(&arm, &zero) < 1e-12);
        let twist = Twist { linear_mm_per_s: [30.0, 20.0, 10.0], angular_rad_per_s: [0.1, 0.2, 0.3] };
        let solution = joint_velocities(&arm, &zero, &twist);
        // The task and at most half as much centring.
        let greatest = 1.5 * twist.to_vector_m().norm() / SMALLEST_SINGULAR_VALUE;
        assert!(solution.rad_per_s.norm() <= greatest);
    }

    #[test]
    fn centring_turns_the_joints_towards_the_middle_of_their_ranges() {
        let arm = XArm7::new();
        let joints = JointVector::from([1.0, 0.4, -1.2, 1.5, 0.9, 1.1, -0.6]);
        let twist = Twist { linear_mm_per_s: [0.0, 50.0, 0.0], ..Twist::ZERO };
        let solution = joint_velocities(&arm, &joints, &twist);
        let pseudo_inverse = arm.jacobian(&joints).pseudo_inverse(1e-9).unwrap();
        let self_motion = solution.rad_per_s - pseudo_inverse * (arm.jacobian(&joints) * solution.rad_per_s);
        assert!(self_motion.norm() > 1e-3);
        assert!(self_motion.dot(&offset_from_centre(&joints)) < 0.0);
    }

    #[test]
    fn no_twist_moves_no_joint() {
        let joints = JointVector::from([1.0, 0.4, -1.2, 1.5, 0.9, 1.1, -0.6]);
        let solution = joint_velocities(&XArm7::new(), &joints, &Twist::ZERO);
        assert_eq!(solution.rad_per_s, JointVector::zeros());
    }

    proptest! {
        #[test]
        fn the_flange_moves_along_the_twist(joints in any_posture(), twist in any_twist()) {
            let arm = XArm7::new();
            prop_assume!(singularity_distance(&arm, &joints) >= SMALLEST_SINGULAR_VALUE);
            let solution = joint_velocities(&arm, &joints, &twist);
            let achieved = arm.jacobian(&joints) * solution.rad_per_s;
            let wanted = twist.to_vector_m() * solution.scale;
            prop_assert!((achieved - wanted).amax() < 1e-12, "{achieved} {wanted}");
        }

        #[test]
        fn limits_hold_in_any_posture_singular_ones_included(
            joints in any_posture(),
            folded in prop::array::uniform7(any::<bool>()),
            twist in any_twist(),
        ) {
            let mut joints = joints;
            for joint in 0..7 {
                if folded[joint] {
                    joints[joint] = 0.0; // zeros align axes, which is where the singularities are
                }
            }
            let solution = joint_velocities(&XArm7::new(), &joints, &twist);
            prop_assert!((0.0..=1.0).contains(&solution.scale));
            for joint in 0..7 {
                let velocity = solution.rad_per_s[joint];
                prop_assert!(velocity.abs() <= JOINT_SPEED_LIMIT_RAD_PER_S + 1e-8);
                let distance = if velocity > 0.0 {
                    UPPER_LIMITS_RAD[joint] - joints[joint]
                } else {
                    joints[joint] - LOWER_LIMITS_RAD[joint]
                };
                prop_assert!(velocity.abs() <= APPROACH_RATE_PER_S * distance + 1e-8);
            }
        }

        #[test]
        fn a_twist_that_is_blocked_one_way_is_free_the_other_way(
            joints in any_posture(),
            limited in 0..7_usize,
            twist in any_twist(),
        ) {
            let arm = XArm7::new();
            let mut joints = joints;
            joints[limited] = UPPER_LIMITS_RAD[limited];
            // The other joints away from their limits, the posture from singularities.
            prop_assume!(smallest_singular_value(&arm, &joints) > 2.0 * SMALLEST_SINGULAR_VALUE);
            prop_assume!((0..7).filter(|&joint| joint != limited).all(|joint| {
                let room = UPPER_LIMITS_RAD[joint] - joints[joint];
                room.min(joints[joint] - LOWER_LIMITS_RAD[joint]) > 0.1
            }));
            let scales = [twist, twist.scaled(-1.0)]
                .map(|twist| joint_velocities(&arm, &joints, &twist).scale);
            prop_assert!(scales[0].min(scales[1]) == 0.0 && scales[0].max(scales[1]) > 0.0, "{scales:?}");
        }
    }
}
