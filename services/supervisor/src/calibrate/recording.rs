//! Where a calibration is recorded.
//!
//! ```text
//! new calibration ─▶ people/NAME/recordings/WHEN, of an update WHEN-update
//! --redo GESTURE ──▶ the recording that the person was fitted to, or the newest of somebody who was not kept
//! ```

use std::path::{Path, PathBuf};

use anyhow::{anyhow, ensure};
use tendon_config::Config;
use tendon_people::{People, PersonName};
use tendon_process::SignalDescription;
use tendon_provenance::Provenance;
use tendon_recordings::{RecordedSession, Recorder, SimulatedFrom};

use super::check;
use crate::Failure;
use crate::personal::is_simulated;

/// Folder of a person's recordings in that of the person.
const RECORDINGS: &str = "recordings";
/// What the folder of an update ends with.
const UPDATE: &str = "-update";

/// Where a calibration is recorded.
pub enum Recording {
    /// In this new folder.
    New(PathBuf, RecordedSession),
    /// Beside what was recorded before.
    Resumed(Recorder),
}

impl Recording {
    /// A new one of this person. `source` says in words where the samples come from.
    pub fn new(
        (people, name): (&People, &PersonName),
        is_update: bool,
        config: &Config,
        source: &str,
        begun: &Provenance,
    ) -> anyhow::Result<Recording> {
        let ending = if is_update { UPDATE } else { "" };
        let folder = recordings_of(people, name).join(begun.started_at.replace(':', "-") + ending);
        Ok(Recording::New(folder, recorded_session(name, config, source, begun)?))
    }

    /// The one to which a gesture of this person is added. It must be of the configuration's channels and rate.
    pub fn to_redo(people: &People, name: &PersonName, config: &Config) -> anyhow::Result<Recording> {
        let recorder = Recorder::resume(&recording_to_redo(people, name)?)?;
        let RecordedSession { channels, sample_rate_hz, .. } = recorder.session();
        let acquisition = &config.acquisition;
        ensure!(
            channels.len() == acquisition.channels && *sample_rate_hz == acquisition.sample_rate_hz,
            "{} holds {} channels at {sample_rate_hz} Hz, this session has {} at {} Hz: use the same configuration",
            recorder.folder().display(),
            channels.len(),
            acquisition.channels,
            acquisition.sample_rate_hz
        );
        Ok(Recording::Resumed(recorder))
    }

    /// What is said of it.
    pub fn session(&self) -> &RecordedSession {
        match self {
            Recording::New(_, session) => session,
            Recording::Resumed(recorder) => recorder.session(),
        }
    }

    /// Of the channels and in the unit that the source says it has.
    pub fn of_signal(self, signal: Option<SignalDescription>) -> anyhow::Result<Recording> {
        let Some(signal) = signal else { return Ok(self) };
        match self {
            Recording::New(folder, mut session) => {
                SignalDescription { channels: session.channels, unit: session.unit } = signal;
                Ok(Recording::New(folder, session))
            }
            Recording::Resumed(recorder) => {
                let recorded = recorder.session();
                ensure!(
                    recorded.channels == signal.channels && recorded.unit == signal.unit,
                    "{} holds the channels {} in \"{}\", and the source has {} in \"{}\": choose the same \
                     (acquisition.channel_selection, acquisition.unit), or calibrate anew with --replace",
                    recorder.folder().display(),
                    recorded.channels.join(", "),
                    recorded.unit,
                    signal.channels.join(", "),
                    signal.unit
                );
                Ok(Recording::Resumed(recorder))
            }
        }
    }

    /// Begins to record. A source that never gives a sample leaves no folder behind if this waits for the first.
    pub fn begin(self) -> Result<Recorder, Failure> {
        match self {
            Recording::New(folder, session) => Recorder::create(&folder, session).map_err(Failure::input),
            Recording::Resumed(recorder) => Ok(recorder),
        }
    }
}

/// What is said of a recording that `source` describes.
fn recorded_session(
    name: &PersonName,
    config: &Config,
    source: &str,
    begun: &Provenance,
) -> anyhow::Result<RecordedSession> {
    let acquisition = &config.acquisition;
    // Of a source that does not say what its channels are called; a table needs names that are no numbers.
    let channels = (0..acquisition.channels).map(|channel| format!("channel_{channel}")).collect();
    let mut session =
        RecordedSession::new(name.id(), &begun.started_at, channels, acquisition.sample_rate_hz);
    session.source = source.to_owned();
    session.program_version = begun.version.clone();
    session.commit = begun.commit.clone();
    session.filter = config.dsp.filter.clone();
    if is_simulated(config) {
        let profile = acquisition.simulate.read_profile()?;
        session.unit = profile.unit;
        let of_data_set = profile.data_set.zip(profile.number);
        session.simulated = of_data_set.map(|(data_set, number)| SimulatedFrom { data_set, number });
    }
    Ok(session)
}

fn recordings_of(people: &People, name: &PersonName) -> PathBuf {
    people.folder_of(name).join(RECORDINGS)
}

/// The recording to which a gesture is added: the one that a person was fitted to; of somebody who was not kept, the newest.
fn recording_to_redo(people: &People, name: &PersonName) -> anyhow::Result<PathBuf> {
    if people.check_new(name).is_ok() {
        return newest_recording(people, name);
    }
    let made = people.find(name)?.made;
    match &made.recordings[..] {
        // A person of an earlier version of Tendon.
        [] => newest_recording(people, name),
        [only] if RecordedSession::read(only.as_ref())?.is_some() => Ok(only.into()),
        _ => Err(anyhow!(
            "{name} was calibrated from {}, to which no gesture can be added: calibrate anew with --replace",
            made.from
        )),
    }
}

/// The newest recording of a person. Their names sort by time.
fn newest_recording(people: &People, name: &PersonName) -> anyhow::Result<PathBuf> {
    let folder = recordings_of(people, name);
    let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_update = |path: &Path| path.to_str().is_none_or(|path| path.ends_with(UPDATE));
    let is_calibration = |path: &PathBuf| !check::is_check(path) && !is_update(path);
    let recordings = entries.filter(|path| is_calibration(path) && RecordedSession::read(path).is_ok());
    recordings.max().ok_or_else(|| {
        anyhow!("{name} has no recording in {}: calibrate first, without --redo", folder.display())
    })
}
