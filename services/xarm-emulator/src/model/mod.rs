//! The emulated arm: its rules of mode and state, its motion in steps of 4 ms, its gripper.
//!
//! ```text
//!           enable            set mode                set state 0
//! off ───────────────▶ on ───────────────▶ changed ───────────────▶ ready ◀─▶ running
//!  ▲                    ▲                  (state 5)                 │ error, stop: state 4
//!  └─ emergency stop ───┴────────────────────────────────────────────┘ an error also: mode 0
//! ```
//!
//! The caller passes the time in ns, so the same orders give the same motion. Unlike the simulated arm of `tendon-arm`,
//! it does not slow down before its limits: like the real arm, it runs into them and reports the error.

mod gripper;
mod motion;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector6};
use tendon_arm::{ArmSettings, JointVector, XArm7};
use tendon_xarm::report::{Health, Report};
use tendon_xarm::{ArmState, JointLimits, Mode, StateOrder, TwistFrame};

pub use self::gripper::Gripper;
use crate::Properties;

/// Length of a step, ns.
pub const STEP_NS: u64 = 4_000_000;
const STEP_S: f64 = STEP_NS as f64 * 1e-9;

/// Motion commands are ignored for this long after a change of mode or state, ns.
pub const SETTLING_NS: u64 = 100_000_000;

/// Greatest linear acceleration of the flange, mm/s².
pub const LINEAR_ACCELERATION_MM_PER_S2: f64 = 2000.0;
/// Greatest angular acceleration of the flange, rad/s².
pub const ANGULAR_ACCELERATION_RAD_PER_S2: f64 = 10.0;
/// Greatest acceleration of a joint, rad/s².
pub const JOINT_ACCELERATION_RAD_PER_S2: f64 = 20.0;

/// Error codes that the model raises by itself.
pub mod code {
    /// Emergency stop button.
    pub const EMERGENCY_STOP: u8 = 1;
    /// Joint limit.
    pub const JOINT_LIMIT: u8 = 23;
    /// Speed.
    pub const SPEED: u8 = 24;
    /// Collision.
    pub const COLLISION: u8 = 31;
    /// Safety boundary.
    pub const BOUNDARY: u8 = 35;
}

/// No joint limits, for an arm whose serial number cannot be read.
const NO_LIMITS: JointLimits = JointLimits { lower_rad: [f64::MIN; 7], upper_rad: [f64::MAX; 7] };

/// The motion that was ordered.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Target {
    Rest,
    Flange { twist: Vector6<f64>, frame: TwistFrame },
    Joints(JointVector),
}

/// Whether an order was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// Accepted.
    Yes,
    /// Refused: the order is invalid in the present state.
    Invalid,
}

/// The emulated arm.
#[derive(Clone, Debug)]
pub struct Model {
    arm: XArm7,
    properties: Properties,
    joint_limits: JointLimits,
    /// From the flange to the tip of the tool, m.
    tcp_offset_m: Isometry3<f64>,
    time_ns: u64,
    joints_rad: JointVector,
    /// Flange velocity in the base frame, mm/s and rad/s, in mode 5.
    flange_velocity: Vector6<f64>,
    joint_velocities_rad_per_s: JointVector,
    target: Target,
    /// Orders are ignored until the arm is stopped.
    runs_away: bool,
    /// How fast the flange creeps along y at commanded rest, mm/s.
    creep_mm_per_s: f64,
    /// Number of velocities still to be refused.
    refused_velocities: u32,
    /// When the target becomes rest.
    deadline_ns: Option<u64>,
    settled_at_ns: u64,
    motors_on: [bool; 7],
    mode: Mode,
    stopped: Option<ArmState>,
    emergency_stop_pressed: bool,
    error: u8,
    warning: u8,
    gripper: Gripper,
    reduced_speed_mm_per_s: f64,
    is_reduced: bool,
    /// Highest and lowest x, y, z, mm.
    boundary_mm: [i32; 6],
    fence_on: bool,
}

impl Model {
    /// An arm just switched on, at the default start posture of Tendon, with its gripper open.
    pub fn new(properties: Properties, now_ns: u64) -> Model {
        // An arm with an unreadable version gets the limits of the default one.
        let identity = properties.identity().or_else(|| Properties::default().identity());
        let [x, y, z, roll, pitch, yaw] = properties.setup.tcp_offset.map(f64::from);
        Model {
            arm: XArm7::new(),
            joint_limits: identity.map_or(NO_LIMITS, |identity| identity.joint_limits()),
            tcp_offset_m: Isometry3::from_parts(
                Translation3::new(x * 1e-3, y * 1e-3, z * 1e-3),
                UnitQuaternion::from_euler_angles(roll, pitch, yaw),
            ),
            properties,
            time_ns: now_ns,
            joints_rad: ArmSettings::default().start_joints_rad(),
            flange_velocity: Vector6::zeros(),
            joint_velocities_rad_per_s: JointVector::zeros(),
            target: Target::Rest,
            runs_away: false,
            creep_mm_per_s: 0.0,
            refused_velocities: 0,
            deadline_ns: None,
            settled_at_ns: now_ns,
            motors_on: [false; 7],
            mode: Mode::Position,
            stopped: Some(ArmState::Stopped),
            emergency_stop_pressed: false,
            error: 0,
            warning: 0,
            gripper: Gripper::new(),
            reduced_speed_mm_per_s: 100.0,
            is_reduced: false,
            boundary_mm: [10_000, -10_000, 10_000, -10_000, 10_000, -10_000],
            fence_on: false,
        }
    }

    /// Advances the model to this time, in whole steps.
    pub fn advance_to(&mut self, now_ns: u64) {
        while self.time_ns + STEP_NS <= now_ns {
            if self.is_still() {
                // Nothing changes before the next order.
                self.time_ns += (now_ns - self.time_ns) / STEP_NS * STEP_NS;
                return;
            }
            self.time_ns += STEP_NS;
            self.step();
        }
    }

    /// Which arm this is.
    pub fn properties(&self) -> &Properties {
        &self.properties
    }

    /// Switches the motor of an axis (1 to 7, 8 all) on or off.
    pub fn enable(&mut self, axis: u8, on: bool) -> Taken {
        if on && self.emergency_stop_pressed {
            return Taken::Invalid;
        }
        match axis {
            1..=7 => self.motors_on[usize::from(axis) - 1] = on,
            _ => self.motors_on = [on; 7],
        }
        if !on {
            self.halt(ArmState::Stopped);
        }
        Taken::Yes
    }

    /// Changes the mode: the arm is at rest and must be set running again.
    pub fn set_mode(&mut self, mode: Mode) -> Taken {
        if self.mode != mode || self.stopped.is_some() {
            self.mode = mode;
            self.halt(ArmState::ConfigurationChanged);
        }
        self.settle();
        Taken::Yes
    }

    /// Runs, pauses or stops the arm.
    pub fn set_state(&mut self, order: StateOrder) -> Taken {
        match order {
            StateOrder::Run if self.error != 0 || !self.motors_on.iter().all(|&on| on) => {
                return Taken::Invalid;
            }
            StateOrder::Run => {
                self.stopped = None;
                self.settle();
            }
            StateOrder::Pause => {
                self.rest();
                self.stopped = Some(ArmState::Paused);
            }
            StateOrder::Stop => self.halt(ArmState::Stopped),
            // The speed goes down as its acceleration allows, see `step`.
            StateOrder::SlowAndStop => {
                self.rest();
                self.stopped = Some(ArmState::Stopped);
            }
        }
        Taken::Yes
    }

    /// Sets the flange velocity: mm/s, rad/s.
    pub fn set_flange_velocity(
        &mut self,
        twist: [f32; 6],
        frame: TwistFrame,
        duration_s: Option<f32>,
    ) -> Taken {
        let twist = Vector6::from(twist.map(f64::from));
        self.follow(Mode::CartesianVelocity, Target::Flange { twist, frame }, duration_s)
    }

    /// Sets the joint velocities, rad/s.
    pub fn set_joint_velocities(&mut self, velocities_rad_per_s: [f32; 7], duration_s: Option<f32>) -> Taken {
        let target = Target::Joints(JointVector::from(velocities_rad_per_s.map(f64::from)));
        self.follow(Mode::JointVelocity, target, duration_s)
    }

    fn follow(&mut self, mode: Mode, target: Target, duration_s: Option<f32>) -> Taken {
        if self.refused_velocities > 0 {
            self.refused_velocities -= 1;
            return Taken::Invalid;
        }
        if !self.is_ready() || self.mode != mode {
            return if self.error != 0 || self.mode == mode { Taken::Yes } else { Taken::Invalid };
        }
        if self.time_ns < self.settled_at_ns || self.runs_away {
            return Taken::Yes;
        }
        self.target = target;
        self.deadline_ns = duration_s
            .filter(|&duration_s| duration_s > 0.0 && self.properties.firmware.obeys_duration())
            .map(|duration_s| self.time_ns.saturating_add((f64::from(duration_s) * 1e9) as u64));
        Taken::Yes
    }

    /// Moves the flange along y (mm/s) regardless of orders until the arm is stopped.
    pub fn run_away(&mut self, along_y_mm_per_s: f64) {
        self.rest();
        self.target = Target::Flange {
            twist: Vector6::new(0.0, along_y_mm_per_s, 0.0, 0.0, 0.0, 0.0),
            frame: TwistFrame::Base,
        };
        self.runs_away = true;
    }

    /// Makes the flange creep along y (mm/s) while the arm is running and commanded to rest; 0 ends it.
    pub fn creep(&mut self, along_y_mm_per_s: f64) {
        self.creep_mm_per_s = along_y_mm_per_s;
    }

    /// Refuses this many velocities.
    pub fn refuse_velocities(&mut self, count: u32) {
        self.refused_velocities = count;
    }

    /// Does what another client does to take the arm over: sets a mode, then sets the arm running.
    pub fn take_over(&mut self, mode: Mode) {
        self.set_mode(mode);
        self.set_state(StateOrder::Run);
    }

    /// Clears the error. While the emergency stop is pressed it returns at once.
    pub fn clear_error(&mut self) {
        if !self.emergency_stop_pressed {
            self.error = 0;
        }
    }

    /// Clears the warning.
    pub fn clear_warning(&mut self) {
        self.warning = 0;
    }

    /// Raises an error: the arm stops at once and falls back to mode 0. An emergency stop also switches the motors off.
    pub fn fail(&mut self, error: u8) {
        self.error = error;
        self.mode = Mode::Position;
        self.halt(ArmState::Stopped);
        if error == code::EMERGENCY_STOP {
            self.motors_on = [false; 7];
            self.gripper.enable(false);
        }
    }

    /// Raises a warning, which does not stop the arm.
    pub fn warn(&mut self, warning: u8) {
        self.warning = warning;
    }

    /// Presses or releases the emergency stop button.
    pub fn press_emergency_stop(&mut self, pressed: bool) {
        self.emergency_stop_pressed = pressed;
        if pressed {
            self.fail(code::EMERGENCY_STOP);
        }
    }

    /// Greatest linear speed in reduced mode, mm/s.
    pub fn set_reduced_speed(&mut self, speed_mm_per_s: f32) {
        self.reduced_speed_mm_per_s = f64::from(speed_mm_per_s.max(0.0));
    }

    /// Reduced mode on or off.
    pub fn set_reduced_mode(&mut self, on: bool) {
        self.is_reduced = on;
    }

    /// The box of the flange: highest and lowest x, y, z, mm.
    pub fn set_boundary(&mut self, boundary_mm: [i32; 6]) {
        self.boundary_mm = boundary_mm;
    }

    /// Enforces that box or not.
    pub fn set_fence(&mut self, on: bool) {
        self.fence_on = on;
    }

    /// The gripper.
    pub fn gripper(&self) -> &Gripper {
        &self.gripper
    }

    /// The gripper, to give it orders.
    pub fn gripper_mut(&mut self) -> &mut Gripper {
        &mut self.gripper
    }

    /// Error and warning code.
    pub fn codes(&self) -> (u8, u8) {
        (self.error, self.warning)
    }

    /// Whether the arm follows velocities.
    pub fn is_ready(&self) -> bool {
        self.error == 0 && self.stopped.is_none() && self.motors_on.iter().all(|&on| on)
    }

    /// The state that the arm reports.
    pub fn state(&self) -> ArmState {
        match self.stopped {
            Some(state) => state,
            // A creeping arm takes itself to be at rest.
            None if self.creeps() => ArmState::Ready,
            None if self.speed_mm_per_s() > 0.0 || self.joint_velocities_rad_per_s.norm() > 0.0 => {
                ArmState::Running
            }
            None => ArmState::Ready,
        }
    }

    /// Linear speed of the flange, mm/s.
    pub fn speed_mm_per_s(&self) -> f64 {
        let velocity = self.arm.jacobian(&self.joints_rad) * self.joint_velocities_rad_per_s;
        velocity.fixed_rows::<3>(0).norm() * 1e3
    }

    /// What the arm reports.
    pub fn report(&self) -> Report {
        let motors_on = (0..7).filter(|&joint| self.motors_on[joint]).map(|joint| 1 << joint).sum();
        Report {
            state: self.state(),
            mode: self.mode as u8,
            command_count: 0,
            joints_rad: std::array::from_fn(|joint| self.joints_rad[joint] as f32),
            pose: self.pose(),
            torques_nm: [0.0; 7],
            health: Some(Health {
                brakes_released: motors_on,
                motors_on,
                error: self.error,
                warning: self.warning,
            }),
            setup: Some(self.properties.setup),
            forces: None,
        }
    }

    /// Position of the tool's tip in mm, then roll, pitch, yaw in rad; without a TCP offset that of the flange.
    fn pose(&self) -> [f32; 6] {
        let tip = self.arm.flange_pose_m(&self.joints_rad) * self.tcp_offset_m;
        let position = tip.translation.vector * 1e3;
        let (roll, pitch, yaw) = tip.rotation.euler_angles();
        [position.x, position.y, position.z, roll, pitch, yaw].map(|value| value as f32)
    }

    /// After a change of mode or state, motion commands are ignored for a while.
    fn settle(&mut self) {
        self.settled_at_ns = self.time_ns + SETTLING_NS;
    }

    fn rest(&mut self) {
        self.target = Target::Rest;
        self.deadline_ns = None;
        self.runs_away = false;
    }

    /// Stops at once.
    fn halt(&mut self, state: ArmState) {
        self.rest();
        self.flange_velocity = Vector6::zeros();
        self.joint_velocities_rad_per_s = JointVector::zeros();
        self.stopped = Some(state);
    }

    /// Whether the flange creeps now.
    fn creeps(&self) -> bool {
        let is_told_to_rest = match self.target {
            Target::Rest => true,
            Target::Flange { twist, .. } => twist == Vector6::zeros(),
            Target::Joints(velocities) => velocities == JointVector::zeros(),
        };
        self.creep_mm_per_s != 0.0 && self.is_ready() && is_told_to_rest
    }

    fn is_still(&self) -> bool {
        self.target == Target::Rest
            && self.flange_velocity == Vector6::zeros()
            && self.joint_velocities_rad_per_s == JointVector::zeros()
            && !self.gripper.moves()
            && !self.creeps()
    }
}

#[cfg(test)]
mod tests;
