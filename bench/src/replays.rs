//! One recording through whole sessions at full speed, again and again, several at a time: all must end, with the same
//! result, and none may take much longer than the others.

use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use serde::Serialize;
use tendon_report::Report;

use crate::{replay, session};

/// Longest duration of a replay over the median.
const LONGEST_OVER_MEDIAN: f64 = 10.0;
/// A replay that takes so long hangs.
const PATIENCE: Duration = Duration::from_secs(300);
/// Time between two looks at a session.
const LOOK: Duration = Duration::from_millis(10);

/// How many replays, and of what.
#[derive(Clone, Copy, Debug, Args)]
pub struct ReplaysArguments {
    /// Number of replays.
    #[arg(long, default_value_t = 500)]
    count: usize,
    /// Replays at a time.
    #[arg(long, default_value_t = 3)]
    parallel: usize,
    /// Length of the recording, s.
    #[arg(long, default_value_t = 20.0)]
    recording_s: f64,
}

/// What came of one replay.
struct Outcome {
    duration_s: f64,
    /// Counts of messages, recognition and where the arm ended; or why the replay failed.
    result: Result<String, String>,
}

/// What came of all.
#[derive(Debug, Serialize)]
pub struct Replays {
    count: usize,
    failed: usize,
    /// Those that ended with another result than most.
    different: usize,
    median_s: f64,
    longest_s: f64,
}

/// Replays as often as `arguments` say.
///
/// # Errors
///
/// When a replay fails, differs or takes too long, or `tendon` has not been built.
pub fn measure(arguments: ReplaysArguments) -> anyhow::Result<Replays> {
    let ReplaysArguments { count, parallel, recording_s } = arguments;
    if count == 0 || parallel == 0 || recording_s.is_nan() || recording_s < 1.0 {
        bail!("give at least 1 replay, 1 at a time, of at least 1 s");
    }
    let program = session::program()?.context("build it with `cargo build --release --workspace --bins`")?;
    let directory = tempfile::tempdir().context("cannot make a folder for a recording")?;
    let settings = replay::prepare(directory.path(), recording_s)?;
    let outcomes = Mutex::new(Vec::new());
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for lane in 0..parallel {
            let (program, settings, outcomes, next) = (&program, &settings, &outcomes, &next);
            scope.spawn(move || {
                while next.fetch_add(1, Ordering::Relaxed) < count {
                    let begun = Instant::now();
                    let result = replay_once(program, settings, lane).map_err(|error| format!("{error:#}"));
                    let outcome = Outcome { duration_s: begun.elapsed().as_secs_f64(), result };
                    let mut outcomes = outcomes.lock().expect("no thread panics with the lock held");
                    outcomes.push(outcome);
                    if outcomes.len() % 50 == 0 {
                        println!("  {} replays", outcomes.len());
                    }
                }
            });
        }
    });
    judge(&outcomes.into_inner().expect("no thread panics with the lock held"))
}

fn replay_once(program: &Path, settings: &Path, lane: usize) -> anyhow::Result<String> {
    let directory = tempfile::tempdir().context("cannot make a folder for a report")?;
    let path = directory.path().join("report.json");
    let errors = std::fs::File::create_new(directory.path().join("errors")).context("cannot make a file")?;
    let mut tendon = Command::new(program)
        .arg("run")
        .args(["--session", &format!("bench-replays-{lane}"), "--realtime", "off", "--config"])
        .arg(settings)
        .arg("--json")
        .arg(&path)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(errors)
        .spawn()
        .with_context(|| format!("cannot start {}", program.display()))?;
    let ended = wait(&mut tendon)?;
    let said = std::fs::read_to_string(directory.path().join("errors")).unwrap_or_default();
    let status = ended.with_context(|| format!("a replay hung for {PATIENCE:?}: {}", said.trim()))?;
    // A session that could not start writes a report, too.
    if !status.success() {
        bail!("a replay ended with {status}: {}", said.trim());
    }
    let text = std::fs::read_to_string(&path).with_context(|| format!("no report: {}", said.trim()))?;
    let report: Report = serde_json::from_str(&text).context("the report of `tendon run`")?;
    serde_json::to_string(&(report.messages, report.recognition, report.final_position_mm))
        .context("the report of `tendon run`")
}

/// Waits for the end of a session; `None` when it hangs and was killed.
fn wait(tendon: &mut Child) -> anyhow::Result<Option<ExitStatus>> {
    let begun = Instant::now();
    loop {
        let status = tendon.try_wait().context("cannot wait for `tendon run`")?;
        if status.is_some() {
            return Ok(status);
        }
        if begun.elapsed() > PATIENCE {
            tendon.kill().context("cannot end `tendon run`")?;
            tendon.wait().context("cannot wait for `tendon run`")?;
            return Ok(None);
        }
        std::thread::sleep(LOOK);
    }
}

fn judge(outcomes: &[Outcome]) -> anyhow::Result<Replays> {
    let mut durations_s: Vec<f64> = outcomes.iter().map(|outcome| outcome.duration_s).collect();
    durations_s.sort_by(f64::total_cmp);
    let results: Vec<&String> = outcomes.iter().filter_map(|outcome| outcome.result.as_ref().ok()).collect();
    let alike = |result: &String| results.iter().filter(|other| ***other == *result).count();
    let most = results.iter().map(|result| alike(result)).max().unwrap_or(0);
    let replays = Replays {
        count: outcomes.len(),
        failed: outcomes.len() - results.len(),
        different: results.len() - most,
        median_s: durations_s[durations_s.len() / 2],
        longest_s: durations_s[durations_s.len() - 1],
    };
    println!(
        "{} replays: {} failed, {} ended differently; median {:.2} s, longest {:.2} s",
        replays.count, replays.failed, replays.different, replays.median_s, replays.longest_s
    );
    for error in outcomes.iter().filter_map(|outcome| outcome.result.as_ref().err()).take(3) {
        println!("  {error}");
    }
    if replays.failed + replays.different > 0 {
        bail!("not all replays ended with the same result");
    }
    if replays.longest_s > LONGEST_OVER_MEDIAN * replays.median_s {
        bail!("a replay took more than {LONGEST_OVER_MEDIAN} times the median");
    }
    Ok(replays)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(duration_s: f64, result: &str) -> Outcome {
        Outcome { duration_s, result: Ok(result.to_owned()) }
    }

    #[test]
    fn a_replay_that_fails_differs_or_takes_too_long_is_told() {
        let alike = || vec![outcome(1.0, "same"), outcome(1.1, "same"), outcome(0.9, "same")];
        let replays = judge(&alike()).unwrap();
        assert_eq!((replays.count, replays.failed, replays.different), (3, 0, 0));
        let with = |other| judge(&alike().into_iter().chain([other]).collect::<Vec<_>>());
        assert!(with(outcome(1.0, "other")).unwrap_err().to_string().contains("same result"));
        assert!(with(outcome(12.0, "same")).unwrap_err().to_string().contains("10 times the median"));
        assert!(with(Outcome { duration_s: 1.0, result: Err("hung".to_owned()) }).is_err());
    }
}
