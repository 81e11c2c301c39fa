//! Trials of the stops: something goes wrong in a session with an emulated arm, and what then happens is measured from
//! the arm's side.
//!
//! ```text
//! seed ─▶ Plan: a cause and a phase
//!           │
//!           ▼                                    at the emulator, every 2 ms: does the flange move?
//! first session ── phase reached ── cause ── 1.2 s ── end     motion later than 250 ms after the cause?
//!           │                                                 report written? exit code documented? files left behind?
//!           ▼
//! second session, same name, same arm, nobody arms it         motion that nobody asked for? an error cleared?
//! ```
//!
//! A trial depends on its seed alone, so a failure is repeated by its seed.

mod cause;
mod first;
mod outputs;
mod second;
mod watch;

use std::fmt;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::Arc;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde::Serialize;
use tempfile::TempDir;
use tendon_transport::SessionName;

pub use cause::{Cause, Order, Output, Phase, Plan, Victim};
use outputs::Outputs;
use watch::Watch;

use crate::{EmulatedArm, model, program, repository};

/// How long the arm may move after the cause.
const STOP_LIMIT: Duration = Duration::from_millis(250);
/// How long the first session is looked at after the cause.
const LOOK_ON: Duration = Duration::from_millis(1200);
/// How long a session may take to end once it is told to.
const END_LIMIT: Duration = Duration::from_secs(15);
/// How long a phase may take to be reached.
const PHASE_LIMIT: Duration = Duration::from_secs(25);
/// Speed of the flange below which it is at rest, mm/s.
const REST_MM_PER_S: f64 = 0.1;
/// Speed of the flange while a gesture is held, mm/s: the fastest that the settings of the arm allow.
const FULL_SPEED_MM_PER_S: f64 = 100.0;
/// Environment variable that marks the processes of a trial.
const MARK: &str = "TENDON_TRIAL";

/// What came of a trial.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The seed that repeats it.
    pub seed: u64,
    /// What was done to the session.
    pub cause: String,
    /// When.
    pub phase: Phase,
    /// From the cause to the last motion of the flange, ms; none when it was at rest already.
    pub stop_ms: Option<f64>,
    /// Everything that is not as it has to be; empty for a good trial.
    pub failures: Vec<Failure>,
    /// Standard error of the first and the second session, of a failed trial only.
    pub errors: Vec<String>,
    /// How long the trial took, s.
    pub took_s: f64,
}

/// One thing that is not as it has to be.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum Failure {
    /// The flange moved so many ms after the cause.
    LateMotion(f64),
    /// The flange moved in the second session, at most at so many mm/s, though nobody armed the arm.
    UnaskedMotion(f64),
    /// The second session cleared this error of the arm.
    ErrorCleared(u8),
    /// These files stayed behind.
    Leftovers(Vec<PathBuf>),
    /// These programs went on after their session.
    Processes(Vec<String>),
    /// The report is missing, or is no JSON.
    LostReport(String),
    /// The command ended with a code that no document names, or by a signal.
    ExitCode(String),
    /// The command panicked.
    Panic,
    /// The session did not end in time.
    NoEnd,
    /// The phase was not reached, so that nothing was tried.
    NotReached,
}

impl Failure {
    /// The kind, as a word for a table.
    pub fn kind(&self) -> &'static str {
        match self {
            Failure::LateMotion(_) => "late motion",
            Failure::UnaskedMotion(_) => "unasked motion",
            Failure::ErrorCleared(_) => "error cleared",
            Failure::Leftovers(_) => "leftovers",
            Failure::Processes(_) => "processes left",
            Failure::LostReport(_) => "lost report",
            Failure::ExitCode(_) => "exit code",
            Failure::Panic => "panic",
            Failure::NoEnd => "no end",
            Failure::NotReached => "not reached",
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = self.kind();
        match self {
            Failure::LateMotion(ms) => write!(formatter, "{kind}: {ms:.0} ms after the cause"),
            Failure::UnaskedMotion(speed) => write!(formatter, "{kind}: up to {speed:.0} mm/s"),
            Failure::ErrorCleared(code) => write!(formatter, "{kind}: {code}"),
            Failure::Leftovers(files) => {
                write!(formatter, "{kind}: {} files, such as {:?}", files.len(), files.first())
            }
            Failure::Processes(names) => write!(formatter, "{kind}: {names:?}"),
            Failure::LostReport(why) | Failure::ExitCode(why) => write!(formatter, "{kind}: {why}"),
            Failure::Panic | Failure::NoEnd | Failure::NotReached => formatter.write_str(kind),
        }
    }
}

/// Runs the trial of this seed.
pub fn run(seed: u64) -> Outcome {
    let begun = Instant::now();
    let plan = Plan::of(seed);
    let bench = Bench::new(seed);
    let first = first::run(&bench, &plan);
    let mut failures = first.failures;
    let mut errors = vec![first.errors];
    // Nothing is to be seen in the next session where nothing was tried in this one.
    if !failures.contains(&Failure::NotReached) {
        let second = second::run(&bench, first.may_move_afterwards);
        failures.extend(second.failures);
        errors.push(second.errors);
    }
    bench.end_processes();
    bench.remove_files();
    if failures.is_empty() {
        errors.clear();
    }
    Outcome {
        seed,
        cause: plan.cause.name(),
        phase: plan.phase,
        stop_ms: first.stop_ms,
        failures,
        errors,
        took_s: begun.elapsed().as_secs_f64(),
    }
}

/// What both sessions of a trial share: an arm, a name, a place for files.
struct Bench {
    seed: u64,
    emulator: Arc<EmulatedArm>,
    session: SessionName,
    /// Run-time files, lasting state and reports of the trial.
    folder: TempDir,
}

impl Bench {
    fn new(seed: u64) -> Bench {
        let session = format!("trial-{}-{seed}", std::process::id() % 100_000);
        let folder = tempfile::tempdir().unwrap();
        std::fs::DirBuilder::new().mode(0o700).create(folder.path().join("run")).unwrap();
        let bench = Bench {
            seed,
            emulator: Arc::new(EmulatedArm::start()),
            session: session.parse().unwrap(),
            folder,
        };
        bench.leave_record();
        bench
    }

    /// The record that permits the arm to set out by itself: it was left in good order where it is.
    fn leave_record(&self) {
        self.emulator.leave_in_good_order(&self.folder.path().join("state"));
    }

    /// Where the records of arms are.
    fn records(&self) -> PathBuf {
        self.folder.path().join("state/tendon/arms")
    }

    fn has_record(&self) -> bool {
        std::fs::read_dir(self.records()).is_ok_and(|mut records| records.next().is_some())
    }

    /// A `tendon` with these arguments in the environment of the trial.
    fn tendon(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(program("tendon"));
        command.args(arguments).args(["--session", &self.session.to_string()]);
        command.current_dir(self.folder.path()).env(MARK, self.seed.to_string());
        command.env("XDG_RUNTIME_DIR", self.folder.path().join("run"));
        command.env("XDG_STATE_HOME", self.folder.path().join("state"));
        if std::env::var_os("ORT_DYLIB_PATH").is_none() {
            command.env("ORT_DYLIB_PATH", repository().join(".cache/onnxruntime/libonnxruntime.so"));
        }
        command
    }

    /// `tendon run` on the emulated arm, with a report at `report`.
    fn session(&self, script: &str, settings: &[&str], report: &Path) -> Command {
        let listen = self.emulator.listen;
        let mut command = self.tendon(&["run", "--strategy", "direct", "--script", script]);
        command.arg("--model").arg(model("cnn-six-class")).arg("--json").arg(report);
        let arm = [
            "robot.backend=\"xarm\"".to_owned(),
            format!("robot.xarm.address=\"{}\"", listen.address),
            format!("robot.xarm.control_port={}", listen.control_port),
            format!("robot.xarm.normal_report_port={}", listen.normal_report_port),
            format!("robot.xarm.real_time_report_port={}", listen.real_time_report_port),
            format!("decision.speed_mm_per_s={FULL_SPEED_MM_PER_S}"),
        ];
        for setting in arm.iter().map(String::as_str).chain(settings.iter().copied()) {
            command.args(["--set", setting]);
        }
        command
    }

    fn speed_mm_per_s(&self) -> f64 {
        self.emulator.model().speed_mm_per_s()
    }

    /// `tendon stop` or `tendon arm`; whether the session took it.
    fn order(&self, order: &str) -> bool {
        self.tendon(&[order]).output().unwrap().status.success()
    }

    /// Processes of this trial that run: number and name.
    fn processes(&self) -> Vec<(Pid, String)> {
        let mark = format!("{MARK}={}", self.seed);
        let entries = std::fs::read_dir("/proc").unwrap().flatten();
        let of_trial = entries.filter_map(|entry| {
            let process = entry.file_name().to_str()?.parse().ok()?;
            let environment = std::fs::read(entry.path().join("environ")).ok()?;
            if !environment.split(|byte| *byte == 0).any(|variable| variable == mark.as_bytes()) {
                return None;
            }
            let name = std::fs::read_to_string(entry.path().join("comm")).ok()?;
            Some((Pid::from_raw(process), name.trim_end().to_owned()))
        });
        of_trial.collect()
    }

    /// Ends whatever still runs, so that one failure is not found again in the next trial.
    fn end_processes(&self) {
        for (process, _) in self.processes() {
            // One that is gone meanwhile needs no killing.
            let _ = kill(process, Signal::SIGKILL);
        }
    }

    /// Files whose name holds the session's, in shared memory and wherever sessions keep their run-time files.
    fn files(&self) -> Vec<PathBuf> {
        let session = self.session.to_string();
        let mut folders = vec![PathBuf::from("/dev/shm"), self.folder.path().join("run")];
        let temporary = std::fs::read_dir("/tmp").unwrap().flatten();
        folders.extend(temporary.map(|entry| entry.path()).filter(|path| {
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("tendon-"))
        }));
        let mut found = Vec::new();
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
                match entry.file_type() {
                    Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                    _ if entry.file_name().to_string_lossy().contains(&session) => found.push(entry.path()),
                    _ => {}
                }
            }
        }
        found
    }

    fn remove_files(&self) {
        for file in self.files() {
            // Nobody else has a session of this name.
            let _ = std::fs::remove_file(file);
        }
    }
}

/// What is wrong with how a `tendon run` ended: its code, a panic, a missing report.
fn ending_failures(status: Option<ExitStatus>, errors: &str, report: Option<&Path>) -> Vec<Failure> {
    let mut failures = Vec::new();
    if errors.contains("panicked") {
        failures.push(Failure::Panic);
    }
    match status {
        None => failures.push(Failure::NoEnd),
        Some(status) if !matches!(status.code(), Some(0..=2)) => {
            failures.push(Failure::ExitCode(status.to_string()));
        }
        Some(_) => {}
    }
    if let Some(path) = report
        && let Err(why) = read_report(path)
    {
        failures.push(Failure::LostReport(why));
    }
    failures
}

fn read_report(path: &Path) -> Result<serde_json::Value, String> {
    let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
    serde_json::from_str(&text).map_err(|error| error.to_string())
}
