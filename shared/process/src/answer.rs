//! What whoever gave an order or asked for something is told.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What came of an order to the robot or of a request to the session. It travels as JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// Whether it is done, or begun.
    pub ok: bool,
    /// What is done, or why nothing is, in words.
    pub text: String,
    /// The same as a key of the page's texts, for its own language; `None` where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    /// What fills the places of that text.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub values: BTreeMap<String, String>,
}

impl Answer {
    /// It is done, or begun.
    pub fn done(text: impl Into<String>) -> Answer {
        Answer { ok: true, text: text.into(), key: None, values: BTreeMap::new() }
    }

    /// Nothing was done.
    pub fn refused(text: impl Into<String>) -> Answer {
        Answer { ok: false, ..Answer::done(text) }
    }

    /// The same with a key of the page's texts.
    pub fn with_key(self, key: &str) -> Answer {
        Answer { key: Some(key.to_owned()), ..self }
    }

    /// The same with what fills a place of the page's text.
    pub fn with_value(mut self, place: &str, value: impl ToString) -> Answer {
        self.values.insert(place.to_owned(), value.to_string());
        self
    }
}
