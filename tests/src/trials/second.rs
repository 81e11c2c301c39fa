//! The second session of a trial: nobody arms the arm, so it must not move.

use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::{Bench, END_LIMIT, Failure, Output, Outputs, Watch, ending_failures};

/// A rest and a gesture, both ways.
const SCRIPT: &str = "rest 0.6s, ulnar 3s, rest 0.6s, radial 3s";
/// How long the arm is looked at once the samples flow: a rest, and a gesture that would move it.
const LOOK_ON: Duration = Duration::from_millis(1800);
/// How long, from the start, where they do not: the arm waits to be armed before it goes to its start.
const LOOK_ON_WAITING: Duration = Duration::from_millis(4500);

/// What came of the second session.
pub struct Second {
    pub failures: Vec<Failure>,
    /// Its standard error.
    pub errors: String,
}

/// Runs the second session.
pub fn run(bench: &Bench, may_move: bool) -> Second {
    let (error_before, _) = bench.emulator.model().codes();
    let watch = Watch::start(&bench.emulator);
    let report = bench.folder.path().join("second.json");
    let (mut child, outputs) = Outputs::start(Output::Pipes, bench.session(SCRIPT, &[], &report));
    let begun = Instant::now();
    let mut running = None;
    while begun.elapsed() < LOOK_ON_WAITING && matches!(child.try_wait(), Ok(None)) {
        if running.is_none() && outputs.text().contains("scheduling") {
            running = Some(Instant::now());
        }
        if running.is_some_and(|since| since.elapsed() > LOOK_ON) {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let greatest_speed = watch.greatest_speed_mm_per_s();
    // One that has ended by itself needs no signal.
    let _ = kill(Pid::from_raw(child.id() as i32), Signal::SIGTERM);
    let told = Instant::now();
    let mut status = None;
    while status.is_none() && told.elapsed() < END_LIMIT {
        status = child.try_wait().unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    let mut failures = ending_failures(status, &outputs.errors(), running.map(|_| report.as_path()));
    if greatest_speed > 0.0 && !may_move {
        failures.push(Failure::UnaskedMotion(greatest_speed));
    }
    let (error_after, _) = bench.emulator.model().codes();
    if error_before != 0 && error_after != error_before {
        failures.push(Failure::ErrorCleared(error_before));
    }
    let files = bench.files();
    if !files.is_empty() {
        failures.push(Failure::Leftovers(files));
    }
    Second { failures, errors: outputs.errors() }
}
