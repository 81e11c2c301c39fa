//! Trials of the stops, many of them: `cargo run --release -p tendon-system-tests --bin trials -- --count 1000`.
//!
//! See [`tendon_system_tests::trials`] for what a trial is. The programs must have been built for the same profile.
#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a program of tests may do what tests may")]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Parser;
use tendon_system_tests::trials::{self, Cause, Outcome, Phase};

/// Does something bad to sessions with an emulated arm, and looks at what the arm then does.
#[derive(Debug, Parser)]
struct Arguments {
    /// How many trials.
    #[arg(long, default_value_t = 128)]
    count: u64,
    /// Seed of the first; each following trial has the next number. A failure is repeated with `--count 1 --seed N`.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How many at a time.
    #[arg(long, default_value_t = 1)]
    parallel: usize,
    /// Only causes whose name holds this.
    #[arg(long)]
    cause: Option<String>,
    /// Writes every trial as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let next = AtomicU64::new(0);
    let outcomes = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..arguments.parallel.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= arguments.count {
                        return;
                    }
                    let seed = arguments.seed + number;
                    let name = trials::Plan::of(seed).cause.name();
                    if arguments.cause.as_ref().is_some_and(|part| !name.contains(part.as_str())) {
                        continue;
                    }
                    let outcome = trials::run(seed);
                    print(&outcome);
                    let mut outcomes = outcomes.lock().unwrap();
                    outcomes.push(outcome);
                    if let Some(path) = &arguments.json {
                        std::fs::write(path, serde_json::to_vec_pretty(&*outcomes).unwrap()).unwrap();
                    }
                }
            });
        }
    });
    let outcomes = outcomes.into_inner().unwrap();
    print_table(&outcomes);
    let failed = outcomes.iter().filter(|outcome| !outcome.failures.is_empty()).count();
    if failed == 0 && !outcomes.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn print(outcome: &Outcome) {
    let stop = outcome.stop_ms.map_or("at rest".to_owned(), |ms| format!("{ms:.0} ms"));
    let failures: Vec<String> = outcome.failures.iter().map(ToString::to_string).collect();
    let verdict = if failures.is_empty() { "good".to_owned() } else { failures.join("; ") };
    println!(
        "seed {:<5} {:<11} {:<32} {stop:>8}  {:4.1} s  {verdict}",
        outcome.seed,
        format!("{:?}", outcome.phase),
        outcome.cause,
        outcome.took_s
    );
}

/// Failed of all, for every cause and phase; then the kinds of failure; then the times.
fn print_table(outcomes: &[Outcome]) {
    let mut cells: BTreeMap<(&str, Phase), (usize, usize)> = BTreeMap::new();
    let mut kinds: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
    for outcome in outcomes {
        let cell = cells.entry((&outcome.cause, outcome.phase)).or_default();
        cell.0 += usize::from(!outcome.failures.is_empty());
        cell.1 += 1;
        for failure in &outcome.failures {
            kinds.entry(failure.kind()).or_default().push(outcome.seed);
        }
    }
    println!("\nfailed of all");
    print!("{:<32}", "");
    Phase::ALL.iter().for_each(|phase| print!("{:>12}", format!("{phase:?}")));
    println!();
    for cause in Cause::all() {
        let name = cause.name();
        let row = Phase::ALL.map(|phase| cells.get(&(name.as_str(), phase)));
        if row.iter().any(Option::is_some) {
            print!("{name:<32}");
            for cell in row {
                print!("{:>12}", cell.map_or(String::new(), |(failed, all)| format!("{failed} of {all}")));
            }
            println!();
        }
    }
    let failed = outcomes.iter().filter(|outcome| !outcome.failures.is_empty()).count();
    println!("\n{failed} of {} trials failed", outcomes.len());
    for (kind, seeds) in kinds {
        println!("  {kind}: {} (seeds {seeds:?})", seeds.len());
    }
    let mut times: Vec<f64> = outcomes.iter().filter_map(|outcome| outcome.stop_ms).collect();
    times.sort_by(f64::total_cmp);
    if let (Some(longest), false) = (times.last(), times.is_empty()) {
        println!("cause to rest: median {:.0} ms, longest {longest:.0} ms", times[times.len() / 2]);
    }
}
