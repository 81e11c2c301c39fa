//! What a session writes: files are checked before it starts and written however it ends and whatever happens to the
//! others, and results say where they come from.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::fs;
use std::path::Path;

use nix::sys::signal::Signal;
use serde_json::Value;
use tendon_report::{Outcome, Report};
use tendon_system_tests::recordings::{MOVEMENT, Stretch, write_table, write_three_dc};
use tendon_system_tests::{Ended, TendonBuilder, model, unique_session, wait_until};

#[test]
fn an_output_that_cannot_be_written_is_refused_before_anything_starts() {
    let folder = tempfile::tempdir().unwrap();
    for option in ["--json", "--latency-log"] {
        let missing = folder.path().join("missing/file");
        let ended = TendonBuilder::command(&unique_session(), &["run", option]).arg(&missing).end();
        ended.assert_failed(2, &[missing.to_str().unwrap(), "there is no folder"]);
        let ended = TendonBuilder::command(&unique_session(), &["run", option]).arg(folder.path()).end();
        ended.assert_failed(2, &[folder.path().to_str().unwrap(), "is a folder"]);
        let pipe = folder.path().join(format!("pipe{option}"));
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        let ended = TendonBuilder::command(&unique_session(), &["run", option]).arg(&pipe).end();
        ended.assert_failed(2, &[pipe.to_str().unwrap(), "nobody reads the pipe"]);
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
    let cases: [(&[&str], &[&str]); 7] = [
        (&["run", "--json", "a.json", "--figures", "a.json"], &["a.json", "two outputs"]),
        (&["run", "--latency-log", "a", "--figures", "./b/../a/figures"], &["lies below a", "another path"]),
        (&["run", "--json", "mine.toml", "--config", "mine.toml"], &["mine.toml", "what the command reads"]),
        (&[&evaluate[..], &["--json", "scores", "--figures", "scores"]].concat(), &["scores", "two outputs"]),
        (&["strategies", "emg.csv", "--json", "emg.csv"], &["emg.csv", "what the command reads"]),
        (&["profile", "fit", "emg.csv", "--out", "emg.csv"], &["emg.csv", "what the command reads"]),
        (&["profile", "fit", "emg.csv", "--out", "notes.txt"], &["notes.txt", "is no profile"]),
    ];
    for (arguments, parts) in cases {
        let builder = TendonBuilder::command(&unique_session(), arguments);
        let folder = builder.folder().to_owned();
        fs::create_dir(folder.join("b")).unwrap();
        for input in ["mine.toml", "emg.csv"] {
            fs::write(folder.join(input), "").unwrap();
        }
        fs::write(folder.join("notes.txt"), "mine").unwrap();
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

/// The report of a session that did not start: it says so, and why, and has all keys.
fn assert_not_started(ended: &Ended, reasons: &[&str]) {
    assert_eq!(ended.exit_code, Some(2), "{ended:#?}");
    let json: Value = serde_json::from_str(ended.report_json.as_deref().expect("a report")).unwrap();
    assert_eq!(json["outcome"], "not_started", "{json:#}");
    let error = json["error"].as_str().unwrap();
    assert!(reasons.iter().all(|reason| error.contains(reason)), "{reasons:?}: {error}");
    assert_eq!(json["provenance"]["version"], env!("CARGO_PKG_VERSION"));
    let report: Report = serde_json::from_value(json).unwrap();
    assert_eq!(report.hops.len(), 4);
    assert_eq!((report.duration_s, report.newest_sample_to_command.count), (0.0, 0));
}

#[test]
fn a_session_that_cannot_start_writes_its_report_with_the_reason() {
    for (settings, reasons) in [
        // A stage ends: what it said itself is the reason.
        (&["acquisition.channels=8"][..], &["tendon inference: error:", "channels", "inference ended"][..]),
        (
            // Nobody listens at that port.
            &["robot.backend=xarm", "robot.xarm.address=127.0.0.1", "robot.xarm.control_port=1"],
            &[
                "tendon robot: error:",
                "127.0.0.1:1 ",
                "no arm answers at 127.0.0.1:1: check address, cable and power",
            ],
        ),
    ] {
        let mut builder = TendonBuilder::run(&unique_session());
        for setting in settings {
            builder = builder.args(&["--set", setting]);
        }
        assert_not_started(&builder.end(), reasons);
    }
    // Nothing is started.
    let missing = Path::new("/nowhere/model.onnx");
    let ended = TendonBuilder::run_with_model(&unique_session(), missing).end();
    assert_not_started(&ended, &["cannot open /nowhere/model.onnx"]);
    let mut first = TendonBuilder::run(&unique_session()).start();
    first.wait_until_running();
    let second = TendonBuilder::run(first.session()).start().end_whatever_is_left();
    assert_not_started(&second, &["is in use by process", &first.id().to_string()]);
    first.signal(Signal::SIGTERM);
    let report = first.end().report();
    assert_eq!((report.outcome, report.error), (Outcome::Completed, None));
}

#[test]
fn a_session_that_cannot_start_writes_its_log_and_says_once_that_there_is_nothing_to_draw() {
    let folder = tempfile::tempdir().unwrap();
    let [log, figures] = ["latency.log", "figures"].map(|name| folder.path().join(name));
    let builder = TendonBuilder::run(&unique_session()).args(&["--set", "acquisition.channels=8"]);
    let ended = builder.arg("--latency-log").arg(&log).arg("--figures").arg(&figures).end();
    assert_not_started(&ended, &["channels"]);
    assert_eq!(ended.errors.matches("nothing to draw").count(), 1, "{ended:#?}");
    assert!(!figures.exists());
    let log = fs::read_to_string(&log).unwrap();
    assert!(log.contains("Tag=newest-sample-to-command"), "{log}");
}

#[test]
fn a_session_that_is_ended_before_it_began_says_so() {
    // It waits for an arm that accepts the connection and says nothing.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("robot.xarm.control_port={}", silent.local_addr().unwrap().port());
    let tendon = TendonBuilder::run(&unique_session())
        .args(&["--set", "robot.backend=xarm", "--set", "robot.xarm.address=127.0.0.1", "--set", &port])
        .start();
    wait_until("the stages", || (!tendon.stages().is_empty()).then_some(()));
    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    assert!(ended.errors.contains("ended before it began"), "{ended:#?}");
    let report = ended.report();
    assert_eq!((report.outcome, report.error), (Outcome::NotStarted, None));
}

#[test]
fn a_session_that_breaks_off_says_why_in_its_report() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    tendon.kill_until_it_gives_up("decision");
    let ended = tendon.end();
    assert_eq!(ended.exit_code, Some(1), "{ended:#?}");
    let report: Report = serde_json::from_str(ended.report_json.as_deref().unwrap()).unwrap();
    assert_eq!(report.outcome, Outcome::BrokeOff);
    assert!(report.error.as_deref().is_some_and(|error| error.contains("decision ended")), "{report:#?}");
    let restarts: Vec<_> =
        report.events.iter().filter(|event| event.text.contains("started again")).collect();
    assert_eq!(restarts.len() as u64, report.restarts);
    assert!(report.restarts > 0);
}
