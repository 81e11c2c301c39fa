//! Which files a path means, and in which order they are one recording.
//!
//! ```text
//! EMG/                            3dc_EMG_gesture_0_0.txt, …_0_1.txt, …   one segment a file, with its cue
//! 3dc_EMG_gesture_2_4.txt         itself, with its cue
//! emg.csv                         itself, without a cue
//! ```

use std::path::Path;

use crate::error::RecordingError;
use crate::labels::is_table;
use crate::segment::{Notice, Segment};
use crate::source::RecordingSettings;
use crate::three_dc;

/// The files at `path`, at least one.
pub(crate) fn segments(
    path: &Path,
    settings: &RecordingSettings,
    notices: &mut Vec<Notice>,
) -> Result<Vec<Segment>, RecordingError> {
    let metadata = path.metadata().map_err(RecordingError::open(path))?;
    if metadata.is_dir() {
        return folder_segments(path, settings.repetition, notices);
    }
    if !metadata.is_file() {
        tendon_input::open(path).map_err(RecordingError::open(path))?;
    }
    if settings.repetition.is_some() {
        return Err(RecordingError::RepetitionOfFile { file: path.to_owned() });
    }
    let three_dc = three_dc::parse_file_name(path);
    if !is_table(path) {
        return Err(RecordingError::UnknownLayout { path: path.to_owned() });
    }
    let cue = three_dc.and_then(|(_, number)| three_dc::gesture(number));
    let repetition = three_dc.map(|(repetition, _)| repetition);
    Ok(vec![Segment { file: path.to_owned(), repetition, cue, end_sample: None, samples_lost_before: 0 }])
}

fn folder_segments(
    folder: &Path,
    wanted: Option<u32>,
    notices: &mut Vec<Notice>,
) -> Result<Vec<Segment>, RecordingError> {
    let mut repetitions = three_dc::list(folder)?;
    let Some(&last) = repetitions.keys().last() else {
        return Err(RecordingError::UnknownLayout { path: folder.to_owned() });
    };
    if let Some(repetition) = wanted {
        if !repetitions.contains_key(&repetition) {
            let available = repetitions.into_keys().collect();
            return Err(RecordingError::NoSuchRepetition {
                folder: folder.to_owned(),
                repetition,
                available,
            });
        }
        repetitions.retain(|&number, _| number == repetition);
    } else {
        let missing = (0..last).filter(|repetition| !repetitions.contains_key(repetition));
        notices.extend(
            missing.map(|repetition| Notice::MissingRepetition { folder: folder.to_owned(), repetition }),
        );
    }
    let mut segments = Vec::new();
    for (repetition, files) in repetitions {
        for number in (0..three_dc::GESTURES).filter(|number| !files.contains_key(number)) {
            notices.push(Notice::MissingFile { file: folder.join(three_dc::file_name(repetition, number)) });
        }
        segments.extend(files.into_iter().map(|(number, file)| Segment {
            file,
            repetition: Some(repetition),
            cue: three_dc::gesture(number),
            end_sample: None,
            samples_lost_before: 0,
        }));
    }
    Ok(segments)
}
