//! What a calibration finds wrong, and what to do about it.

use std::fmt;

use serde::{Deserialize, Serialize};

use tendon_gesture::Gesture;

use crate::calibration::Calibration;
use crate::effort::{quantile, rms};
use crate::expected::Expected;
use crate::quality::ChannelQuality;

/// A channel whose rest is below this share of the median channel's is flat.
const FLAT_SHARE: f64 = 0.01;
/// A channel with more clipped samples than this is clipped.
const CLIPPED_SHARE: f64 = 0.001;
/// A channel with more of its power at rest in the lines of the mains is ridden by hum.
const HUM_SHARE: f64 = 0.3;
/// A channel whose signal is weaker than this says little.
const WEAK_DB: f64 = 3.0;
/// A channel that is below this share of its own rest throughout a repetition has fallen off.
const FALLEN_SHARE: f64 = 0.2;
/// A gesture that is taken for rest, or rest for it, in more of the windows than this was not made.
const NOT_MADE_SHARE: f64 = 0.25;
/// A gesture in which no channel is stronger than so many times its rest was not made.
const NOT_MADE_RATIO: f64 = 1.2;

/// Something that should be mended. Channels are counted from 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Finding {
    /// A gesture looks like rest.
    NotMade {
        /// The gesture.
        gesture: Gesture,
    },
    /// A channel has no signal.
    Flat {
        /// Number of the channel.
        channel: usize,
        /// Its name.
        name: String,
    },
    /// A channel lost its signal in mid-calibration.
    FellOff {
        /// Number of the channel.
        channel: usize,
        /// Its name.
        name: String,
        /// The gesture in which it was first without signal.
        gesture: Gesture,
        /// The repetition.
        repetition: u32,
    },
    /// A channel goes beyond what the amplifier can measure.
    Clipped {
        /// Number of the channel.
        channel: usize,
        /// Its name.
        name: String,
        /// Clipped samples, percent.
        percent: f64,
    },
    /// A channel picks up the mains.
    Hum {
        /// Number of the channel.
        channel: usize,
        /// Its name.
        name: String,
        /// Frequency of the mains, Hz.
        mains_hz: f64,
        /// Share of the power at rest, percent.
        percent: f64,
    },
    /// A channel is hardly stronger in the gestures than at rest.
    Weak {
        /// Number of the channel.
        channel: usize,
        /// Its name.
        name: String,
        /// Signal-to-noise ratio, dB.
        signal_to_noise_db: f64,
    },
    /// Two gestures are taken for each other.
    Alike {
        /// One of them.
        first: Gesture,
        /// The other.
        second: Gesture,
        /// Share of their windows, percent.
        percent: f64,
    },
}

impl Finding {
    /// Whether a session with this person would go wrong, so that the calibration has to be mended first.
    pub fn is_serious(&self) -> bool {
        matches!(self, Finding::NotMade { .. } | Finding::Flat { .. } | Finding::FellOff { .. })
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Finding::NotMade { gesture } => write!(
                out,
                "{gesture} looks like rest: it was not made, or too lightly; record it again, a little firmer"
            ),
            Finding::Flat { channel, name } => write!(
                out,
                "channel {channel} (`{name}`) has no signal: check its electrode and cable, then calibrate again"
            ),
            Finding::FellOff { channel, name, gesture, repetition } => write!(
                out,
                "channel {channel} (`{name}`) lost its signal during {gesture}, repetition {}: fix its electrode, then \
                 record again from there",
                repetition + 1
            ),
            Finding::Clipped { channel, name, percent } => write!(
                out,
                "channel {channel} (`{name}`) is clipped in {percent:.1} % of its samples: lower the amplifier's gain"
            ),
            Finding::Hum { channel, name, mains_hz, percent } => write!(
                out,
                "channel {channel} (`{name}`) picks up the {mains_hz} Hz mains ({percent:.0} % of its power at rest): \
                 press its electrode on, and set dsp.filter.notch_hz to {mains_hz}"
            ),
            Finding::Weak { channel, name, signal_to_noise_db } => write!(
                out,
                "channel {channel} (`{name}`) is hardly stronger in the gestures than at rest \
                 ({signal_to_noise_db:.1} dB): press its electrode on, or place it over a muscle"
            ),
            Finding::Alike { first, second, percent } if *first == Gesture::REST => write!(
                out,
                "{second} looks like rest {percent:.0} % of the time: make it a little firmer, and keep still at rest"
            ),
            Finding::Alike { first, second, percent } => write!(
                out,
                "{first} and {second} look alike {percent:.0} % of the time: repeat them further apart"
            ),
        }
    }
}

/// Everything that the calibration shows to be wrong, the most serious first. Rest is gesture 0.
pub(crate) fn findings(
    calibration: &Calibration,
    gestures: &[Gesture],
    channels: &[ChannelQuality],
    expected: &Expected,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (label, gesture) in gestures.iter().enumerate().skip(1) {
        let like_rest = 0.5 * (expected.taken_for(label, 0) + expected.taken_for(0, label));
        if like_rest > NOT_MADE_SHARE || strongest_channel(calibration, label, channels) < NOT_MADE_RATIO {
            findings.push(Finding::NotMade { gesture: *gesture });
        }
    }
    let mut rests: Vec<f64> = channels.iter().map(|channel| channel.rest_rms).collect();
    rests.sort_by(f64::total_cmp);
    let median = rests.get(rests.len() / 2).copied().unwrap_or(0.0);
    for (channel, quality) in channels.iter().enumerate() {
        findings.extend(of_channel(calibration, gestures, channel, quality, median));
    }
    for (first, second, share) in expected.alike() {
        let not_made = |label: usize| {
            findings
                .iter()
                .any(|finding| matches!(finding, Finding::NotMade { gesture } if *gesture == gestures[label]))
        };
        if !(first == 0 && not_made(second)) {
            let [first, second] = [first, second].map(|label| gestures[label]);
            findings.push(Finding::Alike { first, second, percent: 100.0 * share });
        }
    }
    findings.sort_by_key(|finding| !finding.is_serious());
    findings
}

/// How much stronger than its rest the strongest channel is in the median window of a gesture.
fn strongest_channel(calibration: &Calibration, label: usize, channels: &[ChannelQuality]) -> f64 {
    let samples = calibration.signal.window_samples;
    let ratio = |(channel, quality): (usize, &ChannelQuality)| {
        let of = |window: &[f32]| rms(&window[channel * samples..][..samples]);
        let own: Vec<f64> = calibration.windows_of(label).map(of).collect();
        if quality.rest_rms > 0.0 { quantile(&own, 0.5) / quality.rest_rms } else { 0.0 }
    };
    channels.iter().enumerate().map(ratio).fold(0.0, f64::max)
}

/// The worst that is wrong with a channel.
fn of_channel(
    calibration: &Calibration,
    gestures: &[Gesture],
    channel: usize,
    quality: &ChannelQuality,
    median_rest_rms: f64,
) -> Option<Finding> {
    let name = quality.name.clone();
    if quality.rest_rms <= FLAT_SHARE * median_rest_rms {
        return Some(Finding::Flat { channel, name });
    }
    if let Some((gesture, repetition)) = fell_off(calibration, channel, quality.rest_rms) {
        return Some(Finding::FellOff { channel, name, gesture: gestures[gesture], repetition });
    }
    if quality.clipped_share > CLIPPED_SHARE {
        return Some(Finding::Clipped { channel, name, percent: 100.0 * quality.clipped_share });
    }
    if quality.mains_share > HUM_SHARE {
        let (mains_hz, percent) = (quality.mains_hz, 100.0 * quality.mains_share);
        return Some(Finding::Hum { channel, name, mains_hz, percent });
    }
    (quality.signal_to_noise_db < WEAK_DB).then(|| {
        let signal_to_noise_db = quality.signal_to_noise_db;
        Finding::Weak { channel, name, signal_to_noise_db }
    })
}

/// The first gesture and repetition throughout which a channel is without signal.
fn fell_off(calibration: &Calibration, channel: usize, rest_rms: f64) -> Option<(usize, u32)> {
    let samples = calibration.signal.window_samples;
    let mut strongest: Vec<((usize, u32), f64)> = Vec::new();
    let windows = calibration.windows().zip(calibration.labels).zip(calibration.repetitions);
    for ((window, &label), &repetition) in windows {
        let own = rms(&window[channel * samples..][..samples]);
        match strongest.iter_mut().find(|(at, _)| *at == (label, repetition)) {
            Some((_, largest)) => *largest = own.max(*largest),
            None => strongest.push(((label, repetition), own)),
        }
    }
    strongest.into_iter().find(|(_, largest)| *largest < FALLEN_SHARE * rest_rms).map(|(at, _)| at)
}
