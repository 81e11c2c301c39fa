//! What a person sees while a session runs.

use std::time::Duration;

use tendon_gesture::Gesture;
use tendon_messages::{Permission, STATE_LENGTH, Stage, StateHeader, StopReason};
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

/// Why the arm does not move, empty if it may.
fn standing(header: &StateHeader) -> String {
    let reason = match (Fault::new(tendon_xarm::Source::Controller, header.fault_code), header.stop_reason) {
        (Some(fault), _) => fault.to_string(),
        (None, number) => StopReason::from_number(number).map_or(String::new(), |reason| reason.to_string()),
    };
    match Permission::from_number(header.permission) {
        Permission::Granted => String::new(),
        Permission::AwaitRest if reason.is_empty() => "relax to begin  ".to_owned(),
        Permission::AwaitRest => format!("ARM RESTS ({reason}): relax to go on  "),
        Permission::Stopped => format!("ARM STOPPED ({reason}): `tendon arm` or key a goes on  "),
    }
}
