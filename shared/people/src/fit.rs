//! From windows of known gestures to a person.

use tendon_features::{Discriminant, LaggedLogCovariance, MethodSettings, Prior, Training, rest_floor};
use tendon_gesture::Gesture;

use crate::calibration::{Calibration, CalibrationError};
use crate::effort::{EffortRange, level};
use crate::expected::{Expected, HeldOut, classes, cross_validate};
use crate::finding::findings;
use crate::name::PersonName;
use crate::person::{Fitted, GestureFit, Made, Person, SignalFit};
use crate::quality::ChannelQuality;

/// Share of the held-out windows that are nearer to their gesture than the limit of distance.
const DISTANCE_SHARE: f64 = 0.99;
/// By how much the limit is larger when parts of one repetition were held out: they are more alike than repetitions are.
const DISTANCE_OF_PARTS: f64 = 1.3;

impl Person {
    /// Fits a person. `made` says where the windows come from; the prior's people are added to it.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`]: what is wrong with the windows, the settings or the prior.
    pub fn fit(
        name: PersonName,
        made: Made,
        calibration: &Calibration,
        method: &MethodSettings,
        prior: Option<&Prior>,
    ) -> Result<Person, CalibrationError> {
        let gestures: Vec<Gesture> = calibration.check()?.into();
        let place = |label: &usize| {
            let gesture = calibration.gestures[*label];
            gestures.iter().position(|own| *own == gesture).expect("the set holds all gestures")
        };
        let labels: Vec<usize> = calibration.labels.iter().map(place).collect();
        let calibration = &Calibration { gestures: &gestures, labels: &labels, ..*calibration };

        let SignalFit { channels, sample_rate_hz, .. } = calibration.signal;
        let floor_variance = rest_floor(method, channels.len(), calibration.windows_of(0))?;
        let mut covariance =
            LaggedLogCovariance::new(method, channels.len(), *sample_rate_hz, floor_variance)?;
        if let Some(prior) = prior {
            prior.check(&covariance)?;
        }
        let feature_count = covariance.feature_count();
        let mut features = vec![0.0; labels.len() * feature_count];
        for (window, features) in calibration.windows().zip(features.chunks_exact_mut(feature_count)) {
            covariance.compute(window, features)?;
        }
        let blocks: Vec<usize> =
            calibration.repetitions.iter().map(|&repetition| repetition as usize).collect();
        let training = Training {
            classes: &classes(&gestures),
            feature_count,
            features: &features,
            labels: &labels,
            increment_s: calibration.signal.increment_s(),
            blocks: &blocks,
        };
        let discriminant = Discriminant::fit(&training, prior, method)?;
        let (validation, expected) = cross_validate(calibration, &training, &discriminant, prior, method)?;
        let discriminant = discriminant.with_temperature(validation.temperature(method))?;
        let of_parts = expected.held_out != HeldOut::Repetitions;
        let distance_limit =
            validation.distance_at(DISTANCE_SHARE) * if of_parts { DISTANCE_OF_PARTS } else { 1.0 };
        let prior_people = prior.map_or_else(Vec::new, |prior| prior.people().to_vec());
        let fitted = Fitted { floor_variance, distance_limit, discriminant };
        Ok(assemble(name, Made { prior_people, ..made }, calibration, method, expected, fitted))
    }
}

/// Everything that is said of a person besides the recogniser itself. Rest is gesture 0.
fn assemble(
    name: PersonName,
    made: Made,
    calibration: &Calibration,
    method: &MethodSettings,
    expected: Expected,
    fitted: Fitted,
) -> Person {
    let Calibration { signal, gestures, labels, .. } = *calibration;
    let channels = qualities(calibration);
    let rest_rms: Vec<f64> = channels.iter().map(|channel| channel.rest_rms).collect();
    let levels = |label: usize| -> Vec<f64> {
        calibration.windows_of(label).map(|window| level(window, &rest_rms)).collect()
    };
    let rest_levels = levels(0);
    let gesture = |(label, name): (usize, &Gesture)| GestureFit {
        name: *name,
        repetitions: calibration.repetitions_of(label).len(),
        windows: labels.iter().filter(|own| **own == label).count(),
        effort: EffortRange::of(&rest_levels, &levels(label)),
    };
    Person {
        name,
        made,
        findings: findings(calibration, gestures, &channels, &expected),
        signal: signal.clone(),
        expected,
        gestures: gestures.iter().enumerate().map(gesture).collect(),
        channels,
        method: method.clone(),
        fitted,
    }
}

/// The quality of every channel.
fn qualities(calibration: &Calibration) -> Vec<ChannelQuality> {
    let SignalFit { channels, window_samples, sample_rate_hz, .. } = calibration.signal;
    let rest: Vec<&[f32]> = calibration.windows_of(0).collect();
    let gestures: Vec<&[f32]> = calibration
        .windows()
        .zip(calibration.labels)
        .filter(|(_, label)| **label != 0)
        .map(|(window, _)| window)
        .collect();
    let quality = |(channel, name): (usize, &String)| {
        let quality = ChannelQuality::of(channel, name, *window_samples, *sample_rate_hz, &rest, &gestures);
        let clipped_share = calibration.clipped_shares.get(channel).copied().unwrap_or(0.0);
        ChannelQuality { clipped_share, ..quality }
    };
    channels.iter().enumerate().map(quality).collect()
}
