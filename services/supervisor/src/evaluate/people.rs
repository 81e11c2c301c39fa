//! `tendon evaluate --calibrate-repetitions`: recognisers that are calibrated to each person.

use std::path::Path;

use anyhow::bail;
use serde::Serialize;
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, StoredDataset};
use tendon_evaluation::{PersonalError, PersonalScores, PersonalSettings, score_people};
use tendon_figures::write_score_figures;
use tendon_output::{OutputFile, OutputFolder, collect};
use tendon_provenance::Provenance;
use tendon_recordings::Channel;
use tendon_signal::{OnsetMethod, OnsetSettings};

use super::Options;
use crate::Failure;
use crate::options::WINDOW_KEYS;
use crate::output::{left_out, print};
use crate::progress::Works;

/// A movement counts from here on, ms after its cue: by then everybody has followed it.
const MOVEMENT_BEGINS_MS: f64 = 1200.0;

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
    let mut progress = |done, total| works.show(done, total, "recordings", String::new);
    let scored = score_people(&options.paths, &settings, &options.people, &mut progress);
    works.clear();
    let (scores, tally) = scored.map_err(failure)?;
    let provenance = provenance(options, &settings, begun).map_err(Failure::running)?;
    let content = ScoresWithProvenance { scores: &scores, provenance };
    let json = json.iter().map(|file| file.write_json(&content));
    let drawn =
        figures.iter().flat_map(|folder| write_score_figures(folder, Path::new("calibrated"), &tally));
    let written = collect(json.chain(drawn)).map_err(Failure::running);
    written.and(print(text(options, &scores)).map_err(Failure::running))
}

fn settings(options: &Options, repetitions: u32) -> anyhow::Result<PersonalSettings> {
    if let Some(data_set) = options.paths.iter().find(|path| StoredDataset::is_one(path)) {
        bail!(
            "--calibrate-repetitions needs recordings, and {} is a data set: give the recordings that it was made from",
            data_set.display()
        );
    }
    let Config { acquisition, dsp, .. } = options.base.configuration_of("tendon evaluate", &WINDOW_KEYS)?;
    let default = DatasetSettings::default();
    Ok(PersonalSettings {
        dataset: DatasetSettings {
            channels: options.channels().into_iter().map(Channel::Index).collect(),
            recording_rate_hz: options.recording_rate_hz,
            sample_rate_hz: acquisition.sample_rate_hz,
            filter: Some(dsp.filter),
            windows: dsp.windows,
            onset: OnsetSettings { method: OnsetMethod::Fixed, ..default.onset },
            fallback_ms: MOVEMENT_BEGINS_MS,
            rest_start_ms: MOVEMENT_BEGINS_MS,
            ..default
        },
        method: Default::default(),
        repetitions,
    })
}

fn provenance(
    options: &Options,
    settings: &PersonalSettings,
    begun: Provenance,
) -> anyhow::Result<Provenance> {
    if options.json.is_none() {
        return Ok(begun);
    }
    let configuration = serde_json::json!({
        "people": options.people,
        "dataset": settings.dataset,
        "method": settings.method,
        "calibrate_repetitions": settings.repetitions,
    });
    Ok(begun.with_configuration(&configuration)?.with_recording(&options.paths)?)
}

fn failure(error: PersonalError) -> Failure {
    match error {
        PersonalError::Fit(_) | PersonalError::Prior(_) => Failure::running(error),
        PersonalError::Listing(_)
        | PersonalError::People(_)
        | PersonalError::Features(_)
        | PersonalError::Nobody(_) => Failure::input(error),
    }
}

fn text(options: &Options, scores: &PersonalScores) -> String {
    let people: Vec<String> = scores.people.iter().map(ToString::to_string).collect();
    let mut text = format!("people {}\n", people.join(", "));
    text += &format!("calibrated on {}\nscored on {}\n", scores.calibrated_on, scores.scored_on);
    text += &format!("\n{}\n", scores.evaluation);
    if !scores.skipped.is_empty() {
        text += &format!("{}\n", left_out(&scores.skipped, "recordings, trials or people"));
    }
    text += &format!("longest calibration {:.2} s", scores.longest_fit_s);
    if let Some(folder) = &options.figures {
        text += &format!("\nfigures in {}", folder.display());
    }
    text
}
