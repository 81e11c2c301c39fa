//! Files of samples that say themselves what their channels are: names, units, rate, gaps, and often what was done when.
//!
//! ```text
//! samples   0 ………… 999 │ 1000 ………………… 2999      the chosen channels, in memory
//! gap                  └ 200 samples are missing before sample 1000
//! cues        │extension│     │grip   │          what annotations or markers name
//! segments  ──┴─────────┴─────┴───────┴──────    trials, and what lies between them
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use tendon_gesture::Gesture;

use crate::edf;
use crate::error::RecordingError;
use crate::mapped::MappedFile;
use crate::segment::{Notice, Segment};
use crate::table::{Channel, TableProblem, places};
use crate::xdf;

/// What such a file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Signals {
    /// The channels that can be read, chosen or not.
    pub names: Vec<String>,
    /// Of these the chosen ones, in their order.
    pub chosen: Vec<usize>,
    /// Samples of the chosen ones, all of the same length.
    pub columns: Vec<Vec<f32>>,
    /// Unit of the samples in the file's words; empty if it does not say.
    pub unit: String,
    /// Sampling rate in Hz.
    pub sample_rate_hz: f64,
    /// Where samples are missing, in order.
    pub gaps: Vec<Gap>,
    /// What the person was asked to do, in order.
    pub cues: Vec<Cue>,
    /// Samples of the file that are left out of the columns because they are no numbers, in order.
    pub(crate) missing: Vec<u64>,
    /// What its user should know.
    pub notices: Vec<Notice>,
}

/// Samples that are missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The first sample after it.
    pub before_sample: u64,
    /// How many are missing.
    pub lost_samples: u64,
}

impl Gap {
    /// A gap of about `lost_samples`, of one at least: what a damaged file says may be anything.
    pub(crate) fn of(before_sample: u64, lost_samples: f64) -> Gap {
        const MOST: f64 = (1_u64 << 40) as f64;
        Gap { before_sample, lost_samples: lost_samples.round().clamp(1.0, MOST) as u64 }
    }
}

/// What the person was asked to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cue {
    /// The gesture.
    pub gesture: Gesture,
    /// The sample at which it was asked for.
    pub start_sample: u64,
    /// The first sample after it; `None` if it lasts to the next cue or the end.
    pub end_sample: Option<u64>,
}

/// What can be wrong with such a file. Each message says what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SignalsError {
    /// Something else.
    #[error("is not a file of the kind that its name says ({0}): export the recording again")]
    OtherKind(&'static str),
    /// Contents that contradict themselves.
    #[error("is damaged: {0}; copy it again, or export the recording again")]
    Damaged(String),
    /// Nothing to read.
    #[error("has no samples: {0}")]
    Empty(&'static str),
    /// A channel that is not there.
    #[error("{0}")]
    Channel(TableProblem),
    /// Several streams that can be meant.
    #[error("has several streams of muscles ({}): name the channels with their stream, such as `{example}`", .streams.join(", "))]
    SeveralStreams {
        /// Their names.
        streams: Vec<String>,
        /// A channel with its stream.
        example: String,
    },
}

/// Whether a file's name is that of such a file.
pub fn is_signals(path: &Path) -> bool {
    path.extension().is_some_and(|extension| {
        ["edf", "bdf", "xdf", "xdfz"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    })
}

impl Signals {
    /// Reads the file at `path` with these channels, each of which must be there.
    ///
    /// # Errors
    /// When it cannot be opened or understood, or lacks a channel.
    pub fn read(path: &Path, channels: &[Channel]) -> Result<Signals, RecordingError> {
        let file = MappedFile::open(path).map_err(RecordingError::open(path))?;
        let is_called =
            |ending: &str| path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(ending));
        let signals = if is_called("xdfz") {
            xdf::unpacked(file.bytes()).and_then(|bytes| xdf::read(path, &bytes, channels))
        } else if is_called("xdf") {
            xdf::read(path, file.bytes(), channels)
        } else {
            edf::read(path, file.bytes(), channels)
        };
        signals.and_then(|signals| signals.without_missing(path)).map_err(RecordingError::signals(path))
    }

    /// Leaves out the samples that are no finite number in one of the chosen channels: they are missing.
    pub(crate) fn without_missing(mut self, path: &Path) -> Result<Signals, SignalsError> {
        let samples = self.columns.first().map_or(0, Vec::len);
        let is_missing =
            |sample: &u64| self.columns.iter().any(|column| !column[*sample as usize].is_finite());
        let missing: Vec<u64> = (0..samples as u64).filter(is_missing).collect();
        if missing.is_empty() {
            return Ok(self);
        }
        if missing.len() == samples {
            return Err(SignalsError::Empty("none of them is a finite number"));
        }
        let place = |sample: u64| place(&missing, sample);
        let mut lost_before: BTreeMap<u64, u64> = BTreeMap::new();
        for gap in &self.gaps {
            *lost_before.entry(place(gap.before_sample)).or_default() += gap.lost_samples;
        }
        for sample in &missing {
            *lost_before.entry(place(*sample)).or_default() += 1;
        }
        let left = (samples - missing.len()) as u64;
        let gap = |(before_sample, lost_samples)| Gap { before_sample, lost_samples };
        self.gaps = lost_before.into_iter().filter(|(before, _)| *before < left).map(gap).collect();
        for cue in &mut self.cues {
            cue.start_sample = place(cue.start_sample);
            cue.end_sample = cue.end_sample.map(place);
        }
        self.cues
            .retain(|cue| cue.start_sample < left && cue.end_sample.is_none_or(|end| end > cue.start_sample));
        for column in &mut self.columns {
            let mut missing = missing.iter().peekable();
            let mut sample = 0;
            column.retain(|_| {
                sample += 1;
                missing.next_if(|missing| **missing + 1 == sample).is_none()
            });
        }
        self.notices.push(Notice::SamplesMissing { file: path.to_owned(), samples: missing.len() as u64 });
        self.missing = missing;
        Ok(self)
    }

    /// Divides `path` into trials by the file's own cues. Repetitions of a gesture are counted from 0.
    pub fn segments(&self, path: &Path) -> Vec<Segment> {
        let part = |repetition, cue, end_sample| Segment {
            file: path.to_owned(),
            repetition,
            cue,
            end_sample,
            samples_lost_before: 0,
        };
        let mut repetitions: Vec<Gesture> = Vec::new();
        let mut segments = Vec::new();
        let mut end = Some(0);
        for (number, cue) in self.cues.iter().enumerate() {
            let next_start = self.cues.get(number + 1).map(|next| next.start_sample);
            if end != Some(cue.start_sample) {
                segments.push(part(None, None, Some(cue.start_sample)));
            }
            end = cue.end_sample.into_iter().chain(next_start).min();
            let repetition = repetitions.iter().filter(|gesture| **gesture == cue.gesture).count();
            repetitions.push(cue.gesture);
            segments.push(part(Some(repetition as u32), Some(cue.gesture), end));
        }
        if end.is_some() {
            segments.push(part(None, None, None));
        }
        // Two cues at the same sample leave nothing for the first.
        let mut start = 0;
        segments
            .retain(|segment| segment.end_sample.is_none_or(|end| std::mem::replace(&mut start, end) < end));
        self.divide_at_gaps(segments)
    }

    /// Divides segments of this file, which count its samples, where some are missing.
    pub fn divide(&self, mut segments: Vec<Segment>) -> Vec<Segment> {
        for segment in &mut segments {
            segment.end_sample = segment.end_sample.map(|end| place(&self.missing, end));
        }
        self.divide_at_gaps(segments)
    }

    fn divide_at_gaps(&self, segments: Vec<Segment>) -> Vec<Segment> {
        let mut divided = Vec::with_capacity(segments.len() + self.gaps.len());
        let mut gaps = self.gaps.iter().peekable();
        let mut start = 0;
        for mut segment in segments {
            while let Some(gap) =
                gaps.next_if(|gap| segment.end_sample.is_none_or(|end| gap.before_sample < end))
            {
                if gap.before_sample > start {
                    divided.push(Segment { end_sample: Some(gap.before_sample), ..segment.clone() });
                }
                start = gap.before_sample;
                segment.samples_lost_before = gap.lost_samples;
            }
            start = segment.end_sample.unwrap_or(start);
            divided.push(segment);
        }
        divided
    }
}

/// Where a sample of the file is in the columns, or the next one if it is missing.
fn place(missing: &[u64], sample: u64) -> u64 {
    sample - missing.partition_point(|missing| *missing < sample) as u64
}

/// For each channel its number among `names`.
pub(crate) fn choose(channels: &[Channel], names: &[String]) -> Result<Vec<usize>, SignalsError> {
    let places =
        places(channels, names.len(), names).map_err(|error| SignalsError::Channel(error.problem))?;
    let mut chosen = vec![0; channels.len()];
    for (column, place) in places.into_iter().enumerate() {
        if let Some(place) = place {
            chosen[place] = column;
        }
    }
    Ok(chosen)
}

/// The marker that ends a cue after which nothing is asked for. It names no gesture, as it has a space.
pub(crate) const CUE_IS_OVER: &str = "cue is over";

/// The gesture that an annotation or marker names, as `grip` or `cue grip`. Of numbers, 0 is rest, and those below 0, with a
/// fraction, or too large are none.
pub(crate) fn gesture_of(text: &str) -> Option<Gesture> {
    let text = text.trim().to_ascii_lowercase();
    let text = text.strip_prefix("cue ").unwrap_or(&text);
    match text.parse::<u32>() {
        Ok(0) => Some(Gesture::REST),
        Ok(number) => format!("gesture-{number}").parse().ok(),
        Err(_) if text.parse::<f64>().is_ok() => None,
        Err(_) => text.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_that_are_no_numbers_are_gaps() {
        let nan = f32::NAN;
        let cue = |gesture, start_sample, end_sample| Cue { gesture, start_sample, end_sample };
        let gap = |before_sample, lost_samples| Gap { before_sample, lost_samples };
        let signals = Signals {
            names: vec!["a".to_owned(), "b".to_owned()],
            chosen: vec![0, 1],
            columns: vec![
                vec![nan, 1.0, 2.0, nan, 4.0, 5.0, 6.0, nan],
                vec![0.0, 1.0, 2.0, 3.0, f32::INFINITY, 5.0, 6.0, 7.0],
            ],
            unit: String::new(),
            sample_rate_hz: 100.0,
            gaps: vec![gap(5, 7)],
            cues: vec![
                cue(Gesture::GRIP, 1, Some(3)),
                cue(Gesture::ULNAR, 3, Some(5)),
                cue(Gesture::REST, 5, None),
                cue(Gesture::RADIAL, 7, None),
            ],
            missing: Vec::new(),
            notices: Vec::new(),
        };
        let signals = signals.without_missing(Path::new("a.xdf")).unwrap();
        assert_eq!(signals.columns, [[1.0, 2.0, 5.0, 6.0], [1.0, 2.0, 5.0, 6.0]]);
        assert_eq!(signals.gaps, [gap(0, 1), gap(2, 9)]);
        assert_eq!(signals.cues, [cue(Gesture::GRIP, 0, Some(2)), cue(Gesture::REST, 2, None)]);
        assert_eq!(signals.notices, [Notice::SamplesMissing { file: "a.xdf".into(), samples: 4 }]);
        let nothing = Signals { columns: vec![vec![nan; 2]], ..signals };
        assert!(matches!(nothing.without_missing(Path::new("a.xdf")), Err(SignalsError::Empty(_))));
    }

    #[test]
    fn only_what_names_a_gesture_is_a_cue() {
        let name = |text: &str| gesture_of(text).map(|gesture| gesture.name().to_owned());
        assert_eq!(name(" Fist "), Some("fist".to_owned()));
        assert_eq!(name("cue grip"), Some("grip".to_owned()));
        assert_eq!(name("0"), Some("rest".to_owned()));
        assert_eq!(name("12"), Some("gesture-12".to_owned()));
        assert_eq!(name(CUE_IS_OVER), None);
        assert_eq!((name("-1"), name("99999999999"), name("2e3")), (None, None, None));
        assert_eq!((name("Recording paused"), name("gesture grip"), name("")), (None, None, None));
    }
}
