//! `tendon evaluate`: how well a model recognises windows, by the code that runs live.

mod people;
mod unlabelled;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Args;
use serde::Serialize;
use tendon_classifier::{Classifier, TrainedOn};
use tendon_dataset::{DatasetSettings, StoredDataset};
use tendon_evaluation::{ScoreError, Scores, score_dataset, score_recordings, settings_of};
use tendon_figures::write_score_figures;
use tendon_identity::PersonId;
use tendon_output::{OutputFile, OutputFolder, check_distinct, collect};
use tendon_provenance::Provenance;
use tendon_recordings::Channel;
use tendon_signal::canonical_unit;

use crate::Failure;
use crate::channels::{channels_or_default, listed};
use crate::configuration::Base;
use crate::model_channels;
use crate::output::{checked, left_out, print, tell};
use crate::progress::Works;
use crate::provenance::PROGRAM;
use crate::recording_options::RecordingOptions;
use crate::times::seconds;

/// Command line of `tendon evaluate`.
#[derive(Debug, Args)]
pub struct Options {
    /// A data set made by `tendon dataset build`; or recordings, which are then cut into windows as
    /// `tendon dataset build` does by default, without writing them.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The ONNX model.
    #[arg(long, value_name = "FILE", required_unless_present = "calibration")]
    model: Option<PathBuf>,
    /// Instead of a model, calibrate a recogniser to each person on the first N repetitions of the first session, with
    /// what others have in common, and score the person's last session. Takes filter, windows and rate from the
    /// configuration.
    #[arg(
        long,
        value_name = "N",
        group = "calibration",
        conflicts_with_all = ["model", "runtime_library"],
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    calibrate_repetitions: Option<u32>,
    /// Instead of a model, calibrate a recogniser to each person on the first SECONDS of the first session without looking at
    /// what was made in them, and score the person's last session. What the person made is guessed from where other people's
    /// gestures lie: those of these recordings who are not scored, or with everybody scored, all others.
    #[arg(
        long,
        value_name = "SECONDS",
        group = "calibration",
        conflicts_with_all = ["model", "runtime_library"],
        value_parser = seconds
    )]
    calibrate_unlabelled: Option<f64>,
    #[command(flatten)]
    base: Base,
    #[command(flatten)]
    recording: RecordingOptions,
    /// Score only these people, by number or name. By default, everybody whom the model was not trained on: a score on people
    /// it has seen says nothing about a stranger.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<PersonId>,
    /// ONNX Runtime's shared library. By default ORT_DYLIB_PATH, then what scripts/fetch-onnxruntime fetched.
    #[arg(long, value_name = "FILE")]
    runtime_library: Option<PathBuf>,
    /// Also write the scores to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Draw the confusion matrix and a histogram of the time per window into this folder, as PNG and SVG.
    #[arg(long, value_name = "FOLDER")]
    figures: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct ScoresWithProvenance<'a> {
    #[serde(flatten)]
    scores: &'a Scores,
    provenance: Provenance,
}

/// Evaluates a model.
pub fn evaluate(options: &Options) -> Result<(), Failure> {
    let json = checked(options.json.as_deref())?;
    let figures = options.figures.as_deref().map(OutputFolder::check).transpose().map_err(Failure::input)?;
    let inputs = options.paths.iter().chain(&options.model).map(PathBuf::as_path).chain(options.base.file());
    check_distinct(&json, &figures, inputs).map_err(Failure::input)?;
    let begun = Provenance::begin(PROGRAM);
    // What recognises single people belongs to them.
    let json = if options.model.is_some() { json } else { json.map(OutputFile::private) };
    if let Some(repetitions) = options.calibrate_repetitions {
        return people::evaluate(options, repetitions, json, figures, begun);
    }
    if let Some(stretch_s) = options.calibrate_unlabelled {
        return unlabelled::evaluate(options, stretch_s, json, figures, begun);
    }
    let model = model(options).map_err(Failure::input)?;
    let library =
        tendon_classifier::runtime_library(options.runtime_library.as_deref()).map_err(Failure::input)?;
    let classifier = Classifier::load(&library, model).map_err(Failure::input)?;
    let trained = classifier.contract().provenance.clone();
    let trained_on = classifier.contract().trained_on.clone();
    if let Some(unit) = &options.recording.unit {
        tell_of_unit(unit, &classifier.contract().unit);
    }
    let mut works = Works::default();
    let check = |channels: &[Channel], source| {
        let names: Vec<String> = channels.iter().map(Channel::name).collect();
        model_channels::check([model], source, &names)
    };
    let channels;
    let scored = match &options.paths[..] {
        [folder] if StoredDataset::is_one(folder) => {
            channels = check_data_set(options, folder).map_err(Failure::input)?;
            check(&channels, "the data set gives").map_err(Failure::input)?;
            let mut progress = |done, total| works.show(done, total, "windows", String::new);
            score_dataset(classifier, folder, &options.people, &mut progress)
        }
        paths => {
            channels = channels_of(options, model, paths).map_err(Failure::input)?;
            check(&channels, "the recordings give").map_err(Failure::input)?;
            let mut progress = |done, total| works.show(done, total, "recordings", String::new);
            let settings = options.recording.settings(DatasetSettings {
                channels: channels.clone(),
                ..settings_of(classifier.contract())
            });
            score_recordings(classifier, paths, &settings, &options.people, &mut progress)
        }
    };
    works.clear();
    let (scores, tally) = scored.map_err(failure)?;
    let people: Vec<PersonId> = scores.people.iter().copied().collect();
    let provenance = Provenance {
        trained_on_person: TrainedOn::any_includes([&trained_on], scores.data_set.as_deref(), &people),
        ..provenance(options, &channels, model, begun).map_err(Failure::running)?
    };
    // Neither a full disk nor a closed output keeps the others from being written.
    let content = ScoresWithProvenance { scores: &scores, provenance };
    let json = json.iter().map(|file| file.write_json(&content));
    let drawn = figures.iter().flat_map(|folder| write_score_figures(folder, model, &tally));
    let written = collect(json.chain(drawn)).map_err(Failure::running);
    written.and(print(text(options, model, &channels, &scores, trained.as_deref())).map_err(Failure::running))
}

/// The model, which has the settings of its own windows.
fn model(options: &Options) -> anyhow::Result<&Path> {
    ensure!(
        !options.base.is_given(),
        "--config and --set are for --calibrate-repetitions and --calibrate-unlabelled; a model says itself how its windows \
         are made"
    );
    options.model.as_deref().context("give a model with --model")
}

/// The channels of the data set. Refuses options that would make others of its windows.
fn check_data_set(options: &Options, folder: &Path) -> anyhow::Result<Vec<Channel>> {
    let RecordingOptions { channels: named, recording_rate_hz, label_column, unit } = &options.recording;
    let dataset = StoredDataset::open(folder)?;
    let own = dataset.manifest().settings.channels.clone();
    ensure!(
        named.is_empty() || *named == own,
        "--channels is for recordings, but {} is a data set of other channels: leave --channels out",
        folder.display()
    );
    for (option, is_given) in [
        ("--recording-rate-hz", recording_rate_hz.is_some()),
        ("--label-column", label_column.is_some()),
        ("--unit", unit.is_some()),
    ] {
        let folder = folder.display();
        ensure!(!is_given, "{option} is for recordings, but {folder} is a data set: leave {option} out");
    }
    Ok(own)
}

/// The channels of the recordings that the model is given: those it was trained on, unless others are asked for.
fn channels_of(options: &Options, model: &Path, paths: &[PathBuf]) -> anyhow::Result<Vec<Channel>> {
    let channels = &options.recording.channels;
    let given = if channels.is_empty() { model_channels::remembered([model]) } else { channels.clone() };
    channels_or_default(&given, &options.recording.settings(DatasetSettings::default()), paths)
}

/// Says that a model was trained on samples of another unit.
fn tell_of_unit(unit: &str, trained: &str) {
    if !trained.is_empty() && canonical_unit(trained) != unit {
        tell(format_args!(
            "the recordings are in {unit}, and the model was trained in {trained}: it will not fit"
        ));
    }
}

/// What was scored on what. The hashes of recordings are left out where nobody gets to read them.
fn provenance(
    options: &Options,
    channels: &[Channel],
    model: &Path,
    begun: Provenance,
) -> anyhow::Result<Provenance> {
    if options.json.is_none() {
        return Ok(begun);
    }
    let configuration = serde_json::json!({ "people": options.people, "channels": channels });
    let recordings: Vec<PathBuf> = options
        .paths
        .iter()
        // A data set's manifest names the hashes of what it was made from.
        .map(|path| if StoredDataset::is_one(path) { path.join("manifest.json") } else { path.clone() })
        .collect();
    let begun = begun.with_configuration(&configuration)?.with_models([model])?;
    Ok(begun.with_recording(&recordings)?)
}

fn failure(error: ScoreError) -> Failure {
    if error.is_bad_input() { Failure::input(error) } else { Failure::running(error) }
}

fn text(
    options: &Options,
    model: &Path,
    channels: &[Channel],
    scores: &Scores,
    trained: Option<&str>,
) -> String {
    let people: Vec<String> = scores.people.iter().map(ToString::to_string).collect();
    let mut text = format!("{} on people {}\n", model.display(), people.join(", "));
    text += &format!("channels {}\n", listed(channels));
    text += &format!("scored on {}\n", scores.scored_on);
    if let Some(trained) = trained {
        text += &format!("the model: {trained}\n");
    }
    text += &format!("\n{}\n", scores.evaluation);
    if !scores.skipped.is_empty() {
        text += &format!("{}\n", left_out(&scores.skipped));
    }
    text +=
        &format!("{:.1} s in all, {:.0} times faster than real time", scores.duration_s, scores.x_real_time);
    if let Some(folder) = &options.figures {
        text += &format!("\nfigures in {}", folder.display());
    }
    text
}
