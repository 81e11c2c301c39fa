//! The layouts of the data set of Ozdemir et al. 2022 ("Dataset for multi-channel surface electromyography (sEMG)
//! signals of hand gestures"), the paper's: 40 people, four channels in mV, 2000 Hz.
//!
//! ```text
//! sEMG-dataset/{raw,filtered}/mat/*.mat     a file a person: data (1280000 × 4), fs, iD, …
//! 0 s  4 s            104 s          138 s          272 s          406 s          540 s            640 s
//! |    |── cycle 0 ──|              |── cycle 1 …
//!      |rest  |    |extension |    |…     gesture g begins 10 g s after its cycle and lasts 6 s
//! ```
//! Cut into trials, one a file: `P<person>_C<cycle>_G<gesture>.csv`, see [`trial_of_name`].

use std::fs::File;
use std::path::Path;

use tendon_gesture::Gesture;

use crate::error::RecordingError;
use crate::mat::MatFile;
use crate::segment::Segment;
use crate::source::{Columns, RecordingSource};
use crate::table::Channel;

/// Name of the data set, in which its people have their numbers.
pub const DATA_SET: &str = "Ozdemir 2022";

/// Sampling rate of recordings that do not tell it, in Hz.
pub const SAMPLE_RATE_HZ: f64 = 2000.0;

const CYCLE_STARTS_S: [f64; 5] = [4.0, 138.0, 272.0, 406.0, 540.0];
const GESTURE_INTERVAL_S: f64 = 10.0;
const GESTURE_S: f64 = 6.0;
/// Gestures of a cycle: ours are the first six, the others abduction, adduction, supination and pronation.
const GESTURES: u32 = 10;

/// The gesture a number stands for; `None` for all others.
pub fn gesture(number: u32) -> Option<Gesture> {
    match number {
        0 => Some(Gesture::REST),
        1 => Some(Gesture::EXTENSION),
        2 => Some(Gesture::FLEXION),
        3 => Some(Gesture::ULNAR),
        4 => Some(Gesture::RADIAL),
        5 => Some(Gesture::GRIP),
        _ => None,
    }
}

/// Whether the folders of a file say that it was filtered; `None` if they do not say. The nearest one decides.
pub fn is_filtered(path: &Path) -> Option<bool> {
    path.ancestors().skip(1).find_map(|folder| {
        let name = folder.file_name()?.to_str()?.to_ascii_lowercase();
        match name.as_str() {
            "filtered" => Some(true),
            "raw" => Some(false),
            _ => None,
        }
    })
}

/// Whose recording a `.mat` file is: its variable `iD` if that is a number, else the only number in its name.
///
/// # Errors
/// When the file is not a MAT-file or is damaged.
pub fn person(file: &Path) -> Result<Option<u16>, RecordingError> {
    let id = open_mat(file)?.number("iD").map_err(RecordingError::mat(file))?;
    if let Some(id) = id.filter(|id| id.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(id)) {
        return Ok(Some(id as u16));
    }
    let name = file.file_stem().and_then(|name| name.to_str()).unwrap_or_default();
    let mut numbers =
        name.split(|character: char| !character.is_ascii_digit()).filter(|part| !part.is_empty());
    Ok(match (numbers.next(), numbers.next()) {
        (Some(number), None) => number.parse().ok(),
        _ => None,
    })
}

/// Opens a person's `.mat` file. `given_hz` is the rate the user says, if any.
///
/// # Errors
/// When the file cannot be read, lacks a channel, or has another rate than `given_hz`.
pub fn open(
    file: &Path,
    channels: &[Channel],
    given_hz: Option<f64>,
) -> Result<RecordingSource, RecordingError> {
    let mut mat = open_mat(file)?;
    let mut numbers = Vec::new();
    for channel in channels {
        match channel {
            Channel::Index(index) => numbers.push(*index),
            Channel::Name(name) => {
                return Err(RecordingError::NamedChannel { file: file.to_owned(), name: name.clone() });
            }
        }
    }
    let rate_of_file_hz = mat.number("fs").map_err(RecordingError::mat(file))?;
    let sample_rate_hz = match (rate_of_file_hz, given_hz) {
        (Some(actual_hz), Some(given_hz)) if actual_hz != given_hz => {
            return Err(RecordingError::SampleRateDiffers { path: file.to_owned(), actual_hz, given_hz });
        }
        (of_file, given) => of_file.or(given).unwrap_or(SAMPLE_RATE_HZ),
    };
    if !(sample_rate_hz.is_finite() && sample_rate_hz > 0.0) {
        return Err(tendon_signal::DesignError::SampleRate(sample_rate_hz).into());
    }
    let (_, file_columns) = mat.shape("data").map_err(RecordingError::mat(file))?;
    let names = (0..file_columns).map(|column| column.to_string()).collect();
    let samples = mat.columns("data", &numbers).map_err(RecordingError::mat(file))?;
    let columns = Columns { samples, chosen: numbers, names, unit: "mV".to_owned() };
    Ok(RecordingSource::of_columns(columns, segments(file, sample_rate_hz), sample_rate_hz))
}

fn open_mat(path: &Path) -> Result<MatFile<File>, RecordingError> {
    let file = tendon_input::open(path).map_err(RecordingError::open(path))?;
    MatFile::open(file).map_err(RecordingError::mat(path))
}

/// The trials of a person's file, and what lies between them.
fn segments(file: &Path, sample_rate_hz: f64) -> Vec<Segment> {
    let segment = |repetition, cue, end_s: Option<f64>| Segment {
        file: file.to_owned(),
        repetition,
        cue,
        end_sample: end_s.map(|end_s| (end_s * sample_rate_hz).round() as u64),
        samples_lost_before: 0,
    };
    let mut segments = Vec::new();
    for (cycle, cycle_start_s) in (0..).zip(CYCLE_STARTS_S) {
        for number in 0..GESTURES {
            let start_s = cycle_start_s + GESTURE_INTERVAL_S * f64::from(number);
            segments.push(segment(None, None, Some(start_s)));
            segments.push(segment(Some(cycle), gesture(number), Some(start_s + GESTURE_S)));
        }
    }
    segments.push(segment(None, None, None));
    segments
}

/// Which trial a file of its own is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Trial {
    /// Number of the person.
    pub person: u16,
    /// Cycle, from 0.
    pub cycle: u8,
    /// The data set's number of the gesture.
    pub gesture: u32,
}

/// Reads a trial from the name of its file: `P3_C0_G5.csv` or `participant3_cycle0_gesture5.csv`, in any case, the
/// three parts in any order, `_` or `-` between them. `person` works like `participant`.
pub fn trial_of_name(file: &Path) -> Option<Trial> {
    if !file.extension()?.eq_ignore_ascii_case("csv") {
        return None;
    }
    let name = file.file_stem()?.to_str()?.to_ascii_lowercase();
    let (mut person, mut cycle, mut gesture) = (None, None, None);
    for part in name.split(['_', '-']) {
        let (word, number) = part.split_at(part.find(|character: char| character.is_ascii_digit())?);
        let is_first = match word {
            "p" | "person" | "participant" => person.replace(number.parse().ok()?).is_none(),
            "c" | "cycle" => cycle.replace(number.parse().ok()?).is_none(),
            "g" | "gesture" => gesture.replace(number.parse().ok()?).is_none(),
            _ => false,
        };
        if !is_first {
            return None;
        }
    }
    Some(Trial { person: person?, cycle: cycle?, gesture: gesture? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trials_are_told_by_the_names_of_their_files() {
        let trial = |name: &str| {
            trial_of_name(Path::new(name)).map(|trial| (trial.person, trial.cycle, trial.gesture))
        };
        for name in
            ["a/P3_C0_G5.csv", "p03_c0_g5.CSV", "Participant3-Cycle0-Gesture5.csv", "G5_person3_C0.csv"]
        {
            assert_eq!(trial(name), Some((3, 0, 5)), "{name}");
        }
        for name in [
            "P3_C0.csv",
            "P3_C0_G5.txt",
            "P3_C0_G5_P4.csv",
            "P_C0_G5.csv",
            "X3_C0_G5.csv",
            "P3_C300_G5.csv",
            "P3_C0_G5_filtered.csv",
            "labels.csv",
            "P70000_C0_G5.csv",
        ] {
            assert_eq!(trial(name), None, "{name}");
        }
    }

    #[test]
    fn a_persons_file_has_five_cycles_of_ten_gestures() {
        let segments = segments(Path::new("1.mat"), 2000.0);
        let trials: Vec<(u64, &Segment)> = segments
            .windows(2)
            .filter(|pair| pair[1].repetition.is_some())
            .map(|pair| (pair[0].end_sample.unwrap(), &pair[1]))
            .collect();
        assert_eq!(trials.len(), 50);
        assert!(trials.iter().all(|(start, trial)| trial.end_sample == Some(start + 12_000)));
        // Cycle 2, grip: 272 s + 50 s.
        assert_eq!((trials[25].0, trials[25].1.cue), (644_000, Some(Gesture::GRIP)));
        assert_eq!((trials[26].1.cue, trials[26].1.repetition), (None, Some(2)));
        assert!(segments.is_sorted_by_key(|segment| segment.end_sample.unwrap_or(u64::MAX)));
    }

    #[test]
    fn the_nearest_folder_says_whether_a_file_is_filtered() {
        for (path, expected) in [
            ("sEMG-dataset/raw/mat/1.mat", Some(false)),
            ("raw/Filtered/1.mat", Some(true)),
            ("data/filtered.mat", None),
        ] {
            assert_eq!(is_filtered(Path::new(path)), expected, "{path}");
        }
    }
}
