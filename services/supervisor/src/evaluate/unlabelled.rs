//! `tendon evaluate --calibrate-unlabelled`: recognisers that are calibrated to each person without labels.

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;
use tendon_dataset::DatasetSettings;
use tendon_evaluation::{UnlabelledScores, UnlabelledSettings, score_unlabelled};
use tendon_figures::write_score_figures;
use tendon_output::{OutputFile, OutputFolder, collect};
use tendon_provenance::Provenance;

use super::{Options, people};
use crate::Failure;
use crate::output::print;
use crate::progress::Works;

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct ScoresWithProvenance<'a> {
    #[serde(flatten)]
    scores: &'a UnlabelledScores,
    provenance: Provenance,
}

/// Calibrates to each person on the first `stretch_s`, labels unused, and scores what that person recorded later.
pub fn evaluate(
    options: &Options,
    stretch_s: f64,
    json: Option<OutputFile>,
    figures: Option<OutputFolder>,
    begun: Provenance,
) -> Result<(), Failure> {
    let dataset = people::dataset(options, "--calibrate-unlabelled").map_err(Failure::input)?;
    let settings = UnlabelledSettings { dataset, method: Default::default(), stretch_s };
    let mut works = Works::default();
    let mut progress = |done, total| works.show(done, total, "readings of people", String::new);
    let scored = score_unlabelled(&options.paths, &settings, &options.people, &mut progress);
    works.clear();
    let (scores, tally) = scored.map_err(people::failure)?;
    let configuration = serde_json::json!({
        "people": options.people,
        "dataset": settings.dataset,
        "method": settings.method,
        "calibrate_unlabelled_s": settings.stretch_s,
    });
    let provenance = people::provenance(options, &configuration, begun).map_err(Failure::running)?;
    let content = ScoresWithProvenance { scores: &scores, provenance };
    let json = json.iter().map(|file| file.write_json(&content));
    let drawn =
        figures.iter().flat_map(|folder| write_score_figures(folder, Path::new("unlabelled"), &tally));
    let written = collect(json.chain(drawn)).map_err(Failure::running);
    written.and(print(text(options, &settings.dataset, &scores)).map_err(Failure::running))
}

fn text(options: &Options, dataset: &DatasetSettings, scores: &UnlabelledScores) -> String {
    let mut text = people::text(options, dataset, &scores.scores);
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    text += "\n\nwithout labels     sure   named right   all stretches";
    for person in &scores.unlabelled {
        let all = person.all_stretches_accuracy.map_or_else(|| "-".to_owned(), percent);
        let (sure, right) = (percent(person.sureness), percent(person.right_labels));
        let _ = write!(text, "\nperson {:<10} {sure:>6} {right:>13} {all:>15}", person.person);
    }
    if let Some(accuracy) = scores.all_stretches_accuracy {
        let _ = write!(text, "\nmean accuracy over all stretches of this length: {accuracy:.4}");
    }
    text
}
