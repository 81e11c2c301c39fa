//! `tendon calibrate NAME --update`: what it asks for, and what it changes.
//!
//! ```text
//! person ──────────────────────────────┬─ recognised before
//! recording of the update ─▶ windows ──┼─ Person::updated ─▶ recognised after
//!                                      └─ strength of each channel, beside that of the calibration
//! ```

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, ensure};
use tendon_config::Config;
use tendon_dataset::list;
use tendon_evaluation::{LeftOut, PersonWindows};
use tendon_guide::GuideSettings;
use tendon_people::Person;
use tendon_provenance::Provenance;
use tendon_recordings::RecordedSession;

use super::check::{mean, recognised};
use super::fit::Fitted;
use super::scores::UpdateScores;
use crate::personal::recorded_settings;

/// How long a gesture is held, and how long the rest before it is, s.
const HOLD_S: f64 = 1.5;
const PAUSE_S: f64 = 1.5;
/// Rest at the beginning, s.
const REST_S: f64 = 3.0;

/// What is asked, where the options do not say otherwise.
pub fn guide_settings() -> GuideSettings {
    GuideSettings { rest_s: REST_S, hold_s: HOLD_S, pause_s: PAUSE_S, ..GuideSettings::default() }
}

/// Refuses a signal that is not that of the calibration.
pub fn check_signal(person: &Person, config: &Config) -> anyhow::Result<()> {
    let signal = &person.signal;
    let (channels, rate_hz) = (config.acquisition.channels, config.acquisition.sample_rate_hz);
    let is_same_filter = signal.filter.as_ref().is_none_or(|filter| *filter == config.dsp.filter);
    ensure!(
        signal.channels.len() == channels && signal.sample_rate_hz == rate_hz && is_same_filter,
        "{} was calibrated with {} channels at {} Hz, this session has {channels} at {rate_hz} Hz, or another filter: use \
         the same configuration",
        person.name,
        signal.channels.len(),
        signal.sample_rate_hz
    );
    Ok(())
}

/// Moves the person by what the recording in `folder` shows.
pub fn update(person: &Person, config: &Config, folder: &Path, begun: &Provenance) -> anyhow::Result<Fitted> {
    let recorded = RecordedSession::read(folder)?.context("the recording's description is gone")?;
    let settings = recorded_settings(config, &recorded);
    let found = list(&settings, &[folder.to_owned()])?;
    let mut skipped: Vec<LeftOut> = found.skipped.iter().map(LeftOut::from).collect();
    let windows = PersonWindows::read(&settings, &found.recordings, &mut skipped);
    let begin = Instant::now();
    let made = || {
        let made = windows.origins().iter().enumerate();
        made.map(|(window, origin)| (origin.gesture, windows.window(window)))
    };
    let updated = person.updated(made(), &begun.started_at)?;
    let fit_s = begin.elapsed().as_secs_f64();
    let scores = UpdateScores {
        before: mean(&recognised(person, &windows)?),
        after: mean(&recognised(&updated, &windows)?),
        channels: person.shifts(made()),
    };
    Ok(Fitted { person: updated, fit_s, skipped, update: Some(scores) })
}
