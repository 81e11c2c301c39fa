//! Streaming change of the sampling rate by a ratio of whole numbers, for recordings that were not made at
//! the session's rate.
//!
//! ```text
//! input ─▶ up - 1 zeros between samples ─▶ low-pass at the lower Nyquist rate ─▶ every down-th ─▶ output
//! ```
//! Computed as polyphase: without the products with a zero, and only for the outputs that are kept. Channels
//! are summed side by side, each in its own lane and in the same order as alone.
//!
//! The phases of the low-pass add up to 1 only nearly, so a constant would ripple. Where all that the low-pass spans is one
//! value, the output is that value: a stuck channel stays stuck, and is noticed.

use std::array::from_fn;
use std::f64::consts::PI;

use crate::error::DesignError;

/// A windowed-sinc low-pass, by how much of the sinc it has.
#[derive(Clone, Copy, Debug)]
struct LowPass {
    /// Zero crossings on either side.
    half_width: usize,
    /// Shape of the Kaiser window.
    kaiser_beta: f64,
}

/// SciPy's default for `resample_poly`. Tones of 20 to 450 Hz come out to within -54 dB at any rate from 1259 Hz on.
const SCIPY: LowPass = LowPass { half_width: 10, kaiser_beta: 5.0 };

/// As SciPy's, but to within -82 dB.
const FINE: LowPass = LowPass { half_width: 16, kaiser_beta: 8.0 };

/// Channels that are summed side by side: two of the narrowest vectors that processors have.
const LANES: usize = 4;

/// Resampler of all channels of a recording.
#[derive(Clone, Debug)]
pub struct Resampler {
    up: usize,
    down: usize,
    channels: usize,
    /// Length of one phase of the low-pass, in input samples.
    phase_len: usize,
    /// `[up × phase_len]`: the low-pass's every `up`-th tap from each phase, newest sample first.
    phases: Vec<f64>,
    delay_upsampled: usize,
    /// The newest `phase_len` inputs of every [`LANES`] channels, stored twice in a row, so that any
    /// `phase_len` of them are contiguous.
    histories: Vec<Vec<[f64; LANES]>>,
    /// Of each channel, the newest input and how many in a row have had its value.
    held: Vec<(f32, usize)>,
    /// Index of the newest input; inputs are written from the back.
    newest: usize,
    /// How many upsampled steps the next output lies after the next input.
    next_output: usize,
}

impl Resampler {
    /// A resampler of `channels` channels that gives `up` samples for every `down`. The low-pass is that of SciPy's
    /// `resample_poly`: `firwin(20 max(up, down) + 1, 1 / max(up, down), window=("kaiser", 5.0)) * up`.
    ///
    /// # Errors
    /// `up` or `down` of 0, or no channels.
    pub fn new(up: usize, down: usize, channels: usize) -> Result<Resampler, DesignError> {
        Resampler::with(SCIPY, up, down, channels)
    }

    /// As [`Resampler::new`], with a longer low-pass that changes less within the band and lets less through beyond it:
    /// `firwin(32 max(up, down) + 1, 1 / max(up, down), window=("kaiser", 8.0)) * up`.
    ///
    /// # Errors
    /// `up` or `down` of 0, or no channels.
    pub fn fine(up: usize, down: usize, channels: usize) -> Result<Resampler, DesignError> {
        Resampler::with(FINE, up, down, channels)
    }

    fn with(low_pass: LowPass, up: usize, down: usize, channels: usize) -> Result<Resampler, DesignError> {
        if up == 0 || down == 0 {
            return Err(DesignError::Ratio { up, down });
        }
        if channels == 0 {
            return Err(DesignError::NoChannels);
        }
        let divisor = greatest_common_divisor(up, down);
        let (up, down) = (up / divisor, down / divisor);
        let half_len = low_pass.half_width * up.max(down);
        let taps = low_pass_taps(half_len, low_pass.kaiser_beta, up.max(down), up);
        let phase_len = taps.len().div_ceil(up);
        let phases = (0..up)
            .flat_map(|phase| {
                let taps = &taps;
                (0..phase_len).map(move |step| taps.get(phase + step * up).copied().unwrap_or(0.0))
            })
            .collect();
        Ok(Resampler {
            up,
            down,
            channels,
            phase_len,
            phases,
            delay_upsampled: half_len,
            histories: vec![vec![[0.0; LANES]; 2 * phase_len]; channels.div_ceil(LANES)],
            held: vec![(0.0, phase_len); channels],
            newest: 0,
            next_output: 0,
        })
    }

    /// How many output samples the output lags behind the input.
    pub fn delay_samples(&self) -> f64 {
        self.delay_upsampled as f64 / self.down as f64
    }

    /// Begins anew: what was pushed so far has no effect on what follows.
    pub fn reset(&mut self) {
        self.histories.iter_mut().for_each(|history| history.fill([0.0; LANES]));
        self.held.fill((0.0, self.phase_len));
        (self.newest, self.next_output) = (0, 0);
    }

    /// The most output samples of a channel that `input_samples` inputs can give.
    pub fn max_output_samples(&self, input_samples: usize) -> usize {
        (input_samples * self.up).div_ceil(self.down)
    }

    /// Takes the next samples, `[samples × channels]`, and appends the resulting samples to `output`, in the
    /// same layout. With room for [`Resampler::max_output_samples`] of every channel there, nothing is
    /// allocated.
    ///
    /// # Panics
    /// If `input` is not a whole number of samples for every channel.
    pub fn process(&mut self, input: &[f32], output: &mut Vec<f32>) {
        assert!(input.len().is_multiple_of(self.channels), "samples × channels");
        for samples in input.chunks_exact(self.channels) {
            self.newest = if self.newest == 0 { self.phase_len - 1 } else { self.newest - 1 };
            for (history, samples) in self.histories.iter_mut().zip(samples.chunks(LANES)) {
                let mut lanes = [0.0; LANES];
                for (lane, &sample) in lanes.iter_mut().zip(samples) {
                    *lane = f64::from(sample);
                }
                history[self.newest] = lanes;
                history[self.newest + self.phase_len] = lanes;
            }
            for ((value, times), &sample) in self.held.iter_mut().zip(samples) {
                *times = if sample == *value { *times + 1 } else { 1 };
                *value = sample;
            }
            while self.next_output < self.up {
                // Each sum waits for the previous one, so two outputs take no longer than one.
                if self.next_output + self.down < self.up {
                    self.push_outputs::<2>(output);
                } else {
                    self.push_outputs::<1>(output);
                }
            }
            self.next_output -= self.up;
        }
    }

    /// Appends the next `N` outputs of all channels, none of which needs another input.
    fn push_outputs<const N: usize>(&mut self, output: &mut Vec<f32>) {
        let phases: [&[f64]; N] = from_fn(|number| {
            &self.phases[(self.next_output + number * self.down) * self.phase_len..][..self.phase_len]
        });
        let before = output.len();
        output.resize(before + N * self.channels, 0.0);
        for (group, history) in self.histories.iter().enumerate() {
            let sums = weighted_sums(phases, &history[self.newest..self.newest + self.phase_len]);
            for (outputs, sums) in output[before..].chunks_exact_mut(self.channels).zip(sums) {
                for (output, sum) in outputs[group * LANES..].iter_mut().zip(sums) {
                    *output = sum as f32;
                }
            }
        }
        for (channel, (value, times)) in self.held.iter().enumerate() {
            if *times >= self.phase_len {
                output[before + channel..]
                    .iter_mut()
                    .step_by(self.channels)
                    .for_each(|output| *output = *value);
            }
        }
        self.next_output += N * self.down;
    }
}

/// Sum of the samples times the taps, for each phase and each lane.
#[inline(never)]
fn weighted_sums<const N: usize>(phases: [&[f64]; N], samples: &[[f64; LANES]]) -> [[f64; LANES]; N] {
    let phases = phases.map(|taps| &taps[..samples.len()]);
    // Starts like `Iterator::sum`, with the one number that preserves the sign of a zero.
    let mut sums = [[-0.0; LANES]; N];
    for (step, samples) in samples.iter().enumerate() {
        for (sums, taps) in sums.iter_mut().zip(&phases) {
            let tap = taps[step];
            *sums = from_fn(|lane| sums[lane] + tap * samples[lane]);
        }
    }
    sums
}

fn greatest_common_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// Windowed-sinc low-pass of `2 half_len + 1` taps with its edge at 1 / `band` of the Nyquist rate, as SciPy's
/// `firwin` with a Kaiser window, times `gain`.
fn low_pass_taps(half_len: usize, kaiser_beta: f64, band: usize, gain: usize) -> Vec<f64> {
    let cutoff = 1.0 / band as f64;
    let peak = bessel_i0(kaiser_beta);
    let mut taps: Vec<f64> = (0..=2 * half_len)
        .map(|tap| {
            let offset = tap as f64 - half_len as f64;
            let angle = PI * cutoff * offset;
            let sinc = if angle == 0.0 { 1.0 } else { angle.sin() / angle };
            let position = offset / half_len as f64;
            let kaiser = bessel_i0(kaiser_beta * (1.0 - position * position).sqrt()) / peak;
            cutoff * sinc * kaiser
        })
        .collect();
    let sum: f64 = taps.iter().sum();
    for tap in &mut taps {
        *tap *= gain as f64 / sum;
    }
    taps
}

/// Modified Bessel function of the first kind of order 0, by its power series Σ ((x/2)^k / k!)².
fn bessel_i0(x: f64) -> f64 {
    let mut sum = 1.0;
    let mut term = 1.0;
    let mut k = 1.0;
    while term > sum * f64::EPSILON {
        term *= (x / (2.0 * k)) * (x / (2.0 * k));
        sum += term;
        k += 1.0;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tone_comes_out_at_the_new_rate_after_the_delay() {
        let tone = |time: f64| (2.0 * PI * 0.05 * time).sin();
        let input: Vec<f32> = (0..400).map(|n| tone(f64::from(n)) as f32).collect();
        for (up, down) in [(2, 1), (1, 1), (3, 4)] {
            let mut resampler = Resampler::new(up, down, 1).expect("a resampler");
            let mut output = Vec::new();
            resampler.process(&input, &mut output);
            let settled = (2.0 * resampler.delay_samples()).ceil() as usize;
            for (n, &sample) in output.iter().enumerate().skip(settled) {
                let time = (n as f64 - resampler.delay_samples()) * down as f64 / up as f64;
                assert!((f64::from(sample) - tone(time)).abs() < 2e-2, "{up}/{down}, sample {n}");
            }
        }
        assert_eq!(Resampler::new(0, 1, 1).err(), Some(DesignError::Ratio { up: 0, down: 1 }));
        assert_eq!(Resampler::new(2, 1, 0).err(), Some(DesignError::NoChannels));
    }

    #[test]
    fn what_is_stuck_stays_stuck_and_only_that_channel() {
        let changing = |n: usize| (n % 7) as f32;
        for (up, down) in [(2, 1), (27, 26), (1, 2)] {
            let mut resampler = Resampler::new(up, down, 2).expect("a resampler");
            let input: Vec<f32> = (0..300)
                .flat_map(|n| [if (100..200).contains(&n) { 1234.567 } else { changing(n) }, changing(n)])
                .collect();
            let mut output = Vec::new();
            resampler.process(&input, &mut output);
            // From the input that fills the low-pass with the stuck value until the one that ends it.
            let [from, to] = [100 + resampler.phase_len, 200].map(|n| (n * up).div_ceil(down));
            let stuck: Vec<f32> = output.iter().step_by(2).copied().collect();
            assert!(stuck[from..to].iter().all(|sample| *sample == 1234.567), "{up}/{down}");
            let moved = |channel: usize, n: usize| output[2 * n + channel] != output[2 * n + 2 + channel];
            assert!((from..to - 1).any(|n| moved(1, n)), "{up}/{down}: the other channel");
            assert!((to..output.len() / 2 - 1).any(|n| moved(0, n)), "{up}/{down}: after it");
            resampler.reset();
            let mut again = Vec::new();
            resampler.process(&input, &mut again);
            assert_eq!(output, again, "{up}/{down}");
        }
    }

    #[test]
    fn channels_do_not_know_of_each_other() {
        let sample = |n: usize, channel: usize| ((n * (channel + 3)) % 17) as f32 - 8.3;
        for (channels, up, down) in [(1, 2, 1), (4, 2, 1), (5, 3, 2), (11, 1, 4)] {
            let input: Vec<f32> =
                (0..100).flat_map(|n| (0..channels).map(move |channel| sample(n, channel))).collect();
            let mut together = Vec::new();
            Resampler::new(up, down, channels).expect("a resampler").process(&input, &mut together);
            for channel in 0..channels {
                let input: Vec<f32> = (0..100).map(|n| sample(n, channel)).collect();
                let mut alone = Vec::new();
                Resampler::new(up, down, 1).expect("a resampler").process(&input, &mut alone);
                let ours: Vec<f32> = together.iter().skip(channel).step_by(channels).copied().collect();
                assert_eq!(ours, alone, "channel {channel} of {channels}, {up}/{down}");
            }
        }
    }
}
