//! A guided calibration as it is asked for, checked before anything of it begins.
//!
//! ```text
//! options ─▶ configuration of the source, what is asked, whom it updates, what a gesture is added to ─▶ Plan
//! ```

use std::time::Duration;

use anyhow::ensure;
use tendon_config::{Config, Gestures, Source};
use tendon_gesture::Gesture;
use tendon_guide::GuideSettings;
use tendon_people::{People, Person};
use tendon_recordings::RecordedSession;

use super::options::Options;
use super::recording::Recording;
use super::update;
use crate::channels::ask_for;
use crate::personal::{WINDOWS, check_simulated, is_simulated, personal_windows};

/// A calibration as it is asked for. Nothing of it has begun.
pub struct Plan<'a> {
    /// What was typed.
    pub options: &'a Options,
    /// Those who are kept.
    pub people: &'a People,
    /// Of the source.
    pub config: Config,
    /// What is asked.
    pub guide: GuideSettings,
    /// The person who is to be updated.
    pub updated: Option<Person>,
    /// What a gesture is added to.
    pub redone: Option<Recording>,
}

impl Plan<'_> {
    /// What these options ask for.
    pub fn of<'a>(options: &'a Options, people: &'a People) -> anyhow::Result<Plan<'a>> {
        let name = &options.name;
        let is_redo = options.guided.redo.is_some();
        let updated = options.guided.update.then(|| people.find(name)).transpose()?;
        if !options.replace && !is_redo && updated.is_none() {
            people.check_new(name)?;
        }
        let mut config = configuration(options)?;
        if let Some(person) = &updated {
            config.dsp.windows.window_samples = person.signal.window_samples;
            ask_for(&mut config.acquisition, &person.signal.channels, &person.signal.unit);
            update::check_signal(person, &config)?;
        }
        let guide = guide_settings(options, &config, updated.as_ref())?;
        let redone = is_redo.then(|| Recording::to_redo(people, name, &config)).transpose()?;
        if let Some(recording) = &redone {
            let RecordedSession { channels, unit, .. } = recording.session();
            ask_for(&mut config.acquisition, channels, unit);
        }
        Ok(Plan { options, people, config, guide, updated, redone })
    }
}

/// Looks whether a calibration with these options could begin.
///
/// # Errors
///
/// Why not.
pub fn check(options: &Options, people: &People) -> anyhow::Result<()> {
    Plan::of(options, people).map(drop)
}

/// The configuration of the source, with a person's windows; a simulated person follows the cues.
fn configuration(options: &Options) -> anyhow::Result<Config> {
    let mut config = personal_windows(options.base.configuration()?, options.base.sets(WINDOWS));
    ensure!(
        config.acquisition.source != Source::Replay,
        "a recording cannot follow cues: calibrate with it by --from, or set acquisition.source to another source"
    );
    config.acquisition.simulate.gestures = Gestures::Keyboard;
    Ok(config)
}

/// What is asked.
fn guide_settings(
    options: &Options,
    config: &Config,
    updated: Option<&Person>,
) -> anyhow::Result<GuideSettings> {
    let default = if updated.is_some() { update::guide_settings() } else { GuideSettings::default() };
    let guided = &options.guided;
    let known = updated.map_or_else(|| config.decision.gestures.clone(), Person::gesture_set);
    let gestures = match (guided.redo, &options.gestures[..]) {
        (Some(Gesture::REST), _) => Vec::new(),
        (Some(gesture), _) => vec![gesture],
        (None, []) => known.iter().filter(|gesture| *gesture != Gesture::REST).collect(),
        (None, gestures) => {
            gestures.iter().copied().filter(|gesture| *gesture != Gesture::REST).collect::<Vec<_>>()
        }
    };
    let seconds = |given: Option<Duration>, default_s| given.map_or(default_s, |given| given.as_secs_f64());
    let settings = GuideSettings {
        gestures,
        repetitions: options.repetitions.unwrap_or(default.repetitions),
        rest_s: seconds(guided.rest, default.rest_s),
        hold_s: seconds(guided.hold, default.hold_s),
        pause_s: seconds(guided.pause, default.pause_s),
    };
    if guided.redo == Some(Gesture::REST) {
        ensure!(
            !guided.check,
            "--redo rest asks for no gesture, so --check has none to score: leave one of the two out"
        );
        settings.check_rest_alone()?;
    } else {
        settings.check()?;
    }
    if is_simulated(config) {
        let whose = if updated.is_some() { options.name.as_str() } else { "the calibration" };
        check_simulated(config, whose, &settings.gestures)?;
    }
    Ok(settings)
}
