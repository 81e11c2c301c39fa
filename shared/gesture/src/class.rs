//! What a classifier's outputs stand for.

use std::fmt;
use std::str::FromStr;

use crate::{Gesture, UnknownGesture};

/// What one output of a classifier stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Class {
    /// One gesture, which may be rest.
    Gesture(Gesture),
    /// Any of the five active gestures, which the first stage of the two-stage strategy separates from rest.
    Move,
}

impl Class {
    /// The classes of the two-stage strategy's first stage.
    pub const REST_MOVE: [Class; 2] = [Class::Gesture(Gesture::Rest), Class::Move];

    /// The name used in model metadata and reports: the gesture's, or `move`.
    pub const fn name(self) -> &'static str {
        match self {
            Class::Gesture(gesture) => gesture.name(),
            Class::Move => "move",
        }
    }

    /// Whether `gesture` belongs to this class.
    pub fn includes(self, gesture: Gesture) -> bool {
        match self {
            Class::Gesture(own) => own == gesture,
            Class::Move => gesture != Gesture::Rest,
        }
    }
}

impl fmt::Display for Class {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl FromStr for Class {
    type Err = UnknownGesture;

    fn from_str(name: &str) -> Result<Class, UnknownGesture> {
        if name == Class::Move.name() { Ok(Class::Move) } else { name.parse().map(Class::Gesture) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_found_by_name_and_include_their_gestures() {
        for class in Gesture::ALL.map(Class::Gesture).into_iter().chain([Class::Move]) {
            assert_eq!(class.name().parse(), Ok(class));
        }
        assert_eq!("fist".parse::<Class>(), Err(UnknownGesture("fist".into())));
        for gesture in Gesture::ALL {
            let [rest, movement] = Class::REST_MOVE.map(|class| class.includes(gesture));
            assert_eq!((rest, movement), (gesture == Gesture::Rest, gesture != Gesture::Rest));
        }
    }
}
