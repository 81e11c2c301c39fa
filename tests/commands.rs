//! The other commands of `tendon`.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use nix::sys::signal::Signal;
use tendon_system_tests::recordings::{MOVEMENT, REST, Stretch, real_three_dc, write_table, write_three_dc};
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
fn a_command_for_no_session_says_how_to_start_one_and_gives_the_same_code() {
    let session = unique_session();
    for command in ["latency", "stop", "arm"] {
        let ended = TendonBuilder::command(&session, &[command, "--session", &session.to_string()]).end();
        ended
            .assert_failed(2, &[&format!("no session `{session}` is running"), "start it with `tendon run`"]);
    }
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
fn doctor_looks_at_the_folders_of_a_real_arm_only_if_there_is_one() {
    let doctor =
        |settings: &[&str]| TendonBuilder::command(&unique_session(), &["doctor"]).args(settings).end();
    let ended = doctor(&["--set", "robot.backend=xarm", "--set", "robot.xarm.address=127.0.0.1"]);
    for folder in ["records of arms", "/tendon/arms", "notes on arms", "/var/tmp/tendon-arms"] {
        assert!(ended.output.contains(folder), "{folder}: {ended:#?}");
    }
    let ended = doctor(&[]);
    assert!(!ended.output.contains("tendon-arms"), "{ended:#?}");
}

/// Asserts that the doctor takes what `settings` say as little as `tendon run` does, and says the same of it.
fn assert_both_refuse(settings: &[&str], expected: &str) {
    let session = unique_session();
    let name = format!("session={session}");
    let [run, doctor] = [&["run", "--duration", "1s"][..], &["doctor"]].map(|command| {
        TendonBuilder::command(&session, command).args(&["--set", &name]).args(settings).end()
    });
    assert_eq!((run.exit_code, doctor.exit_code), (Some(2), Some(1)), "{run:#?} {doctor:#?}");
    assert!(run.errors.contains(expected), "{expected}: {run:#?}");
    let broken =
        doctor.output.lines().filter(|line| line.starts_with("BROKEN")).any(|line| line.contains(expected));
    assert!(broken, "{expected}: {doctor:#?}");
}

#[test]
fn doctor_refuses_what_run_refuses() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("emg.csv");
    std::fs::write(&table, "1,2,3,4\n1,2,lunch,4\n").unwrap();
    let replay = format!("acquisition.replay.path={}", table.display());
    let replay = ["--set", "acquisition.source=replay", "--set", &replay];
    let with_rate = [&replay[..], &["--set", "acquisition.replay.sample_rate_hz=2000"]].concat();
    let file = folder.path().join("other.toml");
    std::fs::write(&file, "[dsp.filter]\nnotch_hz = 55\n").unwrap();
    let model = format!("inference.model={}", model("cnn-five-gesture").display());
    for (settings, expected) in [
        (&["--set", "acquisition.channels=0"][..], "take 1 to 1024 channels"),
        (&["--set", "inference.model=/nowhere/mine.onnx"], "cannot open /nowhere/mine.onnx"),
        (
            &["--set", &model, "--set", "acquisition.channels=3"],
            "channels: the model wants 4, the session has 3",
        ),
        (
            &["--set", &model, "--config", file.to_str().unwrap()],
            "dsp.filter.notch_hz: the model wants a notch at 60 Hz",
        ),
        (&replay, "does not state its sampling rate"),
        (&with_rate, "`lunch` is not a number"),
        (&["--set", "acquisition.program=/nowhere/acquire"], "names was not found"),
        (&["--set", "acquisition.simulate.profile=/nowhere/p.toml"], "cannot read the profile"),
    ] {
        assert_both_refuse(settings, expected);
    }
}

#[test]
fn doctor_lists_only_what_dead_sessions_left() {
    let (running, dead, without_files) = (unique_session(), unique_session(), unique_session());
    let mut tendon = TendonBuilder::run(&running).start();
    tendon.wait_until_running();
    let user = nix::unistd::geteuid();
    let left = [format!("tendon.{user}.{dead}.left"), format!("tendon.{user}.{without_files}")]
        .map(|name| std::path::Path::new("/dev/shm").join(name));
    left.iter().for_each(|file| std::fs::write(file, "x").unwrap());
    let doctor = TendonBuilder::command(&unique_session(), &["doctor"]).end();
    let _ = left.map(std::fs::remove_file);
    assert!(doctor.output.contains(&format!("`{dead}` is dead but holds 1 file,")), "{doctor:#?}");
    for other in [&running, &without_files] {
        assert!(!doctor.output.contains(&format!("`{other}`")), "{doctor:#?}");
    }
    tendon.signal(Signal::SIGINT);
    tendon.end().report();
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

#[test]
fn the_recipe_of_the_models_page_works_on_3dc_as_it_is_downloaded() {
    let page = std::fs::read_to_string(repository().join("docs/models.md")).unwrap();
    let recipe = "dataset build data/3dc --out dataset --test-people 19,20,22";
    assert!(page.contains(&format!("tendon {recipe}\n")), "the page has another recipe: test that one");
    let arguments: Vec<&str> = recipe.split(' ').collect();
    let build = TendonBuilder::command(&unique_session(), &arguments);
    let data = build.folder().join("data/3dc");
    // The last one is on another disk.
    let elsewhere = tempfile::tempdir().unwrap();
    for (folder, person) in [(&*data, 18), (&data, 19), (&data, 20), (elsewhere.path(), 22)] {
        let session = folder.join(format!("Participant{person}/train"));
        write_three_dc(&session.join("EMG"));
        std::fs::create_dir(session.join("IMU")).unwrap();
        std::fs::write(session.join("IMU/3dc_IMU_gesture_0_0.txt"), "1,2,3,4,5,6,7,8,9\n").unwrap();
    }
    std::os::unix::fs::symlink(elsewhere.path().join("Participant22"), data.join("Participant22")).unwrap();
    let ended = build.end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.output.contains("windows of 4 people, 12 recordings"), "{ended:#?}");
    assert!(ended.output.contains("4 files that are no recordings"), "{ended:#?}");
}

#[test]
fn a_data_set_is_cut_with_the_filter_of_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("Participant50/train/EMG");
    write_three_dc(&recordings);
    std::fs::write(folder.path().join("mine.toml"), "[dsp.filter]\nnotch_hz = 50\n").unwrap();
    let config = folder.path().join("mine.toml");
    let config = config.to_str().unwrap();
    let cases: [(&[&str], serde_json::Value); 4] = [
        (&[], 60.0.into()),
        (&["--config", config], 50.0.into()),
        (&["--config", config, "--set", "dsp.filter.notch_hz=off"], "off".into()),
        (&["--filtered"], serde_json::Value::Null),
    ];
    for (options, notch_hz) in cases {
        let out = folder.path().join("windows");
        let build = TendonBuilder::command(&unique_session(), &["dataset", "build", "--channels", "0,1,2,3"]);
        // A finished data set is replaced when that is asked for.
        let build = if out.exists() { build.args(&["--force"]) } else { build };
        let ended = build.args(options).arg("--out").arg(&out).arg(&recordings).end();
        assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
        let manifest = std::fs::read_to_string(out.join("manifest.json")).unwrap();
        let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
        let filter = &manifest["settings"]["filter"];
        assert_eq!(filter.get("notch_hz").unwrap_or(filter), &notch_hz, "{options:?}");
        assert_eq!(manifest["settings"]["windows"]["window_samples"], 600);
    }
    // A model that was trained with another notch is refused for such a data set.
    let out = folder.path().join("other-notch");
    let build = TendonBuilder::command(&unique_session(), &["dataset", "build", "--channels", "0,1,2,3"]);
    let build = build.args(&["--set", "dsp.filter.notch_hz=55", "--set", "dsp.windows.window_samples=600"]);
    assert_eq!(build.arg("--out").arg(&out).arg(&recordings).end().exit_code, Some(0));
    let evaluate = TendonBuilder::command(&unique_session(), &["evaluate", "--model"]);
    evaluate.arg(model("cnn-six-class")).arg(&out).end().assert_failed(
        2,
        &["dsp.filter.notch_hz: the model wants a notch at 60 Hz or a notch at 50 Hz, the data set has a notch at 55 Hz"],
    );
    let evaluate = TendonBuilder::command(&unique_session(), &["evaluate", "--channels", "0,1,2", "--model"]);
    evaluate
        .arg(model("cnn-six-class"))
        .arg(&out)
        .end()
        .assert_failed(2, &["--channels is for recordings", "leave --channels out"]);
}

#[test]
fn a_build_that_is_killed_leaves_the_old_data_set_or_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let recording = write_recording(folder.path());
    let out = folder.path().join("windows");
    let build = |increment: &str, force: &[&str]| {
        let mut build = std::process::Command::new(program("tendon"));
        build.args(["dataset", "build", "--channels", "0,1,2,3", "--increment-samples", increment]);
        build.args(force).arg("--out").arg(&out).arg(&recording);
        build.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
        build
    };
    let windows = || {
        let manifest = std::fs::read_to_string(out.join("manifest.json")).unwrap();
        let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
        let windows = manifest["windows"].as_u64().unwrap();
        // A header of 192 bytes, then one byte a window.
        assert_eq!(std::fs::metadata(out.join("labels.npy")).unwrap().len(), 192 + windows);
        windows
    };
    let start = std::time::Instant::now();
    assert!(build("150", &[]).status().unwrap().success());
    let (whole, old) = (start.elapsed(), windows());
    for step in 0..20 {
        let mut killed = build("75", &["--force"]).spawn().unwrap();
        std::thread::sleep(whole * step / 16);
        killed.kill().unwrap();
        killed.wait().unwrap();
        let found = windows();
        assert!(found == old || found > old * 3 / 2, "{found} windows after step {step}, {old} before");
    }
    assert!(build("75", &["--force"]).status().unwrap().success());
    assert!(windows() > old * 3 / 2);
    assert!(!folder.path().join("windows.unfinished").exists());
}

/// Somebody whom no model that comes with Tendon was trained on.
const PERSON: &str = "50";

/// A recording of that person, made here.
fn write_recording(folder: &std::path::Path) -> std::path::PathBuf {
    let recording = folder.join(format!("Participant{PERSON}/train/EMG"));
    write_three_dc(&recording);
    recording
}

/// A data set of that person.
fn build_data_set(folder: &std::path::Path) -> std::path::PathBuf {
    let recording = write_recording(folder);
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
    assert!(ended.output.contains("person 50"), "{ended:#?}");
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
    evaluate(&dataset, &["--people", "8"]).assert_failed(2, &["--people 8", "there are only 50"]);
    evaluate(&folder.path().join("nothing"), &[]).assert_failed(2, &["nothing"]);
    let labels = dataset.join("labels.npy");
    let complete = std::fs::read(&labels).unwrap();
    std::fs::write(&labels, &complete[..complete.len() - 1]).unwrap();
    evaluate(&dataset, &[]).assert_failed(2, &["labels.npy", "is it complete?"]);

    // Windows of two channels are none for a model of four.
    let out = folder.path().join("two-channels");
    let recording = folder.path().join(format!("Participant{PERSON}/train/EMG"));
    let build =
        TendonBuilder::command(&unique_session(), &["dataset", "build", "--channels", "0,1", "--out"]);
    assert_eq!(build.arg(&out).arg(&recording).end().exit_code, Some(0));
    evaluate(&out, &[]).assert_failed(2, &["channels: the model wants 4, the data set has 2"]);
}

#[test]
fn recordings_are_scored_as_the_data_set_cut_from_them() {
    let folder = tempfile::tempdir().unwrap();
    let dataset = build_data_set(folder.path());
    let scores = |paths: &std::path::Path| -> serde_json::Value {
        let json = folder.path().join("scores.json");
        let command = TendonBuilder::command(&unique_session(), &["evaluate", "--channels", "0,1,2,3"]);
        let command = command.arg(paths).arg("--model").arg(model("cnn-six-class")).arg("--json").arg(&json);
        let ended = command.end();
        assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
        serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap()
    };
    let [of_dataset, of_recordings] =
        [scores(&dataset), scores(&folder.path().join(format!("Participant{PERSON}")))];
    for key in ["windows", "accuracy", "loss", "confusion", "per_person", "per_repetition"] {
        assert_eq!(of_dataset[key], of_recordings[key], "{key}");
    }
    assert!(of_dataset["windows"].as_u64().unwrap() > 0);
}

#[test]
fn nobody_is_scored_whom_the_model_was_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    write_three_dc(&folder.path().join("Participant7/train/EMG"));
    let evaluate = |arguments: &[&str]| {
        let command = TendonBuilder::command(&unique_session(), &["evaluate"]).arg(folder.path());
        command.arg("--model").arg(model("cnn-six-class")).args(arguments).end()
    };
    evaluate(&["--people", "7"]).assert_failed(2, &["--people 7: the model was trained on", "somebody new"]);
    evaluate(&[]).assert_failed(2, &["trained on everybody here (7)", "--test-people"]);
    // Beside somebody new, the other is left out.
    write_recording(folder.path());
    let ended = evaluate(&[]);
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.output.contains("on people 50"), "{ended:#?}");
    // Person 7 of another data set is somebody else.
    let trial = folder.path().join("P7_C0_G1.csv");
    write_table(&trial, &[Stretch { samples: 8000, amplitudes: MOVEMENT }]);
    let evaluate = TendonBuilder::command(&unique_session(), &["evaluate", "--channels", "0,1,2,3"]);
    let ended = evaluate.arg(&trial).arg("--model").arg(model("cnn-six-class")).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.output.contains("on people 7"), "{ended:#?}");
}

#[test]
fn recordings_of_your_own_are_of_nobody_whom_the_models_were_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("own");
    std::fs::create_dir(&own).unwrap();
    write_table(&own.join("monday.csv"), &[Stretch { samples: 4000, amplitudes: MOVEMENT }]);
    std::fs::write(own.join("labels.csv"), "file,person,repetition,gesture\nmonday.csv,1,0,grip\n").unwrap();
    let out = folder.path().join("windows");
    let build = ["dataset", "build", "--channels", "0,1,2,3", "--recording-rate-hz", "1000", "--out"];
    let ended = TendonBuilder::command(&unique_session(), &build).arg(&out).arg(&own).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    // The model was trained on person 1 of 3DC.
    let evaluate = TendonBuilder::command(&unique_session(), &["evaluate"]).arg(&out);
    let ended = evaluate.arg("--model").arg(model("cnn-six-class")).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    assert!(ended.output.contains("on people 1\n"), "{ended:#?}");
}

#[test]
fn a_column_of_labels_serves_every_command_that_reads_recordings() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("anna")).unwrap();
    let table = folder.path().join("anna/monday.csv");
    let (rest, grip) = (Stretch { samples: 4000, amplitudes: REST }, [200.0, 900.0, 100.0, 600.0]);
    let grip = Stretch { samples: 4000, amplitudes: grip };
    write_table(&table, &[rest, grip, rest, grip]);
    let samples = std::fs::read_to_string(&table).unwrap();
    let lines = samples.lines().enumerate();
    let lines = lines.map(|(row, line)| format!("{line},{}\n", ["rest", "grip"][row / 4000 % 2]));
    std::fs::write(&table, "a,b,c,d,done\n".to_owned() + &lines.collect::<String>()).unwrap();
    let (path, out) = (table.to_str().unwrap(), folder.path().join("out"));
    let (out, model) = (out.to_str().unwrap(), model("cnn-six-class"));
    for (command, said) in [
        (vec!["dataset", "build", path, "--out", out], "1 person, 4 recordings"),
        (vec!["evaluate", path, "--model", model.to_str().unwrap()], "on people anna"),
        (vec!["strategies", path, "--strategy", "direct"], "strategy direct"),
        (vec!["calibrate", "anna", "--from", path], "anna: 2 gestures on channels a, b, c, d"),
        (vec!["profile", "fit", path, "--out", "me.toml"], "profile of 4 channels"),
        (
            vec!["profile", "fit", folder.path().to_str().unwrap(), "--out", "me.toml"],
            "profile of 4 channels",
        ),
    ] {
        let options = ["--label-column", "done", "--recording-rate-hz", "1000"];
        let arguments = [&command[..], &options].concat();
        let builder = TendonBuilder::command(&unique_session(), &arguments);
        let ended = builder.env("XDG_DATA_HOME", folder.path()).end();
        assert_eq!(ended.exit_code, Some(0), "{command:?}: {ended:#?}");
        assert!(ended.output.contains(said), "{command:?}: {ended:#?}");
    }
}

#[test]
fn all_three_strategies_are_scored_on_continuous_recordings() {
    let folder = tempfile::tempdir().unwrap();
    write_recording(folder.path());
    let json = folder.path().join("strategies.json");
    let command = TendonBuilder::command(&unique_session(), &["strategies", "--json"]);
    let command = command.arg(&json).arg(folder.path());
    let command = command.arg("--five-gesture-model").arg(model("cnn-five-gesture"));
    let command = command.arg("--rest-move-model").arg(model("cnn-rest-move"));
    let ended = command.arg("--six-class-model").arg(model("cnn-six-class")).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    let scores: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    for strategy in ["threshold", "two_stage", "direct"] {
        let scores = &scores["strategies"][strategy];
        assert_eq!(scores["repetitions"], 1, "{scores:#}");
        // 6 s of rest, of which 5 s calibrate, 3 s of extension, 3 s of grip: (2000 - 600) / 150 windows and one, and
        // 40 of each movement.
        assert_eq!(scores["scored_s"], 0.075 * 90.0, "{scores:#}");
        assert_eq!(scores["per_gesture"]["rest"]["windows"], 10, "{scores:#}");
        assert_eq!(scores["rest_scored_s"], 0.075 * 10.0, "{scores:#}");
        assert!(scores["window_start_to_command_ms"]["mean"].as_f64().unwrap() > 300.0, "{scores:#}");
        assert!(scores["rest_taken_for_movement_share"].is_number(), "{scores:#}");
    }
    // The activity detector hears that nobody moves.
    let at_rest = &scores["strategies"]["threshold"]["per_gesture"]["rest"];
    assert_eq!(at_rest["correct_percent"], 100.0, "{scores:#}");
}

#[test]
fn experiments_report_on_the_models_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("recordings");
    write_recording(&recordings);
    write_three_dc(&recordings.join("Participant51/train/EMG"));
    let out = folder.path().join("experiments");
    let models = out.join("3dc/models");
    std::fs::create_dir_all(&models).unwrap();
    for (file, name) in
        [("cnn-five-gesture", "five-gesture"), ("cnn-rest-move", "rest-move"), ("cnn-six-class", "cnn-raw")]
    {
        std::fs::copy(model(file), models.join(format!("{name}-30epochs-seed0.onnx"))).unwrap();
    }
    let command = TendonBuilder::command(&unique_session(), &["experiments", "--no-training", "--no-live"]);
    let command = command.args(&["--three-dc-test-people", PERSON, "--three-dc"]).arg(&recordings);
    let ended = command.arg("--out").arg(&out).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    for part in [
        "Ozdemir: no recordings were given",
        "3DC: lstm-raw-30epochs-seed2 is not trained yet",
        "| extension | 39/200 (19.5 %) |",
        "- paper: accuracy 0.8646, loss 0.5178",
        "- 3DC: accuracy 0.",
        "| the CNN over the LSTM, on the filtered signal | 0.8646 | 0.7032 | 3DC | not trained |",
        "| 3DC threshold | 3DC two_stage | 3DC direct |",
    ] {
        assert!(report.contains(part), "`{part}` is not in {report}");
    }
    assert!(out.join("3dc/figures/cnn-raw-30epochs-seed0-confusion.png").is_file());
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(json[0]["source"], "3DC");
    assert!(json[0]["models"]["cnn-raw"][0]["windows"].as_u64().unwrap() > 0, "{json:#}");

    // Once more into the same folder, with somebody held out whom the models were trained on.
    write_three_dc(&recordings.join("Participant1/train/EMG"));
    let command = TendonBuilder::command(&unique_session(), &["experiments", "--no-training", "--no-live"]);
    let command = command.args(&["--three-dc-test-people", "1", "--three-dc"]).arg(&recordings);
    command.arg("--out").arg(&out).end().assert_failed(2, &["holds a finished data set", "--force"]);
    let command = TendonBuilder::command(&unique_session(), &["experiments", "--no-training", "--no-live"]);
    let command = command.args(&["--force", "--three-dc-test-people", "1", "--three-dc"]).arg(&recordings);
    let ended = command.arg("--out").arg(&out).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    for part in [
        "3DC: scored on people 1; models are trained on people ",
        "cnn-raw-30epochs-seed0 is not scored: it was trained on 1, who are held out: train it anew",
        "the strategies need the models five-gesture, rest-move and cnn-raw, trained on nobody who is held out",
    ] {
        assert!(report.contains(part), "`{part}` is not in {report}");
    }
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("report.json")).unwrap()).unwrap();
    assert_eq!(json[0]["tested_people"], serde_json::json!([1]));
    assert_eq!(json[0]["datasets"]["raw"]["split"]["test_people"], serde_json::json!([1]));
    for scores in ["models", "strategies"] {
        assert_eq!(json[0][scores], serde_json::json!({}), "{json:#}");
    }

    let nothing = TendonBuilder::command(&unique_session(), &["experiments"]).end();
    nothing.assert_failed(2, &["--three-dc FOLDER", "scripts/fetch-data"]);
}

/// Starts `tendon` with standard output as given; its exit code and standard error.
fn end_with_output(output: std::process::Stdio, arguments: &[&std::ffi::OsStr]) -> (Option<i32>, String) {
    let mut command = std::process::Command::new(program("tendon"));
    if std::env::var_os("ORT_DYLIB_PATH").is_none() {
        command.env("ORT_DYLIB_PATH", repository().join(".cache/onnxruntime/libonnxruntime.so"));
    }
    let ended = command.args(arguments).stdin(std::process::Stdio::null()).stdout(output).output().unwrap();
    (ended.status.code(), String::from_utf8_lossy(&ended.stderr).into_owned())
}

/// The commands of the laboratory on the recordings in `folder`, each with the file that it writes.
fn laboratory_commands(folder: &std::path::Path) -> Vec<(Vec<std::ffi::OsString>, std::path::PathBuf)> {
    let recordings = folder.join(format!("Participant{PERSON}"));
    let file = |name: &str| folder.join(name);
    let words = |words: &[&dyn AsRef<std::ffi::OsStr>]| {
        words.iter().map(|word| word.as_ref().to_owned()).collect::<Vec<std::ffi::OsString>>()
    };
    let (scores, strategies, windows) = (file("scores.json"), file("strategies.json"), file("windows"));
    let [five, six] = ["cnn-five-gesture", "cnn-six-class"].map(model);
    vec![
        (words(&[&"evaluate", &recordings, &"--model", &six, &"--json", &scores]), scores),
        (
            words(&[
                &"strategies",
                &recordings,
                &"--strategy",
                &"threshold",
                &"--five-gesture-model",
                &five,
                &"--json",
                &strategies,
            ]),
            strategies,
        ),
        (words(&[&"dataset", &"build", &recordings, &"--out", &windows]), windows.join("manifest.json")),
    ]
}

#[test]
fn a_reader_that_goes_away_is_no_fault_and_a_full_disk_is_named() {
    let folder = tempfile::tempdir().unwrap();
    write_recording(folder.path());
    for (arguments, written) in laboratory_commands(folder.path()) {
        let arguments: Vec<&std::ffi::OsStr> = arguments.iter().map(AsRef::as_ref).collect();
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let (exit_code, errors) = end_with_output(writer.into(), &arguments);
        assert_eq!(exit_code, Some(0), "{arguments:?}: {errors}");
        assert!(written.is_file(), "{arguments:?}: {errors}");
        std::fs::remove_file(&written).unwrap();

        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let (exit_code, errors) = end_with_output(full.into(), &arguments);
        assert_eq!(exit_code, Some(1), "{arguments:?}: {errors}");
        assert!(errors.contains("cannot write to standard output"), "{arguments:?}: {errors}");
        assert!(!errors.contains("panicked") && written.is_file(), "{arguments:?}: {errors}");
    }
}

#[test]
fn names_that_are_no_utf_8_are_read_or_refused_in_words() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let odd = folder.path().join(std::ffi::OsStr::from_bytes(b"m\xfcller"));
    std::fs::create_dir(&odd).unwrap();
    write_recording(&odd);
    for (arguments, _) in laboratory_commands(&odd) {
        let arguments: Vec<&std::ffi::OsStr> = arguments.iter().map(AsRef::as_ref).collect();
        let (exit_code, errors) = end_with_output(std::process::Stdio::null(), &arguments);
        let refused = exit_code == Some(2) && errors.contains("is not UTF-8") && errors.contains("rename");
        assert!(exit_code == Some(0) || refused, "{arguments:?}: {exit_code:?} {errors}");
    }
    // A model and an output may be called so.
    let data_set = build_data_set(folder.path());
    let six = odd.join("model.onnx");
    std::fs::copy(model("cnn-six-class"), &six).unwrap();
    let json = odd.join("scores.json");
    let words: [&std::ffi::OsStr; 6] = [
        "evaluate".as_ref(),
        data_set.as_ref(),
        "--model".as_ref(),
        six.as_ref(),
        "--json".as_ref(),
        json.as_ref(),
    ];
    let (exit_code, errors) = end_with_output(std::process::Stdio::null(), &words);
    assert_eq!(exit_code, Some(0), "{errors}");
    let scores: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&json).unwrap()).unwrap();
    assert!(scores["model"].as_str().unwrap().ends_with("model.onnx"), "{scores:#}");
}
