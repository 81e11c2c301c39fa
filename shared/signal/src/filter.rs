//! The causal filter of the paper: a notch against mains hum, then a Butterworth band-pass, per channel.
//!
//! ```text
//! f32 sample ─▶ usable? ─▶ notch ─▶ section ─▶ … ─▶ section ─▶ f32 sample
//!                 │ no: the channel's last good sample      (state and signal in f64 between)
//! ```
//! The output is bit-identical however the samples are divided into blocks, and whether channels are filtered
//! together or one by one. Together is faster: each output of a section waits for the previous one, and while
//! one channel waits, others are computed in the neighbouring vector lanes.

use std::ops::Range;
use std::slice;

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};

use crate::design::{Section, butterworth_band_pass, butterworth_high_pass, notch};
use crate::error::DesignError;

/// Samples beyond this (in whatever unit the source has) count as faults, like NaN and infinity: no amplifier
/// or converter produces them, and the filter's output could leave the range of `f32`.
pub const LARGEST_SAMPLE: f32 = 1e12;

/// How the samples are filtered. Part of `tendon.toml` and of a model's metadata: a model fits a session only
/// if both agree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FilterSettings {
    /// Mains frequency to remove, in Hz (60 or 50, depending on the country); `"off"` for no notch.
    #[serde(serialize_with = "write_notch", deserialize_with = "read_notch")]
    pub notch_hz: Option<f64>,
    /// Frequency / width of the notch at -3 dB.
    pub notch_quality: f64,
    /// Lower and upper edge of the band-pass, in Hz, at -3 dB. If the upper edge is at or above half the
    /// sampling rate, only the lower one is applied.
    pub band_pass_hz: [f64; 2],
    /// Order of the Butterworth band-pass in SciPy's sense: the steepness at each edge.
    pub band_pass_order: usize,
}

impl Default for FilterSettings {
    /// The paper's: 60 Hz notch, sixth-order 5 to 500 Hz.
    fn default() -> FilterSettings {
        FilterSettings {
            notch_hz: Some(60.0),
            notch_quality: 30.0,
            band_pass_hz: [5.0, 500.0],
            band_pass_order: 6,
        }
    }
}

impl FilterSettings {
    /// The sections of the filter in the order in which they are applied.
    ///
    /// With the upper edge at or above half the sampling rate the band-pass becomes a high-pass of the same
    /// order: nothing is left above the edge to remove, because the recorder's own anti-alias filter limited
    /// the band before sampling.
    ///
    /// # Errors
    /// The first setting that does not fit.
    pub fn sections(&self, sample_rate_hz: f64) -> Result<Vec<Section>, DesignError> {
        let [low_hz, high_hz] = self.band_pass_hz;
        let order = self.band_pass_order;
        let mut sections = Vec::new();
        if let Some(frequency_hz) = self.notch_hz {
            sections.push(notch(frequency_hz, self.notch_quality, sample_rate_hz)?);
        }
        let is_high_pass = high_hz.is_finite() && low_hz < high_hz && high_hz >= sample_rate_hz / 2.0;
        sections.extend(if is_high_pass {
            butterworth_high_pass(order, low_hz, sample_rate_hz)?
        } else {
            butterworth_band_pass(order, low_hz, high_hz, sample_rate_hz)?
        });
        Ok(sections)
    }
}

fn write_notch<S: Serializer>(notch_hz: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    // TOML has no null, and a missing key means the default, so "off" must be written out.
    match notch_hz {
        Some(frequency_hz) => serializer.serialize_f64(*frequency_hz),
        None => serializer.serialize_str("off"),
    }
}

fn read_notch<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    struct NotchVisitor;

    impl Visitor<'_> for NotchVisitor {
        type Value = Option<f64>;

        fn expecting(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            formatter.write_str("the mains frequency in Hz, or \"off\"")
        }
        fn visit_f64<E: de::Error>(self, value: f64) -> Result<Option<f64>, E> {
            Ok(Some(value))
        }
        fn visit_i64<E: de::Error>(self, value: i64) -> Result<Option<f64>, E> {
            Ok(Some(value as f64))
        }
        fn visit_u64<E: de::Error>(self, value: u64) -> Result<Option<f64>, E> {
            Ok(Some(value as f64))
        }
        fn visit_str<E: de::Error>(self, value: &str) -> Result<Option<f64>, E> {
            if value == "off" { Ok(None) } else { Err(E::invalid_value(de::Unexpected::Str(value), &self)) }
        }
    }

    deserializer.deserialize_any(NotchVisitor)
}

/// The streaming filter of all channels of a session.
#[derive(Clone, Debug)]
pub struct EmgFilter {
    sections: Vec<Section>,
    channels: Vec<ChannelState>,
}

#[derive(Clone, Debug)]
struct ChannelState {
    /// The two delayed sums of each section, in transposed direct form II.
    delays: Vec<[f64; 2]>,
    /// `None` until the first usable sample.
    last_good: Option<f32>,
    /// Samples until the decayed delays are next set to zero, 1 to [`FLUSH_INTERVAL`].
    until_flush: usize,
}

/// Decayed delays are set to zero after this many samples of a channel. Counted in samples, not in blocks, so
/// that the output does not depend on how the samples are divided.
const FLUSH_INTERVAL: usize = 64;

/// Below this, a delay is practically zero. To reach the range where `f64` becomes subnormal (1e-308) and
/// arithmetic slow, it would have to shrink by more than any band-pass shrinks it in one interval.
const DECAYED: f64 = 1e-30;

impl EmgFilter {
    /// Designs the filter for `channels` channels.
    ///
    /// # Errors
    /// The first setting that does not fit.
    pub fn new(
        settings: &FilterSettings,
        channels: usize,
        sample_rate_hz: f64,
    ) -> Result<EmgFilter, DesignError> {
        if channels == 0 {
            return Err(DesignError::NoChannels);
        }
        let sections = settings.sections(sample_rate_hz)?;
        let channel = ChannelState {
            delays: vec![[0.0; 2]; sections.len()],
            last_good: None,
            until_flush: FLUSH_INTERVAL,
        };
        Ok(EmgFilter { sections, channels: vec![channel; channels] })
    }

    /// Filters the next samples of `channel` in place and returns how many of them were unusable (NaN,
    /// infinite, beyond [`LARGEST_SAMPLE`]) and replaced by the channel's last good sample.
    ///
    /// The filter starts as if the first good sample had lasted for ever, so that an offset of thousands of
    /// counts does not ring. Before it, the output is 0.
    ///
    /// # Panics
    /// If there is no such channel.
    pub fn process(&mut self, channel: usize, samples: &mut [f32]) -> u32 {
        let length = samples.len();
        process_group(&self.sections, slice::from_mut(&mut self.channels[channel]), samples, 0..length)
    }

    /// Like [`EmgFilter::process`], for all channels: filters the range `samples` of each channel of
    /// `signal`, `[channels × any number]`, in place.
    ///
    /// # Panics
    /// If the length of `signal` is not a multiple of the number of channels, or `samples` is out of range.
    pub fn process_all(&mut self, signal: &mut [f32], samples: Range<usize>) -> u32 {
        assert!(signal.len().is_multiple_of(self.channels.len()), "a signal is channels × samples");
        let length = signal.len() / self.channels.len();
        assert!(samples.end <= length, "{samples:?} of {length} samples");
        if samples.is_empty() {
            return 0;
        }
        let groups = self.channels.chunks_mut(LANES).zip(signal.chunks_mut(LANES * length));
        groups.map(|(states, signal)| process_group(&self.sections, states, signal, samples.clone())).sum()
    }
}

/// Channels that are filtered side by side: two of the narrowest vectors that processors have.
const LANES: usize = 4;

/// Filters the `samples` of each channel of `signal`, `[states × any number]`, of which there are at most [`LANES`].
fn process_group(
    sections: &[Section],
    states: &mut [ChannelState],
    signal: &mut [f32],
    samples: Range<usize>,
) -> u32 {
    let length = signal.len() / states.len();
    let mut started_at = [samples.start; LANES];
    let started_at = &mut started_at[..states.len()];
    let mut replaced = 0;
    for (channel, (state, started_at)) in states.iter_mut().zip(&mut *started_at).enumerate() {
        if state.last_good.is_none() {
            let samples = &mut signal[channel * length..][samples.clone()];
            let silent = state.start(sections, samples);
            samples[..silent].fill(0.0);
            *started_at += silent;
            replaced += silent as u32;
        }
    }
    if started_at.iter().all(|start| *start == started_at[0]) {
        let samples = started_at[0]..samples.end;
        return replaced
            + match states {
                [_] => process_lanes::<1>(sections, states, signal, samples),
                _ => process_lanes::<LANES>(sections, states, signal, samples),
            };
    }
    for ((state, signal), start) in states.iter_mut().zip(signal.chunks_exact_mut(length)).zip(started_at) {
        replaced += process_lanes::<1>(sections, slice::from_mut(state), signal, *start..samples.end);
    }
    replaced
}

/// Like [`process_group`], for at most `N` channels that have all started.
fn process_lanes<const N: usize>(
    sections: &[Section],
    states: &mut [ChannelState],
    signal: &mut [f32],
    samples: Range<usize>,
) -> u32 {
    let length = signal.len() / states.len();
    let mut replaced = 0;
    let mut buffer = [[0.0; N]; FLUSH_INTERVAL];
    let mut start = samples.start;
    while start < samples.end {
        let until_flush = states.iter().map(|state| state.until_flush).min().unwrap_or(FLUSH_INTERVAL);
        let end = samples.end.min(start + until_flush);
        let buffer = &mut buffer[..end - start];
        for (lane, (state, signal)) in states.iter_mut().zip(signal.chunks_exact(length)).enumerate() {
            replaced += state.fill_lane(&signal[start..end], buffer, lane);
        }
        for (number, section) in sections.iter().enumerate() {
            let mut delays = [[0.0; N]; 2];
            for (lane, state) in states.iter().enumerate() {
                [delays[0][lane], delays[1][lane]] = state.delays[number];
            }
            run_section(section, &mut delays, buffer);
            for (lane, state) in states.iter_mut().enumerate() {
                state.delays[number] = [delays[0][lane], delays[1][lane]];
            }
        }
        for (lane, (state, signal)) in states.iter_mut().zip(signal.chunks_exact_mut(length)).enumerate() {
            for (sample, values) in signal[start..end].iter_mut().zip(&*buffer) {
                *sample = values[lane] as f32;
            }
            state.flush_after(end - start);
        }
        start = end;
    }
    replaced
}

/// Whether a working source can have produced the sample.
pub(crate) fn is_usable(sample: f32) -> bool {
    // False for NaN.
    sample.abs() <= LARGEST_SAMPLE
}

impl ChannelState {
    /// Settles the delays on the first usable sample and returns its position, or the number of samples if
    /// there is none.
    fn start(&mut self, sections: &[Section], samples: &[f32]) -> usize {
        let Some(first) = samples.iter().position(|&sample| is_usable(sample)) else {
            return samples.len();
        };
        self.last_good = Some(samples[first]);
        // The steady state of each section for a constant input, as SciPy's sosfilt_zi.
        let mut input = f64::from(samples[first]);
        for (section, delay) in sections.iter().zip(&mut self.delays) {
            let output = input * section.gain_at_zero_hz();
            *delay = [output - section.b[0] * input, section.b[2] * input - section.a[1] * output];
            input = output;
        }
        first
    }

    /// Writes `samples` to a lane of `buffer`, with the last good one in place of each unusable one, and
    /// counts those.
    fn fill_lane<const N: usize>(&mut self, samples: &[f32], buffer: &mut [[f64; N]], lane: usize) -> u32 {
        let mut replaced = 0;
        let mut last_good = self.last_good.unwrap_or(0.0);
        for (values, &sample) in buffer.iter_mut().zip(samples) {
            if is_usable(sample) {
                last_good = sample;
            } else {
                replaced += 1;
            }
            values[lane] = f64::from(last_good);
        }
        self.last_good = Some(last_good);
        replaced
    }

    /// Counts samples, at most `until_flush`, and sets decayed delays to zero where it is time.
    fn flush_after(&mut self, samples: usize) {
        self.until_flush -= samples;
        if self.until_flush == 0 {
            self.until_flush = FLUSH_INTERVAL;
            for delay in self.delays.iter_mut().flatten().filter(|delay| delay.abs() < DECAYED) {
                *delay = 0.0;
            }
        }
    }
}

/// Transposed direct form II over one piece of the channels in the lanes, the delays in registers.
///
/// Compiled separately, every operation becomes one on vectors of neighbouring lanes. Inlined, the compiler
/// mixes in the surrounding code and shuffles lanes more than it computes.
#[inline(never)]
fn run_section<const N: usize>(section: &Section, delays: &mut [[f64; N]; 2], signal: &mut [[f64; N]]) {
    let [b0, b1, b2] = section.b;
    let [a1, a2] = section.a;
    let [mut delays_1, mut delays_2] = *delays;
    for values in signal {
        for lane in 0..N {
            let input = values[lane];
            let output = b0 * input + delays_1[lane];
            delays_1[lane] = (b1 * input + delays_2[lane]) - a1 * output;
            delays_2[lane] = b2 * input - a2 * output;
            values[lane] = output;
        }
    }
    *delays = [delays_1, delays_2];
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filter() -> EmgFilter {
        EmgFilter::new(&FilterSettings::default(), 1, 2000.0).expect("the defaults fit")
    }

    #[test]
    fn settings_survive_toml_and_json_the_notch_off_too() {
        for notch_hz in [Some(50.0), None] {
            let settings = FilterSettings { notch_hz, ..FilterSettings::default() };
            let text = toml::to_string(&settings).expect("writes");
            assert_eq!(toml::from_str::<FilterSettings>(&text), Ok(settings.clone()), "{text}");
            let text = serde_json::to_string(&settings).expect("writes");
            assert_eq!(serde_json::from_str::<FilterSettings>(&text).expect("reads"), settings);
        }
        assert_eq!(toml::from_str::<FilterSettings>(""), Ok(FilterSettings::default()));
        assert_eq!(toml::from_str::<FilterSettings>("notch_hz = 60"), Ok(FilterSettings::default()));
        let error = toml::from_str::<FilterSettings>("notch_hz = \"on\"").expect_err("neither");
        assert!(error.message().contains("the mains frequency in Hz, or \"off\""), "{error}");
        assert!(toml::from_str::<FilterSettings>("notch = 60").is_err(), "unknown keys are errors");
    }

    #[test]
    fn the_band_is_a_high_pass_only_where_its_upper_edge_is_out_of_reach() {
        let sections = |rate_hz| FilterSettings::default().sections(rate_hz).expect("fits").len();
        assert_eq!(sections(2000.0), 1 + 6);
        assert_eq!(sections(1001.0), 1 + 6);
        assert_eq!(sections(1000.0), 1 + 3);
        let swapped = FilterSettings { band_pass_hz: [700.0, 600.0], ..FilterSettings::default() };
        assert!(matches!(swapped.sections(1000.0), Err(DesignError::BandEdges { .. })));
    }

    #[test]
    fn an_offset_does_not_ring_even_after_a_bad_start() {
        let mut samples = [f32::NAN, f32::INFINITY, 30_000.0, 30_000.0, f32::NAN, 30_000.0];
        assert_eq!(filter().process(0, &mut samples), 3);
        assert!(samples.iter().all(|sample| sample.abs() < 1e-3), "{samples:?}");
    }

    #[test]
    fn a_bad_sample_counts_as_the_last_good_one() {
        let mut with_bad = [3.0, 7.0, f32::NAN, f32::NEG_INFINITY, 2e12, -5.0];
        let mut without = [3.0, 7.0, 7.0, 7.0, 7.0, -5.0];
        assert_eq!(filter().process(0, &mut with_bad), 3);
        assert_eq!(filter().process(0, &mut without), 0);
        assert_eq!(with_bad, without);
    }

    #[test]
    fn channels_filtered_together_are_the_same_to_the_bit_as_one_by_one() {
        for channels in [1, 3, 4, 9] {
            // Channel 2 has its first good sample late and others have bad ones on the way.
            let sample = |channel: usize, n: usize| match (channel, n) {
                (2, ..70) | (1, 100..103) | (8, 30) => f32::NAN,
                _ => ((n * (channel + 7)) % 23) as f32 * 10.0 - 90.0,
            };
            let settings = FilterSettings::default();
            let mut together = EmgFilter::new(&settings, channels, 2000.0).expect("a filter");
            let mut alone = together.clone();
            let mut signal: Vec<f32> =
                (0..channels).flat_map(|channel| (0..300).map(move |n| sample(channel, n))).collect();
            let mut expected = signal.clone();
            let replaced: u32 = expected
                .chunks_exact_mut(300)
                .enumerate()
                .map(|(channel, samples)| alone.process(channel, samples))
                .sum();
            // Only these are touched, in pieces of any length.
            let pieces = [0..1, 1..50, 50..50, 50..100, 100..300];
            assert_eq!(
                pieces.map(|samples| together.process_all(&mut signal, samples)).iter().sum::<u32>(),
                replaced
            );
            assert!(signal.iter().map(|sample| sample.to_bits()).eq(expected.iter().map(|s| s.to_bits())));
        }
    }

    #[test]
    fn decayed_delays_become_zero_and_never_subnormal() {
        // These poles decay to subnormal f64 within 15 s; those of the defaults take minutes.
        let settings =
            FilterSettings { notch_quality: 3.0, band_pass_hz: [50.0, 500.0], ..FilterSettings::default() };
        let mut filter = EmgFilter::new(&settings, 1, 2000.0).expect("a filter");
        filter.process(0, &mut [0.0, 1000.0]);
        for _ in 0..3000 {
            filter.process(0, &mut [0.0; 10]);
            for &delay in filter.channels[0].delays.iter().flatten() {
                assert!(delay == 0.0 || delay.is_normal(), "{delay:e}");
            }
        }
        assert!(filter.channels[0].delays.iter().flatten().all(|&delay| delay == 0.0));
    }
}
