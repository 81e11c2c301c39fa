//! What a data set holds: cut as its manifest says, as in passing, and as the live chain does.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, as tests, may fail and print"
)]

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use tendon_dataset::{self as dataset, BuildSettings, DatasetSettings, Progress, StoredDataset};
use tendon_gesture::Gesture;
use tendon_recordings::{Channel, RecordingSettings, ReplayStream};

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

fn build(
    settings: &DatasetSettings,
    paths: &[PathBuf],
    out: &Path,
) -> Result<dataset::Manifest, dataset::DatasetError> {
    dataset::build(settings, &BuildSettings::default(), paths, out, &mut |_| ControlFlow::Continue(()))
}

/// The rows of an array as bytes, after checking its header.
fn npy_rows(path: &Path, description: &str, shape: &str) -> Vec<u8> {
    let bytes = fs::read(path).unwrap();
    let header_end = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = std::str::from_utf8(&bytes[10..header_end]).unwrap();
    assert!(header.contains(&format!("'descr': '{description}'")), "{header}");
    assert!(header.contains(&format!("'shape': ({shape})")), "{header}");
    bytes[header_end..].to_vec()
}

#[test]
fn a_data_set_is_cut_as_its_manifest_says() {
    let temporary = tempfile::tempdir().unwrap();
    let folder =
        write_three_dc(temporary.path(), &[(0, 0, 1500), (0, 1, 900), (0, 2, 600), (0, 5, 900), (1, 4, 900)]);
    // Broken beyond repair: repetition 2 is left out as a whole.
    fs::write(folder.join("3dc_EMG_gesture_2_0.txt"), "1,2\n3,four\n").unwrap();
    let settings = DatasetSettings {
        channels: vec![Channel::Index(0), Channel::Index(1)],
        ..DatasetSettings::default()
    };
    let out = temporary.path().join("out");
    let mut steps = Vec::new();
    let mut progress = |step: Progress<'_>| {
        match step {
            Progress::Begun { total, resumed, windows, is_other } => {
                assert_eq!((total, resumed, windows, is_other), (3, 0, 0, false));
            }
            Progress::Recording { done, total, .. } => steps.push((done, total)),
        }
        ControlFlow::Continue(())
    };
    let manifest =
        dataset::build(&settings, &BuildSettings::default(), &[folder], &out, &mut progress).unwrap();
    assert_eq!(steps, [(1, 3), (2, 3), (3, 3)]);
    assert!(!out.join("progress.jsonl").exists());

    // Rest: 3000 samples without the first 1000, a window of 600 every 150.
    assert_eq!((manifest.recordings[0].gesture, manifest.recordings[0].samples), (Gesture::REST, 3000));
    assert_eq!((manifest.recordings[0].windows, manifest.recordings[0].onset_sample), (10, None));
    for file in &manifest.recordings {
        // The margin before the onset, or the cut-off.
        let start = file.onset_sample.map_or(1000, |onset| onset - 100);
        assert_eq!(file.start_sample, start, "{file:?}");
        assert_eq!(file.windows as usize, (file.samples - start - 600) / 150 + 1, "{file:?}");
        assert_eq!(file.fallback, file.gesture != Gesture::REST && file.onset_sample.is_none());
    }
    let reasons: Vec<&str> = manifest.skipped.iter().map(|skipped| skipped.reason.as_str()).collect();
    assert!(reasons.contains(&"its gesture is not one of the six"), "{reasons:?}");
    assert!(
        reasons.iter().any(|reason| reason.contains("line 2, column 2: `four` is not a number")),
        "{reasons:?}"
    );
    assert!(manifest.notices.iter().any(|notice| notice.contains("3dc_EMG_gesture_0_3.txt is missing")));

    let n = manifest.windows as usize;
    assert_eq!(manifest.recordings.iter().map(|file| file.windows).sum::<u64>(), manifest.windows);
    assert_eq!(npy_rows(&out.join("windows.npy"), "<f4", &format!("{n}, 2, 600,")).len(), n * 2 * 600 * 4);
    let labels = npy_rows(&out.join("labels.npy"), "|u1", &format!("{n},"));
    let expected: Vec<u8> = manifest
        .recordings
        .iter()
        .flat_map(|file| std::iter::repeat_n(file.gesture.paper_number().unwrap(), file.windows as usize))
        .collect();
    assert_eq!(labels, expected);
    let people = npy_rows(&out.join("people.npy"), "<u2", &format!("{n},"));
    assert_eq!(people, [7, 0].repeat(n));
    let repetitions = npy_rows(&out.join("repetitions.npy"), "|u1", &format!("{n},"));
    assert_eq!(repetitions.last(), Some(&1));
    let places = |name: &str| -> Vec<u32> {
        let bytes = npy_rows(&out.join(name), "<u4", &format!("{n},"));
        bytes.chunks_exact(4).map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap())).collect()
    };
    let mut expected = Vec::new();
    for (recording, file) in manifest.recordings.iter().enumerate() {
        let start = |window: u64| (recording as u32, file.start_sample as u32 + 150 * window as u32);
        expected.extend((0..file.windows).map(start));
    }
    let stored: Vec<(u32, u32)> = places("recordings.npy").into_iter().zip(places("starts.npy")).collect();
    assert_eq!(stored, expected);
    let moving = manifest.recordings.iter().filter(|file| file.gesture != Gesture::REST).count();
    assert_eq!(manifest.onsets["total"].recordings, moving as u64);
    assert_eq!(manifest.onsets["total"].fallbacks, manifest.fallbacks);
    let written: dataset::Manifest =
        serde_json::from_slice(&fs::read(out.join("manifest.json")).unwrap()).unwrap();
    assert_eq!(written, manifest);

    let mut stored = StoredDataset::open(&out).unwrap();
    assert_eq!((stored.len(), stored.manifest()), (n, &manifest));
    for index in 0..n {
        assert_eq!(
            (stored.gesture(index).paper_number().unwrap(), stored.person(index)),
            (labels[index], 7.into())
        );
        assert_eq!(stored.repetition(index), repetitions[index]);
        let bytes: Vec<u8> = stored.window(index).iter().flat_map(|sample| sample.to_le_bytes()).collect();
        let all = npy_rows(&out.join("windows.npy"), "<f4", &format!("{n}, 2, 600,"));
        assert!(bytes == all[index * bytes.len()..][..bytes.len()], "window {index}");
        stored.release_before(index);
    }
}

#[test]
fn what_is_cut_in_passing_is_what_a_data_set_holds() {
    let temporary = tempfile::tempdir().unwrap();
    let folder =
        write_three_dc(temporary.path(), &[(0, 0, 1500), (0, 1, 900), (0, 7, 500), (0, 9, 400), (1, 4, 900)]);
    let settings = DatasetSettings {
        channels: vec![Channel::Index(1), Channel::Index(0)],
        ..DatasetSettings::default()
    };
    let out = temporary.path().join("out");
    let folders = [folder];
    let manifest = build(&settings, &folders, &out).unwrap();
    let stored = StoredDataset::open(&out).unwrap();

    let (mut index, mut trials, mut skipped) = (0, 0, Vec::new());
    for recording in &dataset::list(&settings, &folders).unwrap().recordings {
        let mut trials_of_windows = Vec::new();
        let cut = dataset::cut(&settings, recording, &mut |window| {
            assert_eq!(window.samples, stored.window(index));
            assert_eq!((window.gesture, window.person), (stored.gesture(index), stored.person(index)));
            assert_eq!(window.repetition, stored.repetition(index));
            let entry = &manifest.recordings[trials + window.trial];
            let number = index as u64 - entry.first_window;
            assert_eq!(window.start_sample, entry.start_sample + 150 * number as usize);
            trials_of_windows.push(window.trial);
            index += 1;
        })
        .unwrap();
        assert!(trials_of_windows.is_sorted());
        assert_eq!(trials_of_windows.last(), Some(&(cut.trials.len() - 1)));
        trials += cut.trials.len();
        skipped.extend(cut.skipped);
    }
    assert_eq!((index, trials), (stored.len(), manifest.recordings.len()));
    assert_eq!(skipped, manifest.skipped);
}

#[test]
fn a_data_set_whose_parts_do_not_fit_is_refused_by_name() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 1500), (0, 4, 1500)]);
    let settings = DatasetSettings {
        channels: vec![Channel::Index(0), Channel::Index(1)],
        ..DatasetSettings::default()
    };
    let out = temporary.path().join("out");
    build(&settings, &[folder], &out).unwrap();
    let refused = || StoredDataset::open(&out).map(|_| ()).unwrap_err().to_string();

    let labels = fs::read(out.join("labels.npy")).unwrap();
    let mut unknown = labels.clone();
    *unknown.last_mut().unwrap() = 6;
    fs::write(out.join("labels.npy"), &unknown).unwrap();
    assert!(refused().contains("labels.npy: window") && refused().contains("label 6"), "{}", refused());
    fs::copy(out.join("windows.npy"), out.join("labels.npy")).unwrap();
    assert!(refused().contains("labels.npy: it holds values of type <f4"), "{}", refused());
    fs::write(out.join("labels.npy"), &labels).unwrap();
    fs::write(out.join("manifest.json"), "{}").unwrap();
    assert!(refused().contains("manifest.json: is damaged"), "{}", refused());
    fs::remove_file(out.join("manifest.json")).unwrap();
    assert!(refused().contains("tendon dataset build"), "{}", refused());
}

#[test]
fn the_windows_of_a_data_set_are_those_of_the_live_chain() {
    let Some(three_dc) = three_dc() else { return };
    let folder = three_dc.join("Participant1/train/EMG");
    let temporary = tempfile::tempdir().unwrap();
    let emg = temporary.path().join("Participant1/train/EMG");
    fs::create_dir_all(&emg).unwrap();
    for gesture in 0..3 {
        let name = format!("3dc_EMG_gesture_0_{gesture}.txt");
        fs::copy(folder.join(&name), emg.join(&name)).unwrap();
    }
    let settings = DatasetSettings::default();
    let out = temporary.path().join("out");
    let manifest = build(&settings, std::slice::from_ref(&emg), &out).unwrap();
    let bytes = npy_rows(&out.join("windows.npy"), "<f4", &format!("{}, 4, 600,", manifest.windows));
    let windows: Vec<f32> =
        bytes.chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();

    // Live: blocks of 10 through the chain with a window at every sample.
    let recording = RecordingSettings { channels: settings.channels, ..RecordingSettings::default() };
    let mut stream = ReplayStream::open(&emg, &recording, 2000.0, 10).unwrap();
    let signal = tendon_signal::SignalSettings {
        windows: tendon_signal::WindowSettings { window_samples: 600, increment_samples: 1 },
        ..Default::default()
    };
    let mut chain = tendon_signal::SignalChain::new(&signal, 4, 2000.0).unwrap();
    let mut starts = std::collections::HashMap::new();
    let mut file_start = 0;
    for file in &manifest.recordings {
        let start = file_start + file.start_sample;
        starts.extend((0..file.windows as usize).map(|n| (start + 150 * n, file.first_window as usize + n)));
        file_start += file.samples;
    }
    let (mut block, mut window, mut compared) = ([0.0; 40], [0.0; 2400], 0);
    while stream.next_block(&mut block).unwrap().is_some() {
        let Ok(_) = chain.push_block(&block, |chain, live, _| {
            if let Some(index) = starts.get(&(live.first_sample as usize)) {
                chain.write_window(&mut window);
                assert!(windows[index * 2400..][..2400] == window, "window {index} differs");
                compared += 1;
            }
            Ok::<(), std::convert::Infallible>(())
        });
    }
    assert_eq!(compared, manifest.windows);
    assert!(compared > 100, "{compared} windows");
}

#[test]
fn a_data_set_says_why_it_cannot_be_built() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = write_three_dc(temporary.path(), &[(0, 0, 100)]);
    let out = temporary.path().join("out");
    let message = |settings: &DatasetSettings, folder: &Path| {
        build(settings, &[folder.to_owned()], &out).unwrap_err().to_string()
    };
    let two = DatasetSettings { channels: vec![Channel::Index(0)], ..Default::default() };
    assert!(message(&two, &folder).contains("a window has 600"));
    let default = DatasetSettings::default();
    assert!(message(&default, &folder).contains("there is no channel 3: the file has 2"));
    assert!(message(&default, &folder).ends_with("choose among them with --channels"));
    let empty = temporary.path().join("empty");
    fs::create_dir(&empty).unwrap();
    assert!(message(&two, &empty).contains("ParticipantP/train/EMG"));
    // What lies below a folder is found.
    assert!(message(&two, temporary.path()).contains("a window has 600"));
    let no_rate = DatasetSettings { sample_rate_hz: 0.0, ..Default::default() };
    assert!(message(&no_rate, &folder).contains("sample_rate_hz = 0"));
    assert!(!out.join("manifest.json").exists());
}

#[test]
fn a_trial_ends_where_samples_are_missing() {
    let folder = tempfile::tempdir().unwrap();
    // Half a second is missing in the middle, and a sample further on.
    let row = |row: usize| {
        let sample = if row == 5000 { "NULL".to_owned() } else { (row * 7919 % 101).to_string() };
        format!("{:.4},{sample}\n", (row + if row < 3000 { 0 } else { 1000 }) as f64 / 2000.0)
    };
    let rows: String = (0..8000).map(row).collect();
    fs::write(folder.path().join("emg.csv"), format!("Time,EMG\n{rows}")).unwrap();
    fs::write(folder.path().join("labels.csv"), "file,person,repetition,gesture\nemg.csv,1,0,rest\n")
        .unwrap();
    let settings = DatasetSettings { channels: vec!["EMG".into()], ..DatasetSettings::default() };
    let found = dataset::list(&settings, &[folder.path().to_owned()]).unwrap();
    let cut = dataset::cut(&settings, &found.recordings[0], &mut |_| {}).unwrap();
    let trials: Vec<_> = cut.trials.iter().map(|trial| (trial.first_sample, trial.samples)).collect();
    assert_eq!(trials, [(0, 3000), (4000, 2000), (6001, 2999)]);
    assert!(
        cut.notices.iter().any(|notice| notice.contains("1000 samples are missing in 1 place")),
        "{cut:?}"
    );
    assert!(cut.notices.iter().any(|notice| notice.contains("1 line has no sample")), "{cut:?}");
}
