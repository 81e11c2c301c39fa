//! A person from recordings to a session: calibrated, listed, run, and refused where they do not fit.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::path::Path;

use nix::sys::signal::{Signal, kill};
use tendon_system_tests::recordings::write_three_dc;
use tendon_system_tests::{Ended, TendonBuilder, unique_session};

/// What people are recorded in: one repetition of rest, extension and grip.
const EMG: &str = "Participant7/train/EMG";

fn tendon(data: &Path, arguments: &[&str]) -> TendonBuilder {
    TendonBuilder::command(&unique_session(), arguments).env("XDG_DATA_HOME", data)
}

fn calibrate(data: &Path, name: &str, arguments: &[&str]) -> Ended {
    tendon(data, &["calibrate", name, "--from"]).arg(data.join(EMG)).args(arguments).end()
}

/// A folder with recordings, in which people are kept, too.
fn recorded() -> tempfile::TempDir {
    let data = tempfile::tempdir().unwrap();
    write_three_dc(&data.path().join(EMG));
    data
}

#[test]
fn a_person_is_calibrated_from_recordings_and_runs_a_session() {
    let data = recorded();
    let data = data.path();
    let ended = calibrate(data, "anna", &["--json", "learnt.json"]);
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    for part in [
        "anna: 3 gestures on channels 0, 3, 5, 8 in adc_counts, windows of 150 ms",
        "expected accuracy",
        "person.toml",
    ] {
        assert!(ended.output.contains(part), "`{part}` is not in {}", ended.output);
    }
    let listed = tendon(data, &["people"]).end();
    assert!(listed.output.contains("rest, extension, grip; 0, 3, 5, 8"), "{}", listed.output);

    let session = unique_session();
    let run =
        TendonBuilder::command(&session, &["run", "--session", &session.to_string(), "--person", "anna"])
            .env("XDG_DATA_HOME", data)
            .args(&["--pace", "full", "--realtime", "off", "--json", "report.json", "--replay"])
            .arg(data.join(EMG));
    let report = run.end().report();
    assert_eq!(report.strategy, "personal");
    assert!(report.model.ends_with("anna/person.toml"), "{}", report.model);
    // 12 s in windows of 150 ms, one every 25 ms.
    assert_eq!(report.messages["predictions"].published, (24_000 - 300) / 50 + 1);
    let recognition = &report.recognition;
    assert!(recognition.windows > 400, "{recognition:?}");
    assert!(recognition.correct as f64 > 0.95 * recognition.windows as f64, "{recognition:?}");
}

#[test]
fn a_session_that_adapts_leaves_the_person_as_it_was_and_is_replayed_and_deleted() {
    let data = recorded();
    let data = data.path();
    // Nobody else's sessions keep this person from being deleted.
    let name = "adele";
    assert_eq!(calibrate(data, name, &[]).exit_code, Some(0));
    let file = data.join("tendon/people/adele/person.toml");
    let before = std::fs::read(&file).unwrap();
    let sessions = data.join("tendon/sessions");
    let run = |replay: &Path, arguments: &[&str]| {
        let session = unique_session();
        TendonBuilder::command(&session, &["run", "--session", &session.to_string()])
            .env("XDG_DATA_HOME", data)
            .args(&["--pace", "full", "--realtime", "off", "--json", "report.json"])
            .args(arguments)
            .arg("--replay")
            .arg(replay)
    };
    let adapting = ["--person", name, "--set", "inference.adaptation=slow"];
    let report = run(&data.join(EMG), &adapting).end().report();
    assert_eq!(report.allocations["inference"], 0);
    let recognition = &report.recognition;
    assert!(recognition.windows > 400, "{recognition:?}");
    assert!(recognition.correct as f64 > 0.95 * recognition.windows as f64, "{recognition:?}");
    assert_eq!(std::fs::read(&file).unwrap(), before);

    let recorded = run(&data.join(EMG), &adapting).arg("--record").arg(&sessions).end().report();
    let recorded = &recorded.recordings[0].path;
    let replays = &data.join("replays");
    let replayed = run(recorded, &[]).arg("--record").arg(replays).end().report();
    let replayed = &replayed.recordings[0].path;
    let compared = tendon(data, &["compare"]).arg(recorded).arg(replayed).end();
    assert_eq!(compared.exit_code, Some(0), "{compared:#?}");

    tendon(data, &["delete", name]).end().assert_failed(2, &["nothing was deleted", "--yes"]);
    assert!(file.exists() && recorded.exists());
    let deleted = tendon(data, &["delete", name, "--yes", "--in"]).arg(replays).end();
    assert_eq!(deleted.exit_code, Some(0), "{deleted:#?}");
    assert!(!file.exists() && !recorded.exists() && !replayed.exists(), "{deleted:#?}");
    assert_eq!(std::fs::read_dir(data.join("tendon/people")).unwrap().count(), 0, "{deleted:#?}");
    let again = tendon(data, &["delete", name, "--yes"]).end();
    assert!(again.output.starts_with("nothing is kept of adele"), "{again:#?}");
}

#[test]
fn a_name_is_taken_once_and_what_does_not_fit_is_refused_by_name() {
    let data = recorded();
    let data = data.path();
    assert_eq!(calibrate(data, "anna", &[]).exit_code, Some(0));
    calibrate(data, "anna", &[]).assert_failed(2, &["there is a person `anna` already", "--replace"]);
    assert_eq!(calibrate(data, "anna", &["--replace"]).exit_code, Some(0));
    calibrate(data, "Anna", &[]).assert_failed(2, &["`Anna` is no name for a person"]);
    calibrate(data, "berta", &["--session", "test"]).assert_failed(2, &["--session test", "only train"]);
    calibrate(data, "berta", &["--gestures", "fist"]).assert_failed(2, &["--gestures fist", "no window"]);
    calibrate(data, "berta", &["--channels", "0,77"]).assert_failed(2, &["77"]);

    let run = |person: &str, arguments: &[&str]| {
        tendon(data, &["run", "--duration", "1s", "--person", person]).args(arguments).end()
    };
    run("berta", &[]).assert_failed(2, &["there is no person `berta`, only anna"]);
    for (setting, said) in [
        ("acquisition.channels=3", "channels: calibrated with 4 (0, 3, 5, 8), the session has 3"),
        (
            "acquisition.sample_rate_hz=1000",
            "sampling rate: calibrated with 2000 Hz, the session has 1000 Hz",
        ),
        (
            "dsp.windows.window_samples=600",
            "window: calibrated with 300 samples, the session has 600 samples",
        ),
        (
            "dsp.filter.notch_hz=50",
            "notch: calibrated with a notch at 60 Hz, the session has a notch at 50 Hz",
        ),
    ] {
        run("anna", &["--set", setting]).assert_failed(2, &["anna does not fit", said]);
    }
    let file = data.join("tendon/people/anna/person.toml");
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, &text[..text.len() / 2]).unwrap();
    run("anna", &[]).assert_failed(2, &["person.toml", "cut short"]);
    let listed = tendon(data, &["people"]).end();
    assert!(listed.output.contains("cut short"), "{}", listed.output);
}

#[test]
fn a_session_does_not_go_on_with_a_person_file_that_was_replaced_meanwhile() {
    let data = recorded();
    let data = data.path();
    assert_eq!(calibrate(data, "anna", &[]).exit_code, Some(0));
    let session = unique_session();
    let mut run =
        TendonBuilder::command(&session, &["run", "--session", &session.to_string(), "--person", "anna"])
            .env("XDG_DATA_HOME", data)
            .args(&["--duration", "60s"])
            .start();
    run.wait_until_running();
    let replaced = calibrate(data, "anna", &["--replace", "--channels", "1,2,3,4"]);
    assert_eq!(replaced.exit_code, Some(0), "{replaced:#?}");
    kill(run.stage("inference"), Signal::SIGKILL).unwrap();
    run.end().assert_failed(1, &["person.toml", "not the person that the session began with"]);
}
