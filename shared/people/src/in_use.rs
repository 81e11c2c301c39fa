//! Which people sessions use right now, so that nobody deletes them meanwhile.
//!
//! ```text
//! tendon run --person anna ── holds ──▶ tendon-person.UID.anna.PROCESS   a name in the kernel, gone with the process
//! tendon delete anna ──────── looks for tendon-person.UID.anna.*
//! ```

use nix::unistd::geteuid;
use tendon_paths::{Claim, ClaimError, Holder, claimed_names};

use crate::name::PersonName;

/// Says that this process uses a person, until it is dropped or the process ends.
#[derive(Debug)]
pub struct PersonInUse {
    _claim: Claim,
}

impl PersonInUse {
    /// Begins to say so.
    ///
    /// # Errors
    ///
    /// [`ClaimError`] if the system refuses, or this process says so already.
    pub fn claim(name: &PersonName) -> Result<PersonInUse, ClaimError> {
        let claim = Claim::take(&format!("{}{}", prefix(name), std::process::id()), "")?;
        Ok(PersonInUse { _claim: claim })
    }
}

/// A process of this user that uses the person; `None` if there is none.
pub fn user_of_person(name: &PersonName) -> Option<i32> {
    let holders = claimed_names(&prefix(name)).into_iter().filter_map(|claim| Holder::of(&claim));
    let own = geteuid().as_raw();
    holders.into_iter().find(|holder| holder.user == own).map(|holder| holder.process_id)
}

/// What the names of all claims on a person begin with. A person's name has no dot.
fn prefix(name: &PersonName) -> String {
    format!("tendon-person.{}.{name}.", geteuid().as_raw())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_is_in_use_until_the_session_ends() {
        let name: PersonName = format!("test-{}", std::process::id()).parse().unwrap();
        let longer: PersonName = format!("{name}-2").parse().unwrap();
        assert_eq!(user_of_person(&name), None);
        let in_use = PersonInUse::claim(&name).unwrap();
        assert_eq!(user_of_person(&name), Some(std::process::id() as i32));
        assert_eq!(user_of_person(&longer), None);
        drop(in_use);
        assert_eq!(user_of_person(&name), None);
    }
}
