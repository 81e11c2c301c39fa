//! Recorded sessions: where they lie, and their replays.

use std::path::{Path, PathBuf};

use tendon_transport::SessionName;

use crate::{Ended, TendonBuilder};

/// The file of the one session that was recorded to `folder`, once it is there.
pub fn file_in(folder: &Path) -> Option<PathBuf> {
    let session = std::fs::read_dir(folder).ok()?.next()?.ok()?;
    Some(session.path().join("session.mcap")).filter(|file| file.is_file())
}

/// Replays the file at full speed, recorded to `folder`, without allocating for any block; gives what the comparison of the two says.
pub fn replay_and_compare(name: &SessionName, file: &Path, folder: &Path, arguments: &[&str]) -> Ended {
    let session = name.to_string();
    let replay = TendonBuilder::command(name, &["run", "--session", &session, "--json", "report.json"]);
    let replay = replay.args(&["--pace", "full", "--realtime", "off"]).args(arguments);
    let replay = replay.arg("--replay").arg(file).arg("--record").arg(folder).end();
    assert_eq!(replay.exit_code, Some(0), "{replay:#?}");
    let allocations = &replay.report().allocations;
    // The facts of a task, which stand behind the last block, take three.
    assert!(allocations["acquisition"] <= 3, "{allocations:?}");
    TendonBuilder::command(name, &["compare"]).arg(file).arg(file_in(folder).unwrap()).end()
}
