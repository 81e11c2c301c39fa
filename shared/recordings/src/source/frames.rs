//! Reading an open recording, frame by frame and file by file.
//!
//! ```text
//! next_frames ─▶ read_rows: table or columns in memory ─▶ frames, and what is missing before them
//!      └─ at the end of a file ─▶ what was missing in it, the next file
//! ```

use tendon_gesture::Gesture;

use super::{Columns, RecordingSource, Samples};
use crate::error::RecordingError;
use crate::segment::Notice;
use crate::table::{Row, TableError};
use crate::text::Text;

/// What [`RecordingSource::next_frame`] says beside the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Index of the file the frame is from, into [`RecordingSource::segments`].
    pub segment: usize,
    /// The cue of that file.
    pub cue: Option<Gesture>,
    /// Samples that are missing before it, at the recording's rate.
    pub samples_lost_before: u64,
}

/// What is missing in the file that is read, as far as it was read.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Missing {
    /// Places where samples are missing, by the column of time or a counter; how many samples; the line after the first.
    gaps: u64,
    gap_samples: u64,
    gap_line: u64,
    /// Lines without a sample in a chosen column, up to the last line that has them all; the first one.
    lines: u64,
    line: u64,
    /// Such lines since then.
    lines_since: u64,
}

/// What was read in one go.
struct Rows {
    /// Lines, those without a sample included.
    lines: usize,
    /// Frames.
    samples: usize,
    /// Samples that are missing before the first of them.
    samples_lost_before: u64,
    /// Why no more could be read.
    problem: Option<TableError>,
}

impl RecordingSource {
    /// Reads the next sample of each chosen channel into `frame`; `None` at the end. Nothing is allocated
    /// but for an error.
    ///
    /// # Errors
    /// When the next line or the next file cannot be read, with its place. Reading on gives the same error.
    ///
    /// # Panics
    /// When `frame` is not [`channels`](RecordingSource::channels) long.
    pub fn next_frame(&mut self, frame: &mut [f32]) -> Result<Option<Frame>, RecordingError> {
        assert_eq!(frame.len(), self.channels, "a frame holds one value for each chosen channel");
        Ok(self.next_frames(frame)?.map(|(_, frame)| frame))
    }

    /// Reads as many frames as `frames`, `[frames × channels]`, has room for, but neither beyond the end of a file nor
    /// over missing samples: how many, at least one, and what holds for all of them (samples may be missing only before
    /// the first one); `None` at the end. Nothing is allocated but for an error.
    ///
    /// # Errors
    /// When the next line or the next file cannot be read, with its place: once all frames before it have been given.
    /// Reading on gives the same error.
    ///
    /// # Panics
    /// When `frames` is not one frame of [`channels`](RecordingSource::channels) or several.
    pub fn next_frames(&mut self, frames: &mut [f32]) -> Result<Option<(usize, Frame)>, RecordingError> {
        assert!(
            !frames.is_empty() && frames.len().is_multiple_of(self.channels),
            "frames × channels, at least one frame"
        );
        loop {
            let is_last = self.segment + 1 == self.segments.len();
            let end_sample = self.segments[self.segment].end_sample;
            let mut wanted = frames.len() / self.channels;
            if let Some(end) = end_sample.filter(|_| !is_last) {
                wanted = wanted.min(end.saturating_sub(self.position) as usize);
                if wanted == 0 {
                    self.begin_next_segment();
                    continue;
                }
            }
            let Rows { lines, samples, samples_lost_before, problem } = self.read_rows(frames, wanted);
            self.position += lines as u64;
            if samples > 0 {
                let cue = self.segments[self.segment].cue;
                return Ok(Some((samples, Frame { segment: self.segment, cue, samples_lost_before })));
            }
            if let Some(error) = problem {
                return Err(RecordingError::table(&self.segments[self.segment].file)(error));
            }
            if lines > 0 {
                continue;
            }
            self.sum_up_missing();
            // Of segments within one file none is left when the file ends.
            if is_last || end_sample.is_some() {
                return Ok(None);
            }
            self.open_next_segment()?;
        }
    }

    /// Reads up to `wanted` rows of the file into `frames`, up to the first one before which samples are missing.
    fn read_rows(&mut self, frames: &mut [f32], wanted: usize) -> Rows {
        let mut rows = Rows { lines: 0, samples: 0, samples_lost_before: 0, problem: None };
        let (table, text, factors) = match &mut self.samples {
            Samples::Table { table, text, factors, .. } => (table, text, factors),
            Samples::Columns(Columns { samples: columns, .. }) => {
                let position = self.position as usize;
                let left = columns.first().map_or(0, |column| column.len() - position);
                let frames = frames.chunks_exact_mut(self.channels).take(wanted);
                for (frame, index) in frames.zip(position..position + left) {
                    frame.iter_mut().zip(&*columns).for_each(|(value, column)| *value = column[index]);
                    rows.samples += 1;
                }
                if rows.samples > 0 {
                    rows.samples_lost_before = std::mem::take(&mut self.lost_samples);
                }
                rows.lines = rows.samples;
                return rows;
            }
        };
        let missing = &mut self.missing;
        let mut frames = frames.chunks_exact_mut(self.channels);
        let mut frame = frames.next();
        while let Some(values) = frame.as_mut().filter(|_| rows.lines < wanted) {
            match table.next_row(text.bytes(), values) {
                Ok(Row::Samples) => {
                    values.iter_mut().zip(&*factors).for_each(|(value, factor)| *value *= factor);
                    if rows.samples == 0 {
                        rows.samples_lost_before = std::mem::take(&mut self.lost_samples);
                        missing.lines += std::mem::take(&mut missing.lines_since);
                    }
                    rows.samples += 1;
                    rows.lines += 1;
                    frame = frames.next();
                }
                Ok(Row::Missing) => {
                    rows.lines += 1;
                    self.lost_samples += 1;
                    missing.lines_since += 1;
                    if missing.line == 0 {
                        missing.line = table.lines();
                    }
                }
                Ok(Row::Gap(samples)) => {
                    self.lost_samples += samples;
                    missing.gap_samples += samples;
                    missing.gaps += 1;
                    if missing.gap_line == 0 {
                        missing.gap_line = table.lines() + 1;
                    }
                }
                Ok(Row::End) => break,
                Err(error) => {
                    rows.problem = Some(error);
                    break;
                }
            }
            if rows.samples > 0 && self.lost_samples > 0 {
                break;
            }
        }
        text.release_before(table.position());
        rows
    }

    /// Says what was missing in the file that has been read.
    fn sum_up_missing(&mut self) {
        let Missing { gaps, gap_samples, gap_line, lines, line, .. } = std::mem::take(&mut self.missing);
        let file = &self.segments[self.segment].file;
        if gaps > 0 {
            self.notices.push(Notice::Gaps {
                file: file.clone(),
                gaps,
                samples: gap_samples,
                line: gap_line,
            });
        }
        if lines > 0 {
            self.notices.push(Notice::MissingSamples { file: file.clone(), lines, line });
        }
    }

    fn open_next_segment(&mut self) -> Result<(), RecordingError> {
        let path = &self.segments[self.segment + 1].file;
        if let Samples::Table { table, text, .. } = &mut self.samples {
            let (next, notice) = Text::open(path)?;
            table.continue_with(next.bytes()).map_err(RecordingError::table(path))?;
            *text = next;
            self.notices.extend(notice);
        }
        self.begin_next_segment();
        self.position = 0;
        Ok(())
    }

    fn begin_next_segment(&mut self) {
        self.segment += 1;
        self.lost_samples += self.segments[self.segment].samples_lost_before;
    }
}
