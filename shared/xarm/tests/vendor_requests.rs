//! Every request is, to the byte, what the vendor's client sends; `golden/vendor_requests.py` captured it.

use tendon_xarm::command::ALL_AXES;
use tendon_xarm::{Command, GripperRequest, Mode, StateOrder, TwistFrame};

fn command(name: &str) -> Command {
    match name {
        "get_version" => Command::GetVersion,
        "get_serial_number" => Command::GetSerialNumber,
        "enable" => Command::Enable { axis: ALL_AXES, on: true },
        "disable_3" => Command::Enable { axis: 3, on: false },
        "run" => Command::SetState(StateOrder::Run),
        "pause" => Command::SetState(StateOrder::Pause),
        "stop" => Command::SetState(StateOrder::Stop),
        "slow_and_stop" => Command::SetState(StateOrder::SlowAndStop),
        "get_state" => Command::GetState,
        "get_command_count" => Command::GetCommandCount,
        "get_errors" => Command::GetErrors,
        "clear_error" => Command::ClearError,
        "clear_warning" => Command::ClearWarning,
        "mode_5" => Command::SetMode(Mode::CartesianVelocity),
        "get_pose" => Command::GetPose,
        "get_joints" => Command::GetJoints,
        "reduced_speed" => Command::SetReducedSpeed(150.0),
        "reduced_mode" => Command::SetReducedMode(true),
        "boundary" => Command::SetBoundary([700, -700, 600, -600, 500, -100]),
        "fence" => Command::SetFence(true),
        "joint_velocity" => Command::JointVelocity {
            velocities_rad_per_s: [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7],
            synchronous: true,
            duration_s: Some(0.2),
        },
        "flange_velocity" => Command::CartesianVelocity {
            twist: [30.0, 0.0, 20.0, std::f32::consts::FRAC_PI_6, 0.0, 0.0],
            frame: TwistFrame::Base,
            duration_s: Some(0.2),
        },
        "tool_velocity" => Command::CartesianVelocity {
            twist: [-1.5, 2.0, 0.0, 0.0, 0.25, 0.0],
            frame: TwistFrame::Tool,
            duration_s: None,
        },
        "gripper_enable" => Command::Gripper(GripperRequest::Enable(true)),
        "gripper_mode" => Command::Gripper(GripperRequest::SetMode(0)),
        "gripper_speed" => Command::Gripper(GripperRequest::SetSpeed(2000)),
        "gripper_open" => Command::Gripper(GripperRequest::MoveTo(850)),
        "gripper_closed" => Command::Gripper(GripperRequest::MoveTo(-10)),
        "gripper_position" => Command::Gripper(GripperRequest::GetPosition),
        "gripper_error" => Command::Gripper(GripperRequest::GetError),
        "gripper_off" => Command::Gripper(GripperRequest::Enable(false)),
        "gripper_status" => Command::Gripper(GripperRequest::GetStatus),
        _ => panic!("{name} is not known here"),
    }
}

#[test]
fn requests_are_the_vendors_to_the_byte() {
    let vectors: Vec<&str> = include_str!("golden/vendor_requests.txt").lines().collect();
    assert_eq!(vectors.len(), 32);
    for (index, vector) in vectors.into_iter().enumerate() {
        let (name, expected) = vector.split_once(' ').unwrap();
        let mut bytes = Vec::new();
        command(name).encode(index as u16 + 1, &mut bytes);
        let found: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(found, expected, "{name}");
        assert_eq!(Command::decode(&bytes[6..]), Ok(command(name)), "{name}");
    }
}
