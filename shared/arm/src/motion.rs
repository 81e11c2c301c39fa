//! From commands to a velocity that an arm can follow without leaving its limits.

use crate::kinematics::JointLimits;
use crate::limits::{Limits, Obstacle};
use crate::ramp::TwistRamp;
use crate::{ArmSettings, JointVector, NonFiniteTwist, Twist};

/// The velocity that an arm is to follow, step by step: bounded in speed, acceleration and jerk
/// ([`ArmSettings::linear_bounds`], [`ArmSettings::angular_bounds`]), never out of the workspace, and at rest when
/// no command has come for the time of the watchdog.
///
/// It serves any arm that tells its joint angles, simulated or real. Its watchdog and limits are software: they
/// are not safety-rated and replace no emergency stop.
#[derive(Clone, Debug)]
pub struct Motion {
    ramp: TwistRamp,
    limits: Limits,
}

impl Motion {
    /// At rest, with settings that [`ArmSettings::check`] accepts.
    pub fn new(settings: &ArmSettings) -> Motion {
        Motion { ramp: TwistRamp::new(settings), limits: Limits::new(settings) }
    }

    /// Takes this twist for the velocity to go to until the watchdog or another command. A twist above the
    /// speed limits is slowed as a whole. While the arm is stopping, the command waits until it is at rest, and
    /// counts then if the watchdog has not let it run out.
    ///
    /// # Errors
    /// A twist that is not finite is taken as [`Twist::ZERO`]; [`NonFiniteTwist`] names the component.
    pub fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        let finite = twist.finite();
        self.ramp.command(finite.unwrap_or(Twist::ZERO), now_ns);
        finite.map(|_| ())
    }

    /// Forgets the command and comes to rest within [`STOP_NS`](crate::STOP_NS), as the watchdog does. Nothing
    /// interrupts a stop.
    pub fn stop(&mut self) {
        self.ramp.stop();
    }

    /// Forgets the command and is at rest at once: for an arm that has stopped by itself.
    pub fn halt(&mut self) {
        self.ramp.halt();
    }

    /// The velocity for the [`STEP_NS`](crate::STEP_NS) that begin at `now_ns`, with the joints at these angles in
    /// rad then. With angles that are not finite the arm brakes.
    pub fn advance(&mut self, now_ns: u64, joints_rad: &JointVector) -> Twist {
        let here = if self.ramp.is_still() { None } else { self.limits.at(joints_rad) };
        self.ramp.advance(now_ns, |run_down| match &here {
            Some(here) => here.permit(run_down.velocities()),
            None => Err(Obstacle::Singularity),
        })
    }

    /// Keeps these joint limits from now on; before, [`JointLimits::default`].
    pub fn set_joint_limits(&mut self, limits: JointLimits) {
        self.limits.joints = limits;
    }

    /// What kept the last step from being as commanded; `None` if nothing did.
    pub fn obstacle(&self) -> Option<Obstacle> {
        self.ramp.obstacle()
    }

    /// The velocity when this share, 0 to 1, of the coming step has passed: on the straight line from
    /// [`Motion::velocity`] to what [`Motion::advance`] will give. So a command can be answered between two steps
    /// without more acceleration or jerk than the steps have.
    pub fn foresee(&self, now_ns: u64, joints_rad: &JointVector, share: f64) -> Twist {
        let before = self.velocity().to_vector_mm();
        let after = self.clone().advance(now_ns, joints_rad).to_vector_mm();
        Twist::from_vector_mm(&(before + (after - before) * share))
    }

    /// The velocity of the last step.
    pub fn velocity(&self) -> Twist {
        self.ramp.velocity()
    }

    /// Whether nothing moves and nothing is told to.
    pub fn is_still(&self) -> bool {
        self.ramp.is_still()
    }

    /// Whether nothing moves and nothing will before the next command, not even the watchdog.
    pub fn is_at_rest(&self) -> bool {
        self.ramp.is_at_rest()
    }

    /// Whether a stop is under way.
    pub fn is_stopping(&self) -> bool {
        self.ramp.is_stopping()
    }

    /// Whether the last command ran out and none has come since.
    pub fn halted_by_watchdog(&self) -> bool {
        self.ramp.halted_by_watchdog()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::kinematics::{LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, XArm7};
    use crate::step::STEP_S;
    use crate::velocity::{SMALLEST_SINGULAR_VALUE, joint_velocities, singularity_distance};
    use crate::{STEP_NS, STOP_NS};

    const WIDE: [[f64; 3]; 2] = [[-2000.0; 3], [2000.0; 3]];

    fn settings([workspace_min_mm, workspace_max_mm]: [[f64; 3]; 2]) -> ArmSettings {
        ArmSettings { workspace_min_mm, workspace_max_mm, ..ArmSettings::default() }
    }

    fn push(axis: usize, speed_mm_per_s: f64) -> Twist {
        let mut twist = Twist::ZERO;
        twist.linear_mm_per_s[axis] = speed_mm_per_s;
        twist
    }

    /// Holds a twist for so many steps from rest, and returns the joints (rad) after each. An arm beyond a joint limit
    /// follows as well.
    fn hold(settings: &ArmSettings, start_rad: JointVector, twist: Twist, steps: u64) -> Vec<JointVector> {
        let (model, mut motion) = (XArm7::new(), Motion::new(settings));
        let mut joints_rad = start_rad;
        let step = |step| {
            motion.command(twist, step * STEP_NS).unwrap();
            let velocity = motion.advance(step * STEP_NS, &joints_rad);
            let middle =
                joints_rad + joint_velocities(&model, &joints_rad, &velocity).rad_per_s * (0.5 * STEP_S);
            joints_rad += joint_velocities(&model, &middle, &velocity).rad_per_s * STEP_S;
            joints_rad
        };
        (0..steps).map(step).collect()
    }

    fn position_mm(joints_rad: &JointVector) -> Vector3<f64> {
        XArm7::new().flange_pose_m(joints_rad).translation.vector * 1e3
    }

    #[test]
    fn a_face_of_the_workspace_is_approached_at_the_ordinary_deceleration_and_held() {
        let settings = ArmSettings::default();
        let (model, mut motion) = (XArm7::new(), Motion::new(&settings));
        let mut joints_rad = settings.start_joints_rad();
        let mut speeds = Vec::new();
        for step in 0..1000 {
            motion.command(push(2, 100.0), step * STEP_NS).unwrap();
            let velocity = motion.advance(step * STEP_NS, &joints_rad);
            joints_rad += joint_velocities(&model, &joints_rad, &velocity).rad_per_s * STEP_S;
            speeds.push(velocity.linear_mm_per_s[2]);
        }
        // 3 mm before the face, but for the error of this integration.
        assert!((position_mm(&joints_rad).z - 647.0).abs() < 0.5);
        let braking = speeds.iter().rposition(|&speed| speed > 99.9).unwrap();
        let still = speeds.iter().rposition(|&speed| speed > 0.1).unwrap();
        assert!((70..=90).contains(&(still - braking)), "{} steps", still - braking);
        assert!(speeds[braking..].windows(2).all(|pair| pair[1] <= pair[0] + 1e-2));
        assert!(speeds[still + 30..].iter().all(|&speed| speed.abs() < 1e-9));
    }

    #[test]
    fn an_arm_out_of_the_workspace_moves_back_only() {
        let start_rad = ArmSettings::default().start_joints_rad();
        let start = position_mm(&start_rad);
        // The start is 10 mm above the workspace.
        let settings = settings([[200.0, -400.0, 150.0], [600.0, 400.0, start.z - 10.0]]);
        for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0)] {
            let joints = hold(&settings, start_rad, push(axis, 100.0 * sign), 200);
            assert_eq!(joints[199], start_rad, "axis {axis}, sign {sign}");
        }
        let back = hold(&settings, start_rad, push(2, -100.0), 200);
        assert!((start - position_mm(&back[199])).z > 60.0);
        // From the margin it may also go along the face.
        let inside = *back.iter().find(|joints| position_mm(joints).z < start.z - 10.5).unwrap();
        assert!((position_mm(&hold(&settings, inside, push(1, 100.0), 200)[199]) - start).y > 60.0);
    }

    #[test]
    fn a_push_partly_into_a_wall_slides_along_it_and_says_which_wall() {
        let settings = ArmSettings::default();
        let (model, mut motion) = (XArm7::new(), Motion::new(&settings));
        let mut joints_rad = settings.start_joints_rad();
        let start = position_mm(&joints_rad);
        let push = Twist { linear_mm_per_s: [0.0, 25.0, 75.0], ..Twist::ZERO };
        let mut velocity = Twist::ZERO;
        for step in 0..1750 {
            motion.command(push, step * STEP_NS).unwrap();
            velocity = motion.advance(step * STEP_NS, &joints_rad);
            joints_rad += joint_velocities(&model, &joints_rad, &velocity).rad_per_s * STEP_S;
        }
        let way = position_mm(&joints_rad) - start;
        assert!((way.z - (647.0 - start.z)).abs() < 1.0, "{way}");
        assert!(way.y > 150.0, "{way}");
        assert!(velocity.linear_mm_per_s[1] > 24.0, "{velocity:?}");
        assert_eq!(motion.obstacle(), Some(Obstacle::WorkspaceFace { axis: 2, is_upper: true }));
        motion.command(Twist::ZERO, 1750 * STEP_NS).unwrap();
        motion.advance(1750 * STEP_NS, &joints_rad);
        assert_eq!(motion.obstacle(), None);
    }

    #[test]
    fn narrower_joint_limits_are_kept() {
        let settings = settings(WIDE);
        let narrow = JointVector::from([0.0, 0.0, 0.0, -0.104_72, 0.0, 0.0, 0.0]);
        let mut limits = JointLimits::default();
        limits.lower_rad[3] = narrow[3];
        let (model, mut motion) = (XArm7::new(), Motion::new(&settings));
        motion.set_joint_limits(limits);
        let mut joints_rad = settings.start_joints_rad();
        joints_rad[3] = 0.15;
        joints_rad[5] = 1.2;
        let mut lowest = joints_rad[3];
        for step in 0..3000 {
            motion.command(push(0, 50.0), step * STEP_NS).unwrap();
            let velocity = motion.advance(step * STEP_NS, &joints_rad);
            joints_rad += joint_velocities(&model, &joints_rad, &velocity).rad_per_s * STEP_S;
            lowest = lowest.min(joints_rad[3]);
        }
        assert!(lowest >= narrow[3], "{lowest}");
    }

    #[test]
    fn an_arm_beyond_a_joint_limit_moves_back_only() {
        let mut beyond = ArmSettings::default().start_joints_rad();
        beyond[5] = UPPER_LIMITS_RAD[5] + 0.005;
        let mut moved_back = false;
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let joints = hold(&settings(WIDE), beyond, push(axis, 50.0 * sign), 100);
                assert!(joints.iter().all(|joints| joints[5] <= beyond[5] + 1e-9));
                moved_back |= joints[99][5] < UPPER_LIMITS_RAD[5];
            }
        }
        assert!(moved_back);
        let mut below = ArmSettings::default().start_joints_rad();
        below[3] = LOWER_LIMITS_RAD[3] - 0.005;
        let outward = hold(&settings(WIDE), below, push(2, -50.0), 100);
        assert!(outward.iter().all(|joints| joints[3] >= below[3] - 1e-9));
    }

    #[test]
    fn an_arm_in_a_singularity_can_be_driven_out() {
        let zero = JointVector::zeros();
        let out =
            [0, 1, 2].into_iter().flat_map(|axis| [(axis, 50.0), (axis, -50.0)]).any(|(axis, speed)| {
                let joints = hold(&settings(WIDE), zero, push(axis, speed), 1000);
                singularity_distance(&XArm7::new(), &joints[999]) > SMALLEST_SINGULAR_VALUE
            });
        assert!(out);
    }

    #[test]
    fn what_is_foreseen_lies_between_two_steps() {
        let settings = ArmSettings::default();
        let (mut motion, joints_rad) = (Motion::new(&settings), settings.start_joints_rad());
        for step in 0..40 {
            motion.command(push(1, if step < 20 { 100.0 } else { -100.0 }), step * STEP_NS).unwrap();
            let before = motion.velocity().linear_mm_per_s[1];
            let foreseen = [0.0, 0.25, 1.0].map(|share| motion.foresee(step * STEP_NS, &joints_rad, share));
            let after = motion.advance(step * STEP_NS, &joints_rad).linear_mm_per_s[1];
            let expected = [before, 0.75 * before + 0.25 * after, after];
            for (foreseen, expected) in foreseen.iter().zip(expected) {
                assert!((foreseen.linear_mm_per_s[1] - expected).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn joints_that_are_not_finite_are_a_reason_to_brake() {
        let settings = ArmSettings::default();
        let mut motion = Motion::new(&settings);
        for step in 0..50 {
            motion.command(push(1, 100.0), step * STEP_NS).unwrap();
            motion.advance(step * STEP_NS, &settings.start_joints_rad());
        }
        let mut unknown = settings.start_joints_rad();
        unknown[2] = f64::NAN;
        for step in 50..150 {
            motion.command(push(1, 100.0), step * STEP_NS).unwrap();
            motion.advance(step * STEP_NS, &unknown);
        }
        assert_eq!(motion.velocity(), Twist::ZERO);
        assert!(!motion.is_still() && !motion.is_at_rest());
    }

    #[test]
    fn a_stop_and_a_halt_forget_the_command() {
        let settings = ArmSettings::default();
        let mut motion = Motion::new(&settings);
        let joints_rad = settings.start_joints_rad();
        motion.command(push(1, 100.0), 0).unwrap();
        (0..30).for_each(|step| _ = motion.advance(step * STEP_NS, &joints_rad));
        let mut halted = motion.clone();
        halted.halt();
        assert!(halted.is_at_rest() && halted.velocity() == Twist::ZERO);
        motion.stop();
        assert!(motion.is_stopping() && !motion.is_still());
        (30..30 + STOP_NS / STEP_NS).for_each(|step| _ = motion.advance(step * STEP_NS, &joints_rad));
        assert!(motion.is_at_rest() && !motion.halted_by_watchdog());
    }
}
