//! The robot process: commands in, motion and its state out. The arm itself is `tendon_arm::SimulatedArm`.
//!
//! ```text
//! command ─▶ fresh? ─▶ target twist ─┐
//!                                    ├─▶ ramp, limits, joints ─▶ state
//! 150 ms of silence ─▶ target zero ──┘   in steps of 4 ms        100 Hz, 50 Hz while still
//! ```
//!
//! Live, the arm's time is the clock. In a lossless replay it is the time of the samples, so that the arm
//! ends where it would have ended, however fast the replay goes.

use std::os::fd::AsFd;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use tendon_arm::{GripperCommand as ArmGripper, SimulatedArm, Twist};
use tendon_config::Backend;
use tendon_messages::{
    COMMANDS, CommandHeader, GripperCommand, STATE_LENGTH, STATES, Stage, StateHeader, TWIST_LENGTH, Trace,
};
use tendon_process::{StageProcess, Wake};
use tendon_transport::{Delivery, Publisher, Received, Subscriber, now_ns};

/// Time between two states in motion, ns: the rate of the vendor's real-time report, 100 Hz. The steps since the
/// last one are made up for, so the motion is the same at any rate.
const MOVING_PERIOD_NS: u64 = 10_000_000;
/// Time between two states while nothing moves, ns. A command ends it.
const STILL_PERIOD_NS: u64 = 20_000_000;

fn main() -> ExitCode {
    tendon_process::main(Stage::Robot, |process| {
        let config = &process.config;
        let delivery = config.delivery();
        // The one place that knows which arm moves.
        let arm = match config.robot.backend {
            Backend::Simulate => SimulatedArm::new(config.robot.arm.clone(), start_of_time(delivery))?,
        };
        let never = Arc::new(AtomicBool::new(false));
        let robot = Robot {
            arm,
            states: Publisher::open(&process.session, &STATES, STATE_LENGTH, Delivery::Live, never)?,
            delivery,
            sample_rate_hz: config.acquisition.sample_rate_hz,
            state: StateHeader::default(),
        };
        let commands = Subscriber::open(&process.session, &COMMANDS, Some(Stage::Robot), delivery)?;
        process.connect(&commands)?;
        process.ready("simulated xArm7")?;
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
    arm: SimulatedArm,
    states: Publisher<StateHeader, f32>,
    delivery: Delivery,
    sample_rate_hz: f64,
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
        loop {
            let deadline_ns = match self.delivery {
                Delivery::Live => Some(tick_ns),
                Delivery::Lossless => process.measurements.deadline_ns(),
            };
            match process.control.wait(Some(commands.as_fd()), deadline_ns)? {
                Wake::Stop => break,
                Wake::Order(_) => {}
                Wake::Message => {
                    commands.acknowledge_wakes()?;
                    while let Some(command) = commands.receive()? {
                        self.take(process, &command)?;
                        process.measurements.counts.received = commands.received();
                        process.measurements.counts.lost = commands.lost();
                    }
                    // A command may have set the still arm in motion.
                    tick_ns = tick_ns.min(now_ns() + MOVING_PERIOD_NS);
                }
                Wake::Deadline if self.delivery == Delivery::Live => {
                    let now_ns = now_ns();
                    self.arm.tick(now_ns);
                    self.publish_state(process)?;
                    process.measurements.publish_if_due()?;
                    let period_ns = if self.arm.is_still() { STILL_PERIOD_NS } else { MOVING_PERIOD_NS };
                    // After a stall the ticks that were missed are not made up for.
                    tick_ns = (tick_ns + period_ns).max(now_ns);
                }
                Wake::Deadline => process.measurements.publish_if_due()?,
            }
        }
        self.arm.halt();
        self.publish_state(process)?;
        process.measurements.publish()
    }

    fn take(
        &mut self,
        process: &mut StageProcess,
        command: &Received<CommandHeader, f32>,
    ) -> anyhow::Result<()> {
        let trace = command.trace();
        let header = command.header();
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
            self.arm.tick(now_ns);
            let twist: &[f32; TWIST_LENGTH] = command
                .payload()
                .try_into()
                .with_context(|| format!("a command of {} components", command.payload().len()))?;
            let [x, y, z, about_x, about_y, about_z] = twist.map(f64::from);
            let twist = Twist { linear_mm_per_s: [x, y, z], angular_rad_per_s: [about_x, about_y, about_z] };
            if let Err(error) = self.arm.command(twist, now_ns) {
                tracing::error!("a command was refused and the arm stopped: {error}");
            }
            match GripperCommand::from_number(header.gripper) {
                GripperCommand::Keep => {}
                GripperCommand::Open => self.arm.command_gripper(ArmGripper::Open, now_ns),
                GripperCommand::Close => self.arm.command_gripper(ArmGripper::Close, now_ns),
            }
            self.state =
                StateHeader { trace, gesture: header.voted, confidence: header.confidence, ..self.state };
            if self.delivery == Delivery::Lossless {
                self.publish_state(process)?;
            }
        }
        let measurement = process.measure(&trace, None);
        process.measurements.record(measurement)
    }

    fn publish_state(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        let state = self.arm.state();
        let header = StateHeader {
            trace: Trace { sequence: 0, ..self.state.trace },
            speed_mm_per_s: state.linear_speed_mm_per_s as f32,
            gripper_position: state.gripper_position_pulses as f32,
            halted_by_watchdog: state.halted_by_watchdog.into(),
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
