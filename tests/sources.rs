//! Samples from a program of somebody else's, with a clock of its own.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use tendon_system_tests::{TendonBuilder, unique_session};

#[test]
fn a_device_that_pushes_samples_by_its_own_clock_is_acquired_by_a_program_of_its_own() {
    let program = format!("acquisition.program={}", env!("CARGO_BIN_EXE_push-device"));
    let ended = TendonBuilder::run(&unique_session())
        .args(&["--set", "acquisition.source=device", "--set", &program, "--duration", "6s"])
        .end();
    let report = ended.report();
    assert_eq!(report.source, "device");
    // 1200 are due.
    let blocks = report.messages["blocks"];
    assert!((600..=1210).contains(&blocks.published), "{report:#?}");
    assert_eq!(blocks.lost, 0, "{report:#?}");
    // The one that the device lost, and those that this machine was too slow for.
    assert!(report.skipped_blocks >= 1, "{report:#?}");
    assert_eq!(report.lost_samples, 10, "{report:#?}");
    assert!(report.clock_drift_ppm.is_some(), "{report:#?}");
    assert!(report.newest_sample_to_command.count > 0, "{report:#?}");
}

#[test]
fn a_device_without_a_program_and_a_program_that_is_missing_are_refused() {
    let session = unique_session();
    let run =
        |arguments: &[&str]| TendonBuilder::run(&session).args(arguments).args(&["--duration", "1s"]).end();
    run(&["--set", "acquisition.source=device"]).assert_failed(2, &["acquisition.program", "device"]);
    run(&["--set", "acquisition.source=device", "--set", "acquisition.program=/nonexistent/acquire"])
        .assert_failed(2, &["/nonexistent/acquire"]);
}

#[test]
fn blocks_and_increments_that_cannot_work_are_refused_by_name() {
    let session = unique_session();
    let run =
        |setting: &str| TendonBuilder::run(&session).args(&["--set", setting, "--duration", "1s"]).end();
    run("acquisition.block_samples=201").assert_failed(2, &["acquisition.block_samples", "100 ms"]);
    run("dsp.windows.increment_samples=301")
        .assert_failed(2, &["dsp.windows.increment_samples", "robot.arm.watchdog_ms"]);
}

#[test]
fn what_a_session_would_read_is_listed_for_sources_on_the_network() {
    let listed = |settings: &[&str]| {
        let settings = settings.iter().flat_map(|setting| ["--set", setting]);
        let arguments: Vec<&str> = ["sources", "--wait", "50ms"].into_iter().chain(settings).collect();
        let ended = TendonBuilder::command(&unique_session(), &arguments).end();
        assert_eq!(ended.exit_code, Some(0), "{ended:?}");
        ended.output
    };
    let otb = listed(&["acquisition.source=otb"]);
    assert!(otb.contains("from: otb (Muovi, which dials in at 0.0.0.0:54321)"), "{otb}");
    assert!(otb.contains("delsys    Delsys Trigno at 127.0.0.1, port 50040\n"), "{otb}");
    assert!(otb.contains("stream    a program that connects to 127.0.0.1:5577\n"), "{otb}");
    let nidaqmx =
        listed(&["acquisition.source=nidaqmx", "acquisition.nidaqmx.library=/nonexistent/libnidaqmx.so"]);
    assert!(
        nidaqmx.contains("from: nidaqmx (cannot be used: ") && nidaqmx.contains("nidaqmx   not there"),
        "{nidaqmx}"
    );
}
