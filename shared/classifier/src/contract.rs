//! What a model was trained for, according to its metadata.

use std::fmt;

use tendon_gesture::Class;
use tendon_signal::{FilterSettings, SignalSettings, WindowInput, are_same_channels};

use crate::problem::{ContractProblem, senseless};
use crate::trained_on::TrainedOn;

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
    /// Successive windows that are classified together: 1, except for a model of sequences.
    pub sequence_windows: usize,
    /// Filters before the window that its training allows, at least one; the first is that of most of its windows.
    pub filters: Vec<FilterSettings>,
    /// Names of the channels it was trained on, in order; empty if the model does not say.
    pub channel_names: Vec<String>,
    /// Unit of the samples it was trained on; empty if the model does not say.
    pub unit: String,
    /// RMS of each channel of the windows of rest that it was trained on; empty if the model does not say.
    pub rest_rms: Vec<f64>,
    /// What the window holds; the filtered signal if the metadata do not say.
    pub input: WindowInput,
    /// Classes in the order of the outputs.
    pub classes: Vec<Class>,
    /// Whom it was trained on, if the model says so.
    pub trained_on: TrainedOn,
    /// Share of the validation windows that it recognised, if the model says so.
    pub validation_accuracy: Option<f64>,
    /// People, counts and recipe, in words, if the model says so.
    pub provenance: Option<String>,
}

/// What delivers windows to a model: a session, or a data set.
#[derive(Clone, Copy, Debug)]
pub struct WindowSource<'a> {
    /// Its name in messages: `the session`.
    pub name: &'static str,
    /// Number of channels.
    pub channels: usize,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Samples of each channel in a window.
    pub window_samples: usize,
    /// Largest number of successive windows that it delivers together.
    pub sequence_windows: usize,
    /// Filter before the window; `None` if the recordings had been filtered in an unknown way.
    pub filter: Option<&'a FilterSettings>,
    /// What a window holds.
    pub input: WindowInput,
}

impl<'a> WindowSource<'a> {
    /// What a signal chain with these settings delivers: single windows of the filtered signal.
    pub fn of_chain(
        name: &'static str,
        channels: usize,
        sample_rate_hz: f64,
        settings: &'a SignalSettings,
    ) -> WindowSource<'a> {
        WindowSource {
            name,
            channels,
            sample_rate_hz,
            window_samples: settings.windows.window_samples,
            sequence_windows: 1,
            filter: Some(&settings.filter),
            input: WindowInput::Raw,
        }
    }
}

/// A difference between a model and the source of its windows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mismatch {
    /// What differs.
    pub what: &'static str,
    /// The model's value.
    pub model: String,
    /// Who has another value: [`WindowSource::name`].
    pub source: &'static str,
    /// That value.
    pub has: String,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Mismatch { what, model, source, has } = self;
        write!(formatter, "{what}: the model wants {model}, {source} has {has}")
    }
}

impl Contract {
    /// Reads a contract through `lookup`, which gives the metadata's value for a key.
    ///
    /// # Errors
    ///
    /// The first key that is missing or wrong.
    pub fn read(lookup: impl Fn(&str) -> Option<String>) -> Result<Contract, ContractProblem> {
        let get = |key: &'static str| lookup(key).ok_or(ContractProblem::Missing { key });
        let version = get("tendon.contract_version")?;
        if version != CONTRACT_VERSION {
            return Err(ContractProblem::Version { found: version, known: CONTRACT_VERSION });
        }
        let accuracy = "tendon.validation_accuracy";
        let channels = count("tendon.channels", &get("tendon.channels")?)?;
        Ok(Contract {
            channels,
            channel_names: list("tendon.channel_names", &lookup, channels)?,
            unit: lookup("tendon.unit").unwrap_or_default(),
            rest_rms: rest_rms(&lookup, channels)?,
            sample_rate_hz: number("tendon.sample_rate_hz", &get("tendon.sample_rate_hz")?, |rate| {
                rate.is_finite() && rate > 0.0
            })?,
            window_samples: count("tendon.window_samples", &get("tendon.window_samples")?)?,
            sequence_windows: lookup("tendon.sequence_windows")
                .map_or(Ok(1), |value| count("tendon.sequence_windows", &value))?,
            filters: read_filters(&get("tendon.filter")?)?,
            input: match lookup("tendon.input").as_deref() {
                None | Some("raw") => WindowInput::Raw,
                Some("envelope") => WindowInput::Envelope,
                Some(other) => return Err(senseless("tendon.input", other)),
            },
            classes: read_classes(&get("tendon.classes")?)?,
            trained_on: TrainedOn::read(&lookup)?,
            validation_accuracy: lookup(accuracy)
                .map(|value| number(accuracy, &value, |share| (0.0..=1.0).contains(&share)))
                .transpose()?,
            provenance: lookup("tendon.provenance"),
        })
    }

    /// Names of the channels that the model was trained on, in order, where they mean something in other recordings. Numbers do
    /// so in recordings of your own only: those of a data set count the electrodes of its own amplifier.
    pub fn remembered_channels(&self) -> &[String] {
        if are_numbers(&self.channel_names) && !self.trained_on.is_own() { &[] } else { &self.channel_names }
    }

    /// What is different if `given`, the names of the channels of `source` (such as `the recording gives`), are others than those
    /// the model was trained on; `None` if they are the same, or one of the two has no names.
    pub fn other_channels(&self, source: &str, given: &[String]) -> Option<String> {
        let known = self.remembered_channels();
        // A column that has only a number may be any channel of an amplifier that gives names.
        let is_unknown = known.is_empty() || (are_numbers(known) && !are_numbers(given));
        (!is_unknown && !are_same_channels(known, given))
            .then(|| format!("the model knows {}; {source} {}", known.join(", "), given.join(", ")))
    }

    /// Everything in which `source` differs from what the model was trained for.
    pub fn mismatches(&self, source: &WindowSource<'_>) -> Vec<Mismatch> {
        let mut mismatches = Vec::new();
        let mut compare = |what, same: bool, model: String, has: String| {
            if !same {
                mismatches.push(Mismatch { what, model, source: source.name, has });
            }
        };
        let channels = (self.channels, source.channels);
        compare("channels", channels.0 == channels.1, channels.0.to_string(), channels.1.to_string());
        compare(
            "sampling rate",
            self.sample_rate_hz == source.sample_rate_hz,
            format!("{} Hz", self.sample_rate_hz),
            format!("{} Hz", source.sample_rate_hz),
        );
        compare(
            "window",
            self.window_samples == source.window_samples,
            format!("{} samples", self.window_samples),
            format!("{} samples", source.window_samples),
        );
        compare(
            "sequence",
            self.sequence_windows <= source.sequence_windows,
            format!("{} windows together", self.sequence_windows),
            format!("{} at a time", source.sequence_windows),
        );
        if let Some(filter) = source.filter {
            for (what, wants, has) in filter_differences(&self.filters, filter) {
                compare(what, false, wants, has);
            }
        }
        let said = |input| match input {
            WindowInput::Raw => "the filtered signal".to_owned(),
            WindowInput::Envelope => "its envelope".to_owned(),
        };
        compare("input", self.input == source.input, said(self.input), said(source.input));
        mismatches
    }
}

/// Whether channels have only numbers for names.
fn are_numbers(names: &[String]) -> bool {
    names.iter().all(|name| name.parse::<usize>().is_ok())
}

/// Every setting in which `filter` is unlike all that are allowed: its key, what is allowed, what it is. Where each
/// setting is allowed, but not all together, the filters as a whole.
fn filter_differences(
    allowed: &[FilterSettings],
    filter: &FilterSettings,
) -> Vec<(&'static str, String, String)> {
    if allowed.contains(filter) {
        return Vec::new();
    }
    let all: Vec<_> = allowed.iter().map(filter_values).collect();
    let mut differences = Vec::new();
    for (place, (what, has)) in filter_values(filter).into_iter().enumerate() {
        let mut wants: Vec<&str> = Vec::new();
        for (_, value) in all.iter().map(|values| &values[place]) {
            if !wants.contains(&value.as_str()) {
                wants.push(value);
            }
        }
        if !wants.contains(&has.as_str()) {
            differences.push((what, wants.join(" or "), has));
        }
    }
    if differences.is_empty() {
        let whole = |filter| filter_values(filter).map(|(_, value)| value).join(", ");
        let wants = allowed.iter().map(whole).collect::<Vec<_>>().join("; or ");
        differences.push(("dsp.filter", wants, whole(filter)));
    }
    differences
}

/// Every setting of a filter: its key, and its value in words.
fn filter_values(filter: &FilterSettings) -> [(&'static str, String); 4] {
    let FilterSettings { notch_hz, notch_quality, band_pass_hz: [low, high], band_pass_order } = filter;
    let notch = notch_hz.map_or_else(|| "no notch".to_owned(), |hz| format!("a notch at {hz} Hz"));
    [
        ("dsp.filter.notch_hz", notch),
        ("dsp.filter.notch_quality", format!("a notch of quality {notch_quality}")),
        ("dsp.filter.band_pass_hz", format!("a band-pass of {low} to {high} Hz")),
        ("dsp.filter.band_pass_order", format!("a band-pass of order {band_pass_order}")),
    ]
}

/// One filter, or a list of those that are allowed.
fn read_filters(text: &str) -> Result<Vec<FilterSettings>, ContractProblem> {
    let list = serde_json::from_str::<Vec<FilterSettings>>(text);
    let filters = list.or_else(|_| serde_json::from_str::<FilterSettings>(text).map(|filter| vec![filter]));
    filters.ok().filter(|filters| !filters.is_empty()).ok_or_else(|| senseless("tendon.filter", text))
}

/// A JSON list with something for every channel; empty if the model does not say.
fn list<T: serde::de::DeserializeOwned>(
    key: &'static str,
    lookup: impl Fn(&str) -> Option<String>,
    channels: usize,
) -> Result<Vec<T>, ContractProblem> {
    let Some(text) = lookup(key) else { return Ok(Vec::new()) };
    let values: Option<Vec<T>> = serde_json::from_str(&text).ok();
    values.filter(|values| values.len() == channels).ok_or_else(|| senseless(key, &text))
}

fn rest_rms(lookup: impl Fn(&str) -> Option<String>, channels: usize) -> Result<Vec<f64>, ContractProblem> {
    let key = "tendon.rest_rms";
    let values: Vec<f64> = list(key, &lookup, channels)?;
    if values.iter().all(|value| value.is_finite() && *value > 0.0) {
        return Ok(values);
    }
    Err(senseless(key, &lookup(key).unwrap_or_default()))
}

fn count(key: &'static str, value: &str) -> Result<usize, ContractProblem> {
    value.parse().ok().filter(|count: &usize| *count > 0).ok_or_else(|| senseless(key, value))
}

fn number(key: &'static str, value: &str, is_valid: fn(f64) -> bool) -> Result<f64, ContractProblem> {
    value.parse().ok().filter(|number| is_valid(*number)).ok_or_else(|| senseless(key, value))
}

/// The classes of `extension,flexion,…`, each at most once.
fn read_classes(names: &str) -> Result<Vec<Class>, ContractProblem> {
    let mut classes = Vec::new();
    for name in names.split(',') {
        let class: Class = name.trim().parse().map_err(|_| senseless("tendon.classes", names))?;
        if classes.contains(&class) {
            return Err(ContractProblem::ClassTwice { class });
        }
        classes.push(class);
    }
    Ok(classes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tendon_gesture::Gesture;

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
    fn channels_are_remembered_by_name_and_by_number_in_own_recordings_only() {
        let contract = |names: &'static str, data_set: &'static str| {
            let read = |key: &str| match key {
                "tendon.channel_names" => Some(names.to_owned()),
                "tendon.data_set" => Some(data_set.to_owned()),
                _ => metadata(key),
            };
            Contract::read(read).unwrap()
        };
        let given = |names: &str| names.split(',').map(str::to_owned).collect::<Vec<String>>();
        let (own, named) = ("own recordings", contract(r#"["a","b","c","d"]"#, "3DC"));
        assert_eq!(named.other_channels("the recording gives", &given("a,b,c,d")), None);
        assert_eq!(
            named.other_channels("the recording gives", &given("time,a,b,c")).unwrap(),
            "the model knows a, b, c, d; the recording gives time, a, b, c"
        );
        // In another order, or without names.
        assert!(named.other_channels("the recording gives", &given("b,a,c,d")).is_some());
        assert!(named.other_channels("the recording gives", &given("0,1,2,3")).is_some());
        let numbered = contract(r#"["1","2","3","4"]"#, own);
        assert!(numbered.other_channels("the recording gives", &given("0,1,2,3")).is_some());
        assert_eq!(numbered.other_channels("the recording gives", &given("1,2,3,4")), None);
        assert_eq!(numbered.other_channels("the amplifier gives", &given("a,b,c,d")), None);
        let of_data_set = contract(r#"["0","3","5","8"]"#, "3DC");
        assert!(of_data_set.remembered_channels().is_empty());
        assert_eq!(of_data_set.other_channels("the recording gives", &given("0,1,2,3")), None);
    }

    #[test]
    fn a_contract_is_read_and_compared_by_name_of_what_differs() {
        let contract = Contract::read(metadata).unwrap();
        assert_eq!(contract.classes, Gesture::PAPER_ACTIVE.map(Class::Gesture));
        assert_eq!((contract.sequence_windows, contract.trained_on.people.len()), (1, 0));
        let filter = FilterSettings::default();
        let fitting = WindowSource {
            name: "the session",
            channels: 4,
            sample_rate_hz: 2000.0,
            window_samples: 600,
            sequence_windows: 1,
            filter: Some(&filter),
            input: WindowInput::Raw,
        };
        assert_eq!(contract.mismatches(&fitting), []);
        assert_eq!(contract.mismatches(&WindowSource { filter: None, ..fitting }), []);
        let other_filter = FilterSettings { notch_quality: 20.0, ..filter.clone() };
        let different = WindowSource {
            channels: 10,
            sample_rate_hz: 1000.0,
            window_samples: 300,
            filter: Some(&other_filter),
            input: WindowInput::Envelope,
            ..fitting
        };
        let others = FilterSettings { notch_hz: None, band_pass_hz: [20.0, 450.5], ..filter.clone() };
        let text: Vec<String> = contract
            .mismatches(&WindowSource { filter: Some(&others), ..fitting })
            .iter()
            .map(ToString::to_string)
            .collect();
        assert_eq!(
            text,
            [
                "dsp.filter.notch_hz: the model wants a notch at 60 Hz, the session has no notch",
                "dsp.filter.band_pass_hz: the model wants a band-pass of 5 to 500 Hz, the session has a band-pass of \
                 20 to 450.5 Hz",
            ]
        );
        let of_sequences = Contract { sequence_windows: 5, ..contract };
        let text: Vec<String> = of_sequences.mismatches(&different).iter().map(ToString::to_string).collect();
        assert_eq!(text.len(), 6);
        assert_eq!(text[0], "channels: the model wants 4, the session has 10");
        assert_eq!(text[1], "sampling rate: the model wants 2000 Hz, the session has 1000 Hz");
        assert_eq!(text[3], "sequence: the model wants 5 windows together, the session has 1 at a time");
    }

    #[test]
    fn a_model_may_allow_several_filters_and_the_refusal_names_them() {
        let filter = |notch_hz: Option<f64>, band_pass_order| FilterSettings {
            notch_hz,
            band_pass_order,
            ..FilterSettings::default()
        };
        let allowed = [filter(Some(60.0), 6), filter(Some(50.0), 4)];
        let contract = Contract::read(|key| match key {
            "tendon.filter" => serde_json::to_string(&allowed).ok(),
            _ => metadata(key),
        })
        .unwrap();
        let refusal = |filter: &FilterSettings| {
            let source = WindowSource {
                name: "the session",
                channels: 4,
                sample_rate_hz: 2000.0,
                window_samples: 600,
                sequence_windows: 1,
                filter: Some(filter),
                input: WindowInput::Raw,
            };
            contract.mismatches(&source).iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
        };
        assert_eq!(refusal(&allowed[0]) + &refusal(&allowed[1]), "");
        assert_eq!(
            refusal(&filter(None, 4)),
            "dsp.filter.notch_hz: the model wants a notch at 60 Hz or a notch at 50 Hz, the session has no notch"
        );
        // Each setting is one that is allowed, but not with the other.
        let together = refusal(&filter(Some(50.0), 6));
        assert!(together.starts_with("dsp.filter: the model wants a notch at 60 Hz"), "{together}");
        assert!(together.contains("order 6; or a notch at 50 Hz"), "{together}");
    }

    #[test]
    fn a_model_may_say_the_names_the_unit_and_the_rest_of_its_channels() {
        let read = |key: &'static str, value: &'static str| {
            Contract::read(|wanted| if wanted == key { Some(value.to_owned()) } else { metadata(wanted) })
        };
        let silent = Contract::read(metadata).unwrap();
        assert_eq!((silent.channel_names.len(), silent.unit.as_str(), silent.rest_rms.len()), (0, "", 0));
        let names = read("tendon.channel_names", r#"["0","3","5","8"]"#).unwrap().channel_names;
        assert_eq!(names, ["0", "3", "5", "8"]);
        assert_eq!(read("tendon.unit", "ADC counts").unwrap().unit, "ADC counts");
        assert_eq!(read("tendon.rest_rms", "[1, 2.5, 3, 4]").unwrap().rest_rms, [1.0, 2.5, 3.0, 4.0]);
        for (key, value) in [
            ("tendon.channel_names", r#"["0","3"]"#),
            ("tendon.rest_rms", "[1, 2, 3]"),
            ("tendon.rest_rms", "[1, 2, 3, 0]"),
            ("tendon.rest_rms", "quiet"),
            ("tendon.filter", "[]"),
        ] {
            let problem = read(key, value).unwrap_err().to_string();
            assert!(problem.contains(key) && problem.contains(value), "{problem}");
        }
    }

    #[test]
    fn what_a_model_may_say_besides_is_read() {
        let contract = Contract::read(|key| match key {
            "tendon.sequence_windows" => Some("5".to_owned()),
            "tendon.classes" => Some("rest,move".to_owned()),
            "tendon.people_trained" => Some("1 3 14".to_owned()),
            "tendon.data_set" => Some("3DC".to_owned()),
            "tendon.validation_accuracy" => Some("0.9123".to_owned()),
            _ => metadata(key),
        })
        .unwrap();
        assert_eq!(contract.sequence_windows, 5);
        assert_eq!(contract.classes, Class::REST_MOVE);
        let TrainedOn { data_set, people, held_out_sessions, held_out_repetitions } = contract.trained_on;
        assert_eq!(
            (data_set.as_deref(), people.as_slice()),
            (Some("3DC"), &[1, 3, 14].map(tendon_identity::PersonId::Number)[..])
        );
        assert_eq!((held_out_sessions.len(), held_out_repetitions.len()), (0, 0));
        assert_eq!(contract.validation_accuracy, Some(0.9123));
    }

    #[test]
    fn missing_and_senseless_metadata_are_named() {
        for (key, value, expected) in [
            ("tendon.channels", None, "lack `tendon.channels`"),
            ("tendon.channels", Some("0"), "`tendon.channels` is `0`"),
            ("tendon.sample_rate_hz", Some("fast"), "`tendon.sample_rate_hz` is `fast`"),
            ("tendon.filter", Some("none"), "`tendon.filter` is `none`"),
            ("tendon.input", Some("spectrum"), "`tendon.input` is `spectrum`"),
            ("tendon.classes", Some("Fist"), "`tendon.classes` is `Fist`"),
            ("tendon.contract_version", Some("2"), "contract version 2"),
            ("tendon.sequence_windows", Some("0"), "`tendon.sequence_windows` is `0`"),
            ("tendon.people_trained", Some("1 And 3"), "`tendon.people_trained` is `1 And 3`"),
            ("tendon.validation_accuracy", Some("NaN"), "`tendon.validation_accuracy` is `NaN`"),
            ("tendon.classes", Some("grip,rest,grip"), "name `grip` twice"),
        ] {
            let changed = |asked: &str| {
                if asked == key { value.map(str::to_owned) } else { metadata(asked) }
            };
            let error = Contract::read(changed).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
