//! The page of a session: shows it in a browser, and passes on orders and requests. `tendon run --page` and `tendon page` start it.
//!
//! ```text
//! topics ──looked at 30 times a second──▶ watching thread ─▶ View, Traces ─▶ Audience
//! browser ◀─ WebSocket ── server, one thread ◀─────────────────────────────────┘
//! browser ── orders, with the token ──▶ server ─▶ the robot's own socket
//! browser ── requests, with the token ▶ server ─▶ the supervisor's socket, and the recorder's for notes
//! browser ◀─ desk ── server ◀─ desk thread ◀─ the supervisor's status, asked for 5 to 20 times a second
//! ```
//! It is an observer: nobody waits for it, and its end is not the session's.
#![forbid(unsafe_code)]

mod access;
mod browser;
mod connections;
mod desk;
mod files;
mod orders;
mod requests;
mod server;
mod traces;
mod view;
mod watching;

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::Parser;
use listenfd::ListenFd;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use tendon_config::Config;
use tendon_process::{PAGE_VARIABLE, PageKeys, keep_off_the_stages_core};
use tendon_transport::SessionName;

use crate::access::Access;
use crate::browser::Signpost;
use crate::files::Files;
use crate::orders::Orders;
use crate::requests::Requests;
use crate::server::Page;
use crate::watching::{Audience, Watched};

/// How long orders that wait for the robot may hold up the end.
const END_TIMEOUT: Duration = Duration::from_millis(100);

/// Shows a session in a browser.
#[derive(Debug, Parser)]
#[command(version, name = "tendon-page")]
struct Arguments {
    /// Configuration of the session that starts this program.
    #[arg(long, value_name = "FILE", required_unless_present = "session")]
    config: Option<PathBuf>,
    /// Name of the session to wait for.
    #[arg(long, conflicts_with = "config")]
    session: Option<SessionName>,
    /// Give nobody the right to orders.
    #[arg(long)]
    watch_only: bool,
    /// Open the page in this machine's browser.
    #[arg(long)]
    browser: bool,
}

fn main() -> ExitCode {
    match serve(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tendon-page: error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn serve(arguments: &Arguments) -> anyhow::Result<()> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot handle signals")?;
    }
    let watched = match (&arguments.config, &arguments.session) {
        (Some(path), _) => Watched::Given(Box::new(Config::read(path)?)),
        (None, Some(name)) => Watched::Named(name.clone()),
        (None, None) => unreachable!("clap asks for one of the two"),
    };
    let listener = ListenFd::from_env().take_tcp_listener(0).context("cannot use the socket to listen at")?;
    let listener = listener.context("no socket to listen at: `tendon page` starts this program with one")?;
    listener.set_nonblocking(true).context("cannot listen without waiting")?;
    let address = listener.local_addr().context("cannot tell the page's address")?;
    let access = match page_before()? {
        Some(before) => Access::again(address, arguments.watch_only, before),
        None => Access::new(address, arguments.watch_only).context("no random numbers for a token")?,
    };
    let keys = access.keys();
    let audience = Arc::new(Audience::new());
    let session = watched.name().clone();
    let (orders, requests) = (Orders::new(session.clone()), Requests::new(session.clone()));
    let files = Files::new().context("cannot compress the page")?;
    let page = Arc::new(Page::new(access, files, audience.clone(), orders, requests));
    // Before any other thread begins.
    keep_off_the_stages_core();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
        .context("cannot serve")?;
    let (ended, end) = tokio::sync::oneshot::channel();
    let asking = (audience.clone(), stop.clone());
    let is_of_session = arguments.config.is_some();
    let (viewers, is_told_to_end) = (audience.clone(), stop.clone());
    start("desk", move || desk::follow(&session, &asking.0.desk, &asking.1))?;
    start("watching", move || {
        // Whoever waits for it is there until it comes.
        let _ = ended.send(watching::watch(&watched, &audience, &stop));
    })?;
    say(&keys, arguments.config.is_some())?;
    let _signpost = arguments.browser.then(|| open_browser(&keys)).flatten();
    let result = runtime.block_on(async {
        tokio::select! {
            served = server::serve(listener, page) => served.context("cannot serve"),
            end = async {
                let end = end.await;
                // Its session tells this program to end. If nobody has, the session broke off, and viewers are to see that the
                // connection is gone; so they are where the session goes on without this program.
                if is_of_session && is_told_to_end.load(Ordering::Relaxed) {
                    viewers.say_goodbye().await;
                }
                end
            } => end.context("the watching thread ended").flatten(),
        }
    });
    runtime.shutdown_timeout(END_TIMEOUT);
    result
}

/// The address and tokens of the page whose place this one takes.
fn page_before() -> anyhow::Result<Option<PageKeys>> {
    let Ok(text) = std::env::var(PAGE_VARIABLE) else { return Ok(None) };
    serde_json::from_str(&text).with_context(|| format!("{PAGE_VARIABLE} is set to no page: unset it"))
}

/// Says where the page is: to the session that started it, or to the person who did.
fn say(keys: &PageKeys, to_session: bool) -> anyhow::Result<()> {
    if to_session {
        let line = serde_json::to_string(keys).context("cannot say where the page is")?;
        return writeln!(std::io::stdout(), "{line}").context("cannot say where the page is");
    }
    let (orders, watch) = keys.links();
    if let Some(link) = orders {
        eprintln!("page: {link}");
    }
    eprintln!("page, to watch only: {watch}");
    Ok(())
}

/// Opens the page in the browser, if that can be.
fn open_browser(keys: &PageKeys) -> Option<Signpost> {
    let (orders, watch) = keys.links();
    let opened = browser::open(&orders.unwrap_or(watch));
    opened.inspect_err(|error| eprintln!("tendon-page: {error:#}")).ok()
}

fn start(name: &str, thread: impl FnOnce() + Send + 'static) -> anyhow::Result<()> {
    std::thread::Builder::new().name(name.to_owned()).spawn(thread).context("cannot start a thread")?;
    Ok(())
}
