//! Why recordings cannot be used together.

use std::path::PathBuf;

use tendon_identity::PersonId;
use tendon_recordings::labels::LabelsError;
use tendon_recordings::{RecorderError, RecordingError};

use super::Layout;

/// Why there are no recordings to work on. Each message says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ListingError {
    /// A folder or file that cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Labels that cannot be used.
    #[error(transparent)]
    Labels(#[from] LabelsError),
    /// A recording of our own whose description cannot be used.
    #[error(transparent)]
    Recorded(#[from] RecorderError),
    /// A path without recordings.
    #[error(
        "{}: no recordings found{hint}; give folders ParticipantP/train/EMG or ParticipantP/test/EMG (3DC), files \
         .mat or P<person>_C<cycle>_G<gesture>.csv (Ozdemir 2022), files .edf, .bdf, .xdf or .xdfz with \
         annotations or markers, a folder with tables and a labels.csv, tables with --label-column, or a folder above such",
        .path.display()
    )]
    NoRecordings {
        /// The path.
        path: PathBuf,
        /// What lies there instead, if anything, in brackets.
        hint: String,
    },
    /// All that was found has to be left out.
    #[error("none of the recordings found can be used; the first was left out because: {first_reason}")]
    NoneUsable {
        /// Why the first one was left out.
        first_reason: String,
    },
    /// A name that a manifest cannot hold.
    #[error("{}: its name is not UTF-8, which a manifest cannot hold: rename the file or folder", .path.display())]
    NotUtf8 {
        /// The file or folder.
        path: PathBuf,
    },
    /// Recordings of several data sets: their people, channels and units have nothing to do with each other.
    #[error(
        "{} is of the layout {layout}, but {} of {other}: build a data set of each",
        .first.display(), .second.display()
    )]
    SeveralLayouts {
        /// The first path.
        first: PathBuf,
        /// Its layout.
        layout: Layout,
        /// A path of another layout.
        second: PathBuf,
        /// That layout.
        other: Layout,
    },
    /// The same recording from two places.
    #[error("{what} is in {} and in {}: leave one of them out", .first.display(), .second.display())]
    Twice {
        /// What is there twice.
        what: String,
        /// The first place.
        first: PathBuf,
        /// The second.
        second: PathBuf,
    },
    /// Recordings that are to be filtered, but were already.
    #[error("{} lies in a folder `filtered`: give --filtered, or the recordings in `raw`", .file.display())]
    Filtered {
        /// The first such file.
        file: PathBuf,
    },
    /// Recordings that are not to be filtered, but should be.
    #[error(
        "{} lies in a folder `raw`: leave out --filtered, or give the recordings in `filtered`",
        .file.display()
    )]
    NotFiltered {
        /// The first such file.
        file: PathBuf,
    },
    /// A column of labels was named, and there is no table for it.
    #[error(
        "--label-column is for tables of your own without a labels.csv, but {} is of the layout {layout}: leave it out",
        .path.display()
    )]
    NoTable {
        /// The first path found.
        path: PathBuf,
        /// Its layout.
        layout: Layout,
    },
    /// Tables with labels, whose sampling rate was not given.
    #[error(
        "the files named in {} do not state their sampling rate: give it with --recording-rate-hz, e.g. 2000",
        .labels.display()
    )]
    NoRate {
        /// The labels file.
        labels: PathBuf,
    },
    /// More repetitions than `repetitions.npy` can number.
    #[error(
        "person {person} has more than 256 repetitions, counted through all sessions: number them from 0 in \
         each session"
    )]
    TooManyRepetitions {
        /// The person.
        person: PersonId,
    },
}
