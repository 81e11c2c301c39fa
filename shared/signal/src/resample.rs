//! Changing the sampling rate by a ratio of whole numbers, streaming: for a recording that was not made at
//! the session's rate.
//!
//! ```text
//! input ─▶ up - 1 zeros between samples ─▶ low-pass at the lower Nyquist rate ─▶ every down-th ─▶ output
//! ```
//! computed polyphase: only the products that are not with a zero, only for the outputs that are kept.

use std::f64::consts::PI;

use crate::error::DesignError;

/// Shape of the Kaiser window, SciPy's default for `resample_poly`.
const KAISER_BETA: f64 = 5.0;

/// Zero crossings of the low-pass on either side, SciPy's default for `resample_poly`.
const HALF_WIDTH: usize = 10;

/// Resampler of one channel.
#[derive(Clone, Debug)]
pub struct Resampler {
    up: usize,
    down: usize,
    /// Length of one phase of the low-pass, in input samples.
    phase_len: usize,
    /// `[up × phase_len]`: the low-pass's every `up`-th tap from each phase, newest sample first.
    phases: Vec<f64>,
    delay_upsampled: usize,
    /// The newest `phase_len` inputs, twice in a row, so that any `phase_len` of them lie side by side.
    history: Vec<f64>,
    /// Where the newest input lies; inputs go in from the back.
    newest: usize,
    /// Of the next output, how many upsampled steps it lies after the next input.
    next_output: usize,
}

impl Resampler {
    /// A resampler that gives `up` samples for every `down`. The low-pass is that of SciPy's
    /// `resample_poly`: `firwin(20 max(up, down) + 1, 1 / max(up, down), window=("kaiser", 5.0)) * up`.
    ///
    /// # Errors
    /// `up` or `down` of 0.
    pub fn new(up: usize, down: usize) -> Result<Resampler, DesignError> {
        if up == 0 || down == 0 {
            return Err(DesignError::Ratio { up, down });
        }
        let divisor = greatest_common_divisor(up, down);
        let (up, down) = (up / divisor, down / divisor);
        let half_len = HALF_WIDTH * up.max(down);
        let taps = low_pass_taps(half_len, up.max(down), up);
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
            phase_len,
            phases,
            delay_upsampled: half_len,
            history: vec![0.0; 2 * phase_len],
            newest: 0,
            next_output: 0,
        })
    }

    /// By how many output samples the output lags behind the input.
    pub fn delay_samples(&self) -> f64 {
        self.delay_upsampled as f64 / self.down as f64
    }

    /// The most output samples that `input_samples` inputs can give.
    pub fn max_output_samples(&self, input_samples: usize) -> usize {
        (input_samples * self.up).div_ceil(self.down)
    }

    /// Takes the next samples and appends to `output` what they give: room for
    /// [`Resampler::max_output_samples`] there, and nothing is allocated.
    pub fn process(&mut self, input: &[f32], output: &mut Vec<f32>) {
        for &sample in input {
            self.newest = if self.newest == 0 { self.phase_len - 1 } else { self.newest - 1 };
            self.history[self.newest] = f64::from(sample);
            self.history[self.newest + self.phase_len] = f64::from(sample);
            let history = &self.history[self.newest..self.newest + self.phase_len];
            while self.next_output < self.up {
                let phase = &self.phases[self.next_output * self.phase_len..][..self.phase_len];
                let sum: f64 = phase.iter().zip(history).map(|(tap, sample)| tap * sample).sum();
                output.push(sum as f32);
                self.next_output += self.down;
            }
            self.next_output -= self.up;
        }
    }
}

fn greatest_common_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// Windowed-sinc low-pass of `2 half_len + 1` taps with its edge at 1 / `band` of the Nyquist rate, as SciPy's
/// `firwin`, times `gain`.
fn low_pass_taps(half_len: usize, band: usize, gain: usize) -> Vec<f64> {
    let cutoff = 1.0 / band as f64;
    let mut taps: Vec<f64> = (0..=2 * half_len)
        .map(|tap| {
            let offset = tap as f64 - half_len as f64;
            let angle = PI * cutoff * offset;
            let sinc = if angle == 0.0 { 1.0 } else { angle.sin() / angle };
            let position = offset / half_len as f64;
            let kaiser = bessel_i0(KAISER_BETA * (1.0 - position * position).sqrt()) / bessel_i0(KAISER_BETA);
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
            let mut resampler = Resampler::new(up, down).expect("a resampler");
            let mut output = Vec::new();
            resampler.process(&input, &mut output);
            let settled = (2.0 * resampler.delay_samples()).ceil() as usize;
            for (n, &sample) in output.iter().enumerate().skip(settled) {
                let time = (n as f64 - resampler.delay_samples()) * down as f64 / up as f64;
                assert!((f64::from(sample) - tone(time)).abs() < 2e-2, "{up}/{down}, sample {n}");
            }
        }
        assert_eq!(Resampler::new(0, 1).err(), Some(DesignError::Ratio { up: 0, down: 1 }));
    }
}
