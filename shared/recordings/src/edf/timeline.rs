//! When the samples of an EDF or BDF file were taken, and what was written beside them.

use super::head::{Head, Signal, text};
use crate::signals::{Cue, Gap, SignalsError, gesture_of};

/// Beginning of the annotations with which Tendon's export says that a record has no samples from there on, only the last one again.
const FILLED: &str = "filled:";

/// When samples were taken, and what was written beside them.
#[derive(Default)]
pub(super) struct Timeline {
    /// Where records follow on: the first sample, and its time.
    runs: Vec<(u64, f64)>,
    samples: u64,
    sample_rate_hz: f64,
    pub(super) gaps: Vec<Gap>,
    pub(super) cues: Vec<Cue>,
    /// Where there are no samples though records have room for them, in order: the first one, and the first one behind it.
    pub(super) filled: Vec<(usize, usize)>,
}

impl Timeline {
    pub(super) fn read(
        head: &Head,
        bytes: &[u8],
        samples_of_record: usize,
        sample_rate_hz: f64,
    ) -> Result<Timeline, SignalsError> {
        let texts: Vec<&Signal> = head.signals.iter().filter(|signal| signal.is_text).collect();
        let mut timeline = Timeline { sample_rate_hz, ..Timeline::default() };
        let mut annotations = Vec::new();
        for record in 0..head.records {
            let mut start_s = None;
            for (number, signal) in texts.iter().enumerate() {
                for (place, annotation) in annotations_of(head.part(bytes, record, signal)).enumerate() {
                    // The first one is the time of the record, and has no text.
                    if (number, place) == (0, 0) {
                        start_s = Some(annotation.onset_s);
                    }
                    annotations.push(annotation);
                }
            }
            if head.has_gaps && start_s.is_none() {
                return Err(SignalsError::Damaged(format!("record {record} does not say when it begins")));
            }
            timeline.begin_record(record, start_s.filter(|_| head.has_gaps || record == 0))?;
            timeline.samples += samples_of_record as u64;
        }
        timeline.cues = annotations.iter().filter_map(|annotation| timeline.cue(annotation)).collect();
        timeline.cues.sort_by_key(|cue| cue.start_sample);
        let filled = annotations.iter().filter(|annotation| annotation.text.starts_with(FILLED));
        timeline.filled = filled.filter_map(|annotation| timeline.span(annotation)).collect();
        timeline.filled.sort_unstable();
        Ok(timeline)
    }

    /// A record begins, at a time of its own or after the one before.
    fn begin_record(&mut self, record: usize, start_s: Option<f64>) -> Result<(), SignalsError> {
        let Some(&(first_sample, run_start_s)) = self.runs.last() else {
            self.runs.push((0, start_s.unwrap_or(0.0)));
            return Ok(());
        };
        let Some(start_s) = start_s else { return Ok(()) };
        let expected_s = run_start_s + (self.samples - first_sample) as f64 / self.sample_rate_hz;
        let late_samples = (start_s - expected_s) * self.sample_rate_hz;
        // Times are rounded, too.
        const TOLERANCE_SAMPLES: f64 = 1.5;
        if late_samples < -TOLERANCE_SAMPLES {
            return Err(SignalsError::Damaged(format!(
                "record {record} begins at {start_s} s, before the end of the one before it"
            )));
        }
        if late_samples > TOLERANCE_SAMPLES {
            self.gaps.push(Gap::of(self.samples, late_samples));
            self.runs.push((self.samples, start_s));
        }
        Ok(())
    }

    /// The sample at a time: what lies in a gap belongs to its end.
    fn sample_at(&self, time_s: f64) -> u64 {
        let half_sample_s = 0.5 / self.sample_rate_hz;
        let place = self.runs.partition_point(|(_, start_s)| *start_s <= time_s + half_sample_s);
        let end = self.runs.get(place).map_or(self.samples, |(first_sample, _)| *first_sample);
        let Some(&(first_sample, start_s)) = self.runs[..place].last() else { return 0 };
        let sample = first_sample + ((time_s - start_s) * self.sample_rate_hz).round().max(0.0) as u64;
        sample.min(end)
    }

    /// The first sample of what an annotation is about, and the first one behind it.
    fn span(&self, annotation: &Annotation) -> Option<(usize, usize)> {
        let end_s = annotation.onset_s + annotation.duration_s?;
        let span = [annotation.onset_s, end_s].map(|time_s| self.sample_at(time_s) as usize);
        (span[0] < span[1]).then_some((span[0], span[1]))
    }

    fn cue(&self, annotation: &Annotation) -> Option<Cue> {
        let gesture = gesture_of(&annotation.text)?;
        let start_sample = self.sample_at(annotation.onset_s);
        let end_s = annotation.duration_s.filter(|duration_s| *duration_s > 0.0);
        let end_sample = end_s.map(|duration_s| self.sample_at(annotation.onset_s + duration_s));
        let is_inside = start_sample < self.samples && end_sample.is_none_or(|end| end > start_sample);
        is_inside.then_some(Cue { gesture, start_sample, end_sample })
    }
}

struct Annotation {
    onset_s: f64,
    duration_s: Option<f64>,
    text: String,
}

/// What annotations of a record say. What cannot be understood is passed over.
fn annotations_of(bytes: &[u8]) -> impl Iterator<Item = Annotation> {
    const TEXT: u8 = 0x14;
    const DURATION: u8 = 0x15;
    let lists = bytes.split(|byte| *byte == 0).filter(|list| !list.is_empty());
    lists.flat_map(|list| {
        let mut parts = list.split(|byte| *byte == TEXT);
        let time = parts.next().unwrap_or_default();
        let mut times = time.split(|byte| *byte == DURATION);
        let mut seconds = || text(times.next()?).parse().ok().filter(|seconds: &f64| seconds.is_finite());
        let (onset_s, duration_s) = (seconds(), seconds());
        let texts: Vec<String> = parts.map(text).collect();
        // What ends the last one begins no other.
        let texts = texts.len().saturating_sub(1);
        let parts = list.split(|byte| *byte == TEXT).skip(1).take(texts);
        onset_s.into_iter().flat_map(move |onset_s| {
            parts.clone().map(move |part| Annotation { onset_s, duration_s, text: text(part) })
        })
    })
}
