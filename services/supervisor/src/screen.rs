//! What a person sees while a session runs.

use std::time::Duration;

use tendon_gesture::Gesture;
use tendon_messages::{ArmPhase, Hindrance, Permission, STATE_LENGTH, Stage, StateHeader, StopReason};
use tendon_xarm::Fault;

/// What the keys do, for the person at them.
pub const KEYS: &str = "keys: space STOP, a arm again, q quit";
/// With `--keyboard`, before those.
pub const GESTURE_KEYS: &str =
    "keys: e extension, f flexion, u ulnar, r radial, g grip, n none of them (rest)";

/// The live line. What matters most comes first, as a narrow terminal shows its beginning: why the arm does not move,
/// time, gesture, confidence, task; then pose, gripper, and age of the newest sample at the command.
pub fn live_line(elapsed: Duration, header: &StateHeader, state: &[f32], task: &str) -> String {
    let gesture = Gesture::from_index(header.gesture.into()).unwrap_or(Gesture::Rest);
    let position = state.get(7..10).filter(|_| state.len() == STATE_LENGTH).unwrap_or(&[0.0; 3]);
    let command_ns = header.trace.published_ns[Stage::Decision.index()];
    let latency_us = command_ns.saturating_sub(header.trace.captured_ns) as f64 / 1e3;
    format!(
        "{}{:6.1} s  {gesture:<9} {:3.0} %{task}  x {:6.1}  y {:6.1}  z {:6.1} mm  gripper {:3.0}  sample to command {:5.0} us",
        standing(header),
        elapsed.as_secs_f64(),
        100.0 * header.confidence,
        position[0],
        position[1],
        position[2],
        header.gripper_position,
        latency_us,
    )
}

/// Why the arm does not move, or not as it should; empty if it does.
fn standing(header: &StateHeader) -> String {
    let reason = match (Fault::new(tendon_xarm::Source::Controller, header.fault_code), header.stop_reason) {
        (Some(fault), _) => fault.to_string(),
        (None, number) => StopReason::from_number(number).map_or(String::new(), |reason| reason.to_string()),
    };
    let calibration_left_s = header.calibration_left_ms.div_ceil(1000);
    match (Permission::from_number(header.permission), Hindrance::from_number(header.hindrance)) {
        (Permission::Stopped, _) if header.arm_phase == ArmPhase::BringingUp.number() => {
            "the arm switches its motors on  ".to_owned()
        }
        (Permission::Stopped, _) => format!("ARM STOPPED ({reason}): `tendon arm` or key a goes on  "),
        (Permission::AwaitRest, _) if calibration_left_s > 0 => {
            format!("calibrating, {calibration_left_s} s of rest left  ")
        }
        (Permission::AwaitRest, _) if reason.is_empty() => "relax to begin  ".to_owned(),
        (Permission::AwaitRest, _) => format!("ARM RESTS ({reason}): relax to go on  "),
        (Permission::Granted, Some(hindrance)) => format!("HELD UP ({hindrance})  "),
        (Permission::Granted, None) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_a_narrow_terminal_one_sees_why_the_arm_does_not_move() {
        let line = |header: StateHeader| live_line(Duration::from_secs(3), &header, &[0.0; STATE_LENGTH], "");
        let stopped = StateHeader {
            permission: Permission::Stopped as u8,
            stop_reason: StopReason::Ordered as u8,
            ..StateHeader::default()
        };
        assert!(line(stopped).starts_with("ARM STOPPED ("), "{}", line(stopped));
        let comes_up = StateHeader { arm_phase: ArmPhase::BringingUp.number(), stop_reason: 0, ..stopped };
        assert!(line(comes_up).starts_with("the arm switches its motors on"));
        let awaits = StateHeader { permission: Permission::AwaitRest as u8, ..StateHeader::default() };
        assert!(line(awaits).starts_with("relax to begin"));
        let calibrating = StateHeader { calibration_left_ms: 4200, ..awaits };
        assert!(line(calibrating).starts_with("calibrating, 5 s of rest left"));
        let granted = StateHeader { permission: Permission::Granted as u8, ..StateHeader::default() };
        let hindrance = Hindrance::WorkspaceFace { axis: 2, is_upper: true }.number();
        let held = StateHeader { hindrance, ..granted };
        assert!(line(held).starts_with("HELD UP (at the workspace limit +z)"));
        assert!(line(granted).starts_with("   3.0 s"));
    }
}
