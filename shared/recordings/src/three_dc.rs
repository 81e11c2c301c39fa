//! The layout of the 3DC data set (Côté-Allard et al. 2019, "Deep learning for electromyographic hand gesture
//! signal classification using transfer learning").
//!
//! ```text
//! ParticipantP/{train,test}/EMG/3dc_EMG_gesture_R_G.txt     R: repetition 0…3, G: gesture 0…10
//!                          /IMU/3dc_IMU_gesture_R_G.txt     the armband's movements: not read
//! ```
//! 1000 Hz, ten channels, ADC counts. The files of a repetition, in the order of G, are one continuous
//! recording of 55 s; the cue for each gesture was given at its file's start.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;

use crate::error::RecordingError;

/// Name of the data set, in which its people have their numbers.
pub const DATA_SET: &str = "3DC";

/// Sampling rate of all 3DC recordings, in Hz.
pub const SAMPLE_RATE_HZ: f64 = 1000.0;

/// Unit of its samples.
pub const UNIT: &str = "adc_counts";

/// Electrodes of the armband, evenly around the arm: the channels of a recording, in order.
pub const ELECTRODES: usize = 10;

/// Gestures of a repetition, numbered from 0.
pub(crate) const GESTURES: u32 = 11;

/// When a 3DC recording was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Session {
    /// First, four repetitions.
    Train,
    /// Five minutes later, four repetitions.
    Test,
}

impl Session {
    /// Its folder's name: `train` or `test`.
    pub fn name(self) -> &'static str {
        match self {
            Session::Train => "train",
            Session::Test => "test",
        }
    }

    /// Repetitions of the person before this session: each has four.
    pub fn repetitions_before(self) -> u32 {
        match self {
            Session::Train => 0,
            Session::Test => 4,
        }
    }
}

/// Person and session of a folder `…/ParticipantP/{train,test}/EMG`.
pub fn origin(folder: &Path) -> Option<(u16, Session)> {
    let session_folder = folder.parent()?;
    let session = match session_folder.file_name()?.to_str()? {
        "train" => Session::Train,
        "test" => Session::Test,
        _ => return None,
    };
    let person = session_folder.parent()?.file_name()?.to_str()?.strip_prefix("Participant")?.parse().ok()?;
    Some((person, session))
}

/// As [`origin`], or if the folder's name does not say it, that of the folder to which it leads through links.
pub fn origin_through_links(folder: &Path) -> Option<(u16, Session)> {
    origin(folder).or_else(|| origin(&fs::canonicalize(folder).ok()?))
}

/// Whether a folder of [`origin`] is for EMG: it is called so, or holds such files. Others hold the movements of the armband.
///
/// # Errors
/// When the folder cannot be read.
pub fn holds_emg(folder: &Path) -> Result<bool, RecordingError> {
    let is_called_so = folder.file_name().is_some_and(|name| name.eq_ignore_ascii_case("EMG"));
    Ok(is_called_so || !list(folder)?.is_empty())
}

/// Repetition and gesture number in a file's name, if it is a 3DC recording's.
pub fn parse_file_name(path: &Path) -> Option<(u32, u32)> {
    let numbers = path.file_name()?.to_str()?.strip_prefix("3dc_EMG_gesture_")?.strip_suffix(".txt")?;
    let (repetition, gesture) = numbers.split_once('_')?;
    Some((repetition.parse().ok()?, gesture.parse().ok().filter(|&gesture| gesture < GESTURES)?))
}

/// The name of the file that holds a gesture of a repetition.
pub(crate) fn file_name(repetition: u32, gesture: u32) -> String {
    format!("3dc_EMG_gesture_{repetition}_{gesture}.txt")
}

/// The gesture a 3DC number stands for; `None` for all others (supination, pronation, open
/// hand, chuck grip, pinch grip).
pub(crate) fn gesture(number: u32) -> Option<Gesture> {
    match number {
        0 => Some(Gesture::REST),
        1 => Some(Gesture::RADIAL),
        2 => Some(Gesture::FLEXION),
        3 => Some(Gesture::ULNAR),
        4 => Some(Gesture::EXTENSION),
        7 => Some(Gesture::GRIP),
        _ => None,
    }
}

/// The recordings in an EMG folder: by repetition, then by gesture number. Empty if it holds none.
///
/// # Errors
/// When the folder cannot be read.
pub fn list(folder: &Path) -> Result<BTreeMap<u32, BTreeMap<u32, PathBuf>>, RecordingError> {
    let mut repetitions: BTreeMap<u32, BTreeMap<u32, PathBuf>> = BTreeMap::new();
    for entry in fs::read_dir(folder).map_err(RecordingError::open(folder))? {
        let path = entry.map_err(RecordingError::open(folder))?.path();
        if let Some((repetition, gesture)) = parse_file_name(&path) {
            repetitions.entry(repetition).or_default().insert(gesture, path);
        }
    }
    Ok(repetitions)
}

/// Whether `path` is of this layout: a folder of it, or one of its files by name.
pub fn is_three_dc(path: &Path) -> bool {
    path.is_dir() || parse_file_name(path).is_some()
}

/// The numbers of the repetitions that a 3DC `EMG` folder holds, in order; empty if it is another kind of folder.
///
/// # Errors
/// When the folder cannot be read.
pub fn repetitions(folder: &Path) -> Result<Vec<u32>, RecordingError> {
    Ok(list(folder)?.into_keys().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_names_of_the_data_set_are_recognised() {
        let parse = |name: &str| parse_file_name(Path::new(name));
        assert_eq!(parse("a/EMG/3dc_EMG_gesture_3_10.txt"), Some((3, 10)));
        assert_eq!(parse(&file_name(0, 7)), Some((0, 7)));
        for name in
            ["3dc_EMG_gesture_3_11.txt", "3dc_EMG_gesture_3.txt", "3dc_EMG_gesture_a_1.txt", "EMG", ".."]
        {
            assert_eq!(parse(name), None, "{name}");
        }
    }

    #[test]
    fn each_of_our_gestures_has_exactly_one_number() {
        let mut found: Vec<Gesture> = (0..GESTURES).filter_map(gesture).collect();
        found.sort();
        assert_eq!(found, Gesture::PAPER);
    }
}
