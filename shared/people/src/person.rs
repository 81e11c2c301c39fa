//! A person that Tendon has been calibrated to.

use serde::{Deserialize, Serialize};
use tendon_features::{Discriminant, LaggedLogCovariance, MethodSettings};
use tendon_gesture::{Gesture, GestureSet};
use tendon_signal::FilterSettings;

use crate::effort::EffortRange;
use crate::expected::Expected;
use crate::file::PersonProblem;
use crate::finding::Finding;
use crate::name::PersonName;
use crate::quality::ChannelQuality;
use crate::recogniser::{PersonalRecogniser, Recognition};

/// Most values of a window, all channels together: a second of 256 channels at 10 kHz.
const MOST_VALUES: usize = 2_560_000;

/// Largest number of a person file: 32-bit samples are no larger.
pub(crate) const LARGEST_VALUE: f64 = f32::MAX as f64;

/// What a person file holds: whom, when and from what; how good it is; and the recogniser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// The name.
    pub name: PersonName,
    /// When and from what the person was fitted.
    pub made: Made,
    /// The signal that it was fitted to. A session must have the same.
    pub signal: SignalFit,
    /// How well it recognises what it has not seen.
    pub expected: Expected,
    /// What should be mended, the most serious first.
    pub findings: Vec<Finding>,
    /// The gestures in the order of the probabilities, rest first.
    pub gestures: Vec<GestureFit>,
    /// The channels, in order.
    pub channels: Vec<ChannelQuality>,
    /// The constants of the method.
    pub method: MethodSettings,
    /// The recogniser itself.
    pub fitted: Fitted,
}

/// Where a person comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Made {
    /// When, RFC 3339 in UTC.
    pub at: String,
    /// Version of the program.
    pub version: String,
    /// The commit it was built from.
    pub commit: String,
    /// From what, in words.
    pub from: String,
    /// The recordings' files and folders, absolute; none where `from` alone says it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub recordings: Vec<String>,
    /// SHA-256 of the recordings; empty if there are none.
    pub recordings_sha256: String,
    /// The people whose recordings made the prior, such as `3DC 1`; empty without one.
    pub prior_people: Vec<String>,
}

/// A signal that a person is fitted to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalFit {
    /// The channels by name, in order.
    pub channels: Vec<String>,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Unit of the samples; empty if it is not known.
    pub unit: String,
    /// Samples of a channel in a window.
    pub window_samples: usize,
    /// Samples from one window of the calibration to the next. A session may have another increment.
    pub increment_samples: usize,
    /// The filter before the window; `None` if the recordings had been filtered in an unknown way.
    pub filter: Option<FilterSettings>,
}

impl SignalFit {
    /// Samples of a window, all channels together.
    pub fn window_length(&self) -> usize {
        self.channels.len().saturating_mul(self.window_samples)
    }

    /// Time from one window to the next, s.
    pub fn increment_s(&self) -> f64 {
        self.increment_samples as f64 / self.sample_rate_hz
    }
}

/// A gesture of a person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GestureFit {
    /// Its name.
    pub name: Gesture,
    /// How often it was made.
    pub repetitions: usize,
    /// Windows of it.
    pub windows: usize,
    /// From which level to which it goes, see [`EffortRange`].
    pub effort: EffortRange,
}

/// What recognises the gestures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fitted {
    /// Floor of the covariance, in the square of the unit.
    pub floor_variance: f64,
    /// Mahalanobis distance beyond which a window is unlike the calibration.
    pub distance_limit: f64,
    /// Tells the gestures apart.
    pub discriminant: Discriminant,
}

impl Person {
    /// The recogniser's features.
    pub(crate) fn features(&self) -> Result<LaggedLogCovariance, tendon_features::FeatureError> {
        let SignalFit { channels, sample_rate_hz, .. } = &self.signal;
        LaggedLogCovariance::new(&self.method, channels.len(), *sample_rate_hz, self.fitted.floor_variance)
    }

    /// The gestures, by class number.
    pub fn gesture_set(&self) -> GestureSet {
        let gestures = self.gestures.iter().map(|gesture| gesture.name).collect();
        GestureSet::new(gestures).expect("a person is checked when it is fitted or read")
    }

    /// How often the gestures other than rest were made: the fewest.
    pub fn repetitions(&self) -> usize {
        self.gestures.iter().skip(1).map(|gesture| gesture.repetitions).min().unwrap_or(0)
    }

    /// Checks what a file can get wrong: whether everything fits together.
    pub(crate) fn check(&self) -> Result<(), PersonProblem> {
        let Person { signal, expected, gestures, channels, fitted, .. } = self;
        // Before anything of their size is allocated.
        let longest_delay_ms = self.method.delays_ms.iter().copied().fold(0.0, f64::max);
        let is_long_enough =
            longest_delay_ms * signal.sample_rate_hz / 1000.0 <= signal.window_samples as f64;
        if !is_long_enough || signal.window_length() > MOST_VALUES {
            return Err(PersonProblem::Senseless("signal.window_samples"));
        }
        let features = self.features().map_err(PersonProblem::Features)?;
        if signal.window_samples < features.shortest_window() || signal.increment_samples == 0 {
            return Err(PersonProblem::Senseless("signal.window_samples or signal.increment_samples"));
        }
        let names: Vec<Gesture> = gestures.iter().map(|gesture| gesture.name).collect();
        let classes = fitted.discriminant.classes().iter().map(|class| class.name.as_str());
        if !classes.eq(names.iter().map(Gesture::name)) || GestureSet::new(names).is_err() {
            return Err(PersonProblem::Senseless("the list of gestures"));
        }
        if !gestures.iter().all(|gesture| gesture.effort.is_valid(channels.len())) {
            return Err(PersonProblem::Senseless("the effort of a gesture"));
        }
        let names: Vec<&String> = channels.iter().map(|channel| &channel.name).collect();
        if names != signal.channels.iter().collect::<Vec<_>>()
            || !channels.iter().all(ChannelQuality::is_valid)
        {
            return Err(PersonProblem::Senseless("the list of channels"));
        }
        if fitted.discriminant.feature_count() != features.feature_count() {
            return Err(PersonProblem::Senseless("the number of features"));
        }
        if fitted.floor_variance > LARGEST_VALUE {
            return Err(PersonProblem::Senseless("fitted.floor_variance"));
        }
        if !(fitted.distance_limit > 0.0 && fitted.distance_limit <= LARGEST_VALUE) {
            return Err(PersonProblem::Senseless("fitted.distance_limit"));
        }
        if !expected.is_valid(gestures.len()) {
            return Err(PersonProblem::Senseless("what is expected"));
        }
        self.check_recogniser()
    }

    /// Numbers that each make sense can still be too much together: silence, and noise as weak as the person's rest and
    /// as strong as any gesture, must be recognised as something.
    fn check_recogniser(&self) -> Result<(), PersonProblem> {
        let senseless = PersonProblem::Senseless("fitted.discriminant or the effort of a gesture");
        let recogniser = PersonalRecogniser::new(self, self.signal.increment_samples);
        let mut recogniser = recogniser.map_err(PersonProblem::Features)?;
        let comfortable = self.gestures.iter().map(|gesture| gesture.effort.comfortable);
        let strongest = comfortable.fold(0.0, f64::max);
        let weakest = self.channels.iter().map(|channel| channel.rest_rms).fold(strongest, f64::min);
        for level in [0.0, weakest, strongest] {
            // A sequence without a period that matters here (Weyl 1916), from -1 to 1.
            let noise = |sample: usize| 2.0 * (sample as f64 * 0.618_033_988_749_895).fract() - 1.0;
            let window: Vec<f32> =
                (0..self.signal.window_length()).map(|sample| (level * noise(sample)) as f32).collect();
            let is_finite = recogniser.recognise_alone(&window).is_ok_and(|recognition| {
                let Recognition { probabilities, efforts, novelty } = recognition;
                probabilities.iter().chain(efforts).chain([&novelty]).all(|value| value.is_finite())
            });
            if !is_finite {
                return Err(senseless);
            }
        }
        Ok(())
    }
}
