//! A synthetic person: every gesture has its own amplitude in each channel.

use tendon_features::MethodSettings;
use tendon_gesture::Gesture;
use tendon_people::{Calibration, CalibrationError, Made, Person, SignalFit};
use tendon_signal::FilterSettings;

pub const CHANNELS: usize = 4;
pub const SAMPLES: usize = 300;
pub const INCREMENT: usize = 50;

/// Noise between -0.5 and 0.5, the same for a seed.
pub struct Noise(pub u32);

impl Noise {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 24) as f32 - 0.5
    }
}

pub fn signal() -> SignalFit {
    SignalFit {
        channels: ["0", "3", "5", "8"].map(str::to_owned).to_vec(),
        sample_rate_hz: 2000.0,
        unit: "mV".to_owned(),
        window_samples: SAMPLES,
        increment_samples: INCREMENT,
        filter: Some(FilterSettings::default()),
    }
}

/// Gain of each channel in each gesture; rest is not the first on purpose.
pub fn gestures() -> Vec<(Gesture, [f32; CHANNELS])> {
    let gestures = [
        ("fist", [4.0, 4.0, 4.0, 4.0]),
        ("rest", [1.0, 1.0, 1.0, 1.0]),
        ("point", [6.0, 1.5, 1.0, 1.0]),
        ("wave_out", [1.0, 1.0, 2.0, 7.0]),
    ];
    gestures.map(|(name, gains)| (name.parse().expect("a name"), gains)).to_vec()
}

/// A window, channel-major.
pub fn window(noise: &mut Noise, gains: &[f32; CHANNELS]) -> Vec<f32> {
    gains.iter().flat_map(|gain| (0..SAMPLES).map(|_| gain * noise.next()).collect::<Vec<f32>>()).collect()
}

pub struct Recorded {
    pub gestures: Vec<Gesture>,
    pub samples: Vec<f32>,
    pub labels: Vec<usize>,
    pub repetitions: Vec<u32>,
}

/// Records 30 windows of each gesture and repetition, each of a strength of its own.
pub fn record(gestures: &[(Gesture, [f32; CHANNELS])], repetitions: u32, seed: u32) -> Recorded {
    let mut noise = Noise(seed);
    let mut recorded = Recorded {
        gestures: gestures.iter().map(|(name, _)| *name).collect(),
        samples: Vec::new(),
        labels: Vec::new(),
        repetitions: Vec::new(),
    };
    for repetition in 0..repetitions {
        for (label, (_, gains)) in gestures.iter().enumerate() {
            for number in 0..30 {
                let strength = 1.0 + 0.3 * (number as f32 / 29.0);
                let gains = gains.map(|gain| if gain == 1.0 { gain } else { gain * strength });
                recorded.samples.extend(window(&mut noise, &gains));
                recorded.labels.push(label);
                recorded.repetitions.push(repetition);
            }
        }
    }
    recorded
}

pub fn fit(recorded: &Recorded) -> Result<Person, CalibrationError> {
    let calibration = Calibration {
        signal: &signal(),
        gestures: &recorded.gestures,
        samples: &recorded.samples,
        labels: &recorded.labels,
        repetitions: &recorded.repetitions,
        is_entry: &[],
        clipped_shares: &[],
    };
    let made = Made { at: "2026-01-02T03:04:05Z".to_owned(), version: "0.1.0".to_owned(), ..Made::default() };
    Person::fit("anna".parse().expect("a name"), made, &calibration, &MethodSettings::default(), None)
}
