//! `tendon calibrate NAME`: records a person by cues, or takes recordings with cues, fits the person and keeps them.
//!
//! ```text
//! cues (guided) ─▶ recordings ─▶ windows of one person ─▶ Person::fit, with the prior of others ─▶ findings? ─▶ people/NAME/person.toml
//! ```

mod board;
mod check;
mod guided;
mod learnt;
mod next;
mod page;
mod recording;
mod round;
mod status;
mod update;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use serde::Serialize;
use tendon_config::Config;
use tendon_dataset::{DatasetSettings, Recording, list};
use tendon_evaluation::{LeftOut, PersonWindows, prior_without};
use tendon_features::{MethodSettings, Prior};
use tendon_gesture::Gesture;
use tendon_identity::{PersonId, list_of};
use tendon_output::{OutputFile, check_distinct, collect};
use tendon_people::{
    ChannelQuality, ChannelShift, Expected, GestureFit, HeldOut, Made, People, Person, PersonName,
};
use tendon_provenance::Provenance;
use tendon_recordings::{RecordedSession, SkippedKind};

use crate::Failure;
use crate::channels::channels_or_default;
use crate::configuration::{Base, WINDOW_KEYS};
use crate::next::Following;
use crate::output::{checked_private, left_out, print};
use crate::page::RunOptions;
use crate::personal::{WINDOWS, calibration_settings, personal_windows, recorded_settings, shipped_prior};
use crate::provenance::PROGRAM;
use crate::recording_options::RecordingOptions;

use check::CheckScores;
pub use next::command_line;
pub use status::CalibrationStatus;
use update::UpdateScores;

/// Command line of `tendon calibrate`.
#[derive(Debug, Args)]
pub struct Options {
    /// Name of the person, by which `tendon run --person` finds them: 1 to 40 of the characters a-z 0-9 - _. A pseudonym is
    /// enough.
    name: PersonName,
    #[command(flatten)]
    guided: guided::GuidedOptions,
    /// Instead of recording now, take recordings with cues, in any layout that `tendon evaluate` reads.
    #[arg(long, num_args = 1.., value_name = "PATH", conflicts_with = "page")]
    from: Vec<PathBuf>,
    /// Number or name of the person in the recordings, where they are of several people.
    #[arg(long, value_name = "P", requires = "from")]
    person_number: Option<PersonId>,
    /// Only this session of the recordings, such as `train` of 3DC [default: all].
    #[arg(long, value_name = "SESSION", requires = "from")]
    session: Option<String>,
    /// How often each gesture is asked for [default: 1]; with --from, only the first N repetitions [default: all].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    repetitions: Option<u32>,
    /// The gestures, of any names, besides rest [default: those of the configuration; with --from, all that were
    /// recorded].
    #[arg(long, value_name = "GESTURE,…", value_delimiter = ',')]
    gestures: Vec<Gesture>,
    #[command(flatten)]
    recording: RecordingOptions,
    #[command(flatten)]
    base: Base,
    /// The page of the calibration.
    #[command(flatten)]
    page: RunOptions,
    /// Put the person in the place of the one who has this name.
    #[arg(long)]
    replace: bool,
    /// Also write what was learnt to this file, as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Learnt<'a> {
    person: &'a PersonName,
    file: String,
    fit_s: f64,
    prior_people: usize,
    expected: &'a Expected,
    gestures: &'a [GestureFit],
    channels: &'a [ChannelQuality],
    findings: Vec<String>,
    skipped: &'a [LeftOut],
    skipped_by_kind: BTreeMap<SkippedKind, usize>,
    /// What an update changed; `null` if it is none.
    update: Option<&'a UpdateScores>,
    /// How the check round was recognised; `null` without one.
    check: Option<&'a CheckScores>,
    provenance: Provenance,
}

/// Fits a person and keeps them; gives what is to follow, if somebody at the page has asked for something.
pub fn calibrate(options: &Options) -> Result<Option<Following>, Failure> {
    let json = checked_private(options.json.as_deref())?;
    let inputs = options.from.iter().map(PathBuf::as_path).chain(options.base.file());
    check_distinct(&json, [], inputs).map_err(Failure::input)?;
    let begun = Provenance::begin(PROGRAM);
    let people = People::open().map_err(Failure::input)?;
    let _reserved = people.reserve(&options.name).map_err(Failure::input)?;
    if options.from.is_empty() {
        if let Some(option) = options.recording.given() {
            return Err(Failure::input(anyhow!(
                "{option} is for recordings: name some with --from, or leave {option} out"
            )));
        }
        return guided::calibrate(options, &people, json.as_ref(), begun);
    }
    if !options.replace {
        people.check_new(&options.name).map_err(Failure::input)?;
    }
    let begun = begun.with_recording(&options.from).map_err(Failure::input)?;
    let config = options.base.configuration_of("tendon calibrate --from", &WINDOW_KEYS);
    let config = config.map_err(Failure::input)?;
    let selection =
        Selection { paths: &options.from, repetitions: options.repetitions, gestures: &options.gestures };
    let fitted = fit(options, &config, &selection, &[], &begun).map_err(Failure::input)?;
    if let Some(serious) = fitted.serious() {
        return Err(Failure::input(anyhow!(
            "{} is not kept: {serious}. Or leave out what is wrong with --gestures or --channels",
            options.name
        )));
    }
    let file = people.replace(&fitted.person).map_err(Failure::running)?;
    report(options, &fitted, &file, None, begun, json.as_ref()).map(|()| None)
}

/// Says what was learnt.
fn report(
    options: &Options,
    fitted: &Fitted,
    file: &Path,
    check: Option<&CheckScores>,
    begun: Provenance,
    json: Option<&OutputFile>,
) -> Result<(), Failure> {
    let Fitted { person, fit_s, skipped, update } = fitted;
    let learnt = Learnt {
        person: &person.name,
        file: file.display().to_string(),
        fit_s: *fit_s,
        prior_people: person.made.prior_people.len(),
        expected: &person.expected,
        gestures: &person.gestures,
        channels: &person.channels,
        findings: person.findings.iter().map(ToString::to_string).collect(),
        skipped,
        skipped_by_kind: SkippedKind::count(skipped.iter().map(|left_out| left_out.kind)),
        update: update.as_ref(),
        check,
        provenance: begun,
    };
    let written = collect(json.iter().map(|json| json.write_json(&learnt))).map_err(Failure::running);
    written.and(print(text(options, &learnt, person)).map_err(Failure::running))
}

struct Fitted {
    person: Person,
    fit_s: f64,
    skipped: Vec<LeftOut>,
    /// What changed, if the person was there and was updated.
    update: Option<UpdateScores>,
}

impl Fitted {
    /// What keeps the person from being used, in words.
    fn serious(&self) -> Option<String> {
        let serious = self.person.findings.iter().filter(|finding| finding.is_serious());
        let serious: Vec<String> = serious.map(ToString::to_string).collect();
        (!serious.is_empty()).then(|| serious.join("; "))
    }
}

/// The part of recordings that a person is fitted to.
struct Selection<'a> {
    paths: &'a [PathBuf],
    /// Only the first ones of each gesture; `None` for all.
    repetitions: Option<u32>,
    /// Only these and rest; none for all.
    gestures: &'a [Gesture],
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
fn fit(
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

/// What was learnt, for people.
fn text(options: &Options, learnt: &Learnt, person: &Person) -> String {
    let signal = &person.signal;
    let unit = if signal.unit.is_empty() { String::new() } else { format!(" in {}", signal.unit) };
    let mut text = format!(
        "{}: {} gestures on channels {}{unit}, windows of {:.0} ms\n",
        person.name,
        person.gestures.len(),
        signal.channels.join(", "),
        1e3 * signal.window_samples as f64 / signal.sample_rate_hz
    );
    let prior = match learnt.prior_people {
        0 => "without other people".to_owned(),
        people => format!("with what {people} other people have in common"),
    };
    match learnt.update {
        Some(update) => text += &updated(update),
        None => {
            let _ = writeln!(text, "fitted in {:.2} s, {prior}", learnt.fit_s);
        }
    }
    text += &expected(&person.expected);
    text += &confusion(person);
    text += &channels(&person.channels);
    if !learnt.skipped.is_empty() {
        text += &format!("{}\n\n", left_out(learnt.skipped));
    }
    if let Some(CheckScores { before_by, before, after, after_by_gesture }) = learnt.check {
        let _ = write!(text, "check round: {:.1} % of the windows recognised", 100.0 * after);
        if let (Some(by), Some(before)) = (before_by, before) {
            let _ = write!(text, "; {by} recognises {:.1} %", 100.0 * before);
        }
        let shares =
            after_by_gesture.iter().map(|(gesture, share)| format!("{gesture} {:.0} %", 100.0 * share));
        let _ = writeln!(text, "\n  {}\n", shares.collect::<Vec<_>>().join(", "));
    }
    for finding in &learnt.findings {
        text += &format!("- {finding}\n");
    }
    text + &format!(
        "kept in {}\nnow: tendon run --person {}{}",
        learnt.file,
        person.name,
        options.base.typed()
    )
}

/// What an update changed, for people.
fn updated(UpdateScores { before, after, channels }: &UpdateScores) -> String {
    let mut text = format!(
        "updated to how rest and the gestures are now: of the windows of the update, {:.1} % were recognised before, and {:.1} \
         % are now (the update was made of them: --check asks for others)\n\n",
        100.0 * before,
        100.0 * after
    );
    let _ = writeln!(text, "{:<24} {:>12} {:>12}", "times the calibration's", "rest", "gestures");
    for ChannelShift { name, rest, gestures } in channels {
        let _ = writeln!(text, "{name:<24} {rest:>12.2} {gestures:>12.2}");
    }
    text + "\nwhat follows is of the calibration\n"
}

/// What can be expected, and what of, for people. The figures of moved electrodes are those of docs/person.md.
fn expected(Expected { accuracy, held_out, without_effort_share, if_alike, .. }: &Expected) -> String {
    let how = match (held_out, if_alike) {
        (HeldOut::Repetitions, _) => ": each repetition was recognised by a fit to the others".to_owned(),
        (HeldOut::MadeUpRepetitions, Some(if_alike)) => format!(
            " if the next repetitions differ from the only one as other people's do, {:.1} % if they are like it; repeat each \
             gesture to know",
            100.0 * if_alike
        ),
        (HeldOut::MadeUpRepetitions, None) => {
            " if the next repetitions differ from the only one as other people's do; repeat each gesture to know".to_owned()
        }
        (HeldOut::PartsOfOneRepetition, _) => {
            ", which is too much: there is one repetition only, and parts of it were recognised by a fit to the others; repeat \
             each gesture to know"
                .to_owned()
        }
    };
    let mut text = format!(
        "expected accuracy {:.1} %{how}\n\
         That is for now, with the electrodes as they are. Another day is usually lower: when the electrodes were moved by a tenth \
         of the way around the arm, fifteen people fell from 98 to 61 %, and --update brought them to 92 %.\n",
        100.0 * accuracy
    );
    if *without_effort_share > 0.0 {
        let _ = writeln!(
            text,
            "Not counted: {:.0} % of the windows of gestures, which are as weak as rest.",
            100.0 * without_effort_share
        );
    }
    text.push('\n');
    text
}

/// Percent of the windows of each gesture, by what they were recognised as.
fn confusion(person: &Person) -> String {
    let mut text = format!("{:<24}", "made \\ recognised, %");
    for gesture in &person.gestures {
        let _ = write!(text, " {:>10}", gesture.name);
    }
    text.push('\n');
    for (gesture, row) in person.gestures.iter().zip(&person.expected.confusion) {
        let _ = write!(text, "{:<24}", gesture.name);
        let windows = row.iter().sum::<usize>().max(1) as f64;
        for count in row {
            let _ = write!(text, " {:>10.1}", 100.0 * *count as f64 / windows);
        }
        text.push('\n');
    }
    text.push('\n');
    text
}

fn channels(channels: &[ChannelQuality]) -> String {
    let mut text =
        format!("{:<24} {:>12} {:>18} {:>10}\n", "channel", "SNR, dB", "mains at rest, %", "clipped, %");
    for quality in channels {
        let ChannelQuality { name, signal_to_noise_db, mains_share, clipped_share, .. } = quality;
        let (mains, clipped) = (100.0 * mains_share, 100.0 * clipped_share);
        let _ = writeln!(text, "{name:<24} {signal_to_noise_db:>12.1} {mains:>18.1} {clipped:>10.2}");
    }
    text.push('\n');
    text
}
