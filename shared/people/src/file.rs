//! Person files.
//!
//! ```text
//! format = "tendon-person"      ┐
//! version = 1                   │ head, read first: another version may have another body
//! bytes = 123456                │ of the body: tells a file that was cut short
//! crc32 = "0123abcd"            ┘ of the body: tells one that was changed
//!
//! name = "anna"                 ┐
//! [made] …                      │ body: TOML that people can read; the matrices come last, as base64
//! [fitted.discriminant] …       ┘
//! ```

use std::io;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use tendon_features::FeatureError;

use crate::name::PersonName;
use crate::person::Person;

const FORMAT: &str = "tendon-person";
const VERSION: u32 = 1;
/// Lines before the body.
const HEAD_LINES: usize = 5;
/// Largest person file, in bytes: 64 channels take 25 MB.
pub(crate) const LARGEST: u64 = 64 << 20;

/// Why a person file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PersonFileError {
    /// The system refuses to read it.
    #[error("{}: cannot read the person", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// It holds no person that can be used.
    #[error("{}: {problem}", path.display())]
    Problem {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        problem: PersonProblem,
    },
}

/// What is wrong with the text of a person file.
#[derive(Debug, thiserror::Error)]
pub enum PersonProblem {
    /// It does not begin as a person file does.
    #[error("this is no person file: it does not begin with format = \"{FORMAT}\"")]
    NoPerson,
    /// Another version of the format.
    #[error(
        "the person file has version {0}, and this program reads version {VERSION}: calibrate again, or use the Tendon \
         that made it"
    )]
    Version(u32),
    /// The end is missing.
    #[error(
        "the person file was cut short: it has {found} of {expected} bytes; restore a copy, or calibrate again"
    )]
    CutShort {
        /// Bytes of the body.
        found: usize,
        /// Bytes that it had.
        expected: usize,
    },
    /// It is not what was written.
    #[error(
        "the person file was changed or damaged: its checksum is wrong; restore a copy, or calibrate again"
    )]
    Checksum,
    /// It is not made of what a person file is made of.
    #[error("the person file is not valid: {0}; calibrate again")]
    Content(String),
    /// A value cannot be.
    #[error("the person file is not valid: {0} makes no sense; calibrate again")]
    Senseless(&'static str),
    /// The constants make no features.
    #[error("the person file is not valid: {0}; calibrate again")]
    Features(FeatureError),
}

#[derive(Deserialize)]
struct Version {
    format: String,
    version: u32,
}

#[derive(Deserialize)]
struct Head {
    bytes: usize,
    crc32: String,
}

impl Person {
    /// The text of the person's file.
    pub fn to_text(&self) -> String {
        let body = self.body();
        format!(
            "format = \"{FORMAT}\"\nversion = {VERSION}\nbytes = {}\ncrc32 = \"{}\"\n\n{body}",
            body.len(),
            checksum_of(&body)
        )
    }

    /// Tells this person from any other, by all that is in their file.
    pub fn checksum(&self) -> String {
        checksum_of(&self.body())
    }

    fn body(&self) -> String {
        toml::to_string(self).expect("names, numbers and lists: nothing that TOML cannot say")
    }

    /// Reads what [`to_text`](Self::to_text) wrote.
    ///
    /// # Errors
    ///
    /// [`PersonProblem`]: what is wrong with the text.
    pub fn from_text(text: &str) -> Result<Person, PersonProblem> {
        let end_of_head = text.match_indices('\n').nth(HEAD_LINES - 1).map_or(text.len(), |(at, _)| at + 1);
        let (head, body) = text.split_at(end_of_head);
        let first_lines: String = head.lines().take(2).flat_map(|line| [line, "\n"]).collect();
        let Version { format, version } =
            toml::from_str(&first_lines).map_err(|_| PersonProblem::NoPerson)?;
        if format != FORMAT {
            return Err(PersonProblem::NoPerson);
        }
        if version != VERSION {
            return Err(PersonProblem::Version(version));
        }
        let Head { bytes, crc32 } = toml::from_str(head).map_err(|error| content(&error))?;
        if body.len() < bytes {
            return Err(PersonProblem::CutShort { found: body.len(), expected: bytes });
        }
        if body.len() > bytes || checksum_of(body) != crc32 {
            return Err(PersonProblem::Checksum);
        }
        Person::from_body(body)
    }

    /// Reads the part of a file that the checksum is of.
    ///
    /// # Errors
    ///
    /// [`PersonProblem`]: what is wrong with it.
    pub fn from_body(body: &str) -> Result<Person, PersonProblem> {
        let person: Person = toml::from_str(body).map_err(|error| content(&error))?;
        person.check()?;
        Ok(person)
    }

    /// Reads a person file.
    ///
    /// # Errors
    ///
    /// [`PersonFileError`]: why not, by name.
    pub fn read(path: &Path) -> Result<Person, PersonFileError> {
        let text = tendon_input::read_text(path, LARGEST)
            .map_err(|source| PersonFileError::Read { path: path.to_owned(), source })?;
        Person::from_text(&text)
            .map_err(|problem| PersonFileError::Problem { path: path.to_owned(), problem })
    }
}

/// The name in the text of a person file, also of one that is damaged or of another version; `None` if it names nobody.
pub fn name_in(text: &str) -> Option<PersonName> {
    let mut head = text.lines().take_while(|line| !line.starts_with('['));
    head.find_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"')?.parse().ok())
}

fn checksum_of(body: &str) -> String {
    format!("{:08x}", crc32fast::hash(body.as_bytes()))
}

fn content(error: &toml::de::Error) -> PersonProblem {
    PersonProblem::Content(error.message().trim_end().replace('\n', " "))
}
