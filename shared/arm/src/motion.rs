//! From commands to a velocity that an arm can follow without leaving its limits.

use crate::limits::Limits;
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
        self.ramp
            .advance(now_ns, |run_down| here.as_ref().is_some_and(|here| here.permit(run_down.velocities())))
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
