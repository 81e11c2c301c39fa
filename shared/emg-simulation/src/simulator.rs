//! From levels of contraction to the samples of an amplifier.
//!
//! ```text
//! white noise ─▶ shape spectra and coherencies ─▶ × level ─┐  (one branch a gesture)
//!                               mains hum, baseline wander ┴─▶ + ─▶ dropouts ─▶ clipping ─▶ samples
//! ```

use std::f64::consts::TAU;

use rand::{Rng, RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use tendon_gesture::GestureSet;

use crate::performance::Performance;
use crate::profile::{Profile, ProfileError};
use crate::shaping;

/// What is simulated, and what disturbs it. Amplitudes are in the unit of the profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulationSettings {
    /// Number of channels. Those beyond the profile's repeat its channels from the first, with noise of their
    /// own.
    pub channels: usize,
    /// Sampling rate of each channel, Hz.
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
    /// How often per minute, on average, one channel goes flat; 0 for never.
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

/// Why a simulation cannot be created.
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
        /// Its value.
        value: f64,
        /// The allowed range.
        range: &'static str,
    },
}

/// Generates raw EMG samples, block by block. Allocates nothing once constructed.
#[derive(Clone, Debug)]
pub struct SimulatedEmg {
    channels: usize,
    profile_channels: usize,
    gestures: GestureSet,
    noise: NoiseHistory,
    /// The filters of each gesture, in the order of the class numbers; see [`shaping::design`].
    filters: Vec<Vec<f32>>,
    mains: Sine,
    wander: Sine,
    offset: f32,
    dropouts: Dropouts,
    clip_at: f32,
}

impl SimulatedEmg {
    /// Designs the filters for the session's rate.
    ///
    /// # Errors
    /// If the profile or a setting is out of range.
    pub fn new(profile: &Profile, settings: &SimulationSettings) -> Result<SimulatedEmg, SimulationError> {
        profile.check()?;
        settings.check()?;
        // Each disturbance draws from a random stream of its own, so switching one on does not change the
        // others.
        let stream = |number: u64| {
            let mut rng = Xoshiro256PlusPlus::seed_from_u64(settings.seed);
            (0..number).for_each(|_| rng.jump());
            rng
        };
        let gestures = profile.gesture_set().map_err(ProfileError::Gestures)?;
        let design = |gesture| {
            shaping::design(&profile.frequencies_hz, profile.gesture(gesture), settings.sample_rate_hz)
        };
        let filters = gestures.iter().map(design).collect();
        Ok(SimulatedEmg {
            channels: settings.channels,
            profile_channels: profile.channels(),
            noise: NoiseHistory::new(settings, stream(0)),
            gestures,
            filters,
            mains: Sine::new(settings.mains_hz, settings.mains_amplitude, settings, stream(1)),
            wander: Sine::new(settings.wander_hz, settings.wander_amplitude, settings, stream(2)),
            offset: settings.offset,
            dropouts: Dropouts::new(settings, stream(3)),
            clip_at: settings.clip_at.unwrap_or(f32::INFINITY),
        })
    }

    /// The gestures of the profile.
    pub fn gestures(&self) -> &GestureSet {
        &self.gestures
    }

    /// Fills `block`, channel-major `[channels][samples]`, with the next samples and advances `performance`
    /// by as many.
    ///
    /// # Panics
    /// If the length of `block` is not a multiple of the number of channels.
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
            self.noise.advance();
            let (mains_sin, mains_cos) = self.mains.next();
            let (wander_sin, wander_cos) = self.wander.next();
            self.dropouts.advance(self.channels);
            for channel in 0..self.channels {
                let mut value = self.offset
                    + self.mains.at(channel, mains_sin, mains_cos)
                    + self.wander.at(channel, wander_sin, wander_cos);
                for (filters, level) in self.filters.iter().zip(levels) {
                    if *level > 0.0 {
                        value += level * self.muscle_signal(filters, channel);
                    }
                }
                if self.dropouts.is_flat(channel) {
                    value = 0.0;
                }
                block[channel * samples + sample] = value.clamp(-self.clip_at, self.clip_at);
            }
        }
    }

    /// The signal of a full contraction on one channel at the newest sample.
    fn muscle_signal(&self, filters: &[f32], channel: usize) -> f32 {
        let row = channel % self.profile_channels;
        let first_noise = channel - row;
        let taps = self.noise.taps;
        (0..=row)
            .map(|column| {
                let filter = &filters[shaping::filter_index(row, column) * taps..][..taps];
                dot(filter, self.noise.newest(first_noise + column))
            })
            .sum()
    }
}

/// The last samples of white noise, one noise per channel.
#[derive(Clone, Debug)]
struct NoiseHistory {
    rng: Xoshiro256PlusPlus,
    taps: usize,
    /// `[channels][2 × taps]`, flat. Written ahead until the end is reached, then moved back to the front, so
    /// that the newest `taps` samples are always contiguous.
    samples: Vec<f32>,
    /// Where in each channel's part the next sample goes.
    next: usize,
}

impl NoiseHistory {
    fn new(settings: &SimulationSettings, rng: Xoshiro256PlusPlus) -> NoiseHistory {
        let taps = shaping::tap_count(settings.sample_rate_hz);
        let mut history =
            NoiseHistory { rng, taps, samples: vec![0.0; settings.channels * 2 * taps], next: taps };
        // The signal has its full strength from the first sample on.
        (0..taps).for_each(|_| history.advance());
        history
    }

    fn advance(&mut self) {
        if self.next == 2 * self.taps {
            for channel in self.samples.chunks_exact_mut(2 * self.taps) {
                channel.copy_within(self.taps.., 0);
            }
            self.next = self.taps;
        }
        for channel in self.samples.chunks_exact_mut(2 * self.taps) {
            channel[self.next] = StandardNormal.sample(&mut self.rng);
        }
        self.next += 1;
    }

    /// The newest `taps` samples of a channel, oldest first.
    fn newest(&self, channel: usize) -> &[f32] {
        let end = channel * 2 * self.taps + self.next;
        &self.samples[end - self.taps..end]
    }
}

/// Sum of products of two equally long slices, always in the same order, with enough running sums to keep the
/// processor's adders busy. [`shaping::tap_count`] leaves no remainder.
fn dot(left: &[f32], right: &[f32]) -> f32 {
    let mut sums = [0.0_f32; shaping::TAPS_MULTIPLE];
    let (left, _) = left.as_chunks::<{ shaping::TAPS_MULTIPLE }>();
    let (right, _) = right.as_chunks::<{ shaping::TAPS_MULTIPLE }>();
    for (left, right) in left.iter().zip(right) {
        for ((sum, left), right) in sums.iter_mut().zip(left).zip(right) {
            *sum += left * right;
        }
    }
    // Summed in groups of eight first: one long chain of additions would take as long as everything above.
    let mut eight = [0.0_f32; 8];
    for part in sums.chunks_exact(8) {
        eight.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
    }
    eight.iter().sum()
}

/// A sine with a different phase in every channel.
#[derive(Clone, Debug)]
struct Sine {
    turns: f64,
    turns_per_sample: f64,
    /// Amplitude times cosine and sine of the phase, per channel.
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
    /// For how many more samples each channel stays flat.
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
        // An infinite mean, for no dropouts at all, becomes the largest number.
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
    /// Checks the ranges.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let wrong = |key, value, range| Err(SimulationError::Setting { key, value, range });
        if self.channels == 0 {
            return wrong("channels", 0.0, "at least 1");
        }
        // Below 200 Hz no muscle signal is left; above 100 kHz the filters become needlessly long.
        if !(200.0..=100_000.0).contains(&self.sample_rate_hz) {
            return wrong("sample_rate_hz", self.sample_rate_hz, "from 200 to 100000");
        }
        let bounded = [
            ("mains_hz", self.mains_hz, 0.0..=1000.0, "from 0 to 1000"),
            ("mains_amplitude", f64::from(self.mains_amplitude), 0.0..=1e9, "from 0 to 1e9"),
            ("wander_hz", self.wander_hz, 0.0..=100.0, "from 0 to 100"),
            ("wander_amplitude", f64::from(self.wander_amplitude), 0.0..=1e9, "from 0 to 1e9"),
            ("offset", f64::from(self.offset), -1e9..=1e9, "from -1e9 to 1e9"),
            ("dropouts_per_minute", self.dropouts_per_minute, 0.0..=6000.0, "from 0 to 6000"),
            ("dropout_ms", self.dropout_ms, 0.0..=60_000.0, "from 0 to 60000"),
        ];
        for (key, value, range, words) in bounded {
            if !range.contains(&value) {
                return wrong(key, value, words);
            }
        }
        match self.clip_at {
            Some(level) if !(level > 0.0 && level.is_finite()) => {
                wrong("clip_at", f64::from(level), "positive")
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use tendon_gesture::Gesture;

    use super::*;
    use crate::performance::{ContractionSettings, Repeat};

    /// No disturbances: muscles only.
    fn undisturbed() -> SimulationSettings {
        SimulationSettings { mains_amplitude: 0.0, wander_amplitude: 0.0, ..SimulationSettings::default() }
    }

    fn disturbed() -> SimulationSettings {
        SimulationSettings {
            offset: 10.0,
            dropouts_per_minute: 600.0,
            dropout_ms: 30.0,
            clip_at: Some(300.0),
            ..SimulationSettings::default()
        }
    }

    fn playing(script: &str, settings: &SimulationSettings) -> Performance {
        Performance::of_script(
            &GestureSet::default(),
            script.parse().unwrap(),
            Repeat::Forever,
            ContractionSettings::default(),
            settings.sample_rate_hz,
        )
    }

    /// `[channels][samples]`, made in blocks whose sizes are taken in turn from `block_sizes`.
    fn simulate(
        script: &str,
        settings: &SimulationSettings,
        samples: usize,
        block_sizes: &[usize],
    ) -> Vec<Vec<f32>> {
        let mut emg = SimulatedEmg::new(&Profile::default(), settings).unwrap();
        let mut performance = playing(script, settings);
        let mut signal = vec![Vec::new(); settings.channels];
        for size in block_sizes.iter().cycle() {
            let size = (*size).min(samples - signal[0].len());
            let mut block = vec![0.0; size * settings.channels];
            emg.fill_block(&mut performance, &mut block);
            for (channel, part) in signal.iter_mut().zip(block.chunks(size.max(1))) {
                channel.extend_from_slice(part);
            }
            if signal[0].len() == samples {
                break;
            }
        }
        signal
    }

    fn root_mean_square(signal: &[f32]) -> f64 {
        (signal.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>() / signal.len() as f64).sqrt()
    }

    fn correlation(left: &[f32], right: &[f32]) -> f64 {
        let together: f64 = left.iter().zip(right).map(|(left, right)| f64::from(left * right)).sum();
        together / left.len() as f64 / (root_mean_square(left) * root_mean_square(right))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]
        #[test]
        fn samples_depend_on_the_seed_and_not_on_the_blocks(
            seed: u64,
            block_sizes in proptest::collection::vec(1_usize..300, 1..6),
        ) {
            let settings = SimulationSettings { seed, ..disturbed() };
            let script = "rest 33ms, grip 100ms, ulnar 77ms";
            let in_one = simulate(script, &settings, 1000, &[1000]);
            let in_many = simulate(script, &settings, 1000, &block_sizes);
            prop_assert_eq!(&in_one, &in_many);
            let other = SimulationSettings { seed: seed.wrapping_add(1), ..settings };
            prop_assert_ne!(&in_one, &simulate(script, &other, 1000, &[1000]));
        }
    }

    #[test]
    fn each_gesture_has_the_power_of_its_profile() {
        let profile = Profile::default();
        for gesture in Gesture::PAPER {
            let signal = simulate(&format!("{gesture} 1s"), &undisturbed(), 60_000, &[2000]);
            for (channel, density) in profile.gesture(gesture).amplitude_density.iter().enumerate() {
                let power: f64 = profile
                    .frequencies_hz
                    .windows(2)
                    .zip(density.windows(2))
                    .map(|(hz, a)| (hz[1] - hz[0]) * (a[0] * a[0] + a[0] * a[1] + a[1] * a[1]) / 3.0)
                    .sum();
                let ratio = root_mean_square(&signal[channel][1000..]) / power.sqrt();
                // 30 s of noise some 100 Hz wide: its measured strength scatters by about 1 %.
                assert!((ratio - 1.0).abs() < 0.05, "{gesture}, channel {channel}: {ratio}");
            }
        }
    }

    #[test]
    fn channels_beyond_the_profile_repeat_it_with_noise_of_their_own() {
        let settings = SimulationSettings { channels: 10, ..undisturbed() };
        let signal = simulate("extension 1s", &settings, 40_000, &[500]);
        for channel in 4..10 {
            let ratio = root_mean_square(&signal[channel]) / root_mean_square(&signal[channel % 4]);
            assert!((ratio - 1.0).abs() < 0.05, "channel {channel}: {ratio}");
            let alike = correlation(&signal[channel], &signal[channel % 4]);
            assert!(alike.abs() < 0.05, "channel {channel}: {alike}");
        }
        let within = correlation(&signal[0], &signal[1]);
        let repeated = correlation(&signal[4], &signal[5]);
        assert!((within - repeated).abs() < 0.05, "{within} and {repeated}");
    }

    #[test]
    fn a_disturbance_adds_itself_and_changes_nothing_else() {
        let script = "rest 100ms, grip 1s";
        let quiet = simulate(script, &undisturbed(), 4000, &[10]);
        let humming = SimulationSettings { mains_amplitude: 20.0, mains_hz: 50.0, ..undisturbed() };
        let loud = simulate(script, &humming, 4000, &[10]);
        for (quiet, loud) in quiet.iter().zip(&loud) {
            let hum: Vec<f32> = quiet.iter().zip(loud).map(|(quiet, loud)| loud - quiet).collect();
            assert!((root_mean_square(&hum) - 20.0 / 2.0_f64.sqrt()).abs() < 0.01);
            // 50 Hz at 2000 Hz: the same again after 40 samples.
            assert!((0..3960).all(|sample| (hum[sample] - hum[sample + 40]).abs() < 0.01));
        }
        let dropping = SimulationSettings { dropouts_per_minute: 100.0, ..undisturbed() };
        let dropped = simulate(script, &dropping, 4000, &[10]);
        let is_as_it_was = |(before, after): (&f32, &f32)| before == after || *after == 0.0;
        assert!(quiet.iter().flatten().zip(dropped.iter().flatten()).all(is_as_it_was));
    }

    #[test]
    fn dropouts_are_as_long_and_as_frequent_as_asked_for() {
        let settings = SimulationSettings { dropouts_per_minute: 60.0, dropout_ms: 20.0, ..undisturbed() };
        let signal = simulate("grip 1s", &settings, 120_000, &[2000]);
        let mut lengths = Vec::new();
        for channel in &signal {
            lengths.extend(
                channel
                    .chunk_by(|a, b| (*a == 0.0) == (*b == 0.0))
                    .filter(|run| run[0] == 0.0)
                    .map(<[f32]>::len),
            );
        }
        // A dropout that begins within another one on the same channel prolongs it, so a few are longer.
        let exact = lengths.iter().filter(|length| **length == 40).count();
        assert!(exact * 10 >= lengths.len() * 9, "{lengths:?}");
        assert!((30..=95).contains(&lengths.len()), "{} in a minute", lengths.len());
    }

    #[test]
    fn clipping_limits_the_samples() {
        let settings = SimulationSettings { clip_at: Some(50.0), ..undisturbed() };
        let signal = simulate("grip 1s", &settings, 4000, &[10]);
        let highest = signal.iter().flatten().fold(0.0_f32, |highest, value| highest.max(value.abs()));
        assert_eq!(highest, 50.0);
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let key = |settings: SimulationSettings| match SimulatedEmg::new(&Profile::default(), &settings) {
            Err(SimulationError::Setting { key, .. }) => key,
            other => panic!("{other:?}"),
        };
        let default = SimulationSettings::default;
        assert_eq!(key(SimulationSettings { channels: 0, ..default() }), "channels");
        assert_eq!(key(SimulationSettings { sample_rate_hz: f64::NAN, ..default() }), "sample_rate_hz");
        assert_eq!(key(SimulationSettings { mains_amplitude: -1.0, ..default() }), "mains_amplitude");
        assert_eq!(
            key(SimulationSettings { dropouts_per_minute: f64::INFINITY, ..default() }),
            "dropouts_per_minute"
        );
        assert_eq!(key(SimulationSettings { clip_at: Some(0.0), ..default() }), "clip_at");
    }
}
