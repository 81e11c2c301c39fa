//! Before the arm follows: how it was left, what it is answered, errors that nobody has seen.

use super::*;

#[test]
fn an_arm_left_in_good_order_goes_to_its_start_position_and_waits_for_a_rest() {
    let mut rig = Rig::on_the_way();
    assert!(rig.state().start_distance_mm > 1.0);
    rig.pass(5000);
    assert_eq!((rig.phase(), rig.permission()), (ArmPhase::Following, Permission::AwaitRest));
    assert!(rig.controller.is_in_good_order());
    assert!((rig.arm.0.borrow().joints_rad - ArmSettings::default().start_joints_rad()).amax() < 0.003);
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 10);
    assert_eq!(rig.speed(), 0.0);
    rig.rest(3);
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 6);
    assert!(rig.speed() > 97.0);
    assert_eq!(rig.state().start_distance_mm, 0.0);
}

#[test]
fn commands_that_cease_on_the_way_to_the_start_position_stop_the_arm() {
    let mut rig = Rig::on_the_way();
    rig.rest(3);
    assert_eq!(rig.phase(), ArmPhase::GoingToStart);
    rig.pass(150 - INCREMENT_MS);
    assert_eq!(rig.phase(), ArmPhase::GoingToStart);
    rig.pass(8);
    rig.assert_stopped(StopReason::NoCommands);
    rig.assert_arms();
}

#[test]
fn stale_commands_on_the_way_to_the_start_position_are_none() {
    let mut rig = Rig::on_the_way();
    rig.command(Gesture::REST, &STILL);
    for _ in 0..3 {
        rig.pass(INCREMENT_MS);
        let captured_ns = rig.now_ns - 200 * MS;
        let trace = Trace { sequence: rig.sequence, captured_ns, ..Trace::default() };
        rig.sequence += 1;
        rig.controller.take(&CommandHeader { trace, ..CommandHeader::default() }, &STILL, rig.now_ns);
    }
    rig.assert_stopped(StopReason::NoCommands);
}

#[test]
fn an_arm_that_is_sent_to_a_far_start_position_without_commands_stops_at_once() {
    let mut joints_rad = ArmSettings::default().start_joints_rad();
    joints_rad[0] += 30.0_f64.to_radians();
    let mut rig = Rig::new(settings(), joints_rad, None);
    rig.pass(100);
    rig.rest(3);
    rig.assert_stopped(StopReason::StartIsFar);
    rig.pass(1000);
    assert_eq!(rig.arm(), ArmAnswer::GoingToStart);
    rig.assert_stopped(StopReason::NoCommands);
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
        (Departure::UsedSince, StopReason::UsedSince),
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
    for _ in 0..130 {
        if rig.phase() != ArmPhase::Following {
            rig.rest(1);
        }
    }
    assert_eq!((rig.phase(), rig.permission()), (ArmPhase::Following, Permission::AwaitRest));
    assert!(rig.state().start_distance_mm < 2.0);
    // Stopped on this way it is not sent on.
    let mut rig = turned(30.0);
    rig.pass(100);
    rig.arm();
    rig.pass(600);
    rig.controller.order_stop(rig.now_ns);
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();

    // Nor after a stop, or an error, while it waited: more than the distance is in question then.
    let mut rig = turned(30.0);
    rig.pass(100);
    rig.controller.order_stop(rig.now_ns);
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
fn in_a_session_that_follows_on_another_the_arm_waits_before_it_goes_to_its_start_position() {
    let settings = ControlSettings { waits_at_start: true, ..settings() };
    let mut near_rad = settings.arm.start_joints_rad();
    near_rad[0] += 0.18;
    let mut rig = Rig::new(settings.clone(), near_rad, None);
    rig.pass(100);
    assert!(rig.controller.is_ready());
    rig.assert_stopped(StopReason::NextSession);
    rig.rest(1);
    assert_eq!(rig.arm(), ArmAnswer::GoingToStart);
    for _ in 0..130 {
        if rig.phase() != ArmPhase::Following {
            rig.rest(1);
        }
    }
    assert_eq!((rig.phase(), rig.permission()), (ArmPhase::Following, Permission::AwaitRest));
    // One that a stop has reached meanwhile is not sent there, nor one that was not left in good order.
    let mut rig = Rig::new(settings.clone(), near_rad, None);
    rig.pass(100);
    rig.controller.order_stop(rig.now_ns);
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();
    let mut rig = Rig::new(settings.clone(), near_rad, None);
    rig.supervisor_lives = false;
    rig.pass(8);
    rig.controller.hear_supervisor(rig.now_ns);
    rig.controller.depart(Departure::NoRecord, rig.now_ns);
    rig.supervisor_lives = true;
    rig.assert_stopped(StopReason::NotLeftInGoodOrder);
    rig.assert_arms();
    // One that is there already, and one that is always up, as the simulated arm.
    for link in [Link::Connected, Link::Up(Drive::Flange)] {
        let mut rig = Rig::new(settings.clone(), settings.arm.start_joints_rad(), None);
        rig.arm.0.borrow_mut().report.link = link;
        rig.pass(100);
        rig.assert_stopped(StopReason::NextSession);
        rig.assert_arms();
    }
}

#[test]
fn an_arm_that_stands_outside_the_box_is_driven_back_by_its_user_alone() {
    let mut settings = settings();
    // It stands 27 mm beyond this face, and 80 mm from its start position.
    settings.arm.workspace_max_mm[1] = 40.0;
    let mut joints_rad = ArmSettings::default().start_joints_rad();
    joints_rad[0] += 10.0_f64.to_radians();
    let mut rig = Rig::new(settings, joints_rad, None);
    rig.pass(100);
    rig.assert_stopped(StopReason::OutsideBox);
    assert_eq!(rig.arm(), ArmAnswer::Armed, "it does not go anywhere by itself");
    rig.rest(3);
    rig.hold(Gesture::RADIAL, &SIDEWAYS.map(|component| -component), 10);
    assert!(rig.arm.0.borrow().position_mm()[1] < 40.0);
}

#[test]
fn a_stop_while_connecting_and_a_restart_leave_the_arm_where_it_is() {
    let mut rig = Rig::near();
    rig.arm.0.borrow_mut().report.link = Link::Connecting;
    rig.pass(500);
    assert_eq!(rig.controller.order_stop(rig.now_ns), StopAnswer::NotConnected);
    assert_eq!(rig.arm(), ArmAnswer::NotConnected(StopReason::NeverConnected));
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
    assert_eq!(rig.controller.failure(), Some(Stop::because(StopReason::NeverConnected)));
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
    rig.controller.order_stop(rig.now_ns);
    // The emergency stop is pressed.
    rig.arm.0.borrow_mut().refuses = Some(Stop::because(StopReason::NotReady));
    assert_eq!(rig.arm(), ArmAnswer::Failed(Stop::because(StopReason::NotReady)));
    assert_eq!((rig.permission(), rig.reason()), (Permission::Stopped, Some(StopReason::NotReady)));
    rig.arm.0.borrow_mut().refuses = None;
    // Stopped meanwhile.
    rig.controller.order_arm(rig.now_ns);
    rig.pass(20);
    assert_eq!(rig.permission(), Permission::Stopped, "not before it is up");
    rig.controller.order_stop(rig.now_ns);
    assert_eq!(rig.controller.take_answer(), Some(ArmAnswer::Failed(Stop::because(StopReason::Ordered))));
    rig.pass(300);
    assert_eq!(rig.permission(), Permission::Stopped);
    assert_eq!(rig.arm(), ArmAnswer::Armed);
    rig.controller.order_stop(rig.now_ns);
    rig.arm.0.borrow_mut().report.link = Link::Connecting;
    assert_eq!(rig.arm(), ArmAnswer::NotConnected(StopReason::ConnectionBroke));
    let mut rig = Rig::on_the_way();
    assert_eq!(rig.arm(), ArmAnswer::GoingToStart);
    // One that never comes up.
    rig.controller.order_stop(rig.now_ns);
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
fn an_error_is_cleared_only_once_it_was_shown() {
    let mut rig = Rig::moving();
    rig.controller.order_stop(rig.now_ns);
    rig.pass(300);
    rig.arm.0.borrow_mut().report.error_code = Some(31);
    rig.controller.order_arm(rig.now_ns);
    assert_eq!(rig.controller.take_answer(), Some(ArmAnswer::Failed(Stop::by_fault(31))));
    assert_eq!(rig.arm.0.borrow().errors_cleared, 0);
    assert_eq!((rig.reason(), rig.state().fault_code), (Some(StopReason::ArmFault), 31));
    rig.assert_arms();
    assert_eq!(rig.arm.0.borrow().errors_cleared, 1);
}
