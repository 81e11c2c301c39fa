//! Calibrates a recogniser to each person and scores it on what that person recorded later.
//!
//! ```text
//! person's first session ─▶ first N repetitions ─▶ Person::fit ─▶ recogniser ─┐
//! other people ─▶ Cohort without the person ─▶ prior ──┘                      │
//! person's last session ──────────────────────────────────────────────────────┴─▶ Tally
//! ```
//!
//! Nobody is scored with a prior that knows them. Other people are those of the prior that ships, where it fits, or else
//! those whose recordings lie beside.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use tendon_dataset::{DatasetSettings, Layout, ListingError, Recording, list, share_recordings};
use tendon_features::{
    Cohort, FeatureError, LaggedLogCovariance, MemberId, MethodSettings, Prior, PriorError, UnlabelledError,
};
use tendon_gesture::{Class, Gesture};
use tendon_identity::PersonId;
use tendon_people::{CalibrationError, Made, Person, PersonName, PersonalRecogniser, RecogniseError};
use tendon_recordings::SkippedKind;

use crate::evaluation::{Evaluation, Spread};
use crate::left_out::LeftOut;
use crate::people::{PeopleError, chosen_people};
use crate::score::OnProgress;
use crate::tally::{Answer, Origin, Tally};
use crate::windows::PersonWindows;

/// How people are calibrated.
#[derive(Clone, Debug, PartialEq)]
pub struct PersonalSettings {
    /// How windows are cut.
    pub dataset: DatasetSettings,
    /// The constants of the recogniser.
    pub method: MethodSettings,
    /// Repetitions of each gesture that calibrate: the first ones of the first session.
    pub repetitions: u32,
}

/// Scores of recognisers that were calibrated to each person.
#[derive(Debug, Serialize)]
pub struct PersonalScores {
    /// The recordings.
    pub paths: Vec<String>,
    /// Who was scored.
    pub people: BTreeSet<PersonId>,
    /// The data set in which they have these numbers, such as `3DC`; `None` for recordings of your own.
    pub data_set: Option<String>,
    /// What calibrated, in words.
    pub calibrated_on: String,
    /// What was scored, in words.
    pub scored_on: String,
    /// Whose recordings made the prior, in words.
    pub prior_from: &'static str,
    /// Other people whose recordings made the prior; of the person with the fewest.
    pub prior_people: usize,
    /// What the calibrations alone said of the accuracy to expect; mean of the people.
    pub expected_accuracy: f64,
    /// Time to fit one person, s: the longest.
    pub longest_fit_s: f64,
    /// Recordings and people that could not be used, and why.
    pub skipped: Vec<LeftOut>,
    /// How much of it there is of each kind.
    pub skipped_by_kind: BTreeMap<SkippedKind, usize>,
    /// The scores.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// What is scored of people who are calibrated, in words.
pub const SCORED_SESSION: &str = "each person's last session, or what is left of an only one";

/// Why nobody can be calibrated and scored.
#[derive(Debug, thiserror::Error)]
pub enum PersonalError {
    /// There are no recordings to score on.
    #[error(transparent)]
    Listing(#[from] ListingError),
    /// The people asked for cannot be scored.
    #[error(transparent)]
    People(#[from] PeopleError),
    /// The settings of the recogniser do not fit the recordings.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// Other people's windows make no prior.
    #[error(transparent)]
    Prior(#[from] PriorError),
    /// Other people's windows do not show where gestures lie.
    #[error(transparent)]
    Unlabelled(#[from] UnlabelledError),
    /// A window cannot be recognised.
    #[error(transparent)]
    Recognise(#[from] RecogniseError),
    /// Not one person has what it takes.
    #[error("nobody can be calibrated and scored: {}", main_reason(.0))]
    Nobody(Vec<LeftOut>),
}

/// Why somebody is left out says more than why a trial is.
fn main_reason(skipped: &[LeftOut]) -> &str {
    let of_person = skipped.iter().find(|left_out| left_out.kind == SkippedKind::Person);
    of_person.or(skipped.first()).map_or("there are no recordings", |left_out| &left_out.reason)
}

/// The recordings at or below some paths, by person.
pub(crate) struct ByPerson {
    pub(crate) layout: Layout,
    pub(crate) people: BTreeMap<PersonId, Vec<Recording>>,
}

impl ByPerson {
    pub(crate) fn list(
        settings: &DatasetSettings,
        paths: &[PathBuf],
        skipped: &mut Vec<LeftOut>,
    ) -> Result<ByPerson, ListingError> {
        let found = list(settings, paths)?;
        skipped.extend(found.skipped.iter().map(LeftOut::from));
        let mut people: BTreeMap<PersonId, Vec<Recording>> = BTreeMap::new();
        for recording in found.recordings {
            people.entry(recording.person).or_default().push(recording);
        }
        Ok(ByPerson { layout: found.layout, people })
    }

    pub(crate) fn id(&self, number: PersonId) -> MemberId {
        MemberId { data_set: self.layout.data_set().unwrap_or_default().to_owned(), person: number }
    }

    /// Everybody whose windows can be used, with all their windows. `on_person` is told how many are done.
    fn cohort(
        &self,
        settings: &DatasetSettings,
        method: &MethodSettings,
        skipped: &mut Vec<LeftOut>,
        on_person: &mut OnProgress<'_>,
    ) -> Result<Cohort, FeatureError> {
        let features =
            LaggedLogCovariance::new(method, settings.channels.len(), settings.sample_rate_hz, 1.0)?;
        let mut cohort = Cohort::new(features.layout());
        for (done, (&number, recordings)) in self.people.iter().enumerate() {
            on_person(done, self.people.len());
            let windows = PersonWindows::read(settings, recordings, skipped);
            if let Err(error) = windows.join(self.id(number), method, &mut cohort) {
                skipped.push(LeftOut::person(format!("person {number} makes no prior for others: {error}")));
            }
        }
        Ok(cohort)
    }
}

/// Gathers what the people whose recordings lie at or below `paths` tell of others: the prior that a program can ship.
/// It serves rates from half to twice the one at which it was made.
///
/// # Errors
/// When there are no recordings, or the settings do not fit them.
pub fn gather_cohort(
    paths: &[PathBuf],
    settings: &DatasetSettings,
    method: &MethodSettings,
    skipped: &mut Vec<LeftOut>,
    on_progress: &mut OnProgress<'_>,
) -> Result<Cohort, PersonalError> {
    let found = ByPerson::list(settings, paths, skipped)?;
    let cohort = found.cohort(settings, method, skipped, on_progress)?;
    let rate_hz = settings.sample_rate_hz;
    Ok(cohort.with_rates(0.5 * rate_hz, 2.0 * rate_hz))
}

/// The prior of everybody in `cohort` but a person and those who share recordings with them; `None` if they are too few.
///
/// # Errors
/// The gestures that all of them made are too few.
pub fn prior_without(cohort: &Cohort, layout: Layout, person: PersonId) -> Result<Option<Prior>, PriorError> {
    let data_set = layout.data_set().unwrap_or_default();
    cohort.prior(|member| member.data_set != data_set || !share_recordings(layout, person, member.person))
}

/// Calibrates to each of the people `wanted` (all when empty) whose recordings lie at or below `paths`, and scores them.
/// The prior is made of `shipped`, where it fits the recordings, or else of everybody's recordings at `paths`.
/// `on_progress` counts people, twice those who are read twice.
///
/// # Errors
/// When there are no recordings, or nobody has a first and a later repetition of every gesture.
pub fn score_people(
    paths: &[PathBuf],
    settings: &PersonalSettings,
    wanted: &[PersonId],
    shipped: Option<&Cohort>,
    on_progress: &mut OnProgress<'_>,
) -> Result<(PersonalScores, Tally), PersonalError> {
    let PersonalSettings { dataset, method, repetitions } = settings;
    let mut skipped = Vec::new();
    let found = ByPerson::list(dataset, paths, &mut skipped)?;
    let chosen = chosen_people(&found.people.keys().copied().collect(), wanted, &BTreeSet::new())?;
    let gathered;
    let (cohort, prior_from, read_before) = match shipped {
        Some(cohort) if cohort.serves(method, dataset.channels.len(), dataset.sample_rate_hz)? => {
            (cohort, "the people of the prior that comes with Tendon", 0)
        }
        _ => {
            // What cannot be read is said when the person is scored.
            let total = found.people.len() + chosen.len();
            let mut progress = |done, _| on_progress(done, total);
            gathered = found.cohort(dataset, method, &mut Vec::new(), &mut progress)?;
            (&gathered, "the other people of these recordings", found.people.len())
        }
    };

    let mut scored = Scored::default();
    for (done, &number) in chosen.iter().enumerate() {
        on_progress(read_before + done, read_before + chosen.len());
        let skipped_before = skipped.len();
        let windows = PersonWindows::read(dataset, &found.people[&number], &mut skipped);
        if windows.origins().is_empty() {
            let reason = skipped.get(skipped_before).map_or("there are no trials", |first| &first.reason);
            let reason = format!("person {number}: no recording holds a window that can be used: {reason}");
            skipped.push(LeftOut::person(reason));
            continue;
        }
        let prior = prior_without(cohort, found.layout, number)?;
        if let Err(error) = scored.person(number, &windows, settings, prior.as_ref()) {
            skipped.push(LeftOut::person(format!("person {number}: {error}")));
        }
    }
    scored.finish(ScoredOn {
        paths,
        layout: found.layout,
        calibrated_on: match repetitions {
            1 => "the first repetition of each person's first session".to_owned(),
            _ => format!("the first {repetitions} repetitions of each person's first session"),
        },
        prior_from,
        skipped,
    })
}

/// What the scores of people are of.
pub(crate) struct ScoredOn<'a> {
    pub(crate) paths: &'a [PathBuf],
    pub(crate) layout: Layout,
    pub(crate) calibrated_on: String,
    pub(crate) prior_from: &'static str,
    pub(crate) skipped: Vec<LeftOut>,
}

/// What the people so far gave.
#[derive(Default)]
pub(crate) struct Scored {
    people: BTreeSet<PersonId>,
    expected: Vec<f64>,
    longest_fit_s: f64,
    fewest_others: Option<usize>,
    answers: Vec<GivenAnswer>,
}

/// What a person's recogniser made of a window.
struct GivenAnswer {
    gesture: Gesture,
    origin: Origin,
    probabilities: Vec<(Gesture, f32)>,
    work_ns: u64,
}

/// Why one person is left out.
#[derive(Debug, thiserror::Error)]
enum PersonError {
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    #[error(transparent)]
    Features(#[from] FeatureError),
    #[error(transparent)]
    Recognise(#[from] RecogniseError),
}

impl Scored {
    /// Calibrates to a person and scores them.
    fn person(
        &mut self,
        number: PersonId,
        windows: &PersonWindows,
        settings: &PersonalSettings,
        prior: Option<&Prior>,
    ) -> Result<(), PersonError> {
        let first = windows.sessions().first().map(String::as_str);
        let calibrating = windows.chosen(first, Some(settings.repetitions));
        let name = PersonName::of(number);
        let begun = Instant::now();
        let person = windows.fit(&calibrating, name, Made::default(), &settings.method, prior, &[])?;
        self.fitted(number, begun.elapsed().as_secs_f64(), prior, person.expected.accuracy);
        Ok(self.windows(number, windows, &calibrating, &person)?)
    }

    /// Notes that somebody was fitted in so many seconds.
    pub(crate) fn fitted(
        &mut self,
        number: PersonId,
        fit_s: f64,
        prior: Option<&Prior>,
        expected_accuracy: f64,
    ) {
        self.longest_fit_s = self.longest_fit_s.max(fit_s);
        let others = prior.map_or(0, |prior| prior.people().len());
        self.fewest_others = Some(self.fewest_others.map_or(others, |fewest| fewest.min(others)));
        self.people.insert(number);
        self.expected.push(expected_accuracy);
    }

    /// Scores the windows of the last session that did not calibrate.
    pub(crate) fn windows(
        &mut self,
        number: PersonId,
        windows: &PersonWindows,
        calibrating: &[usize],
        person: &Person,
    ) -> Result<(), RecogniseError> {
        let gestures = person.gesture_set();
        let mut recogniser = PersonalRecogniser::new(person, windows.signal().increment_samples)?;
        let last = windows.sessions().len().saturating_sub(1);
        for (window, origin) in windows.origins().iter().enumerate() {
            let calibrates = calibrating.binary_search(&window).is_ok();
            if origin.session != last || calibrates || gestures.number(origin.gesture).is_none() {
                continue;
            }
            let begun = Instant::now();
            let recognition = recogniser.recognise_alone(windows.window(window))?;
            let work_ns = begun.elapsed().as_nanos() as u64;
            self.answers.push(GivenAnswer {
                gesture: origin.gesture,
                origin: Origin { person: number, repetition: origin.repetition_of_all },
                probabilities: gestures.iter().zip(recognition.probabilities.iter().copied()).collect(),
                work_ns,
            });
        }
        Ok(())
    }

    /// The scores of all people.
    ///
    /// # Errors
    /// Nobody was scored.
    pub(crate) fn finish(self, of: ScoredOn<'_>) -> Result<(PersonalScores, Tally), PersonalError> {
        let tally = self.tally();
        let evaluation = Evaluation::of(&tally);
        if evaluation.windows == 0 {
            return Err(PersonalError::Nobody(of.skipped));
        }
        let scores = PersonalScores {
            paths: of.paths.iter().map(|path| path.display().to_string()).collect(),
            data_set: of.layout.data_set().map(str::to_owned),
            calibrated_on: of.calibrated_on,
            scored_on: SCORED_SESSION.to_owned(),
            prior_from: of.prior_from,
            prior_people: self.fewest_others.unwrap_or(0),
            expected_accuracy: Spread::of(&self.expected).mean,
            people: self.people,
            longest_fit_s: self.longest_fit_s,
            skipped_by_kind: SkippedKind::count(of.skipped.iter().map(|left_out| left_out.kind)),
            skipped: of.skipped,
            evaluation,
        };
        Ok((scores, tally))
    }

    /// All answers, over the gestures of all people.
    fn tally(&self) -> Tally {
        let made: BTreeSet<Gesture> = self
            .answers
            .iter()
            .flat_map(|answer| answer.probabilities.iter().map(|(gesture, _)| *gesture))
            .collect();
        let gestures: Vec<Gesture> = made.into_iter().collect();
        let place = |gesture: Gesture| gestures.iter().position(|own| *own == gesture);
        let classes: Vec<Class> = gestures.iter().copied().map(Class::Gesture).collect();
        let mut tally = Tally::new(&classes);
        let mut probabilities = vec![0.0; gestures.len()];
        for answer in &self.answers {
            probabilities.fill(0.0);
            for &(gesture, probability) in &answer.probabilities {
                if let Some(place) = place(gesture) {
                    probabilities[place] = probability;
                }
            }
            if let Some(truth) = place(answer.gesture) {
                tally.record(
                    truth,
                    answer.origin,
                    Answer { probabilities: &probabilities, work_ns: answer.work_ns },
                );
            }
        }
        tally
    }
}
