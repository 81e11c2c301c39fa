//! From levels of contraction to the samples an amplifier would give.
//!
//! ```text
//! white noise ─▶ correlate channels ─▶ shape spectrum ─▶ × level ─┐  (one branch a gesture)
//!                                       mains hum, baseline wander ┴─▶ + ─▶ dropouts ─▶ clipping ─▶ samples
//! ```

use std::f64::consts::TAU;

use rand::{Rng, RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;

use crate::performance::Performance;
use crate::profile::{Profile, ProfileError, cholesky};
use crate::shaping;

/// What is simulated, and what disturbs it. Amplitudes are in the unit of the profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulationSettings {
    /// Channels wanted. Beyond those of the profile they begin again at its first, with noise of their own.
    pub channels: usize,
    /// Samples a second in each channel.
    pub sample_rate_hz: f64,
    /// The same seed gives the same samples.
    pub seed: u64,
    /// Frequency of the mains hum.
    pub mains_hz: f64,
    /// Peak amplitude of the mains hum, 0 for none.
    pub mains_amplitude: f32,
    /// Frequency of the baseline wander that breathing and cable movement cause.
    pub wander_hz: f64,
    /// Peak amplitude of the baseline wander, 0 for none.
    pub wander_amplitude: f32,
    /// A constant added to every sample: the offset of the amplifier.
    pub offset: f32,
    /// How often a minute, on average, one channel goes flat; 0 for never.
    pub dropouts_per_minute: f64,
    /// How long a channel stays flat, in milliseconds.
    pub dropout_ms: f64,
    /// Samples are limited to ± this value, as by an amplifier whose gain is too high.
    pub clip_at: Option<f32>,
}

impl Default for SimulationSettings {
    fn default() -> SimulationSettings {
        SimulationSettings {
            channels: 4,
            sample_rate_hz: 2000.0,
            seed: 0,
            mains_hz: 60.0,
            mains_amplitude: 20.0,
            wander_hz: 0.3,
            wander_amplitude: 50.0,
            offset: 0.0,
            dropouts_per_minute: 0.0,
            dropout_ms: 100.0,
            clip_at: None,
        }
    }
}

/// Why a simulation cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// The profile is faulty.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// A setting is out of range.
    #[error("simulation: {key} is {value}, it must be {range}")]
    Setting {
        /// The name of the setting.
        key: &'static str,
        /// What it was given.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
}

/// Makes raw EMG samples, block by block. Nothing is allocated once it is constructed.
#[derive(Clone, Debug)]
pub struct SimulatedEmg {
    channels: usize,
    muscles: Vec<Muscles>,
    noise: Vec<f32>,
    muscle_rng: Xoshiro256PlusPlus,
    mains: Sine,
    wander: Sine,
    offset: f32,
    dropouts: Dropouts,
    clip_at: f32,
}

/// The muscle pattern of one gesture, on every channel.
#[derive(Clone, Debug)]
struct Muscles {
    gesture: Gesture,
    /// Lower triangular `[profile channels][profile channels]`, flat: gives white noise the correlation.
    mixing: Vec<f32>,
    /// `[profile channels][taps]`, flat.
    filters: Vec<f32>,
    /// `[channels][2 × taps]`, flat: the correlated noise of the last samples. Written ahead until its end is
    /// reached, then moved back to the front, so that the newest `taps` always lie in one piece.
    history: Vec<f32>,
    /// Where in each channel's history the next sample goes.
    next: usize,
}

impl SimulatedEmg {
    /// Designs the filters for the session's rate.
    ///
    /// # Errors
    /// If the profile or a setting is out of range.
    pub fn new(profile: &Profile, settings: &SimulationSettings) -> Result<SimulatedEmg, SimulationError> {
        profile.check()?;
        settings.check()?;
        // Each disturbance draws from a stream of its own, so that switching one on changes no other sample.
        let stream = |number: u64| {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(settings.seed);
            (0..number).for_each(|_| rng.jump());
            rng
        };
        let muscles = Gesture::ALL.map(|gesture| Muscles::new(profile, gesture, settings)).to_vec();
        Ok(SimulatedEmg {
            channels: settings.channels,
            muscles,
            noise: vec![0.0; settings.channels],
            muscle_rng: stream(0),
            mains: Sine::new(settings.mains_hz, settings.mains_amplitude, settings, stream(1)),
            wander: Sine::new(settings.wander_hz, settings.wander_amplitude, settings, stream(2)),
            offset: settings.offset,
            dropouts: Dropouts::new(settings, stream(3)),
            clip_at: settings.clip_at.unwrap_or(f32::INFINITY),
        })
    }

    /// Fills `block`, channel-major `[channels][samples]`, with the next samples and advances `performance`
    /// by as many.
    ///
    /// # Panics
    /// If the length of `block` is no multiple of the number of channels.
    pub fn fill_block(&mut self, performance: &mut Performance, block: &mut [f32]) {
        assert!(
            block.len().is_multiple_of(self.channels),
            "a block of {} values does not divide among {} channels",
            block.len(),
            self.channels
        );
        let samples = block.len() / self.channels;
        for sample in 0..samples {
            let levels = performance.next_levels();
            for value in &mut self.noise {
                *value = StandardNormal.sample(&mut self.muscle_rng);
            }
            for muscles in &mut self.muscles {
                muscles.push(&self.noise);
            }
            let (mains_sin, mains_cos) = self.mains.next();
            let (wander_sin, wander_cos) = self.wander.next();
            self.dropouts.advance(self.channels);
            for channel in 0..self.channels {
                let mut value = self.offset
                    + self.mains.at(channel, mains_sin, mains_cos)
                    + self.wander.at(channel, wander_sin, wander_cos);
                for muscles in &self.muscles {
                    let level = levels[muscles.gesture.index()];
                    if level > 0.0 {
                        value += level * muscles.signal(channel);
                    }
                }
                if self.dropouts.is_flat(channel) {
                    value = 0.0;
                }
                block[channel * samples + sample] = value.clamp(-self.clip_at, self.clip_at);
            }
        }
    }
}

impl Muscles {
    /// `profile` has been checked.
    fn new(profile: &Profile, gesture: Gesture, settings: &SimulationSettings) -> Muscles {
        let entry = profile.gesture(gesture);
        let mixing = cholesky(&entry.correlation).expect("a checked profile has positive definite correlations");
        let filters = entry
            .amplitude_density
            .iter()
            .flat_map(|density| shaping::design(&profile.frequencies_hz, density, settings.sample_rate_hz))
            .collect();
        let taps = shaping::tap_count(settings.sample_rate_hz);
        Muscles {
            gesture,
            mixing: mixing.iter().flatten().map(|value| *value as f32).collect(),
            filters,
            history: vec![0.0; settings.channels * 2 * taps],
            next: taps,
        }
    }

    fn profile_channels(&self) -> usize {
        self.mixing.len().isqrt()
    }

    fn taps(&self) -> usize {
        self.filters.len() / self.profile_channels()
    }

    /// Takes in one sample of white noise a channel.
    fn push(&mut self, noise: &[f32]) {
        let size = self.profile_channels();
        let taps = self.taps();
        if self.next == 2 * taps {
            for history in self.history.chunks_exact_mut(2 * taps) {
                history.copy_within(taps.., 0);
            }
            self.next = taps;
        }
        for (group, histories) in noise.chunks(size).zip(self.history.chunks_mut(size * 2 * taps)) {
            let channels = histories.chunks_exact_mut(2 * taps).zip(self.mixing.chunks_exact(size)).enumerate();
            for (channel, (history, mixing)) in channels {
                history[self.next] = dot(&mixing[..=channel], &group[..=channel]);
            }
        }
        self.next += 1;
    }

    /// The signal of a full contraction at the newest sample.
    fn signal(&self, channel: usize) -> f32 {
        let taps = self.taps();
        let filter = channel % self.profile_channels() * taps;
        let newest = channel * 2 * taps + self.next;
        // The filters are symmetric, so the order of the history does not matter.
        dot(&self.filters[filter..filter + taps], &self.history[newest - taps..newest])
    }
}

/// Sum of products, in eight running sums so that it vectorises, always in the same order.
fn dot(left: &[f32], right: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 8];
    let (left_eights, left_rest) = left.as_chunks::<8>();
    let (right_eights, right_rest) = right.as_chunks::<8>();
    for (left, right) in left_eights.iter().zip(right_eights) {
        for lane in 0..8 {
            sums[lane] += left[lane] * right[lane];
        }
    }
    let rest: f32 = left_rest.iter().zip(right_rest).map(|(left, right)| left * right).sum();
    sums.iter().sum::<f32>() + rest
}

/// A sine that reaches every channel with a phase of its own.
#[derive(Clone, Debug)]
struct Sine {
    turns: f64,
    turns_per_sample: f64,
    /// Amplitude times cosine and sine of the phase, a channel each.
    weights: Vec<(f32, f32)>,
}

impl Sine {
    fn new(frequency_hz: f64, amplitude: f32, settings: &SimulationSettings, mut rng: impl Rng) -> Sine {
        let weights = (0..settings.channels)
            .map(|_| {
                let phase: f32 = rng.random_range(0.0..std::f32::consts::TAU);
                (amplitude * phase.cos(), amplitude * phase.sin())
            })
            .collect();
        Sine { turns: 0.0, turns_per_sample: frequency_hz / settings.sample_rate_hz, weights }
    }

    /// Sine and cosine at the next sample.
    fn next(&mut self) -> (f32, f32) {
        self.turns = (self.turns + self.turns_per_sample).fract();
        let (sin, cos) = (TAU * self.turns).sin_cos();
        (sin as f32, cos as f32)
    }

    fn at(&self, channel: usize, sin: f32, cos: f32) -> f32 {
        let (of_sin, of_cos) = self.weights[channel];
        of_sin * sin + of_cos * cos
    }
}

/// Single channels that go flat for a while, at random times.
#[derive(Clone, Debug)]
struct Dropouts {
    rng: Xoshiro256PlusPlus,
    mean_gap_samples: f64,
    flat_samples: u64,
    gap_left: u64,
    /// The samples that each channel still stays flat.
    flat_left: Vec<u64>,
}

impl Dropouts {
    fn new(settings: &SimulationSettings, rng: Xoshiro256PlusPlus) -> Dropouts {
        let mut dropouts = Dropouts {
            rng,
            mean_gap_samples: 60.0 * settings.sample_rate_hz / settings.dropouts_per_minute,
            flat_samples: (settings.dropout_ms * 1e-3 * settings.sample_rate_hz).round() as u64,
            gap_left: 0,
            flat_left: vec![0; settings.channels],
        };
        dropouts.draw_gap();
        dropouts
    }

    fn draw_gap(&mut self) {
        let gap: f64 = Exp1.sample(&mut self.rng);
        // An infinite mean, for no dropouts at all, ends as the largest number there is.
        self.gap_left = (gap * self.mean_gap_samples) as u64;
    }

    fn advance(&mut self, channels: usize) {
        for left in &mut self.flat_left {
            *left = left.saturating_sub(1);
        }
        if self.gap_left == 0 {
            let channel = self.rng.random_range(0..channels);
            self.flat_left[channel] = self.flat_samples;
            self.draw_gap();
        } else {
            self.gap_left -= 1;
        }
    }

    fn is_flat(&self, channel: usize) -> bool {
        self.flat_left[channel] > 0
    }
}

impl SimulationSettings {
    fn check(&self) -> Result<(), SimulationError> {
        let wrong = |key, value, range| Err(SimulationError::Setting { key, value, range });
        if self.channels == 0 {
            return wrong("channels", 0.0, "at least 1");
        }
        // Below 200 Hz no muscle signal is left; above 100 kHz the filters become needlessly long.
        if !(200.0..=100_000.0).contains(&self.sample_rate_hz) {
            return wrong("sample_rate_hz", self.sample_rate_hz, "from 200 to 100000");
        }
        let not_negative = [
            ("mains_hz", self.mains_hz),
            ("mains_amplitude", f64::from(self.mains_amplitude)),
            ("wander_hz", self.wander_hz),
            ("wander_amplitude", f64::from(self.wander_amplitude)),
            ("dropouts_per_minute", self.dropouts_per_minute),
            ("dropout_ms", self.dropout_ms),
        ];
        for (key, value) in not_negative {
            if !value.is_finite() || value < 0.0 {
                return wrong(key, value, "finite and not negative");
            }
        }
        if !self.offset.is_finite() {
            return wrong("offset", f64::from(self.offset), "finite");
        }
        match self.clip_at {
            // Also wrong for NaN.
            Some(level) if !(level > 0.0) => wrong("clip_at", f64::from(level), "positive"),
            _ => Ok(()),
        }
    }
}
