//! Forward kinematics and Jacobian of the UFACTORY xArm7.
//!
//! Seven revolute joints in a chain. Each has an origin, fixed in the frame of the joint before it, and
//! turns about its own z axis; the frame of joint 7 is the flange. With all joints zero the flange is at
//! (206.0, 0, 120.5) mm and looks down.
//!
//! Source of the joint origins and limits: the vendor's URDF (`xarm_description` in the ROS driver
//! `xarm_ros2`). A robot's own calibration differs from it by fractions of a millimetre.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{ArrayStorage, Isometry3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// One value a joint, joint 1 first.
pub type JointVector = SVector<f64, 7>;

/// The geometric Jacobian: rows are linear x, y, z in m then angular x, y, z in rad, one column a joint.
pub type Jacobian = SMatrix<f64, 6, 7>;

/// Lower joint limits in rad.
pub const LOWER_LIMITS_RAD: JointVector =
    joint_vector([-2.0 * PI, -2.059, -2.0 * PI, -0.19198, -2.0 * PI, -1.69297, -2.0 * PI]);

/// Upper joint limits in rad.
pub const UPPER_LIMITS_RAD: JointVector =
    joint_vector([2.0 * PI, 2.0944, 2.0 * PI, 3.927, 2.0 * PI, PI, 2.0 * PI]);

/// Joint limits of one arm. They differ between generations of the xArm7.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLimits {
    /// Lower limits in rad.
    pub lower_rad: JointVector,
    /// Upper limits in rad.
    pub upper_rad: JointVector,
}

impl Default for JointLimits {
    /// [`LOWER_LIMITS_RAD`] and [`UPPER_LIMITS_RAD`].
    fn default() -> JointLimits {
        JointLimits { lower_rad: LOWER_LIMITS_RAD, upper_rad: UPPER_LIMITS_RAD }
    }
}

/// The greatest speed of every joint in rad/s.
#[expect(clippy::approx_constant, reason = "the vendor's limit is 3.14, not π")]
pub const JOINT_SPEED_LIMIT_RAD_PER_S: f64 = 3.14;

/// A joint vector in a constant.
const fn joint_vector(values: [f64; 7]) -> JointVector {
    JointVector::from_array_storage(ArrayStorage([values]))
}

/// Joint origins in the frame of the joint before: x, y, z in m, then rotation about x in rad (no origin
/// is turned about another axis).
const JOINT_ORIGINS: [([f64; 3], f64); 7] = [
    ([0.0, 0.0, 0.267], 0.0),
    ([0.0, 0.0, 0.0], -FRAC_PI_2),
    ([0.0, -0.293, 0.0], FRAC_PI_2),
    ([0.0525, 0.0, 0.0], FRAC_PI_2),
    ([0.0775, -0.3425, 0.0], FRAC_PI_2),
    ([0.0, 0.0, 0.0], FRAC_PI_2),
    ([0.076, 0.097, 0.0], -FRAC_PI_2),
];

/// A joint's modified Denavit-Hartenberg parameters (Craig, Introduction to Robotics, eq. 3.6): along x by `a`, about x by
/// `alpha`, about z by the joint's angle, along z by `d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenavitHartenberg {
    /// Link length in mm.
    pub a_mm: f64,
    /// Offset along the joint's axis in mm.
    pub d_mm: f64,
    /// Twist of the link in rad.
    pub alpha_rad: f64,
}

/// The arm's modified Denavit-Hartenberg parameters, joint 1 first; with all of them at zero, no angle has an offset.
pub fn denavit_hartenberg() -> [DenavitHartenberg; 7] {
    // An origin is turned about x by alpha, and shifted by a along x and by d along the z axis that this gives.
    JOINT_ORIGINS.map(|([x_m, y_m, z_m], alpha_rad)| {
        let d_m = z_m * alpha_rad.cos() - y_m * alpha_rad.sin();
        DenavitHartenberg { a_mm: 1e3 * x_m, d_mm: 1e3 * d_m, alpha_rad }
    })
}

/// The kinematic chain of the xArm7, without a tool.
#[derive(Clone, Debug)]
pub struct XArm7 {
    /// Origin of each joint in the frame of the joint before.
    origins: [Isometry3<f64>; 7],
}

/// Where a joint's axis lies in the base frame.
#[derive(Clone, Copy, Default)]
struct Axis {
    /// A point on the axis, in m.
    origin_m: Vector3<f64>,
    /// Unit vector along the axis.
    direction: Vector3<f64>,
}

impl XArm7 {
    /// The arm with the vendor's nominal dimensions.
    pub fn new() -> XArm7 {
        let origins = JOINT_ORIGINS.map(|(xyz_m, roll_rad)| {
            Isometry3::from_parts(
                Translation3::from(xyz_m),
                UnitQuaternion::from_euler_angles(roll_rad, 0.0, 0.0),
            )
        });
        XArm7 { origins }
    }

    /// Pose of the flange in the base frame, in metres, for these joint angles in rad.
    pub fn flange_pose_m(&self, joints_rad: &JointVector) -> Isometry3<f64> {
        self.chain(joints_rad).1
    }

    /// Geometric Jacobian of the flange in the base frame: flange velocity (m/s, rad/s) = Jacobian ·
    /// joint velocities (rad/s). Column j is `[z_j × (p − p_j); z_j]` with the axis direction `z_j`, a point
    /// on it `p_j` and the flange position `p` (Siciliano et al., Robotics, 2009, eq. 3.30).
    pub fn jacobian(&self, joints_rad: &JointVector) -> Jacobian {
        self.jacobian_and_position_m(joints_rad).0
    }

    /// [`XArm7::jacobian`], and the position of the flange in the base frame in metres, at the cost of one.
    pub fn jacobian_and_position_m(&self, joints_rad: &JointVector) -> (Jacobian, Vector3<f64>) {
        let (axes, flange) = self.chain(joints_rad);
        let tip = flange.translation.vector;
        let mut jacobian = Jacobian::zeros();
        for (axis, mut column) in axes.iter().zip(jacobian.column_iter_mut()) {
            column.fixed_rows_mut::<3>(0).copy_from(&axis.direction.cross(&(tip - axis.origin_m)));
            column.fixed_rows_mut::<3>(3).copy_from(&axis.direction);
        }
        (jacobian, tip)
    }

    /// The joint axes in the base frame, and the flange pose at the end of the chain.
    fn chain(&self, joints_rad: &JointVector) -> ([Axis; 7], Isometry3<f64>) {
        let mut axes = [Axis::default(); 7];
        let mut pose = Isometry3::identity();
        for (joint, origin) in self.origins.iter().enumerate() {
            pose *= origin;
            axes[joint] = Axis { origin_m: pose.translation.vector, direction: pose.rotation * Vector3::z() };
            pose *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), joints_rad[joint]);
        }
        (axes, pose)
    }
}

impl Default for XArm7 {
    fn default() -> XArm7 {
        XArm7::new()
    }
}

/// Any posture within the joint limits, for property tests.
#[cfg(test)]
pub(crate) fn any_posture() -> impl proptest::strategy::Strategy<Value = JointVector> {
    use proptest::prelude::*;
    prop::array::uniform7(0.0..=1.0_f64).prop_map(|shares| {
        LOWER_LIMITS_RAD + (UPPER_LIMITS_RAD - LOWER_LIMITS_RAD).component_mul(&JointVector::from(shares))
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    use super::*;

    /// Uniform numbers in 0..1, as the script beside the golden vector draws them: SplitMix64.
    fn split_mix(state: &mut u64) -> f64 {
        *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut number = (*state ^ (*state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        number = (number ^ (number >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((number ^ (number >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    #[test]
    fn pose_and_jacobian_agree_with_pinocchio() {
        let golden = include_bytes!("../tests/golden/kinematics.bin");
        let (cases, rest) = golden.as_chunks::<{ 12 * 8 + 42 * 4 }>();
        assert_eq!((cases.len(), rest.len()), (1000, 0));
        let arm = XArm7::new();
        let mut random = 7;
        for case in cases {
            let joints = JointVector::from_fn(|joint, _| {
                let (lower, upper) = (LOWER_LIMITS_RAD[joint], UPPER_LIMITS_RAD[joint]);
                lower + (upper - lower) * split_mix(&mut random)
            });
            let (numbers, entries) = case.split_at(12 * 8);
            let numbers: Vec<f64> =
                numbers.as_chunks().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
            let entries = entries.as_chunks().0.iter().map(|bytes| i32::from_le_bytes(*bytes));
            let jacobian = Jacobian::from_row_iterator(entries.map(|entry| f64::from(entry) * 1e-9));
            let pose = arm.flange_pose_m(&joints);
            assert!((pose.translation.vector - Vector3::from_column_slice(&numbers[..3])).amax() < 1e-9);
            let rotation = pose.rotation.to_rotation_matrix().into_inner();
            assert!((rotation - Matrix3::from_row_slice(&numbers[3..])).amax() < 1e-9);
            assert!((arm.jacobian(&joints) - jacobian).amax() < 1e-8);
        }
    }

    #[test]
    fn with_all_joints_zero_the_flange_is_where_the_vendor_says() {
        let pose = XArm7::new().flange_pose_m(&JointVector::zeros());
        assert!((pose.translation.vector - Vector3::new(0.206, 0.0, 0.1205)).amax() < 1e-12);
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        assert!((rotation - Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0))).amax() < 1e-12);
    }

    proptest! {
        #[test]
        fn jacobian_agrees_with_finite_differences(joints in any_posture()) {
            let arm = XArm7::new();
            let jacobian = arm.jacobian(&joints);
            let step = 1e-6;
            for joint in 0..7 {
                let mut ahead = joints;
                ahead[joint] += step;
                let mut behind = joints;
                behind[joint] -= step;
                let (ahead, behind) = (arm.flange_pose_m(&ahead), arm.flange_pose_m(&behind));
                let linear = (ahead.translation.vector - behind.translation.vector) / (2.0 * step);
                let angular = (ahead.rotation * behind.rotation.inverse()).scaled_axis() / (2.0 * step);
                let column = jacobian.column(joint);
                prop_assert!((column.fixed_rows::<3>(0) - linear).amax() < 1e-8);
                prop_assert!((column.fixed_rows::<3>(3) - angular).amax() < 1e-8);
            }
        }
    }
}
