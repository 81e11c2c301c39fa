//! Whom a recording is of. A person is somebody of a data set, or of your own recordings: there a number or a name tells who.
//!
//! ```text
//! 3DC, person 3          number 3 of the data set 3DC
//! labels.csv: 3          number 3 of your own recordings, who has nothing to do with 3DC's
//! labels.csv: anna       anna, as `tendon calibrate anna` writes it
//! ```
#![forbid(unsafe_code)]

use std::fmt;
use std::str::FromStr;

use serde::de::{self, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Longest name, in characters.
const LONGEST_NAME: usize = 40;

/// Who somebody is within a data set: a number or a name. Numbers come before names.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum PersonId {
    /// A number, as data sets count their people.
    Number(u16),
    /// A name that is no number.
    Name(Name),
}

/// 1 to 40 characters of `a-z 0-9 - _` that are no number.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name {
    /// ASCII, filled up with zeros.
    bytes: [u8; LONGEST_NAME],
}

impl Name {
    /// The name.
    pub fn as_str(&self) -> &str {
        let length = self.bytes.iter().position(|byte| *byte == 0).unwrap_or(LONGEST_NAME);
        std::str::from_utf8(&self.bytes[..length]).expect("names are ASCII")
    }
}

/// What identifies nobody.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` identifies no person: give a whole number of 0 to 65535, or a name of 1 to {LONGEST_NAME} of the characters \
     a-z 0-9 - _"
)]
pub struct NoPersonId(pub String);

impl FromStr for PersonId {
    type Err = NoPersonId;

    fn from_str(text: &str) -> Result<PersonId, NoPersonId> {
        if let Ok(number) = text.parse::<u16>()
            // `007` is not 7: two names stay two people.
            && number.to_string() == text
        {
            return Ok(PersonId::Number(number));
        }
        let fits = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_');
        if !(1..=LONGEST_NAME).contains(&text.len()) || !text.bytes().all(fits) {
            return Err(NoPersonId(text.to_owned()));
        }
        let mut bytes = [0; LONGEST_NAME];
        bytes[..text.len()].copy_from_slice(text.as_bytes());
        Ok(PersonId::Name(Name { bytes }))
    }
}

impl From<u16> for PersonId {
    fn from(number: u16) -> PersonId {
        PersonId::Number(number)
    }
}

impl PartialEq<u16> for PersonId {
    fn eq(&self, number: &u16) -> bool {
        *self == PersonId::Number(*number)
    }
}

impl fmt::Display for PersonId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PersonId::Number(number) => fmt::Display::fmt(number, out),
            PersonId::Name(name) => out.pad(name.as_str()),
        }
    }
}

impl fmt::Debug for PersonId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, out)
    }
}

impl Serialize for PersonId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            PersonId::Number(number) => serializer.serialize_u16(*number),
            PersonId::Name(name) => serializer.serialize_str(name.as_str()),
        }
    }
}

impl<'de> Deserialize<'de> for PersonId {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<PersonId, D::Error> {
        struct NumberOrName;

        impl Visitor<'_> for NumberOrName {
            type Value = PersonId;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("the number or the name of a person")
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<PersonId, E> {
                let number = u16::try_from(number);
                number.map(PersonId::Number).map_err(|_| E::custom("a person's number is at most 65535"))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<PersonId, E> {
                let number = u16::try_from(number);
                number.map(PersonId::Number).map_err(|_| E::custom("a person's number is 0 to 65535"))
            }

            // The keys of a map in JSON are strings, numbers among them.
            fn visit_str<E: de::Error>(self, text: &str) -> Result<PersonId, E> {
                text.parse().map_err(E::custom)
            }
        }

        deserializer.deserialize_any(NumberOrName)
    }
}

/// People, as messages name them: `1, 3, anna`.
pub fn list_of<'a>(people: impl IntoIterator<Item = &'a PersonId>) -> String {
    people.into_iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    fn id(text: &str) -> PersonId {
        text.parse().unwrap()
    }

    #[test]
    fn a_number_is_one_and_what_only_looks_like_one_is_a_name() {
        assert_eq!(id("7"), PersonId::Number(7));
        assert_ne!(id("007"), id("7"));
        assert_ne!(id("007"), id("07"));
        assert_eq!(id("70000").to_string(), "70000", "a name: no data set counts so far");
        let mut people = [id("ben"), id("10"), id("anna"), id("9")];
        people.sort();
        assert_eq!(list_of(&people), "9, 10, anna, ben");
        for text in ["", "Anna", "a b", "-é", &"x".repeat(41)] {
            let message = text.parse::<PersonId>().unwrap_err().to_string();
            assert!(message.contains(&format!("`{text}`")) && message.contains("a-z 0-9"), "{message}");
        }
    }

    #[test]
    fn in_json_a_number_stays_a_number_and_both_can_be_keys() {
        let people = [id("3"), id("anna")];
        assert_eq!(serde_json::to_string(&people).unwrap(), r#"[3,"anna"]"#);
        let counts: BTreeMap<PersonId, u64> = [(id("3"), 1), (id("anna"), 2)].into();
        let text = serde_json::to_string(&counts).unwrap();
        assert_eq!(text, r#"{"3":1,"anna":2}"#);
        assert_eq!(serde_json::from_str::<BTreeMap<PersonId, u64>>(&text).unwrap(), counts);
        for text in ["65536", "-1", "1.5", "\"Anna\"", "null"] {
            assert!(serde_json::from_str::<PersonId>(text).is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn everybody_is_found_by_what_is_shown_of_them(text in "[a-z0-9_-]{1,40}") {
            let person = id(&text);
            prop_assert_eq!(&person.to_string(), &text);
            let json = serde_json::to_string(&person).unwrap();
            prop_assert_eq!(serde_json::from_str::<PersonId>(&json).unwrap(), person);
        }
    }
}
