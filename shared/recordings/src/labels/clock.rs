//! Where a label begins and ends: a sample, or seconds from the file's first one, which become a sample by the file's clock.

use std::path::Path;

use crate::error::RecordingError;
use crate::source::{FRAMES_AT_ONCE, RecordingSettings, RecordingSource};
use crate::table::Channel;

/// A place in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Place {
    Sample(u64),
    /// From the first sample on.
    Seconds(f64),
}

impl Place {
    /// The sample there; `clock` is that of the file.
    pub(super) fn sample(self, clock: Option<&FileClock>) -> u64 {
        match self {
            Place::Sample(sample) => sample,
            Place::Seconds(seconds) => clock.map_or(0, |clock| clock.sample_at(seconds)),
        }
    }
}

/// Which sample of a file stands where in time.
pub(super) struct FileClock {
    sample_rate_hz: f64,
    /// Where samples follow on: how many came before, and how many if none were missing.
    stretches: Vec<(u64, u64)>,
    samples: u64,
}

impl FileClock {
    /// Reads the file at `path` once.
    pub(super) fn read(path: &Path, given_hz: Option<f64>) -> Result<FileClock, RecordingError> {
        let settings = RecordingSettings {
            channels: vec![Channel::Index(0)],
            sample_rate_hz: given_hz,
            ..RecordingSettings::default()
        };
        let mut source = RecordingSource::open(path, &settings)?;
        let mut stretches = vec![(0, 0)];
        let mut frames = [0.0; FRAMES_AT_ONCE];
        let mut lost_samples = 0;
        let mut samples = 0;
        while let Some((count, frame)) = source.next_frames(&mut frames)? {
            let before = source.position() - count as u64;
            if frame.samples_lost_before > 0 {
                // A line without a sample has a number of its own.
                lost_samples += frame.samples_lost_before.saturating_sub(before - samples);
                stretches.push((before, before + lost_samples));
            }
            samples = source.position();
        }
        Ok(FileClock { sample_rate_hz: source.sample_rate_hz(), stretches, samples })
    }

    fn sample_at(&self, seconds: f64) -> u64 {
        let elapsed = (seconds * self.sample_rate_hz).round() as u64;
        let next = self.stretches.partition_point(|(_, start)| *start <= elapsed);
        let (before, start) = self.stretches[next - 1];
        let end = self.stretches.get(next).map_or(self.samples, |(before, _)| *before);
        let sample = before + (elapsed - start);
        // What lies within a gap begins or ends with it; what lies beyond the end is noticed when the file is cut.
        if next < self.stretches.len() { sample.min(end) } else { sample }
    }
}
