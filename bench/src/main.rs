//! Measures what Tendon's design promises, in one run on one machine: hops beside their peers, live sessions,
//! the stages' work alone, and replay at full speed.
//!
//! ```text
//! bench ─┬─ hop ────▶ send ──200 messages/s──▶ receive (one a lane)     idle, then beside `busy`, one a core
//!        ├─ live ───▶ tendon run --duration …
//!        ├─ work ───▶ in this process
//!        ├─ replay ─▶ tendon run --config …
//!        └─ replays ▶ tendon run --config … (500 times, three at a time; only when asked for)
//! ```
//!
//! `send`, `receive` and `busy` are this same program. Numbers of a shared machine vary
//! from run to run; what is compared is measured in turns within one run.
#![forbid(unsafe_code)]
#![allow(clippy::print_stdout)]

mod busy;
mod child;
mod emg;
mod hop;
mod live;
mod replay;
mod replays;
mod session;
mod transports;
mod work;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::{Parser, Subcommand};
use nix::sys::prctl::set_pdeathsig;
use nix::sys::signal::Signal;
use serde::Serialize;
use tendon_report::LatencySummary;

/// Measures hops beside their peers, the stages' work alone, and replay at full speed.
#[derive(Debug, Parser)]
#[command(name = "bench", version)]
struct Arguments {
    /// What to measure; everything when left out.
    #[command(subcommand)]
    command: Option<Command>,
    /// Seconds of messages for every row of the hop table, and of every live session.
    #[arg(long, default_value_t = 10.0, global = true)]
    seconds: f64,
    /// Messages a second.
    #[arg(long, default_value_t = 200.0, global = true)]
    rate_hz: f64,
    /// Writes the results there as JSON, too.
    #[arg(long, value_name = "FILE", global = true)]
    json: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Publish to receive between two processes, beside bare iceoryx2, a Unix socket and ZeroMQ.
    Hop,
    /// Live sessions of all stages: idle, saturated, with and without real-time scheduling.
    Live,
    /// The stages' work alone: no transport, no other process.
    Work,
    /// A recording of a minute through `tendon run`, as fast as it goes.
    Replay,
    /// The same recording again and again, several at a time: all must end with the same result.
    Replays(replays::ReplaysArguments),
    #[command(hide = true)]
    Send(hop::SendArguments),
    #[command(hide = true)]
    Receive(hop::ReceiveArguments),
    #[command(hide = true)]
    Busy { core: usize },
}

/// All results, as `--json` writes them.
#[derive(Debug, Serialize)]
struct Report {
    cores: usize,
    /// 1 min load average before the first measurement: what else ran on the machine.
    load_average: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    hop: Option<hop::HopReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    live: Option<Vec<live::Live>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    work: Option<Vec<work::Work>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    replay: Option<replay::Replay>,
    #[serde(skip_serializing_if = "Option::is_none")]
    replays: Option<replays::Replays>,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bench: error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(Command::Send(_) | Command::Receive(_) | Command::Busy { .. }) = &arguments.command {
        // However the parent ends, nothing it started goes on.
        set_pdeathsig(Signal::SIGKILL).context("cannot ask to end with the parent")?;
    }
    match &arguments.command {
        Some(Command::Send(send)) => return hop::send(send),
        Some(Command::Receive(receive)) => return hop::receive(receive),
        Some(Command::Busy { core }) => busy::spin(*core),
        _ => {}
    }
    let is_chosen = |choice: fn(&Command) -> bool| arguments.command.as_ref().is_none_or(choice);
    let load_average = load_average()?;
    let cores = std::thread::available_parallelism().context("cannot count the cores")?.get();
    println!("{cores} cores, load average {load_average:.2}");
    if load_average > 0.5 {
        println!("Other programs are running: only what is compared within this run means something.");
    }
    let report = Report {
        cores,
        load_average,
        work: is_chosen(|command| matches!(command, Command::Work))
            .then(|| work::measure(cores))
            .transpose()?,
        replay: is_chosen(|command| matches!(command, Command::Replay))
            .then(|| replay::measure(cores))
            .transpose()?
            .flatten(),
        replays: match &arguments.command {
            Some(Command::Replays(replays)) => Some(replays::measure(*replays)?),
            _ => None,
        },
        live: is_chosen(|command| matches!(command, Command::Live))
            .then(|| live::measure(arguments.seconds, cores))
            .transpose()?
            .flatten(),
        hop: is_chosen(|command| matches!(command, Command::Hop))
            .then(|| hop::measure(arguments.seconds, arguments.rate_hz))
            .transpose()?,
    };
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&report).context("cannot write the results as JSON")?;
        std::fs::write(path, text + "\n").with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

fn load_average() -> anyhow::Result<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").context("cannot read /proc/loadavg")?;
    text.split(' ').next().and_then(|first| first.parse().ok()).context("/proc/loadavg has no number")
}

/// The columns of every table of durations, and a row of it; both in µs.
const COLUMNS: &str = "   count       p50       p99     p99.9       max  µs";

fn columns(summary: &LatencySummary) -> String {
    let LatencySummary { count, p50_us, p99_us, p999_us, max_us } = summary;
    format!("{count:8} {p50_us:9.2} {p99_us:9.2} {p999_us:9.2} {max_us:9.2}")
}
