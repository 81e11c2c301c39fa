//! The motion of the arm in steps: velocities ramp toward their targets, and limits are errors.

use nalgebra::{Matrix6, Vector3, Vector6};
use tendon_arm::JointVector;
use tendon_arm::kinematics::JOINT_SPEED_LIMIT_RAD_PER_S;
use tendon_xarm::{Mode, TwistFrame};

use super::{
    ANGULAR_ACCELERATION_RAD_PER_S2, JOINT_ACCELERATION_RAD_PER_S2, LINEAR_ACCELERATION_MM_PER_S2, Model,
    STEP_S, Target, code,
};

/// Greatest linear speed that a command reaches, mm/s.
const LINEAR_SPEED_LIMIT_MM_PER_S: f64 = 1000.0;
/// Damping of the inverse Jacobian: small, so that a singularity ends in error 24.
const DAMPING: f64 = 1e-3;

impl Model {
    /// Lets [`super::STEP_NS`] pass.
    pub(super) fn step(&mut self) {
        self.gripper.step();
        if self.deadline_ns.is_some_and(|deadline_ns| self.time_ns >= deadline_ns) {
            self.rest();
        }
        let velocities = match self.mode {
            _ if self.creeps() => {
                self.ramp_flange(Vector6::new(0.0, self.creep_mm_per_s, 0.0, 0.0, 0.0, 0.0))
            }
            Mode::JointVelocity => self.ramp_joints(),
            _ => self.ramp_flange(self.commanded_twist()),
        };
        if velocities.amax() > JOINT_SPEED_LIMIT_RAD_PER_S {
            self.fail(code::SPEED);
            return;
        }
        let joints_rad = self.joints_rad + velocities * STEP_S;
        let is_out = |joint: usize| {
            (joints_rad[joint] < self.joint_limits.lower_rad[joint] && velocities[joint] < 0.0)
                || (joints_rad[joint] > self.joint_limits.upper_rad[joint] && velocities[joint] > 0.0)
        };
        if (0..7).any(is_out) {
            self.fail(code::JOINT_LIMIT);
            return;
        }
        if self.fence_on && velocities != JointVector::zeros() && self.leaves_boundary(&joints_rad) {
            self.fail(code::BOUNDARY);
            return;
        }
        self.joints_rad = joints_rad;
        self.joint_velocities_rad_per_s = velocities;
    }

    /// The twist in the base frame that was ordered: mm/s, rad/s.
    fn commanded_twist(&self) -> Vector6<f64> {
        match self.target {
            Target::Flange { twist, frame: TwistFrame::Base } => twist,
            Target::Flange { twist, frame: TwistFrame::Tool } => {
                let rotation = self.arm.flange_pose_m(&self.joints_rad).rotation;
                let linear = rotation * Vector3::new(twist[0], twist[1], twist[2]);
                let angular = rotation * Vector3::new(twist[3], twist[4], twist[5]);
                Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
            }
            Target::Rest | Target::Joints(_) => Vector6::zeros(),
        }
    }

    /// The flange velocity, nearer to its target, as joint velocities.
    fn ramp_flange(&mut self, mut target: Vector6<f64>) -> JointVector {
        let limit_mm_per_s = match self.is_reduced {
            true => self.reduced_speed_mm_per_s.min(LINEAR_SPEED_LIMIT_MM_PER_S),
            false => LINEAR_SPEED_LIMIT_MM_PER_S,
        };
        let speed_mm_per_s = target.fixed_rows::<3>(0).norm();
        if speed_mm_per_s > limit_mm_per_s {
            target *= limit_mm_per_s / speed_mm_per_s;
        }
        for (rows, acceleration) in [(0, LINEAR_ACCELERATION_MM_PER_S2), (3, ANGULAR_ACCELERATION_RAD_PER_S2)]
        {
            let change = target.fixed_rows::<3>(rows) - self.flange_velocity.fixed_rows::<3>(rows);
            let share = (acceleration * STEP_S / change.norm()).min(1.0);
            if share < 1.0 {
                let mut velocity = self.flange_velocity.fixed_rows_mut::<3>(rows);
                velocity += change * share;
            } else {
                // To the last bit, so that rest is rest.
                self.flange_velocity.fixed_rows_mut::<3>(rows).copy_from(&target.fixed_rows::<3>(rows));
            }
        }
        let mut twist_m = self.flange_velocity;
        twist_m.fixed_rows_mut::<3>(0).scale_mut(1e-3);
        if twist_m == Vector6::zeros() {
            return JointVector::zeros();
        }
        let jacobian = self.arm.jacobian(&self.joints_rad);
        let damped = jacobian * jacobian.transpose() + Matrix6::identity() * (DAMPING * DAMPING);
        match damped.cholesky() {
            Some(factors) => jacobian.transpose() * factors.solve(&twist_m),
            // Positive definite by the damping; were it not, standing still is safe.
            None => JointVector::zeros(),
        }
    }

    /// The joint velocities, nearer to their target.
    fn ramp_joints(&self) -> JointVector {
        let target = match self.target {
            Target::Joints(velocities) => velocities,
            Target::Rest | Target::Flange { .. } => JointVector::zeros(),
        };
        let change = JOINT_ACCELERATION_RAD_PER_S2 * STEP_S;
        self.joint_velocities_rad_per_s.zip_map(&target, |now, target| {
            if (target - now).abs() <= change { target } else { now + change.copysign(target - now) }
        })
    }

    fn leaves_boundary(&self, joints_rad: &JointVector) -> bool {
        let [now, next] = [&self.joints_rad, joints_rad]
            .map(|joints| self.arm.flange_pose_m(joints).translation.vector * 1e3);
        (0..3).any(|axis| {
            let [highest, lowest] =
                [self.boundary_mm[2 * axis], self.boundary_mm[2 * axis + 1]].map(f64::from);
            (next[axis] > highest && next[axis] > now[axis])
                || (next[axis] < lowest && next[axis] < now[axis])
        })
    }
}
