//! Recordings on disk: layouts, what is wrong with them, and replay.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, as tests, may fail and print"
)]

use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use tendon_gesture::Gesture;
use tendon_recordings::{
    Channel, Notice, RecordingError, RecordingSettings, RecordingSource, ReplayStream, check,
};

fn settings(channels: &[usize], sample_rate_hz: Option<f64>) -> RecordingSettings {
    let channels = channels.iter().copied().map(Channel::Index).collect();
    RecordingSettings { channels, sample_rate_hz, ..RecordingSettings::default() }
}

/// A 3DC folder `Participant7/train/EMG`; sample n of gesture G in repetition R is `1000 R + 100 G + n` in both
/// of two channels, the second negative.
fn write_three_dc(folder: &Path, files: &[(u32, u32, usize)]) -> PathBuf {
    let folder = folder.join("Participant7/train/EMG");
    fs::create_dir_all(&folder).unwrap();
    for &(repetition, gesture, samples) in files {
        let lines: Vec<String> = (0..samples)
            .map(|sample| {
                let value = 1000 * repetition as usize + 100 * gesture as usize + sample;
                format!("{value},-{value}")
            })
            .collect();
        fs::write(folder.join(format!("3dc_EMG_gesture_{repetition}_{gesture}.txt")), lines.join("\n"))
            .unwrap();
    }
    folder
}

fn read_all(path: &Path, settings: &RecordingSettings) -> Vec<(Vec<f32>, Option<Gesture>)> {
    let mut source = RecordingSource::open(path, settings).unwrap();
    let mut frame = vec![0.0; source.channels()];
    let mut frames = Vec::new();
    while let Some(read) = source.next_frame(&mut frame).unwrap() {
        frames.push((frame.clone(), read.cue));
    }
    frames
}

/// All channels of a replay, and the cue of every sample, read in blocks of one.
fn replay_all(
    path: &Path,
    settings: &RecordingSettings,
    rate_hz: f64,
) -> (Vec<Vec<f32>>, Vec<Option<Gesture>>) {
    let mut stream = ReplayStream::open(path, settings, rate_hz, 1).unwrap();
    let mut block = vec![0.0; stream.source().channels()];
    let mut channels = vec![Vec::new(); block.len()];
    let mut cues = Vec::new();
    while let Some(read) = stream.next_block(&mut block).unwrap() {
        channels.iter_mut().zip(&block).for_each(|(channel, &sample)| channel.push(sample));
        cues.push(read.cue);
    }
    (channels, cues)
}

/// Whether a replay file by file gives the same as `replay_all`, and ends each file where its cue does.
fn assert_same_by_segment(
    path: &Path,
    settings: &RecordingSettings,
    rate_hz: f64,
    (channels, cues): &(Vec<Vec<f32>>, Vec<Option<Gesture>>),
) {
    let mut stream = ReplayStream::open(path, settings, rate_hz, 1).unwrap();
    let (mut signal, mut played) = (Vec::new(), 0);
    while let Some(read) = stream.next_piece(&mut signal, NonZeroUsize::MAX).unwrap() {
        let end = played + signal.len() / channels.len();
        assert_eq!((read.first_sample as usize, read.cue_since as usize), (played, played));
        assert!(cues[played..end].iter().all(|&cue| cue == read.cue) && cues.get(end) != Some(&read.cue));
        let expected: Vec<f32> = channels.iter().flat_map(|channel| channel[played..end].to_vec()).collect();
        assert_eq!(signal, expected, "{rate_hz} Hz, samples {played} to {end}");
        played = end;
    }
    assert_eq!(played, cues.len(), "{rate_hz} Hz");
    assert!(signal.is_empty());
}

/// The folder of the 3DC recordings, if it is here.
fn three_dc() -> Option<PathBuf> {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = match std::env::var_os("TENDON_SHARED") {
        Some(shared) => PathBuf::from(shared).join("data"),
        None => repository.join("../shared/data"),
    };
    let folder = data.join("3dc");
    if !folder.is_dir() {
        println!("skipped: recordings not found");
        return None;
    }
    Some(folder)
}

/// Every `ParticipantP/{train,test}/EMG` of it.
fn three_dc_folders(three_dc: &Path) -> Vec<PathBuf> {
    let mut folders: Vec<PathBuf> = fs::read_dir(three_dc)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_dir())
        .flat_map(|person| ["train/EMG", "test/EMG"].map(|session| person.join(session)))
        .filter(|folder| folder.is_dir())
        .collect();
    folders.sort();
    folders
}

#[test]
fn a_folder_joins_its_files_in_the_order_of_their_numbers() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(1, 0, 2), (0, 10, 1), (0, 2, 1), (0, 7, 2)]);
    let frames = read_all(&folder, &settings(&[1, 0], None));
    let expected = [
        (200.0, Some(Gesture::FLEXION)),
        (700.0, Some(Gesture::GRIP)),
        (701.0, Some(Gesture::GRIP)),
        (1000.0_f32, None),
        (1000.0, Some(Gesture::REST)),
        (1001.0, Some(Gesture::REST)),
    ];
    assert_eq!(frames, expected.map(|(value, cue)| (vec![-value, value], cue)));

    let second = RecordingSettings { repetition: Some(1), ..settings(&[0], None) };
    assert_eq!(read_all(&folder, &second).len(), 2);
    let single = read_all(&folder.join("3dc_EMG_gesture_0_7.txt"), &settings(&[0], None));
    assert_eq!(single, [(vec![700.0], Some(Gesture::GRIP)), (vec![701.0], Some(Gesture::GRIP))]);
}

#[test]
fn frames_are_read_as_far_as_the_file_and_its_faults_allow() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 3), (0, 1, 2), (0, 2, 1)]);
    fs::write(folder.join("3dc_EMG_gesture_0_1.txt"), "100,-100\n101,-101\n102,x\n").unwrap();
    let mut source = RecordingSource::open(&folder, &settings(&[1], None)).unwrap();
    let mut frames = [0.0; 2];
    let mut next = || {
        let read = source.next_frames(&mut frames).map_err(|error| error.to_string())?;
        Ok(read.map(|(count, frame)| (frames[..count].to_vec(), frame.segment)))
    };
    assert_eq!(next(), Ok(Some((vec![0.0, -1.0], 0))));
    assert_eq!(next(), Ok(Some((vec![-2.0], 0))));
    assert_eq!(next(), Ok(Some((vec![-100.0, -101.0], 1))));
    let error: String = next().unwrap_err();
    assert!(error.contains("3dc_EMG_gesture_0_1.txt, line 3, column 2: `x`"), "{error}");
    assert_eq!(next(), Err(error));
}

#[test]
fn what_a_folder_lacks_is_a_notice() {
    let temporary = tempfile::tempdir().unwrap();
    let mut files: Vec<(u32, u32, usize)> = (0..11).map(|gesture| (2, gesture, 1)).collect();
    files.remove(3);
    files.extend((0..11).map(|gesture| (0, gesture, 1)));
    let folder = write_three_dc(temporary.path(), &files);
    let summary = check(&folder, &settings(&[0], None)).unwrap();
    assert_eq!(
        summary.notices,
        [
            Notice::MissingRepetition { folder: folder.clone(), repetition: 1 },
            Notice::MissingFile { file: folder.join("3dc_EMG_gesture_2_3.txt") },
        ]
    );
}

#[test]
fn check_sums_up_the_recording() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 3), (0, 1, 2)]);
    let summary = check(&folder, &settings(&[1], Some(1000.0))).unwrap();
    assert_eq!((summary.samples, summary.file_channels, summary.duration_s), (5, 2, 0.005));
    let spans: Vec<_> =
        summary.cues.iter().map(|span| (span.segment.cue, span.first_sample, span.samples)).collect();
    assert_eq!(spans, [(Some(Gesture::REST), 0, 3), (Some(Gesture::RADIAL), 3, 2)]);
}

#[test]
fn what_cannot_be_opened_is_told_by_kind() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 1), (3, 0, 1)]);
    let open = |path: &Path, settings: &RecordingSettings| RecordingSource::open(path, settings).unwrap_err();
    let table = temporary.path().join("a.csv");
    fs::write(&table, "1,2\n").unwrap();
    let binary = temporary.path().join("a.mat");
    fs::write(&binary, "1,2\n").unwrap();

    let one = settings(&[0], Some(1000.0));
    let second = RecordingSettings { repetition: Some(1), ..settings(&[0], None) };
    assert!(matches!(open(&temporary.path().join("b.csv"), &one), RecordingError::Open { .. }));
    assert!(matches!(open(temporary.path(), &one), RecordingError::UnknownLayout { .. }));
    assert!(matches!(open(&binary, &one), RecordingError::UnknownLayout { .. }));
    assert!(matches!(open(&table, &settings(&[0], None)), RecordingError::SampleRateMissing { .. }));
    assert!(matches!(open(&table, &settings(&[0], Some(0.0))), RecordingError::Design(_)));
    assert!(matches!(open(&table, &second), RecordingError::RepetitionOfFile { .. }));
    assert!(matches!(open(&table, &settings(&[2], Some(1.0))), RecordingError::Table { .. }));
    assert!(matches!(open(&folder, &settings(&[0], Some(2000.0))), RecordingError::SampleRateDiffers { .. }));
    match open(&folder, &second) {
        RecordingError::NoSuchRepetition { available, .. } => assert_eq!(available, [0, 3]),
        other => panic!("{other}"),
    }
}

#[test]
fn a_broken_line_in_a_later_file_is_named_with_that_file() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 3), (0, 1, 3), (0, 2, 3)]);
    let broken = folder.join("3dc_EMG_gesture_0_1.txt");
    for (content, place) in [
        ("1,2\n3,x\n", "line 2, column 2: `x` is not a number"),
        ("1,2\n3\n", "line 2, column 2: expected 2 values"),
        ("1,2\n3", "line 2, column 2: the file is truncated"),
        ("1\n", "line 1, column 2: expected 2 values"),
        ("", "line 1, column 1: the file has no samples"),
    ] {
        fs::write(&broken, content).unwrap();
        let message = check(&folder, &settings(&[0, 1], None)).unwrap_err().to_string();
        assert!(message.starts_with(&format!("{}, {place}", broken.display())), "{message}");
    }
}

#[test]
fn replay_at_the_recordings_own_rate_changes_nothing() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 7), (0, 1, 6), (0, 5, 4), (0, 6, 5)]);
    let mut stream = ReplayStream::open(&folder, &settings(&[0, 1], None), 1000.0, 5).unwrap();
    let mut block = [0.0; 10];

    let first = stream.next_block(&mut block).unwrap().unwrap();
    assert_eq!((first.first_sample, first.cue, first.cue_since), (0, Some(Gesture::REST), 0));
    assert_eq!(block, [0.0, 1.0, 2.0, 3.0, 4.0, -0.0, -1.0, -2.0, -3.0, -4.0]);
    let second = stream.next_block(&mut block).unwrap().unwrap();
    assert_eq!((second.first_sample, second.cue, second.cue_since), (5, Some(Gesture::RADIAL), 7));
    assert_eq!(block[..5], [5.0, 6.0, 100.0, 101.0, 102.0]);
    let third = stream.next_block(&mut block).unwrap().unwrap();
    assert_eq!((third.cue, third.cue_since, third.segment), (None, 13, 2));
    let fourth = stream.next_block(&mut block).unwrap().unwrap();
    assert_eq!((fourth.cue, fourth.cue_since, fourth.segment), (None, 17, 3));
    assert_eq!(stream.next_block(&mut block).unwrap(), None);
    assert_eq!(stream.dropped_samples(), 2);
}

#[test]
fn replay_keeps_samples_and_cues_together_at_every_rate() {
    // A slow sine with the offset of an amplifier: what is between its samples is known.
    let value = |time_s: f64| 1000.0 + 200.0 * (std::f64::consts::TAU * 20.0 * time_s).sin();
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("EMG");
    fs::create_dir(&folder).unwrap();
    let lengths = [300, 250, 450];
    let mut written = 0;
    for (gesture, samples) in lengths.into_iter().enumerate() {
        let lines: String = (written..written + samples)
            .map(|sample| format!("{}\n", value(f64::from(sample) / 1000.0)))
            .collect();
        fs::write(folder.join(format!("3dc_EMG_gesture_0_{gesture}.txt")), lines).unwrap();
        written += samples;
    }
    for rate_hz in [250.0, 600.0, 800.0, 1500.0, 2000.0, 2048.0, 4000.0] {
        let settings = settings(&[0], None);
        let replayed = replay_all(&folder, &settings, rate_hz);
        assert_same_by_segment(&folder, &settings, rate_hz, &replayed);
        let (channels, cues) = replayed;
        assert_eq!(channels[0].len(), (1000.0 * rate_hz / 1000.0) as usize, "{rate_hz} Hz");
        for (index, (&sample, &cue)) in channels[0].iter().zip(&cues).enumerate() {
            let time_s = index as f64 / rate_hz;
            let input = (time_s * 1000.0 + 1e-9) as u32;
            let expected = if input < 300 {
                Gesture::REST
            } else if input < 550 {
                Gesture::RADIAL
            } else {
                Gesture::FLEXION
            };
            assert_eq!(cue, Some(expected), "{rate_hz} Hz, sample {index}");
            // The low-pass passes 20 Hz with 0.3 %, but not the kinks where the first and last sample are
            // held, 10 samples of the lower rate from either end.
            let margin_s = 12.0 / rate_hz.min(1000.0);
            if (margin_s..1.0 - margin_s).contains(&time_s) {
                let error = f64::from(sample) - value(time_s);
                assert!(error.abs() < 0.003 * 1200.0, "{rate_hz} Hz, sample {index}: off by {error}");
            } else {
                assert!((700.0..1300.0).contains(&sample), "{rate_hz} Hz, sample {index}: {sample}");
            }
        }
    }
}

#[test]
fn files_that_describe_themselves_are_opened_by_their_names() {
    let golden = |name: &str| Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
    let with = |channels: &[&str], sample_rate_hz| RecordingSettings {
        channels: channels.iter().map(|name| Channel::from(*name)).collect(),
        sample_rate_hz,
        ..RecordingSettings::default()
    };
    let bdf = check(&golden("delsys.bdf"), &with(&["EMG extensor", "EMG flexor"], Some(1926.0))).unwrap();
    assert_eq!((bdf.samples, bdf.file_channels, bdf.unit.as_str()), (1040, 2, "uV"));
    assert_eq!(bdf.channels, ["EMG extensor", "EMG flexor"]);
    let cues: Vec<_> =
        bdf.cues.iter().map(|span| (span.segment.cue.map(|cue| cue.to_string()), span.samples)).collect();
    let named = |name: &str| Some(name.to_owned());
    assert_eq!(cues, [(None, 193), (named("fist"), 260), (None, 125), (named("rest"), 462)]);
    assert!(bdf.notices.iter().any(|notice| notice.to_string().contains("is not 1925.926 Hz: ACC X")));

    let xdf = golden("streams.xdf");
    let read = check(&xdf, &with(&["flexor"], None)).unwrap();
    let lost: u64 = read.cues.iter().map(|span| span.segment.samples_lost_before).sum();
    assert_eq!(
        (read.samples, read.sample_rate_hz, read.unit.as_str(), lost),
        (600, 200.0, "microvolts", 600)
    );
    let refused = |settings: &RecordingSettings| RecordingSource::open(&xdf, settings).unwrap_err();
    let error = refused(&with(&["flexor"], Some(250.0)));
    assert!(matches!(error, RecordingError::SampleRateDiffers { .. }), "{error}");
    let error = refused(&RecordingSettings { repetition: Some(0), ..with(&["flexor"], None) });
    assert!(matches!(error, RecordingError::RepetitionOfFile { .. }), "{error}");
    let error = refused(&RecordingSettings { channels: vec![7.into()], ..with(&[], None) });
    assert!(error.is_missing_channel(), "{error}");
}

#[test]
fn replay_refuses_rates_and_blocks_it_cannot_make() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 7)]);
    for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e9 + 1.0] {
        let error = ReplayStream::open(&folder, &settings(&[0], None), rate_hz, 5).unwrap_err();
        assert!(matches!(error, RecordingError::Resampling { .. }), "{rate_hz}: {error}");
    }
    let error = ReplayStream::open(&folder, &settings(&[0], None), 1000.0, 0).unwrap_err();
    assert!(matches!(error, RecordingError::NoBlock));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn replay_does_not_depend_on_the_block_and_ends_with_the_recording(
        samples in 1_usize..60,
        block_samples in 1_usize..25,
        rate_hz in prop::sample::select(vec![300.0, 1000.0, 1500.0, 2000.0]),
    ) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = write_three_dc(temporary.path(), &[(0, 0, samples), (0, 1, 5)]);
        let settings = settings(&[1, 0], None);
        let replayed = replay_all(&folder, &settings, rate_hz);
        assert_same_by_segment(&folder, &settings, rate_hz, &replayed);
        let (channels, cues) = replayed;
        prop_assert_eq!(channels[0].len(), ((samples + 5) as f64 * rate_hz / 1000.0).ceil() as usize);
        let mut stream = ReplayStream::open(&folder, &settings, rate_hz, block_samples).unwrap();
        let mut block = vec![0.0; 2 * block_samples];
        let mut played = 0;
        while let Some(read) = stream.next_block(&mut block).unwrap() {
            prop_assert_eq!(read.first_sample as usize, played);
            prop_assert_eq!(&block[..block_samples], &channels[0][played..played + block_samples]);
            prop_assert_eq!(&block[block_samples..], &channels[1][played..played + block_samples]);
            played += block_samples;
            prop_assert_eq!(read.cue, cues[played - 1]);
            prop_assert!(cues[read.cue_since as usize..played].iter().all(|&cue| cue == read.cue));
        }
        prop_assert_eq!(played + stream.dropped_samples() as usize, channels[0].len());
    }
}

#[test]
fn every_real_file_is_read_to_its_last_line() {
    let Some(three_dc) = three_dc() else { return };
    let all: Vec<usize> = (0..10).collect();
    let (mut files, mut samples) = (0, 0);
    for folder in three_dc_folders(&three_dc) {
        let summary = check(&folder, &settings(&all, None)).unwrap();
        assert_eq!(summary.file_channels, 10);
        for span in &summary.cues {
            let lines = fs::read_to_string(&span.segment.file).unwrap().lines().count() as u64;
            assert_eq!(span.samples, lines, "{}", span.segment.file.display());
        }
        files += summary.cues.len();
        samples += summary.samples;
    }
    println!("{files} files, {samples} samples");
    assert!(files > 0 && samples > 0);
}

#[test]
fn a_real_recording_at_2000_hz_has_twice_the_samples() {
    let Some(three_dc) = three_dc() else { return };
    let folder = three_dc.join("Participant1/train/EMG");
    let settings = RecordingSettings { repetition: Some(0), ..settings(&[0, 3, 5, 8], None) };
    let summary = check(&folder, &settings).unwrap();
    let mut stream = ReplayStream::open(&folder, &settings, 2000.0, 10).unwrap();
    let mut block = [0.0; 40];
    let mut played = 0;
    while stream.next_block(&mut block).unwrap().is_some() {
        played += 10;
    }
    assert_eq!(played + stream.dropped_samples(), 2 * summary.samples);
}

#[test]
fn runs_of_null_are_gaps_that_a_notice_counts() {
    let Some(three_dc) = three_dc() else { return };
    let folder = three_dc.join("../mains-noise");
    for name in ["sample_data_01.csv", "sample_data_03.csv"] {
        let path = folder.join(name);
        let by_name = RecordingSettings {
            channels: vec!["EMG_zyg".into(), "EMG_cor".into()],
            sample_rate_hz: Some(2000.0),
            ..RecordingSettings::default()
        };
        let text = fs::read_to_string(&path).unwrap();
        let first_null = text.lines().position(|line| line.contains("NULL"));
        let nulls = text.lines().filter(|line| line.contains("NULL")).count();
        let summary = check(&path, &by_name).unwrap();
        assert_eq!(summary.samples as usize, text.lines().count() - 1 - nulls, "{name}");
        let notice = first_null.map(|line| Notice::MissingSamples {
            file: path.clone(),
            lines: nulls as u64,
            line: line as u64 + 1,
        });
        assert_eq!(summary.notices, Vec::from_iter(notice), "{name}");
    }
}
