//! The page of a calibration, which stays when it is over.
//!
//! ```text
//! done, failed or stopped ─▶ hold ─── next: session ──▶ the run from which the page came, or one with the same settings
//!                             │  └─── next: calibrate ▶ the same calibration for somebody else, or once more
//!                             └────── Ctrl-C, q ──────▶ the end
//! ```

use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use anyhow::bail;
use tendon_config::Config;
use tendon_process::{Answer, Next, Request};
use tendon_session::{Event, Writer};

use super::Options;
use super::next::command_line;
use crate::next::{Following, Handover, read, session_after};
use crate::page::Page;
use crate::{Command, Failure};

/// What is said while the page shows what came of the calibration.
const HELD: &str = "the page goes on from here; Ctrl-C ends it";
/// Time between two looks at the page meanwhile.
const HOLD_LOOK: Duration = Duration::from_millis(200);

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
        let before = received.as_ref().and_then(|handover| handover.page.as_ref());
        let mut page = Page::start(&options.page, config, before, errors).map_err(Failure::running)?;
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
        self.errors.say(HELD);
        loop {
            match events.recv_timeout(HOLD_LOOK) {
                Ok(Event::Request(asked)) => {
                    let Request::Next(next) = &asked.request else { continue };
                    let after = self.after(options, config, next);
                    if !asked.is_waited_for() {
                        continue;
                    }
                    match after {
                        Ok(command_line) => {
                            asked.answer(&Answer::done("what was asked for begins"));
                            let handover =
                                Handover { page: self.page.keys().cloned(), run: self.run.clone() };
                            return Some(Following { command_line, handover });
                        }
                        Err(error) => asked.answer(&Answer::refused(format!("{error:#}"))),
                    }
                }
                Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return None,
                Ok(_) | Err(RecvTimeoutError::Timeout) => self.page.look(),
            }
        }
    }

    /// The command line of what is to follow.
    fn after(&self, options: &Options, config: &Config, next: &Next) -> anyhow::Result<Vec<String>> {
        match next {
            Next::Session(next) => {
                let Command::Run(run) = read(&self.run)? else { bail!("a session is what follows") };
                // Of one whose person is gone, the configuration's: another person is asked for.
                let strategy = run
                    .configuration()
                    .map_or(config.decision.strategy, |(config, _)| config.decision.strategy);
                session_after(&self.run, strategy, next)
            }
            Next::Calibrate(wanted) => {
                command_line(wanted, (&options.base, config), &options.page, &options.guided.times())
            }
        }
    }
}

/// A session of the source and with the settings of this calibration.
fn session_with_the_same_settings(options: &Options) -> Vec<String> {
    let run = ["tendon", "run"].map(str::to_owned).into_iter();
    run.chain(options.base.words()).chain(options.page.words()).collect()
}
