//! Whether what was asked was done, and the electrodes stay on.
//!
//! ```text
//! block as acquired ─┬─▶ flat for how long? clipped? not a number?
//!                    └─▶ filter ─▶ RMS of every 100 ms and channel ─┬─▶ level: mean over channels of RMS / RMS at rest
//!                                          RMS at rest ─────────────┴─▶ made? fallen off?
//! ```

use std::fmt;

use serde::Serialize;
use tendon_gesture::Gesture;
use tendon_people::{ClippingWatch, Finding};
use tendon_signal::{DesignError, EmgFilter, FilterSettings};

use crate::guide::Trial;

/// Length of a piece whose RMS is looked at, s.
const PIECE_S: f64 = 0.1;
/// A channel that gives nothing for so long has fallen off, s.
const FALLEN_S: f64 = 0.5;
/// A channel below this share of its RMS at rest gives nothing.
const FALLEN_SHARE: f64 = 0.1;
/// A gesture in which no channel is stronger than so many times its rest, in half of the pieces, was not made.
const NOT_MADE_RATIO: f64 = 1.3;
/// A rest in which a channel is stronger than so many times the first rest, in half of the pieces, was none.
const NO_REST_RATIO: f64 = 4.0;
/// A channel with more clipped samples than this is clipped.
const CLIPPED_SHARE: f64 = 0.001;

/// Why a trial has to be done again.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Trouble {
    /// The arm was not at rest.
    NoRest,
    /// Samples are missing.
    Lost {
        /// How many of each channel.
        samples: u64,
    },
    /// Samples that are no numbers.
    NotNumbers {
        /// How many, of all channels.
        samples: u64,
    },
    /// Something about the signals.
    #[serde(untagged)]
    Signal(Finding),
}

impl fmt::Display for Trouble {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Trouble::Signal(finding) => finding.fmt(out),
            Trouble::NoRest => write!(out, "the muscles were tense at rest: lay the arm down and relax"),
            Trouble::Lost { samples } => write!(
                out,
                "{samples} samples of each channel were lost on the way, so this one does not count: close other programs"
            ),
            Trouble::NotNumbers { samples } => write!(
                out,
                "{samples} samples from the source are not numbers, so this one does not count: check the amplifier"
            ),
        }
    }
}

/// Looks at the samples while a person follows the cues.
#[derive(Clone, Debug)]
pub struct SignalWatch {
    names: Vec<String>,
    sample_rate_hz: f64,
    filter: EmgFilter,
    filtered: Vec<f32>,
    channels: Vec<Channel>,
    piece_samples: usize,
    /// Samples of the piece that is being summed up.
    in_piece: usize,
    /// RMS at rest, once it was measured.
    rest_rms: Option<Vec<f64>>,
    lost_samples: u64,
    not_numbers: u64,
}

#[derive(Clone, Debug, Default)]
struct Channel {
    clipping: ClippingWatch,
    is_clipped: bool,
    last: Option<f32>,
    /// Samples of the same value in a row, as acquired.
    flat_samples: u64,
    sum_of_squares: f64,
    /// Of every piece of the trial.
    rms: Vec<f64>,
}

impl SignalWatch {
    /// Watches channels of these names.
    ///
    /// # Errors
    ///
    /// The filter cannot work at this rate.
    pub fn new(
        filter: &FilterSettings,
        names: &[String],
        sample_rate_hz: f64,
    ) -> Result<SignalWatch, DesignError> {
        Ok(SignalWatch {
            filter: EmgFilter::new(filter, names.len(), sample_rate_hz)?,
            filtered: Vec::new(),
            channels: vec![Channel::default(); names.len()],
            names: names.to_vec(),
            sample_rate_hz,
            piece_samples: ((PIECE_S * sample_rate_hz).round() as usize).max(1),
            in_piece: 0,
            rest_rms: None,
            lost_samples: 0,
            not_numbers: 0,
        })
    }

    /// Takes a block, channel-major. `lost_samples` of each channel are missing before it.
    pub fn push(&mut self, block: &[f32], lost_samples: u64) {
        let samples = block.len() / self.names.len();
        self.lost_samples += lost_samples;
        self.not_numbers += block.iter().filter(|sample| !sample.is_finite()).count() as u64;
        self.filtered.clear();
        self.filtered.extend_from_slice(block);
        self.filter.process_all(&mut self.filtered, 0..samples);
        for (channel, raw) in self.channels.iter_mut().zip(block.chunks_exact(samples.max(1))) {
            channel.clipping.push(raw);
            for &sample in raw {
                channel.flat_samples =
                    if channel.last == Some(sample) { channel.flat_samples + 1 } else { 0 };
                channel.last = Some(sample);
            }
        }
        for sample in 0..samples {
            for (channel, filtered) in self.channels.iter_mut().zip(self.filtered.chunks_exact(samples)) {
                channel.sum_of_squares += f64::from(filtered[sample]).powi(2);
            }
            self.in_piece += 1;
            if self.in_piece == self.piece_samples {
                self.end_piece();
            }
        }
    }

    /// A trial begins: what was before it does not count.
    pub fn begin_trial(&mut self) {
        self.in_piece = 0;
        (self.lost_samples, self.not_numbers) = (0, 0);
        for channel in &mut self.channels {
            channel.sum_of_squares = 0.0;
            channel.rms.clear();
        }
    }

    /// How strong the newest piece is, in multiples of rest; 0 before rest was measured.
    pub fn level(&self) -> f64 {
        let Some(rest_rms) = &self.rest_rms else { return 0.0 };
        let newest = |channel: &Channel| channel.rms.last().copied().unwrap_or(0.0);
        let levels: Vec<f64> = self
            .channels
            .iter()
            .zip(rest_rms)
            .filter(|(_, rest)| **rest > 0.0)
            .map(|(channel, rest)| newest(channel) / rest)
            .collect();
        levels.iter().sum::<f64>() / levels.len().max(1) as f64
    }

    /// What cannot wait for the end of the trial: a channel that fell off, lost samples.
    pub fn trouble_now(&self, trial: Trial) -> Option<Trouble> {
        if self.lost_samples > 0 {
            return Some(Trouble::Lost { samples: self.lost_samples });
        }
        if self.not_numbers > 0 {
            return Some(Trouble::NotNumbers { samples: self.not_numbers });
        }
        let number = (0..self.channels.len()).find(|&number| self.has_fallen(number))?;
        let name = self.names[number].clone();
        Some(Trouble::Signal(if self.rest_rms.is_none() {
            Finding::Flat { channel: number, name }
        } else {
            let Trial { gesture, repetition } = trial;
            Finding::FellOff { channel: number, name, gesture, repetition }
        }))
    }

    /// A trial has come to its end: what is wrong with it. The first rest is what all others are compared with.
    pub fn end_trial(&mut self, trial: Trial) -> Option<Trouble> {
        let trouble = self.trouble_now(trial).or_else(|| self.newly_clipped());
        if trouble.is_some() {
            return trouble;
        }
        let middle: Vec<f64> = self.channels.iter().map(|channel| median(&channel.rms)).collect();
        let Some(rest_rms) = &self.rest_rms else {
            if trial.gesture == Gesture::REST {
                self.rest_rms = Some(middle);
            }
            return None;
        };
        let ratios = middle.iter().zip(rest_rms).filter(|(_, rest)| **rest > 0.0);
        let strongest = ratios.map(|(middle, rest)| middle / rest).fold(0.0, f64::max);
        match trial.gesture {
            Gesture::REST => (strongest > NO_REST_RATIO).then_some(Trouble::NoRest),
            gesture => (strongest < NOT_MADE_RATIO).then_some(Trouble::Signal(Finding::NotMade { gesture })),
        }
    }

    /// Of each channel, the share of all samples so far that was clipped.
    pub fn clipped_shares(&self) -> Vec<f64> {
        self.channels.iter().map(|channel| channel.clipping.clipped_share()).collect()
    }

    /// The next rest is measured anew, as after the electrodes were touched.
    pub fn forget_rest(&mut self) {
        self.rest_rms = None;
    }

    fn end_piece(&mut self) {
        for channel in &mut self.channels {
            channel.rms.push((channel.sum_of_squares / self.piece_samples as f64).sqrt());
            channel.sum_of_squares = 0.0;
        }
        self.in_piece = 0;
    }

    /// Whether a channel gives one value only, or nothing of what it gave at rest, for some time.
    fn has_fallen(&self, number: usize) -> bool {
        let channel = &self.channels[number];
        if channel.flat_samples as f64 >= FALLEN_S * self.sample_rate_hz {
            return true;
        }
        let pieces = (FALLEN_S / PIECE_S).round() as usize;
        let rest = self.rest_rms.as_ref().map_or(0.0, |rest_rms| rest_rms[number]);
        channel.rms.len() >= pieces
            && channel.rms[channel.rms.len() - pieces..].iter().all(|rms| *rms < FALLEN_SHARE * rest)
    }

    /// A channel that is clipped and was not before. Each is named once: another try would not change it.
    fn newly_clipped(&mut self) -> Option<Trouble> {
        let clipped = |(_, channel): &(usize, &mut Channel)| {
            !channel.is_clipped && channel.clipping.clipped_share() > CLIPPED_SHARE
        };
        let (number, channel) = self.channels.iter_mut().enumerate().find(clipped)?;
        channel.is_clipped = true;
        let percent = 100.0 * channel.clipping.clipped_share();
        Some(Trouble::Signal(Finding::Clipped { channel: number, name: self.names[number].clone(), percent }))
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 1000.0;
    const REST: Trial = Trial { gesture: Gesture::REST, repetition: 0 };
    const GRIP: Trial = Trial { gesture: Gesture::GRIP, repetition: 0 };

    /// Two seconds of noise of these amplitudes, a channel each.
    fn noise(amplitudes: [f32; 2], seed: u64) -> Vec<f32> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
        };
        amplitudes.iter().flat_map(|amplitude| [(); 2000].map(|()| amplitude * next())).collect()
    }

    fn watch() -> SignalWatch {
        let names = ["flexor", "extensor"].map(str::to_owned);
        let mut watch = SignalWatch::new(&FilterSettings::default(), &names, RATE_HZ).unwrap();
        watch.begin_trial();
        watch
    }

    fn trial(watch: &mut SignalWatch, trial: Trial, block: &[f32]) -> Option<String> {
        watch.begin_trial();
        watch.push(block, 0);
        watch.end_trial(trial).map(|trouble| trouble.to_string())
    }

    #[test]
    fn a_gesture_that_is_made_on_one_channel_is_fine_and_the_level_follows_it() {
        let mut watch = watch();
        assert_eq!(watch.level(), 0.0);
        assert_eq!(trial(&mut watch, REST, &noise([2.0, 2.0], 1)), None);
        assert!((watch.level() - 1.0).abs() < 0.3, "{}", watch.level());
        assert_eq!(trial(&mut watch, GRIP, &noise([2.0, 20.0], 2)), None);
        assert!((watch.level() - 5.5).abs() < 1.5, "{}", watch.level());
    }

    #[test]
    fn a_gesture_that_is_not_made_and_a_rest_that_is_none_are_noticed() {
        let mut watch = watch();
        trial(&mut watch, REST, &noise([2.0, 2.0], 1));
        let not_made = trial(&mut watch, GRIP, &noise([2.0, 2.1], 2)).unwrap();
        assert!(not_made.contains("grip looks like rest") && not_made.contains("firmer"), "{not_made}");
        let tense = trial(&mut watch, REST, &noise([12.0, 2.0], 3)).unwrap();
        assert!(tense.contains("relax"), "{tense}");
    }

    #[test]
    fn a_channel_that_falls_off_is_named_at_once() {
        let mut watch = watch();
        trial(&mut watch, REST, &noise([2.0, 2.0], 1));
        watch.begin_trial();
        watch.push(&noise([9.0, 9.0], 2), 0);
        assert_eq!(watch.trouble_now(GRIP), None);
        let mut fallen = noise([9.0, 0.0], 3);
        fallen[2000..].fill(7.0);
        watch.push(&fallen, 0);
        let trouble = watch.trouble_now(GRIP).unwrap().to_string();
        assert!(trouble.starts_with("channel 1 (`extensor`) lost its signal during grip"), "{trouble}");
    }

    #[test]
    fn a_channel_that_was_never_there_is_named_after_the_rest() {
        let flat = trial(&mut watch(), REST, &noise([2.0, 0.0], 1)).unwrap();
        assert!(flat.starts_with("channel 1 (`extensor`) has no signal"), "{flat}");
    }

    #[test]
    fn a_clipped_channel_is_named_once() {
        let mut watch = watch();
        trial(&mut watch, REST, &noise([2.0, 2.0], 1));
        let clipped: Vec<f32> =
            noise([40.0, 40.0], 2).iter().map(|sample| (3.0 * sample).clamp(-20.0, 20.0)).collect();
        let first = trial(&mut watch, GRIP, &clipped).unwrap();
        assert!(first.contains("channel 0 (`flexor`) is clipped") && first.contains("gain"), "{first}");
        let second = trial(&mut watch, GRIP, &clipped).unwrap();
        assert!(second.contains("channel 1 (`extensor`) is clipped"), "{second}");
        assert_eq!(trial(&mut watch, GRIP, &clipped), None);
    }

    #[test]
    fn lost_and_unusable_samples_spoil_their_trial_only() {
        let mut watch = watch();
        trial(&mut watch, REST, &noise([2.0, 2.0], 1));
        watch.push(&noise([9.0, 9.0], 2), 10);
        assert_eq!(watch.trouble_now(GRIP), Some(Trouble::Lost { samples: 10 }));
        let mut unusable = noise([9.0, 9.0], 3);
        unusable[5] = f32::NAN;
        let trouble = trial(&mut watch, GRIP, &unusable).unwrap();
        assert!(trouble.starts_with("1 samples from the source are not numbers"), "{trouble}");
        assert_eq!(trial(&mut watch, GRIP, &noise([9.0, 9.0], 4)), None);
    }
}
