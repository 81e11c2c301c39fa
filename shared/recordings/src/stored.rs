//! A data set that [`dataset::build`](crate::dataset::build) wrote, read in place.

use std::path::{Path, PathBuf};

use tendon_gesture::Gesture;

use crate::dataset::{LABELS, MANIFEST, Manifest, PEOPLE, RECORDINGS, REPETITIONS, SPLITS, Split, WINDOWS};
use crate::npy::{Element, MappedArray};

/// Why a data set cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}; build the data set anew with `tendon dataset build`", path.display())]
pub struct StoredDatasetError {
    path: PathBuf,
    problem: String,
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
    /// Whether `folder` holds a complete data set.
    pub fn is_one(folder: &Path) -> bool {
        folder.join(MANIFEST).is_file()
    }

    /// Opens the data set in `folder`. Only a complete one has its manifest.
    ///
    /// # Errors
    /// [`StoredDatasetError`], naming the file that is missing, damaged, of an older version or does not fit the
    /// others.
    pub fn open(folder: &Path) -> Result<StoredDataset, StoredDatasetError> {
        let wrong = |name: &str, problem: String| StoredDatasetError { path: folder.join(name), problem };
        let text = std::fs::read_to_string(folder.join(MANIFEST))
            .map_err(|error| wrong(MANIFEST, format!("cannot read the manifest of a data set ({error})")))?;
        let manifest: Manifest = serde_json::from_str(&text)
            .map_err(|error| wrong(MANIFEST, format!("is damaged or of an older version ({error})")))?;
        let windows = open_array::<f32>(folder, WINDOWS, 2)?;
        let shape = [manifest.settings.channels.len(), manifest.settings.windows.window_samples];
        if windows.row_shape() != shape {
            let problem = format!("has windows of {:?}, the manifest says {shape:?}", windows.row_shape());
            return Err(wrong(WINDOWS, problem));
        }
        let dataset = StoredDataset {
            labels: open_array(folder, LABELS, 0)?,
            people: open_array(folder, PEOPLE, 0)?,
            repetitions: open_array(folder, REPETITIONS, 0)?,
            recordings: open_array(folder, RECORDINGS, 0)?,
            splits: open_array(folder, SPLITS, 0)?,
            windows,
            manifest,
        };
        let rows = [
            (WINDOWS, dataset.windows.rows()),
            (LABELS, dataset.labels.rows()),
            (PEOPLE, dataset.people.rows()),
            (REPETITIONS, dataset.repetitions.rows()),
            (RECORDINGS, dataset.recordings.rows()),
            (SPLITS, dataset.splits.rows()),
        ];
        for (name, rows) in rows {
            if rows as u64 != dataset.manifest.windows {
                let problem = format!("has {rows} rows, the manifest says {}", dataset.manifest.windows);
                return Err(wrong(name, problem));
            }
        }
        if let Some(index) = (0..dataset.len()).find(|index| dataset.gesture_number(*index) >= Gesture::COUNT)
        {
            let problem =
                format!("window {index} has label {}, which no gesture has", dataset.gesture_number(index));
            return Err(wrong(LABELS, problem));
        }
        if let Some(index) = (0..dataset.len()).find(|index| dataset.split_of(*index).is_none()) {
            let problem =
                format!("window {index} is of split {}, not 0, 1 or 2", dataset.splits.row(index)[0]);
            return Err(wrong(SPLITS, problem));
        }
        if !(1..dataset.len()).all(|index| dataset.recording(index - 1) <= dataset.recording(index)) {
            return Err(wrong(
                RECORDINGS,
                "the windows of a recording do not follow on each other".to_owned(),
            ));
        }
        Ok(dataset)
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
        Gesture::from_index(self.gesture_number(index))
            .expect("labels were checked when the data set was opened")
    }

    /// Number of the person whose window it is.
    pub fn person(&self, index: usize) -> u16 {
        self.people.row(index)[0]
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
    MappedArray::open(&path, row_dimensions).map_err(|problem| StoredDatasetError { path, problem })
}
