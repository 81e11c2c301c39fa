//! Files as amplifiers and other programs write them, whole and damaged: nothing panics, and a refusal names the file.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, as tests, may fail and print"
)]

use std::fs;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;
use tendon_dataset::{BuildSettings, DatasetSettings, build};
use tendon_recordings::{Channel, RecordingSettings, check};

/// Files made by `cases/make.py` of the shared folder, if both that and Python are here.
fn cases() -> Option<TempDir> {
    let shared = match std::env::var_os("TENDON_SHARED") {
        Some(shared) => PathBuf::from(shared),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
    };
    let script = shared.join("cases/make.py");
    let folder = tempfile::tempdir().unwrap();
    let made = Command::new("python3").arg(&script).arg(folder.path()).output();
    if script.is_file() && made.is_ok_and(|made| made.status.success()) {
        return Some(folder);
    }
    println!("skipped: cases/make.py or python3 not found");
    None
}

/// All files below `folder`, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() && !path.is_symlink() {
            found.extend(files(&path));
        } else if path.is_file() {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Reads `path` in every way there is; an error must name the file and say something.
fn read_in_every_way(path: &Path, out: &Path) {
    let name = path.file_name().unwrap().to_str().unwrap();
    let says = |error: String| assert!(error.contains(name) && error.len() > name.len() + 20, "{error}");
    let by_number = |numbers: &[usize]| numbers.iter().copied().map(Channel::Index).collect::<Vec<_>>();
    for channels in [by_number(&[0, 1, 2, 3]), by_number(&[4]), vec!["EMG_a".into()]] {
        let settings =
            RecordingSettings { channels, sample_rate_hz: Some(1000.0), ..RecordingSettings::default() };
        if let Err(error) = check(path, &settings) {
            says(error.to_string());
        }
    }
    let settings = DatasetSettings { recording_rate_hz: None, ..DatasetSettings::default() };
    let mut go_on = |_: tendon_dataset::Progress<'_>| ControlFlow::Continue(());
    let building = BuildSettings { replaces: true, ..BuildSettings::default() };
    if let Err(error) = build(&settings, &building, &[path.to_owned()], out, &mut go_on) {
        says(error.to_string());
    }
}

#[test]
fn no_file_that_others_write_makes_the_readers_panic_and_each_refusal_names_it() {
    let Some(folder) = cases() else { return };
    let out = folder.path().join("out");
    let found = files(folder.path());
    assert!(found.len() >= 10, "{found:?}");
    for path in found {
        read_in_every_way(&path, &out);
        // Damaged here and there, the same every time: bytes changed, and the end cut off.
        let whole = fs::read(&path).unwrap();
        let mut random = 1_u64;
        let mut next = |below: usize| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as usize % below
        };
        let damaged = folder.path().join(format!("damaged-{}", path.file_name().unwrap().to_str().unwrap()));
        for _ in 0..12 {
            let mut bytes = whole.clone();
            for _ in 0..3 {
                // The head decides on the layout, so it gets half of the damage.
                let within = if next(2) == 0 { whole.len().min(400) } else { whole.len() };
                bytes[next(within)] = next(256) as u8;
            }
            bytes.truncate(whole.len() - next(whole.len()) * next(2));
            fs::write(&damaged, bytes).unwrap();
            read_in_every_way(&damaged, &out);
        }
        fs::remove_file(damaged).unwrap();
    }
}
