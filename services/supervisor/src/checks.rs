//! What keeps a session from running on this machine: `tendon run` refuses it, `tendon doctor` shows it.

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use tendon_config::Config;
use tendon_gesture::Gesture;
use tendon_messages::{
    BLOCKS, COMMANDS, MEASUREMENTS, PREDICTIONS, STATE_LENGTH, STATES, Stage, TWIST_LENGTH, WINDOWS,
};
use tendon_process::BATCH_LENGTH;
use tendon_transport::{required_bytes, shared_memory_directory};

/// Refuses a session that would run out of shared memory, because that kills the process which touches the
/// page that is missing (SIGBUS). Returns the free and the needed bytes.
///
/// # Errors
///
/// When there is too little, or none can be seen.
pub fn shared_memory(config: &Config) -> anyhow::Result<(u64, u64)> {
    let needed = required_bytes(&BLOCKS, config.block_length())
        + required_bytes(&WINDOWS, config.window_length())
        + required_bytes(&PREDICTIONS, Gesture::COUNT)
        + required_bytes(&COMMANDS, TWIST_LENGTH)
        + required_bytes(&STATES, STATE_LENGTH)
        + Stage::ALL.len() as u64 * required_bytes(&MEASUREMENTS, BATCH_LENGTH);
    let folder = shared_memory_directory();
    let status = nix::sys::statvfs::statvfs(folder)
        .with_context(|| format!("cannot look at {}: is it mounted?", folder.display()))?;
    let free = status.blocks_available() * status.fragment_size();
    let megabytes = |bytes: u64| bytes.div_ceil(1_000_000);
    ensure!(
        needed <= free,
        "{}: {} MB free, but the session may need {} MB: free some (`tendon doctor`), enlarge it (mount -o \
         remount,size=… {0}), or take fewer channels or shorter blocks",
        folder.display(),
        megabytes(free),
        megabytes(needed)
    );
    Ok((free, needed))
}

/// The folder of this program, in which all stages lie.
///
/// # Errors
///
/// With the names of those that are missing.
pub fn programs() -> anyhow::Result<PathBuf> {
    let program = std::env::current_exe().context("cannot find this program's own folder")?;
    let folder = program.parent().unwrap_or(Path::new("/")).to_owned();
    let missing: Vec<&str> = Stage::ALL
        .into_iter()
        .map(Stage::name)
        .filter(|name| !folder.join(format!("tendon-{name}")).is_file())
        .collect();
    ensure!(
        missing.is_empty(),
        "{} not in {}: build them with ./scripts/run or `cargo build --release`",
        missing.join(", "),
        folder.display()
    );
    Ok(folder)
}
