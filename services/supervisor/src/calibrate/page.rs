//! The page of a calibration, which stays when it is over.
//!
//! ```text
//! done, failed or stopped ─▶ hold ─── next: session ──▶ the run from which the page came, or one with the same settings
//!                             │  └─── next: calibrate ▶ the same calibration for somebody else, or once more
//!                             └────── Ctrl-C, q ──────▶ the end
//! ```

use std::sync::mpsc::Receiver;

use tendon_config::Config;
use tendon_process::{Next, NextCalibration};
use tendon_session::{Event, Writer};

use super::next::command_line;
use super::options::Options;
use crate::Failure;
use crate::next::{Following, Handover, session_after, session_again, strategy_of};
use crate::page::Page;

/// The page, which listens.
#[derive(Debug)]
pub struct CalibrationPage {
    page: Page,
    /// The command line of the session to which the page leads back; the program's name comes first.
    run: Vec<String>,
    errors: Writer,
}

impl CalibrationPage {
    /// Starts the page if it is asked for. Gives none if it cannot listen, which it has said then: the calibration goes on without.
    pub fn start(
        options: &Options,
        config: &Config,
        errors: &Writer,
    ) -> Result<Option<CalibrationPage>, Failure> {
        if !options.page.page {
            return Ok(None);
        }
        let received = Handover::received().map_err(Failure::input)?;
        let Some(page) =
            Page::start(&options.page, config, received.as_ref(), errors).map_err(Failure::running)?
        else {
            return Ok(None);
        };
        let run = received.map_or_else(|| session_with_the_same_settings(options), |handover| handover.run);
        let is_there = page.wait_until_there();
        Ok(is_there.then(|| CalibrationPage { page, run, errors: errors.clone() }))
    }

    /// Keeps the page as it is until somebody goes on from there, or ends it.
    pub fn hold(
        &mut self,
        options: &Options,
        config: &Config,
        events: &Receiver<Event>,
    ) -> Option<Following> {
        let CalibrationPage { page, run, errors } = self;
        let after = |next: &Next| match next {
            Next::Session(next) => {
                // Of one whose person is gone, the configuration's: another person is asked for.
                let strategy = strategy_of(run).unwrap_or(config.decision.strategy);
                session_after(run, strategy, next)
            }
            Next::Back => session_again(run),
            Next::Calibrate(wanted) => command_line(
                &as_before(wanted, options),
                (&options.base, config),
                &options.page,
                &options.guided.times(),
            ),
        };
        let command_line = page.hold(events, errors, after)?;
        let session = config.session.clone();
        let handover = Handover {
            page: page.keys().cloned(),
            run: run.clone(),
            is_recorded: false,
            session,
            socket: Some(page.socket().clone()),
        };
        Some(Following { command_line, handover })
    }
}

/// What is asked for after the calibration of `before`: of the same person, where nothing is said of what there is of them, that
/// is taken as it was.
fn as_before(wanted: &NextCalibration, before: &Options) -> NextCalibration {
    let mut wanted = wanted.clone();
    let says_nothing = wanted.redo.is_none() && !wanted.update && !wanted.replace;
    if says_nothing && wanted.name == before.name.to_string() {
        (wanted.redo, wanted.update, wanted.replace) =
            (before.guided.redo, before.guided.update, before.replace);
        // An update asks for each gesture as often as it needs.
        wanted.repetitions = wanted.repetitions.filter(|_| !wanted.update);
    }
    wanted
}

/// A session of the source and with the settings of this calibration.
fn session_with_the_same_settings(options: &Options) -> Vec<String> {
    let run = ["tendon", "run"].map(str::to_owned).into_iter();
    run.chain(options.base.words()).chain(options.page.words()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Command;
    use crate::next::read;

    #[test]
    fn the_same_person_again_takes_the_place_of_who_is_there_as_before() {
        let after = |line: &str, name: &str| {
            let words: Vec<String> = line.split(' ').map(str::to_owned).collect();
            let Ok(Command::Calibrate(before)) = read(&words) else { panic!("{line}") };
            let wanted =
                NextCalibration { name: name.to_owned(), repetitions: Some(1), ..NextCalibration::default() };
            as_before(&wanted, &before)
        };
        assert!(after("tendon calibrate anna --replace", "anna").replace);
        assert!(!after("tendon calibrate anna --replace", "bert").replace);
        assert!(!after("tendon calibrate anna", "anna").replace);
        let update = after("tendon calibrate anna --update", "anna");
        assert_eq!((update.update, update.repetitions), (true, None));
        assert_eq!(
            after("tendon calibrate anna --redo grip", "anna").redo,
            Some(tendon_gesture::Gesture::GRIP)
        );
    }
}
