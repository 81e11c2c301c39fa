//! Where the results of the `tendon` command come from.

use std::path::Path;

use anyhow::Context;
use tendon_classifier::{ModelFiles, people_trained};
use tendon_config::{Config, Source};
use tendon_provenance::{Program, Provenance};
use tendon_recordings::three_dc;

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
    let person = recording.first().and_then(|path| person(path));
    let trained_on_person = person.filter(|_| !trained.is_empty()).map(|person| trained.contains(&person));
    let provenance = Provenance::begin(PROGRAM).with_configuration(config)?.with_models(models.paths())?;
    Ok(Provenance { trained_on_person, ..provenance.with_recording(&recording)? })
}

/// The models of a session, and the numbers of the people that they were trained on.
///
/// # Errors
///
/// When one is missing or cannot be read.
pub fn models(config: &Config) -> anyhow::Result<(ModelFiles, Vec<u16>)> {
    let inference = &config.inference;
    let models = ModelFiles::find(
        config.decision.strategy,
        inference.model.as_deref(),
        inference.rest_move_model.as_deref(),
    )?;
    let mut trained = Vec::new();
    for model in models.paths() {
        trained.extend(people_trained(model).with_context(|| {
            format!("cannot open {}: check the path and its permissions", model.display())
        })?);
    }
    Ok((models, trained))
}

/// The number of the person whose recording this is, where the layout tells it.
fn person(recording: &Path) -> Option<u16> {
    let origin = three_dc::origin(recording).or_else(|| three_dc::origin(recording.parent()?));
    origin.map(|(person, _)| person)
}
