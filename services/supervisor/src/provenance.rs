//! Where the results of the `tendon` command come from.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use tendon_classifier::{ModelFiles, TrainedOn, trained_on};
use tendon_config::{Config, Source};
use tendon_gesture::Strategy;
use tendon_identity::PersonId;
use tendon_provenance::{Program, Provenance};
use tendon_recordings::{ozdemir, three_dc};
use tendon_session_file::is_session_file;

/// This program.
pub const PROGRAM: Program = Program { version: env!("CARGO_PKG_VERSION"), commit: env!("TENDON_COMMIT") };

/// Of a session that starts now, with the hashes of its models and its recording.
///
/// # Errors
///
/// When a model or recording is missing or cannot be read.
pub fn of_session(config: &Config) -> anyhow::Result<Provenance> {
    let (models, trained) = models(config)?;
    let replay = &config.acquisition.replay;
    let recording = replay.path.clone().into_iter().filter(|_| config.acquisition.source == Source::Replay);
    let recording: Vec<_> = recording.collect();
    if recording.iter().any(|path| !is_session_file(path)) {
        // Before all of it is read for its hash.
        config.acquisition.check_recording()?;
    }
    let person = recording.first().and_then(|path| person(path));
    let trained_on_person = person.and_then(|(data_set, person)| {
        TrainedOn::any_includes(&trained, Some(data_set), &[PersonId::Number(person)])
    });
    let provenance = Provenance::begin(PROGRAM).with_configuration(config)?.with_models(models)?;
    Ok(Provenance { trained_on_person, ..provenance.with_recording(&recording)? })
}

/// The models of a session, and whom each was trained on; or its person, who was trained on nobody else.
///
/// # Errors
///
/// When one is missing or cannot be read.
pub fn models(config: &Config) -> anyhow::Result<(Vec<PathBuf>, Vec<TrainedOn>)> {
    let inference = &config.inference;
    if let (Strategy::Personal, Some(person)) = (config.decision.strategy, &inference.person) {
        return Ok((vec![person.clone()], Vec::new()));
    }
    let models = ModelFiles::find(
        config.decision.strategy,
        inference.model.as_deref(),
        inference.rest_move_model.as_deref(),
    )?;
    let mut trained = Vec::new();
    for model in models.paths() {
        trained.push(trained_on(model).map_err(|error| {
            anyhow!("cannot open {}: {error}; check the path and its permissions", model.display())
        })?);
    }
    Ok((models.paths().map(Path::to_owned).collect(), trained))
}

/// The data set that a recording is of, and the number of its person there, where the layout tells it.
fn person(recording: &Path) -> Option<(&'static str, u16)> {
    let of_three_dc = three_dc::origin_through_links(recording)
        .or_else(|| three_dc::origin_through_links(recording.parent()?));
    let of_three_dc = of_three_dc.map(|(person, _)| (three_dc::DATA_SET, person));
    of_three_dc.or_else(|| ozdemir::trial_of_name(recording).map(|trial| (ozdemir::DATA_SET, trial.person)))
}
