//! Whether every channel still shows muscles. An electrode that is off may look like rest to everything that comes later.
//!
//! ```text
//! samples as acquired ─▶ one value for 50 ms ─────────────────▶ flat: at zero or at the end of the range ─┐
//! window ─┬─▶ power / power of the session's rest ─┬──────────▶ silent                                    ├─▶ novelty
//!         ├─▶ share of the mains and its multiples ┼─▶ loud? ─▶ hum                                       │
//!         └─▶ power of differences / power ────────┴─▶ loud? ─▶ white noise                              ─┘
//! ```
//! The limits come from the 3DC recordings (15 people, 88 440 windows of 300 ms, channels 0, 3, 5, 8): 18 windows, none of
//! them of rest, are beyond one.

use std::f64::consts::TAU;
use std::fmt;

use crate::activity::Baseline;
use crate::filter::FilterSettings;

/// A channel that keeps one value for so long is flat, s. In 3DC no value lasts longer than 6 ms.
const FLAT_S: f64 = 0.05;
/// And for so many samples: an amplifier of few bits and a low rate shows a value several times in a row at rest.
const FLAT_SAMPLES: f64 = 100.0;
/// Until so long after a flat stretch the filter answers to the step at its end, s.
const SETTLED_S: f64 = 0.5;
/// Novelty of a flat channel.
const FLAT: f64 = 2.0;
/// Weaker than the session's rest by this factor, a channel is silent.
const SILENT: f64 = 30.0;
/// Stronger than the session's rest by this factor, hum and noise are no rest.
const LOUD: f64 = 3.0;
/// The frequencies of the mains.
const MAINS_HZ: [f64; 2] = [50.0, 60.0];
/// Lines of each that are looked at: the frequency and its multiples.
const LINES: usize = 3;
/// Share of the power in the lines of one of them with which a loud channel is hum.
const HUM: f64 = 0.75;
/// Share with which any channel is, however strong the hum was at the start of the session.
const NOTHING_BUT_HUM: f64 = 0.9;
/// Share of the roughness of white noise from which on a signal is noise. The muscles' is below 0.6.
const WHITE: f64 = 0.8;
/// Upper edge of the band below which muscles look as white as noise, Hz.
const LOWEST_EDGE_HZ: f64 = 400.0;

/// How a channel is unlike muscles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// It keeps one value, or did so just before.
    Flat,
    /// It is far weaker than the session's rest.
    Silent,
    /// It is hum of the mains.
    Hum,
    /// It is white noise.
    Noise,
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Fault::Flat => "flat",
            Fault::Silent => "silent",
            Fault::Hum => "hum",
            Fault::Noise => "noise",
        })
    }
}

/// Watches all channels of a session. Allocates nothing once constructed.
#[derive(Clone, Debug)]
pub(crate) struct ContactWatch {
    flat_run: usize,
    settled_samples: u64,
    channels: Vec<Held>,
    /// What is wrong with each channel in the newest window.
    faults: Vec<Option<Fault>>,
    /// Hann window, as long as a window of samples.
    taper: Vec<f64>,
    /// 2 cos(2π f / rate) of each line; `None` where it is beyond half the rate.
    lines: [[Option<f64>; LINES]; MAINS_HZ.len()],
    /// Roughness of a signal that is as noisy as white noise; `None` where the band is too narrow to tell.
    noise_roughness: Option<f64>,
}

/// For how long a channel has had one value.
#[derive(Clone, Copy, Debug)]
struct Held {
    value: f32,
    run: usize,
    /// A window that begins before this sample shows what a flat stretch left.
    flat_until: u64,
}

/// What one channel of a window is like.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shape {
    rms: f64,
    /// Share of the power in the lines of one of the mains frequencies.
    mains_share: f64,
    /// Power of the differences of neighbouring samples over the power, in the smoother half: a click is no noise.
    roughness: f64,
}

impl ContactWatch {
    /// For windows of this length, filtered so.
    pub(crate) fn new(
        channels: usize,
        window_samples: usize,
        filter: &FilterSettings,
        sample_rate_hz: f64,
    ) -> ContactWatch {
        let samples = |seconds: f64| (seconds * sample_rate_hz).ceil();
        let hann = |at: usize| {
            let turns = (at as f64 + 0.5) / window_samples as f64;
            0.5 - 0.5 * (TAU * turns).cos()
        };
        let line = |mains_hz: f64, multiple: usize| {
            let turns = mains_hz * multiple as f64 / sample_rate_hz;
            (turns < 0.5).then(|| 2.0 * (TAU * turns).cos())
        };
        ContactWatch {
            flat_run: samples(FLAT_S).max(FLAT_SAMPLES) as usize,
            settled_samples: samples(SETTLED_S) as u64,
            channels: vec![Held { value: f32::NAN, run: 0, flat_until: 0 }; channels],
            faults: vec![None; channels],
            taper: (0..window_samples).map(hann).collect(),
            lines: MAINS_HZ.map(|mains_hz| std::array::from_fn(|index| line(mains_hz, index + 1))),
            noise_roughness: white_roughness(filter, sample_rate_hz).map(|roughness| WHITE * roughness),
        }
    }

    /// Takes the next samples of a channel as they were acquired, from sample number `first_sample` on.
    pub(crate) fn push(&mut self, channel: usize, samples: &[f32], first_sample: u64) {
        let held = &mut self.channels[channel];
        for (number, &sample) in (first_sample + 1..).zip(samples) {
            held.run = if sample == held.value { held.run + 1 } else { 1 };
            held.value = sample;
            if held.run >= self.flat_run {
                held.flat_until = number + self.settled_samples;
            }
        }
    }

    /// How unlike muscles the least likely channel of a window is: above 1, its electrode is off. The window begins with
    /// sample `first_sample`; each channel comes in two parts, the older one first, and `rest` says how strong the
    /// session's rest is, once it was measured.
    pub(crate) fn novelty<'a>(
        &mut self,
        first_sample: u64,
        window: impl Iterator<Item = [&'a [f32]; 2]>,
        rest: Option<&[Baseline]>,
    ) -> f32 {
        let mut novelty = 0.0_f64;
        for (channel, parts) in window.enumerate() {
            let is_flat = first_sample < self.channels[channel].flat_until;
            let rest = rest.and_then(|rest| rest.get(channel)).map(|baseline| f64::from(baseline.median));
            let [silence, hum, noise] = self.judge(&self.shape(parts), rest);
            // What is flat is silent, too: the first one that is beyond its limit names the fault.
            let causes = [
                (Fault::Flat, if is_flat { FLAT } else { 0.0 }),
                (Fault::Silent, silence),
                (Fault::Hum, hum),
                (Fault::Noise, noise),
            ];
            self.faults[channel] = causes.iter().find(|(_, value)| *value > 1.0).map(|(fault, _)| *fault);
            // A maximum leaves out what is no number, as of a channel that was flat at rest and still is.
            novelty = causes.iter().fold(novelty, |most, (_, value)| most.max(*value));
        }
        novelty as f32
    }

    /// What is wrong with each channel in the newest window.
    pub(crate) fn faults(&self) -> &[Option<Fault>] {
        &self.faults
    }

    /// How silent a channel is, how much it is hum, and how much noise: above 1, more than muscles are.
    fn judge(&self, shape: &Shape, rest: Option<f64>) -> [f64; 3] {
        let loudness = rest.map_or(0.0, |rest| shape.rms / (LOUD * rest));
        let silence = rest.map_or(0.0, |rest| rest / (SILENT * shape.rms));
        let hum = (shape.mains_share / HUM).min(loudness).max(shape.mains_share / NOTHING_BUT_HUM);
        let noise = self.noise_roughness.map_or(0.0, |limit| (shape.roughness / limit).min(loudness));
        [silence, hum, noise]
    }

    /// Goertzel's algorithm for all lines at once, and the powers beside.
    fn shape(&self, parts: [&[f32]; 2]) -> Shape {
        let half = self.taper.len() / 2;
        let mut tapered_power = 0.0;
        // Of the older and the newer half.
        let (mut powers, mut difference_powers) = ([0.0; 2], [0.0; 2]);
        let turns = self.lines.as_flattened();
        let mut states = [[0.0; 2]; LINES * MAINS_HZ.len()];
        let mut before = None;
        let samples = parts.into_iter().flatten().map(|&sample| f64::from(sample));
        for (at, (sample, taper)) in samples.zip(&self.taper).enumerate() {
            let in_half = usize::from(at >= half);
            powers[in_half] += sample * sample;
            let difference = before.map_or(0.0, |before: f64| sample - before);
            difference_powers[in_half] += difference * difference;
            before = Some(sample);
            let tapered = sample * taper;
            tapered_power += tapered * tapered;
            for (state, turn) in states.iter_mut().zip(turns) {
                *state = [tapered + turn.unwrap_or(0.0) * state[0] - state[1], state[0]];
            }
        }
        let count = self.taper.len() as f64;
        let line_power = |([last, before], turn): (&[f64; 2], &Option<f64>)| {
            turn.map_or(0.0, |turn| last * last + before * before - turn * last * before)
        };
        let line_powers = |mains: usize| -> f64 {
            let range = mains * LINES..(mains + 1) * LINES;
            states[range.clone()].iter().zip(&turns[range]).map(line_power).sum()
        };
        // A sine of amplitude a has the tapered power a²/2 · 3 count/8 and the line a/2 · count/2, squared.
        let share = line_powers(0).max(line_powers(1)) * 3.0 / (count * tapered_power);
        let roughness = |in_half: usize| difference_powers[in_half] / powers[in_half];
        Shape {
            rms: ((powers[0] + powers[1]) / count).sqrt(),
            mains_share: if tapered_power > 0.0 { share } else { 0.0 },
            roughness: if powers[0] > 0.0 && powers[1] > 0.0 { roughness(0).min(roughness(1)) } else { 0.0 },
        }
    }
}

/// Power of the differences of neighbouring samples over the power of white noise in the band of the filter: the mean of
/// |1 - exp(-i 2π f / rate)|² = 2 - 2 cos(2π f / rate) over the band. `None` if muscles fill the band as evenly.
fn white_roughness(filter: &FilterSettings, sample_rate_hz: f64) -> Option<f64> {
    let [low_hz, high_hz] = filter.band_pass_hz;
    let high_hz = high_hz.min(sample_rate_hz / 2.0);
    if high_hz < LOWEST_EDGE_HZ {
        return None;
    }
    let turn = |hz: f64| TAU * hz / sample_rate_hz;
    Some(2.0 - 2.0 * (turn(high_hz).sin() - turn(low_hz).sin()) / (turn(high_hz) - turn(low_hz)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Resampler, SignalChain, SignalSettings};

    const RATE_HZ: f64 = 2000.0;
    const REST_RMS: f32 = 20.0;
    /// Rest, and when a disturbance begins and ends, s.
    const DISTURBED_S: [f64; 2] = [7.0, 9.0];

    /// What a channel shows at a sample, given what the muscles do.
    type Disturbance = Box<dyn FnMut(usize, f32) -> f32>;

    /// White noise of deviation 1, the same in every run.
    struct Noise(u32);

    impl Noise {
        fn next(&mut self) -> f32 {
            // Twelve uniform numbers add up to a variance of 1.
            let mut sum = -6.0;
            for _ in 0..12 {
                self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += (self.0 >> 8) as f32 / (1 << 24) as f32;
            }
            sum
        }
    }

    /// Noise with a spectrum like that of muscles: a broad peak at 90 Hz.
    struct Muscles {
        noise: Noise,
        last: [f32; 2],
    }

    impl Muscles {
        fn next(&mut self) -> f32 {
            let next = 1.538 * self.last[0] - 0.64 * self.last[1] + self.noise.next();
            self.last = [next, self.last[0]];
            // The deviation of this process is 3.75.
            next / 3.75
        }
    }

    fn sine(at: usize, frequency_hz: f64, rms: f64) -> f32 {
        (rms * 2_f64.sqrt() * (TAU * frequency_hz * at as f64 / RATE_HZ).sin()) as f32
    }

    /// Novelty and first sample of each window of 12 s on four channels. `level` is how strong the muscles are at a time
    /// in s, over rest; `disturb` gives what the channel shows at a sample instead of what the muscles do.
    fn windows(level: impl Fn(f64) -> f32, disturb: impl FnMut(usize, usize, f32) -> f32) -> Vec<(u64, f32)> {
        windows_with_faults(level, disturb).into_iter().map(|(first, novelty, _)| (first, novelty)).collect()
    }

    /// The same, and what is wrong with each channel.
    fn windows_with_faults(
        level: impl Fn(f64) -> f32,
        mut disturb: impl FnMut(usize, usize, f32) -> f32,
    ) -> Vec<(u64, f32, Vec<Option<Fault>>)> {
        let mut chain = SignalChain::new(&SignalSettings::default(), 4, RATE_HZ).expect("a chain");
        let mut muscles = [1, 2, 3, 4].map(|seed| Muscles { noise: Noise(seed * 7_919), last: [0.0; 2] });
        let mut windows = Vec::new();
        for first in (0..24_000).step_by(10) {
            let mut block = [0.0; 40];
            for (channel, samples) in block.chunks_exact_mut(10).enumerate() {
                for (at, sample) in (first..).zip(samples) {
                    let strength = REST_RMS * level(at as f64 / RATE_HZ);
                    *sample = disturb(channel, at, strength * muscles[channel].next());
                }
            }
            chain
                .push_block(&block, |chain, window, _| {
                    windows.push((window.first_sample, window.novelty, chain.faults().to_vec()));
                    Ok::<(), std::convert::Infallible>(())
                })
                .expect("nothing fails");
        }
        windows
    }

    /// Rest for 6 s, then contractions of a second of ten times that, and rest of a second, in turns.
    fn rest_then_moves(time_s: f64) -> f32 {
        if time_s > 6.0 && (time_s as u64).is_multiple_of(2) { 10.0 } else { 1.0 }
    }

    fn is_disturbed(at: usize) -> bool {
        (DISTURBED_S[0]..DISTURBED_S[1]).contains(&(at as f64 / RATE_HZ))
    }

    /// The share of the windows that are strange: those before the disturbance, those wholly inside it, and those from 1 s
    /// after it.
    fn strange_shares(windows: &[(u64, f32)]) -> [f64; 3] {
        let [begin, end] = DISTURBED_S.map(|time_s| (time_s * RATE_HZ) as u64);
        let share = |range: std::ops::Range<u64>| {
            let inside: Vec<f32> = windows
                .iter()
                .filter(|(first, _)| range.contains(first) && range.contains(&(first + 599)))
                .map(|(_, novelty)| *novelty)
                .collect();
            inside.iter().filter(|novelty| **novelty > 1.0).count() as f64 / inside.len() as f64
        };
        [share(0..begin), share(begin..end), share(end + 2000..u64::MAX)]
    }

    #[test]
    fn muscles_are_not_strange_at_rest_or_in_motion() {
        let windows = windows(rest_then_moves, |_, _, sample| sample);
        assert!(windows.iter().all(|(_, novelty)| *novelty <= 1.0), "{windows:?}");
    }

    #[test]
    fn an_electrode_that_comes_off_is_noticed_on_one_channel_and_on_all_at_rest_and_in_motion() {
        let mut noise = Noise(99);
        let mut loud_noise = move || 5.0 * REST_RMS * noise.next();
        let hum = |at| sine(at, 50.0, 10.0 * f64::from(REST_RMS));
        let removed_hum = |at| sine(at, 60.0, 10.0 * f64::from(REST_RMS));
        let mut disturbances: [(&str, Disturbance); 6] = [
            ("flat at zero", Box::new(|_, _| 0.0)),
            ("flat at the end of the range", Box::new(|_, _| 8191.0)),
            ("hum", Box::new(move |at, _| hum(at))),
            ("hum over muscles", Box::new(move |at, sample| 5.0 * hum(at) + sample)),
            ("hum that the notch removes", Box::new(move |at, _| removed_hum(at))),
            ("noise", Box::new(move |_, _| loud_noise())),
        ];
        for (name, disturbance) in &mut disturbances {
            for channels in [1, 4] {
                let levels: [fn(f64) -> f32; 2] = [|_| 1.0, rest_then_moves];
                for level in levels {
                    let windows = windows(level, |channel, at, sample| {
                        if channel < channels && is_disturbed(at) { disturbance(at, sample) } else { sample }
                    });
                    let [before, inside, after] = strange_shares(&windows);
                    assert_eq!((before, after), (0.0, 0.0), "{name}, {channels} channels");
                    // Of white noise, a window now and then is smooth.
                    assert!(inside > 0.9, "{name}, {channels} channels: {inside}");
                }
            }
        }
    }

    #[test]
    fn a_flat_channel_is_noticed_within_100_ms_and_what_it_leaves_in_the_filter_too() {
        let windows =
            windows(
                rest_then_moves,
                |channel, at, sample| {
                    if channel == 2 && is_disturbed(at) { -8192.0 } else { sample }
                },
            );
        let [begin, end] = DISTURBED_S.map(|time_s| (time_s * RATE_HZ) as u64);
        for (first, novelty) in windows {
            let newest = first + 599;
            let is_flat = newest >= begin + 200 && first < end + 1000;
            assert!(novelty > 1.0 || !is_flat, "window at {first}");
        }
    }

    #[test]
    fn a_value_that_was_stuck_in_a_recording_of_another_rate_is_flat() {
        let mut resampler = Resampler::new(2, 1, 1).expect("a resampler");
        let mut chain = SignalChain::new(&SignalSettings::default(), 1, RATE_HZ).expect("a chain");
        let mut muscles = Muscles { noise: Noise(7_919), last: [0.0; 2] };
        let mut faults = Vec::new();
        for at in 0..12_000 {
            let muscle = REST_RMS * muscles.next();
            let mut samples = Vec::new();
            resampler.process(&[if (7000..9000).contains(&at) { 8191.0 } else { muscle }], &mut samples);
            chain
                .push_block(&samples, |chain, window, _| {
                    faults.push((window.first_sample, chain.faults()[0]));
                    Ok::<(), std::convert::Infallible>(())
                })
                .expect("nothing fails");
        }
        let share_flat = |range: std::ops::Range<u64>| {
            let inside: Vec<_> = faults.iter().filter(|(first, _)| range.contains(first)).collect();
            inside.iter().filter(|(_, fault)| *fault == Some(Fault::Flat)).count() as f64
                / inside.len() as f64
        };
        assert_eq!([share_flat(0..13_400), share_flat(14_000..18_000)], [0.0, 1.0]);
    }

    #[test]
    fn the_channel_and_its_fault_are_named() {
        let mut noise = Noise(99);
        let mut disturb = |fault: Fault, at: usize, sample: f32| match fault {
            Fault::Flat => 0.0,
            Fault::Silent => 0.001 * sample,
            Fault::Hum => sine(at, 50.0, f64::from(20.0 * REST_RMS)),
            Fault::Noise => 20.0 * REST_RMS * noise.next(),
        };
        for fault in [Fault::Flat, Fault::Silent, Fault::Hum, Fault::Noise] {
            let windows = windows_with_faults(
                |_| 1.0,
                |channel, at, sample| {
                    if channel == 2 && is_disturbed(at) { disturb(fault, at, sample) } else { sample }
                },
            );
            let [begin, end] = DISTURBED_S.map(|time_s| (time_s * RATE_HZ) as u64);
            let mut named = 0;
            for (first, novelty, faults) in &windows {
                assert_eq!(*novelty > 1.0, faults.iter().any(Option::is_some), "{fault}, window at {first}");
                if (begin..end - 600).contains(first) {
                    assert_eq!([faults[0], faults[1], faults[3]], [None; 3], "{fault}, window at {first}");
                    named += usize::from(faults[2] == Some(fault));
                }
            }
            let inside = windows.iter().filter(|(first, ..)| (begin..end - 600).contains(first)).count();
            assert!(named * 10 > inside * 9, "{fault}: {named} of {inside}");
        }
    }

    #[test]
    fn from_the_start_flat_channels_and_nothing_but_hum_are_strange() {
        for (name, rms) in [("flat", 0.0), ("hum", 10.0 * REST_RMS)] {
            for channels in [1, 4] {
                let windows = windows(rest_then_moves, |channel, at, sample| {
                    let is_off = channel < channels;
                    if is_off { sine(at, 50.0, f64::from(rms)) } else { sample }
                });
                assert!(windows.iter().all(|(_, novelty)| *novelty > 1.0), "{name}, {channels} channels");
            }
        }
    }

    #[test]
    fn a_click_is_no_noise() {
        let windows = windows(|_| 1.0, |_, at, sample| if at == 15_000 { 4000.0 } else { sample });
        assert!(windows.iter().all(|(_, novelty)| *novelty <= 1.0), "{windows:?}");
    }

    #[test]
    fn a_narrow_band_tells_nothing_of_noise() {
        let filter = FilterSettings { band_pass_hz: [20.0, 150.0], ..FilterSettings::default() };
        assert_eq!(white_roughness(&filter, RATE_HZ), None);
        assert_eq!(white_roughness(&FilterSettings::default(), 500.0), None);
        // Uncorrelated samples: the differences have twice the power.
        let whole = FilterSettings { band_pass_hz: [1e-3, 1e6], ..FilterSettings::default() };
        let roughness = white_roughness(&whole, RATE_HZ).expect("a wide band");
        assert!((roughness - 2.0).abs() < 1e-3, "{roughness}");
    }
}
