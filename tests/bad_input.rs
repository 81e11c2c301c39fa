//! Bad input is refused before anything moves: with exit code 2, one sentence that names the place and the
//! remedy, and nothing left behind.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::path::{Path, PathBuf};

use nix::sys::signal::Signal;
use tendon_system_tests::{TendonBuilder, model, unique_session};

/// Asserts that `tendon run` with `arguments` is refused with one line that has all of `parts`.
fn assert_refused(arguments: &[&str], parts: &[&str]) {
    TendonBuilder::run(&unique_session()).args(arguments).end().assert_failed(2, parts);
}

fn assert_model_refused(path: &Path, parts: &[&str]) {
    TendonBuilder::run_with_model(&unique_session(), path).end().assert_failed(2, parts);
}

#[test]
fn a_missing_model() {
    assert_model_refused(
        Path::new("/nowhere/model.onnx"),
        &["cannot open", "/nowhere/model.onnx", "check the path"],
    );
}

#[test]
fn a_model_of_random_bytes_and_a_truncated_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.onnx");
    let parts = ["broken.onnx", "cannot be loaded as an ONNX model", "is the file whole?"];
    let noise: Vec<u8> = (0..5000_u32).map(|index| (index.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    std::fs::write(&path, noise).unwrap();
    assert_model_refused(&path, &parts);
    let whole = std::fs::read(model("cnn-five-gesture")).unwrap();
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    assert_model_refused(&path, &parts);
}

#[test]
fn a_model_for_another_session() {
    for (setting, what) in [
        ("acquisition.channels=3", "channels: the model wants 4, the session has 3"),
        (
            "acquisition.sample_rate_hz=4000",
            "sampling rate: the model wants 2000 Hz, the session has 4000 Hz",
        ),
        (
            "dsp.windows.window_samples=500",
            "window: the model wants 600 samples, the session has 500 samples",
        ),
        ("dsp.filter.notch_hz=50", "dsp.filter.notch_hz: the model wants 60, the session has 50"),
        ("decision.strategy=direct", "which needs a model that knows rest"),
    ] {
        assert_refused(
            &["--set", setting],
            &["cnn-five-gesture.onnx", "does not fit", what, "take another model with --model"],
        );
    }
}

#[test]
fn a_first_stage_that_is_none() {
    let five = tendon_system_tests::model("cnn-five-gesture");
    let setting = format!("inference.rest_move_model={}", five.display());
    assert_refused(
        &["--strategy", "two_stage", "--set", &setting],
        &["cnn-five-gesture.onnx", "whose first stage needs a model of rest and move"],
    );
}

#[test]
fn no_runtime_library() {
    let ended = TendonBuilder::run(&unique_session()).env("ORT_DYLIB_PATH", "/nonexistent").end();
    ended.assert_failed(2, &["/nonexistent", "there is no such file", "scripts/fetch-onnxruntime"]);
}

#[test]
fn a_runtime_library_that_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("libonnxruntime.so");
    std::fs::write(&text, "no library\n").unwrap();
    for library in [text, c_library()] {
        let ended = TendonBuilder::run(&unique_session()).env("ORT_DYLIB_PATH", &library).end();
        let path = library.display().to_string();
        ended.assert_failed(2, &[&path, "cannot be used as ONNX Runtime", "scripts/fetch-onnxruntime"]);
    }
}

/// A library that is one, but not ONNX Runtime: the C library that this test itself runs on.
fn c_library() -> PathBuf {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let paths = maps.lines().filter_map(|line| line.split_whitespace().nth(5));
    paths.into_iter().find(|path| path.contains("libc.so") || path.contains("libc-")).unwrap().into()
}

#[test]
fn an_unknown_key() {
    let ended = TendonBuilder::run(&unique_session()).args(&["--set", "acquisition.chanels=8"]).end();
    ended.assert_failed(2, &["--set acquisition.chanels=8: unknown key `chanels`; did you mean `channels`?"]);
    assert!(!ended.errors.contains("TOML parse error"), "{ended:#?}");
    let ended = TendonBuilder::run(&unique_session()).args(&["--set", "robot.backend=foo"]).end();
    ended.assert_failed(2, &["unknown variant `foo`, expected `simulate` or `xarm`"]);
    assert!(!ended.errors.contains("\n\n"), "{ended:#?}");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tendon.toml");
    std::fs::write(&path, "[acquisition]\nblock_sample = 5\n").unwrap();
    let ended = TendonBuilder::run(&unique_session()).arg("--config").arg(&path).end();
    ended.assert_failed(2, &["did you mean `block_samples`?"]);
    ended.assert_failed(2, &[&path.display().to_string(), "line 2"]);
}

#[test]
fn a_recording_that_cannot_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.csv");
    let good = "1,2,3,4\n".repeat(1000);
    let refused = |parts: &[&str]| {
        let recording = path.to_str().unwrap();
        let channels = "acquisition.replay.channels=[0,1,2,3]";
        let arguments = ["--replay", recording, "--replay-rate-hz", "2000", "--set", channels];
        assert_refused(&arguments, parts);
    };
    for (end, parts) in [
        ("1,2,3\n1,2,3,4\n", ["line 1001", "expected 4 values", "complete or delete"]),
        ("1,2,lunch,4\n", ["line 1001, column 3", "`lunch` is not a number", "samples are written like"]),
        ("1,NULL,3,4\n", ["line 1001, column 2", "missing sample `NULL`", "fill the gap"]),
        ("1,2,3,NaN\n", ["line 1001, column 4", "NaN", "cut the recording here"]),
        ("1,2,3,inf\n", ["line 1001, column 4", "inf", "cut the recording here"]),
    ] {
        std::fs::write(&path, format!("{good}{end}")).unwrap();
        refused(&parts);
    }
    std::fs::write(&path, "").unwrap();
    refused(&["recording.csv", "the file has no samples", "record it again"]);
    std::fs::remove_file(&path).unwrap();
    refused(&["cannot open", "recording.csv", "check the path"]);
}

#[test]
fn a_table_without_its_sampling_rate() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("emg.csv");
    std::fs::write(&path, "1,2,3,4\n".repeat(1000)).unwrap();
    let parts = ["emg.csv", "--replay-rate-hz 1000, or acquisition.replay.sample_rate_hz"];
    assert_refused(&["--replay", path.to_str().unwrap()], &parts);
}

#[test]
fn a_source_whose_program_is_not_there() {
    let settings = ["--set", "acquisition.source=device", "--set", "acquisition.program=/nowhere/acquire"];
    assert_refused(
        &settings,
        &["/nowhere/acquire: the program that acquisition.program names was not found"],
    );
}

#[test]
fn a_duration_of_nothing() {
    let ended = TendonBuilder::run(&unique_session()).args(&["--duration", "0s"]).end();
    assert_eq!(ended.exit_code, Some(2), "{ended:#?}");
    assert!(ended.errors.contains("must be longer than 0"), "{ended:#?}");
}

#[test]
fn a_session_that_is_in_use() {
    let session = unique_session();
    let mut first = TendonBuilder::run(&session).start();
    first.wait_until_running();
    let second = TendonBuilder::run(&session).start().end_whatever_is_left();
    let parts = ["is in use by process", &first.id().to_string(), "choose another name with --session"];
    second.assert_failed(2, &parts);
    // The first one did not notice.
    first.signal(Signal::SIGINT);
    assert!(first.end().report().messages["commands"].lost == 0);
}

#[test]
fn a_session_name_that_cannot_be_one() {
    for name in ["Two Words", "a/b", "", "a-name-of-twenty-five-chars"] {
        let ended = TendonBuilder::command(&unique_session(), &["run", "--session", name]).end();
        ended.assert_failed(2, &[&format!("session name `{name}` is not usable"), "take 1 to 24"]);
    }
}

#[test]
fn too_little_shared_memory() {
    let settings = [
        "acquisition.channels=1000",
        "acquisition.sample_rate_hz=10000",
        "acquisition.block_samples=1000",
        "dsp.windows.window_samples=100000",
    ];
    assert_refused(
        &settings.map(|setting| ["--set", setting]).concat(),
        &["/dev/shm", "MB free, but the session may need", "take fewer channels or shorter blocks"],
    );
}

#[test]
fn real_time_scheduling_is_had_or_refused() {
    let ended = TendonBuilder::run(&unique_session()).args(&["--realtime", "on", "--duration", "1s"]).end();
    if ended.exit_code == Some(0) {
        let scheduling = ended.report().scheduling;
        assert_eq!(scheduling.len(), 5, "{scheduling:?}");
        for (stage, scheduling) in scheduling {
            assert!(scheduling.contains("SCHED_FIFO"), "{stage}: {scheduling}");
            assert!(scheduling.contains("memory locked"), "{stage}: {scheduling}");
        }
    } else {
        ended.assert_failed(2, &["scheduling.realtime = \"on\"", "was refused", "or use --realtime auto"]);
    }
}

#[test]
fn a_path_that_is_not_utf_8() {
    use std::os::unix::ffi::OsStrExt;
    let odd = Path::new(std::ffi::OsStr::from_bytes(b"/tmp/m\xfcller/emg.csv"));
    let parts = ["acquisition.replay.path", "not UTF-8", "rename"];
    TendonBuilder::run(&unique_session()).arg("--replay").arg(odd).end().assert_failed(2, &parts);
    let parts = ["inference.model", "not UTF-8", "rename"];
    TendonBuilder::run_with_model(&unique_session(), odd).end().assert_failed(2, &parts);
}
