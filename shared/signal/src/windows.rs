//! Cuts the filtered signal into overlapping windows, which the classifier sees.
//!
//! ```text
//! samples  ──────────────────────────────────────▶
//! windows  [──────── window ────────]
//!                [──────── window ────────]
//!          ◀────▶ increment
//! ```

use std::ops::Range;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::error::DesignError;

/// What windows hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum WindowInput {
    /// The filtered signal, as in every live window.
    #[default]
    Raw,
    /// Its moving RMS over 25 ms.
    Envelope,
}

/// Window length and increment. The defaults are the paper's 300 ms every 75 ms at 2000 Hz.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WindowSettings {
    /// Samples of a channel in a window.
    pub window_samples: usize,
    /// Samples between the starts of two windows.
    pub increment_samples: usize,
}

impl Default for WindowSettings {
    fn default() -> WindowSettings {
        WindowSettings { window_samples: 600, increment_samples: 150 }
    }
}

/// A ring of the newest `window` samples of every channel, and the count to the next window's end.
///
/// Samples are written in place: [`Windower::room`] says how many, [`Windower::place_mut`] gives their place
/// in each channel, and [`Windower::advance`] accepts them.
#[derive(Clone, Debug)]
pub struct Windower {
    window: usize,
    increment: usize,
    /// `[channels × window]`, each channel a ring.
    ring: Vec<f32>,
    /// Where the next sample goes in each channel's ring: also where the oldest one is.
    next: usize,
    until_window: usize,
    /// How many channels were replaced at each point in time in the ring, and their sum.
    replaced: Vec<u16>,
    replaced_sum: u32,
}

impl Windower {
    /// A windower for `channels` channels.
    ///
    /// # Errors
    /// No channels, or a window or increment of no samples.
    pub fn new(settings: &WindowSettings, channels: usize) -> Result<Windower, DesignError> {
        let WindowSettings { window_samples: window, increment_samples: increment } = *settings;
        if channels == 0 {
            return Err(DesignError::NoChannels);
        }
        if window == 0 {
            return Err(DesignError::NoSamples { setting: "window_samples", example: 600 });
        }
        if increment == 0 {
            return Err(DesignError::NoSamples { setting: "increment_samples", example: 150 });
        }
        let ring = vec![0.0; channels * window];
        let replaced = vec![0; window];
        Ok(Windower { window, increment, ring, next: 0, until_window: window, replaced, replaced_sum: 0 })
    }

    /// How many samples of each channel can be written next: up to the next window's end, or to the end of
    /// the ring. At least 1.
    pub fn room(&self) -> usize {
        self.until_window.min(self.window - self.next)
    }

    /// The ring, `[channels × window]`, and where in each channel of it the next `samples` samples go.
    ///
    /// # Panics
    /// If `samples` is more than [`Windower::room`].
    pub fn place_mut(&mut self, samples: usize) -> (&mut [f32], Range<usize>) {
        assert!(samples <= self.room(), "{samples} samples, but room for {}", self.room());
        (&mut self.ring, self.next..self.next + samples)
    }

    /// Accepts the samples just written to every channel. `replaced` holds, for each point in time, how many
    /// channels were unusable. Returns true if a window ends with the newest sample: get it with
    /// [`Windower::write_window`] before more samples are written.
    ///
    /// # Panics
    /// If `replaced` is longer than [`Windower::room`].
    pub fn advance(&mut self, replaced: &[u16]) -> bool {
        let samples = replaced.len();
        assert!(samples <= self.room(), "{samples} samples, but room for {}", self.room());
        let overwritten = &mut self.replaced[self.next..self.next + samples];
        for (old, &new) in overwritten.iter_mut().zip(replaced) {
            self.replaced_sum = self.replaced_sum - u32::from(*old) + u32::from(new);
            *old = new;
        }
        self.next = (self.next + samples) % self.window;
        self.until_window -= samples;
        if self.until_window == 0 {
            self.until_window = self.increment;
            return true;
        }
        false
    }

    /// How many samples of the newest `window`, over all channels, were unusable and replaced.
    pub fn replaced_samples(&self) -> u32 {
        self.replaced_sum
    }

    /// Discards what was collected: the next window ends after a whole `window` of new samples.
    pub fn restart(&mut self) {
        self.until_window = self.window;
    }

    /// Lets a window end after `samples` more samples, if it is not a whole number of increments from the next one anyway.
    pub(crate) fn align(&mut self, samples: usize) {
        if !samples.abs_diff(self.until_window).is_multiple_of(self.increment) {
            self.until_window = samples;
        }
    }

    /// Writes the newest `window` samples, oldest first, as `[channels × window]`.
    ///
    /// # Panics
    /// If `out` is not exactly `channels × window` long.
    pub fn write_window(&self, out: &mut [f32]) {
        assert_eq!(out.len(), self.ring.len(), "a window is channels × window samples");
        for (out, [older, newer]) in out.chunks_exact_mut(self.window).zip(self.parts()) {
            out[..older.len()].copy_from_slice(older);
            out[older.len()..].copy_from_slice(newer);
        }
    }

    /// The `samples` that were accepted last, one slice a channel: they lie in one piece.
    pub(crate) fn newest(&self, samples: usize) -> impl Iterator<Item = &[f32]> {
        let end = if self.next == 0 { self.window } else { self.next };
        self.ring.chunks_exact(self.window).map(move |ring| &ring[end - samples..end])
    }

    /// The newest `window` samples of each channel in the two parts in which they lie, the older one first.
    pub(crate) fn parts(&self) -> impl Iterator<Item = [&[f32]; 2]> {
        self.ring.chunks_exact(self.window).map(|ring| {
            let (newer, older) = ring.split_at(self.next);
            [older, newer]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_of_a_count_begin_an_increment_apart_also_with_distance_between_them() {
        for (window, increment) in [(6, 2), (6, 6), (4, 7)] {
            let settings = WindowSettings { window_samples: window, increment_samples: increment };
            let mut windower = Windower::new(&settings, 2).expect("a windower");
            let (mut sample, mut expected_start) = (0, 0);
            let mut out = vec![0.0; 2 * window];
            while sample < 100 {
                let (ring, place) = windower.place_mut(1);
                ring[place.start] = sample as f32;
                ring[window + place.start] = -(sample as f32);
                sample += 1;
                if windower.advance(&[0]) {
                    windower.write_window(&mut out);
                    let first: Vec<f32> = (expected_start..sample).map(|value| value as f32).collect();
                    assert_eq!(out[..window], first);
                    assert!(out[window..].iter().zip(&first).all(|(second, first)| *second == -first));
                    expected_start += increment;
                }
            }
            assert_eq!(expected_start, (100 - window) / increment * increment + increment);
        }
    }
}
