//! Whether an arm on the network was left in good order.
//!
//! ```text
//! session begins ─▶ mark ─▶ … ─▶ ends, arm free to move ─▶ no mark
//!                    │                └── arm stopped, or a process killed ─▶ mark stays ─┐
//!                    └── was there before: the arm stays where it is until it is armed ◀──┘
//! ```
//!
//! A real arm stays stopped over the end of a session, however that ended: nobody knows where it stands and what is in
//! its way to the start position. The mark is a file of its own for every arm, whatever the session is called.

use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;

use anyhow::Context;
use tendon_config::XArmSettings;
use tendon_paths::runtime_folder;

/// The mark of one arm.
#[derive(Debug)]
pub struct ArmMark {
    path: PathBuf,
    was_there: bool,
}

impl ArmMark {
    /// Marks the arm as in use.
    ///
    /// # Errors
    ///
    /// When the file cannot be made.
    pub fn set(arm: &XArmSettings) -> anyhow::Result<ArmMark> {
        let address = arm.address.context("robot.xarm.address is missing")?;
        let path = runtime_folder()?.path().join(format!("arm-{address}-{}", arm.control_port));
        let was_there = match fs::File::create_new(&path) {
            Ok(_) => false,
            Err(error) if error.kind() == ErrorKind::AlreadyExists => true,
            Err(error) => return Err(error).with_context(|| format!("cannot write {}", path.display())),
        };
        Ok(ArmMark { path, was_there })
    }

    /// Whether the arm was not left in good order before.
    pub fn was_there(&self) -> bool {
        self.was_there
    }

    /// The arm is left in good order.
    ///
    /// # Errors
    ///
    /// When the file cannot be removed.
    pub fn remove(self) -> anyhow::Result<()> {
        fs::remove_file(&self.path).with_context(|| format!("cannot remove {}", self.path.display()))
    }
}
