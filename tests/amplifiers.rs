//! Amplifiers on the network, emulated, and a program that sends samples as the page says.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use nix::sys::signal::Signal;
use tendon_system_tests::{Tendon, TendonBuilder, program, repository, unique_session, wait_until};

/// A port that nobody uses now.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// An emulator, or another program that sends samples. Dropping it kills it.
struct Sender {
    process: Child,
    output: BufReader<ChildStdout>,
}

impl Sender {
    fn start(program: impl AsRef<std::ffi::OsStr>, arguments: &[&str]) -> Sender {
        let mut process = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(process.stdout.take().unwrap());
        Sender { process, output }
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line
    }

    fn say(&mut self, line: &str) {
        writeln!(self.process.stdin.as_mut().unwrap(), "{line}").unwrap();
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        // What has ended already needs no killing.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn session(source: &str, settings: &[String]) -> TendonBuilder {
    let mut builder =
        TendonBuilder::run(&unique_session()).args(&["--set", &format!("acquisition.source={source}")]);
    for setting in settings {
        builder = builder.args(&["--set", setting]);
    }
    builder.args(&["--duration", "120s"])
}

fn wait_for_error(tendon: &Tendon, text: &str) {
    wait_until(text, || tendon.errors_so_far().contains(text).then_some(()));
}

#[test]
fn a_muovi_dials_in_its_losses_are_counted_exactly_and_it_is_found_again() {
    let address = SocketAddr::from(([127, 0, 0, 1], free_port()));
    let settings = [format!("acquisition.otb.address={address}"), "acquisition.unit=uV".to_owned()];
    let mut tendon = session("otb", &settings).start();
    // Waits for the amplifier, and says so.
    wait_for_error(&tendon, "waiting for the Muovi to dial in");
    let mut emulator =
        Sender::start(program("tendon-otb-emulator"), &["muovi", "--connect", &address.to_string()]);
    tendon.wait_until_running();
    tendon.wait_for_output("EMG 1, EMG 2, EMG 3, EMG 4 in uV");
    // A second device is refused.
    let mut second = TcpStream::connect(address).unwrap();
    second.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    assert!(matches!(second.read(&mut [0; 8]), Ok(0) | Err(_)), "it is told to start, too");
    wait_for_error(&tendon, "dialled in and was refused");
    emulator.say("lose 13");
    emulator.say("torn 5");
    emulator.say("lose 1");
    assert!(emulator.line().starts_with("ready"));
    wait_until("samples after the loss", || {
        emulator.say("state");
        emulator.line().contains("lost 14").then_some(())
    });
    emulator.say("garbage");
    wait_for_error(&tendon, "counter jumped");
    wait_for_error(&tendon, "is back");
    tendon.wait_for_blocks();
    tendon.signal(Signal::SIGINT);
    let report = tendon.end().report();
    assert_eq!(report.restarts, 0, "{report:#?}");
    assert!(report.lost_samples > 14, "{report:#?}");
}

#[test]
fn a_sessantaquattro_runs_a_session_and_a_quattrocento_says_which_rates_it_has() {
    let address = SocketAddr::from(([127, 0, 0, 1], free_port())).to_string();
    let settings = ["device=sessantaquattro".to_owned(), format!("address={address}")];
    let settings = settings.map(|setting| format!("acquisition.otb.{setting}"));
    let mut tendon = session("otb", &settings).start();
    let _emulator =
        Sender::start(program("tendon-otb-emulator"), &["sessantaquattro", "--connect", &address]);
    tendon
        .wait_for_output("Sessantaquattro+ at 127.0.0.1, 2000 Hz, channels EMG 1, EMG 2, EMG 3, EMG 4 in mV");
    tendon.wait_for_blocks();
    tendon.signal(Signal::SIGINT);
    let report = tendon.end().report();
    assert_eq!((report.lost_samples, report.restarts), (0, 0), "{report:#?}");
    let refused = session("otb", &["acquisition.otb.device=quattrocento".to_owned()]).end();
    refused.assert_failed(2, &["a Quattrocento has no rate of 2000 Hz: take 512, 2048"]);
}

#[test]
fn a_trigno_server_is_set_up_checked_and_found_again() {
    let (commands, emg) = (free_port(), free_port());
    let mut emulator = Sender::start(
        program("tendon-delsys-emulator"),
        &["--command-port", &commands.to_string(), "--emg-port", &emg.to_string(), "--slots", "1,2,5,7"],
    );
    assert!(emulator.line().starts_with("ready"));
    let settings = [
        format!("acquisition.delsys.command_port={commands}"),
        format!("acquisition.delsys.emg_port={emg}"),
        "acquisition.unit=uV".to_owned(),
    ];
    let mut tendon = session("delsys", &settings).start();
    // Before the session begins: it waits for the server, as it does later.
    tendon.before_the_start(|| emulator.say("close"));
    tendon.wait_until_running();
    wait_for_error(&tendon, "closed");
    tendon.wait_for_output("slot 1, slot 2, slot 5, slot 7 in uV");
    tendon.wait_for_blocks();
    emulator.say("stuck 1");
    wait_for_error(&tendon, "slot 1: its value has not changed for 50 ms");
    wait_for_error(&tendon, "slot 1: the sensor is back");
    emulator.say("garbage");
    wait_for_error(&tendon, "the samples are out of step");
    wait_for_error(&tendon, "Trigno at 127.0.0.1 is back");
    tendon.signal(Signal::SIGINT);
    let report = tendon.end().report();
    assert_eq!(report.restarts, 0, "{report:#?}");
}

#[test]
fn the_python_program_of_the_page_feeds_a_session() {
    let page = std::fs::read_to_string(repository().join("docs/amplifier.md")).unwrap();
    let code = page.split_once("```python\n").unwrap().1.split_once("```").unwrap().0;
    if Command::new("python3").arg("--version").output().is_err() {
        println!("skipped: python3 not found");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("feed.py");
    std::fs::write(&file, code).unwrap();
    let port = free_port();
    let feed = || Sender::start("python3", &[file.to_str().unwrap(), &port.to_string()]);
    // The page says that either may be started first.
    let first = feed();
    let mut tendon = session("stream", &[format!("acquisition.stream.address=127.0.0.1:{port}")]).start();
    tendon.wait_until_running();
    tendon.wait_for_output("flexor, extensor, ulnar, radial in mV");
    tendon.wait_for_blocks();
    drop(first);
    wait_for_error(&tendon, "the connection was closed");
    wait_for_error(&tendon, "waiting for a program");
    // Somebody who sends no samples is refused with the reason, and the next one is heard.
    let mut stranger = TcpStream::connect(("127.0.0.1", port)).unwrap();
    stranger.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    wait_for_error(&tendon, "no header such as");
    let _second = feed();
    wait_for_error(&tendon, "is back");
    tendon.signal(Signal::SIGINT);
    let report = tendon.end().report();
    assert_eq!(report.restarts, 0, "{report:#?}");
    assert!(report.messages["blocks"].published > 0, "{report:#?}");
}
