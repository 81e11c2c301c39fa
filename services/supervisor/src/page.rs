//! The page of a session in a browser: `tendon run --page`, and `tendon page` beside a session that runs.

use std::io::{ErrorKind, IsTerminal};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use nix::sys::socket::{Shutdown, shutdown};
use tendon_config::Config;
use tendon_process::{Answer, Next, PAGE_VARIABLE, PageKeys, Request, socket_variables};
use tendon_session::{BecomeOwnerError, ChildrenError, Companion, Event, Writer, become_owner};
use tendon_transport::FindError;

use crate::next::{Handover, refusal};
use crate::running_session::RunningSession;
use crate::{Failure, TERMINAL_TIMEOUT};

/// The program that serves the page. It lies beside this one.
pub const PROGRAM: &str = "tendon-page";
/// How long the page may take until it listens.
const THERE_TIMEOUT: Duration = Duration::from_secs(10);
/// Time between two looks whether it does.
const THERE_LOOK: Duration = Duration::from_millis(10);
/// What is said while it stays though nothing runs beside it.
const HELD: &str = "the page goes on from here; Ctrl-C ends it";
/// Time between two looks whether its program has ended.
const KEEP_LOOK: Duration = Duration::from_millis(200);
/// How often its program is started again.
const MOST_RESTARTS: u32 = 5;
/// Where its program finds its socket: it is its standard input.
const SOCKET_DESCRIPTOR: i32 = 0;
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
    /// Opens the socket where the page is to be.
    ///
    /// # Errors
    ///
    /// When it cannot be there; says what to do.
    fn listen(&self) -> anyhow::Result<TcpListener> {
        let address = SocketAddr::new(self.page_address, self.page_port);
        TcpListener::bind(address).map_err(|error| {
            let remedy = match error.kind() {
                ErrorKind::AddrInUse => {
                    "the port is taken: give another with --page-port, or 0 for any that is free"
                }
                ErrorKind::AddrNotAvailable => {
                    "this machine has no such address: give one of its own with --page-address"
                }
                _ => "give another with --page-address and --page-port",
            };
            anyhow::Error::new(error).context(format!("cannot listen at {address}; {remedy}"))
        })
    }

    /// Those of the page's program.
    fn arguments(&self, opens_browser: bool) -> Vec<String> {
        let watch_only = self.page_watch_only.then(|| "--watch-only".to_owned());
        let browser = (opens_browser && !self.no_browser && has_screen()).then(|| "--browser".to_owned());
        watch_only.into_iter().chain(browser).collect()
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

/// The page beside a session of this process. Its socket is this program's own: where the page's program ends, it is started again
/// there, and browsers find it.
#[derive(Debug)]
pub struct Page {
    socket: Arc<TcpListener>,
    /// Empty before it listens.
    keys: Arc<OnceLock<PageKeys>>,
    /// Starts the program, and again where it ends.
    keeper: Option<JoinHandle<()>>,
    is_over: Arc<AtomicBool>,
}

impl Page {
    /// Starts the page, in place of the one `before` if there was one. `None` if it cannot listen, which it has said then.
    ///
    /// # Errors
    ///
    /// [`ChildrenError`] when its program cannot be started.
    pub fn start(
        options: &RunOptions,
        config: &Config,
        before: Option<&Handover>,
        errors: &Writer,
    ) -> Result<Option<Page>, ChildrenError> {
        let socket = match before.and_then(|before| before.socket.clone()) {
            Some(socket) => socket,
            None => match options.place.listen() {
                Ok(socket) => Arc::new(socket),
                Err(error) => {
                    errors.say(format!("tendon: the session goes on without a page: {error:#}"));
                    return Ok(None);
                }
            },
        };
        let (keys, is_over) = (Arc::new(OnceLock::new()), Arc::new(AtomicBool::new(false)));
        let program = Program {
            config: config.clone(),
            place: options.place.clone(),
            socket: socket.clone(),
            keys: keys.clone(),
            errors: errors.clone(),
        };
        let first = program.start(before.and_then(|before| before.page.as_ref()))?;
        let over = is_over.clone();
        let keeper = std::thread::Builder::new().name("page".to_owned());
        // Without the thread the program ends at once: that is told as every page that does not listen.
        let keeper = keeper.spawn(move || program.keep(first, &over)).ok();
        Ok(Some(Page { socket, keys, keeper, is_over }))
    }

    /// Waits until it listens; whether it does.
    pub fn wait_until_there(&self) -> bool {
        let begun = Instant::now();
        let has_ended = || self.keeper.as_ref().is_none_or(JoinHandle::is_finished);
        while self.keys.get().is_none() && !has_ended() && begun.elapsed() < THERE_TIMEOUT {
            std::thread::sleep(THERE_LOOK);
        }
        self.keys.get().is_some()
    }

    /// Keeps it up while nothing runs beside it, until somebody asks for what is to follow and `after` finds its command line, or
    /// somebody ends it.
    pub fn hold(
        &self,
        events: &Receiver<Event>,
        errors: &Writer,
        after: impl Fn(&Next) -> anyhow::Result<Vec<String>>,
    ) -> Option<Vec<String>> {
        errors.say(HELD);
        loop {
            match events.recv() {
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
                Ok(Event::Stop) | Err(_) => return None,
                Ok(_) => {}
            }
        }
    }

    /// Where it is, once it listens.
    pub fn keys(&self) -> Option<&PageKeys> {
        self.keys.get()
    }

    /// Where it listens.
    pub fn socket(&self) -> &Arc<TcpListener> {
        &self.socket
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(keeper) = self.keeper.take() {
            keeper.thread().unpark();
            // It ends the program first.
            let _ = keeper.join();
        }
    }
}

/// The program that serves the page.
struct Program {
    config: Config,
    place: PlaceOptions,
    socket: Arc<TcpListener>,
    keys: Arc<OnceLock<PageKeys>>,
    errors: Writer,
}

impl Program {
    /// Starts it, in place of the page `before` if there was one.
    fn start(&self, before: Option<&PageKeys>) -> Result<Companion, ChildrenError> {
        let (heard, errors) = (self.keys.clone(), self.errors.clone());
        let on_said = move |line: &str| {
            let Ok(keys) = serde_json::from_str::<PageKeys>(line) else { return };
            let (orders, watch) = keys.links();
            // It is where it was if it was started again.
            if heard.set(keys).is_ok() {
                orders.into_iter().for_each(|link| errors.say(format!("page: {link}")));
                errors.say(format!("page, to watch only: {watch}"));
            }
        };
        let socket = self.socket.try_clone().map_err(ChildrenError::Socket)?;
        let mut environment = socket_variables(SOCKET_DESCRIPTOR).to_vec();
        // They are made of texts.
        let before_text = before.and_then(|before| serde_json::to_string(before).ok());
        environment.extend(before_text.map(|text| (PAGE_VARIABLE, text)));
        let arguments = self.place.arguments(before.is_none());
        let input = Stdio::from(OwnedFd::from(socket));
        Companion::start(PROGRAM, &self.config, &arguments, environment, input, on_said, &self.errors)
    }

    /// Starts it again where it ends, until `is_over`.
    fn keep(&self, mut running: Companion, is_over: &AtomicBool) {
        let mut restarts_left = MOST_RESTARTS;
        while !is_over.load(Ordering::Relaxed) {
            std::thread::park_timeout(KEEP_LOOK);
            let Some(status) = running.ended() else { continue };
            let again = self.keys.get().filter(|_| restarts_left > 0).map(|keys| self.start(Some(keys)));
            let Some(Ok(started)) = again else {
                self.errors
                    .say(format!("tendon: {PROGRAM} ended ({status}): the session goes on without it"));
                // Browsers are refused, and do not wait for somebody who takes their connections.
                let _ = shutdown(self.socket.as_raw_fd(), Shutdown::Both);
                return;
            };
            self.errors.say(format!("tendon: {PROGRAM} ended ({status}) and was started again"));
            (running, restarts_left) = (started, restarts_left - 1);
        }
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
    let user = session.user()?;
    match become_owner(&session.name, user) {
        Ok(()) => {}
        // It waits for a session of its own user.
        Err(BecomeOwnerError::Find(
            error @ (FindError::NotRunning { .. } | FindError::OtherOwner { .. }),
        )) if user.is_none() => {
            let errors = Writer::standard_error().map_err(Failure::running)?;
            errors.say(format!("tendon page: {error}. The page shows `{}` once it has begun", session.name));
            let _ = errors.finish(TERMINAL_TIMEOUT);
        }
        Err(error) => return Err(Failure::input(error)),
    }
    let own =
        std::env::current_exe().context("cannot find this program's folder").map_err(Failure::running)?;
    let socket = options.place.listen().map_err(Failure::input)?;
    let error = Command::new(own.with_file_name(PROGRAM))
        .env_remove(PAGE_VARIABLE)
        .envs(socket_variables(SOCKET_DESCRIPTOR))
        .stdin(OwnedFd::from(socket))
        .args(["--session", session.name.to_string().as_str()])
        .args(options.place.arguments(true))
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
