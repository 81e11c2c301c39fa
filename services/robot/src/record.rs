//! The lasting record that an arm was left in good order.
//!
//! ```text
//! session begins ─▶ take: read and remove ─▶ … ─▶ ends in good order ─▶ leave: write, at these joints
//!                        │                    └── stopped, killed, an error ─▶ there is none
//!                        └── none, unreadable: the arm waits for `tendon arm` ◀──┘
//!
//! stopped or abandoned before it is known which arm is there ─▶ forget_all: it may be any of this user's
//!
//! /var/tmp/tendon-arms/SERIAL.UID   a token of the newest session of each user on that arm
//! ```
//!
//! What permits a motion is a record that is there and matches; whatever goes wrong leaves none. It is a file for every
//! arm in the user's folder of lasting state, whatever the session is called. It holds the tokens of all users at that
//! time: a session of anybody that has had the arm since makes it worthless.

use std::collections::BTreeMap;

use anyhow::Context;
use serde::{Deserialize, Serialize};
use tendon_arm::JointVector;
use tendon_control::Departure;
use tendon_paths::{PrivateFolder, SharedFolder, arm_record_folder, shared_arm_folder};
use tendon_transport::own_user;

/// A new random token for every reader (random(4)).
const RANDOM: &str = "/proc/sys/kernel/random/uuid";

/// What the file holds.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    left_in_good_order_at_joints_rad: [f64; 7],
    /// The token of each user's newest session on the arm.
    tokens: BTreeMap<u32, String>,
}

/// The records of all arms of this user.
#[derive(Debug)]
pub struct Records {
    folder: PrivateFolder,
    tokens: SharedFolder,
    /// The token that this session has left on the arm it took.
    token: Option<String>,
}

impl Records {
    /// Opens the user's folder of records.
    ///
    /// # Errors
    ///
    /// When it cannot be had, or not be trusted.
    pub fn open() -> anyhow::Result<Records> {
        let failed = "no folder for the record of the arm";
        Ok(Records {
            folder: arm_record_folder().context(failed)?,
            tokens: shared_arm_folder().context(failed)?,
            token: None,
        })
    }

    /// Reads the record of an arm and removes it, so that nothing is left of it whatever happens next. From now on the
    /// records of other users permit nothing either.
    ///
    /// # Errors
    ///
    /// When either cannot be done: then nothing may move.
    pub fn take(&mut self, arm: &str) -> anyhow::Result<Departure> {
        let arm = safe_name(arm);
        let name = format!("{arm}.json");
        let tokens = self.tokens_of(&arm)?;
        let departure = match self.folder.read(&name) {
            Ok(None) => Departure::NoRecord,
            Ok(Some(bytes)) => match serde_json::from_slice::<Contents>(&bytes) {
                Ok(contents) if Some(&contents.tokens) != tokens.as_ref() => {
                    tracing::warn!("another session has used the arm since this user left it in good order");
                    Departure::UsedSince
                }
                Ok(contents) => {
                    Departure::LeftAt(JointVector::from(contents.left_in_good_order_at_joints_rad))
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
        let token = std::fs::read_to_string(RANDOM).context("no random numbers")?;
        self.tokens
            .leave_note(&arm, token.trim())
            .context("cannot tell other users that the arm is in use")?;
        self.token = Some(token.trim().to_owned());
        Ok(departure)
    }

    /// Removes the records of all arms of this user: a stop was ordered, and nobody knows of which.
    ///
    /// # Errors
    ///
    /// When one cannot be removed.
    pub fn forget_all(&self) -> anyhow::Result<()> {
        let failed = "cannot remove the records of how the arms were left";
        let names = self.folder.names().context(failed)?;
        // All are removed, whatever becomes of the others.
        let results: Vec<_> = names
            .iter()
            .filter(|name| name.ends_with(".json"))
            .map(|name| self.folder.remove(name))
            .collect();
        results.into_iter().collect::<Result<(), _>>().context(failed)
    }

    /// The tokens of all users' newest sessions on the arm; `None` if one of them cannot be read.
    fn tokens_of(&self, arm: &str) -> anyhow::Result<Option<BTreeMap<u32, String>>> {
        let notes = self.tokens.notes(arm).context("cannot see who has used the arm")?;
        if let Some(user) = notes.iter().find_map(|(user, note)| note.is_none().then_some(user)) {
            tracing::warn!("user {user} has used the arm, but keeps others from seeing when: it will wait");
        }
        Ok(notes.into_iter().map(|(user, note)| Some((user, note?))).collect())
    }

    /// Writes that the arm that was taken was left in good order at these joint angles in rad. While the token of another
    /// user cannot be read, or if this session's own is gone, it writes nothing: nobody can tell then who has used the arm
    /// meanwhile, and it waits in the next session.
    ///
    /// # Errors
    ///
    /// When it cannot be written; the arm then waits in the next session.
    pub fn leave(&self, arm: &str, joints_rad: &JointVector) -> anyhow::Result<()> {
        let arm = safe_name(arm);
        let Some(tokens) = self.tokens_of(&arm)? else { return Ok(()) };
        if self.token.is_none() || tokens.get(&own_user()) != self.token.as_ref() {
            tracing::warn!(
                "this session's note that it has used the arm was removed: the next session waits"
            );
            return Ok(());
        }
        let contents = Contents { left_in_good_order_at_joints_rad: (*joints_rad).into(), tokens };
        let bytes = serde_json::to_vec(&contents).context("cannot write the record of the arm")?;
        self.folder.write(&format!("{arm}.json"), &bytes).context("cannot write the record of the arm")
    }
}

/// A name of letters, digits and hyphens, whatever an arm calls itself.
fn safe_name(arm: &str) -> String {
    let safe = |character: char| if character.is_ascii_alphanumeric() { character } else { '-' };
    arm.chars().map(safe).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    impl Records {
        fn of(arms: &Path, tokens: &Path) -> anyhow::Result<Records> {
            let (folder, tokens) = (PrivateFolder::open(arms)?, SharedFolder::open(tokens)?);
            Ok(Records { folder, tokens, token: None })
        }
    }

    #[test]
    fn a_record_is_there_once_and_what_is_none_of_ours_permits_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut records = Records::of(folder.path(), &folder.path().join("tokens")).unwrap();
        let joints_rad = JointVector::from([0.0, -0.26, 0.0, 0.79, 0.0, 1.05, 0.0]);
        assert_eq!(records.take("XI1305 a/b").unwrap(), Departure::NoRecord);
        records.leave("XI1305 a/b", &joints_rad).unwrap();
        assert_eq!(records.take("another").unwrap(), Departure::NoRecord);
        assert_eq!(records.take("XI1305 a/b").unwrap(), Departure::LeftAt(joints_rad));
        assert_eq!(records.take("XI1305 a/b").unwrap(), Departure::NoRecord, "reading removes it");
        let file = folder.path().join("torn.json");
        std::fs::write(&file, "{\"left_in_good_order_at_joints_rad\":[0.0,").unwrap();
        assert_eq!(records.take("torn").unwrap(), Departure::Unusable);
        std::fs::write(&file, r#"{"left_in_good_order_at_joints_rad":[0,0,0,0,0,0,0]}"#).unwrap();
        assert_eq!(
            records.take("torn").unwrap(),
            Departure::Unusable,
            "it does not say who had used the arm"
        );
        assert!(!file.exists());
        std::os::unix::fs::symlink("/dev/null", &file).unwrap();
        assert_eq!(records.take("torn").unwrap(), Departure::Unusable, "a link is not followed");
        assert!(file.symlink_metadata().is_err());
    }

    #[test]
    fn a_session_of_anybody_since_makes_a_record_worthless() {
        let place = tempfile::tempdir().unwrap();
        let tokens = place.path().join("tokens");
        let [mut mine, mut others] =
            ["mine", "others"].map(|user| Records::of(&place.path().join(user), &tokens).unwrap());
        let joints_rad = JointVector::zeros();
        mine.take("XI1305").unwrap();
        mine.leave("XI1305", &joints_rad).unwrap();
        // A session on another arm is no reason.
        others.take("XI1306").unwrap();
        assert_eq!(mine.take("XI1305").unwrap(), Departure::LeftAt(joints_rad));
        mine.leave("XI1305", &joints_rad).unwrap();
        others.take("XI1305").unwrap();
        assert_eq!(mine.take("XI1305").unwrap(), Departure::UsedSince);
        mine.leave("XI1305", &joints_rad).unwrap();
        // Nor does it help to remove the tokens.
        std::fs::remove_dir_all(&tokens).unwrap();
        let mut mine = Records::of(&place.path().join("mine"), &tokens).unwrap();
        assert_eq!(mine.take("XI1305").unwrap(), Departure::UsedSince);
    }

    #[test]
    fn a_session_whose_own_token_is_gone_leaves_no_record() {
        let place = tempfile::tempdir().unwrap();
        let tokens = place.path().join("tokens");
        let mut records = Records::of(&place.path().join("arms"), &tokens).unwrap();
        records.take("XI1305").unwrap();
        std::fs::remove_file(tokens.join(format!("XI1305.{}", own_user()))).unwrap();
        records.leave("XI1305", &JointVector::zeros()).unwrap();
        assert_eq!(records.take("XI1305").unwrap(), Departure::NoRecord);
    }

    #[test]
    fn a_stop_of_nobody_knows_which_arm_forgets_all() {
        let place = tempfile::tempdir().unwrap();
        let mut records = Records::of(&place.path().join("arms"), &place.path().join("tokens")).unwrap();
        for arm in ["XI1305", "XI1306"] {
            records.take(arm).unwrap();
            records.leave(arm, &JointVector::zeros()).unwrap();
        }
        records.forget_all().unwrap();
        for arm in ["XI1305", "XI1306"] {
            assert_eq!(records.take(arm).unwrap(), Departure::NoRecord);
        }
        records.forget_all().unwrap();
    }
}
