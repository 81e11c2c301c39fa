//! Recognises the gestures of one person, window by window.
//!
//! ```text
//! window ─┬─▶ features ─┬─▶ discriminant ─▶ probability of every gesture
//!         │             └─▶ distance / limit ─▶ novelty
//!         └─▶ RMS of every channel ─▶ effort of every gesture
//! ```
//!
//! If it adapts, the means of the discriminant follow the windows that are surely a gesture. The person stays as it is: the
//! next recogniser begins where the person was calibrated.

use std::fmt;

use serde::{Deserialize, Serialize};
use tendon_features::{Discriminant, FeatureError, FitError, LaggedLogCovariance, SlowAdaptation};
use tendon_signal::{FilterSettings, are_same_channels, canonical_unit};

use crate::effort::{EffortRange, rms_of_channels};
use crate::person::{Person, SignalFit};

/// Whether a recogniser follows its person during use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Adaptation {
    /// It stays as it was calibrated.
    #[default]
    Off,
    /// Its gestures follow confident windows, and not far: [`SlowAdaptation`].
    Slow,
}

/// Recognises gestures. Once made, it allocates nothing.
#[derive(Clone, Debug)]
pub struct PersonalRecogniser {
    window_length: usize,
    covariance: LaggedLogCovariance,
    discriminant: Discriminant,
    adaptation: Option<SlowAdaptation>,
    /// From one window to the next.
    increment_s: f64,
    distance_limit: f64,
    /// Of the last window; infinite if it was not recognised.
    novelty: f64,
    /// Of every channel of the window.
    rms: Vec<f64>,
    ranges: Vec<EffortRange>,
    features: Vec<f64>,
    whitened: Vec<f64>,
    posterior: Vec<f64>,
    probabilities: Vec<f32>,
    efforts: Vec<f32>,
}

/// What is recognised in a window. Gestures are in the order of the person's, rest first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recognition<'a> {
    /// Probability of every gesture; the sum is 1.
    pub probabilities: &'a [f32],
    /// How hard it is made if it is this gesture, from 0 (the person's rest) to 1 (a comfortable contraction). 0 for rest.
    pub efforts: &'a [f32],
    /// Distance to the nearest gesture over the person's limit: above 1, the window is unlike anything in the
    /// calibration. 0 from a network.
    pub novelty: f32,
}

/// Why a window cannot be recognised.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RecogniseError {
    /// It makes no features.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The features cannot be used.
    #[error(transparent)]
    Discriminant(#[from] FitError),
}

impl PersonalRecogniser {
    /// The recogniser of `person` for windows that begin `increment_samples` after one another.
    ///
    /// # Errors
    ///
    /// None with a person that was fitted or read from a file.
    pub fn new(person: &Person, increment_samples: usize) -> Result<PersonalRecogniser, FeatureError> {
        let covariance = person.features()?.with_increment(person.signal.window_samples, increment_samples);
        let (features, gestures) = (covariance.feature_count(), person.gestures.len());
        Ok(PersonalRecogniser {
            window_length: person.signal.window_length(),
            covariance,
            discriminant: person.fitted.discriminant.clone(),
            adaptation: None,
            increment_s: increment_samples as f64 / person.signal.sample_rate_hz,
            distance_limit: person.fitted.distance_limit,
            novelty: f64::INFINITY,
            rms: vec![0.0; person.channels.len()],
            ranges: person.gestures.iter().map(|gesture| gesture.effort.clone()).collect(),
            features: vec![0.0; features],
            whitened: vec![0.0; features],
            posterior: vec![0.0; gestures],
            probabilities: vec![0.0; gestures],
            efforts: vec![0.0; gestures],
        })
    }

    /// The same recogniser that follows its person, or does not, from where it is now.
    #[must_use]
    pub fn with_adaptation(mut self, adaptation: Adaptation) -> PersonalRecogniser {
        self.adaptation = match adaptation {
            Adaptation::Off => None,
            Adaptation::Slow => Some(SlowAdaptation::new(&self.discriminant, self.increment_s)),
        };
        self
    }

    /// Whether it follows its person.
    pub fn adaptation(&self) -> Adaptation {
        if self.adaptation.is_some() { Adaptation::Slow } else { Adaptation::Off }
    }

    /// Adapts to the window that was recognised last, if it is surely a gesture of the person's. Does nothing where adaptation
    /// is off.
    pub fn adapt(&mut self) {
        if let Some(adaptation) = &self.adaptation {
            adaptation.follow(&mut self.discriminant, &self.posterior, &self.whitened, self.novelty);
        }
    }

    /// Recognises the window that begins at `first_sample` of a stream, channel-major. What was computed for the windows
    /// before it is used again.
    ///
    /// # Errors
    ///
    /// The window has another length than the person's, or samples that are not finite.
    pub fn recognise(
        &mut self,
        window: &[f32],
        first_sample: u64,
    ) -> Result<Recognition<'_>, RecogniseError> {
        self.check_length(window)?;
        self.covariance.compute_next(window, first_sample, &mut self.features)?;
        self.decide(window)
    }

    /// As [`recognise`](Self::recognise) for a window that is not part of a stream.
    ///
    /// # Errors
    ///
    /// As [`recognise`](Self::recognise).
    pub fn recognise_alone(&mut self, window: &[f32]) -> Result<Recognition<'_>, RecogniseError> {
        self.check_length(window)?;
        self.covariance.compute(window, &mut self.features)?;
        self.decide(window)
    }

    fn check_length(&self, window: &[f32]) -> Result<(), FeatureError> {
        if window.len() == self.window_length {
            return Ok(());
        }
        Err(FeatureError::Length { given: window.len(), needed: self.window_length })
    }

    /// Looks at the features that have been computed.
    fn decide(&mut self, window: &[f32]) -> Result<Recognition<'_>, RecogniseError> {
        self.novelty = f64::INFINITY;
        self.discriminant.posterior(&self.features, &mut self.posterior)?;
        let distance = self.discriminant.distance(&self.features, &mut self.whitened)?;
        self.novelty = distance / self.distance_limit;
        let rms = rms_of_channels(window, self.rms.len());
        self.rms.iter_mut().zip(rms).for_each(|(place, rms)| *place = rms);
        for (narrow, wide) in self.probabilities.iter_mut().zip(&self.posterior) {
            *narrow = *wide as f32;
        }
        // Rest stays at 0.
        for (effort, range) in self.efforts.iter_mut().zip(&self.ranges).skip(1) {
            *effort = range.effort(&self.rms) as f32;
        }
        Ok(Recognition {
            probabilities: &self.probabilities,
            efforts: &self.efforts,
            novelty: self.novelty as f32,
        })
    }
}

/// The signal that a session, or a recording, offers to a person's recogniser.
#[derive(Clone, Copy, Debug)]
pub struct SignalOffer<'a> {
    /// Who offers it, in messages: `the session`.
    pub source: &'static str,
    /// Number of channels.
    pub channels: usize,
    /// Their names; `None` if the source has none.
    pub channel_names: Option<&'a [String]>,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Unit of the samples; empty if it is not known.
    pub unit: &'a str,
    /// Samples of a channel in a window.
    pub window_samples: usize,
    /// The filter before the window; `None` if it is not known.
    pub filter: Option<&'a FilterSettings>,
}

/// Something in which an offer differs from what a person was fitted to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// What differs.
    pub what: &'static str,
    /// What the person was calibrated with.
    pub person: String,
    /// Who offers something else.
    pub source: &'static str,
    /// What that is.
    pub has: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Difference { what, person, source, has } = self;
        write!(out, "{what}: calibrated with {person}, {source} has {has}")
    }
}

impl Person {
    /// Everything in which `offer` differs from the signal that the person was fitted to. The increment may differ.
    pub fn differences(&self, offer: &SignalOffer<'_>) -> Vec<Difference> {
        let SignalFit { channels, sample_rate_hz, unit, window_samples, filter, .. } = &self.signal;
        let mut differences = Vec::new();
        let mut compare = |what, same: bool, person: String, has: String| {
            if !same {
                differences.push(Difference { what, person, source: offer.source, has });
            }
        };
        match offer.channel_names {
            Some(names) if names.len() == offer.channels => {
                let are_same = are_same_channels(names, channels);
                compare("channels", are_same, channels.join(", "), names.join(", "));
            }
            _ => {
                let person = format!("{} ({})", channels.len(), channels.join(", "));
                compare("channels", channels.len() == offer.channels, person, offer.channels.to_string());
            }
        }
        let hz = |rate_hz: &f64| format!("{rate_hz} Hz");
        compare(
            "sampling rate",
            *sample_rate_hz == offer.sample_rate_hz,
            hz(sample_rate_hz),
            hz(&offer.sample_rate_hz),
        );
        // A unit that nobody knows cannot be compared.
        let is_known = !unit.is_empty() && !offer.unit.is_empty();
        compare(
            "unit",
            !is_known || canonical_unit(unit) == canonical_unit(offer.unit),
            unit.clone(),
            offer.unit.to_owned(),
        );
        let samples = |samples: &usize| format!("{samples} samples");
        compare(
            "window",
            *window_samples == offer.window_samples,
            samples(window_samples),
            samples(&offer.window_samples),
        );
        if let (Some(own), Some(theirs)) = (filter, offer.filter) {
            for ((what, own), (_, theirs)) in filter_values(own).into_iter().zip(filter_values(theirs)) {
                compare(what, own == theirs, own, theirs);
            }
        }
        differences
    }
}

/// Every setting of a filter in words.
fn filter_values(filter: &FilterSettings) -> [(&'static str, String); 4] {
    let FilterSettings { notch_hz, notch_quality, band_pass_hz: [low, high], band_pass_order } = filter;
    let notch = notch_hz.map_or_else(|| "no notch".to_owned(), |hz| format!("a notch at {hz} Hz"));
    [
        ("notch", notch),
        ("width of the notch", format!("quality {notch_quality}")),
        ("band-pass", format!("{low} to {high} Hz")),
        ("order of the band-pass", band_pass_order.to_string()),
    ]
}
