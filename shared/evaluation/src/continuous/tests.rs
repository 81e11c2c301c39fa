use super::*;

const RATE_HZ: f64 = 2000.0;
const INCREMENT: usize = 150;

/// Rest for 2 s, grip for 2 s with its onset after 0.5 s, ulnar likewise, nothing for 3 s.
fn cues() -> [CuePart; 4] {
    let asked = [Gesture::REST, Gesture::GRIP, Gesture::ULNAR].map(Asked::Gesture);
    [asked[0], asked[1], asked[2], Asked::Nothing].map(|asked| {
        let start = match asked {
            Asked::Gesture(Gesture::REST) => 0,
            Asked::Gesture(Gesture::GRIP) => 4000,
            Asked::Gesture(_) => 8000,
            _ => 12_000,
        };
        let onset = asked.is_movement().then_some(start + 1000);
        let begun = (asked != Asked::Nothing).then_some(onset.map_or(start + 500, |onset| onset - 100));
        let end = if asked == Asked::Nothing { 18_000 } else { start + 4000 };
        CuePart { asked, is_scored: true, start, begun, onset, end }
    })
}

/// What a strategy decides about a window that ends there.
#[derive(Clone, Copy)]
struct Decided {
    gesture: Gesture,
    toggles: bool,
}

impl Decided {
    fn on(gesture: Gesture) -> Decided {
        Decided { gesture, toggles: false }
    }
}

/// A window every 150 samples, of 600, with what `decide` makes of its end. Directions move the arm at 50 mm/s.
fn steps(decide: impl Fn(u64) -> Decided) -> Vec<Step> {
    let step = |first_sample: u64| {
        let end_sample = first_sample + 600;
        let Decided { gesture, toggles } = decide(end_sample);
        let moves = ![Gesture::REST, Gesture::GRIP].contains(&gesture);
        Step {
            first_sample,
            end_sample,
            calibrates: false,
            gesture,
            told: gesture,
            moves,
            speed_mm_per_s: if moves { 50.0 } else { 0.0 },
            toggles_gripper: toggles,
            work_ns: 500_000,
        }
    };
    (0..=17_400).step_by(INCREMENT).map(step).collect()
}

fn scores_of(cues: &[CuePart], steps: &[Step]) -> StrategyScores {
    let mut tally = StrategyTally::new(RATE_HZ, INCREMENT, vec![Gesture::GRIP]);
    tally.add(PersonId::Number(7), "train", 0, cues, steps);
    tally.scores()
}

fn scores(decide: impl Fn(u64) -> Decided) -> StrategyScores {
    scores_of(&cues(), &steps(decide))
}

/// What is right at the end of a window; a person lets go at once.
fn truth(end: u64) -> Gesture {
    match end {
        0..=4000 => Gesture::REST,
        4001..=8000 => Gesture::GRIP,
        8001..=12_000 => Gesture::ULNAR,
        _ => Gesture::REST,
    }
}

fn close(found: Option<f64>, expected: f64) {
    let found = found.expect("it is scored");
    assert!((found - expected).abs() < 1e-9, "{found} instead of {expected}");
}

#[test]
fn a_strategy_that_is_always_right_is_said_to_be() {
    let scores = scores(|end| Decided { gesture: truth(end), toggles: end == 6000 });
    assert_eq!(scores.mean_correct_percent, Some(100.0));
    assert_eq!(scores.per_gesture["rest"].moving_percent, 0.0);
    assert_eq!(scores.per_gesture["rest"].correct_of_moving_percent, None);
    // Windows from sample 500 to 4000 start at 600 to 3300: 19. From 12 000 + 2400 to 18 000: 14 400 to 17 400: 21.
    assert_eq!(scores.per_gesture["rest"].windows, 19 + 21);
    close(Some(scores.rest_scored_s), 40.0 * 0.075);
    assert_eq!(scores.per_repetition[0].correct_percent["ulnar"], 100.0);
    assert_eq!(scores.gripper_false_activations_per_min, Some(0.0));
    assert_eq!(scores.grips_answered_percent, Some(100.0));
    assert_eq!((scores.direction_changes_per_min, scores.never_answered), (Some(0.0), Some(0)));
    // Onsets at 5000 and 9000; the first windows that end later end at 5100 and 9150.
    let answered = scores.onset_to_first_correct_command_ms;
    assert_eq!((answered.count, answered.min, answered.max), (2, Some(50.5), Some(75.5)));
    close(answered.median, 63.0);
    close(answered.p90, 73.0);
    close(scores.correct_share, 1.0);
    close(scores.wrong_direction_share, 0.0);
    close(scores.rest_taken_for_movement_share, 0.0);
    close(scores.rest_false_activations_per_min, 0.0);
    close(scores.wrong_motion_mm_per_min, 0.0);
    let latency = scores.window_start_to_command_ms;
    assert_eq!((latency.mean, latency.median), (Some(300.5), Some(300.5)));
    let text = scores.to_string();
    assert!(
        text.contains("100.00 % correct, in 1 repetitions") && text.contains("90 % within 73 ms"),
        "{text}"
    );
}

#[test]
fn false_grips_changes_of_direction_and_unanswered_movements_are_counted() {
    // Radial and extension in turn during ulnar; the gripper moves once in rest, once late after the grip.
    let scores = scores(|end| {
        let gesture = match end {
            8001..=12_000 if end / 150 % 2 == 0 => Gesture::RADIAL,
            8001..=12_000 => Gesture::EXTENSION,
            _ => Gesture::REST,
        };
        Decided { gesture, toggles: end == 3000 || end == 8100 }
    });
    // Without grip: windows that end in 600 to 4000 (23), 8001 to 12 000 (27), and rest from 14 400 on (21).
    close(scores.gripper_false_activations_per_min, 60.0 / (71.0 * 0.075));
    assert_eq!(scores.grips_answered_percent, Some(0.0));
    // Windows of ulnar start at 9000 to 11 400: 17, so 16 changes, in 71 windows and the 27 of the grip.
    close(scores.direction_changes_per_min, 16.0 * 60.0 / (98.0 * 0.075));
    assert_eq!((scores.never_answered, scores.onset_to_first_correct_command_ms.count), (Some(2), 0));
    assert_eq!(scores.onset_to_first_correct_command_ms.median, None);
    let ulnar = &scores.per_gesture["ulnar"];
    assert_eq!((ulnar.moving_percent, ulnar.correct_percent), (100.0, 0.0));
    assert_eq!(ulnar.correct_of_moving_percent, Some(0.0));
    let mistaken = &scores.mistaken["ulnar"];
    assert_eq!(mistaken["radial"] + mistaken["extension"], ulnar.windows);
    // After the onsets: 20 windows end in 5100 to 7950, 20 in 9150 to 12 000. The latter go astray.
    close(scores.correct_share, 0.0);
    close(scores.wrong_direction_share, 0.5);
    close(scores.wrong_motion_mm_per_min, 20.0 * 50.0 / 80.0 * 60.0);
}

#[test]
fn a_wrong_grip_is_a_wrong_gesture_but_no_wrong_direction() {
    let scores = scores(|end| Decided::on(if end > 4000 { Gesture::GRIP } else { Gesture::REST }));
    close(scores.correct_share, 0.5);
    close(scores.wrong_gesture_share, 0.5);
    close(scores.wrong_direction_share, 0.0);
}

#[test]
fn whatever_gesture_works_the_gripper_is_the_grip() {
    let steps = steps(|end| Decided { gesture: truth(end), toggles: end == 6000 || end == 10_050 });
    let scores = |gripper: Gesture| {
        let mut tally = StrategyTally::new(RATE_HZ, INCREMENT, vec![gripper]);
        tally.add(PersonId::Number(7), "train", 0, &cues(), &steps);
        tally.scores()
    };
    let (grip, ulnar) = (scores(Gesture::GRIP), scores(Gesture::ULNAR));
    assert_eq!((grip.grips_answered_percent, ulnar.grips_answered_percent), (Some(100.0), Some(100.0)));
    // The other one of the two is false, in 71 windows without one or the other.
    close(grip.gripper_false_activations_per_min, 60.0 / (71.0 * 0.075));
    close(ulnar.gripper_false_activations_per_min, 60.0 / (71.0 * 0.075));
}

#[test]
fn movement_at_rest_is_counted_by_windows_by_beginnings_and_by_way() {
    // Two windows of ulnar in the first rest, and ulnar throughout what follows the last movement.
    let scores = scores(|end| match end {
        2100..=2250 | 12_001.. => Decided::on(Gesture::ULNAR),
        _ => Decided::on(truth(end)),
    });
    close(scores.rest_taken_for_movement_share, (2.0 + 21.0) / 40.0);
    // What begins before rest does is no activation in it.
    close(scores.rest_false_activations_per_min, 60.0 / (40.0 * 0.075));
    close(scores.wrong_motion_mm_per_min, 23.0 * 50.0 / 80.0 * 60.0);
}

#[test]
fn a_person_who_is_letting_go_does_not_rest_yet() {
    // The gesture is still told for 1.2 s after its cue has ended.
    let scores =
        scores(|end| Decided::on(if end <= 14_400 { truth(end.min(12_000)) } else { Gesture::REST }));
    close(scores.rest_taken_for_movement_share, 0.0);
    // A cue to rest right after a movement: 2.4 k samples to let go, then windows from 14 400 on as before.
    let mut rest_after = cues();
    rest_after[3] = CuePart { asked: Asked::Gesture(Gesture::REST), begun: Some(12_500), ..rest_after[3] };
    let told = steps(|end| Decided::on(if end <= 14_400 { truth(end.min(12_000)) } else { Gesture::REST }));
    let rest_after = scores_of(&rest_after, &told);
    close(rest_after.rest_taken_for_movement_share, 0.0);
    close(Some(rest_after.rest_scored_s), 40.0 * 0.075);
}

#[test]
fn rest_that_calibrated_is_not_scored() {
    let mut steps = steps(|end| Decided { gesture: Gesture::GRIP, toggles: end <= 4000 });
    steps.iter_mut().filter(|step| step.first_sample < 4000).for_each(|step| step.calibrates = true);
    let cues = &cues()[..3];
    let scores = scores_of(cues, &steps);
    assert_eq!((scores.rest_taken_for_movement_share, scores.rest_false_activations_per_min), (None, None));
    assert_eq!(scores.rest_scored_s, 0.0);
    assert!(!scores.per_gesture.contains_key("rest") && scores.per_gesture.contains_key("grip"));
    assert_eq!(scores.gripper_false_activations_per_min, Some(0.0));
    assert!(scores.to_string().contains("rest: not scored"), "{scores}");
}

#[test]
fn what_was_not_scored_is_null_and_neither_perfect_nor_zero() {
    let steps = steps(|_| Decided { gesture: Gesture::GRIP, toggles: true });
    let others = cues().map(|cue| CuePart { asked: Asked::OtherMovement, ..cue });
    let unscored = cues().map(|cue| CuePart { is_scored: false, ..cue });
    for cues in [others, unscored] {
        let scores = scores_of(&cues, &steps);
        assert_eq!((scores.scored_s, scores.rest_scored_s), (0.0, 0.0));
        assert!(scores.per_gesture.is_empty());
        let json = serde_json::to_value(&scores).unwrap();
        for key in [
            "mean_correct_percent",
            "correct_share",
            "wrong_gesture_share",
            "wrong_direction_share",
            "rest_taken_for_movement_share",
            "rest_false_activations_per_min",
            "wrong_motion_mm_per_min",
            "gripper_false_activations_per_min",
            "grips_answered_percent",
            "direction_changes_per_min",
            "never_answered",
        ] {
            assert!(json.get(key).is_some_and(serde_json::Value::is_null), "{key}: {json:#}");
        }
        assert!(json["onset_to_first_correct_command_ms"]["p90"].is_null(), "{json:#}");
        assert_eq!(json["onset_to_first_correct_command_ms"]["count"], 0);
    }
}

#[test]
fn a_movement_without_an_onset_is_said_and_not_scored() {
    let cues = cues().map(|cue| CuePart { onset: None, ..cue });
    let scores = scores_of(&cues, &steps(|end| Decided::on(truth(end))));
    assert_eq!((scores.movements_without_onset, scores.never_answered), (2, None));
    assert_eq!(scores.correct_share, None);
    assert_eq!(scores.per_gesture["ulnar"].correct_percent, 100.0);
}
