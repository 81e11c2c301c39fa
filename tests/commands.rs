//! The other commands of `tendon`.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use nix::sys::signal::Signal;
use tendon_system_tests::recordings::{real_three_dc, write_three_dc};
use tendon_system_tests::{TendonBuilder, model, program, repository, unique_session};

#[test]
fn latency_looks_on_at_a_running_session() {
    let session = unique_session();
    let mut tendon = TendonBuilder::run(&session).start();
    tendon.wait_until_running();
    let arguments = ["latency", "--session", &session.to_string(), "--duration", "3s"];
    let ended = TendonBuilder::command(&session, &arguments).start().end_whatever_is_left();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    for row in [
        "acquisition to dsp",
        "dsp to inference",
        "inference to decision",
        "decision to robot",
        "newest sample to command",
    ] {
        let count = |line: &str| -> Option<u64> {
            line.trim().strip_prefix(row)?.split_whitespace().next()?.parse().ok()
        };
        let last = ended.output.lines().filter_map(count).next_back();
        assert!(last.is_some_and(|count| count > 0), "{row}: {}", ended.output);
    }
    tendon.signal(Signal::SIGINT);
    tendon.end().report();
}

#[test]
fn latency_of_no_session_says_how_to_start_one() {
    let session = unique_session();
    let ended = TendonBuilder::command(&session, &["latency", "--session", &session.to_string()]).end();
    ended.assert_failed(2, &[&format!("no session `{session}` is running"), "start it with `tendon run`"]);
}

#[test]
fn doctor_says_what_it_found() {
    let ended = TendonBuilder::command(&unique_session(), &["doctor"]).end();
    for finding in ["programs", "model and runtime", "shared memory", "scheduling", "leftovers"] {
        assert!(ended.output.contains(finding), "{finding}: {ended:#?}");
    }
    // The models are looked for above the programs, which may have been built elsewhere.
    if program("tendon").starts_with(repository()) {
        assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
        assert!(!ended.output.contains("BROKEN"), "{ended:#?}");
    }
}

#[test]
fn a_profile_fitted_to_real_recordings_runs() {
    let Some(recordings) = real_three_dc() else { return };
    let folder = tempfile::tempdir().unwrap();
    let profile = folder.path().join("profile.toml");
    let session = unique_session();
    let fit = TendonBuilder::command(&session, &["profile", "fit", "--out"]);
    let ended = fit.arg(&profile).arg(&recordings).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.output.contains("profile of 4 channels"), "{ended:#?}");
    let setting = format!("acquisition.simulate.profile={}", profile.display());
    let report = TendonBuilder::run(&session).args(&["--duration", "2s", "--set", &setting]).end().report();
    assert!(report.messages["commands"].published > 0, "{report:#?}");
}

#[test]
fn a_data_set_is_built_from_real_recordings() {
    let Some(recordings) = real_three_dc() else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("windows");
    let build = TendonBuilder::command(&unique_session(), &["dataset", "build", "--out"]);
    let ended = build.arg(&out).arg(&recordings).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    let manifest = std::fs::read_to_string(out.join("manifest.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
    let windows = manifest["windows"].as_u64().unwrap();
    assert!(windows > 0, "{manifest:#}");
    // 4 channels × 600 samples × 4 bytes each, after a header.
    let bytes = std::fs::metadata(out.join("windows.npy")).unwrap().len();
    assert!((1..1000).contains(&(bytes - windows * 4 * 600 * 4)), "{bytes} bytes for {windows} windows");
}

/// A data set of one person, whose recording is made here.
fn build_data_set(folder: &std::path::Path) -> std::path::PathBuf {
    let recording = folder.join("Participant7/train/EMG");
    write_three_dc(&recording);
    let out = folder.join("windows");
    let build =
        TendonBuilder::command(&unique_session(), &["dataset", "build", "--channels", "0,1,2,3", "--out"]);
    let ended = build.arg(&out).arg(&recording).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    out
}

#[test]
fn a_model_is_scored_on_a_data_set() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = build_data_set(folder.path());
    let [json, figures] = ["scores.json", "figures"].map(|name| folder.path().join(name));
    let evaluate = |model_name: &str| {
        let command = TendonBuilder::command(&unique_session(), &["evaluate"]).arg(&dataset);
        command.arg("--model").arg(model(model_name))
    };
    let ended = evaluate("cnn-six-class").arg("--json").arg(&json).arg("--figures").arg(&figures).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.output.contains("person 7"), "{ended:#?}");
    let scores: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    let manifest = std::fs::read_to_string(dataset.join("manifest.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
    assert_eq!(scores["windows"], manifest["windows"]);
    for gesture in ["rest", "extension", "grip"] {
        let support = &scores["per_class"][gesture]["support"];
        assert_eq!(support, &manifest["windows_per_gesture"][gesture], "{gesture}");
    }
    for figure in ["confusion.png", "confusion.svg", "work.png", "work.svg"] {
        assert!(figures.join(format!("cnn-six-class-{figure}")).is_file(), "{figure}");
    }

    // The five-gesture model knows no rest: those windows are left out, and it says so.
    let ended = evaluate("cnn-five-gesture").end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    let rest = &manifest["windows_per_gesture"]["rest"];
    assert!(ended.output.contains(&format!("left out: {rest} windows of rest")), "{ended:#?}");
}

#[test]
fn an_evaluation_that_makes_no_sense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = build_data_set(folder.path());
    let evaluate = |dataset: &std::path::Path, arguments: &[&str]| {
        let command = TendonBuilder::command(&unique_session(), &["evaluate"]).arg(dataset);
        command.arg("--model").arg(model("cnn-six-class")).args(arguments).end()
    };
    evaluate(&dataset, &["--people", "8"]).assert_failed(2, &["--people 8", "the data set has only 7"]);
    evaluate(folder.path(), &[]).assert_failed(2, &["manifest.json", "tendon dataset build"]);
    let labels = dataset.join("labels.npy");
    let complete = std::fs::read(&labels).unwrap();
    std::fs::write(&labels, &complete[..complete.len() - 1]).unwrap();
    evaluate(&dataset, &[]).assert_failed(2, &["labels.npy", "is it complete?"]);

    // Windows of two channels are none for a model of four.
    let out = folder.path().join("two-channels");
    let recording = folder.path().join("Participant7/train/EMG");
    let build =
        TendonBuilder::command(&unique_session(), &["dataset", "build", "--channels", "0,1", "--out"]);
    assert_eq!(build.arg(&out).arg(&recording).end().exit_code, Some(0));
    evaluate(&out, &[]).assert_failed(2, &["channels: the model wants 4, the data set has 2"]);
}
