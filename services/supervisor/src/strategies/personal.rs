//! The personal strategy: who is calibrated on what, and the scores of the rest.

use anyhow::anyhow;
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, Layout};
use tendon_evaluation::{
    Calibrating, LeftOut, OnProgress, PersonRecordings, SCORED_SESSION, StrategyScores, calibrate_person,
    gather_cohort, score_personal,
};
use tendon_features::{Cohort, MethodSettings};
use tendon_gesture::Strategy;
use tendon_people::Person;
use tendon_recordings::Channel;

use super::{Options, pipeline_settings};
use crate::Failure;
use crate::personal::{self, WINDOWS, personal_windows, shipped_prior};

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
        if self.people.is_empty() { "all repetitions" } else { SCORED_SESSION }
    }
}

/// Calibrates to everybody. Who cannot be calibrated is left out and said in `skipped`. If nobody can be, everything is
/// scored by the other strategies.
pub fn calibrate(
    options: &Options,
    config: &Config,
    channels: &[Channel],
    layout: Layout,
    recordings: Vec<PersonRecordings>,
    skipped: &mut Vec<LeftOut>,
) -> Result<People, Failure> {
    let config = personal_windows(config.clone(), options.sets(WINDOWS));
    let method = MethodSettings::default();
    let dataset = personal::dataset_settings(&config, channels, &options.recording);
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
        skipped.extend(reasons.into_iter().map(LeftOut::person));
        return Ok(fitted);
    }
    let reason = reasons.first().map_or("there are no recordings", String::as_str);
    if options.strategy.is_some() || options.calibrate_repetitions.is_some() {
        return Err(Failure::input(anyhow!("nobody can be calibrated: {reason}")));
    }
    skipped.push(LeftOut::person(format!("the personal strategy is not scored: {reason}")));
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
    let pipeline =
        pipeline_settings(&personal_windows(config.clone(), options.sets(WINDOWS)), Strategy::Personal);
    let recordings = &people.recordings;
    score_personal(&pipeline, config.inference.adaptation, settings, recordings, &people.people, on_progress)
        .map_err(Failure::running)
}

/// The people who make the prior: those that come with Tendon, where they fit, or else those of these recordings.
fn cohort(options: &Options, dataset: &DatasetSettings, method: &MethodSettings) -> Result<Cohort, Failure> {
    let (channels, rate_hz) = (dataset.channels.len(), dataset.sample_rate_hz);
    if let Some(cohort) = shipped_prior().map_err(Failure::input)?
        && cohort.serves(method, channels, rate_hz).map_err(Failure::input)?
    {
        return Ok(cohort);
    }
    // What cannot be read is said when it is scored.
    gather_cohort(&options.recordings, dataset, method, &mut Vec::new(), &mut |_, _| {})
        .map_err(Failure::input)
}
