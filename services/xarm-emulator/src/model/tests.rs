//! The emulated arm, without a network.

use super::*;

const MS: u64 = 1_000_000;

/// An arm that obeys velocities of its flange, and the time.
fn ready(mode: Mode) -> (Model, u64) {
    let mut model = Model::new(Properties::default(), 0);
    assert_eq!(model.enable(8, true), Taken::Yes);
    assert_eq!(model.set_mode(mode), Taken::Yes);
    assert_eq!(model.state(), ArmState::ConfigurationChanged);
    assert_eq!(model.set_state(StateOrder::Run), Taken::Yes);
    model.advance_to(SETTLING_NS);
    (model, SETTLING_NS)
}

fn along_x(speed: f32) -> [f32; 6] {
    [speed, 0.0, 0.0, 0.0, 0.0, 0.0]
}

#[test]
fn nothing_moves_before_it_is_enabled_and_set_running() {
    let mut model = Model::new(Properties::default(), 0);
    assert_eq!(model.set_state(StateOrder::Run), Taken::Invalid);
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None);
    model.advance_to(1000 * MS);
    assert_eq!(model.speed_mm_per_s(), 0.0);
    assert!(!model.is_ready());
}

#[test]
fn a_command_right_after_a_change_is_swallowed() {
    let mut model = Model::new(Properties::default(), 0);
    model.enable(8, true);
    model.set_mode(Mode::CartesianVelocity);
    model.set_state(StateOrder::Run);
    assert_eq!(model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None), Taken::Yes);
    model.advance_to(500 * MS);
    assert_eq!(model.speed_mm_per_s(), 0.0);
}

#[test]
fn duration_ends_the_motion_and_its_absence_does_not() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    let before = model.pose();
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, Some(0.2));
    model.advance_to(start_ns + 150 * MS);
    // Half a step late, the Jacobian is that of the posture after it.
    assert!((model.speed_mm_per_s() - 100.0).abs() < 0.1, "{}", model.speed_mm_per_s());
    assert_eq!(model.state(), ArmState::Running);
    // 100 mm/s ends in 50 ms at 2000 mm/s², and a step or two.
    model.advance_to(start_ns + 260 * MS);
    assert_eq!((model.speed_mm_per_s(), model.state()), (0.0, ArmState::Ready));
    // The way: 0.2 s at 100 mm/s, whatever the two ramps.
    assert!((model.pose()[0] - before[0] - 20.0).abs() < 1.0, "{:?}", model.pose());
    model.set_flange_velocity(along_x(-50.0), TwistFrame::Base, None);
    model.advance_to(start_ns + 1200 * MS);
    assert!((model.speed_mm_per_s() - 50.0).abs() < 0.1);
}

#[test]
fn speed_is_gathered_no_faster_than_the_arm_can() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    model.set_flange_velocity([0.0, 200.0, 0.0, 0.0, 0.0, 0.0], TwistFrame::Base, None);
    let mut last = 0.0;
    for step in 1..=60 {
        model.advance_to(start_ns + step * STEP_NS);
        let speed = model.speed_mm_per_s();
        assert!(speed - last <= LINEAR_ACCELERATION_MM_PER_S2 * STEP_S + 0.5, "{last} to {speed} mm/s");
        last = speed;
    }
    assert!((last - 200.0).abs() < 0.2, "{last} mm/s");
}

#[test]
fn a_joint_limit_is_an_error_that_must_be_cleared() {
    let (mut model, start_ns) = ready(Mode::JointVelocity);
    let towards_limit = [0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0];
    model.set_joint_velocities(towards_limit, None);
    model.advance_to(start_ns + 3000 * MS);
    assert_eq!(model.codes(), (code::JOINT_LIMIT, 0));
    assert_eq!((model.mode, model.state()), (Mode::Position, ArmState::Stopped));
    assert!(model.joints_rad[5] <= model.joint_limits.upper_rad[5]);
    assert_eq!(model.set_state(StateOrder::Run), Taken::Invalid);
    model.clear_error();
    model.set_mode(Mode::JointVelocity);
    assert_eq!(model.set_state(StateOrder::Run), Taken::Yes);
    model.advance_to(start_ns + 4000 * MS);
    model.set_joint_velocities(towards_limit.map(|value| -value), Some(0.2));
    model.advance_to(start_ns + 5000 * MS);
    assert_eq!(model.codes(), (0, 0));
}

#[test]
fn stop_is_at_once_and_lasts() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None);
    model.advance_to(start_ns + 200 * MS);
    model.set_state(StateOrder::Stop);
    assert_eq!((model.speed_mm_per_s(), model.state()), (0.0, ArmState::Stopped));
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None);
    model.advance_to(start_ns + 500 * MS);
    assert_eq!(model.speed_mm_per_s(), 0.0);
}

#[test]
fn an_emergency_stop_takes_the_power_until_it_is_released() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None);
    model.advance_to(start_ns + 200 * MS);
    model.press_emergency_stop(true);
    assert_eq!((model.speed_mm_per_s(), model.codes()), (0.0, (code::EMERGENCY_STOP, 0)));
    model.clear_error();
    assert_eq!((model.codes().0, model.enable(8, true)), (code::EMERGENCY_STOP, Taken::Invalid));
    model.press_emergency_stop(false);
    model.clear_error();
    assert_eq!((model.codes().0, model.enable(8, true)), (0, Taken::Yes));
    assert!(!model.is_ready());
}

#[test]
fn the_fence_stops_who_leaves_it_and_lets_back_in() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    let edge_mm = model.pose()[0] as i32 + 30;
    model.set_boundary([edge_mm, -1000, 1000, -1000, 1000, -1000]);
    model.set_fence(true);
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None);
    model.advance_to(start_ns + 1000 * MS);
    assert_eq!(model.codes().0, code::BOUNDARY);
    assert!(model.pose()[0] <= edge_mm as f32);
}

fn played(properties: Properties) -> (Model, u64) {
    let (ready, start_ns) = ready(Mode::CartesianVelocity);
    let fresh = Model::new(properties, 0);
    let Model { properties, joint_limits, tcp_offset_m, .. } = fresh;
    (Model { properties, joint_limits, tcp_offset_m, ..ready }, start_ns)
}

#[test]
fn firmware_before_1_8_0_ignores_the_duration() {
    let firmware = tendon_xarm::Firmware { major: 1, minor: 7, revision: 9 };
    let (mut model, start_ns) = played(Properties { firmware, ..Properties::default() });
    model.set_flange_velocity(along_x(50.0), TwistFrame::Base, Some(0.2));
    model.advance_to(start_ns + 1000 * MS);
    assert!((model.speed_mm_per_s() - 50.0).abs() < 0.1);
}

#[test]
fn newer_arms_have_less_room() {
    let reach = |serial_number: &str| {
        let properties = Properties { serial_number: serial_number.to_owned(), ..Properties::default() };
        let (mut model, start_ns) = played(properties);
        model.mode = Mode::JointVelocity;
        model.set_joint_velocities([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0], None);
        model.advance_to(start_ns + 4000 * MS);
        assert_eq!(model.codes().0, code::JOINT_LIMIT);
        model.joints_rad[1]
    };
    let (old, new) = (reach("XI130400000000"), reach("XI130500000000"));
    assert!((2.09..2.0944).contains(&old) && (2.02..2.0246).contains(&new), "{old} {new}");
}

#[test]
fn the_pose_is_that_of_the_tip() {
    let setup = tendon_xarm::Setup { tcp_offset: [0.0, 0.0, 172.0, 0.0, 0.0, 0.0], ..Default::default() };
    let (with_tool, _) = played(Properties { setup, ..Properties::default() });
    let (without, _) = ready(Mode::CartesianVelocity);
    // The start posture points the flange down.
    let lower_mm = without.pose()[2] - with_tool.pose()[2];
    assert!((lower_mm - 172.0).abs() < 0.01, "{lower_mm}");
    assert_eq!(with_tool.report().setup, Some(setup));
}

#[test]
fn it_creeps_at_commanded_rest_until_it_is_stopped() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    model.creep(20.0);
    let before = model.pose();
    model.advance_to(start_ns + 1000 * MS);
    assert_eq!(model.state(), ArmState::Ready);
    assert!((model.pose()[1] - before[1] - 20.0).abs() < 0.5, "{:?}", model.pose());
    model.set_flange_velocity(along_x(100.0), TwistFrame::Base, Some(0.2));
    model.advance_to(start_ns + 1150 * MS);
    assert!((model.speed_mm_per_s() - 100.0).abs() < 0.5, "it obeys meanwhile");
    model.set_state(StateOrder::Stop);
    model.advance_to(start_ns + 2000 * MS);
    assert_eq!(model.speed_mm_per_s(), 0.0);
}

#[test]
fn another_client_takes_it_over() {
    let (mut model, start_ns) = ready(Mode::CartesianVelocity);
    model.take_over(Mode::Position);
    model.advance_to(start_ns + 200 * MS);
    assert_eq!((model.report().mode, model.state()), (0, ArmState::Ready));
    assert_eq!(model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None), Taken::Invalid);
    model.take_over(Mode::CartesianVelocity);
    model.refuse_velocities(1);
    model.advance_to(start_ns + 400 * MS);
    assert_eq!(model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None), Taken::Invalid);
    assert_eq!(model.set_flange_velocity(along_x(100.0), TwistFrame::Base, None), Taken::Yes);
}

#[test]
fn how_often_it_is_looked_at_makes_no_difference() {
    let motion = |looks: u64| {
        let (mut model, start_ns) = ready(Mode::CartesianVelocity);
        model.set_flange_velocity([40.0, -30.0, 20.0, 0.1, 0.0, 0.2], TwistFrame::Tool, Some(0.5));
        for look in 1..=looks {
            model.advance_to(start_ns + 1000 * MS * look / looks);
        }
        model.joints_rad
    };
    assert_eq!(motion(1), motion(777));
}
