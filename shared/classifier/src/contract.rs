//! What a model was trained for, as it stands in its metadata.

use std::fmt;

use tendon_gesture::Gesture;
use tendon_signal::{FilterSettings, WindowInput};

/// Version of the metadata's layout that this program reads.
const CONTRACT_VERSION: &str = "1";

/// What a model was trained for.
#[derive(Clone, Debug, PartialEq)]
pub struct Contract {
    /// Number of channels.
    pub channels: usize,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Samples of each channel in a window.
    pub window_samples: usize,
    /// Filter before the window.
    pub filter: FilterSettings,
    /// What the window holds; without a word on it, the filtered signal.
    pub input: WindowInput,
    /// Classes in the order of the outputs.
    pub classes: Vec<Gesture>,
    /// Data, people and recipe, in words, if the model says so.
    pub provenance: Option<String>,
}

/// Something in which a model and a session differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Mismatch {
    /// What differs.
    pub what: &'static str,
    /// The model's value.
    pub model: String,
    /// The session's value.
    pub session: String,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}: the model wants {}, the session has {}", self.what, self.model, self.session)
    }
}

impl Contract {
    /// Reads a contract through `lookup`, which gives the metadata's value for a key.
    ///
    /// # Errors
    ///
    /// A sentence on the first key that is missing or wrong.
    pub fn read(lookup: impl Fn(&str) -> Option<String>) -> Result<Contract, String> {
        let get = |key: &str| {
            lookup(key).ok_or_else(|| format!("the metadata lack `{key}`, so nobody can know what it fits"))
        };
        let wrong =
            |key: &str, value: &str| format!("the metadata's `{key}` is `{value}`, which makes no sense");
        let version = get("tendon.contract_version")?;
        if version != CONTRACT_VERSION {
            return Err(format!(
                "the metadata are of contract version {version}, this program reads {CONTRACT_VERSION}"
            ));
        }
        let count = |key: &str| {
            let value = get(key)?;
            value.parse().ok().filter(|count: &usize| *count > 0).ok_or_else(|| wrong(key, &value))
        };
        let rate = get("tendon.sample_rate_hz")?;
        let filter = get("tendon.filter")?;
        let classes = get("tendon.classes")?;
        Ok(Contract {
            channels: count("tendon.channels")?,
            sample_rate_hz: rate
                .parse()
                .ok()
                .filter(|rate: &f64| rate.is_finite() && *rate > 0.0)
                .ok_or_else(|| wrong("tendon.sample_rate_hz", &rate))?,
            window_samples: count("tendon.window_samples")?,
            filter: serde_json::from_str(&filter).map_err(|_| wrong("tendon.filter", &filter))?,
            input: match lookup("tendon.input").as_deref() {
                None | Some("raw") => WindowInput::Raw,
                Some("envelope") => WindowInput::Envelope,
                Some(other) => return Err(wrong("tendon.input", other)),
            },
            classes: classes
                .split(',')
                .map(|name| name.trim().parse())
                .collect::<Result<Vec<Gesture>, _>>()
                .map_err(|_| wrong("tendon.classes", &classes))?,
            provenance: lookup("tendon.provenance"),
        })
    }

    /// Everything in which the session differs from what the model was trained for.
    pub fn mismatches(
        &self,
        channels: usize,
        sample_rate_hz: f64,
        window_samples: usize,
        filter: &FilterSettings,
        input: WindowInput,
        needs_rest: bool,
    ) -> Vec<Mismatch> {
        let mut mismatches = Vec::new();
        let mut compare = |what, same: bool, model: String, session: String| {
            if !same {
                mismatches.push(Mismatch { what, model, session });
            }
        };
        compare("channels", self.channels == channels, self.channels.to_string(), channels.to_string());
        compare(
            "sampling rate",
            self.sample_rate_hz == sample_rate_hz,
            format!("{} Hz", self.sample_rate_hz),
            format!("{sample_rate_hz} Hz"),
        );
        compare(
            "window",
            self.window_samples == window_samples,
            format!("{} samples", self.window_samples),
            format!("{window_samples} samples"),
        );
        compare("filter", self.filter == *filter, format!("{:?}", self.filter), format!("{filter:?}"));
        let names: Vec<&str> = self.classes.iter().map(|gesture| gesture.name()).collect();
        let said = |input| match input {
            WindowInput::Raw => "the filtered signal".to_owned(),
            WindowInput::Envelope => "its envelope".to_owned(),
        };
        compare("input", self.input == input, said(self.input), said(input));
        compare(
            "classes",
            !needs_rest || self.classes.contains(&Gesture::Rest),
            names.join(", "),
            "decision.strategy = \"direct\", which needs a model that knows rest".to_owned(),
        );
        mismatches
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metadata(key: &str) -> Option<String> {
        let value = match key {
            "tendon.contract_version" => "1",
            "tendon.channels" => "4",
            "tendon.sample_rate_hz" => "2000",
            "tendon.window_samples" => "600",
            "tendon.filter" => {
                r#"{"notch_hz":60.0,"notch_quality":30.0,"band_pass_hz":[5.0,500.0],"band_pass_order":6}"#
            }
            "tendon.classes" => "extension,flexion,ulnar,radial,grip",
            _ => return None,
        };
        Some(value.to_owned())
    }

    #[test]
    fn a_contract_is_read_and_compared_by_name_of_what_differs() {
        let contract = Contract::read(metadata).unwrap();
        assert_eq!(contract.classes, Gesture::ACTIVE);
        let filter = FilterSettings::default();
        assert_eq!(contract.mismatches(4, 2000.0, 600, &filter, WindowInput::Raw, false), []);
        let mismatches = contract.mismatches(10, 1000.0, 300, &filter, WindowInput::Envelope, true);
        let text: Vec<String> = mismatches.iter().map(ToString::to_string).collect();
        assert_eq!(text.len(), 5);
        assert_eq!(text[0], "channels: the model wants 4, the session has 10");
        assert_eq!(text[1], "sampling rate: the model wants 2000 Hz, the session has 1000 Hz");
    }

    #[test]
    fn missing_and_senseless_metadata_are_named() {
        for (key, value, expected) in [
            ("tendon.channels", None, "lack `tendon.channels`"),
            ("tendon.channels", Some("0"), "`tendon.channels` is `0`"),
            ("tendon.sample_rate_hz", Some("fast"), "`tendon.sample_rate_hz` is `fast`"),
            ("tendon.filter", Some("none"), "`tendon.filter` is `none`"),
            ("tendon.input", Some("spectrum"), "`tendon.input` is `spectrum`"),
            ("tendon.classes", Some("fist"), "`tendon.classes` is `fist`"),
            ("tendon.contract_version", Some("2"), "contract version 2"),
        ] {
            let changed = |asked: &str| {
                if asked == key { value.map(str::to_owned) } else { metadata(asked) }
            };
            let error = Contract::read(changed).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
