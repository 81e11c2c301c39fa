//! The personal strategy: who is calibrated on what, and the scores of the rest.

use anyhow::anyhow;
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, Layout};
use tendon_evaluation::{
    Calibrating, OnProgress, PersonRecordings, StrategyScores, calibrate_person, gather_cohort,
    score_personal,
};
use tendon_features::{Cohort, LaggedLogCovariance, MethodSettings};
use tendon_gesture::Strategy;
use tendon_people::Person;
use tendon_signal::WindowSettings;

use super::{Options, pipeline_settings};
use crate::Failure;
use crate::personal::{self, shipped_prior, window_settings};

/// Whom all strategies are scored on, and their recognisers.
pub struct People {
    /// In the order of `people`, where that is not empty.
    pub recordings: Vec<PersonRecordings>,
    /// Recognisers; none if nobody was calibrated.
    pub people: Vec<Person>,
    /// What they were asked to calibrate on.
    repetitions: Option<u32>,
}

impl People {
    /// Nobody is calibrated, and everything is scored.
    pub fn uncalibrated(recordings: Vec<PersonRecordings>) -> People {
        People { recordings, people: Vec::new(), repetitions: None }
    }

    /// In words.
    pub fn calibrated_on(&self) -> Option<String> {
        let repetitions = match self.repetitions {
            Some(1) => "repetition".to_owned(),
            Some(repetitions) => format!("{repetitions} repetitions"),
            None => "repetitions, four at most,".to_owned(),
        };
        (!self.people.is_empty()).then(|| format!("the first {repetitions} of each person's first session"))
    }

    /// In words.
    pub fn scored_on(&self) -> &'static str {
        if self.people.is_empty() {
            "all repetitions"
        } else {
            "each person's last session, or what is left of an only one"
        }
    }
}

/// Calibrates to everybody. Who cannot be calibrated is left out and said in `skipped`. If nobody can be, everything is
/// scored by the other strategies.
pub fn calibrate(
    options: &Options,
    config: &Config,
    layout: Layout,
    recordings: Vec<PersonRecordings>,
    skipped: &mut Vec<String>,
) -> Result<People, Failure> {
    let config = with_windows(options, config);
    let method = MethodSettings::default();
    let dataset = personal::dataset_settings(&config, &options.channels, options.recording_rate_hz);
    let cohort = cohort(options, &dataset, &method)?;
    let calibrating = Calibrating { dataset: &dataset, method: &method, cohort: &cohort, layout };
    let mut fitted =
        People { recordings: Vec::new(), people: Vec::new(), repetitions: options.calibrate_repetitions };
    let (mut others, mut reasons) = (Vec::new(), Vec::new());
    for mut person in recordings {
        let held_back = person.hold_back(options.calibrate_repetitions);
        match held_back.and_then(|()| calibrate_person(&person, &calibrating)) {
            Ok(recogniser) => {
                fitted.people.push(recogniser);
                fitted.recordings.push(person);
            }
            Err(error) => {
                reasons.push(error.to_string());
                others.push(person);
            }
        }
    }
    if !fitted.people.is_empty() {
        skipped.extend(reasons);
        return Ok(fitted);
    }
    let reason = reasons.first().map_or("there are no recordings", String::as_str);
    if options.strategy.is_some() || options.calibrate_repetitions.is_some() {
        return Err(Failure::input(anyhow!("nobody can be calibrated: {reason}")));
    }
    skipped.push(format!("the personal strategy is not scored: {reason}"));
    others.iter_mut().for_each(PersonRecordings::hold_nothing_back);
    Ok(People::uncalibrated(others))
}

/// Scores the recognisers of people.
pub fn score(
    options: &Options,
    config: &Config,
    settings: &DatasetSettings,
    people: &People,
    on_progress: &mut OnProgress<'_>,
) -> Result<StrategyScores, Failure> {
    let pipeline = pipeline_settings(&with_windows(options, config), Strategy::Personal);
    let recordings = &people.recordings;
    score_personal(&pipeline, config.inference.adaptation, settings, recordings, &people.people, on_progress)
        .map_err(Failure::running)
}

/// The people who make the prior: those that come with Tendon, where they fit, or else those of these recordings.
fn cohort(options: &Options, dataset: &DatasetSettings, method: &MethodSettings) -> Result<Cohort, Failure> {
    let features = LaggedLogCovariance::new(method, dataset.channels.len(), dataset.sample_rate_hz, 1.0)
        .map_err(Failure::input)?;
    let shipped = shipped_prior().map_err(Failure::input)?;
    if let Some(cohort) = shipped.filter(|cohort| cohort.layout().fits(&features).is_ok()) {
        return Ok(cohort);
    }
    // What cannot be read is said when it is scored.
    gather_cohort(&options.recordings, dataset, method, &mut Vec::new(), &mut |_, _| {})
        .map_err(Failure::input)
}

/// The configuration with a person's windows, unless others are asked for.
fn with_windows(options: &Options, config: &Config) -> Config {
    let mut config = config.clone();
    if !options.sets("dsp.windows") && config.dsp.windows == WindowSettings::default() {
        config.dsp.windows = window_settings(config.acquisition.sample_rate_hz);
    }
    config
}
