//! Building data sets: every layout, any number of threads, interruptions, and the split.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, as tests, may fail and print"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tendon_dataset::{
    self as dataset, BuildSettings, DatasetError, DatasetSettings, Layout, Manifest, Progress, Split,
    SplitError, StoredDataset,
};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_recordings::{Channel, RecordedSession, RecordedTrial, Recorder, SkippedKind};
use tendon_signal::WindowSettings;

/// People of a data set that counts them.
fn numbered(people: &[u16]) -> Vec<PersonId> {
    people.iter().copied().map(PersonId::Number).collect()
}

/// Small windows of two channels, at the rate of 3DC.
fn settings() -> DatasetSettings {
    DatasetSettings {
        channels: vec![Channel::Index(0), Channel::Index(1)],
        sample_rate_hz: 1000.0,
        windows: WindowSettings { window_samples: 100, increment_samples: 25 },
        ..DatasetSettings::default()
    }
}

fn build(
    settings: &DatasetSettings,
    building: &BuildSettings,
    path: &Path,
    out: &Path,
) -> Result<Manifest, DatasetError> {
    let building = BuildSettings { replaces: true, ..building.clone() };
    dataset::build(settings, &building, &[path.to_owned()], out, &mut |_| ControlFlow::Continue(()))
}

/// Two channels of something like noise, another one for each seed.
fn noise(seed: usize, samples: usize) -> impl Iterator<Item = [i32; 2]> {
    let mut state = seed as u64 * 7919 + 1;
    let mut next = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as i32 % 2000 - 1000
    };
    (0..samples).map(move |_| [next(), next()])
}

fn write_table(path: &Path, seed: usize, samples: usize) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let lines: String = noise(seed, samples).map(|[first, second]| format!("{first},{second}\n")).collect();
    fs::write(path, lines).unwrap();
}

/// The same with a column of labels behind the channels.
fn write_labelled_table(path: &Path, seed: usize, samples: usize, label: impl Fn(usize) -> &'static str) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_table(path, seed, samples);
    let text = fs::read_to_string(path).unwrap();
    let lines = text.lines().enumerate().map(|(row, line)| format!("{line},{}\n", label(row)));
    let columns = text.lines().next().unwrap().split(',').count();
    let names: String = (0..columns).map(|column| format!("EMG {column},")).collect();
    fs::write(path, format!("{names}done\n{}", lines.collect::<String>())).unwrap();
}

/// 3DC recordings of `people`: two sessions of two repetitions of rest, two of our gestures and one that is not.
fn write_three_dc(folder: &Path, people: &[u16]) {
    for &person in people {
        for (session, name) in ["train", "test"].into_iter().enumerate() {
            for repetition in 0..2 {
                for gesture in [0, 2, 5, 7] {
                    let file =
                        format!("Participant{person}/{name}/EMG/3dc_EMG_gesture_{repetition}_{gesture}.txt");
                    let seed = usize::from(person) * 1000 + session * 100 + repetition * 20 + gesture;
                    write_table(&folder.join(file), seed, 800 + 10 * gesture);
                }
            }
        }
    }
    if let [_, second, ..] = people {
        let emg = folder.join(format!("Participant{second}/train/EMG"));
        // Too short for a window, empty, broken: what real recordings have.
        write_table(&emg.join("3dc_EMG_gesture_0_7.txt"), 1, 30);
        fs::write(emg.join("3dc_EMG_gesture_1_2.txt"), "").unwrap();
    }
}

/// All files of a data set, by name.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fs::read_dir(folder)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            (path.file_name().unwrap().to_str().unwrap().to_owned(), fs::read(&path).unwrap())
        })
        .collect()
}

fn assert_same(first: &BTreeMap<String, Vec<u8>>, second: &BTreeMap<String, Vec<u8>>, what: &str) {
    assert!(first.keys().eq(second.keys()), "{what}: {:?} {:?}", first.keys(), second.keys());
    for (name, content) in first {
        assert!(content == &second[name], "{what}: {name} differs");
    }
}

/// The folder of the 3DC recordings, if it is here.
fn real_three_dc() -> Option<PathBuf> {
    let data = match std::env::var_os("TENDON_SHARED") {
        Some(shared) => PathBuf::from(shared).join("data"),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
    };
    let folder = data.join("3dc");
    if !folder.is_dir() {
        println!("skipped: recordings not found");
        return None;
    }
    Some(folder)
}

#[test]
fn the_data_set_does_not_depend_on_the_number_of_threads() {
    let temporary = tempfile::tempdir().unwrap();
    let recordings = temporary.path().join("recordings");
    write_three_dc(&recordings, &[1, 2, 3]);
    let out = |threads: usize| {
        let out = temporary.path().join(format!("{threads}"));
        let building = BuildSettings { test_people: numbered(&[3]), threads, ..BuildSettings::default() };
        build(&settings(), &building, &recordings, &out).unwrap();
        contents(&out)
    };
    let one = out(1);
    assert_eq!(one.len(), 8);
    for threads in [2, 3, 7] {
        assert_same(&one, &out(threads), &format!("{threads} threads"));
    }
}

/// A folder of recordings, and what a build of it gives that nobody interrupts.
struct Whole {
    temporary: TempDir,
    building: BuildSettings,
    contents: BTreeMap<String, Vec<u8>>,
}

impl Whole {
    fn new() -> Whole {
        let temporary = tempfile::tempdir().unwrap();
        write_three_dc(&temporary.path().join("recordings"), &[1, 2, 3]);
        let building = BuildSettings {
            test_people: numbered(&[2]),
            threads: 2,
            seed: 5,
            replaces: true,
            ..BuildSettings::default()
        };
        let out = temporary.path().join("whole");
        build(&settings(), &building, &temporary.path().join("recordings"), &out).unwrap();
        Whole { building, contents: contents(&out), temporary }
    }

    fn recordings(&self) -> PathBuf {
        self.temporary.path().join("recordings")
    }

    /// A build that is broken off after so many recordings, where nothing stood.
    fn interrupted(&self, recordings: usize) -> PathBuf {
        let out = self.temporary.path().join(format!("interrupted-{recordings}"));
        self.interrupt(recordings, &out);
        out
    }

    fn interrupt(&self, recordings: usize, out: &Path) {
        let mut progress = |step: Progress<'_>| match step {
            Progress::Begun { resumed, .. } if resumed >= recordings => ControlFlow::Break(()),
            Progress::Recording { done, .. } if done >= recordings => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        };
        let error = dataset::build(&settings(), &self.building, &[self.recordings()], out, &mut progress)
            .unwrap_err();
        assert!(matches!(error, DatasetError::Interrupted { .. }), "{error}");
    }

    /// Builds again; how many recordings were there already, and whether an unfinished build was of something else.
    fn build_again(&self, out: &Path, settings: &DatasetSettings) -> (usize, bool) {
        let mut begun = None;
        let mut progress = |step: Progress<'_>| {
            if let Progress::Begun { resumed, is_other, .. } = step {
                begun = Some((resumed, is_other));
            }
            ControlFlow::Continue(())
        };
        dataset::build(settings, &self.building, &[self.recordings()], out, &mut progress).unwrap();
        begun.unwrap()
    }
}

/// Where the data set for `out` is built.
fn unfinished(out: &Path) -> PathBuf {
    out.with_extension("unfinished")
}

#[test]
fn a_build_that_was_interrupted_goes_on_and_gives_the_same() {
    let whole = Whole::new();
    for recordings in 0..=12 {
        let out = whole.interrupted(recordings);
        assert_eq!(whole.build_again(&out, &settings()), (recordings, false));
        assert_same(&whole.contents, &contents(&out), &format!("after {recordings} recordings"));
    }
    // Again and again.
    let out = whole.temporary.path().join("often");
    for recordings in [1, 4, 4, 9] {
        whole.interrupt(recordings, &out);
    }
    assert_eq!(whole.build_again(&out, &settings()), (9, false));
    assert_same(&whole.contents, &contents(&out), "often");
    // A complete one is built anew.
    assert_eq!(whole.build_again(&out, &settings()), (0, false));
    assert_same(&whole.contents, &contents(&out), "complete");
}

#[test]
fn a_finished_data_set_stays_until_another_is_complete_and_is_replaced_only_when_asked() {
    let whole = Whole::new();
    let out = whole.temporary.path().join("whole");
    let kept = BuildSettings { replaces: false, ..whole.building.clone() };
    let mut silent = |_: Progress<'_>| ControlFlow::Continue(());
    let refused = dataset::build(&settings(), &kept, &[whole.recordings()], &out, &mut silent);
    let refused = refused.unwrap_err().to_string();
    for part in
        ["whole holds a finished data set (people 1, 2, 3; ", " windows of flexion, grip, rest)", "--force"]
    {
        assert!(refused.contains(part), "`{part}` is not in {refused}");
    }
    // Broken off, then refused at the end: nobody is left to train on.
    whole.interrupt(7, &out);
    assert_same(&whole.contents, &contents(&out), "after an interruption");
    let all_sessions = vec!["train".to_owned(), "test".to_owned()];
    let nothing = BuildSettings { test_sessions: all_sessions, ..whole.building.clone() };
    let refused = build(&settings(), &nothing, &whole.recordings(), &out).unwrap_err();
    assert!(matches!(refused, DatasetError::NothingToTrain { .. }), "{refused}");
    assert_same(&whole.contents, &contents(&out), "after a build that failed");
    let other = DatasetSettings { fallback_ms: 300.0, ..settings() };
    build(&other, &whole.building, &whole.recordings(), &out).unwrap();
    assert_eq!(StoredDataset::open(&out).unwrap().manifest().settings, other);
    assert!(!unfinished(&out).exists());
}

#[test]
fn a_data_set_names_its_classes_its_channels_and_its_unit_and_those_of_earlier_versions_are_read() {
    let whole = Whole::new();
    let out = whole.temporary.path().join("whole");
    let manifest = StoredDataset::open(&out).unwrap().manifest().clone();
    assert_eq!(manifest.classes, ["rest", "extension", "flexion", "ulnar", "radial", "grip"]);
    assert_eq!(
        (manifest.channel_names, manifest.unit.as_str()),
        (vec!["0".into(), "1".into()], "adc_counts")
    );
    let path = out.join("manifest.json");
    let mut json: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    for key in ["classes", "channel_names", "unit"] {
        json.as_object_mut().unwrap().remove(key).unwrap();
    }
    fs::write(&path, json.to_string()).unwrap();
    let dataset = StoredDataset::open(&out).unwrap();
    assert!(dataset.manifest().classes.is_empty() && dataset.manifest().unit.is_empty());
}

#[test]
fn what_was_damaged_meanwhile_is_built_anew() {
    let whole = Whole::new();
    let damaged = |name: &str, change: &dyn Fn(&mut Vec<u8>)| {
        let out = whole.interrupted(8);
        let path = unfinished(&out).join(name);
        let mut bytes = fs::read(&path).unwrap();
        change(&mut bytes);
        fs::write(&path, bytes).unwrap();
        let (resumed, _) = whole.build_again(&out, &settings());
        assert_same(&whole.contents, &contents(&out), name);
        resumed
    };
    let journal_bytes = fs::read(unfinished(&whole.interrupted(8)).join("progress.jsonl")).unwrap().len();
    for cut in [1, 50, 800, journal_bytes - 10, journal_bytes] {
        let resumed = damaged("progress.jsonl", &|bytes| bytes.truncate(bytes.len() - cut));
        assert!(resumed < 8, "{cut} bytes less: {resumed}");
    }
    // A character in the middle of the last line; then one in the first.
    assert_eq!(damaged("progress.jsonl", &|bytes| *bytes.iter_mut().nth_back(40).unwrap() ^= 1), 7);
    assert_eq!(damaged("progress.jsonl", &|bytes| bytes[30] ^= 1), 0);
    assert_eq!(damaged("progress.jsonl", &|bytes| bytes.extend(b"what is this\n")), 8);
    // Windows that are not there, not as they were, or more than there should be.
    assert_eq!(damaged("windows.npy", &|bytes| bytes.truncate(bytes.len() - 1)), 7);
    assert_eq!(damaged("windows.npy", &|bytes| bytes.truncate(100)), 0);
    assert_eq!(damaged("windows.npy", &|bytes| *bytes.last_mut().unwrap() ^= 1), 7);
    assert_eq!(damaged("windows.npy", &|bytes| bytes[1000] ^= 1), 0);
    assert_eq!(damaged("windows.npy", &|bytes| bytes.extend([7; 5000])), 8);
    assert_eq!(damaged("windows.npy", &|bytes| bytes[..100].fill(0)), 8);
}

#[test]
fn other_settings_or_recordings_begin_anew_and_say_so() {
    let whole = Whole::new();
    let out = whole.interrupted(5);
    let other = DatasetSettings { fallback_ms: 300.0, ..settings() };
    assert_eq!(whole.build_again(&out, &other), (0, true));

    let out = whole.interrupted(5);
    let file = whole.recordings().join("Participant1/train/EMG/3dc_EMG_gesture_0_2.txt");
    write_table(&file, 77, 900);
    assert_eq!(whole.build_again(&out, &settings()), (0, true));
    let from_scratch = whole.temporary.path().join("from scratch");
    build(&settings(), &whole.building, &whole.recordings(), &from_scratch).unwrap();
    assert_same(&contents(&from_scratch), &contents(&out), "changed recording");
}

#[test]
fn two_builds_never_write_to_one_folder() {
    let whole = Whole::new();
    let out = whole.temporary.path().join("shared");
    let mut messages = Vec::new();
    let mut progress = |_: Progress<'_>| {
        let second = build(&settings(), &whole.building, &whole.recordings(), &out);
        messages.push(second.unwrap_err().to_string());
        ControlFlow::Break(())
    };
    dataset::build(&settings(), &whole.building, &[whole.recordings()], &out, &mut progress).unwrap_err();
    assert!(messages[0].contains("another build is writing to"), "{messages:?}");
}

/// What is wrong with the split of a data set: people, or samples, on both sides of the test.
fn leaks(stored: &StoredDataset, splits: &[Split]) -> Vec<String> {
    let mut leaks = Vec::new();
    let mut people: BTreeMap<PersonId, BTreeSet<bool>> = BTreeMap::new();
    // Of each file, which samples are on which side.
    let mut spans: BTreeMap<&Path, Vec<(u64, u64, bool)>> = BTreeMap::new();
    let manifest = stored.manifest();
    let windows = &manifest.settings.windows;
    for (index, &split) in splits.iter().enumerate() {
        let is_test = split == Split::Test;
        people.entry(stored.person(index)).or_default().insert(is_test);
        let entry = &manifest.recordings[stored.recording(index) as usize];
        let number = index as u64 - entry.first_window;
        let start =
            entry.first_sample + entry.start_sample as u64 + number * windows.increment_samples as u64;
        spans.entry(&entry.file).or_default().push((start, start + windows.window_samples as u64, is_test));
    }
    leaks.extend(
        people.iter().filter(|(_, sides)| sides.len() > 1).map(|(person, _)| format!("person {person}")),
    );
    for (file, mut spans) in spans {
        spans.sort_unstable();
        for pair in spans.windows(2) {
            if pair[0].2 != pair[1].2 && pair[0].1 > pair[1].0 {
                leaks.push(format!("{}, sample {}", file.display(), pair[1].0));
            }
        }
    }
    leaks
}

/// Checks split and statistics of a data set against what they should be.
fn check_split(out: &Path, test_people: &[PersonId]) {
    let stored = StoredDataset::open(out).unwrap();
    let manifest = stored.manifest();
    let splits: Vec<Split> = (0..stored.len()).map(|index| stored.split(index)).collect();
    assert_eq!(leaks(&stored, &splits), [] as [&str; 0]);
    for (index, &split) in splits.iter().enumerate() {
        assert_eq!(split == Split::Test, test_people.contains(&stored.person(index)), "window {index}");
    }
    // A leak is found: one window of somebody who is held out, its neighbours still being held out.
    let held_out = splits.iter().position(|&split| split == Split::Test).unwrap();
    let mut planted = splits.clone();
    planted[held_out] = Split::Training;
    let found = leaks(&stored, &planted);
    assert!(found.iter().any(|leak| leak.starts_with("person")), "{found:?}");
    assert!(found.iter().any(|leak| leak.contains(", sample ")), "{found:?}");

    let count = |split: Split| splits.iter().filter(|&&other| other == split).count() as u64;
    let counted = manifest.split.windows;
    assert_eq!(
        [counted.train, counted.validation, counted.test],
        [count(Split::Training), count(Split::Validation), count(Split::Test)]
    );
    assert_eq!(manifest.split.test_people, test_people);
    let (channels, samples) = (manifest.settings.channels.len(), manifest.settings.windows.window_samples);
    let mut all = vec![(0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64); channels];
    for gesture in Gesture::PAPER {
        let of_gesture = |split: Split| {
            (0..stored.len())
                .filter(|&index| stored.gesture(index) == gesture && splits[index] == split)
                .count()
        };
        let (training, validation) = (of_gesture(Split::Training), of_gesture(Split::Validation));
        assert_eq!(validation, (0.2 * (training + validation) as f64).round() as usize, "{gesture:?}");
        let Some(statistics) = manifest.training_statistics.per_gesture.get(gesture.name()) else {
            assert_eq!(training, 0);
            continue;
        };
        assert_eq!(statistics.windows, training as u64);
        for (channel, all) in all.iter_mut().enumerate() {
            let (mut sum, mut magnitude, mut squares) = (0.0, 0.0, 0.0);
            for index in (0..stored.len()).filter(|&index| splits[index] == Split::Training) {
                if stored.gesture(index) != gesture {
                    continue;
                }
                for &sample in &stored.window(index)[channel * samples..][..samples] {
                    sum += f64::from(sample);
                    magnitude += f64::from(sample).abs();
                    squares += f64::from(sample).powi(2);
                }
            }
            // The samples are around 0: their sum is nearly nothing, and is compared with what was summed.
            assert!((statistics.sum[channel] - sum).abs() <= 1e-9 * magnitude);
            assert!((statistics.sum_of_squares[channel] - squares).abs() <= 1e-9 * squares);
            all.0 += sum;
            all.1 += magnitude;
            all.2 += squares;
            all.3 += (training * samples) as f64;
        }
    }
    for (channel, (sum, magnitude, squares, count)) in all.into_iter().enumerate() {
        let (mean, scale) = (sum / count, magnitude / count);
        let sd = (squares / count - mean * mean).sqrt();
        assert!((manifest.training_statistics.channel_mean[channel] - mean).abs() <= 1e-9 * scale);
        assert!((manifest.training_statistics.channel_sd[channel] - sd).abs() <= 1e-9 * sd);
    }
}

#[test]
fn nobody_is_on_both_sides_of_the_test() {
    let temporary = tempfile::tempdir().unwrap();
    write_three_dc(&temporary.path().join("recordings"), &[1, 2, 3, 4]);
    for test_people in [&[3][..], &[1, 4], &[1, 2, 4]].map(numbered) {
        let out = temporary.path().join("out");
        let building = BuildSettings { test_people: test_people.to_vec(), ..BuildSettings::default() };
        build(&settings(), &building, &temporary.path().join("recordings"), &out).unwrap();
        check_split(&out, &test_people);
    }
}

#[test]
fn nobody_of_the_real_people_is_on_both_sides_of_the_test() {
    let Some(three_dc) = real_three_dc() else { return };
    let temporary = tempfile::tempdir().unwrap();
    let people = ["Participant1", "Participant13", "Participant14", "Participant22"];
    let paths: Vec<PathBuf> = people.iter().map(|person| three_dc.join(person)).collect();
    // Few windows, for a test that is built without all optimisation.
    let windows = WindowSettings { window_samples: 600, increment_samples: 450 };
    let settings = DatasetSettings { windows, ..DatasetSettings::default() };
    let building = BuildSettings { test_people: numbered(&[13, 14]), ..BuildSettings::default() };
    let out = temporary.path().join("out");
    let mut silent = |_: Progress<'_>| ControlFlow::Continue(());
    let manifest = dataset::build(&settings, &building, &paths, &out, &mut silent).unwrap();
    assert_eq!(manifest.split.train_people, [1, 22]);
    check_split(&out, &numbered(&[13, 14]));

    let divided = BuildSettings { test_people: numbered(&[14]), replaces: true, ..BuildSettings::default() };
    let error = dataset::build(&settings, &divided, &paths, &out, &mut silent).unwrap_err();
    assert!(matches!(error, DatasetError::Split(SplitError::TwinsDivided { .. })), "{error}");
    // Where only one of the two is there, nothing is shared.
    let paths = [three_dc.join("Participant14"), three_dc.join("Participant1")];
    dataset::build(&settings, &divided, &paths, &out, &mut silent).unwrap();
}

#[test]
fn who_is_held_out_must_be_there_and_not_be_everybody() {
    let temporary = tempfile::tempdir().unwrap();
    write_three_dc(temporary.path(), &[1, 2]);
    let message = |test_people: &[u16]| {
        let building = BuildSettings { test_people: numbered(test_people), ..BuildSettings::default() };
        build(&settings(), &building, temporary.path(), &temporary.path().join("out"))
            .unwrap_err()
            .to_string()
    };
    assert_eq!(message(&[1, 9]), "there is no person 9 to hold out: choose among 1, 2");
    assert_eq!(message(&[2, 1]), "all people (1, 2) are held out: leave at least one to train on");
}

#[test]
fn a_session_that_is_held_out_is_said_to_be_one_of_people_trained_on() {
    let temporary = tempfile::tempdir().unwrap();
    let recordings = temporary.path().join("recordings");
    fs::create_dir(&recordings).unwrap();
    let table = (0..4000).map(|sample| format!("{0},{0},{0},{0}\n", sample * 37 % 101)).collect::<String>();
    for day in ["monday", "tuesday"] {
        fs::write(recordings.join(format!("{day}.csv")), &table).unwrap();
    }
    let labels =
        "file,person,session,repetition,gesture\nmonday.csv,1,monday,0,grip\ntuesday.csv,1,tuesday,0,grip\n";
    fs::write(recordings.join("labels.csv"), labels).unwrap();
    let settings = DatasetSettings {
        channels: (0..4).map(Channel::Index).collect(),
        recording_rate_hz: Some(1000.0),
        ..DatasetSettings::default()
    };
    let out = temporary.path().join("out");
    let build_without = |sessions: &[&str]| {
        let test_sessions = sessions.iter().map(|session| (*session).to_owned()).collect();
        let building = BuildSettings { test_sessions, ..BuildSettings::default() };
        build(&settings, &building, &recordings, &out)
    };
    let manifest = build_without(&["tuesday"]).unwrap();
    assert_eq!(manifest.split.held_out, "session tuesday of people trained on");
    assert_eq!((&manifest.split.train_people, manifest.split.test_people.len()), (&numbered(&[1]), 0));
    let stored = StoredDataset::open(&out).unwrap();
    for index in 0..stored.len() {
        let session = &manifest.recordings[stored.recording(index) as usize].session;
        assert_eq!(stored.split(index) == Split::Test, session == "tuesday", "window {index}");
    }
    assert!(manifest.split.windows.test > 0 && manifest.split.windows.train > 0);
    let message = |sessions: &[&str]| build_without(sessions).unwrap_err().to_string();
    assert_eq!(message(&["friday"]), "there is no session friday to hold out: choose among monday, tuesday");
    assert!(message(&["monday", "tuesday"]).contains("hold out fewer people, sessions"));
}

#[test]
fn a_repetition_that_is_held_out_is_said_to_be_one_of_people_trained_on() {
    let temporary = tempfile::tempdir().unwrap();
    write_three_dc(&temporary.path().join("recordings"), &[1, 2]);
    let out = temporary.path().join("out");
    let build = |test_repetitions: &[u8]| {
        let test_repetitions = test_repetitions.to_vec();
        let building = BuildSettings { test_repetitions, ..BuildSettings::default() };
        build(&settings(), &building, &temporary.path().join("recordings"), &out)
    };
    let manifest = build(&[5, 1]).unwrap();
    assert_eq!(manifest.split.held_out, "repetition 1, 5 of people trained on");
    assert_eq!((&manifest.split.test_repetitions[..], manifest.split.train_people.len()), (&[1, 5][..], 2));
    let stored = StoredDataset::open(&out).unwrap();
    for window in 0..stored.len() {
        let is_held_out = [1, 5].contains(&stored.repetition(window));
        assert_eq!(stored.split(window) == Split::Test, is_held_out, "window {window}");
    }
    let refused = build(&[9]).unwrap_err().to_string();
    assert!(refused.starts_with("there is no repetition 9 to hold out"), "{refused}");
    assert!(refused.ends_with("choose among 0, 1, 4, 5"), "{refused}");
    assert!(matches!(build(&[0, 1, 4, 5]), Err(DatasetError::NothingToTrain { .. })));
}

#[test]
fn the_seed_chooses_the_windows_for_validation() {
    let temporary = tempfile::tempdir().unwrap();
    write_three_dc(&temporary.path().join("recordings"), &[1]);
    let splits = |seed: u64| {
        let out = temporary.path().join(format!("{seed}"));
        let building = BuildSettings { seed, ..BuildSettings::default() };
        build(&settings(), &building, &temporary.path().join("recordings"), &out).unwrap();
        fs::read(out.join("splits.npy")).unwrap()
    };
    assert_eq!(splits(0), splits(0));
    assert_ne!(splits(0), splits(1));
}

#[test]
fn a_data_set_that_says_of_no_window_what_it_is_for_is_refused() {
    let temporary = tempfile::tempdir().unwrap();
    write_three_dc(&temporary.path().join("recordings"), &[1]);
    let out = temporary.path().join("out");
    build(&settings(), &BuildSettings::default(), &temporary.path().join("recordings"), &out).unwrap();
    StoredDataset::open(&out).unwrap();
    fs::remove_file(out.join("splits.npy")).unwrap();
    let message = StoredDataset::open(&out).unwrap_err().to_string();
    assert!(message.contains("splits.npy") && message.contains("rebuild the data set"), "{message}");
}

/// Labels for recordings at 1000 Hz.
fn labelled(temporary: &TempDir, labels: &str) -> Result<Manifest, DatasetError> {
    let folder = temporary.path().join("own");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("labels.csv"), labels).unwrap();
    let settings = DatasetSettings { recording_rate_hz: Some(1000.0), ..settings() };
    build(&settings, &BuildSettings::default(), &folder, &temporary.path().join("out"))
}

#[test]
fn everybody_whom_tendon_recorded_has_their_own_name_in_recordings_of_earlier_versions_too() {
    let temporary = tempfile::tempdir().unwrap();
    let own = temporary.path();
    let channels = ["flexor", "extensor"].map(str::to_owned).to_vec();
    for name in ["anna", "ben", "carl"] {
        let session =
            RecordedSession::new(name.parse().unwrap(), "2026-01-02T03:04:05Z", channels.clone(), 1000.0);
        let mut recorder = Recorder::create(&own.join(name), session).unwrap();
        recorder.push(0, &[1.0; 6000]).unwrap();
        let (asked, repetition) = (String::new(), 0);
        let trial =
            RecordedTrial { gesture: Gesture::REST, repetition, asked, start_sample: 0, end_sample: 3000 };
        assert!(recorder.label(trial).unwrap());
    }
    let labels = own.join("carl/labels.csv");
    let text = fs::read_to_string(&labels).unwrap();
    assert!(text.contains(",carl,"), "{text}");
    fs::write(&labels, text.replace(",carl,", ",1,")).unwrap();
    write_table(&own.join("other/table.csv"), 1, 900);
    fs::write(own.join("other/labels.csv"), "file,person,repetition,gesture\ntable.csv,1,0,rest\n").unwrap();
    let settings = DatasetSettings { recording_rate_hz: Some(1000.0), ..settings() };
    let found = dataset::list(&settings, &[own.to_owned()]).unwrap();
    let people: Vec<String> = found.recordings.iter().map(|recording| recording.person.to_string()).collect();
    assert_eq!(people, ["anna", "ben", "carl", "1"]);
}

#[test]
fn tables_with_labels_are_cut_as_the_labels_say() {
    let temporary = tempfile::tempdir().unwrap();
    let own = temporary.path().join("own");
    write_table(&own.join("anna/monday.csv"), 1, 4000);
    write_table(&own.join("anna/tuesday.csv"), 2, 900);
    write_table(&own.join("ben.csv"), 3, 1200);
    write_table(&own.join("nobody.csv"), 4, 1200);
    let manifest = labelled(
        &temporary,
        "file,person,session,repetition,gesture,start_sample,end_sample\n\
         anna/monday.csv,anna,monday,0,rest,0,1500\n\
         anna/monday.csv,anna,monday,1,Grip,2500,3500\n\
         anna/monday.csv,anna,monday,0,fist,1500,2500\n\
         anna/monday.csv,anna,monday,2,flexion,3700,4100\n\
         \"anna/tuesday.csv\",anna,tuesday,1,extension,,\n\
         ben.csv,2,,0,rest,,\n\
         missing.csv,2,,0,rest,,\n",
    )
    .unwrap();
    let found: Vec<_> = manifest
        .recordings
        .iter()
        .map(|entry| {
            (entry.person, entry.gesture, entry.first_sample, entry.samples, entry.repetition_of_all)
        })
        .collect();
    let anna: PersonId = "anna".parse().unwrap();
    // Monday has repetitions 0 and 1, so that Tuesday's 1 is the person's fourth.
    assert_eq!(
        found,
        [
            (anna, Gesture::REST, 0, 1500, 0),
            (anna, Gesture::GRIP, 2500, 1000, 1),
            (anna, Gesture::EXTENSION, 0, 900, 4),
            (PersonId::Number(2), Gesture::REST, 0, 1200, 0),
        ]
    );
    // In people.npy there are numbers: anna's is one that nobody else has.
    assert_eq!(manifest.named_people, [(1, anna)].into());
    let stored = StoredDataset::open(&temporary.path().join("out")).unwrap();
    assert_eq!([stored.person(0), stored.person(stored.len() - 1)], [anna, PersonId::Number(2)]);
    let skipped: Vec<(String, &str)> = manifest
        .skipped
        .iter()
        .map(|entry| (entry.path.file_name().unwrap().to_str().unwrap().to_owned(), entry.reason.as_str()))
        .collect();
    let reason =
        |name: &str, part: &str| skipped.iter().any(|(file, reason)| file == name && reason.contains(part));
    assert_eq!(skipped.len(), 4, "{skipped:?}");
    assert!(reason("nobody.csv", "has no label for it"), "{skipped:?}");
    assert!(reason("missing.csv", "labels.csv, line 8, names it, but there is no such file"), "{skipped:?}");
    assert!(reason("monday.csv", "gesture `fist` is none of rest, extension"), "{skipped:?}");
    assert!(reason("monday.csv", "it ends at sample 4100, but the file has only 4000"), "{skipped:?}");
    use SkippedKind::{CutOff, NoLabel, NotThere, OtherGesture};
    let kinds = [OtherGesture, NoLabel, NotThere, CutOff].map(|kind| (kind, 1));
    assert_eq!(manifest.skipped_by_kind, kinds.into());

    // The filter runs through the whole file: the same samples, in one piece.
    let whole = temporary.path().join("whole");
    write_table(&whole.join("monday.csv"), 1, 4000);
    fs::write(whole.join("labels.csv"), "file,person,repetition,gesture\nmonday.csv,1,0,rest\n").unwrap();
    let settings = DatasetSettings { recording_rate_hz: Some(1000.0), rest_start_ms: 0.0, ..settings() };
    let out = temporary.path().join("whole-out");
    build(&settings, &BuildSettings::default(), &whole, &out).unwrap();
    let (parts, whole) =
        (StoredDataset::open(&temporary.path().join("out")).unwrap(), StoredDataset::open(&out).unwrap());
    let grip = &manifest.recordings[1];
    let first = grip.first_sample as usize + grip.start_sample;
    let (at, offset) = (first / 25, first % 25);
    let window = parts.window(grip.first_window as usize);
    assert_eq!(window[..100 - offset], whole.window(at)[offset..100]);
    assert_eq!(window[100..200 - offset], whole.window(at)[100 + offset..]);
}

/// EDF+ of two channels at 1000 Hz in uV, as many whole seconds of [`noise`], with annotations `(start_s, duration_s, text)`.
fn write_edf(path: &Path, seed: usize, seconds: usize, annotations: &[(f64, f64, &str)]) {
    const TEXT_BYTES: usize = 80;
    let mut bytes = format!("{:<184}{:<8}{:<44}{seconds:<8}{:<8}{:<4}", 0, 1024, "EDF+C", 1, 3).into_bytes();
    for (values, width) in [
        (["EMG 1", "EMG 2", "EDF Annotations"], 16),
        ([""; 3], 80),
        (["uV", "uV", ""], 8),
        (["-32768"; 3], 8),
        (["32767"; 3], 8),
        (["-32768"; 3], 8),
        (["32767"; 3], 8),
        ([""; 3], 80),
        (["1000", "1000", "40"], 8),
        ([""; 3], 32),
    ] {
        bytes.extend(values.map(|value| format!("{value:<width$}")).concat().into_bytes());
    }
    let samples: Vec<[i32; 2]> = noise(seed, seconds * 1000).collect();
    for (second, samples) in samples.chunks(1000).enumerate() {
        for channel in 0..2 {
            bytes.extend(samples.iter().flat_map(|sample| (sample[channel] as i16).to_le_bytes()));
        }
        let mut text = format!("+{second}\x14\x14\0");
        for (start_s, duration_s, gesture) in
            annotations.iter().filter(|(start_s, ..)| *start_s as usize == second)
        {
            text += &format!("+{start_s}\x15{duration_s}\x14{gesture}\x14\0");
        }
        bytes.extend(text.as_bytes());
        bytes.resize(bytes.len() + TEXT_BYTES - text.len(), 0);
    }
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

#[test]
fn no_window_spans_missing_samples_and_the_rest_of_a_trial_is_one_of_its_own() {
    let temporary = tempfile::tempdir().unwrap();
    let file = temporary.path().join("recordings/anna.edf");
    write_edf(&file, 1, 5, &[(0.5, 1.5, "rest"), (2.25, 4.0, "grip")]);
    // Two seconds are missing before the fourth record.
    let mut bytes = fs::read(&file).unwrap();
    for (old, new) in
        [(&b"EDF+C"[..], &b"EDF+D"[..]), (b"+3\x14\x14", b"+5\x14\x14"), (b"+4\x14\x14", b"+6\x14\x14")]
    {
        let start = bytes.windows(old.len()).position(|window| window == old).unwrap();
        bytes[start..start + new.len()].copy_from_slice(new);
    }
    fs::write(&file, bytes).unwrap();
    let out = temporary.path().join("out");
    let manifest =
        build(&settings(), &BuildSettings::default(), &temporary.path().join("recordings"), &out).unwrap();
    let trials: Vec<_> = manifest
        .recordings
        .iter()
        .map(|trial| (trial.gesture.to_string(), trial.first_sample, trial.samples, trial.windows))
        .collect();
    // Of each, the first 0.5 s are left out, then 100 samples every 25.
    let expected = [("rest", 500, 1500, 37), ("grip", 2250, 750, 7), ("grip", 5000, 1250, 27)];
    assert_eq!(
        trials,
        expected.map(|(gesture, first, samples, windows)| (gesture.to_owned(), first, samples, windows))
    );
    assert!(manifest.recordings[2].fallback && manifest.skipped.is_empty(), "{manifest:?}");
    // The windows of the rest of the trial are those of the samples after the gap: the filter continued.
    let whole = temporary.path().join("whole/anna.edf");
    write_edf(&whole, 1, 5, &[(3.0, 1.25, "grip")]);
    let out_of_whole = temporary.path().join("whole-out");
    build(&settings(), &BuildSettings::default(), &temporary.path().join("whole"), &out_of_whole).unwrap();
    let [gap, whole] = [&out, &out_of_whole].map(|out| StoredDataset::open(out).unwrap());
    assert_eq!(gap.window(44), whole.window(0));
}

#[test]
fn annotations_say_what_labels_would() {
    let temporary = tempfile::tempdir().unwrap();
    let (own, tables, named) =
        (temporary.path().join("own"), temporary.path().join("tables"), temporary.path().join("named"));
    let annotations =
        [(0.5, 1.5, "rest"), (2.25, 1.25, "Grip"), (4.0, 1.0, "extension"), (4.5, 0.0, "good one")];
    write_edf(&own.join("all/sub-anna_ses-1_task-grasp_emg.edf"), 1, 5, &annotations);
    write_edf(&own.join("ben/later.edf"), 2, 5, &annotations);
    write_edf(&own.join("ben/nothing.edf"), 2, 5, &[]);
    let labels = |file: &str, person: &str, session: &str| {
        ["rest,500,2000", "grip,2250,3500", "extension,4000,5000"]
            .map(|trial| format!("{file},{person},{session},0,{trial}\n"))
            .concat()
    };
    let header = "file,person,session,repetition,gesture,start_sample,end_sample\n";
    for (folder, ending) in [(&tables, "csv"), (&named, "edf")] {
        let lines = labels(&format!("a.{ending}"), "anna", "1") + &labels(&format!("b.{ending}"), "ben", "1");
        fs::create_dir_all(folder).unwrap();
        fs::write(folder.join("labels.csv"), header.to_owned() + &lines).unwrap();
    }
    for (name, seed) in [("a", 1), ("b", 2)] {
        write_table(&tables.join(format!("{name}.csv")), seed, 5000);
        write_edf(&named.join(format!("{name}.edf")), seed, 5, &[(0.0, 5.0, "ulnar")]);
    }
    let built = |folder: &Path, recording_rate_hz| {
        let settings = DatasetSettings { recording_rate_hz, ..settings() };
        let out = folder.with_extension("out");
        let manifest = build(&settings, &BuildSettings::default(), folder, &out).unwrap();
        let stored = StoredDataset::open(&out).unwrap();
        let windows: Vec<f32> = (0..stored.len()).flat_map(|window| stored.window(window).to_vec()).collect();
        let trials: Vec<_> = manifest
            .recordings
            .iter()
            .map(|trial| (trial.person, trial.gesture, trial.first_sample, trial.samples, trial.windows))
            .collect();
        (manifest, windows, trials)
    };
    let (manifest, windows, trials) = built(&own, None);
    assert_eq!(trials.len(), 6);
    let (_, table_windows, table_trials) = built(&tables, Some(1000.0));
    assert_eq!(trials, table_trials);
    assert!(windows == table_windows, "windows of the annotations differ from those of the labels");
    // Where there are labels, these count.
    let (_, named_windows, named_trials) = built(&named, None);
    assert!(named_windows == windows && named_trials == trials);
    // And so does a column of a table.
    let columns = temporary.path().join("columns");
    for (file, seed) in [("all/sub-anna_ses-1_task-grasp_emg.csv", 1), ("ben/later.csv", 2)] {
        write_labelled_table(&columns.join(file), seed, 5000, |row| match row {
            500..2000 => "rest",
            2250..3500 => "Grip",
            4000..5000 => "extension",
            _ => "good one",
        });
    }
    write_labelled_table(&columns.join("ben/nothing.csv"), 2, 5000, |_| "?!");
    fs::write(columns.join("ben/participants.tsv"), "name\tage\nben\t30\n").unwrap();
    let label_column = Some(Channel::from("done"));
    let labelled = DatasetSettings { recording_rate_hz: Some(1000.0), label_column, ..settings() };
    let found = dataset::list(&labelled, std::slice::from_ref(&columns)).unwrap();
    assert_eq!(found.recordings.len(), 2);
    let reasons = found.skipped.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    assert!(found.skipped.len() == 2 && reasons.contains("column `done` names no gesture"), "{reasons}");
    let out = temporary.path().join("columns.out");
    let of_columns = build(&labelled, &BuildSettings::default(), &columns, &out).unwrap();
    let stored = StoredDataset::open(&out).unwrap();
    let column_windows: Vec<f32> =
        (0..stored.len()).flat_map(|window| stored.window(window).to_vec()).collect();
    assert!(column_windows == windows && of_columns.recordings.len() == 6);
    let refused = dataset::list(&labelled, std::slice::from_ref(&tables)).unwrap_err().to_string();
    assert!(refused.contains("--label-column is for tables of your own without a labels.csv"), "{refused}");
    assert_eq!(manifest.recordings[0].session, "ses-1_task-grasp_emg");
    assert_eq!(manifest.skipped.len(), 1, "{:?}", manifest.skipped);
    assert!(manifest.skipped[0].reason.contains("no annotation or marker in it names a gesture"));
    let unit = |folder: &Path| dataset::list(&settings(), &[folder.to_owned()]).unwrap().unit;
    assert_eq!([unit(&own), unit(&named)], ["uV", "uV"]);
    let other_rate = DatasetSettings { recording_rate_hz: Some(2000.0), ..settings() };
    let message =
        build(&other_rate, &BuildSettings::default(), &own.join("all"), &temporary.path().join("x"))
            .unwrap_err()
            .to_string();
    assert!(message.contains("was sampled at 1000 Hz, but sample_rate_hz = 2000"), "{message}");
}

#[test]
fn tables_keep_their_unit_and_those_in_another_are_converted_to_that_of_the_first() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    let table = |name: &str, head: &str, factors: [f64; 2]| {
        let rows = noise(1, 1000).map(|row| {
            let cells =
                row.iter().zip(factors).map(|(value, factor)| (f64::from(*value) * factor).to_string());
            cells.collect::<Vec<_>>().join(",") + "\n"
        });
        fs::write(folder.join(name), head.to_owned() + &rows.collect::<String>()).unwrap();
    };
    table("a.csv", "x,y\nmV,mV\n", [1.0, 1.0]);
    table("b.csv", "x (uV),y (uV)\n", [1e3, 1e3]);
    table("c.csv", "x [mV],y [V]\n", [1.0, 1e-3]);
    table("d.csv", "x,y\n", [1.0, 1.0]);
    table("e.csv", "x,y\nadc_counts,adc_counts\n", [1.0, 1.0]);
    let lines: String = "abcde".chars().map(|name| format!("{name}.csv,1,0,grip\n")).collect();
    fs::write(folder.join("labels.csv"), format!("file,person,repetition,gesture\n{lines}")).unwrap();
    let settings = DatasetSettings { recording_rate_hz: Some(1000.0), ..settings() };
    let found = dataset::list(&settings, &[folder.to_owned()]).unwrap();
    assert_eq!(found.unit, "mV");
    let said: Vec<_> = found.skipped.iter().map(|entry| (entry.kind, entry.to_string())).collect();
    let [(SkippedKind::Notice, converted), (SkippedKind::Other, left_out)] = &said[..] else {
        panic!("{said:?}")
    };
    assert!(converted.contains("b.csv: its samples are in uV and are converted to mV"), "{converted}");
    assert!(left_out.contains("e.csv: its samples are in adc_counts, those of others in mV"), "{left_out}");
    let samples: Vec<Vec<f32>> = found
        .recordings
        .iter()
        .map(|recording| {
            let mut block = vec![0.0; 200];
            recording.stream(&settings, 100).unwrap().next_block(&mut block).unwrap().unwrap();
            block
        })
        .collect();
    assert_eq!(samples.len(), 4);
    for (own, first) in samples.iter().flat_map(|own| own.iter().zip(&samples[0])) {
        assert!((own - first).abs() < 1e-3, "{own} and {first}");
    }
    let manifest = build(&settings, &BuildSettings::default(), folder, &folder.join("out")).unwrap();
    assert_eq!(manifest.unit, "mV");
}

#[test]
fn a_labelled_table_may_begin_with_time_or_another_sensor_and_its_unit_is_that_of_its_emg() {
    let temporary = tempfile::tempdir().unwrap();
    for (place, first) in
        ["Time (s)", "Battery (V)", "Trigger (uV)", "Counter (n)", "Temperature (°C)"].iter().enumerate()
    {
        let folder = temporary.path().join(format!("anna-{place}"));
        fs::create_dir(&folder).unwrap();
        let row = |(row, samples): (usize, [i32; 2])| {
            let label = if row < 1500 { "rest" } else { "😀" };
            let first = if place == 1 { 3.7 } else { row as f64 / 1000.0 };
            format!("{first},{},{},{label}\n", samples[0], samples[1])
        };
        let rows: String = noise(1, 3000).enumerate().map(row).collect();
        fs::write(folder.join("a.csv"), format!("{first},EMG 1 (mV),EMG 2 (mV),label\n{rows}")).unwrap();
        let settings = DatasetSettings {
            channels: ["EMG 1", "EMG 2"].map(Channel::from).to_vec(),
            recording_rate_hz: Some(1000.0),
            label_column: Some("label".into()),
            ..settings()
        };
        let found = dataset::list(&settings, std::slice::from_ref(&folder)).unwrap();
        assert_eq!((found.recordings.len(), found.unit.as_str()), (1, "mV"), "{first}");
        let names = found.recordings[0].file_channels(&settings).unwrap();
        assert_eq!(names[1..], ["EMG 1", "EMG 2", "label"].map(Channel::from), "{first}");
        let mut block = vec![0.0; 200];
        found.recordings[0].stream(&settings, 100).unwrap().next_block(&mut block).unwrap().unwrap();
        let expected = noise(1, 1).next().unwrap();
        assert_eq!(block[0], expected[0] as f32, "{first}");
        let [left_out] = &found.skipped[..] else { panic!("{:?}", found.skipped) };
        assert_eq!(left_out.kind, SkippedKind::OtherLabels);
        assert!(left_out.reason.starts_with("left out of column `label`: 1 trial of `😀`: "), "{left_out}");
    }
}

#[test]
fn a_trial_too_long_for_memory_is_listed_and_the_rest_is_used() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("own");
    fs::create_dir(&folder).unwrap();
    let line: String = (0..40).map(|channel| format!("{channel},")).collect::<String>() + "0\n";
    fs::write(folder.join("long.csv"), line.repeat(101_500)).unwrap();
    let labels = "long.csv,1,0,rest,0,100001\nlong.csv,1,1,rest,100001,101500\n";
    fs::write(
        folder.join("labels.csv"),
        format!("file,person,repetition,gesture,start_sample,end_sample\n{labels}"),
    )
    .unwrap();
    let settings = DatasetSettings {
        channels: (0..40).map(Channel::Index).collect(),
        recording_rate_hz: Some(1000.0),
        ..settings()
    };
    let out = temporary.path().join("out");
    let manifest = build(&settings, &BuildSettings::default(), &folder, &out).unwrap();
    assert_eq!(manifest.recordings.len(), 1);
    assert_eq!((manifest.recordings[0].first_sample, manifest.recordings[0].samples), (100_001, 1499));
    let [skipped] = manifest.skipped.as_slice() else { panic!("{:?}", manifest.skipped) };
    let expected =
        "samples 0 to 100001: 100.0 s are too long for a trial, 100.0 s is the most: divide it into several";
    assert_eq!(skipped.reason, expected);
}

#[test]
fn labels_that_cannot_be_used_are_refused_by_line() {
    let temporary = tempfile::tempdir().unwrap();
    let own = temporary.path().join("own");
    write_table(&own.join("a.csv"), 1, 2000);
    write_table(&own.join("b.csv"), 2, 2000);
    let message = |labels: &str| labelled(&temporary, labels).unwrap_err().to_string();
    let header = "file,person,session,repetition,gesture,start_sample,end_sample\n";
    for (labels, part) in [
        ("", "line 1: there is no column `file`"),
        ("file,person,gesture\na.csv,1,rest\n", "line 1: there is no column `repetition`"),
        ("file,person,repetition,gesture,hand\n", "line 1: unknown column `hand`"),
        ("file,file,person,repetition,gesture\n", "line 1: column `file` is there twice"),
        (
            "a.csv,\u{738b},,0,rest,,\n",
            "line 2: person: `\u{738b}` identifies no person: give a whole number of 0 to 65535",
        ),
        ("a.csv,1,,300,rest,,\n", "line 2: repetition = `300`"),
        ("a.csv,1,,0,rest,5,5\n", "line 2: the trial ends"),
        ("a.csv,1,,0,rest,0,9\na.csv,1,,0,grip,8,20\n", "line 3: its trial and that of line 2 share samples"),
        ("a.csv,1,,0,rest,,\na.csv,1,,0,grip,8,20\n", "line 3: its trial and that of line 2 share samples"),
        ("a.csv,1,,0,rest,0,9\na.csv,2,,0,grip,9,20\n", "is of person 2, session 1 here, but of person 1"),
        (",1,,0,rest,,\n", "line 2: names no file"),
        ("a.csv,1,,0,thumb up,,\n", "the first was left out because:"),
        ("a.csv,1,x,200,rest,,\nb.csv,1,y,0,rest,,\n", "counted through all sessions"),
    ] {
        let labels = if part.starts_with("line 1") { labels.to_owned() } else { format!("{header}{labels}") };
        let message = message(&labels);
        assert!(message.contains(part), "{labels}: {message}");
    }
    let without_rate = build(&settings(), &BuildSettings::default(), &own, &temporary.path().join("out"));
    let message = without_rate.unwrap_err().to_string();
    assert!(message.contains("labels.csv") && message.contains("--recording-rate-hz"), "{message}");
}

#[test]
fn a_file_a_trial_is_told_by_its_name() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("trials");
    for (name, seed) in [("P2_C0_G1.csv", 1), ("p1_c4_g0.csv", 2), ("Person1_Cycle0_Gesture7.csv", 3)] {
        write_table(&folder.join("female").join(name), seed, 3000);
    }
    write_table(&folder.join("notes.csv"), 4, 3000);
    let out = temporary.path().join("out");
    let settings = DatasetSettings { sample_rate_hz: 2000.0, ..settings() };
    let manifest = build(&settings, &BuildSettings::default(), &folder, &out).unwrap();
    let found: Vec<_> =
        manifest.recordings.iter().map(|entry| (entry.person, entry.gesture, entry.repetition)).collect();
    let [one, two] = [1, 2].map(PersonId::Number);
    assert_eq!(found, [(one, Gesture::REST, 4), (two, Gesture::EXTENSION, 0)]);
    assert!(manifest.recordings.iter().all(|entry| entry.samples == 3000));
    let reasons: Vec<&str> = manifest.skipped.iter().map(|entry| entry.reason.as_str()).collect();
    assert_eq!(reasons.len(), 2, "{reasons:?}");
    assert!(reasons[0].contains("P<person>_C<cycle>_G<gesture>.csv"), "{reasons:?}");
    assert_eq!(reasons[1], "its gesture is not one of the six");

    write_table(&folder.join("P02_C0_G1.csv"), 1, 3000);
    let message = build(&settings, &BuildSettings::default(), &folder, &out).unwrap_err().to_string();
    assert!(message.starts_with("gesture 1 of cycle 0 of person 2 is in "), "{message}");
}

/// A MAT-file of doubles: `data` as the columns say, and `fs` and `iD`.
fn write_mat(path: &Path, columns: &[Vec<f64>], fs_hz: f64, id: f64) {
    let mut bytes = format!("{:<124}", "MATLAB 5.0 MAT-file").into_bytes();
    bytes.extend(b"\x00\x01IM");
    let mut matrix = |name: &str, columns: &[Vec<f64>]| {
        let mut content = Vec::new();
        let mut element = |kind: u32, data: &[u8]| {
            content.extend(kind.to_le_bytes());
            content.extend((data.len() as u32).to_le_bytes());
            content.extend(data);
            content.resize(content.len().next_multiple_of(8), 0);
        };
        element(6, &[6, 0, 0, 0, 0, 0, 0, 0]);
        let dimensions = [columns[0].len() as i32, columns.len() as i32].map(i32::to_le_bytes);
        element(5, dimensions.as_flattened());
        element(1, name.as_bytes());
        let values: Vec<u8> = columns.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
        element(9, &values);
        bytes.extend(14_u32.to_le_bytes());
        bytes.extend((content.len() as u32).to_le_bytes());
        bytes.extend(content);
    };
    matrix("data", columns);
    matrix("fs", &[vec![fs_hz]]);
    matrix("iD", &[vec![id]]);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_mat_file_a_person_is_cut_by_its_timetable() {
    const RATE_HZ: usize = 250;
    let temporary = tempfile::tempdir().unwrap();
    let raw = temporary.path().join("sEMG-dataset/raw/mat");
    // Noise, and a step that says which second it is.
    let column = |seed: usize, seconds: usize| -> Vec<f64> {
        noise(seed, seconds * RATE_HZ)
            .enumerate()
            .map(|(sample, [value, _])| (sample / RATE_HZ) as f64 + f64::from(value) * 1e-5)
            .collect()
    };
    write_mat(&raw.join("a.mat"), &[column(1, 640), column(2, 640)], RATE_HZ as f64, 12.0);
    // Cut off in cycle 3: 406 s + 30 s … 436 s, the fourth gesture.
    write_mat(&raw.join("subject 7.mat"), &[column(3, 438), column(4, 438)], RATE_HZ as f64, 0.5);
    fs::write(raw.join("b.mat"), "MATLAB 7.3 MAT-file, but cut off").unwrap();
    let out = temporary.path().join("out");
    let settings = DatasetSettings {
        channels: vec![Channel::Index(1)],
        sample_rate_hz: RATE_HZ as f64,
        windows: WindowSettings { window_samples: 250, increment_samples: 125 },
        rest_start_ms: 0.0,
        fallback_ms: 0.0,
        ..settings()
    };
    let raw_settings = DatasetSettings { filter: None, ..settings.clone() };
    let message = |settings: &DatasetSettings, path: &Path| {
        build(settings, &BuildSettings::default(), path, &out).unwrap_err().to_string()
    };
    assert!(message(&raw_settings, &raw).contains("lies in a folder `raw`: leave out --filtered"));
    let manifest = build(&settings, &BuildSettings::default(), &raw, &out).unwrap();
    assert_eq!(
        manifest.windows_per_person.keys().collect::<Vec<_>>(),
        [&PersonId::Number(7), &PersonId::Number(12)]
    );

    // Without a filter the samples tell which second they are of.
    let filtered = temporary.path().join("sEMG-dataset/filtered/mat");
    fs::create_dir_all(&filtered).unwrap();
    fs::copy(raw.join("a.mat"), filtered.join("a.mat")).unwrap();
    assert!(message(&settings, &filtered).contains("lies in a folder `filtered`: give --filtered"));
    let manifest = build(&raw_settings, &BuildSettings::default(), &filtered, &out).unwrap();
    assert_eq!(manifest.recordings.len(), 30);
    assert_eq!(manifest.skipped.len(), 20);
    let stored = StoredDataset::open(&out).unwrap();
    for index in 0..stored.len() {
        let entry = &manifest.recordings[stored.recording(index) as usize];
        let cycle_s = [4, 138, 272, 406, 540][entry.repetition as usize];
        let number = [0, 1, 2, 3, 4, 5].into_iter().find(|&number| {
            let start = (cycle_s + 10 * number) * RATE_HZ;
            start as u64 == entry.first_sample
        });
        let gestures: [Gesture; 6] =
            ["rest", "extension", "flexion", "ulnar", "radial", "grip"].map(|name| name.parse().unwrap());
        assert_eq!(gestures[number.unwrap()], entry.gesture);
        assert_eq!((entry.samples, entry.person), (6 * RATE_HZ, PersonId::Number(12)));
        let window = index - entry.first_window as usize;
        let first = entry.first_sample as usize + entry.start_sample + 125 * window;
        let expected = (first / RATE_HZ) as f32;
        assert!((stored.window(index)[0] - expected).abs() < 0.02, "window {index}");
    }

    // Three cycles and three gestures have ended by then; the fourth and all later trials have not.
    let manifest = {
        let only = temporary.path().join("only");
        fs::create_dir(&only).unwrap();
        fs::copy(raw.join("subject 7.mat"), only.join("subject 7.mat")).unwrap();
        fs::copy(raw.join("b.mat"), only.join("b.mat")).unwrap();
        build(&settings, &BuildSettings::default(), &only, &out).unwrap()
    };
    assert_eq!(manifest.recordings.len() + manifest.skipped.len(), 50 + 1);
    let missing =
        manifest.skipped.iter().filter(|entry| entry.reason.contains("but the file has only 109500")).count();
    assert_eq!((manifest.recordings.len(), missing), (21, 17));
    assert!(manifest.skipped.iter().any(|entry| entry.reason.contains("save -v7")), "{:?}", manifest.skipped);

    assert!(
        message(&settings, &temporary.path().join("sEMG-dataset")).contains("lies in a folder `filtered`")
    );
    fs::copy(raw.join("a.mat"), raw.join("c.mat")).unwrap();
    assert!(message(&settings, &raw).starts_with("person 12 is in "));

    // Of nobody.
    let nobody = temporary.path().join("nobody");
    write_mat(&nobody.join("all.mat"), &[column(1, 2), column(2, 2)], RATE_HZ as f64, 0.5);
    let message = message(&settings, &nobody);
    assert!(message.contains("none of the recordings found can be used"), "{message}");
    assert!(message.contains("neither its variable iD nor a number in its name"), "{message}");
}

/// 3DC as it is published: the movements of the armband lie beside its EMG.
fn write_published_three_dc(folder: &Path, people: &[u16]) {
    write_three_dc(folder, people);
    for (person, session) in people.iter().flat_map(|person| [(person, "train"), (person, "test")]) {
        let imu = folder.join(format!("Participant{person}/{session}/IMU"));
        write_table(&imu.join("3dc_IMU_gesture_0_0.txt"), 1, 50);
    }
}

#[test]
fn the_published_three_dc_is_read_without_the_movements_of_the_armband() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("3dc");
    write_published_three_dc(&folder, &[1, 2]);
    let found = dataset::list(&settings(), std::slice::from_ref(&folder)).unwrap();
    assert_eq!((found.layout, found.recordings.len()), (Layout::ThreeDc, 8));
    assert!(found.recordings.iter().all(|recording| recording.path.ends_with("EMG")));
    let imu = folder.join("Participant1/test/IMU");
    assert_eq!(found.skipped.len(), 4, "{:?}", found.skipped);
    assert_eq!((&found.skipped[0].path, found.skipped[0].kind), (&imu, SkippedKind::OtherFile));
    let message = dataset::list(&settings(), &[imu]).unwrap_err().to_string();
    assert!(message.contains("no recordings found (") && message.contains("it holds no EMG"), "{message}");
}

#[test]
fn links_to_folders_are_followed_once_and_never_in_a_circle() {
    use std::os::unix::fs::symlink;
    let temporary = tempfile::tempdir().unwrap();
    write_published_three_dc(&temporary.path().join("disk"), &[1]);
    let person = temporary.path().join("disk/Participant1");
    let recordings = |folder: &Path| {
        let found = dataset::list(&settings(), &[folder.to_owned()]).unwrap();
        (found.recordings.len(), found.skipped.len())
    };
    let linked = temporary.path().join("linked");
    fs::create_dir(&linked).unwrap();
    symlink(&person, linked.join("Participant1")).unwrap();
    assert_eq!(recordings(&linked), (4, 2));
    // The same folder again by another name, and the way back up.
    symlink(&person, linked.join("again")).unwrap();
    symlink(&linked, linked.join("up")).unwrap();
    symlink("nowhere", linked.join("dangling")).unwrap();
    assert_eq!(recordings(&linked), (4, 2));
    // A name that does not say whose recordings they are.
    let renamed = temporary.path().join("renamed");
    fs::create_dir(&renamed).unwrap();
    symlink(&person, renamed.join("first")).unwrap();
    assert_eq!(recordings(&renamed), (4, 2));
    assert_eq!(recordings(&renamed.join("first")), (4, 2));
}

#[test]
fn recordings_of_several_layouts_or_none_are_refused() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("recordings");
    write_three_dc(&folder, &[1]);
    assert_eq!(dataset::list(&settings(), std::slice::from_ref(&folder)).unwrap().layout, Layout::ThreeDc);
    write_table(&folder.join("P1_C0_G1.csv"), 1, 3000);
    let message = |paths: &[PathBuf]| dataset::list(&settings(), paths).unwrap_err().to_string();
    let several = message(std::slice::from_ref(&folder));
    assert!(several.contains("is of the layout Ozdemir 2022 (a .csv a trial), but"), "{several}");
    assert!(several.contains("of 3DC: build a data set of each"), "{several}");
    fs::remove_file(folder.join("P1_C0_G1.csv")).unwrap();

    let tables = temporary.path().join("tables");
    write_table(&tables.join("a.csv"), 1, 10);
    let none = message(&[folder.clone(), tables.clone()]);
    assert!(
        none.contains("no recordings found") && none.contains("a.csv: its name is not P<person>"),
        "{none}"
    );
    assert!(message(&[temporary.path().join("nowhere")]).contains("cannot open"));

    // Given twice, by other names.
    let twice = [folder.clone(), folder.join("Participant1/../Participant1")];
    let found = dataset::list(&settings(), &twice).unwrap();
    assert_eq!((found.recordings.len(), found.skipped.len()), (4, 2));
    // Two copies.
    write_three_dc(&temporary.path().join("copy"), &[1]);
    let copies = message(&[folder, temporary.path().join("copy")]);
    assert!(copies.contains("session of person 1 is in "), "{copies}");
}
