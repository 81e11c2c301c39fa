//! `tendon evaluate`: how well a model recognises windows, by the code that runs live.

use std::path::PathBuf;

use clap::Args;
use tendon_classifier::Classifier;
use tendon_dataset::StoredDataset;
use tendon_evaluation::{ScoreError, Scores, score_dataset, score_recordings};
use tendon_figures::write_score_figures;

use crate::Failure;
use crate::output::print;
use crate::progress::Works;
use crate::run::write_json;

/// Command line of `tendon evaluate`.
#[derive(Debug, Args)]
pub struct Options {
    /// A data set made by `tendon dataset build`; or recordings, which are then cut into windows as
    /// `tendon dataset build` does by default, without writing them.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The ONNX model.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Score only these people, by number. By default, everybody whom the model was not trained on: a score on people
    /// it has seen says nothing about a stranger.
    #[arg(long, value_name = "P,…", value_delimiter = ',')]
    people: Vec<u16>,
    /// Channels of the recordings, in the order the model expects.
    #[arg(long, value_delimiter = ',', default_value = "0,3,5,8")]
    channels: Vec<usize>,
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

/// Evaluates a model.
pub fn evaluate(options: &Options) -> Result<(), Failure> {
    let library =
        tendon_classifier::runtime_library(options.runtime_library.as_deref()).map_err(Failure::input)?;
    let classifier = Classifier::load(&library, &options.model).map_err(Failure::input)?;
    let provenance = classifier.contract().provenance.clone();
    let mut works = Works::default();
    let scored = match &options.paths[..] {
        [folder] if StoredDataset::is_one(folder) => {
            let mut progress = |done, total| works.show(done, total, "windows", String::new);
            score_dataset(classifier, folder, &options.people, &mut progress)
        }
        paths => {
            let mut progress = |done, total| works.show(done, total, "recordings", String::new);
            score_recordings(classifier, paths, &options.channels, &options.people, &mut progress)
        }
    };
    works.clear();
    let (scores, tally) = scored.map_err(failure)?;
    // Neither a full disk nor a closed output keeps the others from being written.
    let json = options.json.as_deref().map_or(Ok(()), |path| write_json(path, &scores));
    let figures = options
        .figures
        .as_deref()
        .map_or(Ok(()), |folder| write_score_figures(folder, &options.model, &tally));
    let printed = print(text(options, &scores, provenance.as_deref()));
    json.and(figures.map_err(anyhow::Error::from)).and(printed).map_err(Failure::running)
}

fn failure(error: ScoreError) -> Failure {
    if error.is_bad_input() { Failure::input(error) } else { Failure::running(error) }
}

fn text(options: &Options, scores: &Scores, provenance: Option<&str>) -> String {
    let people: Vec<String> = scores.people.iter().map(ToString::to_string).collect();
    let mut text = format!("{} on people {}\n", options.model.display(), people.join(", "));
    if let Some(provenance) = provenance {
        text += &format!("the model: {provenance}\n");
    }
    text += &format!("\n{}\n", scores.evaluation);
    if !scores.skipped.is_empty() {
        text += &format!("{} recordings or trials left out:\n", scores.skipped.len());
        scores.skipped.iter().for_each(|skipped| text += &format!("  {skipped}\n"));
    }
    text +=
        &format!("{:.1} s in all, {:.0} times faster than real time", scores.duration_s, scores.x_real_time);
    if let Some(folder) = &options.figures {
        text += &format!("\nfigures in {}", folder.display());
    }
    text
}
