//! Which stream a session reads.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Longest wait for a stream at the start, s: the session itself does not wait much longer for its stages.
const LONGEST_WAIT_S: f64 = 50.0;

/// Which stream a session reads. All that is not empty must agree, and exactly one stream may.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LslSettings {
    /// Name of the stream; empty for any.
    pub name: String,
    /// Its content type; empty for any.
    #[serde(rename = "type")]
    pub content_type: String,
    /// Its source id, which names the device; empty for any.
    pub source_id: String,
    /// Name of the computer that sends it; empty for any.
    pub hostname: String,
    /// How long the stream is looked for when a session starts, s.
    pub wait_s: f64,
    /// liblsl; when left out, `LSL_LIBRARY`, then what `scripts/fetch-libraries` fetched.
    pub library: Option<PathBuf>,
}

impl Default for LslSettings {
    fn default() -> Self {
        LslSettings {
            name: String::new(),
            content_type: "EMG".to_owned(),
            source_id: String::new(),
            hostname: String::new(),
            wait_s: 10.0,
            library: None,
        }
    }
}

/// Settings that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LslSettingsError {
    /// A wait that is none, or too long.
    #[error("wait_s = {0}: take 0.1 to 50 s")]
    Wait(f64),
    /// A text that no query can hold.
    #[error(
        "{key} = {value:?}: a name with both kinds of quotes, or a control character, cannot be looked for"
    )]
    Text {
        /// Which setting.
        key: &'static str,
        /// What it is.
        value: String,
    },
}

impl LslSettings {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// [`LslSettingsError`], which names the key.
    pub fn check(&self) -> Result<(), LslSettingsError> {
        if !(0.1..=LONGEST_WAIT_S).contains(&self.wait_s) {
            return Err(LslSettingsError::Wait(self.wait_s));
        }
        for (key, value) in self.wanted() {
            let has_both_quotes = value.contains('\'') && value.contains('"');
            if has_both_quotes || value.chars().any(char::is_control) {
                return Err(LslSettingsError::Text { key, value: value.to_owned() });
            }
        }
        Ok(())
    }

    /// What a stream must be to be read, as an XPath 1.0 predicate on its `info` element. XPath knows no way to escape a
    /// quote, so a text is put between those that it does not hold.
    pub(crate) fn predicate(&self) -> String {
        let quoted = |value: &str| {
            if value.contains('\'') { format!("\"{value}\"") } else { format!("'{value}'") }
        };
        let conditions = self.wanted().map(|(key, value)| format!("{key}={}", quoted(value)));
        let predicate = conditions.collect::<Vec<_>>().join(" and ");
        if predicate.is_empty() { "channel_count>0".to_owned() } else { predicate }
    }

    /// What a stream must be to be read, in words.
    pub fn describe(&self) -> String {
        let conditions = self.wanted().map(|(key, value)| format!("{key} \"{value}\""));
        let conditions = conditions.collect::<Vec<_>>().join(", ");
        if conditions.is_empty() { "any name and type".to_owned() } else { conditions }
    }

    fn wanted(&self) -> impl Iterator<Item = (&'static str, &str)> {
        [
            ("name", self.name.as_str()),
            ("type", &self.content_type),
            ("source_id", &self.source_id),
            ("hostname", &self.hostname),
        ]
        .into_iter()
        .filter(|(_, value)| !value.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn what_is_set_must_agree_and_nothing_else() {
        let mut settings = LslSettings::default();
        assert_eq!(settings.predicate(), "type='EMG'");
        settings.name = "Anna's arm".to_owned();
        assert_eq!(settings.predicate(), "name=\"Anna's arm\" and type='EMG'");
        assert_eq!(settings.describe(), "name \"Anna's arm\", type \"EMG\"");
        settings.name.clear();
        settings.content_type.clear();
        assert_eq!(settings.predicate(), "channel_count>0");
    }

    #[test]
    fn what_cannot_be_asked_for_is_refused_by_key() {
        let mut settings = LslSettings { name: "it's \"it\"".to_owned(), ..LslSettings::default() };
        assert!(settings.check().unwrap_err().to_string().starts_with("name = "));
        settings.name.clear();
        for wait_s in [f64::NAN, 0.0, -1.0, 51.0] {
            settings.wait_s = wait_s;
            assert!(settings.check().unwrap_err().to_string().contains("wait_s"));
        }
    }

    proptest! {
        #[test]
        fn no_text_that_passes_ends_its_own_quotes(name in ".{0,20}") {
            let settings = LslSettings { name: name.clone(), content_type: String::new(), ..LslSettings::default() };
            if settings.check().is_ok() && !name.is_empty() {
                let predicate = settings.predicate();
                let quote = predicate.chars().last().unwrap();
                prop_assert_eq!(predicate.matches(quote).count(), 2);
            }
        }
    }
}
