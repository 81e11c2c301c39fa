//! What stands beside the arrays of a data set: settings, counts, and what became of each trial.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};
use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_provenance::Provenance;
use tendon_recordings::{Channel, SkippedEntry, SkippedKind};

use crate::files::MANIFEST;
use crate::listing::Layout;
use crate::settings::DatasetSettings;
use crate::split::{SplitEntry, TrainingStatistics};
use crate::stored::StoredDatasetProblem;
use crate::trial::{OnsetStatistics, RecordingEntry};

/// What was made of which recordings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The settings it was made with.
    pub settings: DatasetSettings,
    /// Name of the data set that the recordings are of, such as `3DC`; `null` for recordings of your own.
    #[serde(default)]
    pub data_set: Option<String>,
    /// Gestures by their numbers in `labels.npy`; empty in data sets of earlier versions, which have these.
    #[serde(default)]
    pub classes: Vec<String>,
    /// Names of the channels in their order in `windows.npy`, numbers from 0 where the recordings give no names; empty in data
    /// sets of earlier versions.
    #[serde(default)]
    pub channel_names: Vec<String>,
    /// Unit of the samples; empty if nobody knows.
    #[serde(default)]
    pub unit: String,
    /// Windows in all.
    pub windows: u64,
    /// Windows of each gesture, by name.
    pub windows_per_gesture: BTreeMap<String, u64>,
    /// Windows of each person.
    pub windows_per_person: BTreeMap<PersonId, u64>,
    /// People who have names instead of numbers, by the number that `people.npy` has for each.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub named_people: BTreeMap<u16, PersonId>,
    /// Trials, rest not counted, in which no onset was found.
    pub fallbacks: u64,
    /// How onsets were found, by gesture, and over all as `total`: the paper's table of fallbacks.
    pub onsets: BTreeMap<String, OnsetStatistics>,
    /// What the windows are for.
    pub split: SplitEntry,
    /// What the windows for training hold.
    pub training_statistics: TrainingStatistics,
    /// Every trial that was used, in the order of the windows.
    pub recordings: Vec<RecordingEntry>,
    /// Everything that was not used.
    pub skipped: Vec<SkippedEntry>,
    /// How much of it there is of each kind.
    #[serde(default)]
    pub skipped_by_kind: BTreeMap<SkippedKind, usize>,
    /// What the user should know about the recordings.
    pub notices: Vec<String>,
    /// Program, machine, options and hashes of the recordings.
    #[serde(default)]
    pub provenance: Provenance,
}

/// What the builder knows of a data set when its windows are written.
pub(crate) struct Content<'a> {
    pub(crate) layout: Layout,
    /// Unit of the samples; empty if nobody knows.
    pub(crate) unit: &'a str,
    pub(crate) windows: u64,
    pub(crate) recordings: Vec<RecordingEntry>,
    pub(crate) skipped: Vec<SkippedEntry>,
    pub(crate) notices: Vec<String>,
}

impl Manifest {
    /// Reads that of the data set in `folder`.
    pub(crate) fn read(folder: &Path) -> Result<Manifest, StoredDatasetProblem> {
        let text = tendon_input::read_text(&folder.join(MANIFEST), tendon_input::LARGEST_LIST)
            .map_err(StoredDatasetProblem::ManifestMissing)?;
        serde_json::from_str(&text).map_err(StoredDatasetProblem::Manifest)
    }

    pub(crate) fn of(
        settings: &DatasetSettings,
        content: Content<'_>,
        split: SplitEntry,
        training_statistics: TrainingStatistics,
    ) -> Manifest {
        let Content { windows, recordings, skipped, notices, .. } = content;
        let mut windows_per_gesture = BTreeMap::new();
        let mut windows_per_person = BTreeMap::new();
        for entry in &recordings {
            *windows_per_gesture.entry(entry.gesture.name().to_owned()).or_default() += entry.windows;
            *windows_per_person.entry(entry.person).or_default() += entry.windows;
        }
        let of_gesture = |gesture: Gesture| {
            let statistics = OnsetStatistics::of(recordings.iter().filter(|entry| entry.gesture == gesture));
            (gesture.name().to_owned(), statistics)
        };
        let total = ("total".to_owned(), OnsetStatistics::of(recordings.iter()));
        Manifest {
            settings: settings.clone(),
            data_set: content.layout.data_set().map(str::to_owned),
            classes: Gesture::PAPER.map(|gesture| gesture.name().to_owned()).to_vec(),
            channel_names: settings.channels.iter().map(Channel::name).collect(),
            unit: content.unit.to_owned(),
            windows,
            windows_per_gesture,
            named_people: named_people(&recordings),
            windows_per_person,
            fallbacks: recordings.iter().filter(|entry| entry.fallback).count() as u64,
            onsets: Gesture::PAPER_ACTIVE.into_iter().map(of_gesture).chain([total]).collect(),
            split,
            training_statistics,
            recordings,
            skipped_by_kind: SkippedKind::count(skipped.iter().map(|skipped| skipped.kind)),
            skipped,
            notices,
            provenance: Provenance::default(),
        }
    }
}

/// A number for everybody who has a name: the smallest that nobody has.
pub(crate) fn named_people(recordings: &[RecordingEntry]) -> BTreeMap<u16, PersonId> {
    let people: BTreeSet<PersonId> = recordings.iter().map(|entry| entry.person).collect();
    let is_free = |number: &u16| !people.contains(&PersonId::Number(*number));
    let names = people.iter().copied().filter(|person| matches!(person, PersonId::Name(_)));
    (1..=u16::MAX).filter(is_free).zip(names).collect()
}
