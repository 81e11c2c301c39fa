//! What a session writes and who may watch it: files are checked before it starts and written whatever happens to the
//! others, results say where they come from, and observers that were killed keep nobody out.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::fs;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use tendon_system_tests::recordings::{MOVEMENT, Stretch, write_table, write_three_dc};
use tendon_system_tests::{TendonBuilder, model, unique_session};

#[test]
fn an_output_that_cannot_be_written_is_refused_before_anything_starts() {
    let folder = tempfile::tempdir().unwrap();
    for option in ["--json", "--latency-log"] {
        let missing = folder.path().join("missing/file");
        let ended = TendonBuilder::command(&unique_session(), &["run", option]).arg(&missing).end();
        ended.assert_failed(2, &[missing.to_str().unwrap(), "there is no folder"]);
        let ended = TendonBuilder::command(&unique_session(), &["run", option]).arg(folder.path()).end();
        ended.assert_failed(2, &[folder.path().to_str().unwrap(), "is a folder"]);
    }
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let ended = TendonBuilder::command(&unique_session(), &["run", "--figures"]).arg(&file).end();
    ended.assert_failed(2, &["file is no folder"]);
    let arguments = ["run", "--json", "one", "--latency-log", "one"];
    TendonBuilder::command(&unique_session(), &arguments).end().assert_failed(2, &["two outputs"]);
}

#[test]
fn outputs_that_would_replace_each_other_or_what_is_read_are_refused() {
    let six = model("cnn-six-class");
    let evaluate = ["evaluate", "emg", "--model", six.to_str().unwrap()];
    let cases: [(&[&str], &[&str]); 6] = [
        (&["run", "--json", "a.json", "--figures", "a.json"], &["a.json", "two outputs"]),
        (&["run", "--latency-log", "a", "--figures", "./b/../a/figures"], &["lies below a", "another path"]),
        (&["run", "--json", "mine.toml", "--config", "mine.toml"], &["mine.toml", "what the command reads"]),
        (&[&evaluate[..], &["--json", "scores", "--figures", "scores"]].concat(), &["scores", "two outputs"]),
        (&["strategies", "emg.csv", "--json", "emg.csv"], &["emg.csv", "what the command reads"]),
        (&["profile", "fit", "emg.csv", "--out", "emg.csv"], &["emg.csv", "what the command reads"]),
    ];
    for (arguments, parts) in cases {
        let builder = TendonBuilder::command(&unique_session(), arguments);
        let folder = builder.folder().to_owned();
        fs::create_dir(folder.join("b")).unwrap();
        for input in ["mine.toml", "emg.csv"] {
            fs::write(folder.join(input), "").unwrap();
        }
        let before = fs::read_dir(&folder).unwrap().count();
        let mut tendon = builder.start();
        tendon.end_whatever_is_left().assert_failed(2, parts);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), before, "{arguments:?}");
        assert_eq!(fs::read(folder.join("emg.csv")).unwrap(), b"", "{arguments:?}");
    }
}

#[test]
fn a_full_disk_is_an_error_and_keeps_no_other_file_from_being_written() {
    let session = unique_session();
    let figures = tempfile::tempdir().unwrap();
    let ended = TendonBuilder::run(&session)
        .args(&["--duration", "1s", "--latency-log", "/dev/full", "--figures"])
        .arg(figures.path())
        .end();
    ended.assert_failed(1, &["cannot write /dev/full", "No space left"]);
    assert!(ended.output.contains("whole path"), "the table is missing: {ended:#?}");
    let report: Value = serde_json::from_str(ended.report_json.as_deref().unwrap()).unwrap();
    assert_eq!(report["session"], session.to_string());
    for figure in ["newest-sample-to-command", "window-start-to-command"] {
        assert!(figures.path().join(format!("{figure}.png")).is_file(), "{figure}");
    }
}

#[test]
fn a_report_that_is_there_is_replaced_and_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("earlier.json");
    fs::write(&report, "earlier").unwrap();
    let command = ["run", "--session", &unique_session().to_string(), "--duration", "1s", "--json"];
    let ended = TendonBuilder::command(&unique_session(), &command)
        .arg(&report)
        .arg("--model")
        .arg(model("cnn-five-gesture"))
        .end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.errors.contains("earlier.json is there already and will be replaced"), "{ended:#?}");
    let written: Value = serde_json::from_str(&fs::read_to_string(&report).unwrap()).unwrap();
    assert!(written["hops"].is_array());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
}

#[test]
fn a_report_says_where_it_comes_from() {
    let folder = tempfile::tempdir().unwrap();
    // The models that come with Tendon were trained on person 11, and not on person 50.
    for (person, is_trained_on) in [(11, true), (50, false)] {
        let recording = folder.path().join(format!("Participant{person}/train/EMG"));
        write_three_dc(&recording);
        let ended = TendonBuilder::run(&unique_session())
            .args(&["--pace", "full", "--set", "acquisition.replay.channels=[0,1,2,3]", "--replay"])
            .arg(&recording)
            .end();
        let provenance = ended.report().provenance;
        assert_eq!(provenance.version, env!("CARGO_PKG_VERSION"));
        assert_eq!(provenance.configuration["acquisition"]["source"], "replay");
        assert_eq!(provenance.configuration["decision"]["vote_windows"], 3);
        let [model] = &provenance.models[..] else { panic!("{provenance:#?}") };
        assert!(model.path.ends_with("cnn-five-gesture.onnx") && model.sha256.len() == 64);
        let hash = provenance.recording.unwrap();
        assert_eq!(hash.files as usize, fs::read_dir(&recording).unwrap().count());
        assert_eq!(provenance.trained_on_person, Some(is_trained_on));
    }
}

#[test]
fn a_person_of_another_data_set_is_not_the_one_whom_a_model_was_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    // Person 11 of the Ozdemir data set is not person 11 of 3DC, and nobody knows who person 11 of a table is.
    for (name, is_trained_on) in [("P11_C0_G1.csv", Some(false)), ("person11.csv", None)] {
        let table = folder.path().join(name);
        let stretch = Stretch { samples: 12_000, amplitudes: MOVEMENT };
        write_table(&table, &[stretch]);
        let ended = TendonBuilder::run(&unique_session())
            .args(&["--pace", "full", "--replay-rate-hz", "2000", "--replay"])
            .arg(&table)
            .end();
        assert_eq!(ended.report().provenance.trained_on_person, is_trained_on, "{name}");
    }
}

#[test]
fn observers_that_were_killed_keep_nobody_out() {
    let session = unique_session();
    let mut tendon = TendonBuilder::run(&session).start();
    tendon.wait_until_running();
    let latency = ["latency", "--session", &session.to_string(), "--interval", "100ms"];
    for _ in 0..9 {
        let mut observer = TendonBuilder::command(&session, &latency).start();
        observer.wait_for_output("newest sample to command");
        kill(Pid::from_raw(observer.id() as i32), Signal::SIGKILL).unwrap();
        assert_eq!(observer.end_whatever_is_left().exit_code, None);
    }
    let last =
        TendonBuilder::command(&session, &latency).args(&["--duration", "1s"]).start().end_whatever_is_left();
    assert_eq!(last.exit_code, Some(0), "{last:#?}");
    tendon.signal(Signal::SIGINT);
    tendon.end().report();
}
