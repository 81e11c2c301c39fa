//! Notes for all users of the machine, from a user who keeps others out of new files. A process has one umask and one
//! user, so this test has a process of its own.
#![allow(clippy::unwrap_used, reason = "helpers of tests may do what tests may")]

use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt;

use nix::sys::stat::{Mode, umask};
use nix::unistd::{Uid, geteuid, seteuid};
use tendon_paths::SharedFolder;

const OTHER_USER: u32 = 4242;

#[test]
fn a_note_is_for_all_whatever_the_umask_and_one_that_cannot_be_read_is_a_note_all_the_same() {
    umask(Mode::from_bits_truncate(0o077));
    let place = tempfile::tempdir().unwrap();
    std::fs::set_permissions(place.path(), Permissions::from_mode(0o755)).unwrap();
    let path = place.path().join("notes");
    let folder = SharedFolder::open(&path).unwrap();
    folder.leave_note("arm", "one").unwrap();
    let mine = geteuid();
    let note = path.join(format!("arm.{mine}"));
    assert_eq!(std::fs::metadata(&note).unwrap().permissions().mode() & 0o777, 0o644);

    std::fs::set_permissions(&note, Permissions::from_mode(0o000)).unwrap();
    // One in the name of somebody else is none, whether it can be read or not.
    let forged = path.join("arm.4243");
    std::fs::write(&forged, "forged").unwrap();
    std::fs::set_permissions(&forged, Permissions::from_mode(0o000)).unwrap();
    if mine.is_root() {
        // Root can read everything.
        seteuid(Uid::from_raw(OTHER_USER)).unwrap();
    }
    let notes = folder.notes("arm").unwrap();
    seteuid(mine).unwrap();
    assert_eq!(notes.into_iter().collect::<Vec<_>>(), [(mine.as_raw(), None)]);
}
