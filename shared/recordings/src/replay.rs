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
//!
//! Where samples are missing, the recording is made of *stretches*. Each is resampled by itself, and no block spans two:
//! ```text
//! inputs    0 1 2 3 4 | 7 missing | 12 13 14 …
//! outputs   0 …    9  |           | 24 25 26 …          (up = 2, down = 1)
//! ```

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::path::Path;

use tendon_gesture::Gesture;
use tendon_signal::Resampler;

use crate::error::RecordingError;
use crate::ratio::ratio;
use crate::segment::Notice;
use crate::source::{FRAMES_AT_ONCE, Frame, RecordingSettings, RecordingSource};

/// What [`ReplayStream::next_block`] and [`ReplayStream::next_piece`] say beside the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplayBlock {
    /// Index of the block's first sample since the start of the stream. It jumps where samples are missing: by these, and
    /// by those before them that did not fill a block.
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

/// A recording that is read block by block, or file by file, at the session's rate.
#[derive(Debug)]
pub struct ReplayStream {
    source: RecordingSource,
    /// Rate of the outputs, in Hz.
    sample_rate_hz: f64,
    /// Output samples …
    up: u64,
    /// … for this many input samples, in lowest terms.
    down: u64,
    /// `None` if the rates are equal.
    resampler: Option<Resampler>,
    /// How often the first sample is repeated before the recording.
    padding: u64,
    /// Outputs that are still to be thrown away: of the padding and of the lag.
    skip: u64,
    /// Room for the frames that are read in one go, `[frames × channels]`.
    frames: Vec<f32>,
    /// The newest frame.
    newest: Vec<f32>,
    /// Outputs that no block has taken yet, `[outputs × channels]`.
    pending: Vec<f32>,
    /// Outputs that are thrown away when a stretch begins.
    skip_at_start: u64,
    /// Inputs before the stretch, those missing included.
    inputs_before: u64,
    /// Inputs of the stretch that were read.
    inputs: u64,
    /// The first frames of the next stretch, which lie in `frames`: how many, and what holds for them.
    next_stretch: Option<(usize, Frame)>,
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
    ///
    /// # Errors
    /// When the recording's rate cannot be brought to `sample_rate_hz`.
    pub fn of(
        source: RecordingSource,
        sample_rate_hz: f64,
        block_samples: usize,
    ) -> Result<ReplayStream, RecordingError> {
        if block_samples == 0 {
            return Err(RecordingError::NoBlock);
        }
        let (up, down) = ratio(source.sample_rate_hz(), sample_rate_hz)?;
        let channels = source.channels();
        let mut resampler = None;
        let (mut padding, mut skip, mut outputs_of_frame) = (0, 0, 1);
        if up != down {
            let is_whole = [source.sample_rate_hz(), sample_rate_hz].map(f64::fract) == [0.0, 0.0];
            // Of whole rates as ever, so that what models were trained on stays the same, bit for bit.
            let make = if is_whole { Resampler::new } else { Resampler::fine };
            let resampler = resampler.insert(make(up as usize, down as usize, channels)?);
            // Output j lies at the upsampled place j × down, the first input there at padding × up + lag:
            // with the right padding that is an output.
            let lag = (resampler.delay_samples() * down as f64).round() as u64;
            padding = lag.div_ceil(up);
            while !(padding * up + lag).is_multiple_of(down) {
                padding += 1;
            }
            skip = (padding * up + lag) / down;
            outputs_of_frame = resampler.max_output_samples(1);
        }
        // No more frames are read at once than a block wants.
        let pending = Vec::with_capacity((block_samples + outputs_of_frame) * channels);
        let current = CueStart { sample: 0, segment: 0, cue: source.segments()[0].cue };
        let coming = VecDeque::with_capacity(source.segments().len());
        Ok(ReplayStream {
            source,
            sample_rate_hz,
            up,
            down,
            resampler,
            padding,
            skip,
            frames: vec![0.0; FRAMES_AT_ONCE * channels],
            newest: vec![0.0; channels],
            pending,
            skip_at_start: skip,
            inputs_before: 0,
            inputs: 0,
            next_stretch: None,
            is_at_end: false,
            next_output: 0,
            block_samples,
            current,
            coming,
            dropped_samples: 0,
        })
    }

    /// A word about the rate, if it is not brought to the outputs' exactly.
    pub fn rate_notice(&self) -> Option<Notice> {
        let (from_hz, to_hz) = (self.source.sample_rate_hz(), self.sample_rate_hz);
        let (up, down) = (self.up, self.down);
        let error_ppm = (from_hz * up as f64 / (to_hz * down as f64) - 1.0) * 1e6;
        // What remains of the numbers themselves.
        const NO_ERROR_PPM: f64 = 1e-6;
        (error_ppm.abs() > NO_ERROR_PPM).then_some(Notice::RateApproximated {
            from_hz,
            to_hz,
            up,
            down,
            error_ppm,
        })
    }

    /// The recording that is replayed.
    pub fn source(&self) -> &RecordingSource {
        &self.source
    }

    /// Samples at the end and before missing ones that did not fill a block; known once [`ReplayStream::next_block`] gave
    /// `None`.
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
        let channels = self.newest.len();
        assert_eq!(out.len(), channels * self.block_samples, "a block is channels × block_samples");
        while self.pending_samples() < self.block_samples {
            if !self.read(self.block_samples - self.pending_samples())? {
                self.dropped_samples += self.pending_samples() as u64;
                self.pending.clear();
                if !self.begin_next_stretch() {
                    return Ok(None);
                }
            }
        }
        let first_sample = self.next_output;
        self.take(out);
        while let Some(start) = self.coming.front().filter(|start| start.sample < self.next_output) {
            self.current = *start;
            self.coming.pop_front();
        }
        Ok(Some(self.block_at(first_sample)))
    }

    /// Writes the next samples, which all have the same cue, into `out`, `[channels × samples]`: as many as there are up
    /// to the next cue, but at most `most`. `None` at the end, `out` then being empty. A segment so short that no sample
    /// falls into it is passed over.
    ///
    /// # Errors
    /// When the recording cannot be read on.
    pub fn next_piece(
        &mut self,
        out: &mut Vec<f32>,
        most: NonZeroUsize,
    ) -> Result<Option<ReplayBlock>, RecordingError> {
        out.clear();
        let samples = loop {
            while let Some(start) = self.coming.front().filter(|start| start.sample <= self.next_output) {
                self.current = *start;
                self.coming.pop_front();
            }
            let left = self.coming.front().map(|next| (next.sample - self.next_output) as usize);
            let samples = left.map_or(most.get(), |left| left.min(most.get()));
            if samples <= self.pending_samples() {
                break samples;
            }
            if !self.read(usize::MAX)? && (!self.pending.is_empty() || !self.begin_next_stretch()) {
                break self.pending_samples();
            }
        };
        if samples == 0 {
            return Ok(None);
        }
        let first_sample = self.next_output;
        out.resize(samples * self.newest.len(), 0.0);
        self.take(out);
        Ok(Some(self.block_at(first_sample)))
    }

    /// The block that begins at `first_sample` and ends with a sample under the current cue.
    fn block_at(&self, first_sample: u64) -> ReplayBlock {
        let CueStart { sample: cue_since, segment, cue } = self.current;
        ReplayBlock { first_sample, cue, cue_since, segment }
    }

    fn pending_samples(&self) -> usize {
        self.pending.len() / self.newest.len()
    }

    /// Moves the oldest pending samples to `out`, `[channels × samples]`.
    fn take(&mut self, out: &mut [f32]) {
        let channels = self.newest.len();
        let samples = out.len() / channels;
        for (channel, out) in out.chunks_exact_mut(samples).enumerate() {
            for (out, frame) in out.iter_mut().zip(self.pending.chunks_exact(channels)) {
                *out = frame[channel];
            }
        }
        self.pending.drain(..samples * channels);
        self.next_output += samples as u64;
    }

    /// Takes in the frames that so many outputs need, or fewer, or what lies beyond the last of the stretch; `false` when
    /// all outputs of the stretch are made.
    fn read(&mut self, outputs: usize) -> Result<bool, RecordingError> {
        let channels = self.newest.len();
        if !self.is_at_end && self.next_stretch.is_none() {
            let wanted = (outputs as u64).saturating_mul(self.down).div_ceil(self.up);
            let room = wanted.min(FRAMES_AT_ONCE as u64) as usize;
            match self.source.next_frames(&mut self.frames[..room * channels])? {
                Some((count, frame)) if frame.samples_lost_before == 0 => {
                    self.take_in(count, frame);
                    return Ok(true);
                }
                next_stretch @ Some(_) => self.next_stretch = next_stretch,
                None => self.is_at_end = true,
            }
        }
        let end = self.output_of(self.inputs_before + self.inputs);
        if self.next_output + self.pending_samples() as u64 >= end {
            return Ok(false);
        }
        self.push_newest();
        self.pending.truncate((end - self.next_output) as usize * channels);
        Ok(true)
    }

    /// The first output at or after an input.
    fn output_of(&self, input: u64) -> u64 {
        (input * self.up).div_ceil(self.down)
    }

    /// Takes in the first `count` frames that were read.
    fn take_in(&mut self, count: usize, frame: Frame) {
        let channels = self.newest.len();
        if frame.segment != self.current.segment.max(self.coming.back().map_or(0, |last| last.segment)) {
            let sample = self.output_of(self.inputs_before + self.inputs);
            self.coming.push_back(CueStart { sample, segment: frame.segment, cue: frame.cue });
        }
        if self.inputs == 0 {
            self.newest.copy_from_slice(&self.frames[..channels]);
            for _ in 0..self.padding {
                self.push_newest();
            }
        }
        self.inputs += count as u64;
        let frames = &self.frames[..count * channels];
        self.newest.copy_from_slice(&frames[frames.len() - channels..]);
        resample(self.resampler.as_mut(), frames, &mut self.pending);
        self.skip();
    }

    /// Goes on after missing samples; `false` at the end. Nothing is pending. The first output of a stretch is its first
    /// input: where that lies between two outputs, it comes less than one output late.
    fn begin_next_stretch(&mut self) -> bool {
        let Some((count, frame)) = self.next_stretch.take() else { return false };
        self.inputs_before += self.inputs + frame.samples_lost_before;
        self.inputs = 0;
        self.next_output = self.output_of(self.inputs_before);
        self.skip = self.skip_at_start;
        if let Some(resampler) = &mut self.resampler {
            resampler.reset();
        }
        self.take_in(count, frame);
        true
    }

    /// Resamples the newest frame once more.
    fn push_newest(&mut self) {
        resample(self.resampler.as_mut(), &self.newest, &mut self.pending);
        self.skip();
    }

    /// Throws outputs away while there are some to be. Nothing before them is pending.
    fn skip(&mut self) {
        let skipped = self.skip.min(self.pending_samples() as u64);
        if skipped > 0 {
            self.skip -= skipped;
            self.pending.drain(..skipped as usize * self.newest.len());
        }
    }
}

/// Appends what `frames` give to `pending`.
fn resample(resampler: Option<&mut Resampler>, frames: &[f32], pending: &mut Vec<f32>) {
    match resampler {
        Some(resampler) => resampler.process(frames, pending),
        None => pending.extend_from_slice(frames),
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::segment::Segment;
    use crate::source::Columns;

    /// Tones from 20 to 450 Hz, each with a phase of its own, at time `time_s`.
    fn tones(time_s: f64) -> f64 {
        (2..=45).map(|tone| (TAU * 10.0 * f64::from(tone) * time_s + f64::from(tone * tone)).cos()).sum()
    }

    /// One channel in memory.
    fn one(samples: Vec<f32>) -> Columns {
        Columns { samples: vec![samples], chosen: vec![0], names: vec!["0".to_owned()], unit: String::new() }
    }

    fn stream(from_hz: f64, to_hz: f64, seconds: f64) -> ReplayStream {
        let samples = (seconds * from_hz) as usize;
        let column = (0..samples).map(|sample| tones(sample as f64 / from_hz) as f32).collect();
        let segment = Segment {
            file: "tones".into(),
            repetition: None,
            cue: None,
            end_sample: None,
            samples_lost_before: 0,
        };
        let source = RecordingSource::of_columns(one(column), vec![segment], from_hz);
        ReplayStream::of(source, to_hz, 10).unwrap()
    }

    /// Root mean square of the difference to the true signal at the output's instants, relative to the signal, in dB.
    fn error_db(from_hz: f64, to_hz: f64) -> f64 {
        let mut stream = stream(from_hz, to_hz, 4.0);
        let mut block = [0.0; 10];
        let (mut error, mut signal) = (0.0, 0.0);
        while let Some(ReplayBlock { first_sample, .. }) = stream.next_block(&mut block).unwrap() {
            for (sample, value) in (first_sample..).zip(block) {
                let time_s = sample as f64 / to_hz;
                // The recording has no more to tell about its ends.
                if (0.1..3.9).contains(&time_s) {
                    error += (f64::from(value) - tones(time_s)).powi(2);
                    signal += tones(time_s).powi(2);
                }
            }
        }
        10.0 * (error / signal).log10()
    }

    #[test]
    fn rates_of_amplifiers_that_are_no_whole_numbers_are_brought_to_the_sessions_within_60_db() {
        for (from_hz, to_hz) in [
            (1925.926, 2000.0),
            (26.0 / 0.0135, 2000.0),
            (1259.259, 2000.0),
            (2148.148, 2000.0),
            (2222.222, 2000.0),
            (1111.111, 2000.0),
            (2000.0, 1925.926),
        ] {
            let error_db = error_db(from_hz, to_hz);
            println!("{from_hz} Hz to {to_hz} Hz: {error_db:.1} dB");
            assert!(error_db < -60.0, "{from_hz} Hz to {to_hz} Hz: {error_db:.1} dB");
        }
    }

    #[test]
    fn the_smallest_numbers_that_come_near_are_taken() {
        for (from_hz, to_hz, up, down) in [
            (1000.0, 2000.0, 2, 1),
            (1999.0, 2000.0, 2000, 1999),
            (1925.926, 2000.0, 27, 26),
            (26.0 / 0.0135, 2000.0, 27, 26),
            (1259.259, 2000.0, 27, 17),
            (2148.148, 2000.0, 27, 29),
            (2000.0, 1259.259, 17, 27),
            (2000.0, 666.6666667, 1, 3),
            (1999.9999, 2000.0, 1, 1),
            (0.5, 1.0, 2, 1),
        ] {
            assert_eq!(ratio(from_hz, to_hz).unwrap(), (up, down), "{from_hz} to {to_hz}");
            let stream = stream(from_hz.max(1.0), to_hz, 4.0);
            let is_exact =
                (from_hz.max(1.0) * stream.up as f64 / (to_hz * stream.down as f64) - 1.0).abs() < 1e-12;
            assert_eq!(stream.rate_notice().is_none(), is_exact, "{from_hz} to {to_hz}");
        }
        for (from_hz, to_hz) in [(0.0, 2000.0), (f64::NAN, 2000.0), (-1.0, 2000.0), (1.0, 1e6), (1e6, 1.5)] {
            assert!(ratio(from_hz, to_hz).is_err(), "{from_hz} to {to_hz}");
        }
        let notice = stream(1925.926, 2000.0, 1.0).rate_notice().unwrap().to_string();
        assert_eq!(
            notice,
            "1925.926 Hz is brought to 2000 Hz by the ratio 27/26, 0.038 ppm off: 0.1 ms in an hour"
        );
    }

    #[test]
    fn missing_samples_divide_a_recording_into_stretches_that_no_block_spans() {
        let value = |time_s: f64| 1000.0 + 200.0 * (std::f64::consts::TAU * 20.0 * time_s).sin();
        for rate_hz in [1000.0, 2000.0, 600.0] {
            // 30 ms that end a segment, and 1 ms within the next one.
            let parts = [(None, 0, 0..200), (Some(30), 30, 230..400), (Some(1), 1, 401..600)];
            let samples: Vec<f32> = parts
                .iter()
                .flat_map(|(_, _, range)| range.clone())
                .map(|sample| value(f64::from(sample) / 1000.0) as f32)
                .collect();
            let mut end = 0;
            let segments = parts.iter().map(|(_, lost, range)| {
                end += range.len() as u64;
                Segment {
                    file: "emg".into(),
                    repetition: Some(0),
                    cue: Some(Gesture::REST),
                    end_sample: Some(end),
                    samples_lost_before: *lost,
                }
            });
            let source = RecordingSource::of_columns(one(samples), segments.collect(), 1000.0);
            let mut stream = ReplayStream::of(source, rate_hz, 5).unwrap();
            let mut block = [0.0; 5];
            let mut starts = Vec::new();
            while let Some(read) = stream.next_block(&mut block).unwrap() {
                starts.push(read.first_sample);
                for (at, sample) in (read.first_sample..).zip(block) {
                    let time_s = at as f64 / rate_hz;
                    let error = f64::from(sample) - value(time_s);
                    // Where a stretch begins or ends, its last sample is held for the low-pass; an input that is no output
                    // comes up to one output late.
                    assert!(error.abs() < 60.0, "{rate_hz} Hz, sample {at}: off by {error}");
                }
            }
            let ratio = rate_hz / 1000.0;
            let jumps: Vec<(u64, u64)> = starts
                .windows(2)
                .filter(|pair| pair[1] != pair[0] + 5)
                .map(|pair| (pair[0] + 5, pair[1]))
                .collect();
            let end_of = |inputs: f64| ((inputs * ratio).ceil() / 5.0).floor() as u64 * 5;
            assert_eq!(jumps.len(), 2, "{rate_hz} Hz: {jumps:?}");
            assert_eq!(jumps[0], (end_of(200.0), (230.0 * ratio).ceil() as u64), "{rate_hz} Hz");
            assert_eq!(jumps[1].1, (401.0 * ratio).ceil() as u64, "{rate_hz} Hz");
        }
    }

    #[test]
    fn pieces_end_where_samples_are_missing() {
        let segment = |end_sample, samples_lost_before| Segment {
            file: "emg".into(),
            repetition: Some(0),
            cue: Some(Gesture::REST),
            end_sample,
            samples_lost_before,
        };
        let samples: Vec<f32> = (0..50).map(|sample| sample as f32).collect();
        let segments = vec![segment(Some(20), 0), segment(None, 7)];
        let source = RecordingSource::of_columns(one(samples), segments, 1000.0);
        let mut stream = ReplayStream::of(source, 2000.0, 1).unwrap();
        let mut piece = Vec::new();
        let mut pieces = Vec::new();
        while let Some(read) = stream.next_piece(&mut piece, NonZeroUsize::MAX).unwrap() {
            pieces.push((read.first_sample, read.segment, read.cue_since, piece.len()));
        }
        assert_eq!(pieces, [(0, 0, 0, 40), (54, 1, 54, 60)]);
    }
}
