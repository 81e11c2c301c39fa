//! A session that somebody asked for at the page of another one, and that could not begin: the page says why.
//!
//! ```text
//! session ─ next ─▶ tendon run … ─┬─ runs
//!                                 └─ could not begin ─▶ show ─┬─ next ───▶ tendon run …, at the same page
//!                                                             └─ Ctrl-C ─▶ the end
//! ```

use std::sync::mpsc::channel;

use anyhow::{Context, anyhow};
use tendon_config::Config;
use tendon_process::{Asked, RequestSocket};
use tendon_session::{Event, RobotLine, Writer, stop_on_signals};
use tendon_transport::{Leftovers, SessionLock};

use crate::Failure;
use crate::desk::{Desk, DeskKind};
use crate::next::{Following, Handover, command_line_after, strategy_of};
use crate::page::{Page, RunOptions};

/// Shows why a session could not begin, if it was asked for at a page, until somebody there asks for something else; gives that.
///
/// # Errors
///
/// The failure itself where no page asked for the session, or somebody ends it.
pub fn show(failure: Failure, options: &RunOptions) -> Result<Option<Following>, Failure> {
    let Ok(Some(handover)) = Handover::received() else { return Err(failure) };
    // Where another program holds the session's name it has a page of its own, or none.
    let Ok(lock) = SessionLock::take(&handover.session) else { return Err(failure) };
    let errors = Writer::standard_error().map_err(Failure::running)?;
    errors.say(format!("tendon: error: {:#}", failure.error));
    // Of a configuration that could not be used the page needs the session's name alone.
    let config = Config { session: handover.session.clone(), ..Config::default() };
    lock.keep_configuration(&config.to_toml()).map_err(Failure::running)?;
    let following = hold(&failure, options, &config, handover, &errors);
    Leftovers::remove(&lock);
    let said_above = anyhow!("the session could not begin, as said above");
    following?.map_or(Err(Failure { error: said_above, ..failure }), |following| Ok(Some(following)))
}

fn hold(
    failure: &Failure,
    options: &RunOptions,
    config: &Config,
    handover: Handover,
    errors: &Writer,
) -> Result<Option<Following>, Failure> {
    let (sender, events) = channel();
    stop_on_signals(&RobotLine::default(), &sender)
        .context("cannot handle signals")
        .map_err(Failure::running)?;
    let mut desk = Desk::new(DeskKind::Failed, config);
    desk.can.next = true;
    desk.failed = Some(failure.reason());
    // Once nobody listens any more the request is dropped, which says so.
    let on_request = move |asked: Asked| drop(sender.send(Event::Request(asked)));
    let socket = RequestSocket::listen(&config.session, desk.text(), on_request).map_err(Failure::running)?;
    let Some(page) = Page::start(options, config, Some(&handover), errors).map_err(Failure::running)? else {
        return Ok(None);
    };
    let strategy = strategy_of(&handover.run).unwrap_or(config.decision.strategy);
    let after = |next: &_| command_line_after(&handover.run, strategy, next);
    let command_line = page.hold(&events, errors, after);
    drop(socket);
    Ok(command_line.map(|command_line| Following { command_line, handover }))
}
