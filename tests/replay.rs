//! Recordings replayed: everything comes through, and the same every time.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::path::Path;

use tendon_latency::Report;
use tendon_system_tests::recordings::{MOVEMENT, REST, Stretch, real_three_dc, write_table, write_three_dc};
use tendon_system_tests::{TendonBuilder, unique_session};

/// Windows that `samples` samples give at the default settings: 600 long, one every 150.
fn windows(samples: u64) -> u64 {
    (samples - 600) / 150 + 1
}

/// Replays at full speed. Without real-time scheduling, so that tests beside this one get their turn.
fn replay_at_full_speed(path: &Path, arguments: &[&str]) -> Report {
    let builder = TendonBuilder::run(&unique_session()).args(&["--pace", "full", "--realtime", "off"]);
    builder.arg("--replay").arg(path).args(arguments).end().report()
}

/// Asserts that every message of a finite recording came through to the end.
fn assert_complete(report: &Report, blocks: u64, windows: u64) {
    for (topic, published) in
        [("blocks", blocks), ("windows", windows), ("predictions", windows), ("commands", windows)]
    {
        let messages = report.messages[topic];
        let counts = (messages.published, messages.lost, messages.stale);
        assert_eq!(counts, (published, 0, 0), "{topic}: {report:#?}");
    }
    let hops: Vec<u64> = report.hops.iter().map(|hop| hop.transit.count).collect();
    assert_eq!(hops, [blocks, windows, windows, windows], "{report:#?}");
    assert_eq!(report.newest_sample_to_command.count, windows, "{report:#?}");
}

const CSV: [&str; 4] = ["--replay-rate-hz", "2000", "--set", "acquisition.replay.channels=[0,1,2,3]"];

#[test]
fn at_full_speed_every_block_and_window_of_a_table_comes_through() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.csv");
    // 4.5 s, and 7 samples that fill no block.
    write_table(&path, &[Stretch { samples: 9007, amplitudes: REST }]);
    let report = replay_at_full_speed(&path, &CSV);
    assert_complete(&report, 900, windows(9000));
    assert!(report.replay_x_real_time.unwrap() > 0.0);
}

#[test]
fn at_full_speed_two_replays_of_a_recording_with_cues_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("EMG");
    write_three_dc(&path);
    let channels = ["--set", "acquisition.replay.channels=[0,1,2,3]"];
    let [first, second] = [(); 2].map(|()| replay_at_full_speed(&path, &channels));
    // 12 s at 1000 Hz, resampled to 2000 Hz.
    assert_complete(&first, 2400, windows(24_000));
    assert_eq!(first.messages, second.messages);
    assert_eq!(first.recognition, second.recognition);
    assert_eq!(first.final_position_mm, second.final_position_mm);
    // The comparison says something only if the arm moved and gestures were scored.
    assert!(first.recognition.windows > 0, "{first:#?}");
    let at_rest = folder.path().join("rest.csv");
    write_table(&at_rest, &[Stretch { samples: 4000, amplitudes: REST }]);
    assert_ne!(first.final_position_mm, replay_at_full_speed(&at_rest, &CSV).final_position_mm);
}

#[test]
fn a_real_recording_comes_through_whole_and_the_same_every_time() {
    let Some(path) = real_three_dc() else { return };
    let [first, second] = [(); 2].map(|()| replay_at_full_speed(&path, &["--repetition", "0"]));
    let blocks = first.messages["blocks"].published;
    // 55 s of samples, as the data set's description says.
    assert!((10_500..=11_500).contains(&blocks), "{first:#?}");
    assert_complete(&first, blocks, windows(10 * blocks));
    assert!(first.recognition.windows > 0, "{first:#?}");
    assert_eq!(first.recognition, second.recognition);
    assert_eq!(first.final_position_mm, second.final_position_mm);
}

#[test]
fn at_its_true_pace_a_recording_ends_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.csv");
    write_table(
        &path,
        &[Stretch { samples: 2000, amplitudes: REST }, Stretch { samples: 2000, amplitudes: MOVEMENT }],
    );
    let report = TendonBuilder::run(&unique_session()).arg("--replay").arg(&path).args(&CSV).end().report();
    assert_eq!(report.source, "replay");
    assert!(report.duration_s >= 2.0, "{report:#?}");
    assert_eq!(report.replay_x_real_time, None);
    let blocks = report.messages["blocks"];
    // Blocks that this machine was too slow for are left out.
    assert!(blocks.published > 200 && blocks.published <= 400, "{report:#?}");
    assert_eq!(blocks.lost, 0, "{report:#?}");
    assert_eq!(report.hops[0].transit.count, blocks.published, "{report:#?}");
}
