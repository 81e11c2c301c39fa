//! Recorded sessions: everything is kept, nobody waits for it, and a replay decides the same bit for bit.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may unwrap, as tests may")]

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use nix::sys::signal::{Signal, kill};
use tendon_session_file::{EventKind, Message, Reader};
use tendon_system_tests::recorded_sessions::{file_in, replay_and_compare};
use tendon_system_tests::recordings::write_three_dc;
use tendon_system_tests::{Ended, Tendon, TendonBuilder, arm, unique_session, wait_until};
use tendon_transport::{SessionName, now_ns};

/// What the file holds so far. It may still be written.
fn messages_of(file: &Path) -> Vec<Message> {
    let mut reader = Reader::open(file).unwrap();
    let mut messages = Vec::new();
    // Its first bytes may not be there yet.
    while let Ok(Some(message)) = reader.next_message() {
        messages.push(message);
    }
    messages
}

fn commands_in(folder: &Path) -> usize {
    let messages = file_in(folder).map(|file| messages_of(&file)).unwrap_or_default();
    messages.iter().filter(|message| matches!(message, Message::Command(_))).count()
}

/// Waits until this many more commands are recorded.
fn wait_for_commands(session: &mut Tendon, folder: &Path, more: usize) {
    let before = commands_in(folder);
    wait_until("commands in the recording", || {
        assert!(!session.has_ended(), "{}", session.errors_so_far());
        (commands_in(folder) >= before + more).then_some(())
    });
}

fn start_recording(session: &SessionName, folder: &Path) -> Tendon {
    start_recording_of(TendonBuilder::run(session), folder)
}

fn start_recording_of(session: TendonBuilder, folder: &Path) -> Tendon {
    let mut session = session.arg("--record").arg(folder).start();
    session.wait_until_running();
    wait_for_commands(&mut session, folder, 3);
    session
}

fn ask(session: &SessionName, arguments: &[&str]) -> Ended {
    let name = session.to_string();
    let mut command = TendonBuilder::command(session, arguments).args(&["--session", &name]).start();
    command.end_whatever_is_left()
}

/// Kills a stage and waits until its successor has done some work.
fn restart(session: &mut Tendon, stage: &str, folder: &Path) {
    let before = session.stage(stage);
    kill(before, Signal::SIGKILL).unwrap();
    wait_until("a new process", || session.find_stage(stage).filter(|process| *process != before));
    let note = format!("{stage} ended");
    wait_until("the note on it", || session.errors_so_far().contains(&note).then_some(()));
    wait_for_commands(session, folder, 30);
}

/// Records a session with a stop, a restart of each of `stages`, and the arm let go again; gives its file.
fn disturbed_session(
    name: &SessionName,
    builder: TendonBuilder,
    folder: &Path,
    stages: &[&str],
) -> (Ended, PathBuf) {
    let mut session = start_recording_of(builder, folder);
    wait_for_commands(&mut session, folder, 80);
    assert_eq!(ask(name, &["stop"]).exit_code, Some(0));
    for stage in stages {
        restart(&mut session, stage, folder);
    }
    assert_eq!(arm(name).exit_code, Some(0));
    wait_for_commands(&mut session, folder, 30);
    session.signal(Signal::SIGINT);
    (session.end(), file_in(folder).unwrap())
}

#[test]
fn a_session_with_a_stop_and_restarts_is_replayed_bit_for_bit() {
    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    let [recorded, replayed] = ["recorded", "replayed"].map(|name| folder.path().join(name));
    let stages = ["inference", "decision", "dsp", "acquisition"];
    let (ended, file) = disturbed_session(&name, TendonBuilder::run(&name), &recorded, &stages);
    let recording = &ended.report().recordings[0];
    assert_eq!(recording.error, None, "{ended:#?}");
    assert_eq!(recording.path, file.canonicalize().unwrap());
    assert!(ended.output.contains(&format!("recorded to {}", recording.path.display())), "{ended:#?}");
    let messages = messages_of(&file);
    let events: Vec<&str> = messages
        .iter()
        .filter_map(|message| match message {
            Message::Event(event) if event.kind == EventKind::Session => Some(event.text.as_str()),
            _ => None,
        })
        .collect();
    for text in ["stopped by order", "inference ended", "decision ended", "dsp ended", "acquisition ended"] {
        assert!(events.iter().any(|event| event.contains(text)), "{text}: {events:?}");
    }

    let compared = replay_and_compare(&name, &file, &replayed, &[]);
    assert_eq!(compared.exit_code, Some(0), "{compared:#?}");
    assert!(compared.output.contains(" 0 different, 0 only in the first"), "{compared:#?}");

    // A replay with another vote decides otherwise, and the comparison says where.
    let other = folder.path().join("other");
    let compared = replay_and_compare(&name, &file, &other, &["--set", "decision.vote_windows=1"]);
    compared.assert_failed(1, &["the two recordings differ"]);
    assert!(compared.output.contains("voted "), "{compared:#?}");
}

#[test]
fn a_session_with_zones_is_replayed_bit_for_bit_and_exported_with_its_scores() {
    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    let [recorded, replayed, tables] =
        ["recorded", "replayed", "tables"].map(|name| folder.path().join(name));
    let session = TendonBuilder::run(&name).args(&["--task", "zones", "--duration", "25s"]);
    let near_and_wide = ["--set", "task.distance_mm=[50, 80]", "--set", "task.width_mm=60"];
    let task = session.args(&near_and_wide).arg("--record").arg(&recorded).end().report().task.unwrap();
    let file = file_in(&recorded).unwrap();

    let compared = replay_and_compare(&name, &file, &replayed, &[]);
    assert_eq!(compared.exit_code, Some(0), "{compared:#?}");
    assert_eq!(
        compared.output.matches(" 0 different, 0 only in the first, 0 only").count(),
        2,
        "{compared:#?}"
    );

    let export = TendonBuilder::command(&name, &["export"]).arg(&file).arg("--csv").arg(&tables).end();
    assert_eq!(export.exit_code, Some(0), "{export:#?}");
    let zones = std::fs::read_to_string(tables.join("zones.csv")).unwrap();
    // A head, and a row for each zone.
    assert_eq!(zones.lines().count(), 1 + task.zones.len(), "{zones}");
    assert!(!task.zones.is_empty(), "{task:#?}");
}

#[test]
fn a_person_who_adapts_is_replayed_bit_for_bit_after_a_stop_and_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let [data, recorded, replayed] = ["data", "recorded", "replayed"].map(|name| folder.path().join(name));
    let emg = data.join("Participant7/train/EMG");
    write_three_dc(&emg);
    let name = unique_session();
    let calibrate = TendonBuilder::command(&name, &["calibrate", "ada", "--from"]).arg(&emg);
    let calibrated = calibrate.env("XDG_DATA_HOME", &data).end();
    assert_eq!(calibrated.exit_code, Some(0), "{calibrated:#?}");
    let session =
        TendonBuilder::command(&name, &["run", "--session", &name.to_string(), "--json", "report.json"])
            .args(&["--set", "inference.adaptation=slow", "--person"])
            .arg(data.join("tendon/people/ada/person.toml"));
    let (ended, file) = disturbed_session(&name, session, &recorded, &["inference"]);
    assert_eq!(ended.report().restarts, 1, "{ended:#?}");
    let compared = replay_and_compare(&name, &file, &replayed, &[]);
    assert_eq!(compared.exit_code, Some(0), "{compared:#?}");
    assert_eq!(
        compared.output.matches(" 0 different, 0 only in the first, 0 only").count(),
        2,
        "{compared:#?}"
    );
}

#[test]
#[ignore = "some ten minutes: more sessions of the kind above, in other orders"]
fn twenty_sessions_with_stops_and_restarts_are_replayed_bit_for_bit() {
    let mut stages = ["inference", "decision", "dsp", "acquisition"];
    let mut same = 0;
    for round in 0..20 {
        stages.rotate_left(1);
        if round % 3 == 0 {
            stages.swap(0, 2);
        }
        let name = unique_session();
        let folder = tempfile::tempdir().unwrap();
        let [recorded, replayed] = ["recorded", "replayed"].map(|name| folder.path().join(name));
        let (_, file) = disturbed_session(&name, TendonBuilder::run(&name), &recorded, &stages);
        let compared = replay_and_compare(&name, &file, &replayed, &[]);
        println!("{round}: {stages:?}\n{}", compared.output);
        same += usize::from(compared.exit_code == Some(0));
    }
    assert_eq!(same, 20, "sessions without a difference");
}

#[test]
#[ignore = "some ten minutes"]
fn a_hundred_recorders_that_are_killed_leave_all_but_the_last_second() {
    let mut longest_ns = 0;
    for round in 0..100_u64 {
        let name = unique_session();
        let folder = tempfile::tempdir().unwrap();
        let session = start_recording(&name, folder.path());
        // At any moment between two chunks, the same each time this runs.
        std::thread::sleep(std::time::Duration::from_millis(round * 37 % 1000));
        kill(session.stage("recorder"), Signal::SIGKILL).unwrap();
        let killed_ns = now_ns();
        wait_until("the note on it", || {
            session.errors_so_far().contains("the recording has stopped").then_some(())
        });
        session.signal(Signal::SIGINT);
        session.end();
        let blocks =
            messages_of(&file_in(folder.path()).unwrap()).into_iter().filter_map(|message| match message {
                Message::Block(block) => Some(block.captured_ns),
                _ => None,
            });
        let missing_ns = killed_ns.saturating_sub(blocks.max().unwrap());
        println!("{round}: {:.3} s missing", missing_ns as f64 / 1e9);
        longest_ns = longest_ns.max(missing_ns);
    }
    println!("at most {:.3} s missing", longest_ns as f64 / 1e9);
    assert!(longest_ns < 1_000_000_000);
}

#[test]
fn a_killed_recorder_leaves_what_it_wrote_and_the_session_goes_on() {
    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    ask(&name, &["note", "electrode 3 is loose"])
        .assert_failed(2, &["no session `", "is running", "name another with --session"]);
    let session = start_recording(&name, folder.path());
    let noted = ask(&name, &["note", "electrode 3 is loose"]);
    assert!(noted.output.starts_with("noted in "), "{noted:#?}");
    kill(session.stage("recorder"), Signal::SIGKILL).unwrap();
    wait_until("the note on it", || {
        session.errors_so_far().contains("the recording has stopped: the recorder ended").then_some(())
    });
    ask(&name, &["note", "too late"]).assert_failed(2, &["is not being recorded", "--record FOLDER"]);
    let other = unique_session();
    ask(&other, &["note", "nobody"]).assert_failed(2, &[&format!("no session `{other}`"), &name.to_string()]);
    let messages = messages_of(&file_in(folder.path()).unwrap());
    let is_note =
        |message: &Message| matches!(message, Message::Event(event) if event.text == "electrode 3 is loose");
    assert!(messages.iter().any(is_note), "{messages:?}");
    assert!(messages.iter().filter(|message| matches!(message, Message::Block(_))).count() > 100);
    let file = file_in(folder.path()).unwrap();
    let export = |tables: &Path, arguments: &[&str]| {
        let export =
            TendonBuilder::command(&unique_session(), &["export"]).arg(&file).arg("--csv").arg(tables);
        export.args(arguments).end()
    };
    let exports = tempfile::tempdir().unwrap();
    let tables = exports.path().join("tables");
    let export_of_all = TendonBuilder::command(&unique_session(), &["export"]).arg(folder.path());
    let refused = export_of_all.arg("--csv").arg(&tables).end();
    refused.assert_failed(
        2,
        &["name one of the recorded sessions in it", file.parent().unwrap().to_str().unwrap()],
    );
    let exported = export(&tables, &[]);
    assert_eq!(exported.exit_code, Some(0), "{exported:#?}");
    assert!(exported.errors.contains("the recording has no end"), "{exported:#?}");
    let events = std::fs::read_to_string(tables.join("events.csv")).unwrap();
    assert!(events.contains(",note,electrode 3 is loose"), "{events}");
    export(&tables, &[]).assert_failed(2, &["is not empty", "--force"]);
    assert_eq!(export(&tables, &["--force"]).exit_code, Some(0));
    let settings = exports.path().join("settings");
    std::fs::create_dir(&settings).unwrap();
    std::fs::write(settings.join("tendon.toml"), "mine").unwrap();
    export(&settings, &["--force"]).assert_failed(2, &["something else than an export"]);
    std::fs::write(tables.join("zones.csv"), "mine").unwrap();
    export(&tables, &["--force"]).assert_failed(2, &["zones.csv is something else than an export"]);
    let xdf = exports.path().join("other.xdf");
    std::fs::write(&xdf, "XDF:").unwrap();
    let export = TendonBuilder::command(&unique_session(), &["export", "--force"]).arg(&file).arg("--xdf");
    export.arg(&xdf).end().assert_failed(2, &["other.xdf is something else than an export"]);
    let session_facts = std::fs::read_to_string(tables.join("session.json")).unwrap();
    let session_facts: serde_json::Value = serde_json::from_str(&session_facts).unwrap();
    assert_eq!(session_facts["unit"], "adc_counts");
    assert_eq!(session_facts["channels"][3], "channel_3");
    session.signal(Signal::SIGINT);
    let report = session.end().report();
    assert!(report.recordings[0].error.as_ref().unwrap().contains("signal: 9"), "{report:#?}");
}

#[test]
fn the_key_w_starts_a_recording_and_ends_it() {
    let name = unique_session();
    let home = tempfile::tempdir().unwrap();
    let terminal = nix::pty::openpty(None, None).unwrap();
    let mut keys = File::from(terminal.master);
    let builder = TendonBuilder::run(&name).env("XDG_DATA_HOME", home.path());
    let mut session = builder.controlled_by(terminal.slave).start();
    session.wait_until_running();
    let folder = home.path().join("tendon/sessions");
    keys.write_all(b"w").unwrap();
    wait_for_commands(&mut session, &folder, 15);
    keys.write_all(b"w").unwrap();
    wait_until("the end of the recording", || session.errors_so_far().contains("recorded to ").then_some(()));
    keys.write_all(b"q").unwrap();
    let ended = session.end();
    let report = ended.report();
    assert_eq!((report.recordings.len(), &report.recordings[0].error), (1, &None), "{ended:#?}");
    let file = file_in(&folder).unwrap();
    let mut reader = Reader::open(&file).unwrap();
    while reader.next_message().unwrap().is_some() {}
    assert!(reader.is_whole());

    // A replay begins anew with the first block of it. That it decides otherwise is no fault, and two of them are the same.
    let replays = ["first", "second"].map(|name| home.path().join(name));
    let compared = replays.each_ref().map(|folder| replay_and_compare(&name, &file, folder, &[]));
    for compared in &compared {
        assert_eq!(compared.exit_code, Some(0), "{compared:#?}");
        assert!(compared.errors.contains("was begun in a running session"), "{compared:#?}");
        // Windows that lie in it wholly are those of the recording.
        assert!(compared.output.contains(", 0 only in the second"), "{compared:#?}");
        assert!(!compared.output.contains(" 0 the same, 0 different"), "{compared:#?}");
    }
    let compared = TendonBuilder::command(&name, &["compare"]);
    let compared =
        replays.iter().fold(compared, |command, folder| command.arg(file_in(folder).unwrap())).end();
    assert_eq!(compared.exit_code, Some(0), "{compared:#?}");
    assert_eq!(
        compared.output.matches(" 0 different, 0 only in the first, 0 only").count(),
        2,
        "{compared:#?}"
    );
}

#[test]
fn a_full_disk_and_a_deleted_file_stop_the_recording_and_not_the_session() {
    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    let session = start_recording(&name, folder.path());
    let recorder = session.stage("recorder").to_string();
    // What a full disk does: no byte more.
    let limited = Command::new("prlimit").args(["--fsize=1000", "--pid", &recorder]).status().unwrap();
    assert!(limited.success());
    wait_until("the note on it", || {
        session.errors_so_far().contains("the recording has stopped: cannot write").then_some(())
    });
    session.signal(Signal::SIGINT);
    assert!(session.end().report().recordings[0].error.as_ref().unwrap().contains("File too large"));

    let name = unique_session();
    let folder = tempfile::tempdir().unwrap();
    let session = start_recording(&name, folder.path());
    std::fs::remove_file(file_in(folder.path()).unwrap()).unwrap();
    wait_until("the note on it", || session.errors_so_far().contains("was deleted or moved").then_some(()));
    session.signal(Signal::SIGINT);
    let ended = session.end();
    assert_eq!(ended.exit_code, Some(0));
    assert!(!ended.errors.contains("holds what was written until then"), "{ended:#?}");
    assert!(ended.output.contains("where it is no more"), "{ended:#?}");

    let blocked = folder.path().join("file");
    std::fs::write(&blocked, "").unwrap();
    let refused = TendonBuilder::run(&name).arg("--record").arg(&blocked).end();
    refused.assert_failed(2, &["the recording cannot begin"]);
}
