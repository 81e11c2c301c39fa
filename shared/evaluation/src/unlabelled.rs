//! Calibrates a recogniser to each person on a stretch of use of which nobody says what was made, and scores it on what that
//! person recorded later.
//!
//! ```text
//! other people, the armband turned by -2 … 2 electrodes ─▶ GestureMap ─┐    prior ─┐
//! person's first session ─▶ first seconds, labels unused ──────────────┴─▶ labels ─┴─▶ Person::fit ─┐
//! person's last session ────────────────────────────────────────────────────────────────────────────┴─▶ Tally
//! ```
//!
//! Other people are those whose recordings lie beside: the turned armband takes electrodes that the prior that ships does not
//! have. None of those who are asked for is among them.

use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use tendon_dataset::{DatasetSettings, Layout, share_recordings};
use tendon_features::{
    Cohort, GestureMap, LaggedLogCovariance, MethodSettings, PlacedGestures, Prior, Recognised,
    UnlabelledError,
};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_people::{Made, Person, PersonName, PersonalRecogniser, RecogniseError};
use tendon_recordings::Channel;

use crate::evaluation::Spread;
use crate::left_out::LeftOut;
use crate::people::chosen_people;
use crate::personal::{ByPerson, PersonalError, PersonalScores, Scored, ScoredOn};
use crate::score::OnProgress;
use crate::tally::Tally;
use crate::windows::{PersonWindows, UnlabelledFitError};

/// By how many electrodes the armband is turned.
const TURNS: [i8; 5] = [0, -2, -1, 1, 2];

/// How people are calibrated without labels.
#[derive(Clone, Debug, PartialEq)]
pub struct UnlabelledSettings {
    /// How windows are cut.
    pub dataset: DatasetSettings,
    /// The constants of the recogniser.
    pub method: MethodSettings,
    /// So long a stretch of the first session calibrates, s. It counts all trials whole, also their beginnings, from which
    /// no windows are cut.
    pub stretch_s: f64,
}

/// Scores of recognisers that were calibrated without labels.
#[derive(Debug, Serialize)]
pub struct UnlabelledScores {
    /// As of those that are calibrated with labels.
    #[serde(flatten)]
    pub scores: PersonalScores,
    /// How it went with each person.
    pub unlabelled: Vec<UnlabelledPerson>,
    /// Mean of people of [`UnlabelledPerson::all_stretches_accuracy`]; `None` if nobody has more than one session.
    pub all_stretches_accuracy: Option<f64>,
}

/// How it went with one person.
#[derive(Clone, Debug, Serialize)]
pub struct UnlabelledPerson {
    /// Who it is.
    pub person: PersonId,
    /// The share of the gestures that were expected to have their right names, from the stretch alone.
    pub sureness: f64,
    /// Share of the windows of the stretch that were taken for what the person made.
    pub right_labels: f64,
    /// Mean accuracy over every stretch of this length, one after the other in each session, that could calibrate, each scored
    /// on another session; `None` if there is only one session.
    pub all_stretches_accuracy: Option<f64>,
    /// Accuracy after each of them.
    pub all_stretches: Vec<f64>,
}

/// Calibrates to each of the people `wanted` (all when empty) whose recordings lie at or below `paths`, without labels, and
/// scores them. Others are all who are not `wanted`, or else all but the person; nobody who shares recordings with them.
/// `on_progress` counts readings of people.
///
/// # Errors
/// When there are no recordings, others are too few, or nobody has a stretch in which gestures are found.
pub fn score_unlabelled(
    paths: &[PathBuf],
    settings: &UnlabelledSettings,
    wanted: &[PersonId],
    on_progress: &mut OnProgress<'_>,
) -> Result<(UnlabelledScores, Tally), PersonalError> {
    let UnlabelledSettings { dataset, method, stretch_s } = settings;
    let mut skipped = Vec::new();
    let found = ByPerson::list(dataset, paths, &mut skipped)?;
    let chosen = chosen_people(&found.people.keys().copied().collect(), wanted, &Default::default())?;
    let turned = turned(dataset, found.layout);
    let reads = found.people.len() * turned.len();
    let mut progress = |done| on_progress(done, reads + chosen.len());
    let others = Others::gather(&found, &turned, method, &mut skipped, &mut progress)?;

    let mut scored = Scored::default();
    let mut unlabelled = Vec::new();
    for (done, &number) in chosen.iter().enumerate() {
        progress(reads + done);
        let windows = PersonWindows::read(dataset, &found.people[&number], &mut skipped);
        let left_out = if wanted.is_empty() { &[number] } else { wanted };
        let (prior, map) = others.without(&found, left_out)?;
        let calibrating = Calibrating { number, windows: &windows, method, prior: &prior, map: &map };
        match calibrating.score(*stretch_s, &mut scored) {
            Ok(person) => unlabelled.push(person),
            Err(error) => skipped.push(LeftOut::person(format!("person {number}: {error}"))),
        }
    }
    let (scores, tally) = scored.finish(ScoredOn {
        paths,
        layout: found.layout,
        calibrated_on: format!("the first {stretch_s} s of each person's first session, without labels"),
        prior_from: "the other people of these recordings",
        skipped,
    })?;
    let of_all: Vec<f64> = unlabelled.iter().filter_map(|person| person.all_stretches_accuracy).collect();
    let all_stretches_accuracy = (!of_all.is_empty()).then(|| Spread::of(&of_all).mean);
    Ok((UnlabelledScores { scores, unlabelled, all_stretches_accuracy }, tally))
}

/// The settings with the armband turned, as far as its other electrodes were recorded.
fn turned(settings: &DatasetSettings, layout: Layout) -> Vec<(i8, DatasetSettings)> {
    let with_turn = |turn: i8| {
        let channel = |channel: &Channel| match (channel, layout.electrodes_around_arm()) {
            (Channel::Index(index), Some(count)) => {
                let index = (*index as i64 + i64::from(turn)).rem_euclid(count as i64);
                Some(Channel::Index(index as usize))
            }
            _ if turn == 0 => Some(channel.clone()),
            _ => None,
        };
        let channels: Option<Vec<Channel>> = settings.channels.iter().map(channel).collect();
        Some((turn, DatasetSettings { channels: channels?, ..settings.clone() }))
    };
    TURNS.into_iter().filter_map(with_turn).collect()
}

/// What everybody's windows tell of others.
struct Others {
    cohort: Cohort,
    placed: Vec<(PersonId, PlacedGestures)>,
}

impl Others {
    fn gather(
        found: &ByPerson,
        turned: &[(i8, DatasetSettings)],
        method: &MethodSettings,
        skipped: &mut Vec<LeftOut>,
        progress: &mut impl FnMut(usize),
    ) -> Result<Others, PersonalError> {
        let (_, settings) = &turned[0];
        let features =
            LaggedLogCovariance::new(method, settings.channels.len(), settings.sample_rate_hz, 1.0)?;
        let mut others = Others { cohort: Cohort::new(features.layout()), placed: Vec::new() };
        for (place, (turn, settings)) in turned.iter().enumerate() {
            for (done, (&number, recordings)) in found.people.iter().enumerate() {
                progress(place * found.people.len() + done);
                // What cannot be read is said when the person is scored.
                let windows = PersonWindows::read(settings, recordings, &mut Vec::new());
                let joined = if *turn == 0 {
                    windows.join(found.id(number), method, &mut others.cohort)
                } else {
                    Ok(())
                };
                match joined.and_then(|()| windows.placed(*turn, method)) {
                    Ok(gestures) => others.placed.push((number, gestures)),
                    Err(error) if *turn == 0 => {
                        let reason = format!("person {number} tells nothing of others: {error}");
                        skipped.push(LeftOut::person(reason));
                    }
                    Err(_) => {}
                }
            }
        }
        Ok(others)
    }

    /// The prior and the map of those who share no recordings with anybody `left_out`.
    fn without(&self, found: &ByPerson, left_out: &[PersonId]) -> Result<(Prior, GestureMap), PersonalError> {
        let is_other =
            |number: PersonId| !left_out.iter().any(|&out| share_recordings(found.layout, out, number));
        let others = self.cohort.members().filter(|member| is_other(member.person)).count();
        let prior = self.cohort.prior(|member| is_other(member.person))?;
        let prior = prior.ok_or(UnlabelledError::TooFewPeople(others))?;
        let placed = self.placed.iter().filter(|(number, _)| is_other(*number));
        let placed: Vec<PlacedGestures> = placed.map(|(_, gestures)| gestures.clone()).collect();
        Ok((prior, GestureMap::new(&placed, Gesture::REST.name())?))
    }
}

/// Why one person is left out.
#[derive(Debug, thiserror::Error)]
enum PersonError {
    #[error(transparent)]
    Fit(#[from] UnlabelledFitError),
    #[error(transparent)]
    Recognise(#[from] RecogniseError),
}

/// A person and those who tell of them.
struct Calibrating<'a> {
    number: PersonId,
    windows: &'a PersonWindows,
    method: &'a MethodSettings,
    prior: &'a Prior,
    map: &'a GestureMap,
}

impl Calibrating<'_> {
    /// Calibrates on the first stretch and scores it, then on all others.
    fn score(&self, stretch_s: f64, scored: &mut Scored) -> Result<UnlabelledPerson, PersonError> {
        let calibrating = self.windows.stretch(0, 0.0, stretch_s);
        let begun = Instant::now();
        let (person, recognised, stream) = self.fit(&calibrating)?;
        let expected = person.expected.accuracy * recognised.sureness;
        scored.fitted(self.number, begun.elapsed().as_secs_f64(), Some(self.prior), expected);
        // Windows that share samples with the stretch are not scored either.
        let touched = self.windows.stretch(0, 0.0, stretch_s + self.windows.window_s());
        scored.windows(self.number, self.windows, &touched, &person)?;
        let all_stretches = self.all_stretches(stretch_s)?;
        Ok(UnlabelledPerson {
            person: self.number,
            sureness: recognised.sureness,
            right_labels: self.right_labels(&recognised, &stream),
            all_stretches_accuracy: (!all_stretches.is_empty()).then(|| Spread::of(&all_stretches).mean),
            all_stretches,
        })
    }

    fn fit(&self, windows: &[usize]) -> Result<(Person, Recognised, Vec<usize>), UnlabelledFitError> {
        let name = PersonName::of(self.number);
        self.windows.fit_unlabelled(windows, name, Made::default(), self.method, (self.prior, self.map))
    }

    /// Share of the windows `stream` that were recognised as what was made.
    fn right_labels(&self, recognised: &Recognised, stream: &[usize]) -> f64 {
        let made = stream.iter().map(|&window| self.windows.origins()[window].gesture);
        let is_right = |(gesture, label): &(Gesture, &usize)| self.map.classes()[**label] == gesture.name();
        made.zip(&recognised.labels).filter(is_right).count() as f64 / stream.len().max(1) as f64
    }

    /// Accuracy after each stretch of each session that can calibrate, on the last session or, for the last, on the first.
    fn all_stretches(&self, stretch_s: f64) -> Result<Vec<f64>, RecogniseError> {
        let last = self.windows.sessions().len().saturating_sub(1);
        let mut accuracies = Vec::new();
        if last == 0 {
            return Ok(accuracies);
        }
        for session in 0..=last {
            let count = (self.windows.session_s(session) / stretch_s).floor() as usize;
            let scored = if session == last { 0 } else { last };
            for stretch in 0..count {
                let from_s = stretch as f64 * stretch_s;
                let calibrating = self.windows.stretch(session, from_s, from_s + stretch_s);
                // A stretch in which a gesture is missing may not make a person.
                if let Ok((person, ..)) = self.fit(&calibrating) {
                    accuracies.push(self.accuracy(&person, scored)?);
                }
            }
        }
        Ok(accuracies)
    }

    /// Share of a session's windows that are recognised.
    fn accuracy(&self, person: &Person, session: usize) -> Result<f64, RecogniseError> {
        let gestures = person.gesture_set();
        let mut recogniser = PersonalRecogniser::new(person, self.windows.signal().increment_samples)?;
        let (mut right, mut all) = (0_usize, 0_usize);
        for (window, origin) in self.windows.origins().iter().enumerate() {
            let Some(truth) = gestures.number(origin.gesture).filter(|_| origin.session == session) else {
                continue;
            };
            let recognition = recogniser.recognise_alone(self.windows.window(window))?;
            let mut best = 0;
            for (gesture, probability) in recognition.probabilities.iter().enumerate() {
                if *probability > recognition.probabilities[best] {
                    best = gesture;
                }
            }
            right += usize::from(best == truth as usize);
            all += 1;
        }
        Ok(right as f64 / all.max(1) as f64)
    }
}
