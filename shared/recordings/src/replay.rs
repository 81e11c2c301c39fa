//! A recording as blocks of samples at the session's rate.
//!
//! ```text
//! output sample n is the recording at input time n × down / up, and has the cue that is in force there:
//!
//! inputs    first × padding | 0   1   2   3   …  last | last × padding
//! outputs                     0 1 2 3 4 5 6 7 …            (up = 2, down = 1)
//! ```
//! The resampler's low-pass reaches some samples to either side, and it lags by that much. Reading ahead takes
//! the lag out, so that samples and cues stay together; repeating the first and the last sample keeps the
//! offset of an amplifier from becoming a step at the recording's ends.

use std::collections::VecDeque;
use std::path::Path;

use tendon_gesture::Gesture;
use tendon_signal::Resampler;

use crate::error::RecordingError;
use crate::source::{RecordingSettings, RecordingSource};

/// The largest number in a resampling ratio: the low-pass has 20 times as many taps.
const MAX_RATIO: u64 = 100_000;

/// What [`ReplayStream::next_block`] says beside the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplayBlock {
    /// Index of the block's first sample since the start of the stream.
    pub first_sample: u64,
    /// The cue of the block's newest sample.
    pub cue: Option<Gesture>,
    /// Index of the first sample under this cue: where the file of the newest sample begins.
    pub cue_since: u64,
    /// That file, an index into [`RecordingSource::segments`].
    pub segment: usize,
}

/// From which output sample on a segment is being played.
#[derive(Clone, Copy, Debug)]
struct CueStart {
    sample: u64,
    segment: usize,
    cue: Option<Gesture>,
}

/// A recording that is read block by block at the session's rate.
#[derive(Debug)]
pub struct ReplayStream {
    source: RecordingSource,
    /// Output samples …
    up: u64,
    /// … for so many input samples, in lowest terms.
    down: u64,
    /// One for each channel; none if the rates are equal.
    resamplers: Vec<Resampler>,
    /// How often the first sample is repeated before the recording.
    padding: u64,
    /// Outputs that are still to be thrown away: of the padding and of the lag.
    skip: u64,
    frame: Vec<f32>,
    /// Of each channel, outputs that no block has taken yet.
    pending: Vec<Vec<f32>>,
    /// Inputs read so far.
    inputs: u64,
    is_at_end: bool,
    /// Index of the first pending output.
    next_output: u64,
    block_samples: usize,
    current: CueStart,
    /// Segments that begin after `current`, already read.
    coming: VecDeque<CueStart>,
    dropped_samples: u64,
}

impl ReplayStream {
    /// Opens the recording at `path` for blocks of `block_samples` at `sample_rate_hz`.
    ///
    /// # Errors
    /// As [`RecordingSource::open`], or when the recording's rate cannot be brought to `sample_rate_hz`.
    pub fn open(
        path: &Path,
        settings: &RecordingSettings,
        sample_rate_hz: f64,
        block_samples: usize,
    ) -> Result<ReplayStream, RecordingError> {
        ReplayStream::of(RecordingSource::open(path, settings)?, sample_rate_hz, block_samples)
    }

    /// As [`ReplayStream::open`], for a recording that is open already.
    pub(crate) fn of(
        source: RecordingSource,
        sample_rate_hz: f64,
        block_samples: usize,
    ) -> Result<ReplayStream, RecordingError> {
        if block_samples == 0 {
            return Err(RecordingError::NoBlock);
        }
        let (up, down) = ratio(source.sample_rate_hz(), sample_rate_hz)?;
        let channels = source.channels();
        let mut resamplers = Vec::new();
        let (mut padding, mut skip, mut outputs_of_frame) = (0, 0, 1);
        if up != down {
            let resampler = Resampler::new(up as usize, down as usize)?;
            // Output j lies at the upsampled place j × down, the first input there at padding × up + lag:
            // with the right padding that is an output.
            let lag = (resampler.delay_samples() * down as f64).round() as u64;
            padding = lag.div_ceil(up);
            while !(padding * up + lag).is_multiple_of(down) {
                padding += 1;
            }
            skip = (padding * up + lag) / down;
            outputs_of_frame = resampler.max_output_samples(1);
            resamplers = vec![resampler; channels];
        }
        let pending = vec![Vec::with_capacity(block_samples + outputs_of_frame); channels];
        let current = CueStart { sample: 0, segment: 0, cue: source.segments()[0].cue };
        let coming = VecDeque::with_capacity(source.segments().len());
        Ok(ReplayStream {
            source,
            up,
            down,
            resamplers,
            padding,
            skip,
            frame: vec![0.0; channels],
            pending,
            inputs: 0,
            is_at_end: false,
            next_output: 0,
            block_samples,
            current,
            coming,
            dropped_samples: 0,
        })
    }

    /// The recording that is replayed.
    pub fn source(&self) -> &RecordingSource {
        &self.source
    }

    /// Samples at the end that did not fill a block; known once [`ReplayStream::next_block`] gave `None`.
    pub fn dropped_samples(&self) -> u64 {
        self.dropped_samples
    }

    /// Writes the next block, `[channels × block_samples]`, into `out`; `None` at the end, `out` then being
    /// as it was. Nothing is allocated but for an error.
    ///
    /// # Errors
    /// When the recording cannot be read on.
    ///
    /// # Panics
    /// When `out` is not `channels × block_samples` long.
    pub fn next_block(&mut self, out: &mut [f32]) -> Result<Option<ReplayBlock>, RecordingError> {
        assert_eq!(out.len(), self.pending.len() * self.block_samples, "a block is channels × block_samples");
        while self.pending[0].len() < self.block_samples {
            if !self.read()? {
                self.dropped_samples = self.pending[0].len() as u64;
                return Ok(None);
            }
        }
        for (out, pending) in out.chunks_exact_mut(self.block_samples).zip(&mut self.pending) {
            out.copy_from_slice(&pending[..self.block_samples]);
            pending.drain(..self.block_samples);
        }
        let first_sample = self.next_output;
        self.next_output += self.block_samples as u64;
        while let Some(start) = self.coming.front().filter(|start| start.sample < self.next_output) {
            self.current = *start;
            self.coming.pop_front();
        }
        let CueStart { sample: cue_since, segment, cue } = self.current;
        Ok(Some(ReplayBlock { first_sample, cue, cue_since, segment }))
    }

    /// Takes in one more frame, or what lies beyond the last; `false` when all outputs are made.
    fn read(&mut self) -> Result<bool, RecordingError> {
        if !self.is_at_end {
            if let Some(frame) = self.source.next_frame(&mut self.frame)? {
                if frame.segment
                    != self.current.segment.max(self.coming.back().map_or(0, |last| last.segment))
                {
                    let sample = (self.inputs * self.up).div_ceil(self.down);
                    self.coming.push_back(CueStart { sample, segment: frame.segment, cue: frame.cue });
                }
                if self.inputs == 0 {
                    for _ in 0..self.padding {
                        self.push_frame();
                    }
                }
                self.inputs += 1;
                self.push_frame();
                return Ok(true);
            }
            self.is_at_end = true;
        }
        let outputs = (self.inputs * self.up).div_ceil(self.down);
        let made = self.next_output + self.pending[0].len() as u64;
        if made >= outputs {
            return Ok(false);
        }
        self.push_frame();
        let beyond = (self.next_output + self.pending[0].len() as u64).saturating_sub(outputs) as usize;
        for pending in &mut self.pending {
            pending.truncate(pending.len() - beyond);
        }
        Ok(true)
    }

    /// Resamples `frame` into `pending`.
    fn push_frame(&mut self) {
        if self.resamplers.is_empty() {
            for (pending, &sample) in self.pending.iter_mut().zip(&self.frame) {
                pending.push(sample);
            }
            return;
        }
        for ((resampler, pending), sample) in
            self.resamplers.iter_mut().zip(&mut self.pending).zip(&self.frame)
        {
            resampler.process(std::slice::from_ref(sample), pending);
        }
        // While there is something to skip, nothing before it is pending.
        let skipped = self.skip.min(self.pending[0].len() as u64);
        if skipped > 0 {
            self.skip -= skipped;
            for pending in &mut self.pending {
                pending.drain(..skipped as usize);
            }
        }
    }
}

/// Output samples for so many input samples, in lowest terms.
fn ratio(from_hz: f64, to_hz: f64) -> Result<(u64, u64), RecordingError> {
    if from_hz == to_hz {
        return Ok((1, 1));
    }
    // Beyond this not every whole number is an f64.
    const LARGEST_HZ: f64 = 9e15;
    let is_whole = |hz: f64| hz.fract() == 0.0 && (1.0..LARGEST_HZ).contains(&hz);
    if is_whole(from_hz) && is_whole(to_hz) {
        let (mut divisor, mut rest) = (to_hz as u64, from_hz as u64);
        while rest != 0 {
            (divisor, rest) = (rest, divisor % rest);
        }
        let (up, down) = (to_hz as u64 / divisor, from_hz as u64 / divisor);
        if up.max(down) <= MAX_RATIO {
            return Ok((up, down));
        }
    }
    Err(RecordingError::Resampling { from_hz, to_hz })
}
