//! `tendon calibrate NAME` without recordings: the person follows cues, and the source records.
//!
//! ```text
//! options ─▶ claim the session ─▶ source alone ─▶ round of cues ─▶ people/NAME/recordings/WHEN ─▶ fit ─▶ check round
//! ```

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};

use anyhow::{Context, anyhow, ensure};
use tendon_config::Config;
use tendon_guide::{Guide, GuideSettings};
use tendon_output::OutputFile;
use tendon_people::{People, Person};
use tendon_process::SignalDescription;
use tendon_provenance::Provenance;
use tendon_recordings::Recorder;
use tendon_session::{AcquisitionWatch, Event, Keyboard, Keys, RobotLine, Writer, stop_on_signals};
use tendon_transport::{Leftovers, SessionLock};

use super::board::StatusBoard;
use super::check::CheckRound;
use super::fit::{Fitted, Selection, fit};
use super::learnt::PageReport;
use super::options::Options;
use super::page::CalibrationPage;
use super::plan::Plan;
use super::recording::Recording;
use super::report::report;
use super::round::{Attendance, Live, RoundEnd};
use super::scores::CheckScores;
use super::status::{CalibrationStatus, Phase};
use super::update;
use crate::next::Following;
use crate::{Failure, TERMINAL_TIMEOUT, checks};

/// What the keys do.
const KEYS: &str = "keys: Enter or space go on, r the last gesture again, q stop (what was recorded is kept)";

/// Guides a person through a calibration, fits and keeps them; gives what is to follow.
pub fn calibrate(
    options: &Options,
    people: &People,
    json: Option<&OutputFile>,
    begun: Provenance,
) -> Result<Option<Following>, Failure> {
    let plan = Plan::of(options, people).map_err(Failure::input)?;
    let session = plan.config.session.clone();
    let lock = SessionLock::take(&session).map_err(Failure::input)?;
    Leftovers::remove(&lock);
    let kept = lock.keep_configuration(&plan.config.to_toml()).map_err(Failure::input);
    let result = kept.and_then(|()| attend(plan, begun, json));
    Leftovers::remove(&lock);
    result
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
    let learnt = carry_out(plan, begun, &place, attendance);
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

/// Starts the source and follows the person. Gives nothing if somebody said stop.
fn carry_out(
    plan: Plan<'_>,
    begun: Provenance,
    place: &Place<'_>,
    attendance: Attendance,
) -> Result<Option<Learnt>, Failure> {
    let Plan { options, people, config, guide, updated, redone } = plan;
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
    options: &'a Options,
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
