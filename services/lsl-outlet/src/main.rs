//! Gives what a session decides as streams of the Lab Streaming Layer, until the session ends. `tendon run --lsl-out` starts it.
//!
//! ```text
//! predictions ─┐                          ┌─▶ "Tendon SESSION predictions"   probabilities, efforts
//! commands ────┼─▶ Observer ─ as it comes ┼─▶ "Tendon SESSION commands"      twist, confidence
//! states ──────┘                          └─▶ "Tendon SESSION markers"       gestures, whether the arm may move
//! ```
//!
//! It observes, and nobody waits for it: not in a live session, and in no other one does it run. Time stamps are those of the
//! newest sample behind a message (of a state, of its publication), on LSL's clock, which is CLOCK_MONOTONIC.
#![forbid(unsafe_code)]

mod streams;

use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Parser;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use signal_hook::consts::{SIGINT, SIGTERM};
use tendon_config::Config;
use tendon_lsl::Lsl;
use tendon_messages::{COMMANDS, PREDICTIONS};
use tendon_observer::Observer;

use crate::streams::Streams;

/// Longest time between two looks at the states.
const TICK_MS: u8 = 50;
/// Time between two looks whether the session runs.
const SESSION_INTERVAL: Duration = Duration::from_secs(1);

/// Gives what a session decides as streams of the Lab Streaming Layer.
#[derive(Debug, Parser)]
#[command(version, name = "tendon-lsl-outlet")]
struct Arguments {
    /// Configuration of the session.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

fn main() -> ExitCode {
    match give(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tendon-lsl-outlet: error: {}", tendon_process::with_causes(error.as_ref()));
            ExitCode::FAILURE
        }
    }
}

fn give(arguments: &Arguments) -> anyhow::Result<()> {
    let config = Config::read(&arguments.config)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot handle signals")?;
    }
    let lsl = Lsl::load(&tendon_lsl::find_library(config.acquisition.lsl.library.as_deref())?)?;
    let mut streams = Streams::open(lsl, &config)?;
    let mut observer = Observer::join(&config.session, "lsl-outlet")?;
    let mut predictions = observer.subscribe(&PREDICTIONS)?;
    let mut commands = observer.subscribe(&COMMANDS)?;
    let mut looked = Instant::now();
    while !stop.load(Ordering::Relaxed) {
        let mut inputs = [
            PollFd::new(predictions.as_fd(), PollFlags::POLLIN),
            PollFd::new(commands.as_fd(), PollFlags::POLLIN),
        ];
        match poll(&mut inputs, PollTimeout::from(TICK_MS)) {
            Ok(_) | Err(Errno::EINTR) => {}
            Err(error) => return Err(error).context("cannot wait for messages"),
        }
        predictions.acknowledge_wakes()?;
        while let Some(message) = predictions.receive()? {
            streams.predicted(message.header(), message.payload());
        }
        commands.acknowledge_wakes()?;
        while let Some(message) = commands.receive()? {
            streams.commanded(message.header(), message.payload())?;
        }
        let mut given = Ok(());
        observer.gather(|state| {
            let result = streams.stated(&state.header);
            given = std::mem::replace(&mut given, Ok(())).and(result);
        })?;
        given?;
        if looked.elapsed() > SESSION_INTERVAL {
            looked = Instant::now();
            if !observer.is_running() {
                break;
            }
        }
    }
    Ok(())
}
