//! A data set that [`build`](crate::build) wrote, read in place.

use std::io;
use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;
use tendon_identity::PersonId;
use tendon_recordings::npy::{Element, MappedArray, NpyError};

use crate::files::{LABELS, MANIFEST, PEOPLE, RECORDINGS, REPETITIONS, SPLITS, WINDOWS};
use crate::manifest::Manifest;
use crate::split::Split;

/// Why a data set cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}; rebuild the data set with `tendon dataset build`", path.display())]
pub struct StoredDatasetError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: StoredDatasetProblem,
}

/// What can be wrong with a file of a data set.
#[derive(Debug, thiserror::Error)]
pub enum StoredDatasetProblem {
    /// There is no readable manifest.
    #[error("cannot read the manifest of a data set ({0})")]
    ManifestMissing(io::Error),
    /// The manifest is not what this version writes.
    #[error("is damaged or of an older version ({0})")]
    Manifest(serde_json::Error),
    /// A file that is not an array, or not the expected one.
    #[error("{0}")]
    Array(NpyError),
    /// Windows of another shape.
    #[error("has windows of {}, the manifest says {}", product(found), product(expected))]
    Shape {
        /// Channels and samples of the windows.
        found: Vec<usize>,
        /// Those of the manifest.
        expected: [usize; 2],
    },
    /// More or fewer rows than windows.
    #[error("has {found} rows, the manifest says {expected}")]
    Rows {
        /// Rows of the array.
        found: usize,
        /// Windows in the manifest.
        expected: u64,
    },
    /// A label beyond the gestures.
    #[error("window {window} has label {label}, which no gesture has")]
    Label {
        /// The window.
        window: usize,
        /// Its label.
        label: usize,
    },
    /// A number that stands for no split.
    #[error("window {window} is of split {split}, not 0, 1 or 2")]
    Split {
        /// The window.
        window: usize,
        /// Its split.
        split: u8,
    },
    /// Windows of one trial are scattered.
    #[error("the windows of a recording are not next to each other")]
    Scattered,
}

/// `4 × 600`, channels by samples.
fn product(shape: &[usize]) -> String {
    shape.iter().map(ToString::to_string).collect::<Vec<_>>().join(" × ")
}

/// Windows, whose they are and what they show, mapped into memory.
#[derive(Debug)]
pub struct StoredDataset {
    manifest: Manifest,
    windows: MappedArray<f32>,
    labels: MappedArray<u8>,
    people: MappedArray<u16>,
    repetitions: MappedArray<u8>,
    recordings: MappedArray<u32>,
    splits: MappedArray<u8>,
}

impl StoredDataset {
    /// Whether `folder` has the manifest of a data set, which only a complete one has.
    pub fn is_one(folder: &Path) -> bool {
        folder.join(MANIFEST).exists()
    }

    /// Opens the data set in `folder`. Only a complete one has its manifest.
    ///
    /// # Errors
    /// [`StoredDatasetError`], naming the file that is missing, damaged, of an older version or does not fit the
    /// others.
    pub fn open(folder: &Path) -> Result<StoredDataset, StoredDatasetError> {
        let wrong = |name, problem| StoredDatasetError { path: folder.join(name), problem };
        let manifest = Manifest::read(folder).map_err(|problem| wrong(MANIFEST, problem))?;
        let dataset = StoredDataset {
            windows: open_array(folder, WINDOWS, 2)?,
            labels: open_array(folder, LABELS, 0)?,
            people: open_array(folder, PEOPLE, 0)?,
            repetitions: open_array(folder, REPETITIONS, 0)?,
            recordings: open_array(folder, RECORDINGS, 0)?,
            splits: open_array(folder, SPLITS, 0)?,
            manifest,
        };
        dataset.check().map_err(|(name, problem)| wrong(name, problem))?;
        Ok(dataset)
    }

    /// Whether the arrays fit the manifest and hold what they may; the file that does not, and why.
    fn check(&self) -> Result<(), (&'static str, StoredDatasetProblem)> {
        let settings = &self.manifest.settings;
        let expected = [settings.channels.len(), settings.windows.window_samples];
        if self.windows.row_shape() != expected {
            let found = self.windows.row_shape().to_vec();
            return Err((WINDOWS, StoredDatasetProblem::Shape { found, expected }));
        }
        let rows = [
            (WINDOWS, self.windows.rows()),
            (LABELS, self.labels.rows()),
            (PEOPLE, self.people.rows()),
            (REPETITIONS, self.repetitions.rows()),
            (RECORDINGS, self.recordings.rows()),
            (SPLITS, self.splits.rows()),
        ];
        for (name, found) in rows {
            if found as u64 != self.manifest.windows {
                return Err((name, StoredDatasetProblem::Rows { found, expected: self.manifest.windows }));
            }
        }
        if let Some(window) =
            (0..self.len()).find(|window| self.gesture_number(*window) >= Gesture::PAPER.len())
        {
            let label = self.gesture_number(window);
            return Err((LABELS, StoredDatasetProblem::Label { window, label }));
        }
        if let Some(window) = (0..self.len()).find(|window| self.split_of(*window).is_none()) {
            let split = self.splits.row(window)[0];
            return Err((SPLITS, StoredDatasetProblem::Split { window, split }));
        }
        if !(1..self.len()).all(|index| self.recording(index - 1) <= self.recording(index)) {
            return Err((RECORDINGS, StoredDatasetProblem::Scattered));
        }
        Ok(())
    }

    /// Settings, counts, and what became of each file.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Number of windows.
    pub fn len(&self) -> usize {
        self.labels.rows()
    }

    /// Whether there is no window.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A window, channel-major `[channels × samples]`, in place.
    pub fn window(&self, index: usize) -> &[f32] {
        self.windows.row(index)
    }

    /// What the window shows.
    pub fn gesture(&self, index: usize) -> Gesture {
        Gesture::PAPER[self.gesture_number(index)]
    }

    /// Whose window it is.
    pub fn person(&self, index: usize) -> PersonId {
        let number = self.people.row(index)[0];
        self.manifest.named_people.get(&number).copied().unwrap_or(PersonId::Number(number))
    }

    /// Repetition of the gesture, counted through all sessions of the person.
    pub fn repetition(&self, index: usize) -> u8 {
        self.repetitions.row(index)[0]
    }

    /// What the window is for.
    pub fn split(&self, index: usize) -> Split {
        self.split_of(index).expect("splits were checked when the data set was opened")
    }

    /// The trial that the window was cut from: its place in the manifest's `recordings`.
    pub fn recording(&self, index: usize) -> u32 {
        self.recordings.row(index)[0]
    }

    /// Says that all windows before `index` have been read, so that a large data set does not pile up in this
    /// process's memory.
    pub fn release_before(&mut self, index: usize) {
        self.windows.release_before(index);
    }

    fn split_of(&self, index: usize) -> Option<Split> {
        Split::from_number(self.splits.row(index)[0])
    }

    fn gesture_number(&self, index: usize) -> usize {
        usize::from(self.labels.row(index)[0])
    }
}

fn open_array<T: Element>(
    folder: &Path,
    name: &str,
    row_dimensions: usize,
) -> Result<MappedArray<T>, StoredDatasetError> {
    let path = folder.join(name);
    MappedArray::open(&path, row_dimensions)
        .map_err(|error| StoredDatasetError { path, problem: StoredDatasetProblem::Array(error) })
}
