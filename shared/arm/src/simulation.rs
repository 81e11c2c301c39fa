//! The kinematic simulated arm: follows velocities exactly, without mass or friction.
//!
//! Time is given from outside. It advances in steps of 4 ms (250 Hz, the rate of the vendor's controller); the
//! state is that at the end of the last whole step, however often or seldom [`SimulatedArm::tick`] is
//! called. The same calls give the same motion every time.

use crate::kinematics::{JointVector, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, XArm7};
use crate::step::STEP_S;
use crate::velocity::joint_velocities;
use crate::{ArmSettings, ArmSettingsError, Motion, NonFiniteTwist, STEP_NS, Twist};

/// What an arm reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmState {
    /// Joint angles in rad, joint 1 first.
    pub joints_rad: [f64; 7],
    /// Position of the flange in the base frame in mm.
    pub position_mm: [f64; 3],
    /// Orientation of the flange in the base frame as roll, pitch, yaw in rad by the vendor's convention:
    /// R = Rz(yaw) · Ry(pitch) · Rx(roll).
    pub orientation_rpy_rad: [f64; 3],
    /// Linear speed of the flange in mm/s.
    pub linear_speed_mm_per_s: f64,
    /// Position of the gripper in pulses, about −10 (closed) to 850 (open).
    pub gripper_position_pulses: f64,
    /// Whether the last command ran out (see [`ArmSettings::watchdog_ms`]) and none has come since.
    pub halted_by_watchdog: bool,
}

/// A simulated xArm7 with a gripper.
#[derive(Clone, Debug)]
pub struct SimulatedArm {
    arm: XArm7,
    settings: ArmSettings,
    motion: Motion,
    joints_rad: JointVector,
    gripper_pulses: f64,
    gripper_target_pulses: f64,
    /// Velocity of the flange in the last step.
    velocity: Twist,
    /// The end of the last step.
    now_ns: u64,
}

impl SimulatedArm {
    /// The arm at rest in the start posture of the settings, its gripper open, at the time `now_ns`.
    ///
    /// # Errors
    /// [`ArmSettingsError`] names the setting that no arm can follow.
    pub fn new(settings: ArmSettings, now_ns: u64) -> Result<SimulatedArm, ArmSettingsError> {
        settings.check()?;
        Ok(SimulatedArm {
            arm: XArm7::new(),
            motion: Motion::new(&settings),
            joints_rad: settings.start_joints_rad(),
            gripper_pulses: settings.gripper_open_pulses,
            gripper_target_pulses: settings.gripper_open_pulses,
            velocity: Twist::ZERO,
            settings,
            now_ns,
        })
    }

    /// Lets the time up to `now_ns` pass, then takes this twist as [`Motion::command`] does.
    ///
    /// # Errors
    /// A twist that is not finite is taken as [`Twist::ZERO`]; [`NonFiniteTwist`] names the component.
    pub fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        self.tick(now_ns);
        self.motion.command(twist, now_ns)
    }

    /// Lets the time up to `now_ns` pass, then sets the gripper moving to this position in pulses and returns at once.
    /// It goes to the end whatever becomes of the arm's commands, except for a [`SimulatedArm::stop`] or
    /// [`SimulatedArm::halt`]: a watchdog that stopped it would drop what it is about to hold.
    pub fn move_gripper(&mut self, pulses: f64, now_ns: u64) {
        self.tick(now_ns);
        self.gripper_target_pulses = pulses;
    }

    /// Brings the arm to rest as [`SimulatedArm::stop`] does; the gripper goes on.
    pub fn rest(&mut self) {
        self.motion.stop();
    }

    /// Stops the arm as [`Motion::stop`] does and the gripper where it is, until the next command.
    pub fn stop(&mut self) {
        self.motion.stop();
        self.gripper_target_pulses = self.gripper_pulses;
    }

    /// Stops arm and gripper where they are, at once and without a ramp, until the next command.
    pub fn halt(&mut self) {
        self.motion.halt();
        self.velocity = Twist::ZERO;
        self.gripper_target_pulses = self.gripper_pulses;
    }

    /// Takes all steps that end by `now_ns`. A time before the last step changes nothing.
    pub fn tick(&mut self, now_ns: u64) {
        while now_ns.saturating_sub(self.now_ns) >= STEP_NS {
            if self.motion.is_at_rest() && self.gripper_pulses == self.gripper_target_pulses {
                // Nothing moves: pass over the steps, however long the caller was away.
                self.now_ns += (now_ns - self.now_ns) / STEP_NS * STEP_NS;
            } else {
                self.step();
            }
        }
    }

    /// Whether the gripper is on its way.
    pub fn is_gripper_moving(&self) -> bool {
        self.gripper_pulses != self.gripper_target_pulses
    }

    /// Whether nothing moves and nothing is told to.
    pub fn is_still(&self) -> bool {
        self.motion.is_still() && self.gripper_pulses == self.gripper_target_pulses
    }

    /// Takes one step of [`STEP_NS`].
    pub fn step(&mut self) {
        let twist = self.motion.advance(self.now_ns, &self.joints_rad);
        self.velocity = if twist == Twist::ZERO { twist } else { self.move_joints(&twist) };
        let travel = self.settings.gripper_speed_pulses_per_s * STEP_S;
        let left = self.gripper_target_pulses - self.gripper_pulses;
        if left.abs() <= travel {
            self.gripper_pulses = self.gripper_target_pulses;
        } else {
            self.gripper_pulses += travel.copysign(left);
        }
        self.now_ns += STEP_NS;
    }

    /// Turns the joints for one step and returns the velocity that they could follow.
    fn move_joints(&mut self, twist: &Twist) -> Twist {
        // Midpoint rule: its error a step is of third order, so that orientation does not drift in hours of use.
        let begin = joint_velocities(&self.arm, &self.joints_rad, twist);
        let middle_rad = self.joints_rad + begin.rad_per_s * (0.5 * STEP_S);
        let middle = joint_velocities(&self.arm, &middle_rad, twist);
        // The limits held at the midpoint, the end of the step may be a rounding beyond.
        self.joints_rad =
            (self.joints_rad + middle.rad_per_s * STEP_S).sup(&LOWER_LIMITS_RAD).inf(&UPPER_LIMITS_RAD);
        twist.scaled(middle.scale)
    }

    /// What the arm is told to do.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Velocity of the flange in the last step.
    pub fn velocity(&self) -> Twist {
        self.velocity
    }

    /// The state at the end of the last step.
    pub fn state(&self) -> ArmState {
        let pose = self.arm.flange_pose_m(&self.joints_rad);
        let (roll, pitch, yaw) = pose.rotation.euler_angles();
        ArmState {
            joints_rad: self.joints_rad.into(),
            position_mm: (pose.translation.vector * 1e3).into(),
            orientation_rpy_rad: [roll, pitch, yaw],
            linear_speed_mm_per_s: self.velocity.linear_speed_mm_per_s(),
            gripper_position_pulses: self.gripper_pulses,
            halted_by_watchdog: self.motion.halted_by_watchdog(),
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};
    use proptest::prelude::*;

    use super::*;
    use crate::velocity::smallest_singular_value;

    const MS: u64 = 1_000_000;

    fn arm() -> SimulatedArm {
        SimulatedArm::new(ArmSettings::default(), 0).unwrap()
    }

    fn linear(x: f64, y: f64, z: f64) -> Twist {
        Twist { linear_mm_per_s: [x, y, z], ..Twist::ZERO }
    }

    /// Commands the twist every 20 ms for this long.
    fn hold(arm: &mut SimulatedArm, twist: Twist, duration_ms: u64) {
        let begin_ns = arm.now_ns;
        for elapsed_ms in (0..duration_ms).step_by(20) {
            arm.command(twist, begin_ns + elapsed_ms * MS).unwrap();
        }
        arm.tick(begin_ns + duration_ms * MS);
    }

    /// Lets the arm ramp down and returns how far its position is from another, in mm.
    fn rest_away_from(arm: &mut SimulatedArm, position_mm: [f64; 3]) -> Vector3<f64> {
        hold(arm, Twist::ZERO, 304);
        assert_eq!(arm.state().linear_speed_mm_per_s, 0.0);
        Vector3::from(arm.state().position_mm) - Vector3::from(position_mm)
    }

    #[test]
    fn the_start_posture_is_the_documented_one() {
        let state = arm().state();
        assert!((Vector3::from(state.position_mm) - Vector3::new(386.0, 0.0, 362.0)).amax() < 0.5);
        let [roll, pitch, yaw] = state.orientation_rpy_rad;
        assert!((roll.abs() - std::f64::consts::PI).abs() < 1e-9 && pitch.abs() < 1e-9 && yaw.abs() < 1e-9);
    }

    #[test]
    fn the_orientation_follows_the_vendors_convention() {
        let mut arm = arm();
        let twist = Twist { angular_rad_per_s: [0.3, 0.2, 0.1], ..Twist::ZERO };
        hold(&mut arm, twist, 1000);
        let [roll, pitch, yaw] = arm.state().orientation_rpy_rad;
        let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
        let rotation =
            about(Vector3::z_axis(), yaw) * about(Vector3::y_axis(), pitch) * about(Vector3::x_axis(), roll);
        let pose = arm.arm.flange_pose_m(&arm.joints_rad);
        assert!(rotation.angle_to(&pose.rotation.to_rotation_matrix()) < 1e-7);
        assert!(roll.abs() > 0.01 && pitch.abs() > 0.01 && yaw.abs() > 0.01);
    }

    #[test]
    fn there_are_200_mm_of_straight_way_along_y_and_z() {
        for direction in [linear(0.0, 100.0, 0.0), linear(0.0, 0.0, 100.0)] {
            for sign in [1.0, -1.0] {
                let mut arm = arm();
                let (start, wanted) =
                    (arm.state().position_mm, Vector3::from(direction.linear_mm_per_s) * sign);
                hold(&mut arm, direction.scaled(sign), 2000);
                // Ramps up and down are alike: the way is that of 2 s at full speed.
                let away = rest_away_from(&mut arm, start);
                assert!((away - wanted * 2.0).amax() < 1e-2, "{away}");
                assert!(smallest_singular_value(&arm.arm, &arm.joints_rad) > 0.16);
                let room = (UPPER_LIMITS_RAD - arm.joints_rad).inf(&(arm.joints_rad - LOWER_LIMITS_RAD));
                assert!(room.min() > 25_f64.to_radians());
                hold(&mut arm, direction.scaled(-sign), 2000);
                assert!(rest_away_from(&mut arm, start).amax() < 1e-2);
                let down = arm.arm.flange_pose_m(&arm.joints_rad).rotation * Vector3::z();
                assert!((down + Vector3::z()).amax() < 1e-6, "{down}");
            }
        }
    }

    #[test]
    fn at_the_edge_of_the_workspace_the_arm_stops_and_comes_back() {
        for outward in [linear(100.0, 0.0, 0.0), linear(0.0, 100.0, 0.0), linear(0.0, 0.0, 100.0)] {
            for sign in [1.0, -1.0] {
                let mut arm = arm();
                hold(&mut arm, outward.scaled(sign), 20_000);
                let edge = arm.state();
                assert!(edge.linear_speed_mm_per_s < 1e-3, "{edge:?}");
                hold(&mut arm, outward.scaled(-sign), 1500);
                let back = Vector3::from(arm.state().position_mm) - Vector3::from(edge.position_mm);
                let inward = -Vector3::from(outward.linear_mm_per_s) * sign / 100.0;
                assert!(back.dot(&inward) > 100.0, "{back}");
            }
        }
    }

    #[test]
    fn without_motion_commanded_nothing_drifts() {
        let mut arm = arm();
        hold(&mut arm, linear(40.0, 30.0, -20.0), 1000);
        hold(&mut arm, Twist::ZERO, 500);
        let still = arm.state();
        hold(&mut arm, Twist::ZERO, 60_000);
        assert_eq!(arm.state(), still);
    }

    #[test]
    fn a_halt_stops_arm_and_gripper_at_once_until_the_next_command() {
        let mut arm = arm();
        arm.move_gripper(-10.0, 0);
        hold(&mut arm, linear(100.0, 0.0, 0.0), 300);
        assert!(arm.state().linear_speed_mm_per_s > 99.0);
        arm.halt();
        let halted = arm.state();
        assert_eq!(halted.linear_speed_mm_per_s, 0.0);
        arm.tick(2000 * MS);
        assert_eq!(arm.state(), halted);
        arm.command(linear(100.0, 0.0, 0.0), 2000 * MS).unwrap();
        arm.tick(2120 * MS);
        assert!(arm.state().linear_speed_mm_per_s > 30.0);
    }

    #[test]
    fn a_stop_takes_80_ms_and_keeps_the_gripper_where_it_is() {
        let mut arm = arm();
        hold(&mut arm, linear(0.0, 100.0, 0.0), 400);
        arm.move_gripper(-10.0, 400 * MS);
        arm.tick(440 * MS);
        assert!(arm.state().linear_speed_mm_per_s > 99.0);
        arm.stop();
        arm.tick(512 * MS);
        assert!(arm.state().linear_speed_mm_per_s > 0.0);
        arm.tick(520 * MS);
        assert_eq!(arm.state().linear_speed_mm_per_s, 0.0);
        assert!(arm.is_still() && !arm.state().halted_by_watchdog);
        assert!((arm.state().gripper_position_pulses - 790.0).abs() < 1e-9);
    }

    #[test]
    fn a_twist_that_is_not_finite_is_a_stop() {
        let mut arm = arm();
        hold(&mut arm, linear(0.0, 100.0, 0.0), 300);
        assert!(arm.command(linear(f64::NAN, 100.0, 0.0), 300 * MS).is_err());
        // The watchdog's time, the stop's, and a step.
        arm.tick(534 * MS);
        let state = arm.state();
        assert_eq!(state.linear_speed_mm_per_s, 0.0);
        assert!(state.joints_rad.iter().all(|angle| angle.is_finite()));
    }

    #[test]
    fn the_gripper_travels_at_its_speed_and_to_its_end() {
        let mut arm = arm();
        assert_eq!(arm.state().gripper_position_pulses, 850.0);
        arm.move_gripper(-10.0, 0);
        arm.tick(200 * MS);
        assert!((arm.state().gripper_position_pulses - 550.0).abs() < 1e-9);
        arm.tick(1000 * MS);
        assert_eq!(arm.state().gripper_position_pulses, -10.0);
        arm.move_gripper(850.0, 1000 * MS);
        arm.tick(1100 * MS);
        assert!((arm.state().gripper_position_pulses - 140.0).abs() < 1e-9);
    }

    #[test]
    fn years_of_silence_pass_in_no_time_and_keep_the_rhythm_of_steps() {
        let mut arm = arm();
        arm.tick(u64::MAX);
        assert!(u64::MAX - arm.now_ns < STEP_NS && arm.now_ns.is_multiple_of(STEP_NS));
        arm.tick(0);
        assert_eq!(arm.joints_rad, ArmSettings::default().start_joints_rad());
    }

    proptest! {
        #[test]
        fn how_often_it_is_ticked_makes_no_difference(ticks in prop::collection::vec(0..700 * MS, 0..20)) {
            let mut seldom = arm();
            seldom.command(linear(0.0, 60.0, 30.0), MS).unwrap();
            let mut often = seldom.clone();
            let mut ticks = ticks;
            ticks.sort_unstable();
            ticks.into_iter().for_each(|now_ns| often.tick(now_ns));
            often.tick(700 * MS);
            seldom.tick(700 * MS);
            prop_assert_eq!(often.state(), seldom.state());
        }
    }
}
