//! Two users on one machine, and folders that somebody planted. The tests with a second user need root, and say so
//! otherwise.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may do what tests may")]

use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, geteuid};
use tempfile::TempDir;
use tendon_system_tests::{TendonBuilder, arm, unique_session, wait_until};
use tendon_transport::SessionName;

/// The user `nobody`.
const OTHER_USER: u32 = 65_534;

/// A folder whose path is short enough for sockets in it.
fn short_folder() -> TempDir {
    let folder = tempfile::Builder::new().prefix("t").rand_bytes(4).tempdir_in("/tmp").unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o700)).unwrap();
    folder
}

/// A session of another user.
struct OthersSession {
    session: SessionName,
    process: Child,
    folder: TempDir,
}

impl OthersSession {
    fn start() -> OthersSession {
        let session = unique_session();
        let (mut command, folder) = TendonBuilder::run(&session).into_command(false);
        chown(folder.path(), Some(OTHER_USER), Some(OTHER_USER)).unwrap();
        command.env("HOME", folder.path()).env_remove("XDG_RUNTIME_DIR").env_remove("XDG_STATE_HOME");
        command.uid(OTHER_USER).gid(OTHER_USER).stdin(Stdio::null()).stdout(Stdio::null());
        let process = command.spawn().unwrap();
        let mut others = OthersSession { session, process, folder };
        wait_until("another user's session", || {
            assert!(others.process.try_wait().unwrap().is_none(), "it ended early");
            let running =
                tendon_transport::running_sessions().contains(&(OTHER_USER, others.session.clone()));
            let stop =
                || TendonBuilder::command(&unique_session(), &["stop", "--session", &others.name()]).end();
            (running && stop().exit_code == Some(0)).then_some(())
        });
        others
    }

    fn name(&self) -> String {
        self.session.to_string()
    }

    fn end(mut self) {
        kill(Pid::from_raw(self.process.id() as i32), Signal::SIGTERM).unwrap();
        let status = wait_until("the end of another user's session", || self.process.try_wait().unwrap());
        assert_eq!(status.code(), Some(0));
        assert!(self.folder.path().join("report.json").is_file());
    }
}

impl Drop for OthersSession {
    fn drop(&mut self) {
        if let Ok(None) = self.process.try_wait() {
            let _ = kill(Pid::from_raw(self.process.id() as i32), Signal::SIGTERM);
            let _ = self.process.wait();
        }
    }
}

#[test]
fn root_finds_a_users_session_and_leaves_it_alone() {
    if !geteuid().is_root() {
        return println!("skipped: it needs root");
    }
    let others = OthersSession::start();
    let name = others.name();
    let run = |arguments: &[&str]| TendonBuilder::command(&unique_session(), arguments).end();
    let stopped = run(&["stop", "--session", &name]);
    assert!(stopped.output.contains("the arm is stopped"), "{stopped:#?}");
    assert_eq!(arm(&others.session).exit_code, Some(0));
    let latency = run(&["latency", "--session", &name, "--interval", "300ms", "--duration", "1s"]);
    assert_eq!(latency.exit_code, Some(0), "{latency:#?}");
    assert!(latency.output.contains("acquisition to dsp"), "{latency:#?}");

    let cleaned = run(&["doctor", "--clean"]);
    assert!(!cleaned.output.contains(&format!("`{name}`")), "{cleaned:#?}");
    // A session of the same name, of root's own.
    let own = TendonBuilder::run(&others.session).args(&["--duration", "2s"]).end().report();
    assert!(own.messages["commands"].published > 0, "{own:#?}");
    // The other still runs, and is found.
    assert_eq!(run(&["stop", "--session", &name]).exit_code, Some(0));
    others.end();
}

#[test]
fn a_folder_that_was_planted_is_refused_by_name() {
    let given = short_folder();
    let target = given.path().join("target");
    std::fs::create_dir(&target).unwrap();
    symlink(&target, given.path().join("tendon")).unwrap();
    let run = |folder: &Path| {
        let builder = TendonBuilder::run(&unique_session()).args(&["--duration", "1s"]);
        builder.env("XDG_RUNTIME_DIR", folder).end()
    };
    let folder = given.path().join("tendon");
    run(given.path()).assert_failed(2, &[folder.to_str().unwrap(), "is a link"]);
    assert_eq!(std::fs::read_dir(&target).unwrap().count(), 0, "something was written through the link");
    std::fs::remove_file(&folder).unwrap();
    if geteuid().is_root() {
        std::fs::create_dir(&folder).unwrap();
        chown(&folder, Some(OTHER_USER), None).unwrap();
        run(given.path()).assert_failed(2, &[folder.to_str().unwrap(), "belongs to"]);
        std::fs::remove_dir(&folder).unwrap();
    }
    // In a good one the session runs, and its sockets fit.
    assert_eq!(run(given.path()).exit_code, Some(0));
    assert!(folder.is_dir());
}

#[test]
fn a_session_is_found_though_the_environment_differs_and_its_files_were_deleted() {
    let given = short_folder();
    let builder = TendonBuilder::run(&unique_session()).env("XDG_RUNTIME_DIR", given.path());
    let mut tendon = builder.start();
    tendon.wait_until_running();
    let name = tendon.session().to_string();
    let run = |arguments: &[&str]| TendonBuilder::command(&unique_session(), arguments).end();
    let latency = run(&["latency", "--session", &name, "--interval", "300ms", "--duration", "1s"]);
    assert!(latency.output.contains("acquisition to dsp"), "{latency:#?}");
    std::fs::remove_dir_all(given.path().join("tendon")).unwrap();
    wait_until("the session to miss its folder", || {
        tendon.errors_so_far().contains("tendon was deleted while the session ran").then_some(())
    });
    run(&["latency", "--session", &name]).assert_failed(1, &[&name, "are gone", "start it again"]);
    assert!(run(&["stop", "--session", &name]).output.contains("the arm is stopped"));
    // Its namesake is still running, so files are left.
    TendonBuilder::run(tendon.session())
        .start()
        .end_whatever_is_left()
        .assert_failed(2, &["in use by process", &tendon.id().to_string()]);
    tendon.signal(Signal::SIGTERM);
    assert_eq!(tendon.end().exit_code, Some(0));
}
