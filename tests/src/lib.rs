//! What the whole-system tests share: a `tendon` as a process, and recordings for it to replay.
//!
//! ```text
//! test ─▶ TendonBuilder ─start─▶ tendon ─▶ five stages          every test has a session of its own
//!   │                              │ stdout, stderr, report
//!   └── wait_until, stages, ───────┴─▶ Ended: exit code, output, report, and nothing left behind
//!       signals, observers
//! ```
//!
//! The programs must have been built for the same profile: `scripts/test` does so before it runs the tests.
//! Nothing here waits for a fixed time: every wait is for a condition, and [`WATCHDOG`] ends the ones that
//! would last forever.
#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may do what tests may")]

mod emulated_arm;
pub mod recorded_sessions;
pub mod recordings;
pub mod trials;

use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub use emulated_arm::EmulatedArm;
use nix::sys::signal::{Signal, kill};
use nix::unistd::{Gid, Pid, Uid, chown};
use tempfile::TempDir;
use tendon_messages::{BLOCKS, BlockHeader};
use tendon_report::Report;
use tendon_transport::{Delivery, Leftovers, Session, SessionName, Subscriber};

/// Longest wait for anything: only for a test that would otherwise hang, so generous.
pub const WATCHDOG: Duration = Duration::from_secs(120);
/// Time between two looks at a condition.
const LOOK: Duration = Duration::from_millis(20);

/// The top of the project.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// A model that comes with Tendon: `cnn-five-gesture` or `cnn-six-class`.
pub fn model(name: &str) -> PathBuf {
    repository().join("models").join(format!("{name}.onnx"))
}

/// The library that runs the models, where scripts/fetch-onnxruntime puts it.
pub fn runtime_library() -> PathBuf {
    let given = std::env::var_os("ORT_DYLIB_PATH").map(PathBuf::from);
    given.unwrap_or_else(|| repository().join(".cache/onnxruntime/libonnxruntime.so"))
}

/// A program of the profile that the test was built for.
pub fn program(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let found = test.ancestors().skip(1).map(|folder| folder.join(name)).find(|path| path.is_file());
    found.unwrap_or_else(|| {
        panic!("{name} is not built: run scripts/test, or `cargo build --workspace --bins`")
    })
}

/// A name that no other test's session has, now or in another run.
pub fn unique_session() -> SessionName {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    format!("test-{}-{number}", std::process::id()).parse().unwrap()
}

/// Waits until `condition` gives something.
///
/// # Panics
///
/// When it does not before the [`WATCHDOG`], with `what` was waited for.
pub fn wait_until<T>(what: &str, mut condition: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(value) = condition() {
            return value;
        }
        assert!(begun.elapsed() < WATCHDOG, "waited {WATCHDOG:?} in vain for {what}");
        std::thread::sleep(LOOK);
    }
}

/// `tendon arm`, again and again until the newest stop is so old that its sender can have seen it.
pub fn arm(session: &SessionName) -> Ended {
    let words = ["arm", "--session", &session.to_string()];
    wait_until("an order to arm that comes late enough", || {
        let ended = TendonBuilder::command(&unique_session(), &words).end();
        (!ended.errors.contains("cannot have seen the newest stop")).then_some(ended)
    })
}

/// Asserts that a session has no file left in shared memory and the runtime directory.
pub fn assert_nothing_left(session: &SessionName) {
    let left = Leftovers::of(session).files;
    assert!(left.is_empty(), "session `{session}` left behind: {left:?}");
}

/// A command line of `tendon` in the making.
#[derive(Debug)]
pub struct TendonBuilder {
    command: Command,
    session: SessionName,
    /// Working folder of the command, and place of its report.
    folder: TempDir,
}

impl TendonBuilder {
    /// `tendon run` as `session`, with the model of the threshold strategy, in an empty folder.
    pub fn run(session: &SessionName) -> TendonBuilder {
        TendonBuilder::run_with_model(session, &model("cnn-five-gesture"))
    }

    /// `tendon run` as `session` with this model.
    pub fn run_with_model(session: &SessionName, model: &Path) -> TendonBuilder {
        let builder = TendonBuilder::command(session, &["run", "--session", session.to_string().as_str()]);
        let report = builder.folder.path().join("report.json");
        builder.arg("--model").arg(model).arg("--json").arg(report)
    }

    /// Any command of `tendon`, in an empty folder. `session` is the one that must leave nothing behind.
    pub fn command(session: &SessionName, arguments: &[&str]) -> TendonBuilder {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new(program("tendon"));
        command.args(arguments).current_dir(folder.path());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        if std::env::var_os("ORT_DYLIB_PATH").is_none() {
            command.env("ORT_DYLIB_PATH", runtime_library());
        }
        TendonBuilder { command, session: session.clone(), folder }
    }

    /// Adds an argument.
    pub fn arg(mut self, argument: impl AsRef<std::ffi::OsStr>) -> TendonBuilder {
        self.command.arg(argument);
        self
    }

    /// Adds arguments.
    pub fn args(mut self, arguments: &[&str]) -> TendonBuilder {
        self.command.args(arguments);
        self
    }

    /// Gives it a terminal, as if it were started by a person there (setsid(1) makes it the controlling one).
    pub fn controlled_by(self, terminal: std::os::fd::OwnedFd) -> TendonBuilder {
        let mut builder = self.through("setsid", &["--ctty"]);
        builder.command.stdin(terminal);
        builder
    }

    /// Runs it as another user, whose home is the command's folder. Only root can.
    pub fn as_user(self, user: u32) -> TendonBuilder {
        let id = Uid::from_raw(user);
        chown(self.folder.path(), Some(id), Some(Gid::from_raw(user))).unwrap();
        let (user, home) = (user.to_string(), self.folder.path().to_owned());
        let mut builder = self.through("setpriv", &["--reuid", &user, "--regid", &user, "--clear-groups"]);
        builder.command.env("HOME", home).env_remove("XDG_RUNTIME_DIR").env_remove("XDG_STATE_HOME");
        builder
    }

    /// The same command, started by another one.
    fn through(mut self, program: &str, arguments: &[&str]) -> TendonBuilder {
        let mut command = Command::new(program);
        command.args(arguments).arg(self.command.get_program()).args(self.command.get_args());
        command.current_dir(self.folder.path());
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        for (name, value) in self.command.get_envs() {
            command.env(name, value.unwrap_or_default());
        }
        self.command = command;
        self
    }

    /// The command, for a test that starts it itself with streams of its own, and the folder in which it writes
    /// `report.json`. With `on_terminal` its standard input becomes its controlling terminal: setsid(1).
    pub fn into_command(self, on_terminal: bool) -> (Command, TempDir) {
        if !on_terminal {
            return (self.command, self.folder);
        }
        let mut command = Command::new("setsid");
        command.arg("--ctty").arg(self.command.get_program()).args(self.command.get_args());
        command.current_dir(self.folder.path());
        for (name, value) in self.command.get_envs() {
            command.env(name, value.unwrap_or_default());
        }
        (command, self.folder)
    }

    /// The folder that it will run in.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Sets an environment variable.
    pub fn env(mut self, name: &str, value: impl AsRef<std::ffi::OsStr>) -> TendonBuilder {
        self.command.env(name, value);
        self
    }

    /// Starts it.
    pub fn start(mut self) -> Tendon {
        let mut process = self.command.spawn().unwrap();
        let output = Gathered::of(process.stdout.take().unwrap());
        let errors = Gathered::of(process.stderr.take().unwrap());
        Tendon { process, session: self.session, output, errors, folder: self.folder }
    }

    /// Starts it and waits for its end.
    pub fn end(self) -> Ended {
        self.start().end()
    }
}

/// Everything that comes out of a pipe, in a thread of its own.
#[derive(Debug)]
struct Gathered {
    text: Arc<Mutex<String>>,
    thread: Option<JoinHandle<()>>,
}

impl Gathered {
    fn of(pipe: impl Read + Send + 'static) -> Gathered {
        let text = Arc::new(Mutex::new(String::new()));
        let sink = text.clone();
        let thread = std::thread::spawn(move || {
            let mut pipe = BufReader::new(pipe);
            let mut line = Vec::new();
            while pipe.read_until(b'\n', &mut line).is_ok_and(|length| length > 0) {
                sink.lock().unwrap().push_str(&String::from_utf8_lossy(&line));
                line.clear();
            }
        });
        Gathered { text, thread: Some(thread) }
    }

    fn so_far(&self) -> String {
        self.text.lock().unwrap().clone()
    }

    /// All of it, once whoever holds the other end has closed it.
    fn all(&mut self) -> String {
        if let Some(thread) = self.thread.take() {
            wait_until("the end of a pipe: a stage outlives the session", || {
                thread.is_finished().then_some(())
            });
        }
        self.so_far()
    }
}

/// A running `tendon`. Dropping it kills it and its stages.
#[derive(Debug)]
pub struct Tendon {
    process: Child,
    session: SessionName,
    output: Gathered,
    errors: Gathered,
    folder: TempDir,
}

/// What came of a `tendon`.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code; `None` when a signal ended it.
    pub exit_code: Option<i32>,
    /// Standard output.
    pub output: String,
    /// Standard error, that of the stages among it.
    pub errors: String,
    /// The text of the report, if one was written.
    pub report_json: Option<String>,
}

impl Ended {
    /// The report.
    ///
    /// # Panics
    ///
    /// When there is none, or the session failed.
    pub fn report(&self) -> Report {
        assert_eq!(self.exit_code, Some(0), "{self:#?}");
        serde_json::from_str(self.report_json.as_deref().expect("a report was asked for")).unwrap()
    }

    /// Asserts that the command failed with `exit_code`, said each of `parts` in one line of standard error,
    /// and did not panic.
    pub fn assert_failed(&self, exit_code: i32, parts: &[&str]) {
        assert_eq!(self.exit_code, Some(exit_code), "{self:#?}");
        assert!(!self.errors.contains("panicked"), "{self:#?}");
        let says = |line: &str| parts.iter().all(|part| line.contains(part));
        assert!(self.errors.lines().any(says), "no line has all of {parts:?}: {self:#?}");
    }
}

impl Tendon {
    /// Waits until the samples flow: all stages were ready and the source was let go.
    pub fn wait_until_running(&mut self) {
        wait_until("all stages to be ready", || {
            if let Some(status) = self.process.try_wait().unwrap() {
                panic!("tendon ended early ({status}): {}", self.errors.so_far());
            }
            self.output.so_far().contains("\n  scheduling").then_some(())
        });
    }

    /// Holds the session up while it starts, once its source is ready to begin, and does `disturb` meanwhile.
    pub fn before_the_start(&self, disturb: impl FnOnce()) {
        wait_until("the source", || {
            let is_source = |(_, name): &(Pid, String)| name.starts_with("tendon-acqui");
            children_of(self.process.id()).iter().any(is_source).then_some(())
        });
        let session = Session::join(&self.session, "test").unwrap();
        self.signal(Signal::SIGSTOP);
        let blocks = Subscriber::<BlockHeader, f32>::open(&session, &BLOCKS, None, Delivery::Live).unwrap();
        wait_until("the topic of the source", || blocks.connect().unwrap().then_some(()));
        disturb();
        self.signal(Signal::SIGCONT);
    }

    /// Waits until standard output holds `text`.
    pub fn wait_for_output(&mut self, text: &str) {
        wait_until(text, || {
            if let Some(status) = self.process.try_wait().unwrap() {
                panic!("tendon ended early ({status}): {}", self.errors.so_far());
            }
            self.output.so_far().contains(text).then_some(())
        });
    }

    /// Waits until a hundred more blocks have come: at 5 ms a block, the source has published its counts meanwhile.
    pub fn wait_for_blocks(&self) {
        let session = Session::join(&self.session, "test").unwrap();
        let mut blocks = Subscriber::open(&session, &BLOCKS, None, Delivery::Live).unwrap();
        let mut seen = 0;
        wait_until("100 blocks", || {
            while blocks.receive().unwrap().is_some() {
                seen += 1;
            }
            (seen >= 100).then_some(())
        });
    }

    /// Sends a signal to `tendon` itself.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.process.id() as i32), signal).unwrap();
    }

    /// Process id of `tendon` itself.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// The session's name.
    pub fn session(&self) -> &SessionName {
        &self.session
    }

    /// Process ids of the stages that run.
    pub fn stages(&self) -> Vec<Pid> {
        children_of(self.process.id()).into_iter().map(|(process, _)| process).collect()
    }

    /// Process id of one stage.
    pub fn stage(&self, name: &str) -> Pid {
        self.find_stage(name).unwrap_or_else(|| panic!("{name} does not run"))
    }

    /// Process id of one stage, if it runs.
    pub fn find_stage(&self, name: &str) -> Option<Pid> {
        let program = format!("tendon-{name}");
        children_of(self.process.id()).into_iter().find(|(_, child)| *child == program).map(|found| found.0)
    }

    /// Kills one stage again and again, until the session gives up.
    pub fn kill_until_it_gives_up(&mut self, name: &str) {
        wait_until("the session to give up", || {
            if let Some(process) = self.find_stage(name) {
                // It may have ended by itself meanwhile, with the session.
                let _ = kill(process, Signal::SIGKILL);
            }
            self.has_ended().then_some(())
        });
    }

    /// Standard error so far.
    pub fn errors_so_far(&self) -> String {
        self.errors.so_far()
    }

    /// Whether it is over.
    pub fn has_ended(&mut self) -> bool {
        self.process.try_wait().unwrap().is_some()
    }

    /// Waits for the end, and asserts that nothing is left behind.
    pub fn end(mut self) -> Ended {
        let ended = self.end_whatever_is_left();
        assert_nothing_left(&self.session);
        ended
    }

    /// Waits for the end.
    pub fn end_whatever_is_left(&mut self) -> Ended {
        let status = wait_until("the end of tendon", || self.process.try_wait().unwrap());
        Ended {
            exit_code: status.code(),
            output: self.output.all(),
            errors: self.errors.all(),
            report_json: std::fs::read_to_string(self.folder.path().join("report.json")).ok(),
        }
    }
}

impl Drop for Tendon {
    fn drop(&mut self) {
        // One that ended and was reaped must not be signalled: its id may be another process's by now.
        if let Ok(None) = self.process.try_wait() {
            for stage in self.stages() {
                // What is gone already needs no killing.
                let _ = kill(stage, Signal::SIGKILL);
            }
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}

/// One stage, started by hand instead of by `tendon run`. Dropping it kills it.
#[derive(Debug)]
pub struct StageAlone {
    process: Child,
    errors: Gathered,
    /// Kept open: that it is closed means stop.
    _output: BufReader<ChildStdout>,
}

impl StageAlone {
    /// Starts the stage `name` on a configuration and waits until it is ready.
    pub fn start(name: &str, config: &Path) -> StageAlone {
        let mut process = Command::new(program(&format!("tendon-{name}")))
            .arg("--config")
            .arg(config)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let errors = Gathered::of(process.stderr.take().unwrap());
        let mut output = BufReader::new(process.stdout.take().unwrap());
        let mut ready = String::new();
        output.read_line(&mut ready).unwrap();
        assert!(ready.contains("\"stage\""), "{name} is not ready: {}", errors.so_far());
        StageAlone { process, errors, _output: output }
    }

    /// Writes a line to its standard input, as the supervisor does.
    pub fn order(&mut self, line: &str) {
        let input = self.process.stdin.as_mut().expect("standard input is closed by `stop` only");
        writeln!(input, "{line}").unwrap();
    }

    /// Closes its standard input, which tells it to stop, and waits for its end; gives its exit code and
    /// standard error.
    pub fn stop(mut self) -> (Option<i32>, String) {
        drop(self.process.stdin.take());
        let status = wait_until("the end of a stage", || self.process.try_wait().unwrap());
        (status.code(), self.errors.all())
    }
}

impl Drop for StageAlone {
    fn drop(&mut self) {
        // What has ended already needs no killing.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Whether a process is there and not merely waiting to be reaped.
pub fn is_alive(process: Pid) -> bool {
    status_of(process).is_some_and(|status| status.state != 'Z')
}

/// Ids and program names of the living children of `parent`.
fn children_of(parent: u32) -> Vec<(Pid, String)> {
    let ids = std::fs::read_dir("/proc").unwrap().flatten();
    ids.filter_map(|entry| {
        let process = Pid::from_raw(entry.file_name().to_str()?.parse().ok()?);
        let status = status_of(process)?;
        if status.parent != parent || status.state == 'Z' {
            return None;
        }
        let command_line = std::fs::read(entry.path().join("cmdline")).ok()?;
        let program = String::from_utf8(command_line.split(|byte| *byte == 0).next()?.to_vec()).ok()?;
        Some((process, Path::new(&program).file_name()?.to_str()?.to_owned()))
    })
    .collect()
}

struct Status {
    state: char,
    parent: u32,
}

/// State and parent from `/proc/ID/stat`, whose fields follow the program's name in parentheses: proc(5).
fn status_of(process: Pid) -> Option<Status> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    Some(Status { state: fields.next()?.chars().next()?, parent: fields.next()?.parse().ok()? })
}
