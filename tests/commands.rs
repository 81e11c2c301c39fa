//! The other commands of `tendon`.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use nix::sys::signal::Signal;
use tendon_system_tests::recordings::real_three_dc;
use tendon_system_tests::{TendonBuilder, program, repository, unique_session};

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
