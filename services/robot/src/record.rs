//! The lasting record that an arm was left in good order, and the name by which one process owns it.
//!
//! ```text
//! session begins ─▶ take: read and remove ─▶ … ─▶ ends in good order ─▶ leave: write, at these joints
//!                        │                    └── stopped, killed, an error ─▶ there is none
//!                        └── none, unreadable: the arm waits for `tendon arm` ◀──┘
//! ```
//!
//! What permits a motion is a record that is there and matches; whatever goes wrong leaves none. It is a file for every
//! arm in the user's folder of lasting state, whatever the session is called.

use anyhow::Context;
use serde::{Deserialize, Serialize};
use tendon_arm::JointVector;
use tendon_control::Departure;
use tendon_paths::{PrivateFolder, state_folder};

/// What the file holds.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    left_in_good_order_at_joints_rad: [f64; 7],
}

/// The records of all arms of this user.
#[derive(Debug)]
pub struct Records {
    folder: PrivateFolder,
}

impl Records {
    /// Opens the user's folder of records.
    ///
    /// # Errors
    ///
    /// When it cannot be had, or not be trusted.
    pub fn open() -> anyhow::Result<Records> {
        let arms = state_folder().context("no folder for the record of the arm")?.path().join("arms");
        Records::of(PrivateFolder::open(&arms).context("no folder for the record of the arm")?)
    }

    fn of(folder: PrivateFolder) -> anyhow::Result<Records> {
        Ok(Records { folder })
    }

    /// Reads the record of an arm and removes it, so that nothing is left of it whatever happens next.
    ///
    /// # Errors
    ///
    /// When it cannot be removed: then nothing may move.
    pub fn take(&self, arm: &str) -> anyhow::Result<Departure> {
        let name = file_name(arm);
        let departure = match self.folder.read(&name) {
            Ok(None) => Departure::NoRecord,
            Ok(Some(bytes)) => match serde_json::from_slice(&bytes) {
                Ok(Contents { left_in_good_order_at_joints_rad }) => {
                    Departure::LeftAt(JointVector::from(left_in_good_order_at_joints_rad))
                }
                Err(error) => {
                    tracing::warn!("the record of how the arm was left cannot be read: {error}");
                    Departure::Unusable
                }
            },
            Err(error) => {
                tracing::warn!("the record of how the arm was left is not to be trusted: {error}");
                Departure::Unusable
            }
        };
        self.folder.remove(&name).context("cannot remove the record of how the arm was left")?;
        Ok(departure)
    }

    /// Writes that the arm was left in good order at these joint angles in rad.
    ///
    /// # Errors
    ///
    /// When it cannot be written; the arm then waits in the next session.
    pub fn leave(&self, arm: &str, joints_rad: &JointVector) -> anyhow::Result<()> {
        let contents = Contents { left_in_good_order_at_joints_rad: (*joints_rad).into() };
        let bytes = serde_json::to_vec(&contents).context("cannot write the record of the arm")?;
        self.folder.write(&file_name(arm), &bytes).context("cannot write the record of the arm")
    }
}

/// A name of letters, digits and a few signs, whatever an arm calls itself.
fn file_name(arm: &str) -> String {
    let safe = |character: char| if character.is_ascii_alphanumeric() { character } else { '-' };
    format!("{}.json", arm.chars().map(safe).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_there_once_and_what_is_none_of_ours_permits_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let records = Records::of(PrivateFolder::open(folder.path()).unwrap()).unwrap();
        let joints_rad = JointVector::from([0.0, -0.26, 0.0, 0.79, 0.0, 1.05, 0.0]);
        assert_eq!(records.take("XI1305 a/b").unwrap(), Departure::NoRecord);
        records.leave("XI1305 a/b", &joints_rad).unwrap();
        assert_eq!(records.take("another").unwrap(), Departure::NoRecord);
        assert_eq!(records.take("XI1305 a/b").unwrap(), Departure::LeftAt(joints_rad));
        assert_eq!(records.take("XI1305 a/b").unwrap(), Departure::NoRecord, "reading removes it");
        let file = folder.path().join(file_name("torn"));
        std::fs::write(&file, "{\"left_in_good_order_at_joints_rad\":[0.0,").unwrap();
        assert_eq!(records.take("torn").unwrap(), Departure::Unusable);
        assert!(!file.exists());
        std::os::unix::fs::symlink("/dev/null", &file).unwrap();
        assert_eq!(records.take("torn").unwrap(), Departure::Unusable, "a link is not followed");
        assert!(file.symlink_metadata().is_err());
    }
}
