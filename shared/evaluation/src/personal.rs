//! Calibrates a recogniser to each person and scores it on what that person recorded later.
//!
//! ```text
//! person's first session ─▶ first N repetitions ─▶ features ─▶ discriminant ─┐
//! everybody else         ─▶ scatter within gestures ─▶ prior ────────────────┘
//! person's last session  ─▶ features ────────────────────────────────────────┴─▶ Tally
//! ```
//!
//! Nobody is scored with a prior that knows them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Instant;

use serde::Serialize;
use tendon_dataset::{DatasetSettings, Layout, ListingError, Recording, cut, list, share_recordings};
use tendon_features::{
    Class, CrossValidation, Discriminant, FeatureError, FitError, GestureMeans, LaggedLogCovariance,
    MethodSettings, Population, Prior, PriorError, Training, WithinClassScatter, rest_floor,
};
use tendon_gesture::Gesture;

use crate::evaluation::Evaluation;
use crate::people::{PeopleError, chosen_people};
use crate::score::OnProgress;
use crate::tally::{Answer, Origin, Tally};

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

impl PersonalSettings {
    /// Time from one window to the next.
    fn increment_s(&self) -> f64 {
        self.dataset.windows.increment_samples as f64 / self.dataset.sample_rate_hz
    }
}

/// Scores of recognisers that were calibrated to each person.
#[derive(Debug, Serialize)]
pub struct PersonalScores {
    /// The recordings.
    pub paths: Vec<String>,
    /// Who was scored.
    pub people: BTreeSet<u16>,
    /// The data set in which they have these numbers, such as `3DC`; `None` for recordings of your own.
    pub data_set: Option<String>,
    /// What calibrated, in words.
    pub calibrated_on: String,
    /// What was scored, in words.
    pub scored_on: String,
    /// Other people whose recordings made the prior; of the person with the fewest.
    pub prior_people: usize,
    /// Time to fit one person, s: the longest.
    pub longest_fit_s: f64,
    /// Recordings and people that could not be used, and why.
    pub skipped: Vec<String>,
    /// The scores.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

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
    /// A window cannot be recognised.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// Not one person has what it takes.
    #[error("nobody can be calibrated and scored: {}", .0.first().map_or("there are no recordings", String::as_str))]
    Nobody(Vec<String>),
}

/// Where a window comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Source {
    gesture: Gesture,
    /// Place of the session among the person's.
    session: usize,
    /// Repetition within the session, from 0.
    repetition: u32,
    /// Repetition counted through all sessions.
    repetition_of_all: u8,
}

/// All windows of a person, in the order in which they were recorded.
#[derive(Default)]
struct Windows {
    sessions: Vec<String>,
    sources: Vec<Source>,
    /// Windows × channels × samples.
    samples: Vec<f32>,
}

/// The features of a person's windows.
struct Person {
    sessions: Vec<String>,
    sources: Vec<Source>,
    /// The repetitions of the first session that calibrate.
    calibrating: BTreeSet<u32>,
    /// Windows × features.
    features: Vec<f64>,
    feature_count: usize,
    /// How long each window's features took, ns.
    work_ns: Vec<u64>,
    scatter: Option<WithinClassScatter>,
    /// `None` of somebody who made a gesture only once.
    means: Option<GestureMeans>,
}

impl Person {
    fn features_of(&self, window: usize) -> &[f64] {
        &self.features[window * self.feature_count..][..self.feature_count]
    }

    /// The windows that calibrate.
    fn calibration(&self) -> impl Iterator<Item = usize> {
        (0..self.sources.len()).filter(|&window| self.calibrates(window))
    }

    fn calibrates(&self, window: usize) -> bool {
        let Source { session, repetition, .. } = self.sources[window];
        session == 0 && self.calibrating.contains(&repetition)
    }

    /// The windows that are scored: those of the last session that did not calibrate.
    fn scored(&self) -> impl Iterator<Item = usize> {
        let last = self.sessions.len().saturating_sub(1);
        (0..self.sources.len())
            .filter(move |&window| self.sources[window].session == last && !self.calibrates(window))
    }
}

/// Calibrates to each of the people `wanted` (all when empty) whose recordings lie at or below `paths`, and scores them.
/// `on_progress` counts recordings.
///
/// # Errors
/// When there are no recordings, or nobody has a first and a later repetition of every gesture.
pub fn score_people(
    paths: &[PathBuf],
    settings: &PersonalSettings,
    wanted: &[u16],
    on_progress: &mut OnProgress<'_>,
) -> Result<(PersonalScores, Tally), PersonalError> {
    let found = list(&settings.dataset, paths)?;
    let known = found.recordings.iter().map(|recording| recording.person).collect();
    let chosen = chosen_people(&known, wanted, &BTreeSet::new())?;
    let mut skipped: Vec<String> = found.skipped.iter().map(ToString::to_string).collect();
    let mut by_person: BTreeMap<u16, Vec<Recording>> = BTreeMap::new();
    let total = found.recordings.len();
    for recording in found.recordings {
        by_person.entry(recording.person).or_default().push(recording);
    }
    let mut done = 0;
    let mut people: BTreeMap<u16, Person> = BTreeMap::new();
    for (number, recordings) in by_person {
        on_progress(done, total);
        done += recordings.len();
        let windows = windows_of(&settings.dataset, &recordings, &mut skipped);
        match person_of(settings, windows) {
            Ok(person) => _ = people.insert(number, person),
            Err(reason) => skipped.push(format!("person {number}: {reason}")),
        }
    }
    let made = people.values().flat_map(|person| person.sources.iter().map(|source| source.gesture));
    let made: BTreeSet<Gesture> = made.collect();
    let classes: Vec<_> = made.into_iter().map(tendon_gesture::Class::Gesture).collect();
    let mut tally = Tally::new(&classes);
    let (mut scored, mut longest_fit_s, mut fewest_others) = (BTreeSet::new(), 0.0_f64, people.len());
    for (&number, person) in people.iter().filter(|(number, _)| chosen.contains(number)) {
        let prior = prior_without(settings, found.layout, &people, number)?;
        let begun = Instant::now();
        match calibrate(person, settings, prior.as_ref()) {
            Ok((gestures, discriminant)) => {
                fewest_others = fewest_others.min(prior.as_ref().map_or(0, |prior| prior.people().len()));
                longest_fit_s = longest_fit_s.max(begun.elapsed().as_secs_f64());
                score(person, number, &gestures, &discriminant, &mut tally)?;
                scored.insert(number);
            }
            Err(error) => skipped.push(format!("person {number}: {error}")),
        }
    }
    let evaluation = Evaluation::of(&tally);
    if evaluation.windows == 0 {
        return Err(PersonalError::Nobody(skipped));
    }
    let scores = PersonalScores {
        paths: paths.iter().map(|path| path.display().to_string()).collect(),
        data_set: found.layout.data_set().map(str::to_owned),
        calibrated_on: format!(
            "the first {} repetitions of each person's first session",
            settings.repetitions
        ),
        scored_on: "each person's last session, or what is left of an only one".to_owned(),
        prior_people: fewest_others,
        people: scored,
        longest_fit_s,
        skipped,
        evaluation,
    };
    Ok((scores, tally))
}

/// Cuts all recordings of one person.
fn windows_of(settings: &DatasetSettings, recordings: &[Recording], skipped: &mut Vec<String>) -> Windows {
    let mut windows = Windows::default();
    for recording in recordings {
        let session = windows.sessions.iter().position(|session| *session == recording.session);
        let session = session.unwrap_or_else(|| {
            windows.sessions.push(recording.session.clone());
            windows.sessions.len() - 1
        });
        let (sources_before, samples_before) = (windows.sources.len(), windows.samples.len());
        let mut trials = Vec::new();
        let cut = cut(settings, recording, &mut |window| {
            windows.samples.extend_from_slice(window.samples);
            trials.push((window.trial, window.gesture, window.repetition));
        });
        match cut {
            Ok(cut) => {
                skipped.extend(cut.skipped.iter().map(ToString::to_string));
                windows.sources.extend(trials.into_iter().map(|(trial, gesture, repetition_of_all)| {
                    Source { gesture, session, repetition: cut.trials[trial].repetition, repetition_of_all }
                }));
            }
            Err(error) => {
                windows.sources.truncate(sources_before);
                windows.samples.truncate(samples_before);
                skipped.push(error.to_string());
            }
        }
    }
    windows
}

fn person_of(settings: &PersonalSettings, windows: Windows) -> Result<Person, PersonError> {
    let PersonalSettings { dataset, method, repetitions } = settings;
    let channels = dataset.channels.len();
    let length = channels * dataset.windows.window_samples;
    let Windows { sessions, sources, samples } = windows;
    let first = sources.iter().filter(|source| source.session == 0).map(|source| source.repetition);
    let calibrating = first.collect::<BTreeSet<u32>>().into_iter().take(*repetitions as usize).collect();
    let mut person = Person {
        sessions,
        sources,
        calibrating,
        features: Vec::new(),
        feature_count: 0,
        work_ns: Vec::new(),
        scatter: None,
        means: None,
    };
    let rest = person.calibration().filter(|&window| person.sources[window].gesture == Gesture::REST);
    let rest = rest.map(|window| &samples[window * length..][..length]);
    let floor_variance = rest_floor(method, channels, rest)?;
    let mut features = LaggedLogCovariance::new(method, channels, dataset.sample_rate_hz, floor_variance)?;
    person.feature_count = features.feature_count();
    person.features = vec![0.0; person.sources.len() * person.feature_count];
    let places = person.features.chunks_exact_mut(person.feature_count);
    for (samples, place) in samples.chunks_exact(length).zip(places) {
        let begun = Instant::now();
        features.compute(samples, place)?;
        person.work_ns.push(begun.elapsed().as_nanos() as u64);
    }
    let increment_s = settings.increment_s();
    person.scatter = scatter_of(&person, increment_s)?;
    let all = Labelled::of(&person, 0..person.sources.len(), increment_s);
    person.means = match GestureMeans::new(&all.training(person.feature_count)) {
        Ok(means) => Some(means),
        Err(FitError::TooFewRepetitions { .. }) => None,
        Err(error) => return Err(error.into()),
    };
    Ok(person)
}

/// Why one person is left out.
#[derive(Debug, thiserror::Error)]
enum PersonError {
    #[error(transparent)]
    Features(#[from] FeatureError),
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Windows with their gestures, as the discriminant wants them.
struct Labelled {
    gestures: Vec<Gesture>,
    classes: Vec<Class>,
    features: Vec<f64>,
    labels: Vec<usize>,
    blocks: Vec<usize>,
    increment_s: f64,
}

impl Labelled {
    fn of(person: &Person, windows: impl Iterator<Item = usize> + Clone, increment_s: f64) -> Labelled {
        let shown: BTreeSet<Gesture> = windows.clone().map(|window| person.sources[window].gesture).collect();
        let gestures: Vec<Gesture> = shown.into_iter().collect();
        let class = |gesture: &Gesture| Class { name: gesture.name().to_owned(), weight: 1.0 };
        let classes = gestures.iter().map(class).collect();
        let mut labelled = Labelled {
            gestures,
            classes,
            features: Vec::new(),
            labels: Vec::new(),
            blocks: Vec::new(),
            increment_s,
        };
        for window in windows {
            let Source { gesture, repetition_of_all, .. } = person.sources[window];
            labelled.features.extend_from_slice(person.features_of(window));
            let label = labelled.gestures.iter().position(|own| *own == gesture);
            labelled.labels.push(label.expect("every gesture of the windows has been listed"));
            labelled.blocks.push(repetition_of_all.into());
        }
        labelled
    }

    fn training(&self, feature_count: usize) -> Training<'_> {
        Training {
            classes: &self.classes,
            feature_count,
            features: &self.features,
            labels: &self.labels,
            increment_s: self.increment_s,
            blocks: &self.blocks,
        }
    }
}

/// How the windows of a person scatter within each gesture of a session.
fn scatter_of(person: &Person, increment_s: f64) -> Result<Option<WithinClassScatter>, FitError> {
    let mut total: Option<WithinClassScatter> = None;
    for session in 0..person.sessions.len() {
        let windows = (0..person.sources.len()).filter(|&window| person.sources[window].session == session);
        let labelled = Labelled::of(person, windows, increment_s);
        let scatter = WithinClassScatter::new(&labelled.training(person.feature_count))?;
        match &mut total {
            Some(total) => total.add(&scatter)?,
            None => total = Some(scatter),
        }
    }
    Ok(total)
}

/// What everybody but `person` has in common; `None` if there are too few of them.
fn prior_without(
    settings: &PersonalSettings,
    layout: Layout,
    people: &BTreeMap<u16, Person>,
    person: u16,
) -> Result<Option<Prior>, PersonalError> {
    let PersonalSettings { dataset, method, .. } = settings;
    let features = LaggedLogCovariance::new(method, dataset.channels.len(), dataset.sample_rate_hz, 1.0)?;
    let others: Vec<(String, &Person)> = people
        .iter()
        .filter(|(number, _)| !share_recordings(layout, person, **number))
        .map(|(number, other)| (number.to_string(), other))
        .collect();
    let scatters = others.iter().filter_map(|(name, other)| Some((name.as_str(), other.scatter.as_ref()?)));
    let prior = match Prior::pool(features.layout(), scatters) {
        Err(PriorError::TooFewWindows { .. }) => return Ok(None),
        pooled => pooled?,
    };
    match Population::pool(others.iter().filter_map(|(_, other)| other.means.as_ref())) {
        Err(PriorError::TooFewPeople(_)) => Ok(Some(prior)),
        population => Ok(Some(prior.with_population(population?)?)),
    }
}

fn calibrate(
    person: &Person,
    settings: &PersonalSettings,
    prior: Option<&Prior>,
) -> Result<(Vec<Gesture>, Discriminant), FitError> {
    let windows: Vec<usize> = person.calibration().collect();
    let labelled = Labelled::of(person, windows.iter().copied(), settings.increment_s());
    let training = labelled.training(person.feature_count);
    let discriminant = Discriminant::fit(&training, prior, &settings.method)?;
    let temperature = match CrossValidation::new(&training, prior, &settings.method) {
        Ok(validation) => validation.temperature(&settings.method),
        // A single repetition cannot be held out.
        Err(FitError::CannotHoldOut { .. }) => settings.method.temperature_range[0],
        Err(error) => return Err(error),
    };
    Ok((labelled.gestures, discriminant.with_temperature(temperature)?))
}

fn score(
    person: &Person,
    number: u16,
    gestures: &[Gesture],
    discriminant: &Discriminant,
    tally: &mut Tally,
) -> Result<(), PersonalError> {
    let mut posterior = vec![0.0; gestures.len()];
    let classes = tally.classes();
    let place = |gesture: &Gesture| {
        let place = classes.iter().position(|class| class.includes(*gesture));
        place.expect("the classes are all gestures of all people")
    };
    let places: Vec<usize> = gestures.iter().map(place).collect();
    let mut probabilities = vec![0.0; classes.len()];
    for window in person.scored() {
        let Source { gesture, repetition_of_all, .. } = person.sources[window];
        let Some(truth) = tally.class_of(gesture).filter(|_| gestures.contains(&gesture)) else { continue };
        let begun = Instant::now();
        discriminant.posterior(person.features_of(window), &mut posterior)?;
        let work_ns = person.work_ns[window] + begun.elapsed().as_nanos() as u64;
        for (place, probability) in places.iter().zip(&posterior) {
            probabilities[*place] = *probability as f32;
        }
        let origin = Origin { person: number, repetition: repetition_of_all };
        tally.record(truth, origin, Answer { probabilities: &probabilities, work_ns });
    }
    Ok(())
}
