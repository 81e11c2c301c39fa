//! Whom a model may be scored on.

use std::collections::BTreeSet;

use tendon_identity::{PersonId, list_of};

/// Why the people asked for cannot be scored.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PeopleError {
    /// Somebody of whom there are no recordings.
    #[error("--people {person}: there are only {}", list_of(.known))]
    Unknown {
        /// Who was asked for.
        person: PersonId,
        /// The people there are.
        known: BTreeSet<PersonId>,
    },
    /// Somebody whom the model has learnt from.
    #[error(
        "--people {person}: the model was trained on {}, so a score on any of them says nothing about somebody new; \
         name others or leave --people out",
        list_of(.trained)
    )]
    Trained {
        /// Who was asked for.
        person: PersonId,
        /// All whom the model has learnt from.
        trained: BTreeSet<PersonId>,
    },
    /// The model has learnt from everybody.
    #[error(
        "the model was trained on everybody here ({}): give recordings of others, or hold people out of the training \
         (tendon dataset build --test-people)",
        list_of(.known)
    )]
    NobodyNew {
        /// The people there are.
        known: BTreeSet<PersonId>,
    },
}

/// The people to score among the `known` ones: those `wanted`, or else all; but none whom a model was `trained` on.
///
/// # Errors
/// When one of them is unknown or was trained on, or nobody is left.
pub fn chosen_people(
    known: &BTreeSet<PersonId>,
    wanted: &[PersonId],
    trained: &BTreeSet<PersonId>,
) -> Result<BTreeSet<PersonId>, PeopleError> {
    for &person in wanted {
        if !known.contains(&person) {
            return Err(PeopleError::Unknown { person, known: known.clone() });
        }
        if trained.contains(&person) {
            return Err(PeopleError::Trained { person, trained: trained.clone() });
        }
    }
    let people: BTreeSet<PersonId> =
        if wanted.is_empty() { known - trained } else { wanted.iter().copied().collect() };
    if people.is_empty() {
        return Err(PeopleError::NobodyNew { known: known.clone() });
    }
    Ok(people)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_are_those_wanted_or_all_but_never_those_trained_on() {
        let set = |people: &[u16]| people.iter().copied().map(PersonId::from).collect::<BTreeSet<PersonId>>();
        let people = |people: &[u16]| people.iter().copied().map(PersonId::from).collect::<Vec<PersonId>>();
        let chosen = |wanted: &[u16]| chosen_people(&set(&[1, 2, 3]), &people(wanted), &set(&[2, 9]));
        assert_eq!(chosen(&[]).unwrap(), set(&[1, 3]));
        assert_eq!(chosen(&[3]).unwrap(), set(&[3]));
        let message = |result: Result<BTreeSet<PersonId>, PeopleError>| result.unwrap_err().to_string();
        assert!(message(chosen(&[3, 2])).contains("--people 2: the model was trained on 2, 9"));
        assert!(message(chosen(&[4])).contains("--people 4: there are only 1, 2, 3"));
        assert!(message(chosen_people(&set(&[2]), &[], &set(&[2]))).contains("everybody here (2)"));
    }
}
