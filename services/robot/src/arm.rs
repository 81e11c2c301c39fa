//! The seam between the robot service and the arm it moves: simulated here, over the network in [`crate::xarm`].

use tendon_arm::{ArmState, GripperCommand, NonFiniteTwist, SimulatedArm, Twist};
use tendon_messages::StopReason;

/// Why the arm may not go on, with the error code of its controller or 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    pub reason: StopReason,
    pub fault_code: u8,
}

impl Stop {
    pub fn because(reason: StopReason) -> Stop {
        Stop { reason, fault_code: 0 }
    }
}

/// An arm. Times are those of the session's clock in ns.
pub trait Arm {
    /// What a user may want to know of it.
    fn description(&self) -> String;

    /// Whether it stands at its start position, or was armed again, and follows commands.
    fn is_ready(&self) -> bool;

    /// Lets the time up to `now_ns` pass.
    ///
    /// # Errors
    ///
    /// [`Stop`] if the arm has stopped by itself or cannot be relied upon any more.
    fn tick(&mut self, now_ns: u64) -> Result<(), Stop>;

    /// Follows this twist until the watchdog or another command; one that is not finite is taken as rest.
    ///
    /// # Errors
    ///
    /// [`NonFiniteTwist`] names the component.
    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist>;

    /// How long the newest command took from its receipt to the bytes given to the network, ns; once for each that set an
    /// arm on a network in motion or kept it there.
    fn command_to_wire_ns(&mut self) -> Option<u64>;

    /// Sets the gripper moving and returns at once.
    fn command_gripper(&mut self, command: GripperCommand, now_ns: u64);

    /// Comes to rest as quickly as is smooth, and goes on with the next command.
    fn rest(&mut self);

    /// Stops as quickly as the arm can, ahead of everything that was ordered before, until [`Arm::rearm`].
    fn stop(&mut self);

    /// Takes over that the arm has come to rest by itself because nobody ordered anything.
    fn stalled(&mut self);

    /// Gets ready again after a [`Arm::stop`] or what stopped it; [`Arm::is_ready`] tells.
    fn rearm(&mut self, now_ns: u64);

    /// Whether nothing moves and nothing is told to.
    fn is_still(&self) -> bool;

    /// Where it is.
    fn state(&self) -> ArmState;
}

impl Arm for SimulatedArm {
    fn description(&self) -> String {
        "simulated xArm7".to_owned()
    }

    fn is_ready(&self) -> bool {
        true
    }

    fn tick(&mut self, now_ns: u64) -> Result<(), Stop> {
        SimulatedArm::tick(self, now_ns);
        Ok(())
    }

    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        SimulatedArm::command(self, twist, now_ns)
    }

    fn command_to_wire_ns(&mut self) -> Option<u64> {
        None
    }

    fn command_gripper(&mut self, command: GripperCommand, now_ns: u64) {
        SimulatedArm::command_gripper(self, command, now_ns);
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

    fn rearm(&mut self, _now_ns: u64) {}

    fn is_still(&self) -> bool {
        SimulatedArm::is_still(self)
    }

    fn state(&self) -> ArmState {
        SimulatedArm::state(self)
    }
}
