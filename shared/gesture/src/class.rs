//! What a classifier's outputs stand for.

use std::fmt;
use std::str::FromStr;

use crate::{Gesture, NoGestureName};

/// What one output of a classifier stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Class {
    /// One gesture, which may be rest.
    Gesture(Gesture),
    /// Any gesture but rest, which the first stage of the two-stage strategy separates from rest.
    Move,
}

impl Class {
    /// The classes of the two-stage strategy's first stage.
    pub const REST_MOVE: [Class; 2] = [Class::Gesture(Gesture::REST), Class::Move];

    /// The name used in model metadata and reports: the gesture's, or `move`.
    pub fn name(&self) -> &str {
        match self {
            Class::Gesture(gesture) => gesture.name(),
            Class::Move => "move",
        }
    }

    /// Whether `gesture` belongs to this class.
    pub fn includes(self, gesture: Gesture) -> bool {
        match self {
            Class::Gesture(own) => own == gesture,
            Class::Move => gesture != Gesture::REST,
        }
    }
}

impl fmt::Display for Class {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.pad(self.name())
    }
}

impl FromStr for Class {
    type Err = NoGestureName;

    fn from_str(name: &str) -> Result<Class, NoGestureName> {
        if name == Class::Move.name() { Ok(Class::Move) } else { name.parse().map(Class::Gesture) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_found_by_name_and_include_their_gestures() {
        for class in Gesture::PAPER.map(Class::Gesture).into_iter().chain([Class::Move]) {
            assert_eq!(class.name().parse(), Ok(class));
        }
        assert_eq!("Fist".parse::<Class>(), Err(NoGestureName("Fist".into())));
        for gesture in Gesture::PAPER {
            let [rest, movement] = Class::REST_MOVE.map(|class| class.includes(gesture));
            assert_eq!((rest, movement), (gesture == Gesture::REST, gesture != Gesture::REST));
        }
    }
}
