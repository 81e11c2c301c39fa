//! Which user's session a name stands for.

use std::ffi::CString;

use nix::unistd::{Gid, Uid, User, initgroups, setgid, setuid};
use tendon_paths::user_name;
use tendon_transport::{SessionName, own_user, running_sessions};

/// Why there is no session to look at.
#[derive(Debug, thiserror::Error)]
pub enum FindError {
    /// Somebody else's session.
    #[error("session `{session}` belongs to {owner}: only {owner} and root can look at it")]
    OtherOwner {
        /// Session name.
        session: SessionName,
        /// Name of the user who runs it.
        owner: String,
    },
    /// Several users run a session of that name.
    #[error("several users run a session `{session}`: choose one with --user: {users}")]
    Ambiguous {
        /// Session name.
        session: SessionName,
        /// Names of the users.
        users: String,
    },
    /// Root cannot act for the user.
    #[error("cannot act for {owner}")]
    Become {
        /// Name of the user.
        owner: String,
        /// The system's reason.
        source: nix::Error,
    },
}

/// Lets root look at a user's session: unless root or nobody runs one of this name, this process goes on as the user who
/// does, for good. So it trusts nothing that the user made with rights that the user does not have.
///
/// # Errors
///
/// [`FindError`] when the session is somebody else's, or several users run one of this name and `user` is not given.
pub fn become_owner(session: &SessionName, user: Option<u32>) -> Result<(), FindError> {
    let own = own_user();
    if user.unwrap_or(own) == own && session.supervisor(own).is_some() {
        return Ok(());
    }
    let running = running_sessions().into_iter().filter(|(_, name)| name == session);
    let users: Vec<u32> =
        running.map(|(owner, _)| owner).filter(|owner| user.is_none_or(|user| user == *owner)).collect();
    match users[..] {
        [] => Ok(()),
        [owner] if own == 0 => {
            become_user(owner).map_err(|source| FindError::Become { owner: user_name(owner), source })
        }
        [owner] => Err(FindError::OtherOwner { session: session.clone(), owner: user_name(owner) }),
        _ => {
            let users: Vec<String> = users.into_iter().map(user_name).collect();
            Err(FindError::Ambiguous { session: session.clone(), users: users.join(", ") })
        }
    }
}

fn become_user(user: u32) -> nix::Result<()> {
    let known = User::from_uid(Uid::from_raw(user))?;
    let group = known.as_ref().map_or(Gid::from_raw(user), |known| known.gid);
    match known.and_then(|known| CString::new(known.name).ok()) {
        Some(name) => initgroups(&name, group)?,
        None => nix::unistd::setgroups(&[])?,
    }
    setgid(group)?;
    setuid(Uid::from_raw(user))
}
