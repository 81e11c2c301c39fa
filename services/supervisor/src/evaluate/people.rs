//! `tendon evaluate --calibrate-repetitions`: recognisers that are calibrated to each person.

use std::path::Path;

use anyhow::bail;
use serde::Serialize;
use tendon_dataset::{DatasetSettings, StoredDataset};
use tendon_evaluation::{PersonalError, PersonalScores, PersonalSettings, score_people};
use tendon_figures::write_score_figures;
use tendon_output::{OutputFile, OutputFolder, collect};
use tendon_provenance::Provenance;

use super::Options;
use crate::Failure;
use crate::channels::{channels_or_default, listed};
use crate::configuration::WINDOW_KEYS;
use crate::output::{left_out, print};
use crate::personal::{dataset_settings, how_to_get_personal_windows, shipped_prior, windows_in_words};
use crate::progress::Works;

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct ScoresWithProvenance<'a> {
    #[serde(flatten)]
    scores: &'a PersonalScores,
    provenance: Provenance,
}

/// Calibrates to each person and scores what that person recorded later.
pub fn evaluate(
    options: &Options,
    repetitions: u32,
    json: Option<OutputFile>,
    figures: Option<OutputFolder>,
    begun: Provenance,
) -> Result<(), Failure> {
    let settings = settings(options, repetitions).map_err(Failure::input)?;
    let mut works = Works::default();
    let shipped = shipped_prior().map_err(Failure::input)?;
    let mut progress = |done, total| works.show(done, total, "people", String::new);
    let scored = score_people(&options.paths, &settings, &options.people, shipped.as_ref(), &mut progress);
    works.clear();
    let (scores, tally) = scored.map_err(failure)?;
    let configuration = serde_json::json!({
        "people": options.people,
        "dataset": settings.dataset,
        "method": settings.method,
        "calibrate_repetitions": settings.repetitions,
    });
    let provenance = provenance(options, &configuration, begun).map_err(Failure::running)?;
    let content = ScoresWithProvenance { scores: &scores, provenance };
    let json = json.iter().map(|file| file.write_json(&content));
    let drawn =
        figures.iter().flat_map(|folder| write_score_figures(folder, Path::new("calibrated"), &tally));
    let written = collect(json.chain(drawn)).map_err(Failure::running);
    written.and(print(text(options, &settings.dataset, &scores)).map_err(Failure::running))
}

fn settings(options: &Options, repetitions: u32) -> anyhow::Result<PersonalSettings> {
    let dataset = dataset(options, "--calibrate-repetitions")?;
    Ok(PersonalSettings { dataset, method: Default::default(), repetitions })
}

/// How the recordings are cut to calibrate on, as `option` asks for.
pub(super) fn dataset(options: &Options, option: &str) -> anyhow::Result<DatasetSettings> {
    if let Some(data_set) = options.paths.iter().find(|path| StoredDataset::is_one(path)) {
        bail!(
            "{option} needs recordings, and {} is a data set: give the recordings that it was made from",
            data_set.display()
        );
    }
    let config = options.base.configuration_of("tendon evaluate", &WINDOW_KEYS)?;
    let settings = dataset_settings(&config, &[], &options.recording);
    let channels = channels_or_default(&options.recording.channels, &settings, &options.paths)?;
    Ok(DatasetSettings { channels, ..settings })
}

/// What was scored on what, where somebody gets to read it.
pub(super) fn provenance(
    options: &Options,
    configuration: &serde_json::Value,
    begun: Provenance,
) -> anyhow::Result<Provenance> {
    if options.json.is_none() {
        return Ok(begun);
    }
    Ok(begun.with_configuration(configuration)?.with_recording(&options.paths)?)
}

pub(super) fn failure(error: PersonalError) -> Failure {
    match error {
        PersonalError::Recognise(_) | PersonalError::Prior(_) => Failure::running(error),
        PersonalError::Listing(_)
        | PersonalError::People(_)
        | PersonalError::Features(_)
        | PersonalError::Unlabelled(_)
        | PersonalError::Nobody(_) => Failure::input(error),
    }
}

pub(super) fn text(options: &Options, dataset: &DatasetSettings, scores: &PersonalScores) -> String {
    let people: Vec<String> = scores.people.iter().map(ToString::to_string).collect();
    let DatasetSettings { channels, windows, sample_rate_hz, .. } = dataset;
    let mut text = format!("people {}\n", people.join(", "));
    text += &format!(
        "channels {}; {}{}\n",
        listed(channels),
        windows_in_words(windows, *sample_rate_hz),
        how_to_get_personal_windows(windows, *sample_rate_hz)
    );
    text += &format!("calibrated on {}\nscored on {}\n", scores.calibrated_on, scores.scored_on);
    text += &format!("with what {} others have in common: {}\n", scores.prior_people, scores.prior_from);
    text += &format!("\n{}\n", scores.evaluation);
    if !scores.skipped.is_empty() {
        text += &format!("{}\n", left_out(&scores.skipped));
    }
    text += &format!("the calibrations alone expected {:.4}\n", scores.expected_accuracy);
    text += &format!("longest calibration {:.2} s", scores.longest_fit_s);
    if let Some(folder) = &options.figures {
        text += &format!("\nfigures in {}", folder.display());
    }
    text
}
