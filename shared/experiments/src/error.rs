//! Why experiments cannot be run, or broke off.

use std::io;
use std::path::PathBuf;
use std::process::ExitStatus;

use tendon_classifier::ClassifierError;
use tendon_dataset::{DatasetError, ListingError, StoredDatasetError};
use tendon_evaluation::{ScoreError, StrategyError};
use tendon_gesture::Strategy;
use tendon_output::{OutputError, OutputErrors};
use tendon_pipeline::PipelineError;
use tendon_provenance::ProvenanceError;

/// Why experiments cannot be run, or broke off. Each message says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// No recordings were named.
    #[error(
        "no recordings: name some with --three-dc FOLDER or --ozdemir FOLDER (scripts/fetch-data fetches both)"
    )]
    NoRecordings,
    /// No seed was named.
    #[error("--seeds: name at least one, such as 0")]
    NoSeed,
    /// A folder that cannot be made.
    #[error("cannot make the folder {}: {reason}; check that you may write there", .path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// A file that cannot be written.
    #[error("cannot write {}: {reason}; check that there is room and that you may write there", .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// A data set cannot be built.
    #[error("no data set was built: {0}")]
    Dataset(DatasetError),
    /// A data set of an earlier run cannot be read.
    #[error(transparent)]
    Stored(#[from] StoredDatasetError),
    /// Recordings cannot be used.
    #[error(transparent)]
    Listing(#[from] ListingError),
    /// A model cannot be loaded.
    #[error(transparent)]
    Classifier(#[from] ClassifierError),
    /// A model cannot be scored.
    #[error(transparent)]
    Score(#[from] ScoreError),
    /// A strategy's models do not fit.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A strategy cannot be scored.
    #[error(transparent)]
    Strategy(#[from] StrategyError),
    /// A folder cannot be written to.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Files cannot be written.
    #[error(transparent)]
    Outputs(#[from] OutputErrors),
    /// The recordings cannot be read.
    #[error(transparent)]
    Provenance(#[from] ProvenanceError),
    /// The training's script is missing.
    #[error("scripts/train was not found above {}: run this program from the project's folder", .program.display())]
    NoTrainScript {
        /// This program.
        program: PathBuf,
    },
    /// The training's script does not start.
    #[error("{} cannot be run: try `{} --help` by hand", .script.display(), .script.display())]
    TrainScript {
        /// The script.
        script: PathBuf,
    },
    /// A program that cannot be started.
    #[error("cannot run {}: {reason}", .program.display())]
    Start {
        /// The program.
        program: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// A training that failed.
    #[error("{name}: the training ended with {status}; {} says why. The same command continues from there", .log.display())]
    Training {
        /// The model's name.
        name: String,
        /// How the script ended.
        status: ExitStatus,
        /// What it printed.
        log: PathBuf,
    },
    /// A live session that failed.
    #[error("the session with strategy {} failed: {message}", .strategy.name())]
    Session {
        /// Its strategy.
        strategy: Strategy,
        /// What it said on standard error.
        message: String,
    },
    /// The report of a live session that cannot be read.
    #[error("{} is not a report: {reason}", .path.display())]
    Report {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: io::Error,
    },
}

impl ExperimentError {
    /// Whether what was given cannot be worked on, rather than that the work broke off.
    pub fn is_bad_input(&self) -> bool {
        match self {
            ExperimentError::NoRecordings
            | ExperimentError::NoSeed
            | ExperimentError::Dataset(_)
            | ExperimentError::Listing(_) => true,
            ExperimentError::Score(error) => error.is_bad_input(),
            _ => false,
        }
    }
}
