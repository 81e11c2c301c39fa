//! An xArm7 on the network, driven by [`tendon_xarm::Client`].
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
//! cable is gone. Where the flange is, our own kinematics say: the arm's position is that of its tool.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use anyhow::Context;
use tendon_arm::{ArmSettings, JointLimits, JointVector, Motion, NonFiniteTwist, STEP_NS, Twist, XArm7};
use tendon_config::XArmSettings;
use tendon_control::{Arm, ArmReport, Drive, Link, Stop};
use tendon_messages::StopReason;
use tendon_transport::now_ns;
use tendon_xarm::{ArmState, Client, ClientSettings, Halt, Mode, Phase, Status, Velocity};

/// How long a velocity lasts without a newer one: two increments of the paper's windows.
const VELOCITY_DURATION: Duration = Duration::from_millis(150);
/// Zero velocities sent at the end of a motion, a tick each: more than the network may swallow.
const LAST_ZEROS: u32 = 25;
/// Time over which the flange's speed is measured, ns: two reports are too near for their jitter.
const SPEED_INTERVAL_NS: u64 = 40_000_000;

/// An xArm7 on the network.
pub struct XArm {
    client: Client,
    control: SocketAddr,
    /// The key of an arm that has no serial number.
    control_name: String,
    has_gripper: bool,
    kinematics: XArm7,
    motion: Motion,
    /// What it was last brought up for.
    drive: Drive,
    /// End of the last step.
    stepped_ns: u64,
    zeros_sent: u32,
    /// Commands whose time to the network was told.
    commands_told: u64,
    /// Where the flange was (mm), and when; for its speed.
    position_before: Option<(u64, [f64; 3])>,
    speed_mm_per_s: f64,
    is_introduced: bool,
    status: Status,
}

impl XArm {
    /// Begins to connect, at the time `now_ns`.
    pub fn connect(xarm: &XArmSettings, arm: &ArmSettings, now_ns: u64) -> anyhow::Result<XArm> {
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
            control_name: settings.control.to_string(),
            client: Client::start(settings)?,
            has_gripper: xarm.gripper,
            kinematics: XArm7::new(),
            motion: Motion::new(arm),
            drive: Drive::Flange,
            stepped_ns: now_ns,
            zeros_sent: LAST_ZEROS,
            commands_told: 0,
            position_before: None,
            speed_mm_per_s: 0.0,
            is_introduced: false,
            status: Status::default(),
        })
    }

    fn joints_rad(&self) -> Option<JointVector> {
        self.status.report.map(|report| JointVector::from(report.joints_rad.map(f64::from)))
    }

    fn is_following(&self) -> bool {
        self.status.phase == Phase::Ready && self.drive == Drive::Flange
    }

    /// Whether it is known who the arm is, where it is, and whether it has an error.
    fn is_known(&self) -> bool {
        self.status.identity.is_some() && self.status.report.is_some() && self.status.setup.is_some()
    }

    /// Takes over what is known once of an arm, and warns of settings that leave a person unprotected.
    fn introduce(&mut self) {
        if self.is_introduced || !self.is_known() {
            return;
        }
        self.is_introduced = true;
        self.motion.set_joint_limits(self.joint_limits());
        if let Some(setup) = self.status.setup {
            if setup.collision_sensitivity == 0 {
                tracing::warn!(
                    "the arm's collision detection is off (sensitivity 0): set 1 to 5 with the vendor's software"
                );
            }
            if self.has_gripper && setup.load_kg == 0.0 {
                tracing::warn!(
                    "the arm does not know of its gripper's weight (load 0 kg): set it with the vendor's software, \
                     else collisions are recognised late"
                );
            }
        }
    }

    fn measure_speed(&mut self, now_ns: u64) {
        let Some(joints_rad) = self.joints_rad() else { return };
        let (before_ns, before_mm) = self.position_before.unwrap_or_default();
        let elapsed_ns = now_ns.saturating_sub(before_ns);
        if elapsed_ns < SPEED_INTERVAL_NS {
            return;
        }
        let position_mm: [f64; 3] =
            (self.kinematics.flange_pose_m(&joints_rad).translation.vector * 1e3).into();
        if self.position_before.is_some() {
            let way_mm = (0..3).map(|axis| (position_mm[axis] - before_mm[axis]).powi(2)).sum::<f64>().sqrt();
            self.speed_mm_per_s = way_mm / (elapsed_ns as f64 * 1e-9);
        }
        self.position_before = Some((now_ns, position_mm));
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
    fn send_at_once(&mut self, received_ns: u64, joints_rad: &JointVector) {
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

    fn link(&self) -> Link {
        match self.status.phase {
            Phase::Disconnected | Phase::Identifying => Link::Connecting,
            Phase::Connected if !self.is_known() => Link::Connecting,
            Phase::Connected => Link::Connected,
            Phase::BringingUp => Link::BringingUp,
            Phase::Ready => Link::Up(self.drive),
        }
    }
}

fn of_flange(twist: Twist) -> Velocity {
    let [x, y, z] = twist.linear_mm_per_s;
    let [roll, pitch, yaw] = twist.angular_rad_per_s;
    Velocity::Flange([x, y, z, roll, pitch, yaw].map(|value| value as f32))
}

impl Arm for XArm {
    fn description(&self) -> String {
        let Some(identity) = self.status.identity else { return format!("xArm7 at {}", self.control) };
        let setup = self.status.setup.map_or(String::new(), |setup| {
            let [x, y, z, ..] = setup.tcp_offset;
            format!(
                ", tool {x:.0} {y:.0} {z:.0} mm, load {:.2} kg, collision sensitivity {}",
                setup.load_kg, setup.collision_sensitivity
            )
        });
        format!(
            "xArm7 at {}, {}, firmware {}{setup}",
            self.control, identity.serial_number, identity.firmware
        )
    }

    fn key(&self) -> &str {
        match &self.status.identity {
            Some(identity) if !identity.serial_number.as_str().is_empty() => identity.serial_number.as_str(),
            _ => &self.control_name,
        }
    }

    fn explanation(&self) -> Option<String> {
        match self.status.halt {
            None | Some(Halt::ConnectionBroke) if self.status.identity.is_none() => {
                Some(format!("no arm answers at {}: check address, cable and power", self.control))
            }
            halt => halt.map(|halt| halt.to_string()),
        }
    }

    fn joint_limits(&self) -> JointLimits {
        self.status.identity.map_or_else(JointLimits::default, |identity| {
            let limits = identity.joint_limits();
            JointLimits { lower_rad: limits.lower_rad.into(), upper_rad: limits.upper_rad.into() }
        })
    }

    fn tick(&mut self, now_ns: u64) {
        let steps = now_ns.saturating_sub(self.stepped_ns) / STEP_NS;
        if steps == 0 {
            return;
        }
        // A late tick does not shift those after it: ramps and stops take their time and no longer.
        self.stepped_ns += steps * STEP_NS;
        self.status = self.client.status();
        self.introduce();
        self.measure_speed(now_ns);
        if self.status.halt.is_some() {
            self.motion.halt();
        }
        if let Some(joints_rad) = self.joints_rad().filter(|_| self.is_following()) {
            self.follow(&joints_rad, steps);
        }
    }

    fn report(&self) -> ArmReport {
        let silence = self.status.silence(Instant::now());
        let gripper = self.status.gripper.filter(|_| self.has_gripper);
        ArmReport {
            link: self.link(),
            stop: self.status.halt.map(stop_of),
            error_code: self.status.error().map(|fault| fault.code),
            joints_rad: self.joints_rad(),
            silent_ns: u64::try_from(silence.as_nanos()).unwrap_or(u64::MAX),
            report_age_ns: self.status.reported_at.map_or(0, |at| at.elapsed().as_nanos() as u64),
            speed_mm_per_s: self.speed_mm_per_s,
            is_stopped: self.status.report.is_some_and(|report| report.state == ArmState::Stopped),
            gripper_pulses: gripper.map(|gripper| f64::from(gripper.position_pulses)),
            is_gripper_moving: gripper.is_some_and(|gripper| gripper.moves),
            told: self.motion.velocity(),
            halted_by_watchdog: self.motion.halted_by_watchdog(),
            obstacle: self.motion.obstacle(),
        }
    }

    fn bring_up(&mut self, drive: Drive, acknowledges_error: bool, now_ns: u64) {
        let mode = match drive {
            Drive::Joints => Mode::JointVelocity,
            Drive::Flange => Mode::CartesianVelocity,
        };
        self.motion.halt();
        self.zeros_sent = LAST_ZEROS;
        self.drive = drive;
        self.stepped_ns = now_ns;
        if acknowledges_error {
            self.client.arm(mode);
        } else {
            self.client.bring_up_unless_fault(mode);
        }
        self.status = self.client.status();
    }

    fn follow_joints(&mut self, velocities_rad_per_s: &JointVector) {
        let velocities = <[f64; 7]>::from(*velocities_rad_per_s).map(|velocity| velocity as f32);
        self.client.follow(Velocity::Joints(velocities));
    }

    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        let outcome = self.motion.command(twist, now_ns);
        if let Some(joints_rad) = self.joints_rad().filter(|_| self.is_following()) {
            self.send_at_once(now_ns, &joints_rad);
        }
        outcome
    }

    fn command_to_wire_ns(&mut self) -> Option<u64> {
        let told = std::mem::replace(&mut self.commands_told, self.status.commands_answered);
        (self.status.commands_answered > told).then_some(self.status.command_to_wire.as_nanos() as u64)
    }

    fn move_gripper(&mut self, pulses: f64, _now_ns: u64) {
        self.client.move_gripper(pulses.round() as i32);
    }

    fn rest(&mut self) {
        self.motion.stop();
    }

    fn stop(&mut self) {
        self.client.stop();
        self.motion.halt();
        self.status = self.client.status();
    }

    fn stalled(&mut self) {
        self.motion.halt();
    }

    fn is_still(&self) -> bool {
        let is_moving_up = self.status.phase == Phase::BringingUp
            || (self.status.phase == Phase::Ready && self.drive == Drive::Joints);
        !is_moving_up && self.motion.is_still() && self.zeros_sent >= LAST_ZEROS
    }
}

fn stop_of(halt: Halt) -> Stop {
    match halt {
        Halt::Ordered => Stop::because(StopReason::Ordered),
        Halt::ConnectionBroke => Stop::because(StopReason::ConnectionBroke),
        Halt::Fault(fault) => Stop::by_fault(fault.code),
        Halt::ModeChanged(_) => Stop::because(StopReason::TakenOver),
        Halt::VelocityRefused => Stop::because(StopReason::VelocityRefused),
        Halt::Unsupported(_) => Stop::because(StopReason::UnsupportedArm),
        Halt::NoReports => Stop::because(StopReason::ArmSilent),
        Halt::NotReady(_) | Halt::Refused(_) | Halt::TooSlow => Stop::because(StopReason::NotReady),
    }
}
