//! How well each channel was recorded.
//!
//! ```text
//! windows of rest ──┬─▶ RMS, median ───────────┐
//!                   └─▶ mains lines, median    ├─▶ ChannelQuality
//! windows of gestures ─▶ RMS, mean of power ───┤
//! samples as acquired ─▶ ClippingWatch ────────┘
//! ```
//!
//! Medians, so that one rest in which somebody moved says nothing.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::effort::{quantile, rms};
use crate::person::LARGEST_VALUE;

/// The frequencies of the mains.
const MAINS_HZ: [f64; 2] = [50.0, 60.0];
/// Lines of the mains that are looked at: the mains frequency and its multiples.
const LINES: usize = 3;
/// From a line to those beside it that show what the spectrum is without it, in bins of the window: a Hann window's first
/// zeros, where the line itself is not seen.
const BESIDE_BINS: f64 = 2.0;
/// Windows of rest in which mains hum is looked for; more say the same.
const HUM_WINDOWS: usize = 200;
/// Samples of one value in a row, at the largest or smallest value, that are called clipped.
const CLIPPED_RUN: u32 = 3;

/// What is known of one channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelQuality {
    /// Its name.
    pub name: String,
    /// RMS at rest, in the unit of the source: of the median window.
    pub rest_rms: f64,
    /// How much stronger the gestures are than rest, dB; 0 for a flat channel.
    pub signal_to_noise_db: f64,
    /// Share of the power at rest that the lines of the mains add to the spectrum beside them.
    pub mains_share: f64,
    /// Which mains frequency that is, Hz.
    pub mains_hz: f64,
    /// Share of the samples that were clipped; 0 if nobody watched.
    pub clipped_share: f64,
}

impl ChannelQuality {
    /// The quality of channel number `channel`. Windows are channel-major.
    pub(crate) fn of(
        channel: usize,
        name: &str,
        window_samples: usize,
        sample_rate_hz: f64,
        rest: &[&[f32]],
        gestures: &[&[f32]],
    ) -> ChannelQuality {
        let range = channel * window_samples..(channel + 1) * window_samples;
        let powers = |windows: &[&[f32]]| -> Vec<f64> {
            windows.iter().map(|window| rms(&window[range.clone()]).powi(2)).collect()
        };
        let rest_power = quantile(&powers(rest), 0.5);
        let gesture_power = powers(gestures).iter().sum::<f64>() / gestures.len().max(1) as f64;
        let hum = MAINS_HZ.map(|mains_hz| {
            let windows = rest.iter().step_by(rest.len().div_ceil(HUM_WINDOWS).max(1));
            let share = |window: &&[f32]| mains_share(&window[range.clone()], mains_hz, sample_rate_hz);
            (quantile(&windows.map(share).collect::<Vec<f64>>(), 0.5).max(0.0), mains_hz)
        });
        let (mains_share, mains_hz) = if hum[0].0 > hum[1].0 { hum[0] } else { hum[1] };
        let is_flat = rest_power == 0.0 || gesture_power == 0.0;
        ChannelQuality {
            name: name.to_owned(),
            rest_rms: rest_power.sqrt(),
            signal_to_noise_db: if is_flat { 0.0 } else { 10.0 * (gesture_power / rest_power).log10() },
            mains_share,
            mains_hz,
            clipped_share: 0.0,
        }
    }

    /// RMS in the gestures, in the unit of the source; 0 for a flat channel.
    pub(crate) fn gesture_rms(&self) -> f64 {
        self.rest_rms * 10_f64.powf(self.signal_to_noise_db / 20.0)
    }

    pub(crate) fn is_valid(&self) -> bool {
        let Self { rest_rms, signal_to_noise_db, mains_share, mains_hz, clipped_share, .. } = self;
        *rest_rms >= 0.0
            && [rest_rms, signal_to_noise_db, mains_share, mains_hz, clipped_share]
                .iter()
                .all(|value| value.abs() <= LARGEST_VALUE)
    }
}

/// Share of the power of `samples` that the lines of the mains add to the spectrum on both sides of them, with a Hann window
/// (Goertzel's algorithm). About 0 in noise, and then also below it; 0 for silence.
fn mains_share(samples: &[f32], mains_hz: f64, sample_rate_hz: f64) -> f64 {
    let count = samples.len() as f64;
    let hann = |at: usize| 0.5 - 0.5 * (TAU * (at as f64 + 0.5) / count).cos();
    let mut total = 0.0;
    let windowed: Vec<f64> =
        samples.iter().enumerate().map(|(at, &sample)| f64::from(sample) * hann(at)).collect();
    windowed.iter().for_each(|value| total += value * value);
    if total == 0.0 {
        return 0.0;
    }
    let power_at = |frequency: f64| {
        let turn = 2.0 * (TAU * frequency).cos();
        let (mut before, mut last) = (0.0, 0.0);
        for value in &windowed {
            (before, last) = (last, value + turn * last - before);
        }
        last * last + before * before - turn * last * before
    };
    let line_power = |line: usize| {
        let frequency = mains_hz * line as f64 / sample_rate_hz;
        if frequency >= 0.5 {
            return 0.0;
        }
        let beside = [-1.0, 1.0].map(|side| frequency + side * BESIDE_BINS / count);
        let beside: Vec<f64> =
            beside.into_iter().filter(|beside| *beside > 0.0 && *beside < 0.5).map(power_at).collect();
        power_at(frequency) - beside.iter().sum::<f64>() / beside.len().max(1) as f64
    };
    // A sine of amplitude a has power a²/2 · Σ w² and |X|² = (a/2 · Σ w)²: with Σ w = n/2 and Σ w² = 3n/8, the share
    // is |X|² · 3 / n divided by the power.
    let lines: f64 = (1..=LINES).map(line_power).sum();
    (lines * 3.0 / count / total).min(1.0)
}

/// Counts the samples of a channel that are clipped: several of one value in a row, where no other is larger, or none is
/// smaller. Takes samples as acquired, because a filter makes slopes of what was flat.
#[derive(Clone, Debug, Default)]
pub struct ClippingWatch {
    samples: u64,
    last: f32,
    /// Samples of the last value in a row.
    run: u32,
    largest: Extreme,
    smallest: Extreme,
}

#[derive(Clone, Copy, Debug, Default)]
struct Extreme {
    value: Option<f32>,
    clipped: u64,
}

impl Extreme {
    fn see(&mut self, sample: f32, run: u32, is_further: bool) {
        if is_further {
            *self = Extreme { value: Some(sample), clipped: 0 };
        }
        if self.value == Some(sample) && run >= CLIPPED_RUN {
            self.clipped += if run == CLIPPED_RUN { u64::from(CLIPPED_RUN) } else { 1 };
        }
    }
}

impl ClippingWatch {
    /// Takes the next samples of the channel.
    pub fn push(&mut self, samples: &[f32]) {
        for &sample in samples {
            self.run = if self.samples > 0 && sample == self.last { self.run + 1 } else { 1 };
            self.samples += 1;
            self.last = sample;
            let run = self.run;
            let above = self.largest.value.is_none_or(|largest| sample > largest);
            self.largest.see(sample, run, above);
            let below = self.smallest.value.is_none_or(|smallest| sample < smallest);
            self.smallest.see(sample, run, below);
        }
    }

    /// Share of the samples that were clipped. A channel of one value only is flat and not clipped.
    pub fn clipped_share(&self) -> f64 {
        if self.samples == 0 || self.largest.value == self.smallest.value {
            return 0.0;
        }
        (self.largest.clipped + self.smallest.clipped) as f64 / self.samples as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(amplitude: f64, frequency_hz: f64) -> impl Fn(usize) -> f32 {
        move |at| (amplitude * (TAU * frequency_hz * at as f64 / 2000.0 + 0.3).sin()) as f32
    }

    #[test]
    fn a_line_of_the_mains_has_its_share_and_others_have_none() {
        let share = |frequency_hz: f64, mains_hz: f64| {
            let samples: Vec<f32> = (0..600).map(sine(3.0, frequency_hz)).collect();
            mains_share(&samples, mains_hz, 2000.0)
        };
        for (frequency_hz, mains_hz) in [(50.0, 50.0), (60.0, 60.0), (100.0, 50.0), (180.0, 60.0)] {
            assert!(
                (share(frequency_hz, mains_hz) - 1.0).abs() < 0.02,
                "{frequency_hz} {}",
                share(frequency_hz, mains_hz)
            );
        }
        assert!(share(80.0, 50.0) < 0.01 && share(80.0, 60.0) < 0.01 && share(300.0, 60.0) < 0.01);
        assert_eq!(mains_share(&[0.0; 300], 50.0, 2000.0), 0.0);
    }

    #[test]
    fn noise_has_no_hum_however_short_its_windows_are() {
        let mut noise = noise();
        for window_samples in [150, 300, 600] {
            let samples: Vec<f32> = (0..100 * window_samples).map(|_| noise()).collect();
            let windows: Vec<&[f32]> = samples.chunks_exact(window_samples).collect();
            let quality = ChannelQuality::of(0, "flexor", window_samples, 2000.0, &windows, &windows);
            assert!(quality.mains_share < 0.01, "{window_samples} samples: {}", quality.mains_share);
        }
    }

    #[test]
    fn one_rest_in_which_somebody_moved_spoils_nothing() {
        let mut noise = noise();
        let hum = sine(2_f64.sqrt(), 50.0);
        let mut recorded = |gain: f32, windows: usize| -> Vec<f32> {
            (0..300 * windows).map(|at| gain * (noise() + hum(at % 300))).collect()
        };
        let (rest, moved, gesture) = (recorded(1.0, 50), recorded(30.0, 10), recorded(10.0, 60));
        let of = |rest: &[f32]| {
            let rest: Vec<&[f32]> = rest.chunks_exact(300).collect();
            let gesture: Vec<&[f32]> = gesture.chunks_exact(300).collect();
            ChannelQuality::of(0, "flexor", 300, 2000.0, &rest, &gesture)
        };
        let still = of(&rest);
        assert!((still.signal_to_noise_db - 20.0).abs() < 0.3, "{still:?}");
        assert!((still.mains_share - 0.5).abs() < 0.05, "{still:?}");
        // The bad rest comes first.
        let spoilt = of(&[moved, rest].concat());
        assert!((spoilt.signal_to_noise_db - still.signal_to_noise_db).abs() < 0.3, "{spoilt:?}");
        assert!((spoilt.rest_rms / still.rest_rms - 1.0).abs() < 0.03, "{spoilt:?}");
    }

    fn noise() -> impl FnMut() -> f32 {
        let mut random = 1_u32;
        move || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((random >> 8) as f32 / (1 << 24) as f32 - 0.5) * 12_f32.sqrt()
        }
    }

    #[test]
    fn half_hum_half_noise_is_about_half() {
        let mut noise = noise();
        let hum = sine(2_f64.sqrt(), 50.0);
        let samples: Vec<f32> = (0..6000).map(|at| noise() + hum(at)).collect();
        let share = mains_share(&samples, 50.0, 2000.0);
        assert!((share - 0.5).abs() < 0.05, "{share}");
    }

    #[test]
    fn only_flat_tops_count_as_clipped() {
        let mut watch = ClippingWatch::default();
        let wave: Vec<f32> = (0..2000).map(sine(1.0, 33.0)).collect();
        watch.push(&wave);
        assert_eq!(watch.clipped_share(), 0.0);
        let mut watch = ClippingWatch::default();
        watch.push(&wave.iter().map(|sample| sample.clamp(-0.5, 0.5)).collect::<Vec<f32>>());
        // A sine is beyond half its amplitude two thirds of the time.
        assert!((watch.clipped_share() - 2.0 / 3.0).abs() < 0.02, "{}", watch.clipped_share());
        let mut watch = ClippingWatch::default();
        watch.push(&[7.0; 100]);
        assert_eq!(watch.clipped_share(), 0.0, "flat is not clipped");
    }
}
