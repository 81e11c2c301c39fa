//! From windows of known gestures to a person.

use tendon_features::{Discriminant, LaggedLogCovariance, MethodSettings, Prior, Training, rest_floor};
use tendon_gesture::Gesture;

use crate::calibration::{Calibration, CalibrationError};
use crate::effort::{EffortRange, rms_of_channels};
use crate::expected::{Expected, HeldOut, classes, cross_validate};
use crate::finding::findings;
use crate::name::PersonName;
use crate::person::{Fitted, GestureFit, Made, Person, SignalFit};
use crate::quality::ChannelQuality;

/// Share of the held-out windows that are nearer to their gesture than the limit of distance.
const DISTANCE_SHARE: f64 = 0.99;
/// The limit is at least so many times the square root of the number of features, which is about the distance of windows
/// like those of the calibration: another session's are farther away than held-out repetitions.
const DISTANCE_OF_SESSIONS: f64 = 1.65;
/// How often a window counts that shows how a movement begins. They are a tenth of a hold, but it is they that decide how
/// soon and how surely a gesture is answered: docs/decisions/evidence.md.
const ENTRY_COUNT: usize = 3;
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
        let emphasised = emphasise(&training, calibration.is_entry);
        let emphasised = Training {
            features: &emphasised.features,
            labels: &emphasised.labels,
            blocks: &emphasised.blocks,
            ..training
        };
        let discriminant = Discriminant::fit(&emphasised, prior, method)?;
        let (efforts, has_effort) = efforts(calibration);
        let (validation, expected) =
            cross_validate(calibration, &training, &has_effort, &discriminant, prior, method)?;
        let discriminant = discriminant.with_temperature(validation.temperature(method))?;
        let of_parts = expected.held_out != HeldOut::Repetitions;
        let of_held_out =
            validation.distance_at(DISTANCE_SHARE) * if of_parts { DISTANCE_OF_PARTS } else { 1.0 };
        let distance_limit = of_held_out.max(DISTANCE_OF_SESSIONS * (feature_count as f64).sqrt());
        let prior_people = prior.map_or_else(Vec::new, |prior| prior.people().to_vec());
        let fitted = Fitted { floor_variance, distance_limit, discriminant };
        let made = Made { prior_people, ..made };
        Ok(assemble(name, made, calibration, method, expected, efforts, fitted))
    }
}

/// Features, labels and blocks of windows of which some are there several times.
struct Emphasised {
    features: Vec<f64>,
    labels: Vec<usize>,
    blocks: Vec<usize>,
}

/// Repeats the windows that show how a movement begins.
fn emphasise(training: &Training, is_entry: &[bool]) -> Emphasised {
    let mut emphasised = Emphasised { features: Vec::new(), labels: Vec::new(), blocks: Vec::new() };
    for (window, features) in training.features.chunks_exact(training.feature_count).enumerate() {
        let count = if is_entry.get(window).copied().unwrap_or(false) { ENTRY_COUNT } else { 1 };
        for _ in 0..count {
            emphasised.features.extend_from_slice(features);
            emphasised.labels.push(training.labels[window]);
            emphasised.blocks.push(training.blocks[window]);
        }
    }
    emphasised
}

/// Everything that is said of a person besides the recogniser itself. Rest is gesture 0.
fn assemble(
    name: PersonName,
    made: Made,
    calibration: &Calibration,
    method: &MethodSettings,
    expected: Expected,
    efforts: Vec<EffortRange>,
    fitted: Fitted,
) -> Person {
    let Calibration { signal, gestures, labels, .. } = *calibration;
    let channels = qualities(calibration);
    let gesture = |((label, name), effort): ((usize, &Gesture), EffortRange)| GestureFit {
        name: *name,
        repetitions: calibration.repetitions_of(label).len(),
        windows: labels.iter().filter(|own| **own == label).count(),
        effort,
    };
    Person {
        name,
        made,
        findings: findings(calibration, gestures, &channels, &expected),
        signal: signal.clone(),
        expected,
        gestures: gestures.iter().enumerate().zip(efforts).map(gesture).collect(),
        channels,
        method: method.clone(),
        fitted,
    }
}

/// The range of effort of every gesture; and of every window, whether its gesture was made in it with any. Rest needs none.
fn efforts(calibration: &Calibration) -> (Vec<EffortRange>, Vec<bool>) {
    let channels = calibration.signal.channels.len();
    let rms: Vec<Vec<f64>> =
        calibration.windows().map(|window| rms_of_channels(window, channels).collect()).collect();
    let rms_of = |label: usize| -> Vec<Vec<f64>> {
        let windows = rms.iter().zip(calibration.labels);
        windows.filter(|(_, own)| **own == label).map(|(rms, _)| rms.clone()).collect()
    };
    let rest_rms = rms_of(0);
    let efforts: Vec<EffortRange> =
        (0..calibration.gestures.len()).map(|label| EffortRange::of(&rest_rms, &rms_of(label))).collect();
    let has_effort = rms.iter().zip(calibration.labels);
    let has_effort = has_effort.map(|(rms, &label)| label == 0 || efforts[label].effort(rms) > 0.0);
    let has_effort = has_effort.collect();
    (efforts, has_effort)
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
