//! Gestures are labels: the paper's six, or whatever a person makes.

use std::cmp::Ordering;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Length of the longest name of a gesture, in characters.
pub const LONGEST_NAME: usize = 23;

/// What a person does with the hand, or rest, by its name: `extension`, `thumb_up`, …
///
/// The constants are the gestures of the paper (section "Gesture Classification"). In order, they come first, as the
/// paper numbers them; others follow by name.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Gesture {
    /// ASCII, filled up with zeros.
    bytes: [u8; LONGEST_NAME],
}

impl Gesture {
    /// No movement intended.
    pub const REST: Gesture = Gesture::of("rest");
    /// Wrist extension.
    pub const EXTENSION: Gesture = Gesture::of("extension");
    /// Wrist flexion.
    pub const FLEXION: Gesture = Gesture::of("flexion");
    /// Ulnar deviation of the wrist.
    pub const ULNAR: Gesture = Gesture::of("ulnar");
    /// Radial deviation of the wrist.
    pub const RADIAL: Gesture = Gesture::of("radial");
    /// Power grip.
    pub const GRIP: Gesture = Gesture::of("grip");

    /// The six gestures of the paper, in the order of their class numbers `g0` to `g5`.
    pub const PAPER: [Gesture; 6] =
        [Gesture::REST, Gesture::EXTENSION, Gesture::FLEXION, Gesture::ULNAR, Gesture::RADIAL, Gesture::GRIP];

    /// The five active gestures of the paper, without rest.
    pub const PAPER_ACTIVE: [Gesture; 5] =
        [Gesture::EXTENSION, Gesture::FLEXION, Gesture::ULNAR, Gesture::RADIAL, Gesture::GRIP];

    /// A name that is known to be short enough.
    const fn of(name: &str) -> Gesture {
        let mut bytes = [0; LONGEST_NAME];
        let mut at = 0;
        while at < name.len() {
            bytes[at] = name.as_bytes()[at];
            at += 1;
        }
        Gesture { bytes }
    }

    /// The name used in configuration, recordings, reports and models.
    pub fn name(&self) -> &str {
        let length = self.bytes.iter().position(|byte| *byte == 0).unwrap_or(LONGEST_NAME);
        std::str::from_utf8(&self.bytes[..length]).expect("names are ASCII")
    }

    /// The paper's class number, `0` (rest) to `5` (grip); `None` of other gestures.
    pub fn paper_number(self) -> Option<u8> {
        Gesture::PAPER.iter().position(|gesture| *gesture == self).map(|number| number as u8)
    }
}

impl Ord for Gesture {
    fn cmp(&self, other: &Gesture) -> Ordering {
        let place = |gesture: &Gesture| gesture.paper_number().unwrap_or(u8::MAX);
        place(self).cmp(&place(other)).then(self.bytes.cmp(&other.bytes))
    }
}

impl PartialOrd for Gesture {
    fn partial_cmp(&self, other: &Gesture) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl fmt::Display for Gesture {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl fmt::Debug for Gesture {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// What cannot be the name of a gesture.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` cannot be the name of a gesture: take 1 to 23 characters of a-z, 0-9, - and _")]
pub struct NoGestureName(pub String);

impl FromStr for Gesture {
    type Err = NoGestureName;

    fn from_str(name: &str) -> Result<Gesture, NoGestureName> {
        let fits = |byte: u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_');
        if (1..=LONGEST_NAME).contains(&name.len()) && name.bytes().all(fits) {
            Ok(Gesture::of(name))
        } else {
            Err(NoGestureName(name.to_owned()))
        }
    }
}

impl TryFrom<String> for Gesture {
    type Error = NoGestureName;

    fn try_from(name: String) -> Result<Gesture, NoGestureName> {
        name.parse()
    }
}

impl From<Gesture> for String {
    fn from(gesture: Gesture) -> String {
        gesture.name().to_owned()
    }
}

/// A name that is none of the gestures that can be meant.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown gesture `{name}`: use one of {}", .known.iter().map(Gesture::name).collect::<Vec<_>>().join(", "))]
pub struct UnknownGesture {
    /// The name.
    pub name: String,
    /// The gestures that can be meant.
    pub known: Vec<Gesture>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{prop_assert, prop_assert_eq, proptest};

    #[test]
    fn the_papers_gestures_keep_their_order_and_come_first() {
        let mut gestures = vec!["fist".parse().unwrap(), Gesture::GRIP, Gesture::REST, Gesture::ULNAR];
        gestures.sort();
        assert_eq!(gestures, [Gesture::REST, Gesture::ULNAR, Gesture::GRIP, "fist".parse().unwrap()]);
        let numbers = Gesture::PAPER.map(|gesture| gesture.paper_number().unwrap());
        assert_eq!(numbers, [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn names_that_cannot_be_written_everywhere_are_refused() {
        for name in ["", "Fist", "thumb up", "é", "a-name-of-24-characters-"] {
            assert_eq!(name.parse::<Gesture>(), Err(NoGestureName(name.into())));
        }
    }

    proptest! {
        #[test]
        fn every_gesture_is_found_by_its_name(name in "[a-z0-9_-]{1,23}") {
            let gesture: Gesture = name.parse().unwrap();
            prop_assert_eq!(gesture.name(), &name);
            let json = serde_json::to_string(&gesture).unwrap();
            prop_assert_eq!(serde_json::from_str::<Gesture>(&json).unwrap(), gesture);
            prop_assert!(gesture >= Gesture::REST);
        }
    }
}
