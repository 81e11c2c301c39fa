//! The whole system put to use: a simulated user steers the arm into zones, from muscle to motion and back.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::path::Path;

use tendon_system_tests::{TendonBuilder, unique_session};

/// Near and wide zones and no slips, so that a short session holds some of them even on a machine that is slow.
fn near_and_wide_zones(figures: &Path, arguments: &[&str]) -> TendonBuilder {
    TendonBuilder::run(&unique_session())
        .args(&["--task", "zones"])
        .args(arguments)
        .args(&["--set", "task.distance_mm=[50, 80]", "--set", "task.width_mm=60"])
        .args(&["--set", "task.user.error_rate=0"])
        .arg("--figures")
        .arg(figures)
}

#[test]
fn a_simulated_user_steers_the_arm_into_zones() {
    let figures = tempfile::tempdir().unwrap();
    let ended = near_and_wide_zones(figures.path(), &["--duration", "25s"]).end();
    let task = ended.report().task.unwrap();
    assert!(task.zones_reached >= 1, "{task:#?}");
    assert_eq!((task.name.as_str(), task.user.as_str(), task.box_violations), ("zones", "simulated", 0));
    assert!(task.throughput_bits_per_s.unwrap() > 0.0, "{task:#?}");
    assert_eq!(task.zones.len(), task.zones_reached + task.zones_timed_out);
    // The first zone comes after the 5 s of calibration.
    assert!(task.duration_s < 20.0, "{task:#?}");
    assert!(ended.output.contains("zones reached"), "{}", ended.output);
    for figure in ["zones.png", "zones.svg"] {
        assert!(figures.path().join(figure).is_file(), "{figure} is missing");
    }
}

/// The plane in one mode, and x in another; a grip changes them.
const TWO_MODES: &str = "decision.modes=[{ name = \"y-z\", extension = \"+z\", flexion = \"-z\", ulnar = \"+y\", radial = \"-y\", \
                         grip = \"next_mode\" }, { name = \"x\", extension = \"+x\", flexion = \"-x\", grip = \"next_mode\" }]";

#[test]
fn with_a_second_mode_the_zones_lie_in_space_and_are_reached() {
    let figures = tempfile::tempdir().unwrap();
    let ended = near_and_wide_zones(figures.path(), &["--duration", "45s", "--set", TWO_MODES]).end();
    let task = ended.report().task.unwrap();
    assert!(task.zones_reached >= 2, "{task:#?}");
    assert_eq!(task.box_violations, 0);
    let x_mm: Vec<f64> = task.zones.iter().map(|zone| zone.centre_mm[0]).collect();
    assert!(x_mm.iter().any(|x_mm| (x_mm - 386.0).abs() > 10.0), "{x_mm:?}");
    let figure = std::fs::read_to_string(figures.path().join("zones.svg")).unwrap();
    assert!(figure.contains("side view"));
}

#[test]
fn a_script_may_do_the_papers_task_and_a_session_without_a_task_has_no_score() {
    let run = |task: &[&str]| {
        let builder =
            TendonBuilder::run(&unique_session()).args(&["--duration", "7s", "--script", "rest 6s"]);
        builder.args(task).end().report()
    };
    let task = run(&["--task", "paper-zones"]).task.unwrap();
    assert_eq!((task.name.as_str(), task.user.as_str()), ("paper-zones", "person"));
    assert_eq!((task.zones_reached, task.dwell_s), (0, 0.0));
    assert_eq!(run(&[]).task, None);
}

#[test]
fn a_task_that_cannot_be_done_is_refused_before_anything_moves() {
    let run = || TendonBuilder::run(&unique_session()).args(&["--task", "zones"]);
    run().args(&["--set", "task.width_mm=400"]).end().assert_failed(2, &["no room for zones 400 mm wide"]);
    run()
        .args(&[
            "--set",
            "decision.modes=[{ name = \"turn\", ulnar = \"+yaw\", radial = \"-yaw\", extension = \"+z\" }]",
        ])
        .end()
        .assert_failed(
            2,
            &["[[decision.modes]]", "no mode moves the arm both ways along an axis of its base"],
        );
    run()
        .args(&["--set", "task.dwell_s=-1"])
        .end()
        .assert_failed(2, &["[task] dwell_s = -1: take 0 to 60 s"]);
}

#[test]
fn a_task_at_full_speed_is_refused() {
    TendonBuilder::run(&unique_session())
        .args(&["--task", "zones", "--replay", "emg.csv", "--replay-rate-hz", "1000", "--pace", "full"])
        .end()
        .assert_failed(2, &["--task", "--pace full"]);
}
