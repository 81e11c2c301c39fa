//! The windows of one person's recordings, with what was made in them.
//!
//! ```text
//! recordings ─▶ cut ─▶ PersonWindows ─┬─ some repetitions ─────────────▶ Person::fit
//!                                     ├─ a stretch of time, unlabelled ─▶ GestureMap ─▶ Person::fit
//!                                     └─ all of them ──────────────────▶ Cohort, GestureMap
//! ```

use std::collections::BTreeSet;

use tendon_dataset::{DatasetSettings, Recording, cut};
use tendon_features::{
    Class, Cohort, FeatureError, FitError, GestureMap, LaggedLogCovariance, MemberId, MethodSettings,
    PlacedGestures, Prior, Recognised, Training, UnlabelledError, rest_floor,
};
use tendon_gesture::Gesture;
use tendon_people::{Calibration, CalibrationError, Made, Person, PersonName, SignalFit};
use tendon_recordings::Channel;

use crate::left_out::{LeftOut, left_out_of};

/// So long after its onset, a movement still begins.
const ENTRY_MS: f64 = 500.0;
/// Time from one window to the next in which gestures are looked for without labels, s: what the method was tried with.
const UNLABELLED_INCREMENT_S: f64 = 0.075;

/// Where a window comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowOrigin {
    /// What the person was asked to make.
    pub gesture: Gesture,
    /// Place of the session among the person's.
    pub session: usize,
    /// Repetition counted through all sessions.
    pub repetition_of_all: u8,
    /// It begins within half a second of the onset of its movement.
    pub is_entry: bool,
    /// First sample after it, in the session's trials one after the other.
    pub end_sample: u64,
}

/// All windows of a person, in the order in which they were recorded.
#[derive(Debug)]
pub struct PersonWindows {
    signal: SignalFit,
    sessions: Vec<String>,
    /// Samples of the trials of each session, whole.
    session_samples: Vec<u64>,
    origins: Vec<WindowOrigin>,
    /// Windows x channels x samples.
    samples: Vec<f32>,
}

impl PersonWindows {
    /// Cuts all recordings of one person. What could not be used, and why, is added to `skipped`.
    pub fn read(
        settings: &DatasetSettings,
        recordings: &[Recording],
        skipped: &mut Vec<LeftOut>,
    ) -> PersonWindows {
        let mut windows = PersonWindows {
            signal: signal(settings),
            sessions: Vec::new(),
            session_samples: Vec::new(),
            origins: Vec::new(),
            samples: Vec::new(),
        };
        for recording in recordings {
            windows.add(settings, recording, skipped);
        }
        windows
    }

    fn add(&mut self, settings: &DatasetSettings, recording: &Recording, skipped: &mut Vec<LeftOut>) {
        let session = self.sessions.iter().position(|session| *session == recording.session);
        let session = session.unwrap_or_else(|| {
            self.sessions.push(recording.session.clone());
            self.session_samples.push(0);
            self.sessions.len() - 1
        });
        let (origins_before, samples_before) = (self.origins.len(), self.samples.len());
        let mut trials = Vec::new();
        let cut = cut(settings, recording, &mut |window| {
            self.samples.extend_from_slice(window.samples);
            trials.push((window.gesture, window.repetition, window.trial, window.start_sample));
        });
        match cut {
            Ok(cut) => {
                skipped.extend(left_out_of(&cut));
                let entry_samples = (ENTRY_MS * 1e-3 * settings.sample_rate_hz) as usize;
                let mut begin_samples = Vec::new();
                for trial in &cut.trials {
                    begin_samples.push(self.session_samples[session]);
                    self.session_samples[session] += trial.samples as u64;
                }
                let window_samples = settings.windows.window_samples;
                let origin = |(gesture, repetition_of_all, trial, start_sample): (_, _, usize, usize)| {
                    let end_sample = begin_samples[trial] + (start_sample + window_samples) as u64;
                    let onset = cut.trials[trial].onset_sample;
                    let is_entry = onset.is_some_and(|onset| start_sample < onset + entry_samples);
                    WindowOrigin { gesture, session, repetition_of_all, is_entry, end_sample }
                };
                self.origins.extend(trials.into_iter().map(origin));
            }
            Err(error) => {
                self.origins.truncate(origins_before);
                self.samples.truncate(samples_before);
                skipped.push(LeftOut::from(&recording.skipped(&error)));
            }
        }
    }

    /// The signal that the windows are of.
    pub fn signal(&self) -> &SignalFit {
        &self.signal
    }

    /// The names of the sessions, in order.
    pub fn sessions(&self) -> &[String] {
        &self.sessions
    }

    /// Where each window comes from.
    pub fn origins(&self) -> &[WindowOrigin] {
        &self.origins
    }

    /// The samples of a window, channel-major.
    pub fn window(&self, window: usize) -> &[f32] {
        let length = self.signal.window_length();
        &self.samples[window * length..][..length]
    }

    /// The windows of a session, or of all, of its first repetitions, or of all.
    pub fn chosen(&self, session: Option<&str>, repetitions: Option<u32>) -> Vec<usize> {
        let is_wanted =
            |origin: &WindowOrigin| session.is_none_or(|session| self.sessions[origin.session] == session);
        let wanted = self.origins.iter().filter(|origin| is_wanted(origin));
        let numbers: BTreeSet<u8> = wanted.map(|origin| origin.repetition_of_all).collect();
        let most = repetitions.map_or(usize::MAX, |repetitions| repetitions as usize);
        let numbers: BTreeSet<u8> = numbers.into_iter().take(most).collect();
        let calibrates = |window: &usize| {
            let origin = &self.origins[*window];
            is_wanted(origin) && numbers.contains(&origin.repetition_of_all)
        };
        (0..self.origins.len()).filter(calibrates).collect()
    }

    /// How long the trials of a session are together, s.
    pub fn session_s(&self, session: usize) -> f64 {
        self.session_samples[session] as f64 / self.signal.sample_rate_hz
    }

    /// Length of a window, s.
    pub(crate) fn window_s(&self) -> f64 {
        self.signal.window_samples as f64 / self.signal.sample_rate_hz
    }

    /// The windows of a session that lie wholly between two times, s from its start. What time counts are the trials, one
    /// after the other: also their beginnings, from which no windows are cut.
    pub fn stretch(&self, session: usize, from_s: f64, to_s: f64) -> Vec<usize> {
        let SignalFit { sample_rate_hz, window_samples, .. } = self.signal;
        let is_within = |window: &usize| {
            let origin = &self.origins[*window];
            let end_s = origin.end_sample as f64 / sample_rate_hz;
            let start_s = end_s - window_samples as f64 / sample_rate_hz;
            origin.session == session && start_s >= from_s && end_s <= to_s
        };
        (0..self.origins.len()).filter(is_within).collect()
    }

    /// Fits a person to some of the windows. `clipped_shares` are those of the channels, empty if nobody watched.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`]: what is wrong with them.
    pub fn fit(
        &self,
        windows: &[usize],
        name: PersonName,
        made: Made,
        method: &MethodSettings,
        prior: Option<&Prior>,
        clipped_shares: &[f64],
    ) -> Result<Person, CalibrationError> {
        let chosen = || windows.iter().map(|&window| self.origins[window]);
        let gestures = gestures(chosen());
        let samples: Vec<f32> = windows.iter().flat_map(|&window| self.window(window)).copied().collect();
        let labels: Vec<usize> = chosen().map(|origin| label(&gestures, origin.gesture)).collect();
        let repetitions: Vec<u32> = chosen().map(|origin| origin.repetition_of_all.into()).collect();
        let is_entry: Vec<bool> = chosen().map(|origin| origin.is_entry).collect();
        let calibration = Calibration {
            signal: &self.signal,
            gestures: &gestures,
            samples: &samples,
            labels: &labels,
            repetitions: &repetitions,
            is_entry: &is_entry,
            clipped_shares,
        };
        Person::fit(name, made, &calibration, method, prior)
    }

    /// Fits a person to windows that follow each other, without looking at what was made in them: `map` says what it probably
    /// was. The result of the recognition has a label for each window of the second list, which are those of `windows` that
    /// it was made on.
    ///
    /// # Errors
    ///
    /// [`UnlabelledFitError`]: what is wrong with them.
    pub fn fit_unlabelled(
        &self,
        windows: &[usize],
        name: PersonName,
        made: Made,
        method: &MethodSettings,
        others: (&Prior, &GestureMap),
    ) -> Result<(Person, Recognised, Vec<usize>), UnlabelledFitError> {
        let (prior, map) = others;
        let step = (UNLABELLED_INCREMENT_S / self.signal.increment_s()).round().max(1.0) as usize;
        let windows: Vec<usize> = windows.iter().copied().step_by(step).collect();
        let quietest = self.quietest(&windows);
        let (features, covariance) =
            self.features(method, &windows, quietest.iter().map(|&window| self.window(window)))?;
        let levels: Vec<f64> = features
            .chunks_exact(covariance.feature_count())
            .map(|features| covariance.mean_log_variance(features))
            .collect();
        let recognised = map.recognise(&features, &levels)?;
        let gestures: Vec<Gesture> =
            map.classes().iter().map(|name| name.parse().expect("they were gestures before")).collect();
        let samples: Vec<f32> = windows.iter().flat_map(|&window| self.window(window)).copied().collect();
        let calibration = Calibration {
            signal: &SignalFit {
                increment_samples: self.signal.increment_samples * step,
                ..self.signal.clone()
            },
            gestures: &gestures,
            samples: &samples,
            labels: &recognised.labels,
            // Nobody knows where a repetition begins.
            repetitions: &vec![0; windows.len()],
            is_entry: &[],
            clipped_shares: &[],
        };
        let person = Person::fit(name, made, &calibration, method, Some(prior))?;
        Ok((person, recognised, windows))
    }

    /// The tenth of the windows with the least power, which are rest if there is any.
    fn quietest(&self, windows: &[usize]) -> Vec<usize> {
        let power = |&window: &usize| -> f64 {
            self.window(window).iter().map(|sample| f64::from(*sample).powi(2)).sum()
        };
        let mut by_power: Vec<(f64, usize)> = windows.iter().map(|window| (power(window), *window)).collect();
        by_power.sort_by(|(one, _), (other, _)| one.total_cmp(other));
        let count = windows.len().div_ceil(10);
        by_power.into_iter().take(count).map(|(_, window)| window).collect()
    }

    /// The features of some windows, one after the other, with the floor of `rest`; and what computed them.
    fn features<'a>(
        &self,
        method: &MethodSettings,
        windows: &[usize],
        rest: impl Iterator<Item = &'a [f32]>,
    ) -> Result<(Vec<f64>, LaggedLogCovariance), FeatureError> {
        let SignalFit { channels, sample_rate_hz, .. } = &self.signal;
        let floor_variance = rest_floor(method, channels.len(), rest)?;
        let mut covariance =
            LaggedLogCovariance::new(method, channels.len(), *sample_rate_hz, floor_variance)?;
        let feature_count = covariance.feature_count();
        let mut features = vec![0.0; windows.len() * feature_count];
        for (&window, features) in windows.iter().zip(features.chunks_exact_mut(feature_count)) {
            covariance.compute(self.window(window), features)?;
        }
        Ok((features, covariance))
    }

    /// Adds the person to those who make priors for others. The floor is that of all windows of rest.
    ///
    /// # Errors
    ///
    /// [`MemberError`]: what is wrong with the windows.
    pub fn join(
        &self,
        id: MemberId,
        method: &MethodSettings,
        cohort: &mut Cohort,
    ) -> Result<(), MemberError> {
        let (features, feature_count) = self.all_features(method)?;
        let gestures = gestures(self.origins.iter().copied());
        let classes = classes(&gestures);
        let increment_s = self.signal.increment_s();
        let of_session = |session: usize| {
            let windows =
                (0..self.origins.len()).filter(move |&window| self.origins[window].session == session);
            Labelled::of(self, windows, &gestures, &features, feature_count)
        };
        let sessions: Vec<Labelled> = (0..self.sessions.len()).map(of_session).collect();
        let sessions: Vec<Training> = sessions
            .iter()
            .filter(|labelled| !labelled.labels.is_empty())
            .map(|labelled| labelled.training(&classes, feature_count, increment_s))
            .collect();
        let all = Labelled::of(self, 0..self.origins.len(), &gestures, &features, feature_count);
        Ok(cohort.add(id, &sessions, &all.training(&classes, feature_count, increment_s))?)
    }

    /// Where the person's gestures lie, with the armband turned by so many electrodes.
    ///
    /// # Errors
    ///
    /// [`MemberError`]: what is wrong with the windows.
    pub fn placed(&self, turn: i8, method: &MethodSettings) -> Result<PlacedGestures, MemberError> {
        let (features, feature_count) = self.all_features(method)?;
        let gestures = gestures(self.origins.iter().copied());
        let classes = classes(&gestures);
        let all = Labelled::of(self, 0..self.origins.len(), &gestures, &features, feature_count);
        let training = all.training(&classes, feature_count, self.signal.increment_s());
        Ok(PlacedGestures::new(turn, &training)?)
    }

    /// The features of all windows with the floor of all rest, and how many a window has.
    fn all_features(&self, method: &MethodSettings) -> Result<(Vec<f64>, usize), FeatureError> {
        let all: Vec<usize> = (0..self.origins.len()).collect();
        let rest = all.iter().filter(|&&window| self.origins[window].gesture == Gesture::REST);
        let (features, covariance) = self.features(method, &all, rest.map(|&window| self.window(window)))?;
        Ok((features, covariance.feature_count()))
    }
}

/// Why nobody can be fitted without labels.
#[derive(Debug, thiserror::Error)]
pub enum UnlabelledFitError {
    /// The windows make no features.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// No gestures are found in the windows.
    #[error(transparent)]
    Unlabelled(#[from] UnlabelledError),
    /// What is found makes no person.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
}

/// Why somebody's windows cannot make a prior.
#[derive(Debug, thiserror::Error)]
pub enum MemberError {
    /// The windows make no features.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The features cannot be used.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Features of windows with their gestures and repetitions.
struct Labelled {
    features: Vec<f64>,
    labels: Vec<usize>,
    blocks: Vec<usize>,
}

impl Labelled {
    fn of(
        person: &PersonWindows,
        windows: impl Iterator<Item = usize>,
        gestures: &[Gesture],
        features: &[f64],
        feature_count: usize,
    ) -> Labelled {
        let mut labelled = Labelled { features: Vec::new(), labels: Vec::new(), blocks: Vec::new() };
        for window in windows {
            let origin = person.origins[window];
            labelled.features.extend_from_slice(&features[window * feature_count..][..feature_count]);
            labelled.labels.push(label(gestures, origin.gesture));
            labelled.blocks.push(origin.repetition_of_all.into());
        }
        labelled
    }

    fn training<'a>(&'a self, classes: &'a [Class], feature_count: usize, increment_s: f64) -> Training<'a> {
        Training {
            classes,
            feature_count,
            features: &self.features,
            labels: &self.labels,
            increment_s,
            blocks: &self.blocks,
        }
    }
}

/// The gestures of windows, rest first if it is there.
fn gestures(origins: impl Iterator<Item = WindowOrigin>) -> Vec<Gesture> {
    origins.map(|origin| origin.gesture).collect::<BTreeSet<_>>().into_iter().collect()
}

fn classes(gestures: &[Gesture]) -> Vec<Class> {
    gestures.iter().map(|gesture| Class { name: gesture.name().to_owned(), weight: 1.0 }).collect()
}

fn label(gestures: &[Gesture], gesture: Gesture) -> usize {
    gestures.iter().position(|own| *own == gesture).expect("every gesture of the windows is listed")
}

/// The signal of windows that are cut with these settings.
fn signal(settings: &DatasetSettings) -> SignalFit {
    SignalFit {
        channels: settings.channels.iter().map(Channel::name).collect(),
        sample_rate_hz: settings.sample_rate_hz,
        unit: String::new(),
        window_samples: settings.windows.window_samples,
        increment_samples: settings.windows.increment_samples,
        filter: settings.filter.clone(),
    }
}
