//! Two users on one machine: neither reaches what is the other's. What root may do is in `users.rs`.
//!
//! The tests run programs as two users who need not exist. They need root, programs that every user may run, and
//! `setpriv` (util-linux).
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests may do what tests may")]

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use nix::sys::signal::Signal;
use nix::unistd::{Gid, Uid, chown, geteuid};
use tendon_system_tests::{TendonBuilder, program, unique_session, wait_until};

/// Each test has users of its own, so that all can run at a time.
fn users(number: u32) -> [u32; 2] {
    [61_000 + 2 * number, 61_001 + 2 * number]
}

/// Whether programs can be run as other users here.
fn is_possible() -> bool {
    let tendon = program("tendon");
    let mut trial = Command::new("setpriv");
    trial.args(["--reuid", "61000", "--regid", "61000", "--clear-groups"]).arg(tendon).arg("--version");
    let possible = geteuid().is_root() && trial.output().is_ok_and(|output| output.status.success());
    if !possible {
        println!("skipped: needs root, setpriv, and programs that every user may run");
    }
    possible
}

fn give_to(path: &Path, user: u32) {
    chown(path, Some(Uid::from_raw(user)), Some(Gid::from_raw(user))).unwrap();
}

/// Where a user without a run-time folder of the system's has it.
fn runtime_folder(user: u32) -> PathBuf {
    PathBuf::from(format!("/tmp/tendon-{user}"))
}

#[test]
fn a_run_time_folder_that_somebody_else_made_is_refused() {
    if !is_possible() {
        return;
    }
    let [user, other] = users(1);
    let folder = runtime_folder(user);
    let _ = fs::remove_dir_all(&folder);
    let session = unique_session();
    let precious = tempfile::NamedTempFile::new().unwrap();
    fs::write(precious.path(), "precious").unwrap();
    give_to(precious.path(), user);
    fs::create_dir(&folder).unwrap();
    symlink(precious.path(), folder.join(format!("lock.{session}"))).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o777)).unwrap();
    give_to(&folder, other);
    let ended = TendonBuilder::run(&session).args(&["--duration", "1s"]).as_user(user).end();
    ended.assert_failed(2, &[&folder.display().to_string(), "belongs to"]);
    assert_eq!(fs::read_to_string(precious.path()).unwrap(), "precious");
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn nobody_else_can_change_the_files_of_a_session() {
    if !is_possible() {
        return;
    }
    let [user, _] = users(2);
    let folder = runtime_folder(user);
    let _ = fs::remove_dir_all(&folder);
    let mut tendon = TendonBuilder::run(&unique_session()).as_user(user).start();
    tendon.wait_until_running();
    let metadata = fs::symlink_metadata(&folder).unwrap();
    assert_eq!((metadata.uid(), metadata.mode() & 0o777), (user, 0o700));
    tendon.signal(Signal::SIGTERM);
    tendon.end().report();
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn two_users_may_give_their_sessions_the_same_name_and_stop_only_their_own() {
    if !is_possible() {
        return;
    }
    let [user, other] = users(3);
    let session = unique_session();
    let name = session.to_string();
    let mut tendon = TendonBuilder::run(&session).as_user(user).start();
    tendon.wait_until_running();
    let refused =
        TendonBuilder::command(&unique_session(), &["stop", "--session", &name]).as_user(other).end();
    refused.assert_failed(2, &["belongs to", "root can look at it or give it orders"]);
    TendonBuilder::run(&session).args(&["--duration", "2s"]).as_user(other).end().report();
    wait_until("the first session to go on", || (!tendon.has_ended()).then_some(()));
    tendon.signal(Signal::SIGTERM);
    tendon.end().report();
    for user in [user, other] {
        let _ = fs::remove_dir_all(runtime_folder(user));
    }
}
