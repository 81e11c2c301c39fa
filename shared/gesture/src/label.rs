//! The six gestures of the paper (section "Gesture Classification").

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A gesture, rest included. The discriminant is the paper's class number `g0`..`g5` and the index of
/// the gesture's probability in a prediction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Gesture {
    /// No movement intended.
    Rest = 0,
    /// Wrist extension.
    Extension = 1,
    /// Wrist flexion.
    Flexion = 2,
    /// Ulnar deviation of the wrist.
    Ulnar = 3,
    /// Radial deviation of the wrist.
    Radial = 4,
    /// Power grip.
    Grip = 5,
}

impl Gesture {
    /// Number of gestures, rest included.
    pub const COUNT: usize = 6;

    /// All gestures in the order of their class numbers.
    pub const ALL: [Gesture; Gesture::COUNT] =
        [Gesture::Rest, Gesture::Extension, Gesture::Flexion, Gesture::Ulnar, Gesture::Radial, Gesture::Grip];

    /// The five active gestures, without rest.
    pub const ACTIVE: [Gesture; Gesture::COUNT - 1] =
        [Gesture::Extension, Gesture::Flexion, Gesture::Ulnar, Gesture::Radial, Gesture::Grip];

    /// The class number, `0` (rest) to `5` (grip).
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The gesture with this class number, `None` beyond 5.
    pub fn from_index(index: usize) -> Option<Gesture> {
        Gesture::ALL.get(index).copied()
    }

    /// The name used in configuration, reports and model metadata: `rest`, `extension`, `flexion`,
    /// `ulnar`, `radial` or `grip`.
    pub const fn name(self) -> &'static str {
        match self {
            Gesture::Rest => "rest",
            Gesture::Extension => "extension",
            Gesture::Flexion => "flexion",
            Gesture::Ulnar => "ulnar",
            Gesture::Radial => "radial",
            Gesture::Grip => "grip",
        }
    }
}

impl fmt::Display for Gesture {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

/// An unknown gesture name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown gesture `{0}`: use rest, extension, flexion, ulnar, radial or grip")]
pub struct UnknownGesture(pub String);

impl FromStr for Gesture {
    type Err = UnknownGesture;

    fn from_str(name: &str) -> Result<Gesture, UnknownGesture> {
        Gesture::ALL
            .into_iter()
            .find(|gesture| gesture.name() == name)
            .ok_or_else(|| UnknownGesture(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_gesture_is_found_by_its_name_and_number() {
        for gesture in Gesture::ALL {
            assert_eq!(gesture.name().parse(), Ok(gesture));
            assert_eq!(Gesture::from_index(gesture.index()), Some(gesture));
        }
        assert_eq!(Gesture::from_index(6), None);
        assert_eq!("fist".parse::<Gesture>(), Err(UnknownGesture("fist".into())));
    }
}
