//! The `tendon` command.
//!
//! ```text
//! tendon run ──starts──▶ acquisition, dsp, inference, decision, robot
//!     ▲  │ ready, exit            │ measurements, states (shared memory)
//!     │  └──── orders (stdin) ──▶ │
//!     └───────────────────────────┘     tendon latency observes
//! ```
#![allow(clippy::print_stdout, reason = "this program's output is for people and pipes")]

mod calibrate;
mod channels;
mod checks;
mod configuration;
mod dataset;
mod delete;
mod desk;
mod doctor;
mod evaluate;
mod experiments;
mod export;
mod failed;
mod latency;
mod model_channels;
mod next;
mod note;
mod options;
mod order;
mod output;
mod page;
mod people;
mod personal;
mod prior;
mod profile;
mod progress;
mod provenance;
mod recorded;
mod recording_options;
mod run;
mod running_session;
mod screen;
mod session_outputs;
mod sources;
mod strategies;
mod times;
mod zones;

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::{Parser, Subcommand};
use signal_hook::consts::SIGXFSZ;
use tendon_process::Order;
use tendon_session::{SessionFailure, Writer};
use tendon_transport::now_ns;

/// How long a terminal may take what is said at the end. One whose reader stopped never takes it.
const TERMINAL_TIMEOUT: Duration = Duration::from_secs(2);

/// What `tendon --help` ends with.
const EXIT_CODES: &str = "Exit codes: 0 done, also when a signal or the terminal's end stopped the session, or nobody \
    read the output; 1 something broke off, or a result could not be written; 2 bad input, no such session, or the \
    session could not start.";

/// Steer an assistive robot arm with forearm muscle signals.
#[derive(Debug, Parser)]
#[command(name = "tendon", version, about, max_term_width = 100, after_help = EXIT_CODES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Start a session: all stages, watched until it ends, then the table of latencies.
    Run(Box<options::Options>),
    /// Show the live latencies of a running session.
    Latency(latency::Options),
    /// Stop the arm of a running session at once; it does not move again before `tendon arm`.
    Stop(running_session::RunningSession),
    /// Permit the arm of a running session to move again, once the muscles have been at rest.
    Arm(running_session::RunningSession),
    /// List where samples can come from: streams on the network, and what is configured.
    Sources(sources::Options),
    /// Show a running session in a browser; waits for it, and for the next of that name.
    Page(page::Options),
    /// Keep a note in the recording of a running session.
    Note(note::Options),
    /// Compare two recorded sessions, such as one and its replay: what was recognised and decided, bit for bit.
    Compare(recorded::CompareOptions),
    /// Give a recorded session in the formats of others: tables, BIDS, XDF.
    Export(export::Options),
    /// Check what this machine offers a session, and say how to mend what is wrong.
    Doctor(doctor::Options),
    /// Profiles of the simulated amplifier.
    #[command(subcommand)]
    Profile(profile::Command),
    /// Data sets to train models on.
    #[command(subcommand)]
    Dataset(dataset::Command),
    /// Fit a recogniser to one person and keep it.
    Calibrate(calibrate::Options),
    /// List the people who were calibrated.
    People(people::Options),
    /// Delete all that is kept of a person: calibrations, sessions, exports.
    Delete(delete::Options),
    /// Gather what people have in common from their recordings, for the recognisers of others.
    Prior(prior::Options),
    /// Score a model on a data set: accuracy, per-class scores, confusion matrix, figures.
    Evaluate(evaluate::Options),
    /// Score the three real-time strategies on continuous recordings with cues.
    Strategies(strategies::Options),
    /// Repeat the paper's experiments on recordings: data sets, models, strategies, tables and figures.
    Experiments(experiments::Options),
}

/// An error with the exit code it leads to: 2 for bad input, 1 for what broke off later.
#[derive(Debug)]
struct Failure {
    error: anyhow::Error,
    exit_code: u8,
}

impl Failure {
    fn input(error: impl Into<anyhow::Error>) -> Failure {
        Failure { error: error.into(), exit_code: 2 }
    }

    fn running(error: impl Into<anyhow::Error>) -> Failure {
        Failure { error: error.into(), exit_code: 1 }
    }

    /// The reason in one line, for a report: with what a stage that ended had said of it.
    fn reason(&self) -> String {
        let of_session = self.error.downcast_ref::<SessionFailure>().map(SessionFailure::reason);
        of_session.unwrap_or_else(|| format!("{:#}", self.error))
    }
}

/// Goes on with what somebody has asked for at the page of a session that has ended; if nobody has, all is done.
fn go_on(following: Option<next::Following>) -> Result<(), Failure> {
    following.map_or(Ok(()), |following| Err(following.start()))
}

fn main() -> ExitCode {
    // A limit on the size of files is then an error of writing that says so, and no silent end. It fails for no signal that
    // programs may handle.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
    let result = match Arguments::parse().command {
        Command::Run(options) => run::run(&options).and_then(go_on),
        Command::Latency(options) => latency::show(&options),
        Command::Stop(options) => order::give(&options, Order::Stop),
        Command::Arm(options) => order::give(&options, Order::arm_shown_at(now_ns())),
        Command::Sources(options) => sources::list(&options),
        Command::Page(options) => page::serve(&options),
        Command::Note(options) => note::leave(&options),
        Command::Compare(options) => recorded::compare(&options),
        Command::Export(options) => export::export(&options),
        Command::Doctor(options) => doctor::examine(&options),
        Command::Profile(profile::Command::Fit(options)) => profile::fit(&options),
        Command::Dataset(dataset::Command::Build(options)) => dataset::build(&options),
        Command::Calibrate(options) => calibrate::calibrate(&options).and_then(go_on),
        Command::People(options) => people::list(&options),
        Command::Delete(options) => delete::delete(&options),
        Command::Prior(options) => prior::gather(&options),
        Command::Evaluate(options) => evaluate::evaluate(&options),
        Command::Strategies(options) => strategies::score(&options),
        Command::Experiments(options) => experiments::run(&options),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure { error, exit_code }) => {
            // Without standard error there is nobody left to tell; the exit code still says it.
            if let Ok(errors) = Writer::standard_error() {
                errors.say(format!("tendon: error: {error:#}"));
                let _ = errors.finish(TERMINAL_TIMEOUT);
            }
            ExitCode::from(exit_code)
        }
    }
}
