//! What the page says in its own language, and the terminal in English.

use serde::Serialize;

/// Something that the page says in its own language, beside its English text.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InWords<T> {
    /// In English.
    pub text: String,
    #[serde(flatten)]
    what: T,
}

impl<T: Clone + ToString> InWords<T> {
    /// With the text that it has.
    pub fn of(what: &T) -> InWords<T> {
        InWords { text: what.to_string(), what: what.clone() }
    }
}
