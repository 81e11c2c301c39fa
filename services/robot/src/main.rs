//! The robot process: commands in, motion and its state out. Which arm moves is behind the seam in [`arm`].
//!
//! ```text
//! command ─▶ fresh? ─▶ permitted? ─▶ target twist ─┐
//!                          ▲                       ├─▶ ramp, limits, joints ─▶ state
//! 150 ms of silence, ──────┴──▶ rest, stop ────────┘   steps of 4 ms           250 Hz, 50 Hz while still
//! stop orders, limits
//! ```
//!
//! Live, the arm's time is the clock. In a lossless replay it is the time of the samples, so that the arm
//! ends where it would have ended, however fast the replay goes.

mod arm;
mod permission;
mod xarm;

use std::os::fd::AsFd;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, bail};
use tendon_arm::{GripperCommand as ArmGripper, Guard, JointVector, LimitViolation, SimulatedArm, Twist};
use tendon_config::Backend;
use tendon_gesture::Strategy;
use tendon_messages::{
    ArmPhase, COMMANDS, CommandHeader, Permission, STATE_LENGTH, STATES, Stage, StateHeader, StopReason,
    TWIST_LENGTH, Trace,
};
use tendon_process::{Order, STALE_NS, StageProcess, Wake};
use tendon_transport::{Delivery, Publisher, Received, Subscriber, now_ns};

use crate::arm::{Arm, Stop};
use crate::permission::Latch;
use crate::xarm::XArm;

/// Time between two ticks in motion, ns: 250 Hz, the rate of the vendor's controller.
const MOVING_PERIOD_NS: u64 = tendon_arm::STEP_NS;
/// Time between two ticks while nothing moves, ns. A command ends it.
const STILL_PERIOD_NS: u64 = 20_000_000;
/// After so long without a word from the supervisor it is taken to hang, ns: four of its heartbeats.
const SUPERVISOR_SILENCE_NS: u64 = 120_000_000;

fn main() -> ExitCode {
    tendon_process::main(Stage::Robot, |process| {
        let config = &process.config;
        let delivery = config.delivery();
        // The one place that knows which arm moves.
        let arm: Box<dyn Arm> = match config.robot.backend {
            Backend::Simulate => {
                Box::new(SimulatedArm::new(config.robot.arm.clone(), start_of_time(delivery))?)
            }
            Backend::XArm => {
                let goes_to_start = !process.is_restarted;
                Box::new(XArm::connect(&config.robot.xarm, &config.robot.arm, goes_to_start, now_ns())?)
            }
        };
        let never = Arc::new(AtomicBool::new(false));
        let mut latch = Latch::new(config.decision.strategy == Strategy::Threshold);
        if process.is_restarted {
            latch.stop(Stop::because(StopReason::StageEnded));
        }
        let robot = Robot {
            arm,
            latch,
            guard: Guard::new(&config.robot.arm),
            states: Publisher::open(&process.session, &STATES, STATE_LENGTH, Delivery::Live, never)?,
            delivery,
            sample_rate_hz: config.acquisition.sample_rate_hz,
            supervisor_heard_ns: None,
            woke_ns: now_ns(),
            is_introduced: false,
            newest_command: None,
            gripper_toggles: None,
            gripper_middle_pulses: 0.5
                * (config.robot.arm.gripper_open_pulses + config.robot.arm.gripper_closed_pulses),
            needs_calibration: config.decision.strategy == Strategy::Threshold,
            state: StateHeader::default(),
        };
        let commands = Subscriber::open(&process.session, &COMMANDS, Some(Stage::Robot), delivery)?;
        // Before the wait for others, so that an order to stop is heard from the beginning.
        process.control.listen(process.session.name())?;
        process.connect(&commands)?;
        Ok(move |process: &mut StageProcess| robot.run(process, commands))
    })
}

/// What the arm's time starts from.
fn start_of_time(delivery: Delivery) -> u64 {
    match delivery {
        Delivery::Live => now_ns(),
        Delivery::Lossless => 0,
    }
}

struct Robot {
    arm: Box<dyn Arm>,
    latch: Latch,
    guard: Guard,
    states: Publisher<StateHeader, f32>,
    delivery: Delivery,
    sample_rate_hz: f64,
    /// When the supervisor was last heard; `None` without one.
    supervisor_heard_ns: Option<u64>,
    /// When this process last did anything.
    woke_ns: u64,
    /// Whether the supervisor knows that the arm is ready.
    is_introduced: bool,
    /// Sequence number of the newest command.
    newest_command: Option<u64>,
    /// What the newest command counted.
    gripper_toggles: Option<u32>,
    gripper_middle_pulses: f64,
    /// Whether rest is known only once the activity detector is calibrated.
    needs_calibration: bool,
    /// Of the last command acted on.
    state: StateHeader,
}

impl Robot {
    fn run(
        mut self,
        process: &mut StageProcess,
        mut commands: Subscriber<CommandHeader, f32>,
    ) -> anyhow::Result<()> {
        let mut tick_ns = now_ns();
        let ended = loop {
            if let Err(error) = self.introduce(process) {
                break Err(error);
            }
            let deadline_ns = match self.delivery {
                Delivery::Live => Some(tick_ns),
                Delivery::Lossless => process.measurements.deadline_ns(),
            };
            let wake = process.control.wait(Some(commands.as_fd()), deadline_ns)?;
            self.notice_stall();
            match wake {
                Wake::Stop => break Ok(()),
                Wake::Order(order) => self.obey(process, order),
                Wake::Message => {
                    commands.acknowledge_wakes()?;
                    let was_still = self.arm.is_still();
                    while let Some(command) = commands.receive()? {
                        self.take(process, &command)?;
                        process.count(&commands);
                    }
                    // A command that sets the still arm in motion goes out at once.
                    if was_still && !self.arm.is_still() {
                        tick_ns = now_ns();
                    }
                }
                Wake::Deadline if self.delivery == Delivery::Live => {
                    let now_ns = now_ns();
                    if !self.arm.is_still() {
                        process.measurements.record_tick(now_ns.saturating_sub(tick_ns))?;
                    }
                    self.tick(now_ns);
                    if let Some(took_ns) = self.arm.command_to_wire_ns() {
                        process.measurements.record_command_to_wire(took_ns)?;
                    }
                    self.publish_state(process)?;
                    process.measurements.publish_if_due()?;
                    let period_ns = if self.arm.is_still() { STILL_PERIOD_NS } else { MOVING_PERIOD_NS };
                    // After a stall the ticks that were missed are not made up for.
                    tick_ns = (tick_ns + period_ns).max(now_ns);
                }
                Wake::Deadline => process.measurements.publish_if_due()?,
            }
        };
        self.arm.stop();
        self.publish_state(process)?;
        process.measurements.publish()?;
        ended
    }

    /// Tells the supervisor once that the arm is ready, or, after a restart, that it can be armed.
    ///
    /// # Errors
    ///
    /// When it cannot become ready.
    fn introduce(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        if self.is_introduced {
            return Ok(());
        }
        if self.arm.is_ready() || process.is_restarted {
            self.is_introduced = true;
            return process.ready(&self.arm.description());
        }
        match self.latch.reason() {
            None => Ok(()),
            Some(stop) => bail!("{} did not get ready: {}", self.arm.description(), words(stop)),
        }
    }

    /// A process that stood still while its arm moved must not go on where it was: the arm has come to rest.
    fn notice_stall(&mut self) {
        let now_ns = now_ns();
        let is_live = self.delivery == Delivery::Live;
        if is_live && now_ns.saturating_sub(self.woke_ns) > STALE_NS && !self.arm.is_still() {
            self.arm.stalled();
            self.latch.interrupt(StopReason::RobotStalled);
        }
        self.woke_ns = now_ns;
    }

    fn obey(&mut self, process: &mut StageProcess, order: Order) {
        match order {
            Order::Alive => self.supervisor_heard_ns = Some(now_ns()),
            Order::Stop => {
                self.stop(Stop::because(StopReason::Ordered));
                process.control.answer("the arm is stopped: `tendon arm` permits motion again");
            }
            Order::Arm => {
                if self.latch.permission() == Permission::Stopped {
                    self.arm.rearm(now_ns());
                    self.guard.reset();
                    self.latch.arm();
                }
                process.control.answer("armed: the arm moves again once the muscles have been at rest");
            }
            Order::StageEnded => {
                // A decision process that is started again is no surprise then.
                self.newest_command = None;
                self.stop(Stop::because(StopReason::StageEnded));
            }
            Order::Start | Order::Gesture(_) => {}
        }
    }

    fn stop(&mut self, stop: Stop) {
        self.arm.stop();
        self.latch.stop(stop);
    }

    /// Lets the arm move, and looks after it.
    fn tick(&mut self, now_ns: u64) {
        if let Err(stop) = self.arm.tick(now_ns) {
            self.stop(stop);
        }
        let state = self.arm.state();
        if self.arm.is_ready() && self.latch.permission() != Permission::Stopped {
            let joints_rad = JointVector::from(state.joints_rad);
            if let Err(violation) = self.guard.check(now_ns, &joints_rad, state.position_mm) {
                self.stop(Stop::because(reason_of(violation)));
            }
        }
        if state.halted_by_watchdog {
            self.latch.interrupt(StopReason::NoCommands);
        }
        let is_silent = |heard_ns| now_ns.saturating_sub(heard_ns) > SUPERVISOR_SILENCE_NS;
        if self.supervisor_heard_ns.is_some_and(is_silent) && self.latch.permission() == Permission::Granted {
            self.arm.rest();
            self.latch.interrupt(StopReason::SupervisorSilent);
        }
    }

    fn take(
        &mut self,
        process: &mut StageProcess,
        command: &Received<CommandHeader, f32>,
    ) -> anyhow::Result<()> {
        let trace = command.trace();
        let header = command.header();
        let newest_command = self.newest_command.replace(trace.sequence);
        if newest_command.is_some_and(|newest| trace.sequence <= newest) {
            // From a decision process that began anew, whoever started it.
            self.stop(Stop::because(StopReason::StageEnded));
        }
        if process.is_stale(&trace) {
            process.measurements.counts.stale += 1;
        } else {
            let now_ns = match self.delivery {
                Delivery::Live => now_ns(),
                Delivery::Lossless => {
                    let sample = header.context.first_sample as f64;
                    (sample * 1e9 / self.sample_rate_hz) as u64
                }
            };
            self.tick(now_ns);
            let toggles = self.gripper_toggles.replace(header.gripper_toggles);
            if self.arm.is_ready() && self.latch.admits(header) {
                let is_toggled = toggles.is_some_and(|toggles| toggles != header.gripper_toggles);
                self.follow(command.payload(), is_toggled, now_ns)?;
            }
            self.state = StateHeader {
                trace,
                gesture: header.voted,
                confidence: header.confidence,
                calibration_left_ms: if self.needs_calibration {
                    header.context.calibration_left_ms
                } else {
                    0
                },
                ..self.state
            };
            if self.delivery == Delivery::Lossless {
                self.publish_state(process)?;
            }
        }
        let measurement = process.measure(&trace, None);
        process.measurements.record(measurement)
    }

    fn follow(&mut self, twist: &[f32], toggles_gripper: bool, now_ns: u64) -> anyhow::Result<()> {
        let length = twist.len();
        let twist: &[f32; TWIST_LENGTH] =
            twist.try_into().with_context(|| format!("a command of {length} components"))?;
        let [x, y, z, about_x, about_y, about_z] = twist.map(f64::from);
        let twist = Twist { linear_mm_per_s: [x, y, z], angular_rad_per_s: [about_x, about_y, about_z] };
        if let Err(error) = self.arm.command(twist, now_ns) {
            tracing::error!("a command was refused and the arm stopped: {error}");
        }
        if toggles_gripper {
            let is_open = self.arm.state().gripper_position_pulses > self.gripper_middle_pulses;
            let command = if is_open { ArmGripper::Close } else { ArmGripper::Open };
            self.arm.command_gripper(command, now_ns);
        }
        Ok(())
    }

    fn publish_state(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        let state = self.arm.state();
        let stop = self.latch.reason();
        let header = StateHeader {
            trace: Trace { sequence: 0, ..self.state.trace },
            speed_mm_per_s: state.linear_speed_mm_per_s as f32,
            gripper_position: state.gripper_position_pulses as f32,
            permission: self.latch.permission() as u8,
            stop_reason: stop.map_or(0, |stop| stop.reason as u8),
            fault_code: stop.map_or(0, |stop| stop.fault_code),
            arm_phase: if self.arm.is_ready() { ArmPhase::Following } else { ArmPhase::BringingUp } as u8,
            ..self.state
        };
        self.states.publish(header, STATE_LENGTH, |payload| {
            let components =
                state.joints_rad.iter().chain(&state.position_mm).chain(&state.orientation_rpy_rad);
            for (component, value) in payload.iter_mut().zip(components) {
                *component = *value as f32;
            }
        })?;
        process.measurements.counts.published = self.states.published();
        Ok(())
    }
}

fn reason_of(violation: LimitViolation) -> StopReason {
    match violation {
        LimitViolation::JointLimit { .. } => StopReason::JointLimit,
        LimitViolation::WorkspaceBox { .. } => StopReason::WorkspaceBox,
        LimitViolation::OverSpeed { .. } => StopReason::OverSpeed,
    }
}

/// Why the arm stopped, and what to do.
fn words(stop: Stop) -> String {
    match tendon_xarm::Fault::new(tendon_xarm::Source::Controller, stop.fault_code) {
        Some(fault) => fault.to_string(),
        None => stop.reason.to_string(),
    }
}
