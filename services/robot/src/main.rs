//! The robot process: commands in, motion and its state out. What may move when is decided by
//! [`tendon_control::Controller`]; this program gives it the topics, orders and the clock.
//!
//! ```text
//! commands, orders, heartbeat, time ─▶ Controller ─▶ arm: simulated, or an xArm7 ([`xarm`])
//!                                          └───────▶ states  250 Hz, 50 Hz while still
//! ```
//!
//! Live, the arm's time is the clock. In a lossless replay it is the time of the samples, so that the arm
//! ends where it would have ended, however fast the replay goes.

mod record;
mod xarm;

use std::os::fd::AsFd;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use tendon_arm::{JointVector, SimulatedArm};
use tendon_config::{Backend, Config, XArmSettings};
use tendon_control::{Arm, ControlSettings, Controller, Departure, State, Stop, StopAnswer, Taken};
use tendon_gesture::Strategy;
use tendon_messages::{
    COMMANDS, CommandHeader, STATE_LENGTH, STATES, Stage, StateHeader, StopReason, TWIST_LENGTH,
};
use tendon_paths::Claim;
use tendon_process::{Answer, Asker, Order, STALE_NS, StageProcess, Wake};
use tendon_transport::{Delivery, Publisher, Received, Subscriber, now_ns};

use crate::record::Records;
use crate::xarm::XArm;

/// Time between two ticks in motion, ns: 250 Hz, the rate of the vendor's controller.
const MOVING_PERIOD_NS: u64 = tendon_arm::STEP_NS;
/// Time between two ticks while nothing moves, ns. A command ends it.
const STILL_PERIOD_NS: u64 = 20_000_000;
/// How long the robot process of a session that was killed may take to stop the arm and end.
const LAST_OWNER: Duration = Duration::from_secs(3);
/// How long the arm may take to come to rest at the end, and for how long it must have been at rest, ns.
const LAST_STOP_NS: u64 = 1_500_000_000;
const AT_REST_NS: u64 = 200_000_000;
/// Joints that turn by less than this, in rad, between two looks are at rest.
const AT_REST_RAD: f64 = 2e-4;

fn main() -> ExitCode {
    tendon_process::main(Stage::Robot, |process| {
        let config = &process.config;
        let delivery = config.delivery();
        // The one place that knows which arm moves.
        let (arm, owned): (Box<dyn Arm>, _) = match config.robot.backend {
            Backend::Simulate => {
                (Box::new(SimulatedArm::new(config.robot.arm.clone(), start_of_time(delivery))?), None)
            }
            Backend::XArm => {
                let claims = vec![claim_address(&config.robot.xarm)?];
                let owned = Owned { records: Records::open()?, claims };
                (Box::new(XArm::connect(&config.robot.xarm, &config.robot.arm, now_ns())?), Some(owned))
            }
        };
        let settings =
            ControlSettings { waits_at_start: process.follows_on_session, ..control_settings(config) };
        let stopped = process.is_restarted.then_some(StopReason::StageEnded);
        let never = Arc::new(AtomicBool::new(false));
        let robot = Robot {
            controller: Controller::new(arm, settings, stopped, now_ns()),
            owned,
            states: Publisher::open(&process.session, &STATES, STATE_LENGTH, Delivery::Live, never)?,
            delivery,
            sample_rate_hz: config.acquisition.sample_rate_hz,
            is_introduced: false,
            taken: None,
            was_stopped: process.is_restarted,
            askers: Vec::new(),
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

fn control_settings(config: &Config) -> ControlSettings {
    let has_gripper = match config.robot.backend {
        Backend::Simulate => true,
        Backend::XArm => config.robot.xarm.gripper,
    };
    ControlSettings {
        arm: config.robot.arm.clone(),
        has_gripper,
        start_speed_rad_per_s: config.robot.xarm.start_speed_deg_per_s.to_radians(),
        waits_at_start: false,
        needs_calibration: config.decision.strategy == Strategy::Threshold,
        increment_samples: config.dsp.windows.increment_samples as u64,
        rest_windows: rest_windows(config),
        stale_ns: (config.delivery() == Delivery::Live).then_some(STALE_NS),
    }
}

/// Windows in a row that are a rest: three, and no less than 200 ms however often windows come.
fn rest_windows(config: &Config) -> u32 {
    const SHORTEST_REST_S: f64 = 0.2;
    let increment_s = config.dsp.windows.increment_samples as f64 / config.acquisition.sample_rate_hz;
    ((SHORTEST_REST_S / increment_s).ceil() as u32).max(3)
}

/// Makes this process the only one on this machine, of whatever user, that drives the arm at this address.
fn claim_address(xarm: &XArmSettings) -> anyhow::Result<Claim> {
    let address = xarm.address.context("robot.xarm.address is missing")?;
    // One arm has one name, however its address is written.
    let address = address.to_canonical();
    ensure!(
        !(address.is_unspecified() || address.is_multicast()),
        "robot.xarm.address = {address}: give the address of one arm"
    );
    let address = std::net::SocketAddr::new(address, xarm.control_port);
    claim(&format!("the arm at {address}"), &address.to_string())
}

fn claim(arm: &str, name: &str) -> anyhow::Result<Claim> {
    Claim::take_within(LAST_OWNER, &format!("tendon-arm-{name}"), "").with_context(|| {
        format!("{arm} is driven by another session: end that one first, or check robot.xarm.address")
    })
}

/// An arm on the network is this process's alone, and leaves a record.
struct Owned {
    records: Records,
    /// Of its address, and of its serial number once that is known. Held for as long as the process lives.
    claims: Vec<Claim>,
}

struct Robot {
    controller: Controller,
    /// With an arm on the network.
    owned: Option<Owned>,
    states: Publisher<StateHeader, f32>,
    delivery: Delivery,
    sample_rate_hz: f64,
    /// Whether the supervisor knows that the arm is ready.
    is_introduced: bool,
    /// The key of the arm that this session has taken: the record of how it was left was read and removed.
    taken: Option<String>,
    /// Whether somebody ordered a stop, or a stage ended: an arm that is not taken yet must be, so that no record is left.
    was_stopped: bool,
    /// Who waits for what comes of an order to arm.
    askers: Vec<Asker>,
}

impl Robot {
    fn run(
        mut self,
        process: &mut StageProcess,
        mut commands: Subscriber<CommandHeader, f32>,
    ) -> anyhow::Result<()> {
        let ended = self.drive(process, &mut commands);
        let left = self.leave(process);
        self.publish_state(process)?;
        process.measurements.publish()?;
        ended.and(left)
    }

    /// Takes what comes, until the process is to stop.
    fn drive(
        &mut self,
        process: &mut StageProcess,
        commands: &mut Subscriber<CommandHeader, f32>,
    ) -> anyhow::Result<()> {
        let mut tick_ns = now_ns();
        loop {
            self.introduce(process)?;
            let deadline_ns = match self.delivery {
                Delivery::Live => Some(tick_ns),
                Delivery::Lossless => process.measurements.deadline_ns(),
            };
            match process.control.wait(Some(commands.as_fd()), deadline_ns)? {
                Wake::Stop => return Ok(()),
                Wake::Order(order) => self.obey(process, order)?,
                Wake::Message => {
                    commands.acknowledge_wakes()?;
                    let was_still = self.controller.is_still();
                    while let Some(command) = commands.receive()? {
                        self.take(process, &command)?;
                        process.count(commands);
                    }
                    // A command that sets the still arm in motion goes out at once.
                    if was_still && !self.controller.is_still() {
                        tick_ns = now_ns();
                    }
                }
                Wake::Deadline if self.delivery == Delivery::Live => {
                    self.tick(process, tick_ns)?;
                    let period_ns =
                        if self.controller.is_still() { STILL_PERIOD_NS } else { MOVING_PERIOD_NS };
                    // After a stall the ticks that were missed are not made up for.
                    tick_ns = (tick_ns + period_ns).max(now_ns());
                }
                Wake::Deadline => process.measurements.publish_if_due()?,
            }
            if let Some(violation) = self.controller.take_violation() {
                tracing::warn!("the arm is stopped: {violation}");
            }
        }
    }

    /// Tells the supervisor once that the arm is ready, or that it waits for `tendon arm`.
    ///
    /// # Errors
    ///
    /// When the arm cannot be reached.
    fn introduce(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        if self.is_introduced {
            return Ok(());
        }
        if self.controller.is_ready() || process.is_restarted || self.delivery == Delivery::Lossless {
            self.is_introduced = true;
            return Ok(process.ready(&self.controller.description())?);
        }
        match self.controller.failure() {
            None => Ok(()),
            Some(stop) => bail!("{} did not get ready: {}", self.controller.description(), self.words(stop)),
        }
    }

    /// One step of the arm's time.
    fn tick(&mut self, process: &mut StageProcess, due_ns: u64) -> anyhow::Result<()> {
        let now_ns = now_ns();
        if !self.controller.is_still() {
            process.measurements.record_tick(now_ns.saturating_sub(due_ns))?;
        }
        self.controller.tick(now_ns);
        self.check_arm()?;
        if self.controller.wants_departure(now_ns) {
            let departure = self.take_record()?;
            self.controller.depart(departure, now_ns);
        } else if self.was_stopped && self.taken.is_none() && self.controller.is_connected() {
            self.take_record()?;
        }
        self.answer(process);
        if let Some(took_ns) = self.controller.command_to_wire_ns() {
            process.measurements.record_command_to_wire(took_ns)?;
        }
        self.publish_state(process)?;
        Ok(process.measurements.publish_if_due()?)
    }

    /// Reads and removes the record of how the arm was left, before anything moves.
    ///
    /// # Errors
    ///
    /// When it cannot be removed, or when the arm is driven by another session that knows it by another address.
    fn take_record(&mut self) -> anyhow::Result<Departure> {
        let key = self.taken.insert(self.controller.key().to_owned());
        let Some(owned) = &mut self.owned else { return Ok(Departure::NoRecord) };
        owned.claims.push(claim(&format!("the arm {key}"), &format!("serial-{key}"))?);
        owned.records.take(key)
    }

    /// Whether the arm that answers is still the one that was taken.
    ///
    /// # Errors
    ///
    /// When it is another: this session has not claimed it, and does not know its joint limits nor how it was left.
    fn check_arm(&self) -> anyhow::Result<()> {
        match &self.taken {
            Some(taken) if self.controller.is_connected() && self.controller.key() != taken => bail!(
                "another arm ({}) answers instead of {taken}: check robot.xarm.address. It moves only after `tendon arm` (key \
                 a)",
                self.controller.key()
            ),
            _ => Ok(()),
        }
    }

    fn obey(&mut self, process: &mut StageProcess, order: Order) -> anyhow::Result<()> {
        match order {
            Order::Alive => self.controller.hear_supervisor(now_ns()),
            Order::Stop => {
                self.was_stopped = true;
                let answer = self.controller.order_stop(now_ns());
                if let Some(asker) = process.control.take_asker() {
                    process.control.answer(&asker, &stop_answer(answer));
                }
            }
            Order::Arm { seen_ns } => self.arm(process, seen_ns)?,
            Order::StageEnded => {
                self.was_stopped = true;
                self.controller.stage_ended(now_ns());
            }
            Order::Start | Order::Gesture { .. } | Order::Mode(_) => {}
        }
        self.answer(process);
        Ok(())
    }

    /// Obeys an order to arm, unless it is outdated: of that only its sender is told.
    fn arm(&mut self, process: &mut StageProcess, seen_ns: u64) -> anyhow::Result<()> {
        let asker = process.control.take_asker();
        if let Some(outdated) = self.controller.is_outdated(seen_ns, now_ns()) {
            match asker {
                Some(asker) => process.control.answer(&asker, &not_armed(outdated.text())),
                None => tracing::warn!("{}", outdated.text()),
            }
            return Ok(());
        }
        self.check_arm()?;
        if self.taken.is_none() && self.controller.is_connected() {
            self.take_record()?;
        }
        self.askers.extend(asker);
        self.controller.order_arm(now_ns());
        Ok(())
    }

    /// Tells those who ordered to arm what came of it, once that is known.
    fn answer(&mut self, process: &mut StageProcess) {
        if let Some(answer) = self.controller.take_answer() {
            let text = answer.text(|stop| self.words(stop));
            // By a key: nobody else waits to be told.
            if self.askers.is_empty() && !answer.is_success() {
                tracing::warn!("{text}");
            }
            let answer = if answer.is_success() { Answer::done(text) } else { not_armed(text) };
            for asker in self.askers.drain(..) {
                process.control.answer(&asker, &answer);
            }
        }
    }

    fn take(
        &mut self,
        process: &mut StageProcess,
        command: &Received<CommandHeader, f32>,
    ) -> anyhow::Result<()> {
        let trace = command.trace();
        let header = CommandHeader { trace, ..*command.header() };
        let length = command.payload().len();
        let twist: &[f32; TWIST_LENGTH] =
            command.payload().try_into().with_context(|| format!("a command of {length} components"))?;
        let now_ns = match self.delivery {
            Delivery::Live => now_ns(),
            Delivery::Lossless => {
                let sample = header.context.first_sample as f64;
                (sample * 1e9 / self.sample_rate_hz) as u64
            }
        };
        match self.controller.take(&header, twist, now_ns) {
            Taken::Stale => process.measurements.counts.stale += 1,
            Taken::Fresh if self.delivery == Delivery::Lossless => self.publish_state(process)?,
            Taken::Fresh => {}
        }
        let measurement = process.measure(&trace, None);
        Ok(process.measurements.record(measurement)?)
    }

    /// Stops the arm, and leaves a record if everything is in good order and the arm is at rest. If there was an order to
    /// stop, or the supervisor is gone, no record is left, even if it is not known which arm is there.
    fn leave(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        // Nor does one linger whose supervisor is gone: the next session may have the same name.
        let is_in_good_order = self.controller.is_in_good_order() && !process.control.is_abandoned();
        self.controller.end();
        let rest = if is_in_good_order && self.owned.is_some() { self.wait_for_rest(process)? } else { None };
        // So that an order to stop is either heard now, or refused.
        process.control.stop_listening();
        let is_stopped_now = self.obey_last_stop(process)?;
        for asker in self.askers.drain(..) {
            process.control.answer(&asker, &not_armed("not armed: the session is ending"));
        }
        // A supervisor that is gone was killed, or crashed.
        let is_abandoned = process.control.is_abandoned();
        let Some(owned) = &mut self.owned else { return Ok(()) };
        match (&self.taken, rest) {
            (Some(taken), Some(joints_rad)) if !is_stopped_now && !is_abandoned => {
                owned.records.leave(taken, &joints_rad)
            }
            (None, _) if self.was_stopped || is_abandoned => {
                if self.controller.is_connected() {
                    owned.records.take(self.controller.key()).map(drop)
                } else {
                    owned.records.forget_all()
                }
            }
            _ => Ok(()),
        }
    }

    /// Waits until the arm is at rest; gives its joint angles in rad, or `None` if it is not in good order any more, as
    /// after an order to stop.
    fn wait_for_rest(&mut self, process: &mut StageProcess) -> anyhow::Result<Option<JointVector>> {
        let begun_ns = now_ns();
        let mut rest: Option<(u64, JointVector)> = None;
        while now_ns().saturating_sub(begun_ns) < LAST_STOP_NS {
            std::thread::sleep(Duration::from_nanos(STILL_PERIOD_NS));
            if self.obey_last_stop(process)? || process.control.is_abandoned() {
                return Ok(None);
            }
            let now_ns = now_ns();
            let Some(joints_rad) = self.controller.at_the_end(now_ns) else { return Ok(None) };
            match rest {
                Some((since_ns, at_rad)) if (joints_rad - at_rad).amax() <= AT_REST_RAD => {
                    if now_ns.saturating_sub(since_ns) >= AT_REST_NS {
                        return Ok(Some(joints_rad));
                    }
                }
                _ => rest = Some((now_ns, joints_rad)),
            }
        }
        Ok(None)
    }

    /// Obeys and answers the orders to stop that have come while the process ends; whether there was one.
    fn obey_last_stop(&mut self, process: &mut StageProcess) -> anyhow::Result<bool> {
        let mut is_stopped = false;
        while let Some(order) = process.control.last_stop()? {
            self.obey(process, order)?;
            is_stopped = true;
        }
        Ok(is_stopped)
    }

    /// Why the arm stopped, and what to do.
    fn words(&self, stop: Stop) -> String {
        if let Some(fault) = tendon_xarm::Fault::new(tendon_xarm::Source::Controller, stop.fault_code) {
            return fault.to_string();
        }
        self.controller.explanation(stop.reason).unwrap_or_else(|| stop.reason.to_string())
    }

    fn publish_state(&mut self, process: &mut StageProcess) -> anyhow::Result<()> {
        let State { header, payload } = self.controller.state();
        self.states.publish(header, STATE_LENGTH, |components| components.copy_from_slice(&payload))?;
        process.measurements.counts.published = self.states.published();
        Ok(())
    }
}

fn stop_answer(answer: StopAnswer) -> Answer {
    match answer {
        StopAnswer::Stopped => Answer::done(answer.text()),
        StopAnswer::NotConnected | StopAnswer::ArmSilent => {
            Answer::refused(answer.text()).with_key("not-confirmed")
        }
    }
}

fn not_armed(text: impl Into<String>) -> Answer {
    Answer::refused(text).with_key("not-armed")
}
