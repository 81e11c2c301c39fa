//! `tendon latency`: shows the latencies of a running session.

use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use tendon_observer::{Observer, ObserverError};
use tendon_report::running_table;
use tendon_session::become_owner;

use crate::Failure;
use crate::output::{print, print_while_read};
use crate::running_session::RunningSession;
use crate::times::duration;

/// Time between two looks at what the stages say.
const TICK: Duration = Duration::from_millis(50);

/// Command line of `tendon latency`.
#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    session: RunningSession,
    /// Time between two tables.
    #[arg(long, value_parser = duration, default_value = "1s")]
    interval: Duration,
    /// Stop after this long; without it, on Ctrl-C or when the session ends.
    #[arg(long, value_parser = duration)]
    duration: Option<Duration>,
}

/// Shows the latencies since it was started, again and again.
pub fn show(options: &Options) -> Result<(), Failure> {
    let session = &options.session;
    become_owner(&session.name, session.user()?).map_err(Failure::input)?;
    let observer = Observer::join(&session.name, "latency").map_err(|error| match error {
        ObserverError::Find(_) => Failure::input(error),
        _ => Failure::running(error),
    })?;
    watch(options, observer).map_err(Failure::running)
}

fn watch(options: &Options, mut observer: Observer) -> anyhow::Result<()> {
    let (sender, stop) = std::sync::mpsc::channel();
    let mut signals =
        signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP]).context("cannot handle signals")?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || signals.forever().next().map(|_| sender.send(())))
        .context("cannot start a thread")?;
    let begun = Instant::now();
    let mut shown = begun;
    while stop.recv_timeout(TICK).is_err() {
        observer.gather(|_| {})?;
        if shown.elapsed() >= options.interval {
            shown = Instant::now();
            let is_read =
                print_while_read(running_table(begun.elapsed(), observer.measurements()).trim_end())?;
            if !observer.is_running() {
                print(format_args!("session `{}` has ended", options.session.name))?;
                break;
            }
            if !is_read {
                break;
            }
        }
        if options.duration.is_some_and(|duration| begun.elapsed() >= duration) {
            break;
        }
    }
    Ok(())
}
