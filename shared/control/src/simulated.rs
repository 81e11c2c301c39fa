//! The simulated arm behind the seam: always there, always up, and always at its start position at first.

use tendon_arm::{JointLimits, JointVector, NonFiniteTwist, SimulatedArm, Twist};

use crate::arm::{Arm, ArmReport, Drive, Link};

impl Arm for SimulatedArm {
    fn description(&self) -> String {
        "simulated xArm7".to_owned()
    }

    fn key(&self) -> &str {
        "simulated xArm7"
    }

    fn explanation(&self) -> Option<String> {
        None
    }

    fn joint_limits(&self) -> JointLimits {
        JointLimits::default()
    }

    fn tick(&mut self, now_ns: u64) {
        SimulatedArm::tick(self, now_ns);
    }

    fn report(&self) -> ArmReport {
        let state = self.state();
        ArmReport {
            link: Link::Up(Drive::Flange),
            joints_rad: Some(state.joints_rad.into()),
            speed_mm_per_s: state.linear_speed_mm_per_s,
            gripper_pulses: Some(state.gripper_position_pulses),
            is_gripper_moving: self.is_gripper_moving(),
            told: self.motion().velocity(),
            halted_by_watchdog: state.halted_by_watchdog,
            obstacle: self.motion().obstacle(),
            ..ArmReport::default()
        }
    }

    fn bring_up(&mut self, _drive: Drive, _acknowledges_error: bool, _now_ns: u64) {}

    fn follow_joints(&mut self, _velocities_rad_per_s: &JointVector) {}

    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        SimulatedArm::command(self, twist, now_ns)
    }

    fn command_to_wire_ns(&mut self) -> Option<u64> {
        None
    }

    fn move_gripper(&mut self, pulses: f64, now_ns: u64) {
        SimulatedArm::move_gripper(self, pulses, now_ns);
    }

    fn rest(&mut self) {
        SimulatedArm::rest(self);
    }

    fn stop(&mut self) {
        SimulatedArm::stop(self);
    }

    fn stalled(&mut self) {
        self.halt();
    }

    fn is_still(&self) -> bool {
        SimulatedArm::is_still(self)
    }
}
