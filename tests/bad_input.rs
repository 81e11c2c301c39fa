//! Bad input is refused before anything moves: with exit code 2, one sentence that names the place and the
//! remedy, and nothing left behind.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::fs::{self, File};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use nix::sys::signal::Signal;
use nix::sys::stat::Mode;
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
fn a_model_that_is_not_what_its_metadata_say() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.onnx");
    let mut bytes = std::fs::read(model("cnn-five-gesture")).unwrap();
    let entry = b"tendon.window_samples\x12\x03600";
    let start = bytes.windows(entry.len()).position(|window| window == entry).unwrap();
    bytes[start + entry.len() - 3] = b'5';
    std::fs::write(&path, bytes).unwrap();
    let parts = [
        "the model's input is 1 × 4 × 600 float32 numbers, but the metadata want 1 × 4 × 500 float32 numbers",
        "models/training/train.py",
    ];
    assert_model_refused(&path, &parts);
}

#[test]
fn a_table_of_which_nothing_says_what_it_shows() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("emg.csv");
    std::fs::write(&table, "1,2,3,4\n".repeat(1000)).unwrap();
    let path = table.to_str().unwrap();
    let six = model("cnn-six-class");
    let build = ["dataset", "build", path, "--out", "windows"];
    let evaluate = ["evaluate", path, "--model", six.to_str().unwrap()];
    let refused = |arguments: &[&str], parts: &[&str]| {
        TendonBuilder::command(&unique_session(), arguments).end().assert_failed(2, parts);
    };
    let fit = ["profile", "fit", path, "--out", "me.toml"];
    for command in [&build[..], &evaluate, &["strategies", path], &fit] {
        let header = "file,person,session,repetition,gesture,start_sample,end_sample";
        refused(command, &["emg.csv", "no labels.csv names it: write one beside it", header]);
    }
    std::fs::write(folder.path().join("labels.csv"), "").unwrap();
    refused(&build, &["give its folder, so that", "labels.csv says what it shows"]);
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
        (
            "dsp.filter.notch_hz=55",
            "the model wants a notch at 60 Hz or a notch at 50 Hz, the session has a notch at 55 Hz",
        ),
        ("decision.strategy=direct", "which needs a model that knows rest"),
    ] {
        assert_refused(
            &["--set", setting],
            &["cnn-five-gesture.onnx", "does not fit", what, "take another model with --model"],
        );
    }
}

#[test]
fn a_model_of_other_channels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.onnx");
    let mut bytes = std::fs::read(model("cnn-six-class")).unwrap();
    let (numbers, names) = (br#"["0","3","5","8"]"#, br#"["a","b","c","d"]"#);
    let start = bytes.windows(numbers.len()).position(|window| window == numbers).unwrap();
    bytes[start..start + names.len()].copy_from_slice(names);
    std::fs::write(&path, bytes).unwrap();
    let table = folder.path().join("emg.csv");
    let line = |row: usize| format!("{row},{},3,4,5\n", row % 7);
    let rows: String = (0..12_000).map(line).collect();
    std::fs::write(&table, format!("count,a,b,c,d\n{rows}")).unwrap();
    let labels = "file,person,repetition,gesture,start_sample,end_sample\nemg.csv,1,0,rest,0,6000\n\
                  emg.csv,1,0,grip,6000,12000\n";
    std::fs::write(folder.path().join("labels.csv"), labels).unwrap();
    let [path, table, recordings] = [&path, &table, folder.path()].map(|path| path.to_str().unwrap());
    let run = ["run", "--strategy", "direct", "--model", path, "--replay", table];
    let evaluate = ["evaluate", recordings, "--model", path];
    let strategies = ["strategies", recordings, "--strategy", "direct", "--six-class-model", path];
    let rate = ["--recording-rate-hz", "2000"];
    for (command, source) in [
        (&run[..], "the recording gives"),
        (&evaluate, "the recordings give"),
        (&strategies, "the recordings give"),
    ] {
        let others = [command, &rate, &["--channels", "count,a,b,c"]].concat();
        let ended = TendonBuilder::command(&unique_session(), &others).end();
        let parts =
            ["model.onnx: the model knows a, b, c, d; ", source, " count, a, b, c", "--channels a,b,c,d"];
        ended.assert_failed(2, &parts);
    }
    // Without a choice, it takes those that it knows; a number is the name that stands there.
    for channels in [&[][..], &["--channels", "1,2,3,4"]] {
        let ended =
            TendonBuilder::command(&unique_session(), &[&evaluate[..], &rate, channels].concat()).end();
        assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
        assert!(ended.output.contains("\nchannels a, b, c, d\n"), "{ended:#?}");
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
    std::fs::write(&path, "10,20,30,40\n".repeat(1000)).unwrap();
    let parts = ["emg.csv", "--recording-rate-hz 1000, or acquisition.replay.sample_rate_hz"];
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
    let parts = ["is in use by process", &first.id().to_string(), "choose another name (--set session=NAME)"];
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

/// Commands that read a file, `@`, with the name that it has; of these the size is bounded.
const BOUNDED: [(&str, &str); 10] = [
    ("run --config @", "mine.toml"),
    ("run", "tendon.toml"),
    ("run --set acquisition.simulate.profile=@", "me.toml"),
    ("run --model @", "model.onnx"),
    ("run --strategy two_stage --rest-move-model @", "model.onnx"),
    ("strategies . --config @", "mine.toml"),
    ("strategies . --strategy direct --six-class-model @", "model.onnx"),
    ("evaluate . --model @", "model.onnx"),
    ("dataset build . --recording-rate-hz 1000 --out windows", "labels.csv"),
    ("evaluate data --model SIX", "data/manifest.json"),
];
/// Those that read a file of any size.
const UNBOUNDED: [(&str, &str); 7] = [
    ("run --replay @ --replay-rate-hz 1000", "emg.csv"),
    ("run --replay @", "3dc_EMG_gesture_0_1.txt"),
    ("profile fit @ --out me.toml", "3dc_EMG_gesture_0_1.txt"),
    ("dataset build @ --out windows", "P50_C0_G1.csv"),
    ("dataset build @ --filtered --out windows", "50.mat"),
    ("evaluate @ --model SIX", "P50_C0_G1.csv"),
    ("run --set inference.runtime_library=@", "libonnxruntime.so"),
];

/// Runs `command` where `make` has put a file called `name`, and asserts that it is refused by its name and with `part`.
fn assert_input_refused((command, name): (&str, &str), make: impl FnOnce(&Path), part: &str) {
    let session = unique_session();
    let words = command.split(' ');
    let first = words.clone().next().unwrap();
    let builder = TendonBuilder::command(&session, &[first]);
    let builder =
        if first == "run" { builder.args(&["--session", session.to_string().as_str()]) } else { builder };
    let path = builder.folder().join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    make(&path);
    let six = model("cnn-six-class");
    let filled = words
        .skip(1)
        .map(|word| word.replace('@', path.to_str().unwrap()).replace("SIX", six.to_str().unwrap()));
    let ended = filled.fold(builder, TendonBuilder::arg).end();
    assert_eq!(ended.exit_code, Some(2), "{command}: {ended:#?}");
    assert!(!ended.errors.contains("panicked"), "{command}: {ended:#?}");
    let says = |line: &str| line.contains(name) && line.contains(part);
    assert!(ended.errors.lines().any(says), "{command}: no line has `{name}` and `{part}`: {ended:#?}");
}

#[test]
fn a_pipe_without_a_writer() {
    for reader in BOUNDED.into_iter().chain(UNBOUNDED) {
        assert_input_refused(
            reader,
            |path| nix::unistd::mkfifo(path, Mode::S_IRWXU).unwrap(),
            "it is a pipe",
        );
    }
}

#[test]
fn a_device_without_an_end() {
    for reader in BOUNDED.into_iter().chain(UNBOUNDED) {
        assert_input_refused(reader, |path| symlink("/dev/zero", path).unwrap(), "it is a device");
    }
}

#[test]
fn a_folder_instead_of_a_file() {
    // A folder called labels.csv is one without recordings.
    for reader in BOUNDED.into_iter().filter(|(_, name)| *name != "labels.csv") {
        assert_input_refused(reader, |path| fs::create_dir(path).unwrap(), "it is a folder");
    }
    // Of recordings folders may be given, but not empty ones.
    for reader in UNBOUNDED {
        assert_input_refused(reader, |path| fs::create_dir(path).unwrap(), "");
    }
}

#[test]
fn a_file_beyond_its_bound() {
    for reader in BOUNDED {
        let make = |path: &Path| File::create(path).unwrap().set_len(1 << 40).unwrap();
        assert_input_refused(reader, make, "it is larger than");
    }
}

#[test]
fn a_recording_of_any_size_without_lines() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("emg.csv");
    File::create(&path).unwrap().set_len(1 << 40).unwrap();
    let arguments = ["--replay", path.to_str().unwrap(), "--replay-rate-hz", "1000"];
    assert_refused(&arguments, &["emg.csv, line 1", "binary or non-UTF-8"]);
}

#[test]
fn a_file_that_may_not_be_read() {
    if nix::unistd::geteuid().is_root() {
        // Root may read it.
        return;
    }
    for reader in BOUNDED.into_iter().chain(UNBOUNDED) {
        let make = |path: &Path| {
            fs::write(path, "").unwrap();
            fs::set_permissions(path, fs::Permissions::from_mode(0o000)).unwrap();
        };
        assert_input_refused(reader, make, "Permission denied");
    }
}

#[test]
fn a_data_set_in_a_folder_where_a_pipe_lies() {
    let builder = TendonBuilder::command(&unique_session(), &["dataset", "build", "emg", "--out", "windows"]);
    tendon_system_tests::recordings::write_three_dc(&builder.folder().join("emg/Participant50/train/EMG"));
    fs::create_dir(builder.folder().join("windows")).unwrap();
    nix::unistd::mkfifo(&builder.folder().join("windows/labels.npy"), Mode::S_IRWXU).unwrap();
    builder.end().assert_failed(2, &["labels.npy is no regular file", "choose another folder"]);
}

#[test]
fn options_that_would_have_no_effect() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("emg.csv");
    fs::write(&table, "1,2,3,4\n".repeat(1000)).unwrap();
    let (table, five) = (table.to_str().unwrap(), model("cnn-five-gesture"));
    let five = five.to_str().unwrap();
    let replay = ["run", "--replay", table, "--replay-rate-hz", "1000", "--seed", "1"];
    let from_file = ["run", "--set", "acquisition.source=replay", "--set", "acquisition.replay.path=emg.csv"];
    let scripted = [&from_file[..], &["--script", "rest 6s"]].concat();
    let build = ["dataset", "build", table, "--out", "windows"];
    let simulate = ["run", "--replay", table, "--set", "acquisition.source=simulate"];
    let cases: [(&[&str], [&str; 3]); 18] = [
        (&replay, ["--seed", "--replay", "leave one of the two out"]),
        (&simulate, ["--replay", "--set acquisition.source=simulate", "leave one of the two out"]),
        (&scripted, ["--script", "acquisition.source is \"replay\"", "leave --script out"]),
        (
            &["run", "--rest-move-model", five],
            ["--rest-move-model", "decision.strategy is \"threshold\"", "add --strategy two_stage"],
        ),
        (
            &["run", "--set", "decision.speed_mm_per_s=200"],
            ["decision.speed_mm_per_s = 200", "linear_speed_limit_mm_per_s = 100", "raise the limit"],
        ),
        (
            &["strategies", table, "--strategy", "direct", "--rest-move-model", five],
            ["--rest-move-model", "--strategy direct", "leave one of the two out"],
        ),
        (
            &["run", "--set", "inference.adaptation=slow"],
            ["inference.adaptation = \"slow\"", "add --person NAME", "set inference.adaptation to \"off\""],
        ),
        (
            &["strategies", table, "--strategy", "direct", "--set", "inference.adaptation=slow"],
            ["--set inference.adaptation", "--strategy direct", "leave one of the two out"],
        ),
        (
            &["strategies", table, "--set", "robot.backend=xarm"],
            ["--set robot.backend=xarm", "tendon strategies does not use", "leave it out"],
        ),
        (
            &[&build[..], &["--set", "decision.vote_windows=5"]].concat(),
            ["--set decision.vote_windows=5", "tendon dataset build does not use", "leave it out"],
        ),
        (
            &[&build[..], &["--filtered", "--set", "dsp.filter.notch_hz=50"]].concat(),
            ["--filtered", "--set dsp.filter", "leave one of the two out"],
        ),
        (
            &[&build[..], &["--peak-percentile", "70"]].concat(),
            ["--peak-percentile", "--onset peak-percentile", "leave --peak-percentile out"],
        ),
        (
            &["experiments", "--no-training", "--jobs", "2"],
            ["--jobs", "cannot be used with", "--no-training"],
        ),
        (
            &["run", "--channels", "0,1"],
            ["--channels is for recordings", "--replay PATH", "leave --channels out"],
        ),
        (&["calibrate", "anna", "--unit", "mV"], ["--unit is for recordings", "--from", "leave --unit out"]),
        (&["run", "--pace", "full"], ["--pace", "recordings", "--replay PATH"]),
        (&["run", "--replay", table, "--keyboard"], ["--keyboard", "cannot be used with", "--replay"]),
        (&["run", "--script", "rest 6s", "--random"], ["--script", "cannot be used with", "--random"]),
    ];
    for (arguments, parts) in cases {
        TendonBuilder::command(&unique_session(), arguments).end().assert_failed(2, &parts);
    }
}
