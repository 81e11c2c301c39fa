//! A person fitted to recordings with cues.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, anyhow, ensure};
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, Recording, list};
use tendon_evaluation::{LeftOut, PersonWindows, prior_without};
use tendon_features::{MethodSettings, Prior};
use tendon_gesture::Gesture;
use tendon_identity::{PersonId, list_of};
use tendon_people::{Made, Person};
use tendon_provenance::Provenance;
use tendon_recordings::RecordedSession;

use super::options::Options;
use super::scores::UpdateScores;
use crate::channels::channels_or_default;
use crate::personal::{WINDOWS, calibration_settings, personal_windows, recorded_settings, shipped_prior};

/// A person who was fitted, or updated.
pub struct Fitted {
    /// Who.
    pub person: Person,
    /// How long it took, s.
    pub fit_s: f64,
    /// Recordings that were left out.
    pub skipped: Vec<LeftOut>,
    /// What changed, if the person was there and was updated.
    pub update: Option<UpdateScores>,
}

impl Fitted {
    /// What keeps the person from being used, in words.
    pub fn serious(&self) -> Option<String> {
        let serious = self.person.findings.iter().filter(|finding| finding.is_serious());
        let serious: Vec<String> = serious.map(ToString::to_string).collect();
        (!serious.is_empty()).then(|| serious.join("; "))
    }
}

/// The part of recordings that a person is fitted to.
pub struct Selection<'a> {
    /// Where they are.
    pub paths: &'a [PathBuf],
    /// Only the first ones of each gesture; `None` for all.
    pub repetitions: Option<u32>,
    /// Only these and rest; none for all.
    pub gestures: &'a [Gesture],
}

/// How recordings are cut: as a calibration of ours describes its own, or as the options say. Channels have the names that the
/// recordings give them.
fn settings_of(
    options: &Options,
    config: &Config,
    paths: &[PathBuf],
) -> anyhow::Result<(DatasetSettings, Option<RecordedSession>)> {
    let recorded = paths.first().map_or(Ok(None), |path| RecordedSession::read(path))?;
    let mut settings = match &recorded {
        // Its labels.csv counts; a column of labels is refused.
        Some(recorded) => DatasetSettings {
            label_column: options.recording.label_column.clone(),
            ..recorded_settings(config, recorded)
        },
        None => calibration_settings(config, &[], &options.recording),
    };
    let given = &options.recording.channels;
    if !given.is_empty() || recorded.is_none() {
        settings.channels = channels_or_default(given, &settings, paths)?;
    }
    Ok((settings, recorded))
}

/// Fits the person to the recordings, with the prior of others where it fits. `clipped_shares` are those of the channels, as
/// far as somebody watched.
pub fn fit(
    options: &Options,
    config: &Config,
    selection: &Selection<'_>,
    clipped_shares: &[f64],
    begun: &Provenance,
) -> anyhow::Result<Fitted> {
    let shipped = shipped_prior()?;
    let config = personal_windows(config.clone(), options.base.sets(WINDOWS));
    let (settings, recorded) = settings_of(options, &config, selection.paths)?;
    let found = list(&settings, selection.paths)?;
    let unit = options.recording.unit_of(&found.unit)?;
    let recordings = of_one_person(options, found.recordings)?;
    let number = recordings[0].person;
    let mut skipped: Vec<LeftOut> = found.skipped.iter().map(LeftOut::from).collect();
    let windows = PersonWindows::read(&settings, &recordings, &mut skipped);
    let chosen = windows.chosen(options.session.as_deref(), selection.repetitions);
    let is_wanted = |gesture: Gesture| {
        let wanted = selection.gestures;
        wanted.is_empty() || gesture == Gesture::REST || wanted.contains(&gesture)
    };
    let chosen: Vec<usize> =
        chosen.into_iter().filter(|&window| is_wanted(windows.origins()[window].gesture)).collect();
    ensure!(
        !windows.origins().is_empty(),
        "no recording holds a window that can be used: {}",
        skipped.first().map_or("there are none with a cue", |first| &first.reason)
    );
    for gesture in selection.gestures {
        let is_there = chosen.iter().any(|&window| windows.origins()[window].gesture == *gesture);
        ensure!(is_there, "--gestures {gesture}: the recordings hold no window of it");
    }
    let method = MethodSettings::default();
    let (channels, rate_hz) = (settings.channels.len(), settings.sample_rate_hz);
    let prior: Option<Prior> = match shipped {
        // A simulated person must not be known to the prior either.
        Some(cohort) if cohort.serves(&method, channels, rate_hz)? => {
            match recorded.as_ref().and_then(|recorded| recorded.simulated.as_ref()) {
                Some(from) => cohort.prior(|member| {
                    (&member.data_set, member.person) != (&from.data_set, from.number.into())
                })?,
                None => prior_without(&cohort, found.layout, number)?,
            }
        }
        _ => None,
    };
    let made = Made {
        at: begun.started_at.clone(),
        version: begun.version.clone(),
        commit: begun.commit.clone(),
        from: format!("recordings: {}", listed(selection.paths)),
        recordings: absolute(selection.paths)?,
        recordings_sha256: begun
            .recording
            .as_ref()
            .map_or_else(String::new, |recording| recording.sha256.clone()),
        prior_people: Vec::new(),
    };
    let start = Instant::now();
    let mut person =
        windows.fit(&chosen, options.name.clone(), made, &method, prior.as_ref(), clipped_shares)?;
    person.signal.unit = unit;
    Ok(Fitted { person, fit_s: start.elapsed().as_secs_f64(), skipped, update: None })
}

/// The recordings of the person asked for.
fn of_one_person(options: &Options, recordings: Vec<Recording>) -> anyhow::Result<Vec<Recording>> {
    let mut numbers: Vec<PersonId> = recordings.iter().map(|recording| recording.person).collect();
    numbers.sort_unstable();
    numbers.dedup();
    let number = match (options.person_number, &numbers[..]) {
        (Some(number), _) => number,
        (None, [only]) => *only,
        (None, _) => {
            return Err(anyhow!(
                "the recordings are of several people ({}): say whom with --person-number",
                list_of(&numbers)
            ));
        }
    };
    let mut sessions: Vec<&str> = Vec::new();
    for recording in recordings.iter().filter(|recording| recording.person == number) {
        if !sessions.contains(&recording.session.as_str()) {
            sessions.push(&recording.session);
        }
    }
    ensure!(!sessions.is_empty(), "--person-number {number}: there are no recordings of this person");
    if let Some(session) = &options.session {
        ensure!(
            sessions.contains(&session.as_str()),
            "--session {session}: person {number} has only {}",
            sessions.join(", ")
        );
    }
    let is_wanted = |recording: &Recording| {
        recording.person == number
            && options.session.as_ref().is_none_or(|session| *session == recording.session)
    };
    Ok(recordings.into_iter().filter(is_wanted).collect())
}

/// The paths from any folder.
fn absolute(paths: &[PathBuf]) -> anyhow::Result<Vec<String>> {
    let absolute = |path: &PathBuf| {
        let absolute = std::path::absolute(path);
        absolute.with_context(|| format!("cannot make {} an absolute path", path.display()))
    };
    paths.iter().map(|path| Ok(absolute(path)?.display().to_string())).collect()
}

fn listed(paths: &[PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}
