//! `participants.tsv`: the people of the data set and their pseudonyms.

use std::io::ErrorKind;
use std::path::Path;

use super::{cell, label};
use crate::ExportError;

pub(super) const FILE: &str = "participants.tsv";
/// The subject of a session without a person.
const UNKNOWN: &str = "unknown";
const HEADER: &str = "participant_id\tpseudonym";

/// The table as it is, and who is added.
pub(super) struct Participants {
    lines: Vec<String>,
}

impl Participants {
    /// Reads the table of the data set in `folder`; one without people where there is none, or nothing in it.
    pub(super) fn read(folder: &Path) -> Result<Participants, ExportError> {
        let path = folder.join(FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) if text.trim().is_empty() => HEADER.to_owned(),
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => HEADER.to_owned(),
            Err(source) => return Err(ExportError::Read { path, source }),
        };
        let lines: Vec<String> = text.lines().map(str::to_owned).collect();
        if !lines[0].split('\t').any(|column| column == "participant_id") {
            return Err(ExportError::Participants { path });
        }
        Ok(Participants { lines })
    }

    /// The label of a person, who is added if they are not there. Two pseudonyms of the same letters and digits get two labels.
    pub(super) fn subject(&mut self, pseudonym: Option<&str>) -> String {
        let pseudonym = pseudonym.unwrap_or(UNKNOWN);
        let column = |line: &str, name: &str| -> Option<String> {
            let place = self.lines.first()?.split('\t').position(|column| column == name)?;
            line.split('\t').nth(place).map(str::to_owned)
        };
        let known: Vec<(String, Option<String>)> = self
            .lines
            .iter()
            .skip(1)
            .filter_map(|line| Some((column(line, "participant_id")?, column(line, "pseudonym"))))
            .collect();
        let wanted = Some(label(pseudonym)).filter(|wanted| !wanted.is_empty());
        let wanted = wanted.unwrap_or_else(|| UNKNOWN.to_owned());
        let candidates = (1..).map(|number: u32| match number {
            1 => wanted.clone(),
            number => format!("{wanted}x{number}"),
        });
        for candidate in candidates {
            let id = format!("sub-{candidate}");
            match known.iter().find(|(known, _)| *known == id) {
                // A table without pseudonyms tells people by their labels alone.
                Some((_, known)) if known.as_deref().is_none_or(|known| known == pseudonym) => {
                    return candidate;
                }
                Some(_) => {}
                None => {
                    self.add(&id, pseudonym);
                    return candidate;
                }
            }
        }
        unreachable!("the table is finite")
    }

    fn add(&mut self, id: &str, pseudonym: &str) {
        let Some(header) = self.lines.first() else { return };
        let row = header.split('\t').map(|column| match column {
            "participant_id" => id.to_owned(),
            "pseudonym" => cell(pseudonym),
            _ => "n/a".to_owned(),
        });
        let row = row.collect::<Vec<_>>().join("\t");
        self.lines.push(row);
    }

    /// Its text.
    pub(super) fn table(&self) -> String {
        self.lines.iter().map(|line| format!("{line}\n")).collect()
    }
}

/// The `participant_id` of a pseudonym in the text of a `participants.tsv`. A table without pseudonyms tells people by their
/// labels alone.
pub fn participant_of(table: &str, pseudonym: &str) -> Option<String> {
    let mut lines = table.lines();
    let columns: Vec<&str> = lines.next()?.split('\t').collect();
    let place = |name: &str| columns.iter().position(|column| *column == name);
    let (id, known) = (place("participant_id")?, place("pseudonym"));
    lines.find_map(|line| {
        let cells: Vec<&str> = line.split('\t').collect();
        let participant = *cells.get(id)?;
        let is_safe = participant.strip_prefix("sub-").is_some_and(|subject| label(subject) == subject);
        let is_person = match known {
            Some(known) => cells.get(known) == Some(&pseudonym),
            None => participant == format!("sub-{}", label(pseudonym)),
        };
        (is_safe && is_person).then(|| participant.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_without_a_column_for_people_is_refused_and_an_empty_one_is_begun() {
        let folder = tempfile::tempdir().unwrap();
        for (text, is_table) in
            [("", true), ("\n", true), ("age\n30\n", false), ("participant\tage\n", false)]
        {
            std::fs::write(folder.path().join(FILE), text).unwrap();
            match Participants::read(folder.path()) {
                Ok(mut participants) => {
                    participants.subject(Some("anna"));
                    assert!(is_table, "{text:?}");
                    assert_eq!(participants.table(), "participant_id\tpseudonym\nsub-anna\tanna\n");
                }
                Err(error) => {
                    assert!(!is_table && matches!(error, ExportError::Participants { .. }), "{error}")
                }
            }
        }
    }

    #[test]
    fn people_are_added_once_and_told_apart_and_other_columns_stay() {
        let folder = tempfile::tempdir().unwrap();
        let mut participants = Participants::read(folder.path()).unwrap();
        for (pseudonym, subject) in [
            (Some("left-arm"), "leftarm"),
            (Some("leftarm"), "leftarmx2"),
            (Some("left-arm"), "leftarm"),
            (None, "unknown"),
            (Some("__"), "unknownx2"),
        ] {
            assert_eq!(participants.subject(pseudonym), subject);
        }
        assert_eq!(participants.table().lines().count(), 5);
        std::fs::write(folder.path().join(FILE), "participant_id\tage\nsub-anna\t30\n").unwrap();
        let table = "participant_id\tpseudonym\nsub-leftarm\tleft-arm\nsub-../x\tben\n";
        assert_eq!(participant_of(table, "left-arm").as_deref(), Some("sub-leftarm"));
        assert_eq!((participant_of(table, "leftarm"), participant_of(table, "ben")), (None, None));
        let mut participants = Participants::read(folder.path()).unwrap();
        assert_eq!(
            (participants.subject(Some("anna")), participants.subject(Some("ben"))),
            ("anna".into(), "ben".into())
        );
        assert_eq!(participants.table(), "participant_id\tage\nsub-anna\t30\nsub-ben\tn/a\n");
    }
}
