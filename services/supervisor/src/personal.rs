//! What the commands share that calibrate people or run with one: how windows are cut, the prior that comes with Tendon,
//! and the settings of a session with a person.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use tendon_config::{Config, Source};
use tendon_dataset::DatasetSettings;
use tendon_features::Cohort;
use tendon_gesture::{Gesture, GestureSet, Strategy};
use tendon_people::{People, Person, PersonName, SignalOffer};
use tendon_process::SignalDescription;
use tendon_recordings::{Channel, RecordedSession};
use tendon_signal::{OnsetMethod, OnsetSettings, WindowSettings, are_same_channels, canonical_unit};

use crate::channels::ask_for;
use crate::configuration::Base;
use crate::model_channels;
use crate::recording_options::RecordingOptions;

/// Keys of the windows.
pub const WINDOWS: &str = "dsp.windows";
/// A movement counts from here on, ms after its cue: by then everybody has followed it.
const MOVEMENT_BEGINS_MS: f64 = 1200.0;
/// Where the onset of a gesture that `tendon calibrate` recorded is looked for, ms from the beginning of its trial, which is
/// half a second before the cue.
const RECORDED_ONSET_MS: [f64; 2] = [400.0, 1500.0];
/// Where none is found, the movement counts from here on, ms.
const RECORDED_FALLBACK_MS: f64 = 1000.0;
/// Windows of a person where nobody asks for others, ms: long enough to be sure, short enough to be quick.
const WINDOW_MS: f64 = 150.0;
/// From one such window to the next, ms.
const INCREMENT_MS: f64 = 25.0;
/// File of the prior in `models/`.
const PRIOR_FILE: &str = "prior-3dc.tendon-prior";
/// Largest prior, in bytes.
const LARGEST_PRIOR: u64 = 256 << 20;

/// How recordings are cut into windows to calibrate on.
pub fn dataset_settings(
    config: &Config,
    channels: &[Channel],
    recording: &RecordingOptions,
) -> DatasetSettings {
    let default = recording.settings(DatasetSettings::default());
    DatasetSettings {
        channels: channels.to_vec(),
        sample_rate_hz: config.acquisition.sample_rate_hz,
        filter: Some(config.dsp.filter.clone()),
        windows: config.dsp.windows.clone(),
        onset: OnsetSettings { method: OnsetMethod::Fixed, ..default.onset },
        fallback_ms: MOVEMENT_BEGINS_MS,
        rest_start_ms: MOVEMENT_BEGINS_MS,
        ..default
    }
}

/// How the recordings that calibrate a person are cut: as [`dataset_settings`], but from the onset of each movement, so that
/// its beginning is learnt, too.
pub fn calibration_settings(
    config: &Config,
    channels: &[Channel],
    recording: &RecordingOptions,
) -> DatasetSettings {
    let onset = DatasetSettings::default().onset;
    DatasetSettings { onset, ..dataset_settings(config, channels, recording) }
}

/// The same for what `tendon calibrate` recorded: all of its channels; a trial of a gesture begins half a second before its
/// cue, and a rest is rest throughout.
pub fn recorded_settings(config: &Config, recorded: &RecordedSession) -> DatasetSettings {
    let settings = calibration_settings(config, &[], &RecordingOptions::default());
    DatasetSettings {
        recording_rate_hz: Some(recorded.sample_rate_hz),
        channels: recorded.channels.iter().cloned().map(Channel::Name).collect(),
        onset: OnsetSettings { search_ms: RECORDED_ONSET_MS, ..settings.onset.clone() },
        fallback_ms: RECORDED_FALLBACK_MS,
        rest_start_ms: 0.0,
        ..settings
    }
}

/// The configuration with a person's windows, unless others are asked for: by a key that is set, or by a configuration file.
pub fn personal_windows(config: Config, sets_windows: bool) -> Config {
    if sets_windows || config.dsp.windows != WindowSettings::default() {
        return config;
    }
    let mut config = config;
    let rate_hz = config.acquisition.sample_rate_hz;
    config.dsp.windows = WindowSettings {
        window_samples: samples_of_ms(WINDOW_MS, rate_hz),
        increment_samples: samples_of_ms(INCREMENT_MS, rate_hz),
    };
    config
}

fn samples_of_ms(ms: f64, rate_hz: f64) -> usize {
    ((ms * 1e-3 * rate_hz).round() as usize).max(1)
}

/// Windows and the steps between them, in words.
pub fn windows_in_words(windows: &WindowSettings, rate_hz: f64) -> String {
    let ms = |samples: usize| (1e3 * samples as f64 / rate_hz).round();
    format!("windows of {} ms every {} ms", ms(windows.window_samples), ms(windows.increment_samples))
}

/// How to ask for the windows of a person; nothing where these are such.
pub fn how_to_get_personal_windows(windows: &WindowSettings, rate_hz: f64) -> String {
    let window_samples = samples_of_ms(WINDOW_MS, rate_hz);
    if windows.window_samples == window_samples {
        return String::new();
    }
    format!(
        " (tendon calibrate has {WINDOW_MS} ms; to get these: --set dsp.windows.window_samples={window_samples})"
    )
}

/// Refuses gestures that the simulated person does not know. `whose` gestures they are.
///
/// # Errors
///
/// Both lists.
pub fn check_simulated(config: &Config, whose: &str, gestures: &[Gesture]) -> anyhow::Result<()> {
    let (emg, _) = config.acquisition.open_simulation()?;
    let known = emg.gestures();
    let names = |gestures: &mut dyn Iterator<Item = Gesture>| {
        gestures.map(|gesture| gesture.to_string()).collect::<Vec<_>>().join(", ")
    };
    ensure!(
        gestures.iter().all(|gesture| known.number(*gesture).is_some()),
        "the simulated person cannot make all gestures of {whose}, which are {}; it makes {}: choose among these, or a \
         profile with the others (acquisition.simulate.profile)",
        names(&mut gestures.iter().copied()),
        names(&mut known.iter())
    );
    Ok(())
}

/// Sets a session up for a person, who is named or whose file is: what the user left at its default becomes the person's.
/// Returns the file and the person.
///
/// # Errors
///
/// When there is no such person, or their file cannot be used.
pub fn set_person(person: &str, base: &Base, config: &mut Config) -> anyhow::Result<(PathBuf, Person)> {
    let (file, person) = match person.parse::<PersonName>() {
        Ok(name) => {
            let people = People::open()?;
            (people.file_of(&name), people.find(&name)?)
        }
        // It is no name that a person can have.
        Err(no_name) if !person.contains('/') && !std::path::Path::new(person).exists() => {
            bail!("there is no person file `{person}`, and {no_name}")
        }
        Err(_) => (PathBuf::from(person), Person::read(person.as_ref())?),
    };
    let default = Config::default();
    let signal = &person.signal;
    let acquisition = &mut config.acquisition;
    if acquisition.channels == default.acquisition.channels && !base.sets("acquisition.channels") {
        acquisition.channels = signal.channels.len();
    }
    if acquisition.sample_rate_hz == default.acquisition.sample_rate_hz
        && !base.sets("acquisition.sample_rate_hz")
    {
        acquisition.sample_rate_hz = signal.sample_rate_hz;
    }
    if acquisition.source == Source::Replay && acquisition.replay.channels.is_none() {
        let channel =
            |name: &String| name.parse().map_or_else(|_| Channel::Name(name.clone()), Channel::Index);
        acquisition.replay.channels = Some(signal.channels.iter().map(channel).collect());
    }
    ask_for(acquisition, &signal.channels, &signal.unit);
    if let Some(filter) = &signal.filter
        && config.dsp.filter == default.dsp.filter
        && !base.sets("dsp.filter")
    {
        config.dsp.filter = filter.clone();
    }
    let windows = &mut config.dsp.windows;
    if windows.window_samples == default.dsp.windows.window_samples
        && !base.sets("dsp.windows.window_samples")
    {
        windows.window_samples = signal.window_samples;
    }
    if windows.increment_samples == default.dsp.windows.increment_samples
        && !base.sets("dsp.windows.increment_samples")
    {
        windows.increment_samples = samples_of_ms(INCREMENT_MS, signal.sample_rate_hz);
    }
    if config.decision.gestures == default.decision.gestures && !base.sets("decision.gestures") {
        config.decision.gestures = person.gesture_set();
    }
    let gestures = &config.decision.gestures;
    if config.decision.modes == default.decision.modes && !base.sets("decision.modes") {
        // Of the paper's map, what the person makes.
        config.decision.modes.iter_mut().for_each(|mode| mode.keep(gestures));
        ensure!(
            config.decision.modes.iter().any(|mode| !mode.actions.is_empty()),
            "none of the gestures of {} does anything: say in [[decision.modes]] of the configuration what each does",
            person.name
        );
    }
    config.decision.strategy = Strategy::Personal;
    config.inference.person = Some(file.clone());
    // That of a recorded session is of the person who is replaced.
    config.inference.person_checksum = None;
    Ok((file, person))
}

/// Refuses a session that differs from what the person was calibrated with.
///
/// # Errors
///
/// Everything that differs, by name.
pub fn check_person(file: &Path, person: &Person, config: &Config) -> anyhow::Result<()> {
    let acquisition = &config.acquisition;
    if is_simulated(config) {
        let gestures: Vec<Gesture> = person.gesture_set().iter().collect();
        check_simulated(config, person.name.as_str(), &gestures)?;
    }
    let unit = match acquisition.source {
        Source::Simulate if acquisition.program.is_none() => acquisition.simulate.read_profile()?.unit,
        // Nobody knows it.
        Source::Simulate => String::new(),
        Source::Replay => {
            let recorded = acquisition.replay.path.as_deref().map_or(Ok(None), RecordedSession::beside)?;
            let own = recorded.map_or_else(|| acquisition.recording_unit(), |session| session.unit);
            if own.is_empty() { acquisition.unit.clone().unwrap_or_default() } else { own }
        }
        _ => acquisition.unit.clone().unwrap_or_default(),
    };
    let names: Option<Vec<String>> = match acquisition.source {
        Source::Simulate => None,
        Source::Replay => {
            acquisition.replay.channels.as_ref().map(|channels| channels.iter().map(Channel::name).collect())
        }
        // Of channels that are chosen by number, the amplifier says the names when it is ready.
        _ => acquisition.channel_selection.as_ref().and_then(|channels| {
            let names = channels.iter().map(|channel| match channel {
                Channel::Name(name) => Some(name.clone()),
                Channel::Index(_) => None,
            });
            names.collect()
        }),
    };
    let mut differences: Vec<String> = person
        .differences(&SignalOffer {
            source: "the session",
            channels: acquisition.channels,
            channel_names: names.as_deref(),
            sample_rate_hz: acquisition.sample_rate_hz,
            unit: &unit,
            window_samples: config.dsp.windows.window_samples,
            filter: Some(&config.dsp.filter),
        })
        .iter()
        .map(ToString::to_string)
        .collect();
    let (own, session) = (person.gesture_set(), &config.decision.gestures);
    if own != *session {
        let names = |set: &GestureSet| set.iter().map(String::from).collect::<Vec<_>>().join(", ");
        differences.push(format!(
            "gestures: calibrated with {}, the session has {}",
            names(&own),
            names(session)
        ));
    }
    ensure!(
        differences.is_empty(),
        "{}: {} does not fit: {}; change the configuration, or calibrate again with it",
        file.display(),
        person.name,
        differences.join("; ")
    );
    Ok(())
}

/// Whether the source is the simulated person that comes with Tendon.
pub fn is_simulated(config: &Config) -> bool {
    config.acquisition.source == Source::Simulate && config.acquisition.program.is_none()
}

/// Refuses a source that is ready with other channels, or another unit, than the person of this configuration was calibrated
/// with, or with other channels than its models were trained on. Only the source itself knows what it measures.
///
/// # Errors
///
/// What differs, by name.
pub fn check_signal(config: &Config, signal: &SignalDescription) -> anyhow::Result<()> {
    // The simulated amplifier numbers its channels, and so does the recording of a session with it.
    let numbered =
        signal.channels.iter().enumerate().all(|(place, name)| *name == format!("channel_{place}"));
    if is_simulated(config) || (config.acquisition.source == Source::Replay && numbered) {
        return Ok(());
    }
    let is_personal = config.decision.strategy == Strategy::Personal;
    let Some(file) = config.inference.person.as_ref().filter(|_| is_personal) else {
        let models = model_channels::of_session(config);
        return model_channels::check(
            models.iter().map(PathBuf::as_path),
            "the source gives",
            &signal.channels,
        );
    };
    let person = Person::read(file)?;
    let own = &person.signal;
    ensure!(
        are_same_channels(&own.channels, &signal.channels),
        "{}: {} was calibrated with the channels {}, and the source has {}: choose them in acquisition.channel_selection, or \
         calibrate again",
        file.display(),
        person.name,
        own.channels.join(", "),
        signal.channels.join(", ")
    );
    ensure!(
        own.unit.is_empty()
            || signal.unit.is_empty()
            || canonical_unit(&own.unit) == canonical_unit(&signal.unit),
        "{}: {} was calibrated in {}, and the source has {}: set acquisition.unit, or calibrate again",
        file.display(),
        person.name,
        own.unit,
        signal.unit
    );
    Ok(())
}

/// The people of the prior that comes with Tendon; `None` where it is not installed.
///
/// # Errors
///
/// When it is damaged.
pub fn shipped_prior() -> anyhow::Result<Option<Cohort>> {
    let Ok(path) = tendon_classifier::model_beside_program(PRIOR_FILE) else { return Ok(None) };
    let bytes = tendon_input::read(&path, LARGEST_PRIOR)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let cohort = Cohort::from_bytes(&bytes).with_context(|| path.display().to_string())?;
    Ok(Some(cohort))
}
