//! The name of a person, which is also that of a folder.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use tendon_identity::PersonId;

/// Longest name, in characters.
const LONGEST: usize = 40;

/// The name of a person: 1 to 40 characters of `a-z 0-9 - _`. A pseudonym is enough.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PersonName(String);

/// What is no name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is no name for a person: use 1 to {LONGEST} of the characters a-z 0-9 - _, such as anna or left-arm_2"
)]
pub struct InvalidName(pub String);

impl PersonName {
    /// The name of somebody of a data set.
    pub fn of(person: PersonId) -> PersonName {
        match person {
            PersonId::Number(number) => PersonName(format!("person-{number}")),
            PersonId::Name(name) => PersonName(name.as_str().to_owned()),
        }
    }

    /// Who it is among the people of this user.
    pub fn id(&self) -> PersonId {
        self.0.parse().expect("a name of a person identifies somebody")
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for PersonName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(&self.0)
    }
}

impl TryFrom<String> for PersonName {
    type Error = InvalidName;

    fn try_from(name: String) -> Result<PersonName, InvalidName> {
        let is_known =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-' || byte == b'_';
        if (1..=LONGEST).contains(&name.len()) && name.bytes().all(is_known) {
            Ok(PersonName(name))
        } else {
            Err(InvalidName(name))
        }
    }
}

impl FromStr for PersonName {
    type Err = InvalidName;

    fn from_str(name: &str) -> Result<PersonName, InvalidName> {
        PersonName::try_from(name.to_owned())
    }
}

impl From<PersonName> for String {
    fn from(name: PersonName) -> String {
        name.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_that_every_folder_can_have() {
        for name in ["anna", "a", "left-arm_2", "7", "007", "70000", &"x".repeat(40)] {
            let parsed: PersonName = name.parse().unwrap();
            assert_eq!((parsed.as_str(), parsed.id().to_string().as_str()), (name, name));
        }
        for name in ["", "Anna", "a b", "../a", "ä", ".", &"x".repeat(41)] {
            let message = name.parse::<PersonName>().unwrap_err().to_string();
            assert!(message.contains(&format!("`{name}`")), "{message}");
        }
    }
}
