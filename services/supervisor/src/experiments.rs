//! `tendon experiments`: the paper's experiments, repeated on any recordings of its layouts.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use tendon_experiments::{Event, ExperimentError, Settings};
use tendon_identity::PersonId;
use tendon_provenance::Provenance;

use crate::Failure;
use crate::dataset::BuildProgress;
use crate::output::{print, tell};
use crate::progress::Works;
use crate::provenance::PROGRAM;

/// Command line of `tendon experiments`.
#[derive(Debug, Args)]
pub struct Options {
    /// The 3DC data set: its folder, or one with some of its people (scripts/fetch-data 3dc fetches it).
    #[arg(long, value_name = "FOLDER")]
    three_dc: Option<PathBuf>,
    /// The Ozdemir data set, which the paper used: its folder raw/mat (scripts/fetch-data ozdemir fetches it). With
    /// filtered/mat, only models are trained; the strategies need unfiltered recordings.
    #[arg(long, value_name = "FOLDER")]
    ozdemir: Option<PathBuf>,
    /// Folder for all results: data sets, models, figures, report.md and report.json.
    #[arg(long, value_name = "FOLDER", default_value = "experiments")]
    out: PathBuf,
    /// People of 3DC to hold out for the test.
    #[arg(
        long,
        value_name = "P,…",
        value_delimiter = ',',
        default_value = "19,20,22",
        requires = "three_dc"
    )]
    three_dc_test_people: Vec<PersonId>,
    /// People of the Ozdemir data set to hold out for the test; the default is the paper's choice.
    #[arg(
        long,
        value_name = "P,…",
        value_delimiter = ',',
        default_value = "36,37,38,39,40",
        requires = "ozdemir"
    )]
    ozdemir_test_people: Vec<PersonId>,
    /// Seeds of the trainings. Comparisons report the spread over all of them.
    #[arg(long, value_delimiter = ',', default_value = "0,1,2")]
    seeds: Vec<u64>,
    /// Epochs of a training; the default is the paper's.
    #[arg(long, default_value_t = 30)]
    epochs: u32,
    /// Trainings to run at the same time, each on one core. By default, as many as there are cores.
    #[arg(long, conflicts_with = "no_training")]
    jobs: Option<usize>,
    /// Do not train: report on the models that exist.
    #[arg(long)]
    no_training: bool,
    /// Replace data sets and models of an earlier run with other recordings, people or settings.
    #[arg(long)]
    force: bool,
    /// Skip the live sessions, which take about three minutes.
    #[arg(long)]
    no_live: bool,
    /// ONNX Runtime's shared library. By default ORT_DYLIB_PATH, then what scripts/fetch-onnxruntime fetched.
    #[arg(long, value_name = "FILE")]
    runtime_library: Option<PathBuf>,
}

impl Options {
    fn settings(&self) -> anyhow::Result<Settings> {
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        Ok(Settings {
            three_dc: self.three_dc.clone(),
            ozdemir: self.ozdemir.clone(),
            out: self.out.clone(),
            three_dc_test_people: self.three_dc_test_people.clone(),
            ozdemir_test_people: self.ozdemir_test_people.clone(),
            seeds: self.seeds.clone(),
            epochs: self.epochs,
            jobs: self.jobs.unwrap_or_else(cores),
            trains: !self.no_training,
            replaces: self.force,
            runs_live: !self.no_live,
            runtime_library: tendon_classifier::runtime_library(self.runtime_library.as_deref())?,
            provenance: self.provenance()?,
            program: std::env::current_exe().context("cannot tell where this program is")?,
        })
    }
}

impl Options {
    fn provenance(&self) -> anyhow::Result<Provenance> {
        let configuration = serde_json::json!({
            "three_dc_test_people": self.three_dc_test_people,
            "ozdemir_test_people": self.ozdemir_test_people,
            "seeds": self.seeds,
            "epochs": self.epochs,
        });
        Ok(Provenance::begin(PROGRAM).with_configuration(&configuration)?)
    }
}

/// Runs all experiments.
pub fn run(options: &Options) -> Result<(), Failure> {
    let settings = options.settings().map_err(Failure::input)?;
    let mut works = Works::default();
    let mut build = BuildProgress::default();
    let mut on_event = |event: Event<'_>| match event {
        Event::Line(line) => {
            works.clear();
            build = BuildProgress::default();
            // A terminal that went away must not end hours of training; the report is in files.
            if let Err(error) = print(line) {
                tell(format_args!("{error:#}"));
            }
        }
        Event::Dataset(progress) => build.show(&progress),
        Event::Progress { done, total, things } => works.show(done, total, things, String::new),
    };
    let report = tendon_experiments::run(&settings, &mut on_event).map_err(failure)?;
    print(format_args!("report: {}", report.display())).map_err(Failure::running)
}

fn failure(error: ExperimentError) -> Failure {
    if error.is_bad_input() { Failure::input(error) } else { Failure::running(error) }
}
