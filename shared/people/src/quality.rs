//! How well each channel was recorded.
//!
//! ```text
//! windows of rest ──┬─▶ RMS ──────────┐
//!                   └─▶ mains lines   ├─▶ ChannelQuality
//! windows of gestures ─▶ RMS ─────────┤
//! samples as acquired ─▶ ClippingWatch┘
//! ```

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::effort::rms;
use crate::person::LARGEST_VALUE;

/// The frequencies of the mains.
const MAINS_HZ: [f64; 2] = [50.0, 60.0];
/// Lines of the mains that are looked at: the mains frequency and its multiples.
const LINES: usize = 3;
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
    /// RMS at rest, in the unit of the source.
    pub rest_rms: f64,
    /// How much stronger the gestures are than rest, dB; 0 for a flat channel.
    pub signal_to_noise_db: f64,
    /// Share of the power at rest that lies in the lines of the mains.
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
        let power = |windows: &[&[f32]]| {
            let sum: f64 = windows.iter().map(|window| rms(&window[range.clone()]).powi(2)).sum();
            sum / windows.len().max(1) as f64
        };
        let (rest_power, gesture_power) = (power(rest), power(gestures));
        let hum = MAINS_HZ.map(|mains_hz| {
            let windows = &rest[..rest.len().min(HUM_WINDOWS)];
            let shares =
                windows.iter().map(|window| mains_share(&window[range.clone()], mains_hz, sample_rate_hz));
            (shares.sum::<f64>() / windows.len().max(1) as f64, mains_hz)
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

    pub(crate) fn is_valid(&self) -> bool {
        let Self { rest_rms, signal_to_noise_db, mains_share, mains_hz, clipped_share, .. } = self;
        *rest_rms >= 0.0
            && [rest_rms, signal_to_noise_db, mains_share, mains_hz, clipped_share]
                .iter()
                .all(|value| value.abs() <= LARGEST_VALUE)
    }
}

/// Share of the power of `samples` in the lines of the mains, with a Hann window (Goertzel's algorithm). 0 for silence.
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
    let line_power = |line: usize| {
        let frequency = mains_hz * line as f64 / sample_rate_hz;
        if frequency >= 0.5 {
            return 0.0;
        }
        let turn = 2.0 * (TAU * frequency).cos();
        let (mut before, mut last) = (0.0, 0.0);
        for value in &windowed {
            (before, last) = (last, value + turn * last - before);
        }
        last * last + before * before - turn * last * before
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
    fn half_hum_half_noise_is_about_half() {
        let mut random = 1_u32;
        let mut noise = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((random >> 8) as f32 / (1 << 24) as f32 - 0.5) * 12_f32.sqrt()
        };
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
