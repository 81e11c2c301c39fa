//! `tendon calibrate NAME` without recordings: the person follows cues, and the source records.
//!
//! ```text
//! options ─▶ claim the session ─▶ source alone ─▶ round of cues ─▶ people/NAME/recordings/WHEN ─▶ fit ─▶ check round
//! ```

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use anyhow::{Context, anyhow, ensure};
use clap::Args;
use tendon_config::{Config, Gestures, Source};
use tendon_gesture::Gesture;
use tendon_guide::{Guide, GuideSettings};
use tendon_output::OutputFile;
use tendon_people::{People, Person};
use tendon_process::SignalDescription;
use tendon_provenance::Provenance;
use tendon_recordings::{RecordedSession, Recorder};
use tendon_session::{AcquisitionWatch, Event, Keyboard, Keys, RobotLine, Writer, stop_on_signals};
use tendon_transport::{Leftovers, SessionLock};

use super::board::StatusBoard;
use super::check::{CheckRound, CheckScores};
use super::learnt::PageReport;
use super::page::CalibrationPage;
use super::recording::Recording;
use super::round::{Attendance, Live, RoundEnd};
use super::status::{CalibrationStatus, Phase};
use super::{Fitted, Selection, fit, report, update};
use crate::channels::ask_for;
use crate::next::Following;
use crate::personal::{WINDOWS, check_simulated, is_simulated, personal_windows};
use crate::times::duration;
use crate::{Failure, TERMINAL_TIMEOUT, checks};

/// What the keys do.
const KEYS: &str = "keys: Enter or space go on, r the last gesture again, q stop (what was recorded is kept)";

/// What can be said of a guided calibration.
#[derive(Debug, Args)]
pub struct GuidedOptions {
    /// Then ask for each gesture once more, and say how well it is recognised with the calibration, and by what was there
    /// without it.
    #[arg(long, conflicts_with = "from")]
    check: bool,
    /// Ask for this gesture alone, in place of what the recording of the calibration has of it. `rest` is 5 s of
    /// it, in place of all rest.
    #[arg(long, value_name = "GESTURE", conflicts_with_all = ["from", "gestures"])]
    pub(super) redo: Option<Gesture>,
    /// Correct the person for a new day or electrodes that sit a little differently: a few seconds of rest and of each
    /// gesture (18 s for five gestures) move the person by the step that they show.
    #[arg(long, conflicts_with_all = ["from", "gestures", "repetitions", "redo", "replace"])]
    pub(super) update: bool,
    /// How long to rest at the beginning [default: 5s].
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    rest: Option<Duration>,
    /// How long each gesture is held [default: 5s].
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    hold: Option<Duration>,
    /// How long to rest before each gesture [default: 4s].
    #[arg(long, value_name = "TIME", value_parser = duration, conflicts_with = "from")]
    pause: Option<Duration>,
}

impl GuidedOptions {
    /// The times again, a word each.
    pub fn times(&self) -> Vec<String> {
        let times = [("--rest", self.rest), ("--hold", self.hold), ("--pause", self.pause)];
        let given = times.into_iter().filter_map(|(option, time)| Some((option, time?)));
        given.map(|(option, time)| format!("{option}={}", humantime::format_duration(time))).collect()
    }
}

/// Guides a person through a calibration, fits and keeps them; gives what is to follow.
pub fn calibrate(
    options: &super::Options,
    people: &People,
    json: Option<&OutputFile>,
    begun: Provenance,
) -> Result<Option<Following>, Failure> {
    let plan = Plan::of(options, people).map_err(Failure::input)?;
    let session = plan.config.session.clone();
    let lock = SessionLock::take(&session).map_err(Failure::input)?;
    Leftovers::remove(&lock, &session);
    let kept = lock.keep_configuration(&session, &plan.config.to_toml()).map_err(Failure::input);
    let result = kept.and_then(|()| attend(plan, begun, json));
    Leftovers::remove(&lock, &session);
    result
}

/// Looks whether a calibration with these options could begin.
///
/// # Errors
///
/// Why not.
pub fn check(options: &super::Options, people: &People) -> anyhow::Result<()> {
    Plan::of(options, people).map(drop)
}

/// Carries out a calibration and says what came of it: on the terminal, and on the page, which stays until somebody goes on from
/// there or ends it.
fn attend(
    plan: Plan<'_>,
    begun: Provenance,
    json: Option<&OutputFile>,
) -> Result<Option<Following>, Failure> {
    let Plan { options, .. } = plan;
    let config = plan.config.clone();
    checks::shared_memory(&config).map_err(Failure::input)?;
    let errors = Writer::standard_error().map_err(Failure::running)?;
    let robot = RobotLine::default();
    let (sender, events) = channel();
    stop_on_signals(&robot, &sender).context("cannot handle signals").map_err(Failure::running)?;
    let status = CalibrationStatus::new(options.name.clone(), plan.guide.repetitions);
    let board = StatusBoard::open(status, &config, &sender).map_err(Failure::input)?;
    let has_keys = Keyboard::is_there();
    let keyboard = has_keys.then(|| Keyboard::listen(&robot, &sender, Keys::Guide));
    let keyboard = keyboard.transpose().context("keys").map_err(Failure::input)?;
    let mut page = CalibrationPage::start(options, &config, &errors)?;
    let has_page = page.is_some() && options.page.takes_orders();
    let attendance = Attendance { has_keys, has_page };
    let place = Place { errors: &errors, board: &board, robot: &robot, sender: &sender, events: &events };
    let learnt = plan.carry_out(begun, &place, attendance);
    show_end(&board, &learnt);
    errors.end_live();
    let _ = errors.finish(TERMINAL_TIMEOUT);
    let result = learnt.and_then(|learnt| match learnt {
        Some(Learnt { fitted, file, check, begun }) => {
            report(options, &fitted, &file, check.as_ref(), begun, json)
        }
        None => Ok(()),
    });
    let Some(page) = page.as_mut().filter(|_| !robot.is_ending()) else { return result.map(|()| None) };
    let result = result.map_err(|Failure { error, exit_code }| {
        errors.say(format!("tendon: error: {error:#}"));
        Failure { error: anyhow!("{} was not calibrated, as said above", options.name), exit_code }
    });
    let following = page.hold(options, &config, &events);
    drop(keyboard);
    let _ = errors.finish(TERMINAL_TIMEOUT);
    following.map_or_else(|| result.map(|()| None), |following| Ok(Some(following)))
}

/// A calibration as it is asked for. Nothing of it has begun.
struct Plan<'a> {
    options: &'a super::Options,
    people: &'a People,
    config: Config,
    guide: GuideSettings,
    /// The person who is to be updated.
    updated: Option<Person>,
    /// What a gesture is added to.
    redone: Option<Recording>,
}

impl Plan<'_> {
    /// What these options ask for.
    fn of<'a>(options: &'a super::Options, people: &'a People) -> anyhow::Result<Plan<'a>> {
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

    /// Starts the source and follows the person. Gives nothing if somebody said stop.
    fn carry_out(
        self,
        begun: Provenance,
        place: &Place<'_>,
        attendance: Attendance,
    ) -> Result<Option<Learnt>, Failure> {
        let Plan { options, people, config, guide, updated, redone } = self;
        let source = checks::source(&config).map_err(Failure::input)?;
        let recording = redone.map_or_else(
            || Recording::new((people, &options.name), updated.is_some(), &config, &source, &begun),
            Ok,
        );
        let recording = recording.map_err(Failure::input)?;
        let updated = updated.as_ref();
        let calibration = Calibration { options, people, config: &config, guide, begun, updated };
        let channels = recording.session().channels.clone();
        with_source(&config, &channels, place, attendance, |live, signal| {
            let recording = recording.of_signal(signal).map_err(Failure::input)?;
            calibration.follow(live, recording, place.errors)
        })
    }
}

/// Shows what came of a calibration.
fn show_end(board: &StatusBoard, learnt: &Result<Option<Learnt>, Failure>) {
    board.change(|status| match learnt {
        Ok(Some(Learnt { fitted, file, check, .. })) => {
            status.rest_in(Phase::Done);
            status.report = Some(PageReport::of(&fitted.person, check.as_ref(), file));
        }
        Ok(None) => status.rest_in(Phase::Stopped),
        Err(failure) => {
            status.rest_in(Phase::Failed);
            status.error = Some(failure.reason());
        }
    });
}

/// A calibration that is under way.
struct Calibration<'a> {
    options: &'a super::Options,
    people: &'a People,
    config: &'a Config,
    guide: GuideSettings,
    begun: Provenance,
    /// The person who is to be updated.
    updated: Option<&'a Person>,
}

/// What came of it.
struct Learnt {
    fitted: Fitted,
    file: PathBuf,
    check: Option<CheckScores>,
    begun: Provenance,
}

impl Calibration<'_> {
    /// Cues, fit, check round. Gives nothing if somebody said stop.
    fn follow(
        self,
        live: &mut Live<'_>,
        recording: Recording,
        errors: &Writer,
    ) -> Result<Option<Learnt>, Failure> {
        let Calibration { options, people, config, .. } = self;
        let name = &options.name;
        // A source that never gives a sample leaves no folder behind.
        if live.wait_for_samples()? == RoundEnd::Stopped {
            errors.say("stopped before the first sample: nothing was recorded");
            return Ok(None);
        }
        let mut recorder = recording.begin()?;
        let folder = recorder.folder().to_owned();
        let mut guide = Guide::new(self.guide.clone(), config.acquisition.sample_rate_hz);
        let seconds = self.guide.duration_s();
        errors.say(format!("calibration of {name}: {seconds:.0} s, recorded in {}", folder.display()));
        let end = live.round(Phase::Cues, &mut guide, &mut recorder);
        if !matches!(end, Ok(RoundEnd::Done)) {
            errors.say(self.left_over(&recorder));
        }
        if end? == RoundEnd::Stopped {
            return Ok(None);
        }
        if let Some(gesture) = options.guided.redo {
            recorder.forget_earlier(gesture).map_err(Failure::running)?;
        }
        drop(recorder);
        let paths = [folder.clone()];
        let begun = self.begun.with_recording(&paths).map_err(Failure::running)?;
        let clipped_shares = live.clipped_shares();
        let selection = Selection { paths: &paths, repetitions: None, gestures: &[] };
        let fitted = live.meanwhile(|| match self.updated {
            Some(person) => update::update(person, config, &folder, &begun),
            None => fit(options, config, &selection, &clipped_shares, &begun),
        })?;
        let fitted = fitted
            .with_context(|| format!("the recording stays in {}", folder.display()))
            .map_err(Failure::running)?;
        let before = people.find(name).ok();
        if let Some(serious) = fitted.serious() {
            // With somebody of this name, --redo is about their recording.
            let remedy = if before.is_some() && options.guided.redo.is_none() {
                format!("{name} stays as before; calibrate again with --replace")
            } else {
                format!("record one gesture again with `tendon calibrate {name} --redo GESTURE`")
            };
            return Err(Failure::running(anyhow!(
                "{name} is not kept: {serious}. The recording stays in {}: {remedy}",
                folder.display()
            )));
        }
        if options.guided.redo.is_some() {
            check_gestures(before.as_ref(), &fitted.person, &folder).map_err(Failure::running)?;
        }
        if self.updated.is_some() && !live.spoilt().is_empty() {
            let spoilt: Vec<String> = live.spoilt().iter().map(ToString::to_string).collect();
            return Err(Failure::running(anyhow!(
                "{name} is not updated and stays as it was, because of {}: mend what was said of it, and update again",
                spoilt.join(", ")
            )));
        }
        let file = people.replace(&fitted.person).map_err(Failure::running)?;
        let check = if options.guided.check {
            errors.say("check round: each gesture once more");
            let round = CheckRound { config, guide: &self.guide, before: before.as_ref() };
            round.run(live, &fitted.person, &folder, errors)?
        } else {
            None
        };
        Ok(Some(Learnt { fitted, file, check, begun }))
    }

    /// What is there of a calibration that did not come to its end, and how to go on with it.
    fn left_over(&self, recorder: &Recorder) -> String {
        let (name, folder) = (&self.options.name, recorder.folder().display());
        if self.updated.is_some() {
            return format!("{name} stays as before: update again");
        }
        if recorder.trials().is_empty() {
            return format!("this was before the end of the first gesture; what was recorded is in {folder}");
        }
        let replace = if self.people.file_of(name).exists() { " --replace" } else { "" };
        format!("what was recorded is kept; to fit it: tendon calibrate {name} --from {folder}{replace}")
    }
}

/// The configuration of the source, with a person's windows; a simulated person follows the cues.
fn configuration(options: &super::Options) -> anyhow::Result<Config> {
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
    options: &super::Options,
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

/// Refuses to take gestures from a person who has them: the newest recording was broken off, or is of fewer gestures.
fn check_gestures(before: Option<&Person>, fitted: &Person, folder: &Path) -> anyhow::Result<()> {
    let Some(before) = before else { return Ok(()) };
    let now = fitted.gesture_set();
    let lost: Vec<String> = before
        .gesture_set()
        .iter()
        .filter(|gesture| now.number(*gesture).is_none())
        .map(|gesture| gesture.to_string())
        .collect();
    ensure!(
        lost.is_empty(),
        "{} stays as it was: {} is not in the recording {}. Calibrate all gestures anew with --replace",
        before.name,
        lost.join(", "),
        folder.display()
    );
    Ok(())
}

/// What a calibration runs in.
struct Place<'a> {
    errors: &'a Writer,
    board: &'a StatusBoard,
    robot: &'a RobotLine,
    sender: &'a Sender<Event>,
    events: &'a Receiver<Event>,
}

/// Starts the source, lets `work` follow it, and stops it. Gives nothing if somebody said stop before.
fn with_source<T>(
    config: &Config,
    channels: &[String],
    place: &Place<'_>,
    attendance: Attendance,
    work: impl FnOnce(&mut Live<'_>, Option<SignalDescription>) -> Result<Option<T>, Failure>,
) -> Result<Option<T>, Failure> {
    let Place { errors, board, robot, sender, events } = *place;
    let mut acquisition =
        AcquisitionWatch::start(config, robot, (sender, events), errors).map_err(Failure::input)?;
    let ready = acquisition
        .wait_until_ready()
        .map_err(|error| if error.is_input() { Failure::input(error) } else { Failure::running(error) })?;
    let Some(ready) = ready else { return Ok(None) };
    errors.say(ready.detail);
    if attendance.has_keys {
        errors.say(KEYS);
    }
    let channels = ready.signal.as_ref().map_or(channels, |signal| &signal.channels);
    let mut live = Live::new(acquisition, config, channels, (errors, board), attendance)?;
    let done = work(&mut live, ready.signal);
    let stopped = live.stop();
    done.and_then(|done| stopped.map(|()| done))
}
