//! Recordings replayed: everything comes through, and the same every time.
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::collections::HashMap;
use std::path::Path;

use tendon_classifier::{Recogniser, runtime_library};
use tendon_config::{Config, Pace, Source};
use tendon_gesture::{DecisionSettings, Strategy};
use tendon_messages::{PREDICTIONS, WINDOWS};
use tendon_pipeline::{Pipeline, PipelineSettings};
use tendon_recordings::{Channel, RecordingSettings, ReplayStream};
use tendon_report::Report;
use tendon_session_file::{Reader, Record};
use tendon_system_tests::recordings::{
    MOVEMENT, REST, Stretch, real_three_dc, write_edf, write_table, write_three_dc,
};
use tendon_system_tests::{
    StageAlone, TendonBuilder, assert_nothing_left, model, repository, unique_session, wait_until,
};
use tendon_transport::{Delivery, Leftovers, Session, SessionLock, Subscriber};

/// Windows that `samples` samples give at the default settings: 600 long, one every 150.
fn windows_of(samples: u64) -> u64 {
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
    let recordings = folder.path().join("recordings");
    let record = [&CSV[..], &["--record", recordings.to_str().unwrap()]].concat();
    let report = replay_at_full_speed(&path, &record);
    assert_complete(&report, 900, windows_of(9000));
    // Nobody allocates for the recorder, which came last.
    assert!(report.allocations.values().all(|allocations| *allocations == 0), "{report:#?}");
    assert!(report.replay_x_real_time.unwrap() > 0.0);
}

#[test]
fn the_columns_of_a_table_are_named_and_its_time_gives_the_rate_and_the_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("emg.csv");
    // 100 ms are missing in the middle.
    let row = |row: usize| {
        format!("{:.4},{},2,3,4\n", (row + if row < 1000 { 0 } else { 200 }) as f64 / 2000.0, row % 7)
    };
    let samples: String = (0..2000).map(row).collect();
    std::fs::write(&path, format!("time,flexor,extensor,thumb,ulna\n{samples}")).unwrap();
    let run = |channels: &[&str]| {
        let builder = TendonBuilder::run(&unique_session()).args(&["--pace", "full", "--realtime", "off"]);
        builder.arg("--replay").arg(&path).args(channels).end()
    };
    let ended = run(&[]);
    assert!(ended.output.contains("at 2000 Hz, columns flexor, extensor, thumb, ulna\n"), "{ended:#?}");
    assert!(ended.errors.contains("200 samples are missing in 1 place"), "{ended:#?}");
    assert!(ended.errors.contains("channels extensor (2), thumb (3), ulna (4) were constant"), "{ended:#?}");
    let recorded = folder.path().join("recorded");
    let channels = "acquisition.replay.channels=[2,1,0,3]";
    let ended = run(&["--set", channels, "--record", recorded.to_str().unwrap()]);
    assert!(ended.output.contains("columns extensor, flexor, time, thumb\n"), "{ended:#?}");
    assert!(
        ended.errors.contains("column `time` is taken as EMG, as asked, but looks like time"),
        "{ended:#?}"
    );
    // What was recorded has the names of the columns, too.
    let session = std::fs::read_dir(&recorded).unwrap().next().unwrap().unwrap().path();
    let mut reader = Reader::open(&session.join("session.mcap")).unwrap();
    let mut said = None;
    while let Some(record) = reader.next().unwrap() {
        if let Record::Metadata { name, facts } = record
            && name == "stages"
        {
            said = facts.get("json").cloned();
        }
    }
    let names = r#""channels":["extensor","flexor","time","thumb"]"#;
    assert!(said.as_ref().unwrap().contains(names), "{said:?}");
}

#[test]
fn at_full_speed_two_replays_of_a_recording_with_cues_are_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("EMG");
    write_three_dc(&path);
    let channels = ["--set", "acquisition.replay.channels=[0,1,2,3]"];
    let [first, second] = [(); 2].map(|()| replay_at_full_speed(&path, &channels));
    // 12 s at 1000 Hz, resampled to 2000 Hz.
    assert_complete(&first, 2400, windows_of(24_000));
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
fn an_edf_file_with_a_gap_is_replayed_at_the_rate_of_the_session_with_its_own_cues() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("delsys.edf");
    write_edf(&path);
    let run =
        TendonBuilder::run(&unique_session()).args(&["--pace", "full", "--realtime", "off", "--replay"]);
    let ended = run.arg(&path).end();
    let report = ended.report();
    // Twice 5772 samples at 1925.926 Hz, of which each 27 / 26 remain: 599 blocks, after which windows begin anew.
    assert_complete(&report, 2 * 599, 2 * windows_of(5990));
    // Half a second, and what fills no block before it.
    assert!((1000..1010).contains(&report.lost_samples), "{report:#?}");
    assert!(report.recognition.windows > 60, "{report:#?}");
    let columns = "columns EMG 1, EMG 2, EMG 3, EMG 4, in uV";
    assert!(ended.output.contains("at 1925.926 Hz") && ended.output.contains(columns), "{ended:#?}");
}

#[test]
fn a_real_recording_comes_through_whole_and_the_same_every_time() {
    let Some(path) = real_three_dc() else { return };
    let [first, second] = [(); 2].map(|()| replay_at_full_speed(&path, &["--repetition", "0"]));
    let blocks = first.messages["blocks"].published;
    // 55 s of samples, as the data set's description says.
    assert!((10_500..=11_500).contains(&blocks), "{first:#?}");
    assert_complete(&first, blocks, windows_of(10 * blocks));
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

/// What the libraries make of a recording without any process: every window and its probabilities, by the
/// window's first sample.
fn offline(path: &Path, strategy: Strategy) -> HashMap<u64, (Vec<f32>, Vec<f32>)> {
    let config = Config::default();
    let recording = RecordingSettings {
        channels: (0..4).map(Channel::Index).collect(),
        sample_rate_hz: None,
        ..RecordingSettings::default()
    };
    let mut stream = ReplayStream::open(path, &recording, 2000.0, config.acquisition.block_samples).unwrap();
    let fetched = repository().join(".cache/onnxruntime/libonnxruntime.so");
    let library =
        if std::env::var_os("ORT_DYLIB_PATH").is_some() { runtime_library(None).unwrap() } else { fetched };
    let [five, rest_move] = ["cnn-five-gesture", "cnn-rest-move"].map(model);
    let decision = DecisionSettings { strategy, ..config.decision.clone() };
    let recogniser = Recogniser::load(&library, &decision, Some(&five), Some(&rest_move)).unwrap();
    let settings =
        PipelineSettings { channels: 4, sample_rate_hz: 2000.0, signal: config.dsp.clone(), decision };
    let mut pipeline = Pipeline::new(settings, recogniser).unwrap();
    let mut block = vec![0.0; config.block_length()];
    let mut windows = HashMap::new();
    while stream.next_block(&mut block).unwrap().is_some() {
        let keep = |step: tendon_pipeline::Step<'_>| {
            windows.insert(
                step.window.first_sample,
                (step.samples.to_vec(), [step.recognition.probabilities, step.recognition.efforts].concat()),
            );
        };
        pipeline.push(&block, keep).unwrap();
    }
    windows
}

#[test]
fn windows_and_predictions_of_the_processes_are_bit_for_bit_those_of_the_offline_path() {
    live_is_as_offline(Strategy::Threshold);
}

#[test]
fn those_of_the_two_stage_strategy_are_so_too() {
    live_is_as_offline(Strategy::TwoStage);
}

fn live_is_as_offline(strategy: Strategy) {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("EMG");
    write_three_dc(&recording);
    let offline = offline(&recording, strategy);
    let name = unique_session();
    let mut config = Config { session: name.clone(), ..Config::default() };
    config.acquisition.source = Source::Replay;
    config.acquisition.replay.path = Some(recording);
    config.acquisition.replay.channels = Some((0..4).map(Channel::Index).collect());
    // Nothing is lost, on a slow machine neither.
    config.acquisition.replay.pace = Pace::Full;
    config.decision.strategy = strategy;
    config.inference.model = Some(model("cnn-five-gesture"));
    config.inference.rest_move_model = Some(model("cnn-rest-move"));
    let path = folder.path().join("tendon.toml");
    std::fs::write(&path, config.to_toml()).unwrap();

    let lock = SessionLock::take(&name).unwrap();
    let mut stages =
        ["acquisition", "dsp", "inference", "decision", "robot"].map(|stage| StageAlone::start(stage, &path));
    let session = Session::join(&name, "test").unwrap();
    let mut windows = Subscriber::open(&session, &WINDOWS, None, Delivery::Lossless).unwrap();
    let mut predictions = Subscriber::open(&session, &PREDICTIONS, None, Delivery::Lossless).unwrap();
    assert!(windows.connect().unwrap() && predictions.connect().unwrap());
    stages[0].order("start");

    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<u32>>();
    // 12 s at 1000 Hz, resampled to 2000 Hz.
    let expected = windows_of(24_000);
    assert_eq!(offline.len() as u64, expected);
    let (mut windows_compared, mut predictions_compared) = (0, 0);
    wait_until("all windows and predictions", || {
        while let Some(message) = windows.receive().unwrap() {
            let first_sample = message.header().context.first_sample;
            assert!(bits(message.payload()) == bits(&offline[&first_sample].0), "window at {first_sample}");
            windows_compared += 1;
        }
        while let Some(message) = predictions.receive().unwrap() {
            let first_sample = message.header().context.first_sample;
            assert_eq!(
                bits(message.payload()),
                bits(&offline[&first_sample].1),
                "prediction at {first_sample}"
            );
            predictions_compared += 1;
        }
        (windows_compared.min(predictions_compared) == expected).then_some(())
    });

    drop((windows, predictions, session));
    for stage in stages {
        let (exit_code, errors) = stage.stop();
        assert_eq!(exit_code, Some(0), "{errors}");
    }
    Leftovers::remove(&lock);
    drop(lock);
    assert_nothing_left(&name);
}

#[test]
fn a_session_says_once_that_its_rest_is_of_another_unit_than_the_models() {
    let folder = tempfile::tempdir().unwrap();
    // Rest in ADC counts, as the models know it, and in something a hundred times as large.
    for (name, amplitude, is_other) in [("counts.csv", 55.0, false), ("other.csv", 0.55, true)] {
        let table = folder.path().join(name);
        write_table(&table, &[Stretch { samples: 14_000, amplitudes: [amplitude; 4] }]);
        let builder = TendonBuilder::run(&unique_session()).args(&["--pace", "full", "--realtime", "off"]);
        let ended = builder.args(&["--replay-rate-hz", "2000", "--replay"]).arg(&table).end();
        assert_eq!(ended.exit_code, Some(0), "{ended:#?}");
        let warnings = ended.errors.matches("times weaker than in the recordings").count();
        assert_eq!(warnings, usize::from(is_other), "{ended:#?}");
        assert_eq!(ended.errors.contains("(in ADC counts)"), is_other, "{ended:#?}");
    }
}
