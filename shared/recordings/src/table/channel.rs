//! Which columns of a table are read.

use std::fmt;

use serde::{Deserialize, Serialize};
use tendon_signal::without_unit;

use super::problem::{TableError, TableProblem, error_at};

/// A channel the caller chooses: by column, counted from 0, or by the name a header line gives it.
///
/// In a configuration file: `channels = [0, 3, 5, 8]` or `channels = ["EMG_zyg", "EMG_cor"]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Channel {
    /// Column number, counted from 0.
    Index(usize),
    /// Name in the header line.
    Name(String),
}

impl From<usize> for Channel {
    fn from(index: usize) -> Channel {
        Channel::Index(index)
    }
}

impl From<&str> for Channel {
    fn from(name: &str) -> Channel {
        Channel::Name(name.to_owned())
    }
}

impl Channel {
    /// What it is called, without the quotes of a message: its name, or its number.
    pub fn name(&self) -> String {
        match self {
            Channel::Index(index) => index.to_string(),
            Channel::Name(name) => name.clone(),
        }
    }
}

impl fmt::Display for Channel {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Channel::Index(index) => write!(formatter, "{index}"),
            Channel::Name(name) => write!(formatter, "`{name}`"),
        }
    }
}

/// For each column its place in a frame of `channels`, if chosen.
pub(crate) fn places(
    channels: &[Channel],
    columns: usize,
    names: &[String],
) -> Result<Vec<Option<usize>>, TableError> {
    if channels.is_empty() {
        return Err(error_at(1, 1, TableProblem::NoChannels { columns }));
    }
    let mut places = vec![None; columns];
    for (place, channel) in channels.iter().enumerate() {
        let column = match channel {
            Channel::Index(index) => *index,
            Channel::Name(name) => {
                // A name may have been given with the unit that stands in the header.
                let is_exact = names.contains(name);
                let wanted = if is_exact { name } else { without_unit(name) };
                let mut found = names.iter().enumerate().filter(|(_, candidate)| *candidate == wanted);
                let Some((column, _)) = found.next() else {
                    let problem = TableProblem::MissingName { name: name.clone(), names: names.to_vec() };
                    return Err(error_at(1, 1, problem));
                };
                if let Some((second, _)) = found.next() {
                    return Err(error_at(1, second + 1, TableProblem::AmbiguousName(name.clone())));
                }
                column
            }
        };
        match places.get_mut(column) {
            None => {
                let problem = TableProblem::MissingChannel { channel: column, columns };
                return Err(error_at(1, column.saturating_add(1), problem));
            }
            Some(Some(_)) => return Err(error_at(1, column + 1, TableProblem::ChosenTwice(column))),
            Some(free) => *free = Some(place),
        }
    }
    Ok(places)
}
