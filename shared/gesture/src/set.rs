//! The gestures of a session, and their class numbers.

use serde::{Deserialize, Serialize};

use crate::{Gesture, UnknownGesture};

/// The gestures of a session. A gesture's place is its class number: the index of its probability in a prediction, and
/// what stands for it in the header of a message. Rest has number 0.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Gesture>", into = "Vec<Gesture>")]
pub struct GestureSet {
    gestures: Vec<Gesture>,
}

/// Gestures that cannot be those of a session.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidGestureSet {
    /// Rest is not first.
    #[error("rest must be the first of the gestures")]
    RestNotFirst,
    /// Too few or too many.
    #[error("{0} gestures beside rest: take 1 to 12")]
    Count(usize),
    /// One is there twice.
    #[error("the gesture {0} is there twice")]
    Twice(Gesture),
}

impl GestureSet {
    /// Most gestures, rest included.
    pub const MAXIMUM: usize = 13;

    /// These gestures, rest first.
    ///
    /// # Errors
    ///
    /// [`InvalidGestureSet`], with what is wrong.
    pub fn new(gestures: Vec<Gesture>) -> Result<GestureSet, InvalidGestureSet> {
        if gestures.first() != Some(&Gesture::REST) {
            return Err(InvalidGestureSet::RestNotFirst);
        }
        if !(2..=GestureSet::MAXIMUM).contains(&gestures.len()) {
            return Err(InvalidGestureSet::Count(gestures.len() - 1));
        }
        match gestures.iter().enumerate().find(|(place, gesture)| gestures[..*place].contains(gesture)) {
            Some((_, twice)) => Err(InvalidGestureSet::Twice(*twice)),
            None => Ok(GestureSet { gestures }),
        }
    }

    /// How many, rest included.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.gestures.len()
    }

    /// In the order of their class numbers.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Gesture> + '_ {
        self.gestures.iter().copied()
    }

    /// All but rest.
    pub fn active(&self) -> impl ExactSizeIterator<Item = Gesture> + '_ {
        self.gestures[1..].iter().copied()
    }

    /// The class number of a gesture.
    pub fn number(&self, gesture: Gesture) -> Option<u8> {
        self.gestures.iter().position(|own| *own == gesture).map(|number| number as u8)
    }

    /// The gesture with this class number.
    pub fn get(&self, number: u8) -> Option<Gesture> {
        self.gestures.get(usize::from(number)).copied()
    }

    /// The gesture with this name.
    ///
    /// # Errors
    ///
    /// [`UnknownGesture`], with the names that are known.
    pub fn find(&self, name: &str) -> Result<Gesture, UnknownGesture> {
        self.iter()
            .find(|gesture| gesture.name() == name)
            .ok_or_else(|| UnknownGesture { name: name.to_owned(), known: self.gestures.clone() })
    }
}

/// The paper's six gestures.
impl Default for GestureSet {
    fn default() -> GestureSet {
        GestureSet { gestures: Gesture::PAPER.to_vec() }
    }
}

impl TryFrom<Vec<Gesture>> for GestureSet {
    type Error = InvalidGestureSet;

    fn try_from(gestures: Vec<Gesture>) -> Result<GestureSet, InvalidGestureSet> {
        GestureSet::new(gestures)
    }
}

impl From<GestureSet> for Vec<Gesture> {
    fn from(set: GestureSet) -> Vec<Gesture> {
        set.gestures
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gesture_is_found_by_its_number_and_its_name() {
        let set = GestureSet::default();
        for (number, gesture) in (0..).zip(set.iter()) {
            assert_eq!((set.number(gesture), set.get(number)), (Some(number), Some(gesture)));
            assert_eq!(set.find(gesture.name()), Ok(gesture));
        }
        assert_eq!(set.get(6), None);
        let error = set.find("fist").unwrap_err();
        assert_eq!(
            error.to_string(),
            "unknown gesture `fist`: use one of rest, extension, flexion, ulnar, radial, grip"
        );
    }

    #[test]
    fn sets_that_cannot_work_are_refused() {
        let of = |names: &[&str]| GestureSet::new(names.iter().map(|name| name.parse().unwrap()).collect());
        assert_eq!(of(&[]), Err(InvalidGestureSet::RestNotFirst));
        assert_eq!(of(&["grip", "rest"]), Err(InvalidGestureSet::RestNotFirst));
        assert_eq!(of(&["rest"]), Err(InvalidGestureSet::Count(0)));
        assert_eq!(of(&["rest", "a", "b", "a"]), Err(InvalidGestureSet::Twice("a".parse().unwrap())));
        let names: Vec<String> = (1..=13).map(|number| format!("g{number}")).collect();
        let mut all = vec!["rest"];
        all.extend(names.iter().map(String::as_str));
        assert_eq!(of(&all), Err(InvalidGestureSet::Count(13)));
        assert!(of(&all[..13]).is_ok());
    }
}
