//! Commands, the gripper, and the state that is published.

use super::*;

#[test]
fn no_fresh_command_is_a_rest_after_the_watchdogs_time() {
    let mut rig = Rig::moving();
    rig.pass(150 + 80 - INCREMENT_MS + 8);
    assert_eq!(rig.speed(), 0.0);
    assert_eq!((rig.permission(), rig.reason()), (Permission::AwaitRest, Some(StopReason::NoCommands)));
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 4);
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
            gesture: Gesture::ULNAR.paper_number().unwrap(),
            ..CommandHeader::default()
        };
        rig.sequence += 1;
        assert_eq!(rig.controller.take(&header, &SIDEWAYS, rig.now_ns), Taken::Stale);
    }
    assert_eq!(rig.speed(), 0.0);
    assert_eq!(rig.reason(), Some(StopReason::NoCommands));
}

#[test]
fn commands_whose_samples_were_captured_in_the_future_are_not_acted_on() {
    let mut rig = Rig::moving();
    for ahead_ns in [2 * MS, 1000 * MS, u64::MAX / 2, u64::MAX] {
        rig.pass(INCREMENT_MS);
        let header = CommandHeader {
            trace: Trace {
                sequence: rig.sequence,
                captured_ns: rig.now_ns.saturating_add(ahead_ns),
                ..Trace::default()
            },
            gesture: Gesture::ULNAR.paper_number().unwrap(),
            ..CommandHeader::default()
        };
        rig.sequence += 1;
        assert_eq!(rig.controller.take(&header, &SIDEWAYS, rig.now_ns), Taken::Stale);
    }
    assert_eq!((rig.speed(), rig.reason()), (0.0, Some(StopReason::NoCommands)));
}

#[test]
fn commands_of_a_decision_process_that_began_anew_stop_the_arm() {
    let mut rig = Rig::moving();
    rig.sequence = 0;
    rig.command(Gesture::ULNAR, &SIDEWAYS);
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
fn a_stop_stops_the_gripper_and_a_grip_while_stopped_leaves_nothing_at_odds() {
    let mut rig = Rig::moving();
    rig.gripper_toggles += 1;
    rig.hold(Gesture::GRIP, &STILL, 1);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, Some(-10.0));
    rig.arm.0.borrow_mut().report.gripper_pulses = Some(300.0);
    rig.controller.order_stop(rig.now_ns);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, None);
    // A grip meanwhile.
    rig.assert_stopped(StopReason::Ordered);
    rig.assert_arms();
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, None, "it is not made up for");
    rig.gripper_toggles += 1;
    rig.hold(Gesture::GRIP, &STILL, 1);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, Some(850.0), "half closed, it opens");
}

#[test]
fn a_gripper_on_its_way_stays_where_it_is_when_the_arm_rests_and_after_a_restart() {
    let mut rig = Rig::moving();
    rig.gripper_toggles += 1;
    rig.hold(Gesture::GRIP, &STILL, 1);
    rig.arm.0.borrow_mut().report.gripper_pulses = Some(300.0);
    rig.arm.0.borrow_mut().report.is_gripper_moving = true;
    rig.supervisor_lives = false;
    rig.hold(Gesture::REST, &STILL, 3);
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
    rig.hold(Gesture::GRIP, &STILL, 2);
    assert_eq!(rig.arm.0.borrow().gripper_target_pulses, None);
    assert!(rig.state().gripper_position.is_nan());
}

#[test]
fn the_state_says_why_a_held_gesture_does_not_move_the_arm() {
    let mut rig = Rig::at_start();
    rig.pass(300);
    rig.rest(3);
    rig.hold(Gesture::EXTENSION, &UP, 70);
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
    rig.command(Gesture::ULNAR, &[f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]);
    rig.pass(250);
    assert_eq!((rig.speed(), rig.permission()), (0.0, Permission::Stopped));
}

#[test]
fn a_motion_in_the_tools_frame_goes_where_the_flange_points() {
    let mut rig = Rig::at_start();
    rig.pass(300);
    rig.rest(3);
    rig.frame = TwistFrame::Tool;
    let pose = |rig: &Rig| XArm7::new().flange_pose_m(&rig.arm.0.borrow().joints_rad);
    let before = pose(&rig);
    rig.hold(Gesture::ULNAR, &SIDEWAYS, 4);
    let moved_m = before.rotation.inverse() * (pose(&rig).translation.vector - before.translation.vector);
    assert!(moved_m.y > 0.015, "{moved_m}");
    assert!(moved_m.x.abs() < 1e-4 && moved_m.z.abs() < 1e-4, "{moved_m}");
    let in_base = Twist { linear_mm_per_s: [0.0, 1.0, 0.0], ..Twist::ZERO }.rotated(&before.rotation);
    assert!((in_base.linear_mm_per_s[1] - 1.0).abs() > 0.1, "the frames differ: {in_base:?}");
    rig.rest(4);
    // About the flange's own z axis: it turns, and stays where it is.
    let before = pose(&rig);
    rig.hold(Gesture::ULNAR, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.3], 4);
    let turned = (before.rotation.inverse() * pose(&rig).rotation).scaled_axis();
    assert!(turned.z > 0.04 && turned.x.abs() < 1e-3 && turned.y.abs() < 1e-3, "{turned}");
    assert!((pose(&rig).translation.vector - before.translation.vector).norm() < 1e-4);
    assert_eq!(rig.permission(), Permission::Granted, "{:?}", rig.reason());
}
