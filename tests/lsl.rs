//! The Lab Streaming Layer, in and out. Each test has a network of its own on this machine: a session id of LSL.
//!
//! Tests with pylsl run where `TENDON_PYLSL` names a Python that has it, and say so where it does not.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests may")]

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tempfile::TempDir;
use tendon_system_tests::{Tendon, TendonBuilder, program, repository, unique_session, wait_until};
use tendon_transport::SessionName;

/// A network that nobody else sees, or nothing where there is no liblsl.
struct Network {
    session: SessionName,
    folder: TempDir,
}

impl Network {
    fn new() -> Option<Network> {
        let fetched = repository().join(".cache/lsl/liblsl.so");
        if std::env::var_os("LSL_LIBRARY").is_none() && !fetched.is_file() {
            println!("skipped: liblsl not found (scripts/fetch-libraries lsl)");
            return None;
        }
        let session = unique_session();
        let folder = tempfile::tempdir().unwrap();
        // Of several streams on one machine, all answer only if each port is asked, not only the one they share.
        let configuration = format!(
            "[ports]\nIPv6=disable\n[multicast]\nResolveScope=machine\n[lab]\nSessionID={session}\nKnownPeers={{127.0.0.1}}\n\
             [log]\nlevel=-2\n"
        );
        std::fs::write(folder.path().join("lsl_api.cfg"), configuration).unwrap();
        Some(Network { session, folder })
    }

    fn configuration(&self) -> PathBuf {
        self.folder.path().join("lsl_api.cfg")
    }

    /// The emulator that comes with Tendon, once it streams.
    fn emulator(&self, arguments: &[&str]) -> Peer {
        let mut command = Command::new(program("tendon-lsl-emulator"));
        command.args(arguments);
        Peer::start(command, &self.configuration())
    }

    /// A Python program that uses pylsl, once it has printed a line; nothing where there is no pylsl.
    fn python(&self, text: &str) -> Option<Peer> {
        let Some(python) = std::env::var_os("TENDON_PYLSL").filter(|python| !python.is_empty()) else {
            println!("skipped: TENDON_PYLSL names no Python that has pylsl");
            return None;
        };
        let mut command = Command::new(python);
        command.arg("-c").arg(text);
        Some(Peer::start(command, &self.configuration()))
    }

    fn run(&self) -> TendonBuilder {
        TendonBuilder::run(&self.session).env("LSLAPICFG", self.configuration())
    }

    fn read(&self) -> TendonBuilder {
        self.run().args(&["--set", "acquisition.source=lsl"])
    }
}

/// Another program on the network. Dropping it kills it.
struct Peer {
    process: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Peer {
    fn start(mut command: Command, configuration: &Path) -> Peer {
        command.env("LSLAPICFG", configuration).stdin(Stdio::null()).stdout(Stdio::piped());
        let mut process = command.spawn().unwrap();
        let mut output = BufReader::new(process.stdout.take().unwrap());
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        assert!(!line.is_empty(), "the peer ended");
        Peer { process, output }
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.process.id() as i32), signal).unwrap();
    }

    /// What it prints until it ends by itself.
    fn rest(&mut self) -> String {
        let mut text = String::new();
        self.output.read_to_string(&mut text).unwrap();
        text
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn wait_for_error(tendon: &mut Tendon, text: &str, times: usize) {
    wait_until(text, || {
        assert!(!tendon.has_ended(), "{}", tendon.errors_so_far());
        (tendon.errors_so_far().matches(text).count() >= times).then_some(())
    });
}

#[test]
fn a_stream_is_listed_and_read_and_every_sample_that_it_lost_is_counted() {
    let Some(network) = Network::new() else { return };
    let _emulator = network.emulator(&["--lose", "7"]);
    let list = network.folder.path().join("sources.json");
    let ended = TendonBuilder::command(&network.session, &["sources", "--json"])
        .arg(&list)
        .env("LSLAPICFG", network.configuration())
        .end();
    assert_eq!(ended.exit_code, Some(0), "{ended:?}");
    assert!(ended.output.contains("\"Tendon emulator\" (type EMG, 4 channels, 2000 Hz"), "{ended:?}");
    let list: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(list).unwrap()).unwrap();
    assert_eq!(list["lsl"]["streams"][0]["channel_facts"][3]["label"], "EMG 4", "{list}");

    let ended = network.read().args(&["--duration", "5s"]).end();
    let report = ended.report();
    assert_eq!(report.source, "lsl");
    assert!(ended.output.contains("channels EMG 1, EMG 2, EMG 3, EMG 4, adc_counts"), "{ended:?}");
    // One loss of seven in each second.
    assert!(report.lost_samples.is_multiple_of(7), "{report:#?}");
    assert!((28..=42).contains(&report.lost_samples), "{report:#?}");
    assert!(report.messages["blocks"].published > 0, "{report:#?}");
}

#[test]
fn a_stream_that_ends_or_falls_silent_is_said_and_found_again() {
    let Some(network) = Network::new() else { return };
    let emulator = network.emulator(&[]);
    let mut tendon = network.read().start();
    // Before the session begins: it waits for the stream, as it does later.
    tendon.before_the_start(|| drop(emulator));
    tendon.wait_until_running();
    wait_for_error(&mut tendon, "has ended, or the connection to it: the arm stops", 1);
    let emulator = network.emulator(&[]);
    wait_for_error(&mut tendon, ") is back", 1);
    emulator.signal(Signal::SIGKILL);
    drop(emulator);
    wait_for_error(&mut tendon, "has ended, or the connection to it: the arm stops", 2);
    // Another one of that name with another rate is none that the session can take.
    let other = network.emulator(&["--rate-hz", "1000"]);
    wait_for_error(&mut tendon, "its rate or format has changed", 1);
    drop(other);
    let emulator = network.emulator(&[]);
    let returned = Instant::now();
    wait_for_error(&mut tendon, ") is back", 2);
    println!("found again after {:?}", returned.elapsed());
    emulator.signal(Signal::SIGSTOP);
    wait_for_error(&mut tendon, "sends no samples", 1);
    emulator.signal(Signal::SIGCONT);
    wait_for_error(&mut tendon, ") is back", 3);
    tendon.signal(Signal::SIGTERM);
    let report = tendon.end().report();
    assert_eq!(report.restarts, 0, "{report:#?}");
    // The time that the first one was gone, which no sample of the second one fills.
    assert!(report.lost_samples > 0, "{report:#?}");
}

#[test]
fn a_session_without_the_stream_or_with_several_is_refused_with_those_there_are() {
    let Some(network) = Network::new() else { return };
    let refused = network.read().args(&["--set", "acquisition.lsl.wait_s=0.5"]).end();
    refused.assert_failed(2, &["no LSL stream with type \"EMG\" within 0.5 s", "no stream answers at all"]);
    let _first = network.emulator(&["--name", "left"]);
    let _second = network.emulator(&["--name", "right", "--rate-hz", "1000"]);
    network
        .read()
        .end()
        .assert_failed(2, &["2 LSL streams", "\"left\"", "\"right\"", "acquisition.lsl.name"]);
    let right =
        |setting: &str| network.read().args(&["--set", "acquisition.lsl.name=right", "--set", setting]);
    right("acquisition.channels=4")
        .end()
        .assert_failed(2, &["1000 Hz", "--set acquisition.sample_rate_hz=1000"]);
    network
        .read()
        .args(&["--set", "acquisition.lsl.name=left", "--set", "acquisition.unit=mV"])
        .end()
        .assert_failed(2, &["EMG 1", "ADC counts", "acquisition.unit"]);
    network
        .read()
        .args(&["--set", "acquisition.lsl.library=/nowhere/liblsl.so"])
        .end()
        .assert_failed(2, &["/nowhere/liblsl.so", "scripts/fetch-libraries lsl"]);
}

/// An outlet of somebody else's: a trigger among the channels, volts, stamps by count; of each second 13 samples are lost.
const PYTHON_OUTLET: &str = "
import time, pylsl
info = pylsl.StreamInfo('other amplifier', 'EMG', 5, 2000, 'double64', 'other-1')
channels = info.desc().append_child('channels')
for label, kind in [('trigger', 'trigger'), ('FCR', 'EMG'), ('ECR', 'EMG'), ('FCU', 'EMG'), ('ECU', 'EMG')]:
    channel = channels.append_child('channel')
    channel.append_child_value('label', label)
    channel.append_child_value('unit', 'volts')
    channel.append_child_value('type', kind)
outlet = pylsl.StreamOutlet(info)
markers = pylsl.StreamOutlet(pylsl.StreamInfo('markers', 'Markers', 1, 0, 'string', 'other-2'))
print('streaming', flush=True)
began, sample, lost = pylsl.local_clock(), 0, 0
while True:
    chunk = [[1.0, 0.001 * ((sample + k) % 7), 0.002, 0.003, 0.004] for k in range(20)]
    sample += 20
    newest = began + (sample - 1) / 2000
    time.sleep(max(0.0, newest - pylsl.local_clock()))
    outlet.push_chunk(chunk, newest)
    if sample // 2000 > lost:
        lost += 1
        sample += 13
";

#[test]
fn a_stream_of_another_program_is_read_by_its_labels_in_the_unit_asked_for() {
    let Some(network) = Network::new() else { return };
    let Some(_outlet) = network.python(PYTHON_OUTLET) else { return };
    let ended = network.read().args(&["--set", "acquisition.unit=mV", "--duration", "5s"]).end();
    let report = ended.report();
    assert!(ended.output.contains("channels FCR, ECR, FCU, ECU, mV"), "{ended:?}");
    assert!(report.lost_samples.is_multiple_of(13), "{report:#?}");
    assert!((52..=78).contains(&report.lost_samples), "{report:#?}");
    network
        .read()
        .args(&["--set", "acquisition.channel_selection=[\"palm\", 1, 2, 3]"])
        .end()
        .assert_failed(2, &["no channel `palm`", "0: trigger, 1: FCR"]);
    network
        .read()
        .args(&["--set", "acquisition.lsl.type=Markers"])
        .end()
        .assert_failed(2, &["\"markers\"", "no fixed rate"]);
}

/// Reads what a session gives, for some seconds.
const PYTHON_INLET: &str = "
import time, pylsl
print('looking', flush=True)
streams = {}
end = time.time() + 60
while len(streams) < 3 and time.time() < end:
    for info in pylsl.resolve_streams(1.0):
        if info.name().startswith('Tendon '):
            streams[info.name().split()[-1]] = info
inlets = {name: pylsl.StreamInlet(info) for name, info in streams.items()}
labels = []
channel = inlets['predictions'].info().desc().child('channels').first_child()
while not channel.empty():
    labels.append(channel.child_value('label'))
    channel = channel.next_sibling()
print('labels', labels, flush=True)
counts, markers, ages = {'predictions': 0, 'commands': 0}, [], []
end = time.time() + 90
while time.time() < end and (counts['commands'] < 100 or not any('extension' in marker for marker in markers)):
    for name in counts:
        sample, stamp = inlets[name].pull_sample(0.05)
        if stamp is not None:
            counts[name] += 1
            ages.append(pylsl.local_clock() - stamp)
    marker, stamp = inlets['markers'].pull_sample(0.0)
    if stamp is not None:
        markers.append(marker[0])
print('counts', counts['predictions'] > 90, counts['commands'] >= 100, 'ages', min(ages) >= 0)
print('markers', markers)
";

#[test]
fn another_program_reads_predictions_commands_and_markers_of_a_session() {
    let Some(network) = Network::new() else { return };
    let Some(mut reader) = network.python(PYTHON_INLET) else { return };
    let tendon = network.run().arg("--lsl-out").start();
    let read = reader.rest();
    assert!(read.contains("labels ['probability rest', 'probability extension'"), "{read}");
    assert!(read.contains("'effort grip']"), "{read}");
    assert!(read.contains("counts True True ages True"), "{read}");
    assert!(read.contains("gesture extension"), "{read}");
    tendon.signal(Signal::SIGTERM);
    let ended = tendon.end();
    ended.report();
    assert!(!ended.errors.contains("goes on without it"), "{ended:?}");
}
