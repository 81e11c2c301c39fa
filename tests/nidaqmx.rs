//! An NI device, whose driver is the stand-in of this project.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::path::{Path, PathBuf};

use tendon_system_tests::{Tendon, TendonBuilder, unique_session, wait_until};

// Builds the library that is loaded here.
use nidaqmx as _;

/// The stand-in, which Cargo puts beside the tests that depend on it.
fn library() -> PathBuf {
    let tests = std::env::current_exe().unwrap();
    let library = tests.parent().unwrap().join("libnidaqmx.so");
    assert!(library.is_file(), "{} is not there: was the stand-in built?", library.display());
    library
}

fn session(control: &Path, arguments: &[&str]) -> TendonBuilder {
    let library = format!("acquisition.nidaqmx.library={}", library().display());
    TendonBuilder::run(&unique_session())
        .args(&["--set", "acquisition.source=nidaqmx", "--set", &library])
        .args(arguments)
        .env("DAQMX_EMULATOR_CONTROL", control)
}

#[test]
fn an_ni_device_is_acquired_by_its_own_clock_without_a_loss() {
    let folder = tempfile::tempdir().unwrap();
    let report = session(&folder.path().join("control"), &["--duration", "6s"]).end().report();
    assert_eq!(report.source, "nidaqmx");
    assert_eq!((report.lost_samples, report.messages["blocks"].lost), (0, 0), "{report:#?}");
    assert!(report.newest_sample_to_command.count > 0, "{report:#?}");
    assert!(report.clock_drift_ppm.is_some(), "{report:#?}");
}

#[test]
fn what_the_device_does_not_have_is_refused_with_the_way_on() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |setting: &str, parts: &[&str]| {
        session(&folder.path().join("control"), &["--set", setting, "--duration", "1s"])
            .end()
            .assert_failed(2, parts);
    };
    refused(
        "acquisition.nidaqmx.channels=cDAQ1Mod1/ai0:7",
        &["does not exist", "acquisition.nidaqmx.channels"],
    );
    refused("acquisition.nidaqmx.channels=cDAQ1Mod1/ai0:2", &["3 EMG channels", "acquisition.channels"]);
    refused("acquisition.nidaqmx.library=/nonexistent.so", &["NI-DAQmx was not found", "ni.com"]);
    refused("acquisition.nidaqmx.gain=0", &["acquisition.nidaqmx", "gain"]);
}

#[test]
fn a_device_that_is_unplugged_stops_the_arm_and_is_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let control = folder.path().join("control");
    let mut tendon = session(&control, &["--duration", "60s"]).start();
    let says = |tendon: &Tendon, text: &str, times: usize| {
        wait_until(text, || (tendon.errors_so_far().matches(text).count() >= times).then_some(()));
    };
    // Before the session begins, and while it runs.
    tendon.before_the_start(|| std::fs::write(&control, "unplugged").unwrap());
    tendon.wait_until_running();
    for times in 1..=2 {
        says(&tendon, "plug it in again", times);
        std::fs::remove_file(&control).unwrap();
        says(&tendon, "the device acquires again", times);
        tendon.wait_for_blocks();
        if times == 1 {
            std::fs::write(&control, "unplugged").unwrap();
        }
    }
    tendon.signal(nix::sys::signal::Signal::SIGINT);
    let report = tendon.end().report();
    assert!(report.lost_samples > 0, "{report:#?}");
    assert_eq!(report.restarts, 0, "{report:#?}");
}
