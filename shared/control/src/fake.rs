//! An arm for tests: it moves as told, and misbehaves as told.

use std::cell::RefCell;
use std::rc::Rc;

use tendon_arm::velocity::joint_velocities;
use tendon_arm::{ArmSettings, JointLimits, JointVector, Motion, NonFiniteTwist, STEP_NS, Twist, XArm7};

use crate::arm::{Arm, ArmReport, Drive, Link, Stop};

/// Velocities of joints last so long.
const DURATION_NS: u64 = 150_000_000;
/// Bringing up takes so long.
const BRING_UP_NS: u64 = 100_000_000;
const STEP_S: f64 = 4e-3;

/// What a [`FakeArm`] is, in the hands of its test.
pub(crate) struct Body {
    kinematics: XArm7,
    pub motion: Motion,
    pub report: ArmReport,
    pub joints_rad: JointVector,
    pub limits: JointLimits,
    joint_rates: JointVector,
    rates_end_ns: u64,
    up_at: Option<(u64, Drive)>,
    /// Why the next bring-up fails.
    pub refuses: Option<Stop>,
    /// The flange moves like this, whatever it is told.
    pub runaway: Twist,
    /// Nothing moves, whatever it is told.
    pub is_held: bool,
    /// It reports these joint angles (rad), wherever it is.
    pub frozen_at_rad: Option<JointVector>,
    pub gripper_target_pulses: Option<f64>,
    pub stops: u32,
    pub errors_cleared: u32,
    now_ns: u64,
}

impl Body {
    /// Speed of the flange in the last step.
    pub fn speed_mm_per_s(&self) -> f64 {
        self.report.speed_mm_per_s
    }

    pub fn position_mm(&self) -> [f64; 3] {
        (self.kinematics.flange_pose_m(&self.joints_rad).translation.vector * 1e3).into()
    }

    /// The arm is out of motion.
    pub fn halt(&mut self, stop: Stop) {
        self.report.link = Link::Connected;
        self.report.stop = Some(stop);
        if stop.fault_code > 0 {
            self.report.error_code = Some(stop.fault_code);
        }
        self.up_at = None;
        self.motion.halt();
    }

    /// What the last order to bring it up has begun takes for ever.
    pub fn never_comes_up(&mut self) {
        self.up_at = None;
    }

    fn step(&mut self) {
        if let Some((at_ns, drive)) = self.up_at.filter(|(at_ns, _)| self.now_ns >= *at_ns) {
            let _ = at_ns;
            self.up_at = None;
            match self.refuses.or(self.report.error_code.map(Stop::by_fault)) {
                Some(stop) => self.halt(stop),
                None => self.report.link = Link::Up(drive),
            }
        }
        let mut rates = JointVector::zeros();
        match self.report.link {
            Link::Up(Drive::Joints) if self.now_ns < self.rates_end_ns => rates = self.joint_rates,
            Link::Up(Drive::Flange) => {
                let twist = self.motion.advance(self.now_ns, &self.joints_rad);
                rates = joint_velocities(&self.kinematics, &self.joints_rad, &twist).rad_per_s;
            }
            _ => {}
        }
        rates += joint_velocities(&self.kinematics, &self.joints_rad, &self.runaway).rad_per_s;
        if self.is_held {
            rates = JointVector::zeros();
        }
        let before = self.position_mm();
        self.joints_rad += rates * STEP_S;
        let moved = self.position_mm();
        let way = (0..3).map(|axis| (moved[axis] - before[axis]).powi(2)).sum::<f64>().sqrt();
        self.report.speed_mm_per_s = way / STEP_S;
        self.now_ns += STEP_NS;
    }
}

#[derive(Clone)]
pub(crate) struct FakeArm(pub Rc<RefCell<Body>>);

impl FakeArm {
    /// A connected arm at these joint angles in rad.
    pub fn at(settings: &ArmSettings, joints_rad: JointVector) -> FakeArm {
        FakeArm(Rc::new(RefCell::new(Body {
            kinematics: XArm7::new(),
            motion: Motion::new(settings),
            report: ArmReport { link: Link::Connected, gripper_pulses: Some(850.0), ..ArmReport::default() },
            joints_rad,
            limits: JointLimits::default(),
            joint_rates: JointVector::zeros(),
            rates_end_ns: 0,
            up_at: None,
            refuses: None,
            runaway: Twist::ZERO,
            is_held: false,
            frozen_at_rad: None,
            gripper_target_pulses: None,
            stops: 0,
            errors_cleared: 0,
            now_ns: 0,
        })))
    }
}

impl Arm for FakeArm {
    fn description(&self) -> String {
        "an arm for tests".to_owned()
    }

    fn key(&self) -> &str {
        "an arm for tests"
    }

    fn explanation(&self) -> Option<String> {
        None
    }

    fn joint_limits(&self) -> JointLimits {
        self.0.borrow().limits
    }

    fn tick(&mut self, now_ns: u64) {
        let mut body = self.0.borrow_mut();
        while body.now_ns + STEP_NS <= now_ns {
            body.step();
        }
    }

    fn report(&self) -> ArmReport {
        let body = self.0.borrow();
        ArmReport {
            joints_rad: Some(body.frozen_at_rad.unwrap_or(body.joints_rad)),
            told: body.motion.velocity(),
            halted_by_watchdog: body.motion.halted_by_watchdog(),
            obstacle: body.motion.obstacle(),
            ..body.report
        }
    }

    fn bring_up(&mut self, drive: Drive, acknowledges_error: bool, now_ns: u64) {
        let mut body = self.0.borrow_mut();
        if acknowledges_error && body.report.error_code.take().is_some() {
            body.errors_cleared += 1;
        }
        body.report.link = Link::BringingUp;
        body.report.is_stopped = false;
        body.report.stop = None;
        body.up_at = Some((now_ns + BRING_UP_NS, drive));
        body.motion.halt();
    }

    fn follow_joints(&mut self, velocities_rad_per_s: &JointVector) {
        let mut body = self.0.borrow_mut();
        body.joint_rates = *velocities_rad_per_s;
        body.rates_end_ns = body.now_ns + DURATION_NS;
    }

    fn command(&mut self, twist: Twist, now_ns: u64) -> Result<(), NonFiniteTwist> {
        self.0.borrow_mut().motion.command(twist, now_ns)
    }

    fn command_to_wire_ns(&mut self) -> Option<u64> {
        None
    }

    fn move_gripper(&mut self, pulses: f64, _now_ns: u64) {
        self.0.borrow_mut().gripper_target_pulses = Some(pulses);
    }

    fn rest(&mut self) {
        self.0.borrow_mut().motion.stop();
    }

    fn stop(&mut self) {
        let mut body = self.0.borrow_mut();
        body.stops += 1;
        body.report.is_stopped = true;
        body.gripper_target_pulses = None;
        body.motion.halt();
        if body.report.link != Link::Connecting {
            body.report.link = Link::Connected;
        }
        body.up_at = None;
    }

    fn stalled(&mut self) {
        self.0.borrow_mut().motion.halt();
    }

    fn is_still(&self) -> bool {
        let body = self.0.borrow();
        body.motion.is_still() && body.up_at.is_none() && !matches!(body.report.link, Link::Up(Drive::Joints))
    }
}
