//! From a twist to joint velocities, within the limits of the joints and away from singularities.
//!
//! ```text
//! joint velocities = a · (damped inverse of the Jacobian) · twist  +  b · joint centring
//! ```
//!
//! - **Damped inverse.** With the singular value decomposition J = Σ σᵢ uᵢ vᵢᵀ, damped least squares gives
//!   Σ σᵢ / (σᵢ² + λᵢ²) vᵢ uᵢᵀ. The damping λᵢ² = max(0, σ₀² − σᵢ²) is zero in a well-conditioned direction and
//!   grows as a singular value sinks below σ₀ = [`SMALLEST_SINGULAR_VALUE`] (Nakamura and Hanafusa, 1986,
//!   who measure the nearness by manipulability; by singular value: Maciejewski and Klein, 1988). Then
//!   σᵢ / (σᵢ² + λᵢ²) = σᵢ / max(σᵢ, σ₀)².
//! - **Joint centring.** The seventh degree of freedom draws the joints to the middle of their ranges within
//!   the null space of J, which leaves the flange alone (Liégeois, 1977). It is in proportion to the joint
//!   speed that the twist asks for: an arm that stands still stands still altogether.
//! - **Limits.** `a` and `b`, both in 0..=1, are the greatest that keep the joint speed limits, and keep the speed
//!   towards a joint limit or towards a singularity below [`APPROACH_RATE_PER_S`] times the distance
//!   left (a velocity damper: Faverjon and Tournassoud, 1987). Slowing as a whole keeps the direction. At an
//!   edge of the workspace the arm comes softly to rest, and every twist that leads back is free.
//!
//! The singular values mix metres and radians; metres and radians suit an arm of this reach (0.7 m).

use nalgebra::{SVD, SVector, Vector6};

use crate::Twist;
use crate::kinematics::{
    JOINT_SPEED_LIMIT_RAD_PER_S, JointVector, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, XArm7,
};

/// Singular values of the Jacobian below this count as singular: damping sets in, and motion that would
/// lower them further is stopped. At 100 mm/s it keeps joints below 2.5 rad/s, within their speed limit.
pub const SMALLEST_SINGULAR_VALUE: f64 = 0.04;

/// The speed towards a limit is at most this times the distance left to it. An integration step must be
/// shorter than its inverse, 0.2 s.
pub const APPROACH_RATE_PER_S: f64 = 5.0;

/// Centring joint speed over task joint speed, for joints half a range off centre.
const CENTRING_SHARE: f64 = 0.5;

/// Joint velocities that follow a twist as far as the limits allow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointVelocities {
    /// Joint velocities in rad/s.
    pub rad_per_s: JointVector,
    /// How much of the twist was allowed (`a` above): 1 all of it, 0 none.
    pub scale: f64,
}

/// Rates (rad/s or 1/s) towards a limit below this are rounding errors and not held against it.
const NEGLIGIBLE_RATE: f64 = 1e-9;

/// What is limited: the seven joint velocities, then the rates of the six singular values.
type Rates = SVector<f64, 13>;

/// Joint velocities for a finite twist of the flange, in a posture within the joint limits (rad).
///
/// Where all singular values are at least [`SMALLEST_SINGULAR_VALUE`], the flange moves at exactly
/// `scale · twist`.
pub fn joint_velocities(arm: &XArm7, joints_rad: &JointVector, twist: &Twist) -> JointVelocities {
    let standstill = JointVelocities { rad_per_s: JointVector::zeros(), scale: 0.0 };
    let Some((singular_values, left, right)) = decompose(arm, joints_rad) else {
        return standstill;
    };
    let gains = singular_values.map(damped_inverse);
    let task = right.tr_mul(&gains.component_mul(&left.tr_mul(&twist.to_vector_m())));
    let pull = offset_from_centre(joints_rad) * (-CENTRING_SHARE * task.norm());
    let centring = pull - right.tr_mul(&(right * pull));

    let rates_of = |velocities: &JointVector| -> Rates {
        let jacobian_rate = arm.jacobian_rate(joints_rad, velocities);
        let mut rates = Rates::zeros();
        rates.fixed_rows_mut::<7>(0).copy_from(velocities);
        for value in 0..6 {
            // Derivative of a singular value: uᵀ (dJ/dt) v.
            rates[7 + value] = left.column(value).dot(&(jacobian_rate * right.row(value).transpose()));
        }
        rates
    };
    let (lowest, highest) = allowed_rates(joints_rad, &singular_values);
    let task_rates = rates_of(&task);
    let scale = greatest_share(&Rates::zeros(), &task_rates, &lowest, &highest);
    let centring_share = greatest_share(&(task_rates * scale), &rates_of(&centring), &lowest, &highest);
    // The centring follows the motion it accompanies: no motion, no centring.
    JointVelocities { rad_per_s: task * scale + centring * (centring_share * scale), scale }
}

/// The smallest singular value of the Jacobian in this posture (rad): 0 in a singularity.
pub fn smallest_singular_value(arm: &XArm7, joints_rad: &JointVector) -> f64 {
    decompose(arm, joints_rad).map_or(0.0, |(singular_values, _, _)| singular_values.min())
}

/// Singular values of the Jacobian, its left singular vectors as columns and its right ones as rows.
/// `None` should the iteration not converge.
fn decompose(
    arm: &XArm7,
    joints_rad: &JointVector,
) -> Option<(Vector6<f64>, nalgebra::Matrix6<f64>, nalgebra::SMatrix<f64, 6, 7>)> {
    const MOST_ITERATIONS: usize = 1000;
    let svd =
        SVD::try_new_unordered(arm.jacobian(joints_rad), true, true, 5.0 * f64::EPSILON, MOST_ITERATIONS)?;
    Some((svd.singular_values, svd.u?, svd.v_t?))
}

/// σ / (σ² + λ²) with the damping of the module's text: the inverse of a singular value, finite everywhere.
fn damped_inverse(singular_value: f64) -> f64 {
    singular_value / singular_value.max(SMALLEST_SINGULAR_VALUE).powi(2)
}

/// Where each joint is in its range: −1 at the lower limit, 0 in the middle, 1 at the upper limit.
fn offset_from_centre(joints_rad: &JointVector) -> JointVector {
    let centre = (UPPER_LIMITS_RAD + LOWER_LIMITS_RAD) * 0.5;
    let half_range = (UPPER_LIMITS_RAD - LOWER_LIMITS_RAD) * 0.5;
    (joints_rad - centre).component_div(&half_range)
}

/// The lowest (never positive) and highest (never negative) allowed rates.
fn allowed_rates(joints_rad: &JointVector, singular_values: &Vector6<f64>) -> (Rates, Rates) {
    let approach = |distance: f64| APPROACH_RATE_PER_S * distance.max(0.0);
    let mut lowest = Rates::zeros();
    let mut highest = Rates::repeat(f64::INFINITY);
    for joint in 0..7 {
        let below = joints_rad[joint] - LOWER_LIMITS_RAD[joint];
        let above = UPPER_LIMITS_RAD[joint] - joints_rad[joint];
        lowest[joint] = -approach(below).min(JOINT_SPEED_LIMIT_RAD_PER_S);
        highest[joint] = approach(above).min(JOINT_SPEED_LIMIT_RAD_PER_S);
    }
    for value in 0..6 {
        lowest[7 + value] = -approach(singular_values[value] - SMALLEST_SINGULAR_VALUE);
    }
    (lowest, highest)
}

/// The greatest share in 0..=1 for which `base + share · step` stays between `lowest` and `highest`, given
/// that `base` does.
fn greatest_share(base: &Rates, step: &Rates, lowest: &Rates, highest: &Rates) -> f64 {
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
    fn damping_grows_towards_a_singularity_and_is_absent_far_from_it() {
        let inverse_at =
            |share: f64| damped_inverse(share * SMALLEST_SINGULAR_VALUE) * SMALLEST_SINGULAR_VALUE;
        for (share, expected) in [(0.0, 0.0), (0.25, 0.25), (0.5, 0.5), (1.0, 1.0), (2.0, 0.5), (4.0, 0.25)] {
            assert!((inverse_at(share) - expected).abs() < 1e-12);
        }
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
        let (_, _, right) = decompose(&arm, &joints).unwrap();
        let self_motion = solution.rad_per_s - right.tr_mul(&(right * solution.rad_per_s));
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
            prop_assume!(smallest_singular_value(&arm, &joints) >= SMALLEST_SINGULAR_VALUE);
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
