//! Which windows a model is trained on, which ones tell when to stop, and which ones test it.
//!
//! ```text
//! people, sessions,  ┬─ held out ─▶ test: all of their windows
//! repetitions        └─ others ───▶ of each gesture one window in five, chosen by chance: validation; the rest: training
//! ```
//! Neighbouring windows overlap, so those of one person must never be on both sides of the test: validation says
//! how well a model learns, and only the test how well it does for somebody new.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;

use tendon_identity::{PersonId, list_of};
use tendon_recordings::npy::MappedArray;

use crate::listing::Layout;
use crate::recording::Recording;
use crate::trial::RecordingEntry;

/// Share of the windows of each gesture, of people who are not held out, that validation gets.
pub const VALIDATION_SHARE: f64 = 0.2;

/// Two people of 3DC part of whose recordings are copies of each other.
const THREE_DC_TWINS: [PersonId; 2] = [PersonId::Number(13), PersonId::Number(14)];

/// Whether a model that knows person `one` of a layout has seen recordings of `other`.
pub fn share_recordings(layout: Layout, one: PersonId, other: PersonId) -> bool {
    let are_twins =
        layout == Layout::ThreeDc && [one, other].iter().all(|person| THREE_DC_TWINS.contains(person));
    one == other || are_twins
}

/// What a window is for. The numbers are those of `splits.npy`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Split {
    /// A model learns from it.
    Training = 0,
    /// It shows when a model has learned enough.
    Validation = 1,
    /// It tests a model, which has never seen its person, or not in its session.
    Test = 2,
}

impl Split {
    /// The split of a number in `splits.npy`.
    pub(crate) fn from_number(number: u8) -> Option<Split> {
        [Split::Training, Split::Validation, Split::Test].into_iter().find(|split| *split as u8 == number)
    }
}

/// How the windows were divided.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitEntry {
    /// People held out, in order.
    pub test_people: Vec<PersonId>,
    /// Sessions held out of all people, in order.
    #[serde(default)]
    pub test_sessions: Vec<String>,
    /// Repetitions held out of all people, counted through all sessions of the person, in order.
    #[serde(default)]
    pub test_repetitions: Vec<u8>,
    /// What is held out, in words.
    #[serde(default)]
    pub held_out: String,
    /// People of whom windows are for training, in order.
    pub train_people: Vec<PersonId>,
    /// [`VALIDATION_SHARE`].
    pub validation_share: f64,
    /// What chance was seeded with.
    pub seed: u64,
    /// Windows of each split.
    pub windows: SplitWindows,
}

/// Windows of each split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SplitWindows {
    /// For training.
    pub train: u64,
    /// For validation.
    pub validation: u64,
    /// For the test.
    pub test: u64,
}

/// What the windows for training hold: z-scores come from it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrainingStatistics {
    /// By name of the gesture.
    pub per_gesture: BTreeMap<String, GestureStatistics>,
    /// Mean of each channel over all of them, in the recording's unit.
    pub channel_mean: Vec<f64>,
    /// Standard deviation (of the population) of each channel over all of them, in the recording's unit.
    pub channel_sd: Vec<f64>,
}

/// What the windows of a gesture for training hold.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GestureStatistics {
    /// How many they are.
    pub windows: u64,
    /// Sum of the samples of each channel.
    pub sum: Vec<f64>,
    /// Sum of their squares.
    pub sum_of_squares: Vec<f64>,
}

/// Why people cannot be held out.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SplitError {
    /// Somebody to hold out who is not there.
    #[error("there is no person {person} to hold out: choose among {}", list_of(.known))]
    UnknownTestPerson {
        /// Who was asked for.
        person: PersonId,
        /// The people there are.
        known: Vec<PersonId>,
    },
    /// A session to hold out that nobody has.
    #[error("there is no session {session} to hold out: choose among {}", .known.join(", "))]
    UnknownTestSession {
        /// The session asked for.
        session: String,
        /// The sessions there are.
        known: Vec<String>,
    },
    /// A repetition to hold out that nobody made.
    #[error(
        "there is no repetition {repetition} to hold out, counted through all sessions of a person: choose among {}",
        .known.iter().map(u8::to_string).collect::<Vec<_>>().join(", ")
    )]
    UnknownTestRepetition {
        /// The repetition asked for.
        repetition: u8,
        /// The repetitions there are.
        known: Vec<u8>,
    },
    /// Everybody is held out.
    #[error("all people ({}) are held out: leave at least one to train on", list_of(.known))]
    EverybodyHeldOut {
        /// The people there are.
        known: Vec<PersonId>,
    },
    /// Two people who must stay together.
    #[error(
        "people {} and {} of 3DC share recordings (part of one's files are copies of the other's): hold out both or \
         neither",
        .people[0], .people[1]
    )]
    TwinsDivided {
        /// The two.
        people: [PersonId; 2],
    },
}

/// Refuses people to hold out who are not there, are everybody, or cannot be held out alone.
pub(crate) fn check_people(
    test_people: &[PersonId],
    layout: Layout,
    recordings: &[Recording],
) -> Result<(), SplitError> {
    let known: BTreeSet<PersonId> = recordings.iter().map(|recording| recording.person).collect();
    if let Some(&person) = test_people.iter().find(|person| !known.contains(person)) {
        return Err(SplitError::UnknownTestPerson { person, known: known.into_iter().collect() });
    }
    if !known.is_empty() && known.iter().all(|person| test_people.contains(person)) {
        return Err(SplitError::EverybodyHeldOut { known: known.into_iter().collect() });
    }
    let are_known = THREE_DC_TWINS.iter().all(|person| known.contains(person));
    let held_out = THREE_DC_TWINS.iter().filter(|person| test_people.contains(person)).count();
    if layout == Layout::ThreeDc && are_known && held_out == 1 {
        return Err(SplitError::TwinsDivided { people: THREE_DC_TWINS });
    }
    Ok(())
}

/// Refuses sessions to hold out that nobody has.
pub(crate) fn check_sessions(test_sessions: &[String], recordings: &[Recording]) -> Result<(), SplitError> {
    let known: BTreeSet<&String> = recordings.iter().map(|recording| &recording.session).collect();
    match test_sessions.iter().find(|session| !known.contains(session)) {
        Some(session) => Err(SplitError::UnknownTestSession {
            session: session.clone(),
            known: known.into_iter().cloned().collect(),
        }),
        None => Ok(()),
    }
}

/// Whose windows, and which, are for the test.
pub(crate) struct HeldOut<'a> {
    pub(crate) test_people: &'a [PersonId],
    pub(crate) test_sessions: &'a [String],
    pub(crate) test_repetitions: &'a [u8],
}

impl HeldOut<'_> {
    /// Refuses repetitions to hold out that nobody made.
    pub(crate) fn check_repetitions(&self, recordings: &[RecordingEntry]) -> Result<(), SplitError> {
        let known: BTreeSet<u8> = recordings.iter().map(|entry| entry.repetition_of_all).collect();
        match self.test_repetitions.iter().find(|repetition| !known.contains(repetition)) {
            Some(&repetition) => {
                Err(SplitError::UnknownTestRepetition { repetition, known: known.into_iter().collect() })
            }
            None => Ok(()),
        }
    }

    /// Whether the windows of a trial are for the test.
    fn includes(&self, entry: &RecordingEntry) -> bool {
        self.test_people.contains(&entry.person) || self.is_part(entry)
    }

    /// Whether a trial is of a part that is held out of everybody.
    fn is_part(&self, entry: &RecordingEntry) -> bool {
        self.test_sessions.contains(&entry.session)
            || self.test_repetitions.contains(&entry.repetition_of_all)
    }
}

/// What is held out, in words.
fn held_out(test_people: &[PersonId], test_sessions: &[String], test_repetitions: &[u8]) -> String {
    let numbers: Vec<String> = test_repetitions.iter().map(u8::to_string).collect();
    let of_known = |what: &str, names: &[String]| {
        (!names.is_empty()).then(|| format!("{what} {} of people trained on", names.join(", ")))
    };
    let people = (!test_people.is_empty()).then(|| format!("people {}", list_of(test_people)));
    let parts = [people, of_known("session", test_sessions), of_known("repetition", &numbers)];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    if parts.is_empty() { "nothing".to_owned() } else { parts.join(" and ") }
}

/// What each window is for, in order.
pub(crate) fn splits(recordings: &[RecordingEntry], held_out: &HeldOut<'_>, seed: u64) -> Vec<Split> {
    let mut splits = Vec::new();
    let mut others: BTreeMap<Gesture, Vec<usize>> = BTreeMap::new();
    for entry in recordings {
        let windows = entry.windows as usize;
        if held_out.includes(entry) {
            splits.extend(std::iter::repeat_n(Split::Test, windows));
        } else {
            others.entry(entry.gesture).or_default().extend(splits.len()..splits.len() + windows);
            splits.extend(std::iter::repeat_n(Split::Training, windows));
        }
    }
    for windows in others.values_mut() {
        let count = (VALIDATION_SHARE * windows.len() as f64).round() as usize;
        windows.sort_by_key(|&index| chance(seed, index as u64));
        for &index in &windows[..count] {
            splits[index] = Split::Validation;
        }
    }
    splits
}

/// The number that chance gives to a window: those with the smallest are chosen. SplitMix64 (Steele, Lea and Flood
/// 2014, "Fast splittable pseudorandom number generators"), so that any other program can tell the same windows.
fn chance(seed: u64, index: u64) -> u64 {
    let state = seed.wrapping_add((index + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mixed = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}

/// How `splits` were made of `recordings`.
pub(crate) fn entry_of(
    splits: &[Split],
    recordings: &[RecordingEntry],
    of: &HeldOut<'_>,
    seed: u64,
) -> SplitEntry {
    let count = |wanted: Split| splits.iter().filter(|&&split| split == wanted).count() as u64;
    let test_people: BTreeSet<PersonId> = of.test_people.iter().copied().collect();
    let trains = |entry: &&RecordingEntry| !of.is_part(entry);
    let people: BTreeSet<PersonId> = recordings.iter().filter(trains).map(|entry| entry.person).collect();
    let test_sessions: BTreeSet<String> = of.test_sessions.iter().cloned().collect();
    let test_sessions: Vec<String> = test_sessions.into_iter().collect();
    let test_repetitions: BTreeSet<u8> = of.test_repetitions.iter().copied().collect();
    let test_repetitions: Vec<u8> = test_repetitions.into_iter().collect();
    let held_out_people: Vec<PersonId> = test_people.iter().copied().collect();
    SplitEntry {
        held_out: held_out(&held_out_people, &test_sessions, &test_repetitions),
        test_sessions,
        test_repetitions,
        train_people: people.difference(&test_people).copied().collect(),
        test_people: test_people.into_iter().collect(),
        validation_share: VALIDATION_SHARE,
        seed,
        windows: SplitWindows {
            train: count(Split::Training),
            validation: count(Split::Validation),
            test: count(Split::Test),
        },
    }
}

/// What the windows for training hold.
pub(crate) fn statistics(
    windows: &mut MappedArray<f32>,
    splits: &[Split],
    recordings: &[RecordingEntry],
) -> TrainingStatistics {
    let (channels, samples) = (windows.row_shape()[0], windows.row_shape()[1]);
    let none =
        || GestureStatistics { windows: 0, sum: vec![0.0; channels], sum_of_squares: vec![0.0; channels] };
    let mut per_gesture: BTreeMap<String, GestureStatistics> = BTreeMap::new();
    for entry in recordings {
        let of_gesture = per_gesture.entry(entry.gesture.name().to_owned()).or_insert_with(none);
        for index in entry.first_window..entry.first_window + entry.windows {
            let index = index as usize;
            if splits[index] != Split::Training {
                continue;
            }
            of_gesture.windows += 1;
            for (channel, values) in windows.row(index).chunks_exact(samples).enumerate() {
                let (mut sum, mut sum_of_squares) = (0.0, 0.0);
                for &value in values {
                    let value = f64::from(value);
                    sum += value;
                    sum_of_squares += value * value;
                }
                of_gesture.sum[channel] += sum;
                of_gesture.sum_of_squares[channel] += sum_of_squares;
            }
            windows.release_before(index);
        }
    }
    let mut total = none();
    for of_gesture in per_gesture.values() {
        total.windows += of_gesture.windows;
        for channel in 0..channels {
            total.sum[channel] += of_gesture.sum[channel];
            total.sum_of_squares[channel] += of_gesture.sum_of_squares[channel];
        }
    }
    let count = (total.windows * samples as u64) as f64;
    let channel_mean: Vec<f64> = total.sum.iter().map(|sum| sum / count).collect();
    let deviation = |(squares, mean): (&f64, &f64)| (squares / count - mean * mean).max(0.0).sqrt();
    let channel_sd = total.sum_of_squares.iter().zip(&channel_mean).map(deviation).collect();
    TrainingStatistics { per_gesture, channel_mean, channel_sd }
}
