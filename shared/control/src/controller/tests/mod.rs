//! Every way to stop the arm, in every phase, on an arm and a clock that are not there.

mod commands;
mod outdated;
mod start;
mod stops;
mod watch;

use tendon_gesture::Gesture;
use tendon_messages::{Activity, ArmPhase, Hindrance, WindowContext};

use super::*;
use crate::fake::FakeArm;

const REST_WINDOWS: u32 = 3;

const MS: u64 = 1_000_000;
const INCREMENT_MS: u64 = 76;
const UP: [f32; TWIST_LENGTH] = [0.0, 0.0, 100.0, 0.0, 0.0, 0.0];
const SIDEWAYS: [f32; TWIST_LENGTH] = [0.0, 100.0, 0.0, 0.0, 0.0, 0.0];
const STILL: [f32; TWIST_LENGTH] = [0.0; TWIST_LENGTH];

fn settings() -> ControlSettings {
    ControlSettings {
        arm: ArmSettings::default(),
        has_gripper: true,
        start_speed_rad_per_s: 10.0_f64.to_radians(),
        waits_at_start: false,
        needs_calibration: false,
        increment_samples: 150,
        rest_windows: REST_WINDOWS,
        stale_ns: Some(100 * MS),
    }
}

/// A controller, its arm, and the rest of the session.
struct Rig {
    controller: Controller,
    arm: FakeArm,
    now_ns: u64,
    supervisor_lives: bool,
    sequence: u64,
    first_sample: u64,
    gripper_toggles: u32,
    frame: TwistFrame,
    context: WindowContext,
}

impl Rig {
    fn new(settings: ControlSettings, joints_rad: JointVector, stopped: Option<StopReason>) -> Rig {
        let arm = FakeArm::at(&settings.arm, joints_rad);
        let controller = Controller::new(Box::new(arm.clone()), settings, stopped, 0);
        Rig {
            controller,
            arm,
            now_ns: 0,
            supervisor_lives: true,
            sequence: 0,
            first_sample: 0,
            gripper_toggles: 0,
            frame: TwistFrame::Base,
            context: WindowContext { activity: Activity::Rest as u8, ..WindowContext::default() },
        }
    }

    /// An arm some 70 mm from its start position, where it was left in good order.
    fn near() -> Rig {
        let mut joints_rad = ArmSettings::default().start_joints_rad();
        joints_rad[0] += 0.18;
        Rig::new(settings(), joints_rad, None)
    }

    /// An arm at its start position.
    fn at_start() -> Rig {
        Rig::new(settings(), ArmSettings::default().start_joints_rad(), None)
    }

    /// Ticks for so long. The record says that the arm was left in good order where it is.
    fn pass(&mut self, ms: u64) {
        for _ in 0..ms / 4 {
            self.now_ns += 4 * MS;
            if self.supervisor_lives {
                self.controller.hear_supervisor(self.now_ns);
            }
            self.controller.tick(self.now_ns);
            if self.controller.wants_departure(self.now_ns) {
                let left_rad = self.arm.0.borrow().joints_rad;
                self.controller.depart(Departure::LeftAt(left_rad), self.now_ns);
            }
        }
    }

    /// A window says this.
    fn command(&mut self, gesture: Gesture, twist: &[f32; TWIST_LENGTH]) -> Taken {
        let trace = Trace { sequence: self.sequence, captured_ns: self.now_ns, ..Trace::default() };
        let header = CommandHeader {
            trace,
            context: WindowContext { first_sample: self.first_sample, ..self.context },
            gesture: gesture.paper_number().unwrap(),
            voted: gesture.paper_number().unwrap(),
            gripper_toggles: self.gripper_toggles,
            frame: self.frame.number(),
            ..CommandHeader::default()
        };
        self.sequence += 1;
        self.first_sample += 150;
        self.controller.take(&header, twist, self.now_ns)
    }

    /// So many windows say this, one after the other.
    fn hold(&mut self, gesture: Gesture, twist: &[f32; TWIST_LENGTH], windows: u64) {
        for _ in 0..windows {
            self.command(gesture, twist);
            self.pass(INCREMENT_MS);
        }
    }

    fn rest(&mut self, windows: u64) {
        self.hold(Gesture::REST, &STILL, windows);
    }

    /// On the way to its start position, at full speed.
    fn on_the_way() -> Rig {
        let mut rig = Rig::near();
        rig.pass(600);
        assert_eq!(rig.phase(), ArmPhase::GoingToStart);
        assert!(rig.speed() > 50.0, "{}", rig.speed());
        rig
    }

    /// Following a gesture at full speed.
    fn moving() -> Rig {
        let mut rig = Rig::at_start();
        rig.pass(300);
        rig.rest(3);
        rig.hold(Gesture::ULNAR, &SIDEWAYS, 6);
        assert!(rig.speed() > 97.0, "{}", rig.speed());
        rig
    }

    fn state(&self) -> StateHeader {
        self.controller.state().header
    }

    fn phase(&self) -> ArmPhase {
        ArmPhase::from_number(self.state().arm_phase)
    }

    fn permission(&self) -> Permission {
        Permission::from_number(self.state().permission)
    }

    fn reason(&self) -> Option<StopReason> {
        StopReason::from_number(self.state().stop_reason)
    }

    fn speed(&self) -> f64 {
        self.arm.0.borrow().speed_mm_per_s()
    }

    /// The arm is at rest within 250 ms, and stays so through rests and gestures.
    fn assert_stopped(&mut self, reason: StopReason) {
        self.pass(250);
        assert_eq!((self.permission(), self.reason()), (Permission::Stopped, Some(reason)));
        assert!(!self.controller.is_in_good_order());
        let at = self.arm.0.borrow().joints_rad;
        self.gripper_toggles += 1;
        for _ in 0..3 {
            self.rest(5);
            self.hold(Gesture::ULNAR, &SIDEWAYS, 5);
        }
        assert_eq!(self.arm.0.borrow().joints_rad, at, "{reason:?}: it moved");
        assert_eq!(self.arm.0.borrow().gripper_target_pulses, None, "{reason:?}: its gripper moved");
        assert_eq!(self.arm.0.borrow().errors_cleared, 0);
        assert_eq!(self.reason(), Some(reason));
    }

    /// An order to arm of somebody who saw the arm at this time, as the robot process takes it.
    fn order_arm(&mut self, seen_ns: u64) -> Option<Outdated> {
        let outdated = self.controller.is_outdated(seen_ns, self.now_ns);
        if outdated.is_none() {
            self.controller.order_arm(self.now_ns);
        }
        outdated
    }

    /// `tendon arm`, and what it is answered.
    fn arm(&mut self) -> ArmAnswer {
        assert_eq!(self.order_arm(self.now_ns), None);
        for _ in 0..4000 {
            if let Some(answer) = self.controller.take_answer() {
                return answer;
            }
            self.pass(4);
        }
        panic!("never answered");
    }

    /// After `tendon arm` and a rest it follows again, from where it is.
    fn assert_arms(&mut self) {
        let at = self.arm.0.borrow().joints_rad;
        assert_eq!(self.arm(), ArmAnswer::Armed);
        self.hold(Gesture::ULNAR, &SIDEWAYS, 5);
        assert_eq!(self.arm.0.borrow().joints_rad, at, "it moved before a rest");
        self.rest(3);
        assert_eq!(self.permission(), Permission::Granted);
        self.hold(Gesture::ULNAR, &SIDEWAYS, 6);
        assert!(self.speed() > 50.0);
    }
}

/// What stops an arm until `tendon arm`, and how to do it.
type Cause = (StopReason, fn(&mut Rig));

const CAUSES: [Cause; 9] = [
    (StopReason::Ordered, |rig| _ = rig.controller.order_stop(rig.now_ns)),
    (StopReason::StageEnded, |rig| rig.controller.stage_ended(rig.now_ns)),
    (StopReason::ArmFault, |rig| rig.arm.0.borrow_mut().halt(Stop::by_fault(31))),
    (StopReason::NotReady, |rig| rig.arm.0.borrow_mut().halt(Stop::because(StopReason::NotReady))),
    (StopReason::TakenOver, |rig| rig.arm.0.borrow_mut().halt(Stop::because(StopReason::TakenOver))),
    (StopReason::VelocityRefused, |rig| {
        rig.arm.0.borrow_mut().halt(Stop::because(StopReason::VelocityRefused));
    }),
    (StopReason::ConnectionBroke, |rig| rig.arm.0.borrow_mut().report.link = Link::Connecting),
    (StopReason::ConnectionBroke, |rig| rig.arm.0.borrow_mut().report.silent_ns = 1001 * MS),
    (StopReason::OverSpeed, |rig| {
        rig.arm.0.borrow_mut().runaway.linear_mm_per_s[1] = 300.0;
        rig.pass(120);
        rig.arm.0.borrow_mut().runaway = Twist::ZERO;
    }),
];

/// The arm is well again: somebody has looked after it.
fn repair(rig: &mut Rig) {
    let mut arm = rig.arm.0.borrow_mut();
    arm.report.silent_ns = 0;
    arm.report.link = Link::Connected;
}
