//! `tendon latency`: looks on at a running session.

use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use clap::Args;
use signal_hook::consts::{SIGINT, SIGTERM};
use tendon_latency::{LatencySummary, SessionMeasurements};
use tendon_messages::{MEASUREMENTS, Stage};
use tendon_transport::{Delivery, Session, SessionLock, SessionLockError, SessionName, Subscriber};

use crate::Failure;

/// Time between two looks at what the stages say.
const TICK: Duration = Duration::from_millis(50);

/// Command line of `tendon latency`.
#[derive(Debug, Args)]
pub struct Options {
    /// Name of the session to look at.
    #[arg(long, default_value = "tendon")]
    session: SessionName,
    /// Time between two tables.
    #[arg(long, value_parser = humantime::parse_duration, default_value = "1s")]
    interval: Duration,
    /// Stop after this long; without it, on Ctrl-C or when the session ends.
    #[arg(long, value_parser = humantime::parse_duration)]
    duration: Option<Duration>,
}

/// Shows the latencies since it was started, again and again.
pub fn show(options: &Options) -> Result<(), Failure> {
    ensure_running(&options.session).map_err(Failure::input)?;
    watch(options).map_err(Failure::running)
}

fn ensure_running(session: &SessionName) -> anyhow::Result<()> {
    ensure!(
        is_running(session)?,
        "no session `{session}` is running: start it with `tendon run`, or name another with --session"
    );
    Ok(())
}

/// A session runs while a supervisor holds its lock.
fn is_running(session: &SessionName) -> anyhow::Result<bool> {
    match SessionLock::take(session) {
        Ok(_lock) => Ok(false),
        Err(SessionLockError::InUse { .. }) => Ok(true),
        Err(error) => Err(error.into()),
    }
}

fn watch(options: &Options) -> anyhow::Result<()> {
    let (sender, stop) = std::sync::mpsc::channel();
    let mut signals =
        signal_hook::iterator::Signals::new([SIGINT, SIGTERM]).context("cannot handle signals")?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || signals.forever().next().map(|_| sender.send(())))
        .context("cannot start a thread")?;
    let session = Session::join(&options.session, "latency")?;
    let mut measurements = Subscriber::open(&session, &MEASUREMENTS, None, Delivery::Live)?;
    let mut gathered = SessionMeasurements::default();
    let begun = Instant::now();
    let mut shown = begun;
    while stop.recv_timeout(TICK).is_err() {
        measurements.acknowledge_wakes()?;
        while let Some(batch) = measurements.receive()? {
            gathered.absorb(batch.header(), batch.payload());
        }
        if shown.elapsed() >= options.interval {
            shown = Instant::now();
            println!("{}", table(begun.elapsed(), &gathered));
            if !is_running(&options.session)? {
                println!("session `{}` has ended", options.session);
                break;
            }
        }
        if options.duration.is_some_and(|duration| begun.elapsed() >= duration) {
            break;
        }
    }
    Ok(())
}

fn table(elapsed: Duration, gathered: &SessionMeasurements) -> String {
    let mut lines = vec![format!(
        "{:>7.0} s looked on{:>24}{:>11}{:>11}{:>11}{:>11}",
        elapsed.as_secs_f64(),
        "messages",
        "p50",
        "p99",
        "p99.9",
        "max"
    )];
    let mut row = |name: String, latency: LatencySummary| {
        let LatencySummary { count, p50_us, p99_us, p999_us, max_us } = latency;
        lines.push(format!(
            "  {name:<32}{count:>9}{p50_us:>8.0} us{p99_us:>8.0} us{p999_us:>8.0} us{max_us:>8.0} us"
        ));
    };
    for stage in Stage::ALL {
        if let Some(upstream) = stage.upstream() {
            let name = format!("{} to {}", upstream.name(), stage.name());
            row(name, LatencySummary::of(gathered.transit(stage)));
        }
    }
    for stage in Stage::ALL {
        row(format!("{} (work)", stage.name()), LatencySummary::of(gathered.work(stage)));
    }
    row("newest sample to command".to_owned(), LatencySummary::of(&gathered.newest_sample_to_command));
    lines.join("\n")
}
