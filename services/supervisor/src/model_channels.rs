//! Which channels a model was trained on, by name: these are taken where nobody says which, and others are refused.
//!
//! ```text
//! model ─▶ names ─┬─▶ replay, amplifier, recordings: chosen by these names, unless the user chooses
//!                 └─▶ compared with the names that the source gives ─▶ refused, or nothing
//! ```
//! The models that come with Tendon name no channels, only numbers in their data set.

use std::path::{Path, PathBuf};

use anyhow::bail;
use tendon_classifier::{Contract, ModelFiles, contract_of};
use tendon_config::{AcquisitionSettings, Config, Source};
use tendon_gesture::Strategy;
use tendon_recordings::{Channel, RecordingSource};
use tendon_session_file::is_session_file;

use crate::channels::ask_for;
use crate::recording_options::named_channel;

/// The channels that the first of these models that names some was trained on; none if none does.
pub fn remembered<'a>(models: impl IntoIterator<Item = &'a Path>) -> Vec<Channel> {
    let names = contracts(models).find_map(|(_, contract)| {
        let names = contract.remembered_channels().to_vec();
        (!names.is_empty()).then_some(names)
    });
    names.iter().flatten().filter_map(|name| named_channel(name).ok()).collect()
}

/// Refuses channels with the names `given`, which are those of `source` (`the recording gives`), if one of these models was
/// trained on others.
///
/// # Errors
///
/// Both lists, by name.
pub fn check<'a>(
    models: impl IntoIterator<Item = &'a Path>,
    source: &str,
    given: &[String],
) -> anyhow::Result<()> {
    for (model, contract) in contracts(models) {
        if let Some(difference) = contract.other_channels(source, given) {
            bail!(
                "{}: {difference}: choose the channels by name, such as --channels {}, or take another model",
                model.display(),
                contract.remembered_channels().join(",")
            );
        }
    }
    Ok(())
}

/// What the models say of themselves, as far as they can be read: whoever loads them says what is wrong with the others.
fn contracts<'a>(models: impl IntoIterator<Item = &'a Path>) -> impl Iterator<Item = (&'a Path, Contract)> {
    models.into_iter().filter_map(|model| Some((model, contract_of(model).ok()??)))
}

/// The models of a session; none of a person's.
pub fn of_session(config: &Config) -> Vec<PathBuf> {
    if config.decision.strategy == Strategy::Personal {
        return Vec::new();
    }
    let inference = &config.inference;
    let models = ModelFiles::find(
        config.decision.strategy,
        inference.model.as_deref(),
        inference.rest_move_model.as_deref(),
    );
    models.iter().flat_map(|models| models.paths().map(Path::to_owned)).collect()
}

/// Sets a session up for the channels of its models, where the user chooses none.
pub fn choose(config: &mut Config) {
    let models = of_session(config);
    let channels = remembered(models.iter().map(PathBuf::as_path));
    if channels.is_empty() {
        return;
    }
    let acquisition = &mut config.acquisition;
    if is_replayed_table(acquisition) {
        acquisition.replay.channels.get_or_insert(channels);
    } else {
        let names: Vec<String> = channels.iter().map(Channel::name).collect();
        ask_for(acquisition, &names, "");
    }
}

/// Refuses a recording whose chosen channels are others than those the models were trained on.
///
/// # Errors
///
/// Both lists, by name. What cannot be read is said elsewhere.
pub fn check_recording(config: &Config) -> anyhow::Result<()> {
    let acquisition = &config.acquisition;
    let Some(path) = &acquisition.replay.path else { return Ok(()) };
    if !is_replayed_table(acquisition) {
        return Ok(());
    }
    let settings = acquisition.replay.recording(acquisition.channels);
    let opened = settings.and_then(|settings| RecordingSource::open(path, &settings));
    let Ok(recording) = opened else { return Ok(()) };
    let models = of_session(config);
    check(models.iter().map(PathBuf::as_path), "the recording gives", &recording.chosen())
}

/// Whether the source is a recording that is no recorded session: that has its own models.
pub fn is_replayed_table(acquisition: &AcquisitionSettings) -> bool {
    let path = acquisition.replay.path.as_deref();
    acquisition.source == Source::Replay && path.is_some_and(|path| !is_session_file(path))
}
