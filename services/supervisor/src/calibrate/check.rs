//! A check round: each gesture once more, recognised without the calibration and with it.
//!
//! ```text
//! round of cues ─▶ recordings/WHEN-check ─▶ windows ─┬─▶ the person of before, or a network   before
//!                                                    └─▶ the person                           after
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use tendon_classifier::{Classifier, default_model_file, model_beside_program, runtime_library};
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, list};
use tendon_evaluation::{PersonWindows, score_recordings, settings_of};
use tendon_gesture::{Gesture, Strategy};
use tendon_guide::{Guide, GuideSettings};
use tendon_people::{Person, PersonalRecogniser};
use tendon_recordings::{Channel, RecordedSession, Recorder};
use tendon_session::Writer;

use super::round::{Live, RoundEnd};
use super::scores::CheckScores;
use super::status::Phase;
use crate::Failure;
use crate::personal::recorded_settings;

/// What the folder of a check round ends with.
const ENDING: &str = "-check";

/// A check round.
pub struct CheckRound<'a> {
    /// The configuration of the calibration.
    pub config: &'a Config,
    /// What was asked in the calibration.
    pub guide: &'a GuideSettings,
    /// The person who was there before.
    pub before: Option<&'a Person>,
}

/// Whether this is the folder of a check round.
pub fn is_check(folder: &Path) -> bool {
    folder.to_str().is_none_or(|folder| folder.ends_with(ENDING))
}

impl CheckRound<'_> {
    /// Asks for each gesture once more and scores. `calibration` is the folder of the calibration. Gives nothing if somebody
    /// said stop.
    pub fn run(
        &self,
        live: &mut Live<'_>,
        person: &Person,
        calibration: &Path,
        errors: &Writer,
    ) -> Result<Option<CheckScores>, Failure> {
        let folder = PathBuf::from(format!("{}{ENDING}", calibration.display()));
        let session = RecordedSession::read(calibration).map_err(Failure::running)?;
        let session =
            session.context("the calibration's own description is gone").map_err(Failure::running)?;
        let mut recorder = Recorder::create(&folder, session.clone()).map_err(Failure::running)?;
        let asked = GuideSettings { rest_s: 0.0, repetitions: 1, ..self.guide.clone() };
        let mut guide = Guide::new(asked, session.sample_rate_hz);
        if live.round(Phase::Check, &mut guide, &mut recorder)? == RoundEnd::Stopped {
            return Ok(None);
        }
        drop(recorder);
        let scores = live.meanwhile(|| self.score(person, &folder, &session))?;
        let (scores, remark) = scores.map_err(Failure::running)?;
        if let Some(remark) = remark {
            errors.say(remark);
        }
        Ok(Some(scores))
    }

    /// Scores a round that was recorded, and says why there is no score before, if so.
    fn score(
        &self,
        person: &Person,
        folder: &Path,
        session: &RecordedSession,
    ) -> anyhow::Result<(CheckScores, Option<String>)> {
        let settings = recorded_settings(self.config, session);
        let after_by_gesture = recognised_in(person, &settings, folder)?;
        let before = match self.before {
            Some(before) => recognised_in(before, &settings, folder)
                .map(|shares| (format!("{} of {}", before.name, before.made.at), mean(&shares))),
            None => network(folder, session.channels.len()),
        };
        let after = mean(&after_by_gesture);
        let (before, remark) = match before {
            Ok(before) => (Some(before), None),
            Err(error) => {
                (None, Some(format!("there is nothing to compare the check round with: {error:#}")))
            }
        };
        let (before_by, before) = before.unzip();
        Ok((CheckScores { before_by, before, after, after_by_gesture }, remark))
    }
}

/// Share of each gesture's windows in `folder` that a person's recogniser recognises.
fn recognised_in(
    person: &Person,
    settings: &DatasetSettings,
    folder: &Path,
) -> anyhow::Result<BTreeMap<Gesture, f64>> {
    let signal = &person.signal;
    ensure!(
        signal.channels.len() == settings.channels.len() && signal.sample_rate_hz == settings.sample_rate_hz,
        "{} was calibrated with other channels or another rate",
        person.name
    );
    let mut settings = settings.clone();
    settings.windows.window_samples = signal.window_samples;
    let found = list(&settings, &[folder.to_owned()])?;
    let mut skipped = Vec::new();
    let windows = PersonWindows::read(&settings, &found.recordings, &mut skipped);
    let reasons: Vec<String> = skipped.iter().map(ToString::to_string).collect();
    ensure!(!windows.origins().is_empty(), "no window was recorded: {}", reasons.join("; "));
    recognised(person, &windows)
}

/// Share of each gesture's windows that a person's recogniser recognises.
pub fn recognised(person: &Person, windows: &PersonWindows) -> anyhow::Result<BTreeMap<Gesture, f64>> {
    let gestures = person.gesture_set();
    let mut recogniser = PersonalRecogniser::new(person, person.signal.increment_samples)?;
    let mut counts: BTreeMap<Gesture, (u64, u64)> = BTreeMap::new();
    for (window, origin) in windows.origins().iter().enumerate() {
        let probabilities = recogniser.recognise_alone(windows.window(window))?.probabilities;
        let best = probabilities.iter().enumerate().max_by(|(_, one), (_, other)| one.total_cmp(other));
        let best = best.and_then(|(number, _)| gestures.get(number as u8));
        let (right, all) = counts.entry(origin.gesture).or_default();
        *right += u64::from(best == Some(origin.gesture));
        *all += 1;
    }
    Ok(counts.into_iter().map(|(gesture, (right, all))| (gesture, right as f64 / all as f64)).collect())
}

/// The same of the network that comes with Tendon, all gestures together.
fn network(folder: &Path, channels: usize) -> anyhow::Result<(String, f64)> {
    let file = default_model_file(Strategy::Direct).context("the direct strategy has a model")?;
    let model = model_beside_program(file)?;
    let classifier = Classifier::load(&runtime_library(None)?, &model)?;
    let channels: Vec<Channel> = (0..channels).map(Channel::Index).collect();
    let settings = DatasetSettings { channels, ..settings_of(classifier.contract()) };
    let (scores, _) = score_recordings(classifier, &[folder.to_owned()], &settings, &[], &mut |_, _| ())?;
    Ok((file.to_owned(), scores.evaluation.macro_average.recall))
}

/// The mean over the gestures.
pub fn mean(shares: &BTreeMap<Gesture, f64>) -> f64 {
    shares.values().sum::<f64>() / shares.len().max(1) as f64
}
