//! Reads a whole recording once, so that a bad one is refused before anything starts.

use std::path::Path;

use crate::error::RecordingError;
use crate::segment::{Notice, Segment};
use crate::source::{FRAMES_AT_ONCE, Frame, RecordingSettings, RecordingSource};

/// What a whole recording holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Samples of each channel.
    pub samples: u64,
    /// Sampling rate in Hz.
    pub sample_rate_hz: f64,
    /// Unit of the samples; empty if it is not known.
    pub unit: String,
    /// Length in seconds, without what is missing.
    pub duration_s: f64,
    /// Columns of the first file, chosen or not.
    pub file_channels: usize,
    /// The chosen ones in their order: by the name in the header line, else by number from 0.
    pub channels: Vec<String>,
    /// The files in order, with their cues.
    pub cues: Vec<CueSpan>,
    /// What its user should know.
    pub notices: Vec<Notice>,
}

/// The part of a recording that one segment, and so one cue, holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CueSpan {
    /// The segment and its cue.
    pub segment: Segment,
    /// Index of its first sample.
    pub first_sample: u64,
    /// Its samples.
    pub samples: u64,
}

/// A replay at its true pace is silent for no longer than this, in seconds, however many samples are missing. A gap that is longer
/// is named.
pub const LONGEST_SILENCE_S: f64 = 10.0;

/// Reads the whole recording once, so that a bad one is refused before anything starts.
///
/// # Errors
/// The first thing that is wrong with it.
pub fn check(path: &Path, settings: &RecordingSettings) -> Result<Summary, RecordingError> {
    let mut source = RecordingSource::open(path, settings)?;
    let mut frames = vec![0.0; FRAMES_AT_ONCE * source.channels()];
    let mut counts = vec![0_u64; source.segments().len()];
    let mut constant = Vec::new();
    // The longest gap, and the samples before it.
    let (mut longest_lost, mut samples_before) = (0, 0);
    while let Some((count, Frame { segment, samples_lost_before, .. })) = source.next_frames(&mut frames)? {
        let frames = &frames[..count * source.channels()];
        if counts.iter().all(|count| *count == 0) {
            constant = frames[..source.channels()].iter().copied().enumerate().collect();
        }
        constant.retain(|(channel, value)| {
            frames.iter().skip(*channel).step_by(source.channels()).all(|sample| sample == value)
        });
        if samples_lost_before > longest_lost {
            (longest_lost, samples_before) = (samples_lost_before, counts.iter().sum());
        }
        counts[segment] += count as u64;
    }
    if counts.iter().all(|count| *count == 0) {
        return Err(RecordingError::NoSamples {
            path: path.to_owned(),
            channels: source.chosen().join(", "),
        });
    }
    let names = source.chosen();
    let constant: Vec<(String, f32)> =
        constant.into_iter().map(|(channel, value)| (names[channel].clone(), value)).collect();
    let constant =
        (!constant.is_empty()).then(|| Notice::Constant { path: path.to_owned(), channels: constant });
    let sample_rate_hz = source.sample_rate_hz();
    let seconds = |samples: u64| samples as f64 / sample_rate_hz;
    let silence = Some(seconds(longest_lost)).filter(|silence_s| *silence_s > LONGEST_SILENCE_S);
    let silence = silence.map(|silence_s| Notice::Silence {
        path: path.to_owned(),
        silence_s,
        after_s: seconds(samples_before),
    });
    let notices = source.notices().iter().cloned().chain(silence).chain(constant).collect();
    let mut samples = 0;
    let cues = source.segments().iter().zip(counts).map(|(segment, count)| {
        let span = CueSpan { segment: segment.clone(), first_sample: samples, samples: count };
        samples += count;
        span
    });
    let cues = cues.collect();
    Ok(Summary {
        samples,
        sample_rate_hz,
        duration_s: samples as f64 / sample_rate_hz,
        file_channels: source.file_channels(),
        channels: source.chosen(),
        unit: source.unit().to_owned(),
        cues,
        notices,
    })
}
