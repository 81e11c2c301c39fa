//! Every way to stop the arm, in every phase, on an arm and a clock that are not there.

use tendon_gesture::Gesture;
use tendon_messages::{Activity, WindowContext};

use super::*;
use crate::fake::FakeArm;

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
        needs_calibration: false,
        increment_samples: 150,
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
    context: WindowContext,
}

impl Rig {
    fn new(settings: ControlSettings, joints_rad: JointVector, stopped: Option<StopReason>) -> Rig {
        let arm = FakeArm::at(&settings.arm, joints_rad);
        let controller = Controller::new(Box::new(arm.clone()), settings, stopped);
        Rig {
            controller,
            arm,
            now_ns: 0,
            supervisor_lives: true,
            sequence: 0,
            first_sample: 0,
            gripper_toggles: 0,
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
            gesture: gesture as u8,
            voted: gesture as u8,
            gripper_toggles: self.gripper_toggles,
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
        self.hold(Gesture::Rest, &STILL, windows);
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
        rig.hold(Gesture::Ulnar, &SIDEWAYS, 6);
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
            self.hold(Gesture::Ulnar, &SIDEWAYS, 5);
        }
        assert_eq!(self.arm.0.borrow().joints_rad, at, "{reason:?}: it moved");
        assert_eq!(self.arm.0.borrow().gripper_target_pulses, None, "{reason:?}: its gripper moved");
        assert_eq!(self.arm.0.borrow().errors_cleared, 0);
        assert_eq!(self.reason(), Some(reason));
    }

    /// `tendon arm`, and what it is answered.
    fn arm(&mut self) -> ArmAnswer {
        self.controller.order_arm(self.now_ns);
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
        self.hold(Gesture::Ulnar, &SIDEWAYS, 5);
        assert_eq!(self.arm.0.borrow().joints_rad, at, "it moved before a rest");
        self.rest(3);
        assert_eq!(self.permission(), Permission::Granted);
        self.hold(Gesture::Ulnar, &SIDEWAYS, 6);
        assert!(self.speed() > 50.0);
    }
}

/// What stops an arm until `tendon arm`, and how to do it.
type Cause = (StopReason, fn(&mut Rig));

const CAUSES: [Cause; 9] = [
    (StopReason::Ordered, |rig| rig.controller.order_stop()),
    (StopReason::StageEnded, |rig| rig.controller.stage_ended()),
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

#[test]
fn an_arm_left_in_good_order_goes_to_its_start_position_and_waits_for_a_rest() {
    let mut rig = Rig::on_the_way();
    assert!(rig.state().start_distance_mm > 1.0);
    rig.pass(5000);
    assert_eq!((rig.phase(), rig.permission()), (ArmPhase::Following, Permission::AwaitRest));
    assert!(rig.controller.is_in_good_order());
    assert!((rig.arm.0.borrow().joints_rad - ArmSettings::default().start_joints_rad()).amax() < 0.003);
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 10);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 6);
    assert!(rig.speed() > 97.0);
    assert_eq!(rig.state().start_distance_mm, 0.0);
}

#[test]
fn whatever_stops_the_arm_on_the_way_to_its_start_stops_it_until_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::on_the_way();
        cause(&mut rig);
        rig.assert_stopped(reason);
        repair(&mut rig);
        // From where it is: not a step of the way that was left.
        rig.assert_arms();
    }
}

#[test]
fn whatever_stops_the_arm_while_it_follows_stops_it_until_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::moving();
        cause(&mut rig);
        rig.assert_stopped(reason);
        repair(&mut rig);
        rig.assert_arms();
    }
}

#[test]
fn whatever_stops_the_arm_while_it_is_brought_up_stops_it_until_it_is_armed() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::near();
        rig.pass(60);
        assert_eq!(rig.phase(), ArmPhase::BringingUp);
        if matches!(reason, StopReason::OverSpeed) || rig.arm.0.borrow().report.link != Link::BringingUp {
            continue;
        }
        cause(&mut rig);
        if rig.arm.0.borrow().report.silent_ns > 0 {
            // Switching motors on takes the arm longer than this without a word.
            continue;
        }
        rig.assert_stopped(reason);
        repair(&mut rig);
        rig.assert_arms();
    }
}

#[test]
fn while_stopped_the_first_reason_stays_but_for_an_error_of_the_arm_and_nothing_moves() {
    for (reason, cause) in CAUSES {
        let mut rig = Rig::moving();
        rig.controller.order_stop();
        rig.pass(300);
        cause(&mut rig);
        rig.pass(100);
        assert_eq!(rig.permission(), Permission::Stopped);
        let shown = if reason == StopReason::ArmFault { reason } else { StopReason::Ordered };
        assert_eq!(rig.reason(), Some(shown), "{reason:?}");
    }
}

#[test]
fn a_supervisor_that_hangs_stops_the_arm_in_every_phase() {
    let mut rig = Rig::on_the_way();
    rig.supervisor_lives = false;
    rig.pass(250);
    rig.assert_stopped(StopReason::SupervisorSilent);
    assert_eq!(rig.arm(), ArmAnswer::SupervisorSilent);
    rig.supervisor_lives = true;
    rig.pass(4);
    rig.assert_arms();

    let mut rig = Rig::moving();
    rig.supervisor_lives = false;
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 4);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::SupervisorSilent)));
    assert_eq!(rig.speed(), 0.0);
    rig.rest(5);
    assert_eq!(rig.permission(), Permission::AwaitRest, "no rest counts while nobody can press a key");
    rig.supervisor_lives = true;
    rig.rest(4);
    assert_eq!(rig.permission(), Permission::Granted);

    let mut rig = Rig::near();
    rig.supervisor_lives = false;
    rig.pass(2000);
    assert_eq!(rig.phase(), ArmPhase::Waiting, "without a supervisor it never sets out");
    assert_eq!(rig.arm.0.borrow().report.link, Link::Connected);
}

#[test]
fn an_arm_that_gives_no_sign_of_life_for_300_ms_is_brought_to_rest() {
    let mut rig = Rig::moving();
    rig.arm.0.borrow_mut().report.silent_ns = 301 * MS;
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 2);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::ArmSilent)));
    assert_eq!(rig.speed(), 0.0);
    rig.arm.0.borrow_mut().report.silent_ns = 0;
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 3);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 6);
    assert!(rig.speed() > 97.0);

    let mut rig = Rig::on_the_way();
    rig.arm.0.borrow_mut().report.silent_ns = 301 * MS;
    rig.assert_stopped(StopReason::ArmSilent);
}

#[test]
fn no_fresh_command_is_a_rest_after_the_watchdogs_time() {
    let mut rig = Rig::moving();
    rig.pass(150 + 80 - INCREMENT_MS + 8);
    assert_eq!(rig.speed(), 0.0);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::NoCommands)));
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 4);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    assert_eq!(rig.permission(), Permission::Granted);
}

#[test]
fn stale_commands_are_not_acted_on() {
    let mut rig = Rig::moving();
    for _ in 0..4 {
        let captured_ns = rig.now_ns;
        rig.pass(INCREMENT_MS);
        let header = CommandHeader {
            trace: Trace { sequence: rig.sequence, captured_ns: captured_ns - 30 * MS, ..Trace::default() },
            gesture: Gesture::Ulnar as u8,
            ..CommandHeader::default()
        };
        rig.sequence += 1;
        assert_eq!(rig.controller.take(&header, &SIDEWAYS, rig.now_ns), Taken::Stale);
    }
    assert_eq!(rig.speed(), 0.0);
    assert_eq!(rig.reason(), Some(StopReason::NoCommands));
}

#[test]
fn a_controller_that_stood_still_does_not_go_on_where_it_was() {
    let mut rig = Rig::moving();
    rig.now_ns += 300 * MS;
    rig.pass(4);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::RobotStalled)));
    rig.hold(Gesture::Ulnar, &SIDEWAYS, 4);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    assert_eq!(rig.permission(), Permission::Granted);

    let mut rig = Rig::on_the_way();
    rig.now_ns += 300 * MS;
    rig.assert_stopped(StopReason::RobotStalled);
    rig.assert_arms();
}

#[test]
fn commands_of_a_decision_process_that_began_anew_stop_the_arm() {
    let mut rig = Rig::moving();
    rig.sequence = 0;
    rig.command(Gesture::Ulnar, &SIDEWAYS);
    rig.assert_stopped(StopReason::StageEnded);
}

#[test]
fn a_gap_a_stale_and_a_lost_command_start_the_count_of_rests_again() {
    let breaks: [fn(&mut Rig); 5] = [
        |rig| rig.sequence += 1,
        |rig| rig.first_sample += 150,
        |rig| rig.first_sample -= 300,
        |rig| rig.now_ns += 120 * MS,
        |rig| {
            let header = CommandHeader {
                trace: Trace { sequence: rig.sequence, captured_ns: 1, ..Trace::default() },
                context: WindowContext { first_sample: rig.first_sample, ..rig.context },
                ..CommandHeader::default()
            };
            rig.sequence += 1;
            rig.first_sample += 150;
            assert_eq!(rig.controller.take(&header, &STILL, rig.now_ns), Taken::Stale);
        },
    ];
    for (index, broken) in breaks.into_iter().enumerate() {
        let mut rig = Rig::at_start();
        rig.pass(300);
        rig.rest(2);
        broken(&mut rig);
        rig.rest(1);
        assert_eq!(rig.permission(), Permission::AwaitRest, "break {index}");
        rig.rest(1);
        assert_eq!(rig.permission(), Permission::AwaitRest, "break {index}");
        rig.rest(2);
        assert_eq!(rig.permission(), Permission::Granted, "break {index}");
    }
}

#[test]
fn an_arm_that_another_program_sets_running_at_the_end_leaves_no_record() {
    let mut rig = Rig::moving();
    rig.rest(5);
    assert!(rig.controller.is_in_good_order());
    rig.controller.end();
    assert!(rig.controller.at_the_end(rig.now_ns).is_some());
    rig.arm.0.borrow_mut().report.is_stopped = false;
    assert_eq!(rig.controller.at_the_end(rig.now_ns), None);
}

#[test]
fn an_arm_without_a_fitting_record_waits_and_then_follows_from_where_it_is() {
    let moved = ArmSettings::default().start_joints_rad().add_scalar(0.05);
    for (departure, reason) in [
        (Departure::NoRecord, StopReason::NotLeftInGoodOrder),
        (Departure::Unusable, StopReason::RecordUnusable),
        (Departure::LeftAt(moved), StopReason::MovedSince),
    ] {
        let mut rig = Rig::near();
        rig.supervisor_lives = false;
        rig.pass(8);
        rig.controller.hear_supervisor(rig.now_ns);
        assert!(rig.controller.wants_departure(rig.now_ns));
        rig.controller.depart(departure, rig.now_ns);
        rig.supervisor_lives = true;
        rig.assert_stopped(reason);
        assert!(rig.controller.is_ready());
        rig.assert_arms();
        assert!(rig.controller.is_in_good_order());
    }
}

#[test]
fn an_error_that_nobody_acknowledged_is_never_cleared_by_the_program() {
    let mut rig = Rig::near();
    rig.arm.0.borrow_mut().report.error_code = Some(31);
    rig.pass(1000);
    assert_eq!(rig.state().fault_code, 31);
    rig.assert_stopped(StopReason::ArmFault);
    rig.assert_arms();
    assert_eq!(rig.arm.0.borrow().errors_cleared, 1);
    // Nor one that comes while the arm changes from joints to the flange.
    let mut rig = Rig::near();
    while rig.phase() != ArmPhase::GoingToStart {
        rig.pass(4);
    }
    while rig.phase() == ArmPhase::GoingToStart {
        rig.pass(4);
    }
    rig.arm.0.borrow_mut().report.error_code = Some(22);
    rig.pass(1000);
    assert_eq!(rig.state().fault_code, 22);
    rig.assert_stopped(StopReason::ArmFault);
}

#[test]
fn a_start_position_that_is_far_away_asks_first_and_says_how_far() {
    let turned = |by_deg: f64| {
        let mut joints_rad = ArmSettings::default().start_joints_rad();
        joints_rad[0] += by_deg.to_radians();
        Rig::new(settings(), joints_rad, None)
    };
    let mut rig = turned(30.0);
    rig.pass(100);
    let distance_mm = f64::from(rig.state().start_distance_mm);
    assert!((distance_mm - 2.0 * 386.0 * 15.0_f64.to_radians().sin()).abs() < 1.0, "{distance_mm}");
    rig.assert_stopped(StopReason::StartIsFar);
    // The question is whether it may go there.
    assert_eq!(rig.arm(), ArmAnswer::GoingToStart);
    rig.pass(10_000);
    assert_eq!((rig.phase(), rig.permission()), (ArmPhase::Following, Permission::AwaitRest));
    assert!(rig.state().start_distance_mm < 2.0);
    // Stopped on this way it is not sent on.
    let mut rig = turned(30.0);
    rig.pass(100);
    rig.arm();
    rig.pass(600);
    rig.controller.order_stop();
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();

    // Nor after a stop, or an error, while it waited: more than the distance is in question then.
    let mut rig = turned(30.0);
    rig.pass(100);
    rig.controller.order_stop();
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();
    let mut rig = turned(30.0);
    rig.pass(100);
    rig.arm.0.borrow_mut().report.error_code = Some(1);
    rig.assert_stopped(StopReason::ArmFault);
    rig.assert_arms();

    let mut rig = turned(-350.0);
    rig.pass(100);
    rig.assert_stopped(StopReason::WayLeavesBox);
    rig.assert_arms();
}

#[test]
fn the_workspace_box_holds_while_following_and_the_arm_can_be_driven_back() {
    let mut settings = settings();
    settings.arm.workspace_max_mm[2] = 370.0;
    let mut rig = Rig::new(settings, ArmSettings::default().start_joints_rad(), None);
    rig.pass(300);
    rig.rest(3);
    // Too slow to look like an arm that does not follow.
    rig.arm.0.borrow_mut().runaway.linear_mm_per_s = [0.0, 0.0, 15.0];
    while rig.permission() != Permission::Stopped {
        rig.hold(Gesture::Ulnar, &SIDEWAYS, 1);
    }
    rig.arm.0.borrow_mut().runaway = Twist::ZERO;
    rig.assert_stopped(StopReason::WorkspaceBox);
    assert_eq!(rig.arm(), ArmAnswer::Armed);
    rig.rest(3);
    rig.hold(Gesture::Ulnar, &UP.map(|component| -component), 6);
    assert!(rig.speed() > 50.0 && rig.arm.0.borrow().position_mm()[2] < 370.0);
}

#[test]
fn an_arm_that_creeps_at_commanded_rest_is_stopped() {
    for speed_mm_per_s in [20.0, 60.0, 150.0] {
        let mut rig = Rig::at_start();
        rig.pass(300);
        rig.rest(20);
        let from_mm = rig.arm.0.borrow().position_mm()[1];
        rig.arm.0.borrow_mut().runaway.linear_mm_per_s[1] = speed_mm_per_s;
        let begun_ns = rig.now_ns;
        while rig.permission() != Permission::Stopped {
            rig.rest(1);
            assert!(rig.now_ns - begun_ns < 400 * MS, "{speed_mm_per_s}");
        }
        let crept_mm = rig.arm.0.borrow().position_mm()[1] - from_mm;
        assert!(crept_mm < 0.2 * speed_mm_per_s, "{crept_mm}");
        rig.arm.0.borrow_mut().runaway = Twist::ZERO;
        rig.assert_stopped(StopReason::Creeping);
    }
    // One that brakes and then stands does not.
    let mut rig = Rig::moving();
    rig.rest(30);
    assert_eq!(rig.permission(), Permission::Granted);
}

#[test]
fn an_arm_that_does_not_move_as_it_is_told_is_stopped_before_it_is_far() {
    // Up or forward instead of sideways, or held where it is.
    for (runaway, axis, at_most_mm) in
        [([0.0, 0.0, 80.0], 2, 25.0), ([80.0, 0.0, 0.0], 0, 25.0), ([0.0, -100.0, 0.0], 1, 10.0)]
    {
        let mut rig = Rig::moving();
        rig.hold(Gesture::Ulnar, &SIDEWAYS, 4);
        let from_mm = rig.arm.0.borrow().position_mm();
        let begun_ns = rig.now_ns;
        rig.arm.0.borrow_mut().runaway.linear_mm_per_s = runaway;
        while rig.permission() != Permission::Stopped {
            rig.hold(Gesture::Ulnar, &SIDEWAYS, 1);
            assert!(rig.now_ns - begun_ns < 700 * MS, "{runaway:?}");
        }
        let off_mm = (rig.arm.0.borrow().position_mm()[axis] - from_mm[axis]).abs();
        assert!(off_mm < at_most_mm, "{runaway:?}: {off_mm} mm");
        rig.arm.0.borrow_mut().runaway = Twist::ZERO;
        rig.assert_stopped(StopReason::NotFollowing);
    }
    let mut rig = Rig::on_the_way();
    rig.arm.0.borrow_mut().runaway.linear_mm_per_s = [0.0, 0.0, 150.0];
    rig.pass(400);
    rig.arm.0.borrow_mut().runaway = Twist::ZERO;
    let reason = rig.reason();
    assert!(matches!(reason, Some(StopReason::NotFollowing | StopReason::OverSpeed)), "{reason:?}");
    rig.assert_stopped(reason.unwrap());
}

#[test]
fn the_joint_limits_are_those_of_the_arm_that_is_there() {
    let mut rig = Rig::moving();
    assert_eq!(rig.permission(), Permission::Granted);
    let mut rig_of_narrow_arm = Rig::at_start();
    rig_of_narrow_arm.arm.0.borrow_mut().limits.lower_rad[3] = 0.8;
    rig_of_narrow_arm.pass(1000);
    assert_eq!(rig_of_narrow_arm.reason(), Some(StopReason::JointLimit), "its start position is beyond");
    rig.rest(1);
}

#[test]
fn a_stop_while_connecting_and_a_restart_leave_the_arm_where_it_is() {
    let mut rig = Rig::near();
    rig.arm.0.borrow_mut().report.link = Link::Connecting;
    rig.pass(500);
    rig.controller.order_stop();
    assert_eq!(rig.arm(), ArmAnswer::NotConnected);
    rig.arm.0.borrow_mut().report.link = Link::Connected;
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();

    let joints_rad = ArmSettings::default().start_joints_rad().add_scalar(0.01);
    let mut rig = Rig::new(settings(), joints_rad, Some(StopReason::StageEnded));
    rig.pass(500);
    rig.assert_stopped(StopReason::StageEnded);
    rig.assert_arms();
}

#[test]
fn an_arm_that_cannot_be_reached_or_driven_is_a_failure() {
    let mut rig = Rig::near();
    rig.arm.0.borrow_mut().report.link = Link::Connecting;
    rig.pass(9_900);
    assert_eq!(rig.controller.failure(), None);
    rig.pass(200);
    assert_eq!(rig.controller.failure(), Some(Stop::because(StopReason::ConnectionBroke)));
    // An arm that Tendon cannot drive answers and reports like any other.
    for link in [Link::Connecting, Link::Connected] {
        let mut rig = Rig::near();
        rig.arm.0.borrow_mut().report.link = link;
        rig.arm.0.borrow_mut().report.stop = Some(Stop::because(StopReason::UnsupportedArm));
        rig.pass(100);
        assert_eq!(rig.controller.failure(), Some(Stop::because(StopReason::UnsupportedArm)));
        assert!(!rig.controller.is_ready());
    }
}

#[test]
fn tendon_arm_is_answered_with_what_is_so() {
    let mut rig = Rig::moving();
    assert_eq!(rig.arm(), ArmAnswer::AlreadyArmed);
    rig.pass(1000);
    assert_eq!(rig.arm(), ArmAnswer::AwaitsRest);
    rig.controller.order_stop();
    // The emergency stop is pressed.
    rig.arm.0.borrow_mut().refuses = Some(Stop::because(StopReason::NotReady));
    assert_eq!(rig.arm(), ArmAnswer::Failed(Stop::because(StopReason::NotReady)));
    assert_eq!((rig.permission(), rig.reason()), (Permission::Stopped, Some(StopReason::NotReady)));
    rig.arm.0.borrow_mut().refuses = None;
    // Stopped meanwhile.
    rig.controller.order_arm(rig.now_ns);
    rig.pass(20);
    assert_eq!(rig.permission(), Permission::Stopped, "not before it is up");
    rig.controller.order_stop();
    assert_eq!(rig.controller.take_answer(), Some(ArmAnswer::Failed(Stop::because(StopReason::Ordered))));
    rig.pass(300);
    assert_eq!(rig.permission(), Permission::Stopped);
    assert_eq!(rig.arm(), ArmAnswer::Armed);
    rig.controller.order_stop();
    rig.arm.0.borrow_mut().report.link = Link::Connecting;
    assert_eq!(rig.arm(), ArmAnswer::NotConnected);
    let mut rig = Rig::on_the_way();
    assert_eq!(rig.arm(), ArmAnswer::GoingToStart);
    // One that never comes up.
    rig.controller.order_stop();
    rig.controller.order_arm(rig.now_ns);
    rig.arm.0.borrow_mut().report.link = Link::BringingUp;
    for _ in 0..3000 {
        rig.arm.0.borrow_mut().never_comes_up();
        rig.pass(4);
    }
    assert_eq!(rig.controller.take_answer(), Some(ArmAnswer::TooSlow));
    assert_eq!(rig.permission(), Permission::Stopped);
}

#[test]
fn a_stop_stops_the_gripper_and_a_grip_while_stopped_leaves_nothing_at_odds() {
    let mut rig = Rig::moving();
    rig.gripper_toggles += 1;
    rig.hold(Gesture::Grip, &STILL, 1);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, Some(-10.0));
    rig.arm.0.borrow_mut().report.gripper_pulses = Some(300.0);
    rig.controller.order_stop();
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, None);
    // A grip meanwhile.
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, None, "it is not made up for");
    rig.gripper_toggles += 1;
    rig.hold(Gesture::Grip, &STILL, 1);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, Some(850.0), "half closed, it opens");
}

#[test]
fn an_error_is_cleared_only_once_it_was_shown() {
    let mut rig = Rig::moving();
    rig.controller.order_stop();
    rig.pass(300);
    rig.arm.0.borrow_mut().report.error_code = Some(31);
    rig.controller.order_arm(rig.now_ns);
    assert_eq!(rig.controller.take_answer(), Some(ArmAnswer::Failed(Stop::by_fault(31))));
    assert_eq!(rig.arm.0.borrow().errors_cleared, 0);
    assert_eq!((rig.reason(), rig.state().fault_code), (Some(StopReason::ArmFault), 31));
    rig.assert_arms();
    assert_eq!(rig.arm.0.borrow().errors_cleared, 1);
}

#[test]
fn a_gripper_on_its_way_stays_where_it_is_when_the_arm_rests_and_after_a_restart() {
    let mut rig = Rig::moving();
    rig.gripper_toggles += 1;
    rig.hold(Gesture::Grip, &STILL, 1);
    rig.arm.0.borrow_mut().report.gripper_pulses = Some(300.0);
    rig.arm.0.borrow_mut().report.is_gripper_moving = true;
    rig.supervisor_lives = false;
    rig.hold(Gesture::Rest, &STILL, 3);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, Some(300.0));
    let mut rig =
        Rig::new(settings(), ArmSettings::default().start_joints_rad(), Some(StopReason::StageEnded));
    rig.pass(100);
    assert_eq!(rig.arm.0.borrow().stops, 1, "the process before may have left it on its way");
}

#[test]
fn without_a_gripper_none_is_commanded() {
    let settings = ControlSettings { has_gripper: false, ..settings() };
    let mut rig = Rig::new(settings, ArmSettings::default().start_joints_rad(), None);
    rig.pass(300);
    rig.rest(3);
    rig.gripper_toggles += 1;
    rig.hold(Gesture::Grip, &STILL, 2);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, None);
    assert!(rig.state().gripper_position.is_nan());
}

#[test]
fn the_state_says_why_a_held_gesture_does_not_move_the_arm() {
    let mut rig = Rig::at_start();
    rig.pass(300);
    rig.rest(3);
    rig.hold(Gesture::Extension, &UP, 70);
    assert_eq!((rig.permission(), rig.speed() < 0.1), (Permission::Granted, true));
    let face = Hindrance::WorkspaceFace { axis: 2, is_upper: true };
    assert_eq!(Hindrance::from_number(rig.state().hindrance), Some(face));
    rig.rest(2);
    assert_eq!(rig.state().hindrance, 0);
}

#[test]
fn the_state_says_how_long_the_calibration_takes() {
    let settings = ControlSettings { needs_calibration: true, ..settings() };
    let mut rig = Rig::new(settings, ArmSettings::default().start_joints_rad(), None);
    rig.pass(300);
    rig.context = WindowContext {
        calibration_left_ms: 4200,
        activity: Activity::Calibrating as u8,
        ..WindowContext::default()
    };
    rig.rest(5);
    assert_eq!((rig.state().calibration_left_ms, rig.permission()), (4200, Permission::AwaitRest));
    rig.context = WindowContext { activity: Activity::Rest as u8, ..WindowContext::default() };
    rig.rest(3);
    assert_eq!((rig.state().calibration_left_ms, rig.permission()), (0, Permission::Granted));
}

#[test]
fn the_pose_is_that_of_our_own_kinematics() {
    let mut rig = Rig::at_start();
    rig.pass(100);
    let payload = rig.controller.state().payload;
    let position_mm = rig.arm.0.borrow().position_mm();
    assert!((0..3).all(|axis| (f64::from(payload[7 + axis]) - position_mm[axis]).abs() < 1e-2));
}

#[test]
fn a_twist_that_is_no_number_stops_the_arm() {
    let mut rig = Rig::moving();
    rig.command(Gesture::Ulnar, &[f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]);
    rig.pass(250);
    assert_eq!((rig.speed(), rig.permission()), (0.0, Permission::Stopped));
}
