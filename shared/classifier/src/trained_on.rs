//! Whom a model was trained on, according to its metadata.

use tendon_identity::PersonId;

use crate::problem::{ContractProblem, senseless};

/// Whom a model was trained on. A number alone names nobody: every data set counts its people from 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TrainedOn {
    /// Name of the data set, such as `3DC`; `None` if the model does not say, or its recordings are of no known data set.
    pub data_set: Option<String>,
    /// The people in that data set; empty if the model does not say.
    pub people: Vec<PersonId>,
    /// Sessions of these people that were held out, so that the model has not seen them.
    pub held_out_sessions: Vec<String>,
    /// Repetitions of these people, counted through all sessions, that were held out likewise.
    pub held_out_repetitions: Vec<u8>,
}

/// What a model says instead of the name of a data set if it was trained on recordings of your own. Their people have
/// nothing to do with those of a data set.
const OWN_RECORDINGS: &str = "own recordings";

impl TrainedOn {
    /// Reads it through `lookup`, which gives the metadata's value for a key.
    pub(crate) fn read(lookup: impl Fn(&str) -> Option<String>) -> Result<TrainedOn, ContractProblem> {
        let people = lookup("tendon.people_trained").unwrap_or_default();
        let key = "tendon.held_out_sessions";
        let sessions = lookup(key).unwrap_or_else(|| "[]".to_owned());
        let repetitions_key = "tendon.held_out_repetitions";
        let repetitions = lookup(repetitions_key).unwrap_or_else(|| "[]".to_owned());
        Ok(TrainedOn {
            held_out_repetitions: serde_json::from_str(&repetitions)
                .map_err(|_| senseless(repetitions_key, &repetitions))?,
            held_out_sessions: serde_json::from_str(&sessions).map_err(|_| senseless(key, &sessions))?,
            data_set: lookup("tendon.data_set").filter(|name| !name.is_empty()),
            people: people
                .split_whitespace()
                .map(str::parse)
                .collect::<Result<Vec<PersonId>, _>>()
                .map_err(|_| senseless("tendon.people_trained", &people))?,
        })
    }

    /// Whether it was recordings of your own.
    pub fn is_own(&self) -> bool {
        self.data_set.as_deref() == Some(OWN_RECORDINGS)
    }

    /// Those of them who may be people of `data_set`; `None` is recordings of your own. Nobody if the model names another
    /// data set, everybody if it names none.
    pub fn people_of(&self, data_set: Option<&str>) -> &[PersonId] {
        match &self.data_set {
            Some(own) if own != data_set.unwrap_or(OWN_RECORDINGS) => &[],
            _ => &self.people,
        }
    }

    /// Whether the model was, or may have been, trained on this repetition, counted through all sessions, in this session of
    /// this person of `data_set`; without a repetition, on all of the session.
    pub fn knows(
        &self,
        data_set: Option<&str>,
        person: PersonId,
        session: &str,
        repetition: Option<u8>,
    ) -> bool {
        let is_held_out = match repetition {
            Some(repetition) => self.held_out_repetitions.contains(&repetition),
            None => !self.held_out_repetitions.is_empty(),
        };
        self.people_of(data_set).contains(&person)
            && !is_held_out
            && !self.held_out_sessions.iter().any(|held_out| held_out == session)
    }

    /// What was held out of these people, in words.
    pub fn held_out(&self) -> String {
        let sessions = (!self.held_out_sessions.is_empty())
            .then(|| format!("session {}", self.held_out_sessions.join(", ")));
        let numbers: Vec<String> = self.held_out_repetitions.iter().map(u8::to_string).collect();
        let repetitions = (!numbers.is_empty()).then(|| format!("repetition {}", numbers.join(", ")));
        sessions.into_iter().chain(repetitions).collect::<Vec<String>>().join(" and ")
    }

    /// Whether this person of `data_set` is one of them; `None` where the model does not say enough to tell.
    pub fn includes(&self, data_set: Option<&str>, person: PersonId) -> Option<bool> {
        let is_known = !self.people.is_empty() && self.data_set.is_some();
        is_known.then(|| self.people_of(data_set).contains(&person))
    }

    /// Whether any of `models` was trained on any of `people` of `data_set`; `None` where that cannot be told.
    pub fn any_includes<'a>(
        models: impl IntoIterator<Item = &'a TrainedOn>,
        data_set: Option<&str>,
        people: &[PersonId],
    ) -> Option<bool> {
        let mut any = Some(false);
        for model in models {
            for &person in people {
                match model.includes(data_set, person) {
                    Some(true) => return Some(true),
                    Some(false) => {}
                    None => any = None,
                }
            }
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trained_on(data_set: Option<&str>, people: &[u16]) -> TrainedOn {
        TrainedOn {
            data_set: data_set.map(str::to_owned),
            people: people.iter().copied().map(PersonId::from).collect(),
            held_out_sessions: Vec::new(),
            held_out_repetitions: Vec::new(),
        }
    }

    #[test]
    fn people_of_your_own_are_not_those_of_a_data_set_and_a_session_held_out_is_not_known() {
        let of_own = trained_on(Some("own recordings"), &[3]);
        assert!(of_own.people_of(Some("3DC")).is_empty(), "the user's 3 is not 3DC's");
        assert_eq!(of_own.people_of(None), [3]);
        let with_session = TrainedOn { held_out_sessions: vec!["tuesday".to_owned()], ..of_own.clone() };
        let knows = |person, session| with_session.knows(None, PersonId::Number(person), session, Some(0));
        assert_eq!((knows(3, "monday"), knows(3, "tuesday"), knows(4, "monday")), (true, false, false));
        let with_repetition = TrainedOn { held_out_repetitions: vec![2], ..of_own.clone() };
        let knows = |repetition| with_repetition.knows(None, PersonId::Number(3), "monday", repetition);
        assert_eq!((knows(Some(1)), knows(Some(2)), knows(None)), (true, false, false));
        assert_eq!(with_repetition.held_out(), "repetition 2");
        let anna: PersonId = "anna".parse().unwrap();
        let of_anna = TrainedOn::read(|key| match key {
            "tendon.people_trained" => Some("anna ben".to_owned()),
            "tendon.data_set" => Some(OWN_RECORDINGS.to_owned()),
            _ => None,
        });
        let of_anna = of_anna.unwrap();
        assert_eq!(
            (of_anna.includes(None, anna), of_anna.includes(None, 1.into())),
            (Some(true), Some(false))
        );
        let broken = TrainedOn::read(|key| (key == "tendon.held_out_sessions").then(|| "tuesday".to_owned()));
        assert!(broken.unwrap_err().to_string().contains("tendon.held_out_sessions"));
    }

    #[test]
    fn a_person_is_a_number_in_a_data_set_and_what_cannot_be_told_is_not_guessed() {
        let of_3dc = trained_on(Some("3DC"), &[1, 3]);
        let of_own = trained_on(None, &[1, 3]);
        let silent = trained_on(Some("3DC"), &[]);
        for (model, data_set, person, expected) in [
            (&of_3dc, Some("3DC"), 1, Some(true)),
            (&of_3dc, Some("3DC"), 2, Some(false)),
            (&of_3dc, Some("Ozdemir 2022"), 1, Some(false)),
            (&of_3dc, None, 1, Some(false)),
            (&of_own, Some("3DC"), 1, None),
            (&of_own, None, 1, None),
            (&silent, Some("3DC"), 1, None),
        ] {
            assert_eq!(
                model.includes(data_set, PersonId::Number(person)),
                expected,
                "{model:?}, {data_set:?}, {person}"
            );
        }
        assert!(of_3dc.people_of(Some("Ozdemir 2022")).is_empty());
        assert!(of_3dc.people_of(None).is_empty(), "recordings of your own are of no data set");
        assert_eq!(of_own.people_of(None), [1, 3], "they may be the same");
        assert_eq!(of_own.people_of(Some("3DC")), [1, 3], "they may be the same");
        let any = |models: &[&TrainedOn], people: &[u16]| {
            let people: Vec<PersonId> = people.iter().copied().map(PersonId::from).collect();
            TrainedOn::any_includes(models.iter().copied(), Some("3DC"), &people)
        };
        assert_eq!(any(&[&of_own, &of_3dc], &[2, 3]), Some(true));
        assert_eq!(any(&[&of_3dc, &of_own], &[2]), None);
        assert_eq!(any(&[&of_3dc], &[2, 4]), Some(false));
    }
}
