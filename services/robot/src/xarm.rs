//! An xArm7 on the network, driven by [`tendon_xarm::Client`].
//!
//! ```text
//! connect ─▶ bring up for joints ─▶ go slowly to the start position ─▶ bring up for the flange ─▶ follow
//!                                                                              ▲                    │
//!    └─▶ stopped, if the arm was not left in good order before          rearm  └──── stopped ◀──────┘
//! ```
//!
//! While it follows, every tick sends the velocity that [`Motion`] allows in the joint angles that the arm reports. A
//! command is answered at once, by the part of the coming step that has passed: velocities lie on one ramp, whenever
//! they are sent.
//!
//! ```text
//! velocity      ·──── tick
//!            ,x´      x: a command that came between two ticks
//!   tick ───´
//! ```
//!
//! Each velocity lasts for [`VELOCITY_DURATION`] only, so the arm comes to rest by itself when this process or the
//! cable is gone.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use anyhow::Context;
use tendon_arm::{
    ArmSettings, ArmState, GripperCommand, JointVector, Motion, NonFiniteTwist, STEP_NS, Twist,
};
use tendon_config::XArmSettings;
use tendon_messages::StopReason;
use tendon_transport::now_ns;
use tendon_xarm::{Client, ClientSettings, Fault, Halt, Mode, Status, Velocity};

use crate::arm::{Arm, Stop};

/// How long a velocity lasts without a newer one: two increments of the paper's windows.
const VELOCITY_DURATION: Duration = Duration::from_millis(150);
/// Real-time reports come every 10 ms; after so long without one the arm's whereabouts are not known any more.
const REPORT_TIMEOUT: Duration = Duration::from_millis(250);
/// Zero velocities sent at the end of a motion, a tick each: more than the network may swallow.
const LAST_ZEROS: u32 = 25;
/// Joints this near to the start position, rad, are there.
const ARRIVED_RAD: f64 = 0.002;
/// On the way to the start position: acceleration in rad/s², and the speed near the end in 1/s of the distance left.
const START_ACCELERATION_RAD_PER_S2: f64 = 0.5;
const START_APPROACH_PER_S: f64 = 2.0;
/// How long the client may take to connect, ns.
const CONNECT_TIMEOUT_NS: u64 = 10_000_000_000;
/// The client takes an order a moment later: what it says until then, ns, is about before.
const ORDER_TAKEN_NS: u64 = 50_000_000;
/// Time over which the flange's speed is measured, ns: two reports are too near for their jitter.
const SPEED_INTERVAL_NS: u64 = 40_000_000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Connecting,
    EnablingJoints,
    /// At this joint speed, rad/s.
    GoingToStart(f64),
    EnablingFlange,
    Following,
    Stopped,
}

/// An xArm7 on the network.
pub struct XArm {
    client: Client,
    control: SocketAddr,
    motion: Motion,
    phase: Phase,
    goes_to_start: bool,
    start_joints_rad: JointVector,
    start_speed_rad_per_s: f64,
    gripper_open_pulses: f64,
    gripper_closed_pulses: f64,
    connecting_since_ns: Option<u64>,
    /// End of the last step, or when the next may begin.
    stepped_ns: u64,
    zeros_sent: u32,
    /// Commands whose time to the network was told.
    commands_told: u64,
    /// Whether the error that stopped the arm was told.
    is_explained: bool,
    /// Where the flange was, and when; for its speed.
    position_before_mm: [f64; 3],
    position_before_ns: u64,
    speed_mm_per_s: f64,
    status: Status,
}

impl XArm {
    /// Begins to connect, at the time `now_ns`. Without `goes_to_start` the arm is stopped where it is, until
    /// [`Arm::rearm`].
    pub fn connect(
        xarm: &XArmSettings,
        arm: &ArmSettings,
        goes_to_start: bool,
        now_ns: u64,
    ) -> anyhow::Result<XArm> {
        let address = xarm.address.context("robot.xarm.address is missing")?;
        let settings = ClientSettings {
            control: SocketAddr::new(address, xarm.control_port),
            normal_report: SocketAddr::new(address, xarm.normal_report_port),
            real_time_report: SocketAddr::new(address, xarm.real_time_report_port),
            duration: VELOCITY_DURATION,
            gripper_speed: xarm.gripper.then_some(arm.gripper_speed_pulses_per_s as u16),
            ..ClientSettings::new(address)
        };
        Ok(XArm {
            control: settings.control,
            client: Client::start(settings)?,
            motion: Motion::new(arm),
            phase: Phase::Connecting,
            goes_to_start,
            start_joints_rad: arm.start_joints_rad(),
            start_speed_rad_per_s: xarm.start_speed_deg_per_s.to_radians(),
            gripper_open_pulses: arm.gripper_open_pulses,
            gripper_closed_pulses: arm.gripper_closed_pulses,
            connecting_since_ns: None,
            stepped_ns: now_ns,
            zeros_sent: LAST_ZEROS,
            commands_told: 0,
            is_explained: false,
            position_before_mm: [0.0; 3],
            position_before_ns: 0,
            speed_mm_per_s: 0.0,
            status: Status::default(),
        })
    }

    fn joints_rad(&self) -> Option<JointVector> {
        self.status.report.map(|report| JointVector::from(report.joints_rad.map(f64::from)))
    }

    fn position_mm(&self) -> Option<[f64; 3]> {
        let [x, y, z, ..] = self.status.report?.pose.map(f64::from);
        Some([x, y, z])
    }

    fn measure_speed(&mut self, now_ns: u64) {
        let elapsed_ns = now_ns.saturating_sub(self.position_before_ns);
        if let Some(position_mm) = self.position_mm().filter(|_| elapsed_ns >= SPEED_INTERVAL_NS) {
            let moved_mm = (0..3).map(|axis| position_mm[axis] - self.position_before_mm[axis]);
            let distance_mm = moved_mm.map(|way| way * way).sum::<f64>().sqrt();
            if self.position_before_ns > 0 {
                self.speed_mm_per_s = distance_mm / (elapsed_ns as f64 * 1e-9);
            }
            self.position_before_mm = position_mm;
            self.position_before_ns = now_ns;
        }
    }

    /// What the client says of the arm as long as it is to move.
    fn look_after(&self) -> Result<(), Stop> {
        if self.status.phase == tendon_xarm::Phase::Disconnected {
            return Err(Stop::because(StopReason::ConnectionBroke));
        }
        if let Some(halt) = self.status.halt {
            // An error says more than that the arm is not ready.
            return Err(self.status.error().map_or(stop_of(halt), stop_for));
        }
        let is_fresh = self.status.reported_at.is_some_and(|at| at.elapsed() < REPORT_TIMEOUT);
        if is_fresh { Ok(()) } else { Err(Stop::because(StopReason::ConnectionBroke)) }
    }

    fn bring_up(&mut self, mode: Mode, phase: Phase, now_ns: u64) {
        self.client.arm(mode);
        self.phase = phase;
        self.stepped_ns = now_ns + ORDER_TAKEN_NS;
    }

    /// That the arm stopped is known before its error is, which says why.
    fn say_more(&mut self) -> Result<(), Stop> {
        match self.status.error() {
            Some(fault) if !self.is_explained => {
                self.is_explained = true;
                Err(stop_for(fault))
            }
            _ => Ok(()),
        }
    }

    fn go_to_start(&mut self, joints_rad: &JointVector, speed_rad_per_s: f64, now_ns: u64) {
        let way = self.start_joints_rad - joints_rad;
        let distance = way.amax();
        if distance < ARRIVED_RAD {
            self.bring_up(Mode::CartesianVelocity, Phase::EnablingFlange, now_ns);
            return;
        }
        let gained = speed_rad_per_s + START_ACCELERATION_RAD_PER_S2 * STEP_NS as f64 * 1e-9;
        let speed = gained.min(self.start_speed_rad_per_s).min(START_APPROACH_PER_S * distance);
        let velocities = way * (speed / distance);
        self.client.follow(Velocity::Joints(<[f64; 7]>::from(velocities).map(|velocity| velocity as f32)));
        self.phase = Phase::GoingToStart(speed);
    }

    fn follow(&mut self, joints_rad: &JointVector, steps: u64) {
        for step in (0..steps).rev() {
            self.motion.advance(self.stepped_ns - step * STEP_NS, joints_rad);
        }
        let twist = self.motion.velocity();
        self.zeros_sent = if twist == Twist::ZERO { self.zeros_sent + 1 } else { 0 };
        if self.zeros_sent <= LAST_ZEROS {
            self.client.follow(of_flange(twist));
        } else {
            self.zeros_sent = LAST_ZEROS;
        }
    }

    /// Sends where the ramp to the velocity of the coming step is now, after a command received at `received_ns`.
    fn answer(&mut self, received_ns: u64, joints_rad: &JointVector) {
        let passed = received_ns.saturating_sub(self.stepped_ns) as f64 / STEP_NS as f64;
        let twist = self.motion.foresee(self.stepped_ns, joints_rad, passed.min(1.0));
        if twist == Twist::ZERO {
            // Rest at rest needs no answer.
            return;
        }
        self.zeros_sent = 0;
        let since = Duration::from_nanos(now_ns().saturating_sub(received_ns));
        self.client.follow_command(of_flange(twist), Instant::now() - since);
    }
}

fn of_flange(twist: Twist) -> Velocity {
    let [x, y, z] = twist.linear_mm_per_s;
    let [roll, pitch, yaw] = twist.angular_rad_per_s;
    Velocity::Flange([x, y, z, roll, pitch, yaw].map(|value| value as f32))
}

impl Arm for XArm {
    fn description(&self) -> String {
        format!("xArm7 at {}", self.control)
    }

    fn is_ready(&self) -> bool {
        self.phase == Phase::Following
    }

    fn tick(&mut self, now_ns: u64) -> Result<(), Stop> {
        let steps = now_ns.saturating_sub(self.stepped_ns) / STEP_NS;
        if steps == 0 {
            return Ok(());
        }
        // A late tick does not shift those after it: ramps and stops take their time and no longer.
        self.stepped_ns += steps * STEP_NS;
        self.status = self.client.status();
        self.measure_speed(now_ns);
        let is_up = self.status.phase == tendon_xarm::Phase::Ready;
        match self.phase {
            Phase::Stopped => return self.say_more(),
            Phase::Connecting => {
                if self.status.phase == tendon_xarm::Phase::Connected && self.status.report.is_some() {
                    if self.goes_to_start {
                        self.bring_up(Mode::JointVelocity, Phase::EnablingJoints, now_ns);
                    } else {
                        self.stop();
                    }
                    return Ok(());
                }
                let since_ns = *self.connecting_since_ns.get_or_insert(now_ns);
                let is_late = now_ns - since_ns > CONNECT_TIMEOUT_NS;
                return if is_late { Err(Stop::because(StopReason::ConnectionBroke)) } else { Ok(()) };
            }
            _ => {}
        }
        let looked_after = self.look_after();
        if looked_after.is_err() {
            self.phase = Phase::Stopped;
            self.is_explained = self.status.error().is_some();
            self.motion.halt();
        }
        looked_after?;
        let Some(joints_rad) = self.joints_rad() else { return Ok(()) };
        match self.phase {
            Phase::EnablingJoints if is_up => self.phase = Phase::GoingToStart(0.0),
            Phase::GoingToStart(speed_rad_per_s) => {
                self.go_to_start(&joints_rad, speed_rad_per_s, now_ns);
            }
            Phase::EnablingFlange if is_up => self.phase = Phase::Following,
            Phase::Following => self.follow(&joints_rad, steps),
            _ => {}
        }
        Ok(())
    }

    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        let outcome = self.motion.command(twist, now_ns);
        if let Some(joints_rad) = self.joints_rad().filter(|_| self.phase == Phase::Following) {
            self.answer(now_ns, &joints_rad);
        }
        outcome
    }

    fn command_to_wire_ns(&mut self) -> Option<u64> {
        let told = std::mem::replace(&mut self.commands_told, self.status.commands_answered);
        (self.status.commands_answered > told).then_some(self.status.command_to_wire.as_nanos() as u64)
    }

    fn command_gripper(&mut self, command: GripperCommand, _now_ns: u64) {
        let pulses = match command {
            GripperCommand::Open => self.gripper_open_pulses,
            GripperCommand::Close => self.gripper_closed_pulses,
        };
        self.client.move_gripper(pulses.round() as i32);
    }

    fn rest(&mut self) {
        self.motion.stop();
    }

    fn stop(&mut self) {
        self.client.stop();
        self.motion.halt();
        self.phase = Phase::Stopped;
    }

    fn stalled(&mut self) {
        self.motion.halt();
    }

    fn rearm(&mut self, now_ns: u64) {
        self.motion.halt();
        self.is_explained = false;
        self.bring_up(Mode::CartesianVelocity, Phase::EnablingFlange, now_ns);
    }

    fn is_still(&self) -> bool {
        matches!(self.phase, Phase::Following | Phase::Stopped)
            && self.motion.is_still()
            && self.zeros_sent >= LAST_ZEROS
    }

    fn state(&self) -> ArmState {
        let Some(report) = self.status.report else { return ArmState::default() };
        let [x, y, z, roll, pitch, yaw] = report.pose.map(f64::from);
        ArmState {
            joints_rad: report.joints_rad.map(f64::from),
            position_mm: [x, y, z],
            orientation_rpy_rad: [roll, pitch, yaw],
            linear_speed_mm_per_s: self.speed_mm_per_s,
            gripper_position_pulses: self
                .status
                .gripper
                .map_or(self.gripper_open_pulses, |gripper| f64::from(gripper.position_pulses)),
            halted_by_watchdog: self.motion.halted_by_watchdog(),
        }
    }
}

fn stop_for(fault: Fault) -> Stop {
    Stop { reason: StopReason::ArmFault, fault_code: fault.code }
}

fn stop_of(halt: Halt) -> Stop {
    match halt {
        Halt::Ordered => Stop::because(StopReason::Ordered),
        Halt::ConnectionBroke => Stop::because(StopReason::ConnectionBroke),
        Halt::Fault(fault) => stop_for(fault),
        Halt::NotReady(_)
        | Halt::ModeChanged(_)
        | Halt::VelocityRefused
        | Halt::Refused(_)
        | Halt::NoReports
        | Halt::TooSlow
        | Halt::Unsupported(_) => Stop::because(StopReason::NotReady),
    }
}
