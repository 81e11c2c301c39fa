//! The seam between what decides and the arm that moves, simulated or on a network.

use tendon_arm::{JointLimits, JointVector, NonFiniteTwist, Obstacle, Twist};
use tendon_messages::StopReason;

/// Why the arm may not go on, with the error code of its controller or 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    /// The reason.
    pub reason: StopReason,
    /// With [`StopReason::ArmFault`], the error code of the arm's controller; else 0.
    pub fault_code: u8,
}

impl Stop {
    /// A stop that is no error of the arm's controller.
    pub fn because(reason: StopReason) -> Stop {
        Stop { reason, fault_code: 0 }
    }

    /// A stop by an error of the arm's controller.
    pub fn by_fault(fault_code: u8) -> Stop {
        Stop { reason: StopReason::ArmFault, fault_code }
    }
}

/// What kind of velocities an arm follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drive {
    /// Those of its joints.
    Joints,
    /// Those of its flange.
    Flange,
}

/// How far an arm is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Link {
    /// There is no connection, or it is not known yet what is there.
    #[default]
    Connecting,
    /// It is known, and follows nothing before [`Arm::bring_up`].
    Connected,
    /// It is being brought up.
    BringingUp,
    /// It follows velocities.
    Up(Drive),
}

/// What an arm says of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmReport {
    /// How far it is.
    pub link: Link,
    /// Why it is not up any more, or could not be brought up. `None` from [`Arm::bring_up`] on until then.
    pub stop: Option<Stop>,
    /// The error of its controller that nobody has acknowledged.
    pub error_code: Option<u8>,
    /// Its joint angles in rad; `None` before the first report.
    pub joints_rad: Option<JointVector>,
    /// For how long it has given no sign of life, ns.
    pub silent_ns: u64,
    /// How long ago the report of the joint angles came, ns.
    pub report_age_ns: u64,
    /// Speed of the flange in mm/s.
    pub speed_mm_per_s: f64,
    /// Whether it says that it is stopped and follows no velocities.
    pub is_stopped: bool,
    /// Position of the gripper in pulses; `None` without a gripper and before it has told.
    pub gripper_pulses: Option<f64>,
    /// Whether the gripper's fingers move.
    pub is_gripper_moving: bool,
    /// The velocity of the flange that it was last told, unless it follows those of joints.
    pub told: Twist,
    /// Whether the last command ran out and none has come since.
    pub halted_by_watchdog: bool,
    /// What keeps it from following the last command in full.
    pub obstacle: Option<Obstacle>,
}

/// An arm. Times are those of the session's clock in ns.
pub trait Arm {
    /// What a user may want to know of it.
    fn description(&self) -> String;

    /// By what it is told apart from other arms.
    fn key(&self) -> &str;

    /// Why it stopped, or cannot be reached, in its own words.
    fn explanation(&self) -> Option<String>;

    /// The limits of its joints, known once it is [`Link::Connected`].
    fn joint_limits(&self) -> JointLimits;

    /// Lets the time up to `now_ns` pass.
    fn tick(&mut self, now_ns: u64);

    /// What it says of itself.
    fn report(&self) -> ArmReport;

    /// Begins to bring it up. An error of its controller is cleared only if somebody has acknowledged it, else it is a
    /// reason not to come up.
    fn bring_up(&mut self, drive: Drive, acknowledges_error: bool, now_ns: u64);

    /// Moves its joints at these velocities in rad/s until the next, or until they run out.
    fn follow_joints(&mut self, velocities_rad_per_s: &JointVector);

    /// Follows this twist until the watchdog or another command; one that is not finite is taken as rest.
    ///
    /// # Errors
    ///
    /// [`NonFiniteTwist`] names the component.
    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist>;

    /// How long the newest command took from its receipt to the bytes given to the network, ns; once for each that set
    /// an arm on a network in motion or kept it there.
    fn command_to_wire_ns(&mut self) -> Option<u64>;

    /// Sets the gripper moving to this position in pulses and returns at once.
    fn move_gripper(&mut self, pulses: f64, now_ns: u64);

    /// Comes to rest as quickly as is smooth, and goes on with the next command.
    fn rest(&mut self);

    /// Stops arm and gripper as quickly as they can, ahead of everything that was ordered before, until
    /// [`Arm::bring_up`].
    fn stop(&mut self);

    /// Takes over that the arm has come to rest by itself because nobody ordered anything.
    fn stalled(&mut self);

    /// Whether nothing moves and nothing is told to.
    fn is_still(&self) -> bool;
}
