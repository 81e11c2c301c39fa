//! What a person sees while a session runs.

use std::time::Duration;

use tendon_gesture::{DecisionSettings, Gesture};
use tendon_messages::{ArmPhase, Hindrance, Permission, Stage, StateHeader, StopReason};
use tendon_observer::State;
use tendon_session::{is_found_waiting, stop_words};

/// What the keys do, for the person at them.
pub const KEYS: &str = "keys: space STOP, a arm again, w record, q quit";

/// What stands for the gesture when it is not clear which one is made.
const UNSURE: &str = "unsure";
/// What stands for a value that is not known yet.
const UNKNOWN: &str = "-";

/// The live line. What matters most comes first, as a narrow terminal shows its beginning: why the arm does not move,
/// time, gesture, confidence, task; then pose, gripper, and age of the newest sample at the command. `standstill` says
/// which stage makes no progress.
pub fn live_line(
    elapsed: Duration,
    decision: &DecisionSettings,
    state: Option<&State>,
    standstill: Option<&str>,
    task: &str,
) -> String {
    let standing = match state {
        Some(state) => standing(&state.header, standstill),
        None => format!("{}waiting for the arm's first report  ", troubled(standstill)),
    };
    let commanded = state.map(|state| &state.header).filter(|header| header.trace.captured_ns > 0);
    let gesture = commanded.map(|header| match header.is_unsure {
        0 => decision.gestures.get(header.gesture).unwrap_or(Gesture::REST).to_string(),
        _ => UNSURE.to_owned(),
    });
    let mode = commanded.and_then(|header| decision.modes.get(usize::from(header.mode)));
    let mode =
        mode.filter(|_| decision.modes.len() > 1).map_or(String::new(), |mode| format!("  [{}]", mode.name));
    let latency_us = commanded.map(|header| {
        let command_ns = header.trace.published_ns[Stage::Decision.index()];
        command_ns.saturating_sub(header.trace.captured_ns) as f32 / 1e3
    });
    // All zeros before the arm has reported: no flange is ever in its own base.
    let position_mm = state.map(State::position_mm).filter(|position_mm| *position_mm != [0.0; 3]);
    let [x, y, z] = [0, 1, 2].map(|axis| number(position_mm.map(|position_mm| position_mm[axis]), 1));
    format!(
        "{standing}{:6.1} s{mode}  {:<9} {:>3} %{task}  x {x:>6}  y {y:>6}  z {z:>6} mm  gripper {:>3}  sample to command \
         {:>5} us",
        elapsed.as_secs_f64(),
        gesture.as_deref().unwrap_or(UNKNOWN),
        number(commanded.map(|header| 100.0 * header.confidence), 0),
        number(state.map(|state| state.header.gripper_position), 0),
        number(latency_us, 0),
    )
}

/// A number with so many decimals, never `-0`; a dash for one that is not known.
fn number(value: Option<f32>, decimals: usize) -> String {
    let Some(value) = value.filter(|value| value.is_finite()) else { return UNKNOWN.to_owned() };
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(magnitude) if magnitude.chars().all(|digit| matches!(digit, '0' | '.')) => magnitude.to_owned(),
        _ => text,
    }
}

/// A stage that makes no progress, at the beginning of the line.
fn troubled(standstill: Option<&str>) -> String {
    standstill.map_or(String::new(), |standstill| format!("{standstill}  "))
}

/// Why the arm does not move, or not as it should; empty if it does.
fn standing(header: &StateHeader, standstill: Option<&str>) -> String {
    let reason = stop_words(header).unwrap_or_default();
    let distance_mm = header.start_distance_mm;
    let calibration_left_s = header.calibration_left_ms.div_ceil(1000);
    let trouble = troubled(standstill);
    match (Permission::from_number(header.permission), Hindrance::from_number(header.hindrance)) {
        (Permission::Stopped, _) if header.arm_phase == ArmPhase::BringingUp.number() => {
            format!("the arm switches its motors on  {trouble}")
        }
        (Permission::Stopped, _) if header.arm_phase == ArmPhase::GoingToStart.number() => {
            format!("the arm goes to its start position, {distance_mm:.0} mm away  {trouble}")
        }
        (Permission::Stopped, _) if header.stop_reason == StopReason::StartIsFar.number() => {
            format!("ARM WAITS ({reason})  {trouble}")
        }
        (Permission::Stopped, _) if is_found_waiting(header) => {
            format!("ARM WAITS ({reason}); to begin: `tendon arm` or key a  {trouble}")
        }
        (Permission::Stopped, _) => {
            format!("ARM STOPPED ({reason}); to go on: `tendon arm` or key a  {trouble}")
        }
        // It would wait for a rest in vain.
        (Permission::AwaitRest, _) if standstill.is_some() => format!("ARM RESTS  {trouble}"),
        (Permission::AwaitRest, _) if calibration_left_s > 0 => {
            format!("calibrating, {calibration_left_s} s of rest left  ")
        }
        (Permission::AwaitRest, _) if reason.is_empty() => "relax to begin  ".to_owned(),
        (Permission::AwaitRest, _) => format!("ARM RESTS ({reason}): relax to go on  "),
        (Permission::Granted, Some(hindrance)) => format!("HELD UP ({hindrance})  {trouble}"),
        (Permission::Granted, None) => trouble,
    }
}

#[cfg(test)]
mod tests {
    use tendon_messages::{STATE_LENGTH, Trace};

    use super::*;

    fn line_of(state: Option<State>, standstill: Option<&str>) -> String {
        live_line(Duration::from_secs(3), &DecisionSettings::default(), state.as_ref(), standstill, "")
    }

    #[test]
    fn on_a_narrow_terminal_one_sees_why_the_arm_does_not_move() {
        let line = |header| line_of(Some(State { header, payload: [0.0; STATE_LENGTH] }), None);
        let stopped = StateHeader {
            permission: Permission::Stopped as u8,
            stop_reason: StopReason::Ordered as u8,
            ..StateHeader::default()
        };
        assert!(line(stopped).starts_with("ARM STOPPED ("), "{}", line(stopped));
        let comes_up = StateHeader { arm_phase: ArmPhase::BringingUp.number(), stop_reason: 0, ..stopped };
        assert!(line(comes_up).starts_with("the arm switches its motors on"));
        let goes =
            StateHeader { arm_phase: ArmPhase::GoingToStart.number(), start_distance_mm: 199.7, ..comes_up };
        assert!(line(goes).starts_with("the arm goes to its start position, 200 mm away  "));
        let waits = |reason: StopReason| {
            let arm_phase = ArmPhase::Waiting.number();
            line(StateHeader { arm_phase, stop_reason: reason.number(), start_distance_mm: 199.7, ..stopped })
        };
        let far = waits(StopReason::StartIsFar);
        assert!(far.starts_with("ARM WAITS (the start position is 200 mm away: look around"), "{far}");
        assert!(far.contains("key a sends the arm there"), "{far}");
        assert!(waits(StopReason::UsedSince).starts_with("ARM WAITS (another session has used the arm"));
        assert!(waits(StopReason::NotFollowing).starts_with("ARM STOPPED ("));
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

    #[test]
    fn what_is_not_known_yet_is_a_dash() {
        let nothing = line_of(None, None);
        let dashes = "   3.0 s  -           - %  x      -  y      -  z      - mm  gripper   -  sample to command     - us";
        assert_eq!(nothing, format!("waiting for the arm's first report  {dashes}"));
        // An arm without a gripper, before it has reported, and before the first command.
        let header = StateHeader {
            permission: Permission::AwaitRest as u8,
            gripper_position: f32::NAN,
            ..StateHeader::default()
        };
        let connecting = line_of(Some(State { header, payload: [0.0; STATE_LENGTH] }), None);
        assert_eq!(connecting, format!("relax to begin  {dashes}"));
    }

    #[test]
    fn no_number_is_minus_zero() {
        let mut trace = Trace { captured_ns: 1_000_000, ..Trace::default() };
        trace.published_ns[Stage::Decision.index()] = 1_350_000;
        let header =
            StateHeader { trace, confidence: 0.98, gripper_position: -0.4, ..StateHeader::default() };
        let mut payload = [0.0; STATE_LENGTH];
        payload[7..10].copy_from_slice(&[386.04, -0.04, -120.26]);
        let line = line_of(Some(State { header, payload }), None);
        let expected = "x  386.0  y    0.0  z -120.3 mm  gripper   0  sample to command   350 us";
        assert!(line.contains("rest       98 %") && line.ends_with(expected), "{line}");
    }

    #[test]
    fn a_stage_that_stands_still_is_named_where_a_narrow_terminal_shows_it() {
        let standstill = Some("acquisition: no samples for 3 s");
        let line = |permission: Permission, stop_reason: u8| {
            let header = StateHeader { permission: permission as u8, stop_reason, ..StateHeader::default() };
            line_of(Some(State { header, payload: [0.0; STATE_LENGTH] }), standstill)
        };
        assert!(line(Permission::Granted, 0).starts_with("acquisition: no samples for 3 s     3.0 s"));
        let rests = line(Permission::AwaitRest, StopReason::NoCommands as u8);
        assert!(rests.starts_with("ARM RESTS  acquisition: no samples for 3 s  "), "{rests}");
        let stopped = line(Permission::Stopped, StopReason::Ordered as u8);
        assert!(stopped.starts_with("ARM STOPPED (stopped by order)"), "{stopped}");
        assert!(stopped.contains("acquisition: no samples for 3 s"), "{stopped}");
        assert!(
            line_of(None, standstill).starts_with("acquisition: no samples for 3 s  waiting for the arm")
        );
    }
}
