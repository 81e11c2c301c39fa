//! Sessions as they should go: simulated, from start to report.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use nix::sys::signal::Signal;
use tendon_gesture::Gesture;
use tendon_report::Report;
use tendon_system_tests::{TendonBuilder, model, unique_session};

/// What a stage may have published after the next one stopped, or what lies in a full queue.
const UNDER_WAY: u64 = 64;

/// Asserts what holds of the counts of every session on a machine that keeps up: nothing was lost, and each
/// hop was measured for every message but those that were under way at the end.
fn assert_consistent(report: &Report) {
    let topics = ["blocks", "windows", "predictions", "commands"];
    assert_eq!(report.hops.len(), topics.len(), "{report:#?}");
    for (hop, topic) in report.hops.iter().zip(topics) {
        let messages = report.messages[topic];
        assert_eq!(messages.lost, 0, "{topic}: {report:#?}");
        assert!(hop.transit.count <= messages.published, "{topic}: {report:#?}");
        assert!(hop.transit.count + UNDER_WAY >= messages.published, "{topic}: {report:#?}");
        let work = report.work.iter().find(|work| work.stage == hop.to).unwrap();
        assert_eq!(work.work.count, hop.transit.count, "{topic}: {report:#?}");
    }
    let commands = report.messages["commands"].published;
    assert_eq!(report.newest_sample_to_command.count, commands, "{report:#?}");
    assert_eq!(report.window_start_to_command.count, commands, "{report:#?}");
    assert_eq!(report.replaced_samples, 0);
    assert_eq!(report.restarts, 0);
}

#[test]
fn a_simulated_session_ends_in_time_with_a_consistent_report_and_leaves_nothing_behind() {
    let session = unique_session();
    let ended =
        TendonBuilder::run(&session).args(&["--duration", "4s", "--script", "rest 1s, grip 1s"]).end();
    let report = ended.report();
    assert_consistent(&report);
    assert_eq!(report.session, session.to_string());
    assert!(report.model.ends_with("cnn-five-gesture.onnx"), "{report:#?}");
    assert!(report.duration_s >= 4.0, "{report:#?}");
    // Of 49 windows; some may be left out where the machine could not keep up.
    assert!(report.messages["windows"].published >= 20, "{report:#?}");
    assert!(report.recognition.windows > 0, "{report:#?}");
    for line in ["transit (publish to receive)", "newest sample to command", "recognition"] {
        assert!(ended.output.contains(line), "`{line}` is not in {}", ended.output);
    }
}

#[test]
fn the_two_stage_strategy_asks_two_models() {
    let rest_move = model("cnn-rest-move");
    let setting = format!("inference.rest_move_model={}", rest_move.display());
    let ended = TendonBuilder::run(&unique_session())
        .args(&[
            "--duration",
            "4s",
            "--script",
            "rest 1s, grip 1s",
            "--strategy",
            "two_stage",
            "--set",
            &setting,
        ])
        .end();
    let report = ended.report();
    assert_consistent(&report);
    assert_eq!(report.strategy, "two_stage");
    assert!(report.model.contains("cnn-rest-move.onnx, ") && report.model.ends_with("cnn-five-gesture.onnx"));
    assert!(report.recognition.windows > 0, "{report:#?}");
    // Rest is said by the first stage only, gestures by the second only; both are.
    for gesture in ["rest", "grip"] {
        assert!(report.recognition.per_gesture[gesture].correct > 0, "{report:#?}");
    }
    let allocations: u64 = report.allocations.values().sum();
    assert_eq!(allocations, 0, "{report:#?}");
}

#[test]
fn the_report_has_the_keys_that_other_programs_read() {
    let ended = TendonBuilder::run(&unique_session()).args(&["--duration", "2s"]).end();
    ended.report();
    let report: serde_json::Value = serde_json::from_str(&ended.report_json.unwrap()).unwrap();
    let latency = ["count", "p50_us", "p99_us", "p999_us", "max_us"];
    let stages = ["acquisition", "dsp", "inference", "decision", "robot"];
    let numbers = |value: &serde_json::Value, keys: &[&str]| {
        for key in keys {
            assert!(value[key].is_number(), "{key} of {value:#} is no number: {report:#}");
        }
    };
    for key in ["session", "source", "robot", "model"] {
        assert!(report[key].is_string(), "{key} is no text: {report:#}");
    }
    numbers(&report, &["duration_s", "restarts"]);
    for index in 0..4 {
        let hop = &report["hops"][index];
        numbers(hop, &latency);
        assert_eq!(hop["from"], stages[index]);
        assert_eq!(hop["to"], stages[index + 1]);
    }
    for (index, stage) in stages.iter().enumerate() {
        let work = &report["work"][index];
        numbers(work, &latency);
        assert_eq!(work["stage"], *stage);
    }
    for key in ["newest_sample_to_command", "control_tick", "command_to_wire"] {
        numbers(&report[key], &latency);
    }
    numbers(
        &report["window_start_to_command"],
        &["count", "mean_ms", "sd_ms", "min_ms", "median_ms", "max_ms"],
    );
    for topic in ["blocks", "windows", "predictions", "commands"] {
        numbers(&report["messages"][topic], &["published", "lost"]);
    }
    numbers(&report["recognition"], &["windows", "correct"]);
    numbers(&report["recognition"]["per_gesture"]["rest"], &["windows", "correct"]);
    numbers(&report["cpu_s"], &stages);
}

#[test]
fn ctrl_c_and_sigterm_end_a_session_with_its_report() {
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let mut tendon = TendonBuilder::run(&unique_session()).start();
        tendon.wait_until_running();
        tendon.signal(signal);
        let report = tendon.end().report();
        assert_eq!(report.source, "simulate", "after {signal}");
    }
}

#[test]
fn two_sessions_at_once_do_not_meet() {
    let mut first = TendonBuilder::run(&unique_session()).args(&["--script", "rest 1s, grip 1s"]).start();
    first.wait_until_running();
    let second = TendonBuilder::run(&unique_session())
        .args(&["--script", "rest 1s, flexion 1s", "--duration", "5s"])
        .end()
        .report();
    first.signal(Signal::SIGINT);
    for (report, gesture) in [(first.end().report(), Gesture::GRIP), (second, Gesture::FLEXION)] {
        assert_consistent(&report);
        let made: Vec<&str> = report.recognition.per_gesture.keys().map(String::as_str).collect();
        assert_eq!(made, [gesture.name(), "rest"], "{report:#?}");
    }
}

#[test]
fn the_path_of_a_sample_allocates_nothing_once_warm() {
    let report = TendonBuilder::run(&unique_session()).args(&["--duration", "6s"]).end().report();
    assert_eq!(report.allocations.len(), 5, "{report:#?}");
    assert!(report.allocations.values().all(|allocations| *allocations == 0), "{:#?}", report.allocations);
}

#[test]
fn all_gestures_of_the_default_script_are_recognised() {
    let report = TendonBuilder::run(&unique_session()).args(&["--duration", "21s"]).end().report();
    assert_consistent(&report);
    let recognition = &report.recognition;
    assert_eq!(recognition.per_gesture.len(), Gesture::PAPER.len(), "{recognition:#?}");
    // The seed sets the samples, so only windows that the machine was too slow for can be missing.
    assert!(100 * recognition.correct >= 95 * recognition.windows, "{recognition:#?}");
}
