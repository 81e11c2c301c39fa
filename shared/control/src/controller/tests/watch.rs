//! What must hold while the arm moves.

use super::*;

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
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 4);
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
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 2);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::ArmSilent)));
    assert_eq!(rig.speed(), 0.0);
    rig.arm.0.borrow_mut().report.silent_ns = 0;
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 3);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 6);
    assert!(rig.speed() > 97.0);

    let mut rig = Rig::on_the_way();
    rig.arm.0.borrow_mut().report.silent_ns = 301 * MS;
    rig.assert_stopped(StopReason::ArmSilent);
}

#[test]
fn a_controller_that_stood_still_does_not_go_on_where_it_was() {
    let mut rig = Rig::moving();
    rig.now_ns += 300 * MS;
    rig.pass(4);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::RobotStalled)));
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 4);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    assert_eq!(rig.permission(), Permission::Granted);

    let mut rig = Rig::on_the_way();
    rig.now_ns += 300 * MS;
    rig.assert_stopped(StopReason::RobotStalled);
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
        rig.hold(Gesture::ULNAR, &SIDEWAYS, 1);
    }
    rig.arm.0.borrow_mut().runaway = Twist::ZERO;
    rig.assert_stopped(StopReason::WorkspaceBox);
    assert_eq!(rig.arm(), ArmAnswer::Armed);
    rig.rest(3);
    rig.hold(Gesture::ULNAR, &UP.map(|component| -component), 6);
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
        rig.hold(Gesture::ULNAR, &SIDEWAYS, 4);
        let from_mm = rig.arm.0.borrow().position_mm();
        let begun_ns = rig.now_ns;
        rig.arm.0.borrow_mut().runaway.linear_mm_per_s = runaway;
        while rig.permission() != Permission::Stopped {
            rig.hold(Gesture::ULNAR, &SIDEWAYS, 1);
            assert!(rig.now_ns - begun_ns < 700 * MS, "{runaway:?}");
        }
        let off_mm = (rig.arm.0.borrow().position_mm()[axis] - from_mm[axis]).abs();
        assert!(off_mm < at_most_mm, "{runaway:?}: {off_mm} mm");
        rig.arm.0.borrow_mut().runaway = Twist::ZERO;
        // What was measured is told once, and kept for whoever asks.
        let found = rig.controller.take_violation();
        assert!(matches!(found, Some(LimitViolation::NotFollowing { .. })), "{found:?}");
        assert_eq!(rig.controller.take_violation(), None);
        let words = rig.controller.explanation(StopReason::NotFollowing);
        assert_eq!(words, found.map(|found| found.to_string()));
        assert_eq!(rig.controller.explanation(StopReason::OverSpeed), None);
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
fn an_arm_that_does_not_go_to_its_start_as_it_is_told_is_stopped() {
    let hold = |rig: &mut Rig| rig.arm.0.borrow_mut().is_held = true;
    let freeze = |rig: &mut Rig| {
        let mut body = rig.arm.0.borrow_mut();
        body.frozen_at_rad = Some(body.joints_rad);
    };
    for (name, cause) in [("held", &hold as &dyn Fn(&mut Rig)), ("reports frozen", &freeze)] {
        let mut rig = Rig::on_the_way();
        let from_mm = rig.arm.0.borrow().position_mm();
        cause(&mut rig);
        rig.pass(1000);
        assert_eq!(
            (rig.permission(), rig.reason()),
            (Permission::Stopped, Some(StopReason::NotFollowing)),
            "{name}"
        );
        let to_mm = rig.arm.0.borrow().position_mm();
        let way_mm = (0..3).map(|axis| (to_mm[axis] - from_mm[axis]).powi(2)).sum::<f64>().sqrt();
        assert!(way_mm < 60.0, "{name}: {way_mm} mm");
        rig.assert_stopped(StopReason::NotFollowing);
    }
}

#[test]
fn the_joint_limits_are_those_of_the_arm_that_is_there() {
    let mut rig = Rig::moving();
    assert_eq!(rig.permission(), Permission::Granted);
    let mut rig_of_narrow_arm = Rig::at_start();
    rig_of_narrow_arm.arm.0.borrow_mut().limits.lower_rad[3] = 0.8;
    rig_of_narrow_arm.pass(1000);
    assert_eq!(
        rig_of_narrow_arm.reason(),
        Some(StopReason::StartBeyondLimit),
        "its start position is beyond"
    );
    rig.rest(1);
}
