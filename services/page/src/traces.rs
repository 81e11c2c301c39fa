//! The filtered signal as a browser draws it: the least and the greatest value of every bin of 8 ms.
//!
//! ```text
//! block ─▶ SignalChain (that of dsp) ─┬─ filtered samples ─▶ bins ─▶ frame [channels × bins × (least, greatest)]
//!                                     ├─ envelope, its median at rest ─▶
//!                                     └─ faults, samples that are no numbers ─▶ lamps
//! ```
//! A bin's number is its place in the source's count of samples. Bins in which samples were lost are NaN.

use tendon_config::Config;
use tendon_messages::BlockHeader;
use tendon_signal::{DesignError, SignalChain};

/// Length of a bin, rounded to samples, s.
const BIN_S: f64 = 0.008;
/// What a frame begins with: "TEMG" and the version of its layout.
const FRAME_WORD: u32 = 0x474d_4554;
const FRAME_VERSION: u32 = 1;
/// Bins that wait for a frame at most; a longer gap in the signal is left out altogether.
const MOST_BINS: u64 = 64;
/// What the chain measures of rest counts only if it saw the session's rest: from so long after its first sample at most, s.
const REST_FROM_S: f64 = 2.0;
/// How long a channel's lamp says that it was no number, s.
const LOST_SHOWN_S: f64 = 0.5;

/// All channels of a session.
#[derive(Debug)]
pub struct Traces {
    config: Config,
    chain: SignalChain,
    channels: usize,
    sample_rate_hz: f64,
    bin_samples: u64,
    /// Number of the next sample; `None` before the first block.
    next_sample: Option<u64>,
    /// Least and greatest of each channel in the bin that is being filled.
    open: Vec<[f32; 2]>,
    /// `[bins × channels]`, complete, not in a frame yet.
    complete: Vec<[f32; 2]>,
    first_bin: u64,
    /// When the last sample of the newest complete bin was captured.
    captured_ns: u64,
    knows_rest: bool,
    /// Until which sample each channel's lamp says that it was lost.
    lost_until: Vec<u64>,
}

const NOTHING: [f32; 2] = [f32::NAN; 2];

impl Traces {
    /// For the channels and filters of this session.
    ///
    /// # Errors
    ///
    /// [`DesignError`] for settings that cannot work.
    pub fn new(config: &Config) -> Result<Traces, DesignError> {
        let (channels, sample_rate_hz) = (config.acquisition.channels, config.acquisition.sample_rate_hz);
        Ok(Traces {
            config: config.clone(),
            chain: SignalChain::new(&config.dsp, channels, sample_rate_hz)?,
            channels,
            sample_rate_hz,
            bin_samples: (BIN_S * sample_rate_hz).round().max(1.0) as u64,
            next_sample: None,
            open: vec![NOTHING; channels],
            complete: Vec::new(),
            first_bin: 0,
            captured_ns: 0,
            knows_rest: false,
            lost_until: vec![0; channels],
        })
    }

    /// Length of a bin in ms.
    pub fn bin_ms(&self) -> f64 {
        1e3 * self.bin_samples as f64 / self.sample_rate_hz
    }

    /// Takes the next block, `[channels × samples]`. One of another shape is passed over.
    ///
    /// # Errors
    ///
    /// [`DesignError`] as in [`Traces::new`], when the source began anew.
    pub fn take(&mut self, header: &BlockHeader, block: &[f32]) -> Result<(), DesignError> {
        let samples = header.samples as usize;
        if samples == 0 || header.channels as usize != self.channels || block.len() != samples * self.channels
        {
            return Ok(());
        }
        match self.next_sample {
            Some(expected) if header.first_sample >= expected => {
                self.pass_over(expected, header.first_sample)
            }
            Some(_) => *self = Traces::new(&self.config.clone())?,
            None => {}
        }
        if self.next_sample.is_none() {
            self.knows_rest = header.first_sample as f64 <= REST_FROM_S * self.sample_rate_hz;
            self.first_bin = header.first_sample / self.bin_samples;
        }
        if header.non_finite_samples > 0 {
            self.look_for_lost(header.first_sample, block, samples);
        }
        let mut from = 0;
        while from < samples {
            let consumed = self.chain.push(block, from).consumed;
            self.fill(header.first_sample + from as u64, consumed);
            from += consumed;
        }
        let next = header.first_sample + samples as u64;
        self.next_sample = Some(next);
        let behind = (next % self.bin_samples) as f64 / self.sample_rate_hz;
        self.captured_ns = header.trace.captured_ns.saturating_sub((1e9 * behind) as u64);
        Ok(())
    }

    /// Samples `from..to` are missing.
    fn pass_over(&mut self, from: u64, to: u64) {
        if from == to {
            return;
        }
        self.chain.gap(to - from);
        if to / self.bin_samples - from / self.bin_samples > MOST_BINS {
            self.complete.clear();
            self.open.fill(NOTHING);
            self.first_bin = to / self.bin_samples;
            return;
        }
        for _ in from / self.bin_samples..to / self.bin_samples {
            self.close_bin();
        }
    }

    /// Puts the samples of the chain's last push into their bins.
    fn fill(&mut self, first_sample: u64, count: usize) {
        let mut from = 0;
        while from < count {
            let in_bin = (first_sample + from as u64) % self.bin_samples;
            let to = count.min(from + (self.bin_samples - in_bin) as usize);
            for ([least, greatest], samples) in self.open.iter_mut().zip(self.chain.filtered()) {
                for sample in &samples[from..to] {
                    // The other number where one is NaN.
                    *least = least.min(*sample);
                    *greatest = greatest.max(*sample);
                }
            }
            if in_bin + (to - from) as u64 == self.bin_samples {
                self.close_bin();
            }
            from = to;
        }
    }

    fn close_bin(&mut self) {
        if self.complete.len() as u64 >= MOST_BINS * self.channels as u64 {
            self.complete.drain(..self.channels);
            self.first_bin += 1;
        }
        self.complete.append(&mut self.open);
        self.open.resize(self.channels, NOTHING);
    }

    fn look_for_lost(&mut self, first_sample: u64, block: &[f32], samples: usize) {
        let until = first_sample + (LOST_SHOWN_S * self.sample_rate_hz) as u64;
        for (lost_until, channel) in self.lost_until.iter_mut().zip(block.chunks_exact(samples)) {
            if channel.iter().any(|sample| !sample.is_finite()) {
                *lost_until = until;
            }
        }
    }

    /// The bins since the last frame, and the envelope now and at rest, as the page reads them; `None` if no bin is complete.
    pub fn frame(&mut self) -> Option<Vec<u8>> {
        let bins = self.complete.len() / self.channels;
        if bins == 0 {
            return None;
        }
        let mut frame = Vec::with_capacity(32 + 4 * self.channels * (2 * bins + 2));
        frame.extend(FRAME_WORD.to_le_bytes());
        frame.extend(FRAME_VERSION.to_le_bytes());
        frame.extend(self.first_bin.to_le_bytes());
        frame.extend(self.captured_ns.to_le_bytes());
        frame.extend((self.channels as u32).to_le_bytes());
        frame.extend((bins as u32).to_le_bytes());
        for channel in 0..self.channels {
            for bin in self.complete.chunks_exact(self.channels) {
                frame.extend(bin[channel].iter().flat_map(|value| value.to_le_bytes()));
            }
        }
        let envelope = self.chain.envelope().iter().copied();
        let rest = self.chain.baselines().filter(|_| self.knows_rest);
        let rest = (0..self.channels).map(|channel| rest.map_or(f32::NAN, |rest| rest[channel].median));
        frame.extend(envelope.chain(rest).flat_map(f32::to_le_bytes));
        self.first_bin += bins as u64;
        self.complete.clear();
        Some(frame)
    }

    /// When the newest complete bin ended, CLOCK_MONOTONIC ns.
    pub fn captured_ns(&self) -> u64 {
        self.captured_ns
    }

    /// Channels that are unlike muscles, and how.
    pub fn troubles(&self) -> Vec<(usize, String)> {
        let next = self.next_sample.unwrap_or_default();
        let trouble = |(channel, fault): (usize, &Option<tendon_signal::Fault>)| {
            let lost = (next < self.lost_until[channel]).then(|| "lost".to_owned());
            lost.or(fault.map(|fault| fault.to_string())).map(|kind| (channel, kind))
        };
        self.chain.faults().iter().enumerate().filter_map(trouble).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK: u64 = 10;

    struct Frame {
        first_bin: u64,
        captured_ns: u64,
        bins: usize,
        values: Vec<f32>,
    }

    fn read(frame: &[u8]) -> Frame {
        let long = |at: usize| u64::from_le_bytes(frame[at..at + 8].try_into().unwrap());
        let word = |at: usize| u32::from_le_bytes(frame[at..at + 4].try_into().unwrap());
        assert_eq!((&frame[..4], word(4)), (&b"TEMG"[..], 1));
        let values = frame[32..].chunks_exact(4).map(|value| f32::from_le_bytes(value.try_into().unwrap()));
        Frame { first_bin: long(8), captured_ns: long(16), bins: word(28) as usize, values: values.collect() }
    }

    /// Traces of two channels at 2000 Hz, so of bins of 16 samples.
    fn traces() -> Traces {
        let mut config = Config::default();
        config.acquisition.channels = 2;
        Traces::new(&config).unwrap()
    }

    fn header(first_sample: u64) -> BlockHeader {
        let mut header =
            BlockHeader { first_sample, channels: 2, samples: BLOCK as u32, ..BlockHeader::default() };
        header.trace.captured_ns = (first_sample + BLOCK) * 500_000;
        header
    }

    fn value(sample: u64) -> f32 {
        ((sample * 7919) % 101) as f32 - 50.0
    }

    fn take(traces: &mut Traces, samples: std::ops::Range<u64>) {
        for first in samples.step_by(BLOCK as usize) {
            let channel = |factor: f32| (first..first + BLOCK).map(move |sample| factor * value(sample));
            let block: Vec<f32> = channel(1.0).chain(channel(-2.0)).collect();
            traces.take(&header(first), &block).unwrap();
        }
    }

    #[test]
    fn bins_hold_the_extremes_of_what_dsp_filters() {
        let mut traces = traces();
        take(&mut traces, 0..100);
        let frame = read(&traces.frame().unwrap());
        assert_eq!((frame.first_bin, frame.bins, frame.values.len()), (0, 6, 2 * (2 * 6 + 2)));
        // Sample 96 is the first of the bin that is not complete.
        assert_eq!(frame.captured_ns, 96 * 500_000);
        let config = Config::default();
        let mut filter = tendon_signal::EmgFilter::new(&config.dsp.filter, 1, 2000.0).unwrap();
        let mut filtered: Vec<f32> = (0..96).map(value).collect();
        filter.process(0, &mut filtered);
        for (bin, samples) in filtered.chunks(16).enumerate() {
            let least = samples.iter().copied().fold(f32::INFINITY, f32::min);
            let greatest = samples.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            assert_eq!(frame.values[2 * bin..2 * bin + 2], [least, greatest]);
            // The filter is linear.
            assert_eq!(frame.values[12 + 2 * bin..][..2], [-2.0 * greatest, -2.0 * least]);
        }
        assert!(frame.values[24..26].iter().all(|envelope| *envelope > 0.0));
        assert!(frame.values[26..].iter().all(|rest| rest.is_nan()));
        assert_eq!(traces.frame(), None);
        take(&mut traces, 100..120);
        assert_eq!(read(&traces.frame().unwrap()).first_bin, 6);
    }

    #[test]
    fn lost_samples_are_bins_of_nothing_and_a_source_that_began_anew_counts_anew() {
        let mut traces = traces();
        take(&mut traces, 0..20);
        take(&mut traces, 80..100);
        let frame = read(&traces.frame().unwrap());
        assert_eq!((frame.first_bin, frame.bins), (0, 6));
        let is_known: Vec<bool> = frame.values[..12].iter().map(|value| value.is_finite()).collect();
        assert_eq!(is_known, [true, true, true, true, false, false, false, false, false, false, true, true]);
        // Too long to be drawn.
        take(&mut traces, 100_000..100_100);
        assert_eq!(read(&traces.frame().unwrap()).first_bin, 100_000 / 16);
        take(&mut traces, 0..20);
        assert_eq!(read(&traces.frame().unwrap()).first_bin, 0);
    }

    #[test]
    fn nobody_who_asks_for_no_frames_makes_them_grow() {
        let mut traces = traces();
        take(&mut traces, 0..100_000);
        let frame = read(&traces.frame().unwrap());
        assert_eq!((frame.bins as u64, frame.first_bin), (MOST_BINS, 100_000 / 16 - MOST_BINS));
    }

    #[test]
    fn a_channel_that_is_no_number_is_lost_and_one_that_is_flat_is_flat() {
        let mut traces = traces();
        let mut at = 0;
        for _ in 0..200 {
            let mut block: Vec<f32> = (at..at + BLOCK).map(value).collect();
            block.extend([0.0; BLOCK as usize]);
            block[0] = f32::NAN;
            let header = BlockHeader { non_finite_samples: 1, ..header(at) };
            traces.take(&header, &block).unwrap();
            at += BLOCK;
        }
        let troubles = traces.troubles();
        assert_eq!(troubles, [(0, "lost".to_owned()), (1, "flat".to_owned())]);
        // A block of another shape is none.
        traces.take(&header(at), &[0.0; 3]).unwrap();
    }
}
