//! Scores a model on windows: those of a data set, or those cut from recordings on the fly.
//!
//! ```text
//! data set ──▶ windows ──┐
//!                        ├─▶ model ─▶ tally ─▶ Scores
//! recordings ─▶ cut ─────┘
//! ```

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::Serialize;
use tendon_classifier::{Classifier, ClassifierError, Contract, WindowSource};
use tendon_dataset::{
    Cut, DatasetSettings, ListingError, Recording, StoredDataset, StoredDatasetError, cut, list,
};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_recordings::{RecordingError, SkippedKind};
use tendon_signal::WindowSettings;

use crate::evaluation::Evaluation;
use crate::left_out::{LeftOut, left_out_of};
use crate::people::{PeopleError, chosen_people};
use crate::sequence::{Sequence, TrialId};
use crate::tally::{Answer, Origin, Tally};

/// Scores of a model, and what they are of.
#[derive(Debug, Serialize)]
pub struct Scores {
    /// The ONNX file.
    pub model: String,
    /// A data set, or recordings.
    pub paths: Vec<String>,
    /// Who was scored.
    pub people: BTreeSet<PersonId>,
    /// The data set in which they have these numbers, such as `3DC`; `None` for recordings of your own.
    pub data_set: Option<String>,
    /// What the model has not seen of them, in words.
    pub scored_on: String,
    /// What the model's training got on its validation windows, if the model says so.
    pub validation_accuracy: Option<f64>,
    /// Recordings that could not be used, and why.
    pub skipped: Vec<LeftOut>,
    /// How much of it there is of each kind.
    pub skipped_by_kind: BTreeMap<SkippedKind, usize>,
    /// Time from the first byte to the last class, s.
    pub duration_s: f64,
    /// Seconds of signal for every second: of recordings, all that was read, windows or not; of a data set, an
    /// increment for every window.
    pub x_real_time: f64,
    /// The scores.
    #[serde(flatten)]
    pub evaluation: Evaluation,
}

/// Why a model cannot be scored.
#[derive(Debug, thiserror::Error)]
pub enum ScoreError {
    /// The model does not fit the windows.
    #[error(transparent)]
    Model(ClassifierError),
    /// The data set cannot be read.
    #[error(transparent)]
    Dataset(#[from] StoredDatasetError),
    /// There are no recordings to score on.
    #[error(transparent)]
    Listing(#[from] ListingError),
    /// The people asked for cannot be scored.
    #[error(transparent)]
    People(#[from] PeopleError),
    /// Not a single window of what the model knows.
    #[error("{}: no window shows what the model knows ({classes}){reasons}", .path.display())]
    NoWindows {
        /// The data set, or the first of the recordings.
        path: PathBuf,
        /// What the model knows.
        classes: String,
        /// Why recordings were left out, as the end of a sentence; empty if none was.
        reasons: String,
    },
    /// The model failed on a window.
    #[error("{place}: {error}")]
    Window {
        /// Which window, or the recording it is of.
        place: String,
        /// What the model's runtime says.
        error: ClassifierError,
    },
}

impl ScoreError {
    /// Whether what was given cannot be scored, rather than that the scoring broke off.
    pub fn is_bad_input(&self) -> bool {
        !matches!(self, ScoreError::Window { .. })
    }
}

/// How far a scoring has come: done, and in total.
pub type OnProgress<'a> = dyn FnMut(usize, usize) + 'a;

/// Windows between two reports of progress, and between two releases of memory.
const WINDOWS_A_ROUND: usize = 256;

/// Scores `classifier` on the data set in `folder`. `wanted` are the people to score; when empty, all whom the model
/// was not trained on. `on_progress` counts windows.
///
/// # Errors
/// When the data set cannot be read, does not fit the model, or holds nothing for it.
pub fn score_dataset(
    classifier: Classifier,
    folder: &Path,
    wanted: &[PersonId],
    on_progress: &mut OnProgress<'_>,
) -> Result<(Scores, Tally), ScoreError> {
    let mut dataset = StoredDataset::open(folder)?;
    let settings = dataset.manifest().settings.clone();
    let source = WindowSource {
        name: "the data set",
        channels: settings.channels.len(),
        sample_rate_hz: settings.sample_rate_hz,
        window_samples: settings.windows.window_samples,
        sequence_windows: usize::MAX,
        filter: settings.filter.as_ref(),
        input: settings.input,
    };
    classifier.check_fit(&source).map_err(ScoreError::Model)?;
    let known = dataset.manifest().windows_per_person.keys().copied().collect();
    let data_set = dataset.manifest().data_set.clone();
    let recordings = dataset.manifest().recordings.clone();
    let sessions = recordings.iter().map(|entry| (entry.person, entry.session.as_str()));
    let trained = people_known(&classifier, data_set.as_deref(), sessions);
    let people = chosen_people(&known, wanted, &trained)?;
    let mut scorer = Scorer::new(classifier, people, data_set);
    let windows = dataset.len();
    for index in 0..windows {
        if index % WINDOWS_A_ROUND == 0 {
            dataset.release_before(index);
            on_progress(index, windows);
        }
        let window = Window {
            samples: dataset.window(index),
            gesture: dataset.gesture(index),
            person: dataset.person(index),
            session: &recordings[dataset.recording(index) as usize].session,
            repetition: dataset.repetition(index),
            trial: TrialId { recording: 0, trial: dataset.recording(index) as usize },
        };
        scorer
            .take(&window)
            .map_err(|error| ScoreError::Window { place: format!("window {index}"), error })?;
    }
    let increments = scorer.tally.confusion().windows() * settings.windows.increment_samples as u64;
    scorer.finish(vec![folder.to_owned()], increments as f64 / settings.sample_rate_hz, Vec::new())
}

/// Scores `classifier` on the windows that are cut from the recordings at or below `paths` as `settings` say: see [`settings_of`].
/// `wanted` as for [`score_dataset`]; `on_progress` counts recordings.
///
/// # Errors
/// When there are no recordings, or none of what the model knows.
pub fn score_recordings(
    classifier: Classifier,
    paths: &[PathBuf],
    settings: &DatasetSettings,
    wanted: &[PersonId],
    on_progress: &mut OnProgress<'_>,
) -> Result<(Scores, Tally), ScoreError> {
    let source = WindowSource {
        name: "--channels",
        channels: settings.channels.len(),
        sample_rate_hz: settings.sample_rate_hz,
        window_samples: settings.windows.window_samples,
        sequence_windows: usize::MAX,
        filter: None,
        input: settings.input,
    };
    classifier.check_fit(&source).map_err(ScoreError::Model)?;
    let found = list(settings, paths)?;
    let known = found.recordings.iter().map(|recording| recording.person).collect();
    let data_set = found.layout.data_set();
    let sessions = found.recordings.iter().map(|recording| (recording.person, recording.session.as_str()));
    let trained = people_known(&classifier, data_set, sessions);
    let people = chosen_people(&known, wanted, &trained)?;
    let mut skipped: Vec<LeftOut> = found.skipped.iter().map(LeftOut::from).collect();
    let recordings: Vec<Recording> =
        found.recordings.into_iter().filter(|recording| people.contains(&recording.person)).collect();
    let mut scorer = Scorer::new(classifier, people, data_set.map(str::to_owned));
    let mut samples = 0;
    for (index, recording) in recordings.iter().enumerate() {
        on_progress(index, recordings.len());
        match scorer.take_recording(settings, recording, index)? {
            Ok(cut) => {
                samples += cut.samples;
                skipped.extend(left_out_of(&cut));
            }
            Err(error) => skipped.push(LeftOut::from(&recording.skipped(&error))),
        }
    }
    scorer.finish(paths.to_vec(), samples as f64 / settings.sample_rate_hz, skipped)
}

/// How recordings are cut for a model: as `tendon dataset build` does by default, with the model's filter, rate and
/// window.
pub fn settings_of(contract: &Contract) -> DatasetSettings {
    DatasetSettings {
        sample_rate_hz: contract.sample_rate_hz,
        filter: contract.filters.first().cloned(),
        input: contract.input,
        windows: WindowSettings {
            window_samples: contract.window_samples,
            increment_samples: (contract.window_samples / 4).max(1),
        },
        ..DatasetSettings::default()
    }
}

/// The people of `data_set` of whose `sessions` the model knows, or may know, all.
fn people_known<'a>(
    classifier: &Classifier,
    data_set: Option<&str>,
    sessions: impl Iterator<Item = (PersonId, &'a str)>,
) -> BTreeSet<PersonId> {
    let trained_on = &classifier.contract().trained_on;
    let mut known: BTreeSet<PersonId> = trained_on.people_of(data_set).iter().copied().collect();
    for (person, session) in sessions {
        if !trained_on.knows(data_set, person, session, None) {
            known.remove(&person);
        }
    }
    known
}

/// A window to be scored.
struct Window<'a> {
    /// Channel-major `[channels × samples]`.
    samples: &'a [f32],
    gesture: Gesture,
    person: PersonId,
    session: &'a str,
    repetition: u8,
    trial: TrialId,
}

/// A model being scored, window by window.
struct Scorer {
    classifier: Classifier,
    people: BTreeSet<PersonId>,
    data_set: Option<String>,
    tally: Tally,
    sequence: Sequence,
    start: Instant,
}

impl Scorer {
    fn new(classifier: Classifier, people: BTreeSet<PersonId>, data_set: Option<String>) -> Scorer {
        let Contract { channels, window_samples, sequence_windows, ref classes, .. } = *classifier.contract();
        let tally = Tally::new(classes);
        let sequence = Sequence::new(sequence_windows, channels * window_samples);
        Scorer { sequence, classifier, people, data_set, tally, start: Instant::now() }
    }

    fn take(&mut self, window: &Window<'_>) -> Result<(), ClassifierError> {
        let trained_on = &self.classifier.contract().trained_on;
        if !self.people.contains(&window.person)
            || trained_on.knows(
                self.data_set.as_deref(),
                window.person,
                window.session,
                Some(window.repetition),
            )
        {
            return Ok(());
        }
        let Some(truth) = self.tally.class_of(window.gesture) else { return Ok(()) };
        let start = Instant::now();
        let Some(input) = self.sequence.push(window.trial, window.samples) else { return Ok(()) };
        let probabilities = self.classifier.classify(input)?;
        let work_ns = start.elapsed().as_nanos() as u64;
        let origin = Origin { person: window.person, repetition: window.repetition };
        self.tally.record(truth, origin, Answer { probabilities, work_ns });
        Ok(())
    }

    /// Takes all windows of a recording, which has this place among all; one that cannot be read to its end counts for nothing.
    fn take_recording(
        &mut self,
        settings: &DatasetSettings,
        recording: &Recording,
        index: usize,
    ) -> Result<Result<Cut, RecordingError>, ScoreError> {
        let before = self.tally.clone();
        let mut result = Ok(());
        let cut = cut(settings, recording, &mut |window| {
            if result.is_ok() {
                result = self.take(&Window {
                    samples: window.samples,
                    gesture: window.gesture,
                    person: window.person,
                    session: &recording.session,
                    repetition: window.repetition,
                    trial: TrialId { recording: index, trial: window.trial },
                });
            }
        });
        let place = || recording.path.display().to_string();
        result.map_err(|error| ScoreError::Window { place: place(), error })?;
        if cut.is_err() {
            self.tally = before;
        }
        Ok(cut)
    }

    /// What the model has not seen of the people scored, in words.
    fn scored_on(&self) -> String {
        let trained_on = &self.classifier.contract().trained_on;
        let is_trained = |person: &PersonId| trained_on.people_of(self.data_set.as_deref()).contains(person);
        let trained = self.people.iter().filter(|person| is_trained(person)).count();
        let held_out = trained_on.held_out();
        if trained_on.people.is_empty() {
            "people, of whom the model does not say whether it was trained on them".to_owned()
        } else if trained == 0 {
            "people whom the model was not trained on".to_owned()
        } else if trained == self.people.len() {
            format!("{held_out} of people whom the model was trained on, in others")
        } else {
            format!(
                "people whom the model was not trained on, and {held_out} of others, whom it was trained on"
            )
        }
    }

    fn finish(
        self,
        paths: Vec<PathBuf>,
        signal_s: f64,
        skipped: Vec<LeftOut>,
    ) -> Result<(Scores, Tally), ScoreError> {
        let duration_s = self.start.elapsed().as_secs_f64();
        let evaluation = Evaluation::of(&self.tally);
        if evaluation.windows == 0 {
            let reasons = match &skipped[..] {
                [] => String::new(),
                [first, ..] => format!("; {} left out, the first because: {first}", skipped.len()),
            };
            let path = paths.into_iter().next().unwrap_or_default();
            return Err(ScoreError::NoWindows { path, classes: evaluation.classes.join(", "), reasons });
        }
        let scores = Scores {
            scored_on: self.scored_on(),
            model: self.classifier.path().display().to_string(),
            paths: paths.iter().map(|path| path.display().to_string()).collect(),
            people: self.people,
            data_set: self.data_set,
            validation_accuracy: self.classifier.contract().validation_accuracy,
            skipped_by_kind: SkippedKind::count(skipped.iter().map(|left_out| left_out.kind)),
            skipped,
            duration_s,
            x_real_time: signal_s / duration_s,
            evaluation,
        };
        Ok((scores, self.tally))
    }
}
