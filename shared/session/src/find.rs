//! Which user's session a name stands for.

use std::ffi::CString;

use nix::unistd::{Gid, Uid, User, initgroups, setgid, setuid};
use tendon_paths::user_name;
use tendon_transport::{FindError, SessionName, find_owner, own_user, running_sessions};

/// Why this process cannot look at a session.
#[derive(Debug, thiserror::Error)]
pub enum BecomeOwnerError {
    /// There is no such session, or it cannot be reached.
    #[error(transparent)]
    Find(#[from] FindError),
    /// Root cannot act for the user.
    #[error("cannot act for {owner}")]
    Become {
        /// Name of the user.
        owner: String,
        /// The system's reason.
        source: nix::Error,
    },
}

/// Lets root look at a user's session: unless it is root's own, this process goes on as the user who runs it, for good.
/// So it trusts nothing that the user made with rights that the user does not have.
///
/// # Errors
///
/// [`BecomeOwnerError`] when no session of this name can be reached: nobody's, or not that of `wanted`, if given.
pub fn become_owner(session: &SessionName, wanted: Option<u32>) -> Result<(), BecomeOwnerError> {
    let running = running_sessions().into_iter().filter(|(_, name)| name == session);
    let users: Vec<u32> = running.map(|(owner, _)| owner).collect();
    let owner = find_owner(session, &users, wanted)?;
    if owner == own_user() {
        return Ok(());
    }
    become_user(owner).map_err(|source| BecomeOwnerError::Become { owner: user_name(owner), source })
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
