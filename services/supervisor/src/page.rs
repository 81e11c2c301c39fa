//! The page of a session in a browser: `tendon run --page`, and `tendon page` beside a session that runs.

use std::io::IsTerminal;
use std::net::{IpAddr, Ipv4Addr};
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use tendon_config::Config;
use tendon_process::{Answer, Next, PAGE_VARIABLE, PageKeys, Request};
use tendon_session::{ChildrenError, Companion, Event, Writer, become_owner};

use crate::Failure;
use crate::next::refusal;
use crate::running_session::RunningSession;

/// The program that serves the page. It lies beside this one.
pub const PROGRAM: &str = "tendon-page";
/// How long the page may take until it listens.
const THERE_TIMEOUT: Duration = Duration::from_secs(10);
/// Time between two looks whether it does.
const THERE_LOOK: Duration = Duration::from_millis(10);
/// What is said while it stays though nothing runs beside it.
const HELD: &str = "the page goes on from here; Ctrl-C ends it";
/// Time between two looks at it meanwhile.
const HOLD_LOOK: Duration = Duration::from_millis(200);
/// Where it listens unless told otherwise.
const PORT: u16 = 8423;

/// Where a page is, and what it allows.
#[derive(Clone, Debug, Args)]
struct PlaceOptions {
    /// Port of the page; 0 for any that is free.
    #[arg(long, value_name = "PORT", default_value_t = PORT)]
    page_port: u16,
    /// Address of this machine at which others may watch; they give no orders.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    page_address: IpAddr,
    /// Let nobody give orders on the page.
    #[arg(long)]
    page_watch_only: bool,
    /// Do not open the page in the browser.
    #[arg(long)]
    no_browser: bool,
}

impl PlaceOptions {
    /// Those of the page's program, in place of the page `before` if there was one.
    fn arguments(&self, before: Option<&PageKeys>) -> Vec<String> {
        let port = before.map_or(self.page_port, |before| before.address.port());
        let mut arguments = vec![format!("--port={port}"), format!("--address={}", self.page_address)];
        arguments.extend(self.page_watch_only.then(|| "--watch-only".to_owned()));
        let opens_browser = before.is_none() && !self.no_browser && has_screen();
        arguments.extend(opens_browser.then(|| "--browser".to_owned()));
        arguments
    }
}

/// The options of `tendon run` and `tendon calibrate` that concern the page.
#[derive(Debug, Args)]
#[command(mut_group("PlaceOptions", |group| group.requires("page")))]
pub struct RunOptions {
    /// Show the session in a browser: prints an address with a token, which is the key to it.
    #[arg(long)]
    pub page: bool,
    #[command(flatten)]
    place: PlaceOptions,
}

impl RunOptions {
    /// Whether somebody at the page can give orders.
    pub fn takes_orders(&self) -> bool {
        self.page && !self.place.page_watch_only
    }

    /// The options again, a word each.
    pub fn words(&self) -> Vec<String> {
        if !self.page {
            return Vec::new();
        }
        let PlaceOptions { page_port, page_address, page_watch_only, no_browser } = self.place;
        let mut words = vec![
            "--page".to_owned(),
            format!("--page-port={page_port}"),
            format!("--page-address={page_address}"),
        ];
        words.extend(page_watch_only.then(|| "--page-watch-only".to_owned()));
        words.extend(no_browser.then(|| "--no-browser".to_owned()));
        words
    }
}

/// The page beside a session of this process.
#[derive(Debug)]
pub struct Page {
    companion: Companion,
    /// Empty before it listens.
    keys: Arc<OnceLock<PageKeys>>,
}

impl Page {
    /// Starts the page, in place of the one `before` if there was one.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when its program cannot be started.
    pub fn start(
        options: &RunOptions,
        config: &Config,
        before: Option<&PageKeys>,
        standard_error: &Writer,
    ) -> Result<Page, ChildrenError> {
        let arguments = options.place.arguments(before);
        // It is made of texts.
        let before = before.and_then(|before| serde_json::to_string(before).ok());
        let (keys, errors) = (Arc::new(OnceLock::new()), standard_error.clone());
        let heard = keys.clone();
        let on_said = move |line: &str| {
            let Ok(keys) = serde_json::from_str::<PageKeys>(line) else { return };
            let (orders, watch) = keys.links();
            orders.into_iter().for_each(|link| errors.say(format!("page: {link}")));
            errors.say(format!("page, to watch only: {watch}"));
            // It says so once.
            let _ = heard.set(keys);
        };
        let before = before.as_deref();
        let companion = Companion::start(PROGRAM, config, &arguments, before, on_said, standard_error)?;
        Ok(Page { companion, keys })
    }

    /// Says once that it has ended, if it has. Does not wait.
    pub fn look(&mut self) {
        self.companion.look();
    }

    /// Waits until it listens; whether it does. One whose port is taken never will.
    pub fn wait_until_there(&mut self) -> bool {
        let begun = Instant::now();
        while self.keys.get().is_none() && !self.companion.has_ended() && begun.elapsed() < THERE_TIMEOUT {
            std::thread::sleep(THERE_LOOK);
            self.look();
        }
        self.keys.get().is_some()
    }

    /// Keeps it up while nothing runs beside it, until somebody asks for what is to follow and `after` finds its command line, or
    /// somebody ends it.
    pub fn hold(
        &mut self,
        events: &Receiver<Event>,
        errors: &Writer,
        after: impl Fn(&Next) -> anyhow::Result<Vec<String>>,
    ) -> Option<Vec<String>> {
        errors.say(HELD);
        loop {
            match events.recv_timeout(HOLD_LOOK) {
                Ok(Event::Request(asked)) => {
                    let Request::Next(next) = &asked.request else { continue };
                    let after = after(next);
                    if !asked.is_waited_for() {
                        continue;
                    }
                    match after {
                        Ok(command_line) => {
                            asked.answer(&Answer::done("what was asked for begins"));
                            return Some(command_line);
                        }
                        Err(error) => asked.answer(&refusal(&error)),
                    }
                }
                Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return None,
                Ok(_) | Err(RecvTimeoutError::Timeout) => self.look(),
            }
        }
    }

    /// Where it is, once it listens.
    pub fn keys(&self) -> Option<&PageKeys> {
        self.keys.get()
    }
}

/// Whether somebody sits at a screen on which a browser can open.
fn has_screen() -> bool {
    let is_set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    std::io::stdout().is_terminal() && (is_set("DISPLAY") || is_set("WAYLAND_DISPLAY"))
}

/// Command line of `tendon page`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    session: RunningSession,
    #[command(flatten)]
    place: PlaceOptions,
}

/// Goes on as the program that serves the page.
pub fn serve(options: &Options) -> Result<(), Failure> {
    let session = &options.session;
    if let Some(user) = session.user()? {
        become_owner(&session.name, Some(user)).map_err(Failure::input)?;
    }
    let own =
        std::env::current_exe().context("cannot find this program's folder").map_err(Failure::running)?;
    let error = Command::new(own.with_file_name(PROGRAM))
        .env_remove(PAGE_VARIABLE)
        .args(["--session", session.name.to_string().as_str()])
        .args(options.place.arguments(None))
        .exec();
    Err(Failure::running(anyhow::Error::new(error).context(format!("cannot start {PROGRAM}"))))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use crate::Arguments;

    #[test]
    fn what_concerns_the_page_of_a_session_needs_one() {
        for (line, is_fine) in [
            ("tendon run", true),
            ("tendon run --page --page-port 0 --no-browser", true),
            ("tendon run --page-port 0", false),
            ("tendon run --no-browser", false),
            ("tendon calibrate anna --page-watch-only", false),
            ("tendon page --page-port 0 --no-browser", true),
        ] {
            assert_eq!(Arguments::try_parse_from(line.split(' ')).is_ok(), is_fine, "{line}");
        }
    }
}
