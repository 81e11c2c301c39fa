//! Whose session a name stands for.

use tendon_paths::user_name;

use crate::session::{SessionName, own_user, running_sessions};

/// Why a name stands for no session that this user can reach.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum FindError {
    /// There is none.
    #[error(
        "no session `{session}` is running: start it with `tendon run`, or name another with --session{}",
        listed(.running)
    )]
    NotRunning {
        /// Session name.
        session: SessionName,
        /// Those that this user could name instead.
        running: Vec<SessionName>,
    },
    /// Somebody else's session.
    #[error("session `{session}` belongs to {owner}: only {owner} and root can look at it or give it orders")]
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
}

impl FindError {
    /// That no session of this name is running, and which are.
    pub fn not_running(session: &SessionName) -> FindError {
        let is_reached = |user: u32| user == own_user() || own_user() == 0;
        let running = running_sessions().into_iter().filter(|(user, _)| is_reached(*user));
        let mut running: Vec<SessionName> = running.map(|(_, name)| name).collect();
        running.sort_unstable_by_key(ToString::to_string);
        FindError::NotRunning { session: session.clone(), running }
    }
}

/// Sessions by name, behind a message.
fn listed(sessions: &[SessionName]) -> String {
    let names: Vec<String> = sessions.iter().map(ToString::to_string).collect();
    if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) }
}

/// Whose session of this name is meant, of the users that run one: `wanted`'s, if given; else one's own; else that of
/// the one user who runs one, which only root can reach.
///
/// # Errors
///
/// [`FindError`] when there is none, or it cannot be reached, or several may be meant.
pub fn find_owner(session: &SessionName, running: &[u32], wanted: Option<u32>) -> Result<u32, FindError> {
    choose(session, running, wanted, own_user())
}

fn choose(session: &SessionName, running: &[u32], wanted: Option<u32>, own: u32) -> Result<u32, FindError> {
    let preferred = wanted.unwrap_or(own);
    let session = session.clone();
    let owner = match running {
        _ if running.contains(&preferred) => preferred,
        [owner, ..] if wanted.is_none() && (own != 0 || running.len() == 1) => *owner,
        [_, ..] if wanted.is_none() => {
            let users: Vec<String> = running.iter().copied().map(user_name).collect();
            return Err(FindError::Ambiguous { session, users: users.join(", ") });
        }
        _ => return Err(FindError::not_running(&session)),
    };
    if owner == own || own == 0 {
        Ok(owner)
    } else {
        Err(FindError::OtherOwner { session, owner: user_name(owner) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_stands_for_ones_own_session_first_and_root_reaches_those_of_others() {
        let session: SessionName = "left".parse().unwrap();
        let choose = |running: &[u32], wanted, own| choose(&session, running, wanted, own);
        let is_not_running = |found| matches!(found, Err(FindError::NotRunning { .. }));
        assert_eq!(choose(&[1001, 1002], None, 1002), Ok(1002));
        assert!(is_not_running(choose(&[], None, 1002)));
        assert!(is_not_running(choose(&[1001], Some(1003), 0)));
        let running = ["left", "right"].map(|name| name.parse().unwrap()).to_vec();
        let said = FindError::NotRunning { session: session.clone(), running }.to_string();
        assert!(said.ends_with("or name another with --session (left, right)"), "{said}");
        assert!(matches!(choose(&[1001], None, 1002), Err(FindError::OtherOwner { .. })));
        assert!(matches!(choose(&[1001, 1003], None, 1002), Err(FindError::OtherOwner { .. })));
        assert!(matches!(choose(&[1001, 1002], Some(1001), 1002), Err(FindError::OtherOwner { .. })));
        assert_eq!(choose(&[1001], None, 0), Ok(1001));
        assert!(matches!(choose(&[1001, 1002], None, 0), Err(FindError::Ambiguous { .. })));
        assert_eq!(choose(&[1001, 1002], Some(1002), 0), Ok(1002));
        assert_eq!(choose(&[0, 1002], None, 0), Ok(0));
    }
}
