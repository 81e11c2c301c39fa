//! Terminals and pipes that stall, close or are full: every stop reaches the arm, and what was measured is written.
//!
//! ```text
//! reader stops (Ctrl-S), reader leaves (head), disk full, terminal closed
//!        └─▶ space, q, Ctrl-C, SIGTERM, SIGHUP, tendon stop ─▶ flange at rest ─▶ report.json, exit code, nothing left
//! ```
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use nix::fcntl::{FcntlArg, FdFlag, OFlag, fcntl};
use nix::sys::signal::{Signal, kill};
use nix::sys::termios::{FlowArg, tcflow};
use nix::unistd::Pid;
use tempfile::TempDir;
use tendon_system_tests::{
    EmulatedArm, TendonBuilder, WATCHDOG, assert_nothing_left, model, program, unique_session, wait_until,
};
use tendon_transport::SessionName;

/// How long a stop may take on a machine that runs other tests at the same time.
const PATIENCE: Duration = Duration::from_secs(1);
/// How long the arm moves on a stalled terminal before it is stopped.
const STALL: Duration = Duration::from_millis(500);

/// A session that moves an emulated arm, with streams of the test's choice.
struct Moving {
    emulator: EmulatedArm,
    session: SessionName,
    process: Child,
    folder: TempDir,
    _state_home: TempDir,
}

impl Moving {
    fn start(prepare: impl FnOnce(&mut Command) -> &mut Command, controlling_terminal: bool) -> Moving {
        let emulator = EmulatedArm::start();
        let session = unique_session();
        let listen = emulator.listen;
        let state_home = tempfile::tempdir().unwrap();
        emulator.leave_in_good_order(state_home.path());
        let mut builder = TendonBuilder::run_with_model(&session, &model("cnn-six-class"));
        builder = builder.env("XDG_STATE_HOME", state_home.path());
        builder = builder.args(&["--strategy", "direct", "--script", "rest 1s, ulnar 60s"]);
        for setting in [
            "robot.backend=\"xarm\"".to_owned(),
            format!("robot.xarm.address=\"{}\"", listen.address),
            format!("robot.xarm.control_port={}", listen.control_port),
            format!("robot.xarm.normal_report_port={}", listen.normal_report_port),
            format!("robot.xarm.real_time_report_port={}", listen.real_time_report_port),
            "decision.speed_mm_per_s=100.0".to_owned(),
        ] {
            builder = builder.args(&["--set", &setting]);
        }
        let (mut command, folder) = builder.into_command(controlling_terminal);
        prepare(&mut command);
        let process = command.spawn().unwrap();
        let moving = Moving { emulator, session, process, folder, _state_home: state_home };
        wait_until("full speed", || (moving.speed_mm_per_s() > 97.0).then_some(()));
        moving
    }

    /// On a terminal of its own, which is returned: keys are written to the master.
    fn on_terminal() -> (Moving, File, OwnedFd) {
        let terminal = nix::pty::openpty(None, None).unwrap();
        for end in [&terminal.master, &terminal.slave] {
            // Or the session holds its own terminal open.
            fcntl(end, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).unwrap();
        }
        let slave = || Stdio::from(terminal.slave.try_clone().unwrap());
        let moving = Moving::start(|command| command.stdin(slave()).stdout(slave()).stderr(slave()), true);
        (moving, File::from(terminal.master), terminal.slave)
    }

    fn speed_mm_per_s(&self) -> f64 {
        self.emulator.model().speed_mm_per_s()
    }

    /// Asserts that the flange comes to rest because of what was just done.
    fn assert_stops(&self, by: &str) {
        let begun = Instant::now();
        while self.speed_mm_per_s() > 0.0 {
            assert!(begun.elapsed() < PATIENCE, "{by} did not stop the arm");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.process.id() as i32), signal).unwrap();
    }

    /// Waits for the end; gives the exit code. The report is written and nothing is left.
    fn end(mut self) -> Option<i32> {
        let status = wait_until("the end of tendon", || self.process.try_wait().unwrap());
        let report = std::fs::read_to_string(self.folder.path().join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        assert!(report["messages"]["commands"]["published"].as_u64().unwrap() > 0, "{report:#}");
        assert_nothing_left(&self.session);
        status.code()
    }
}

impl Drop for Moving {
    fn drop(&mut self) {
        // One that has ended was reaped; after a failed test the session is ended in order.
        if let Ok(None) = self.process.try_wait() {
            self.signal(Signal::SIGTERM);
            let _ = self.process.wait();
        }
    }
}

/// A pipe that is full and whose reader, which is returned, reads nothing.
fn full_pipe() -> (std::io::PipeReader, OwnedFd) {
    let (reader, writer) = std::io::pipe().unwrap();
    let mut writer = File::from(OwnedFd::from(writer));
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).unwrap();
    let full = loop {
        if let Err(error) = writer.write_all(&[b'.'; 4096]) {
            break error;
        }
    };
    assert_eq!(full.kind(), ErrorKind::WouldBlock);
    fcntl(&writer, FcntlArg::F_SETFL(OFlag::empty())).unwrap();
    (reader, writer.into())
}

fn order(session: &SessionName, order: &str) {
    let ended = TendonBuilder::command(&unique_session(), &[order, "--session", &session.to_string()]).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
}

#[test]
fn every_key_stops_the_arm_though_the_terminal_takes_nothing() {
    for key in [" ", "q", "\x03"] {
        let (moving, mut keys, terminal) = Moving::on_terminal();
        // As Ctrl-S does.
        tcflow(&terminal, FlowArg::TCOOFF).unwrap();
        std::thread::sleep(STALL);
        assert!(moving.speed_mm_per_s() > 90.0, "the arm moves until the key");
        keys.write_all(key.as_bytes()).unwrap();
        moving.assert_stops(&format!("key {key:?}"));
        if key == " " {
            keys.write_all(b"q").unwrap();
        }
        assert_eq!(moving.end(), Some(0), "key {key:?}");
    }
}

#[test]
fn signals_and_orders_stop_the_arm_though_the_terminal_takes_nothing() {
    for by in ["SIGINT", "SIGTERM", "SIGHUP", "tendon stop"] {
        let (moving, _keys, terminal) = Moving::on_terminal();
        tcflow(&terminal, FlowArg::TCOOFF).unwrap();
        std::thread::sleep(STALL);
        match by {
            "tendon stop" => order(&moving.session, "stop"),
            signal => moving.signal(signal.parse().unwrap()),
        }
        moving.assert_stops(by);
        moving.signal(Signal::SIGTERM);
        assert_eq!(moving.end(), Some(0), "{by}");
    }
}

#[test]
fn signals_and_orders_stop_the_arm_though_nobody_empties_the_pipes() {
    for by in ["SIGTERM", "tendon stop"] {
        let (_output_reader, output) = full_pipe();
        let (_errors_reader, errors) = full_pipe();
        let moving =
            Moving::start(|command| command.stdin(Stdio::null()).stdout(output).stderr(errors), false);
        std::thread::sleep(STALL);
        match by {
            "tendon stop" => order(&moving.session, "stop"),
            signal => moving.signal(signal.parse().unwrap()),
        }
        moving.assert_stops(by);
        moving.signal(Signal::SIGTERM);
        assert_eq!(moving.end(), Some(0), "{by}");
    }
}

#[test]
fn a_terminal_that_is_closed_ends_the_session_in_good_order() {
    let (moving, keys, terminal) = Moving::on_terminal();
    drop((keys, terminal));
    moving.assert_stops("closing the terminal");
    assert_eq!(moving.end(), Some(0));
}

#[test]
fn a_reader_that_leaves_costs_neither_the_report_nor_a_panic() {
    let (reader, output) = std::io::pipe().unwrap();
    let (errors_reader, errors) = std::io::pipe().unwrap();
    drop((reader, errors_reader));
    let moving = Moving::start(|command| command.stdin(Stdio::null()).stdout(output).stderr(errors), false);
    moving.signal(Signal::SIGTERM);
    moving.assert_stops("SIGTERM");
    assert_eq!(moving.end(), Some(0));
}

#[test]
fn a_full_disk_under_standard_output_is_an_error_and_the_report_is_written_all_the_same() {
    let full = || File::options().write(true).open("/dev/full").unwrap();
    let session = unique_session();
    let builder = TendonBuilder::run(&session).args(&["--duration", "2s"]);
    let (mut command, folder) = builder.into_command(false);
    let output = command.stdin(Stdio::null()).stdout(full()).stderr(Stdio::piped()).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains("cannot write to standard output: No space left"), "{errors}");
    assert!(folder.path().join("report.json").is_file());
    assert_nothing_left(&session);

    let log = TendonBuilder::run(&unique_session()).args(&["--duration", "2s", "--latency-log", "/dev/full"]);
    let ended = log.end();
    ended.assert_failed(1, &["/dev/full", "No space left"]);
    assert!(ended.report_json.is_some(), "the report is lost with the log");
}

#[test]
fn doctor_and_latency_take_a_reader_that_leaves() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    let session = tendon.session().to_string();
    for arguments in [&["doctor"][..], &["latency", "--interval", "100ms", "--session", session.as_str()]] {
        let (reader, output) = std::io::pipe().unwrap();
        drop(reader);
        let mut process = Command::new(program("tendon"))
            .args(arguments)
            .env("ORT_DYLIB_PATH", tendon_system_tests::runtime_library())
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let status = wait_until("the end of a command", || process.try_wait().unwrap());
        let mut errors = String::new();
        process.stderr.take().unwrap().read_to_string(&mut errors).unwrap();
        assert!(!errors.contains("panicked"), "{arguments:?}: {errors}");
        assert_eq!(status.code(), Some(0), "{arguments:?}: {errors}");
    }
    tendon.signal(Signal::SIGTERM);
    tendon.end().report();
}

#[test]
fn observers_that_were_killed_give_their_seats_back() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    let session = tendon.session().to_string();
    let arguments = ["latency", "--interval", "50ms", "--session", session.as_str()];
    // A topic has eight seats, one of which the session itself needs.
    for _ in 0..9 {
        let (mut reader, output) = std::io::pipe().unwrap();
        let mut observer = Command::new(program("tendon")).args(arguments).stdout(output).spawn().unwrap();
        // Its first table: it is seated.
        reader.read_exact(&mut [0; 10]).unwrap();
        observer.kill().unwrap();
        observer.wait().unwrap();
    }
    let ended = TendonBuilder::command(&unique_session(), &arguments).args(&["--duration", "300ms"]).end();
    assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
    tendon.signal(Signal::SIGTERM);
    tendon.end().report();
}

#[test]
fn a_stage_that_stands_still_is_named_and_so_is_its_going_on() {
    let mut tendon = TendonBuilder::run(&unique_session()).start();
    tendon.wait_until_running();
    let inference = tendon.stage("inference");
    kill(inference, Signal::SIGSTOP).unwrap();
    let says = |text: &str| wait_until(text, || tendon.errors_so_far().contains(text).then_some(()));
    says("inference makes no progress");
    kill(inference, Signal::SIGCONT).unwrap();
    says("inference makes progress again");
    tendon.signal(Signal::SIGTERM);
    tendon.end().report();
    assert!(WATCHDOG > PATIENCE);
}
