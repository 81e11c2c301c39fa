//! The line of JSON that comes first.

use serde_json::{Map, Value};

/// Longest header line, bytes.
pub const LONGEST_HEADER: usize = 1 << 16;
/// Most channels.
const MOST_CHANNELS: usize = 1024;
/// A header as it should be.
const EXAMPLE: &str = r#"{"channels": ["flexor", "extensor"], "rate_hz": 2000, "unit": "mV"}"#;
/// So many characters of what was found are shown.
const SHOWN: usize = 60;

/// What a program says of its samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// What the user calls the amplifier; may be left out.
    pub name: String,
    /// Names of the channels, in the order of the samples.
    pub channels: Vec<String>,
    /// Samples of each channel in a second, Hz.
    pub rate_hz: f64,
    /// Unit of the samples; may be left out if nobody knows it.
    pub unit: String,
}

/// A header that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum HeaderError {
    /// It is no JSON object.
    #[error(
        "the first line of the stream is no header such as {EXAMPLE}: from column {column} on, it is no JSON object: {line}"
    )]
    Json {
        /// Where that shows, from 1.
        column: usize,
        /// Its beginning.
        line: String,
    },
    /// A field is something else than it should be.
    #[error("the header says {field}: {found}: give {expected}, as in {EXAMPLE}")]
    Field {
        /// Its name.
        field: &'static str,
        /// What was found, as JSON.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
    /// A field that has to be there is not.
    #[error("the header has no {field}: give {expected}, as in {EXAMPLE}")]
    Missing {
        /// Its name.
        field: &'static str,
        /// What it should be.
        expected: &'static str,
    },
    /// A field that means nothing.
    #[error(
        "the header says {field}, which means nothing here: it has name, channels, rate_hz and unit, as in {EXAMPLE}"
    )]
    Unknown {
        /// Its name.
        field: String,
    },
    /// It does not end.
    #[error(
        "the first line of the stream is longer than {LONGEST_HEADER} bytes: it must be a header in JSON that ends with a newline"
    )]
    TooLong,
    /// A number of channels that cannot be.
    #[error("the header names {channels} channels: name 1 to {MOST_CHANNELS}")]
    Channels {
        /// How many it names.
        channels: usize,
    },
    /// A rate that cannot be.
    #[error("the header's rate_hz is {rate_hz}: say 1 to 1000000 Hz")]
    Rate {
        /// What it says.
        rate_hz: f64,
    },
}

impl Header {
    /// Reads the header at the beginning of a stream; gives it and the number of its bytes, the newline included. `None` while
    /// it has not come as a whole.
    ///
    /// # Errors
    ///
    /// [`HeaderError`].
    pub fn parse(bytes: &[u8]) -> Result<Option<(Header, usize)>, HeaderError> {
        let Some(end) = bytes.iter().take(LONGEST_HEADER).position(|byte| *byte == b'\n') else {
            return if bytes.len() < LONGEST_HEADER { Ok(None) } else { Err(HeaderError::TooLong) };
        };
        let line = &bytes[..end];
        let no_object = |column| HeaderError::Json { column, line: shown(&String::from_utf8_lossy(line)) };
        let value = serde_json::from_slice(line).map_err(|error| no_object(error.column().max(1)))?;
        let Value::Object(fields) = value else { return Err(no_object(1)) };
        let header = Header::of_fields(fields)?;
        let channels = header.channels.len();
        if !(1..=MOST_CHANNELS).contains(&channels) {
            return Err(HeaderError::Channels { channels });
        }
        if !(1.0..=1e6).contains(&header.rate_hz) {
            return Err(HeaderError::Rate { rate_hz: header.rate_hz });
        }
        Ok(Some((header, end + 1)))
    }

    fn of_fields(mut fields: Map<String, Value>) -> Result<Header, HeaderError> {
        let text = |value: &Value| value.as_str().map(str::to_owned);
        let names = |value: &Value| value.as_array()?.iter().map(text).collect::<Option<Vec<String>>>();
        let (a_text, a_list) = ("a text", "the name of each channel");
        let a_rate = "the samples of each channel in a second, as a number";
        let missing = |field, expected| HeaderError::Missing { field, expected };
        let header = Header {
            name: take(&mut fields, "name", a_text, text)?.unwrap_or_default(),
            channels: take(&mut fields, "channels", a_list, names)?.ok_or(missing("channels", a_list))?,
            rate_hz: take(&mut fields, "rate_hz", a_rate, Value::as_f64)?
                .ok_or(missing("rate_hz", a_rate))?,
            unit: take(&mut fields, "unit", a_text, text)?.unwrap_or_default(),
        };
        match fields.into_iter().next() {
            None => Ok(header),
            Some((field, _)) => Err(HeaderError::Unknown { field: shown(&field) }),
        }
    }
}

/// Takes a field out of a header, if it is there.
fn take<T>(
    fields: &mut Map<String, Value>,
    field: &'static str,
    expected: &'static str,
    read: impl Fn(&Value) -> Option<T>,
) -> Result<Option<T>, HeaderError> {
    let Some(value) = fields.remove(field) else { return Ok(None) };
    read(&value).map(Some).ok_or_else(|| HeaderError::Field {
        field,
        found: shown(&value.to_string()),
        expected,
    })
}

/// The beginning of what was found, without anything that acts on a terminal.
fn shown(found: &str) -> String {
    let mut characters =
        found.chars().map(|character| if character.is_control() { '\u{fffd}' } else { character });
    let begin: String = characters.by_ref().take(SHOWN).collect();
    if characters.next().is_some() { begin + "…" } else { begin }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_is_read_up_to_its_newline() {
        let text =
            b"{\"channels\": [\"flexor\", \"extensor\"], \"rate_hz\": 1259.259, \"unit\": \"uV\"}\nEMGf";
        for end in 0..text.len() - 4 {
            assert_eq!(Header::parse(&text[..end]).unwrap(), None);
        }
        let (header, length) = Header::parse(text).unwrap().unwrap();
        assert_eq!(&text[length..], b"EMGf");
        assert_eq!(header.channels, ["flexor", "extensor"]);
        assert_eq!((header.rate_hz, header.unit.as_str(), header.name.as_str()), (1259.259, "uV", ""));
    }

    #[test]
    fn headers_that_cannot_be_used_are_refused_with_the_reason() {
        let refusal = |text: &str| Header::parse(text.as_bytes()).unwrap_err().to_string();
        assert!(refusal("GET / HTTP/1.1\r\n").contains("no header such as {\"channels\""));
        assert!(refusal("{\"channels\": [], \"rate_hz\": 2000}\n").contains("0 channels"));
        assert!(refusal("{\"channels\": [\"a\"], \"rate_hz\": 0}\n").contains("rate_hz is 0"));
        let no_rate = refusal("{\"channels\": [\"a\"], \"rate\": 5}\n");
        assert!(
            no_rate.starts_with("the header has no rate_hz: give the samples of each channel in a second"),
            "{no_rate}"
        );
        assert!(refusal(&"x".repeat(LONGEST_HEADER)).contains("longer than"));
        let said =
            |fields: &str| refusal(&format!("{{\"channels\": [\"a\"], \"rate_hz\": 2000, {fields}}}\n"));
        let example = "as in {\"channels\": [\"flexor\", \"extensor\"], \"rate_hz\": 2000, \"unit\": \"mV\"}";
        let wrong_unit = said("\"unit\": 5");
        assert_eq!(wrong_unit, format!("the header says unit: 5: give a text, {example}"));
        assert!(
            said("\"rate_hz\": \"2 kHz\"")
                .starts_with("the header says rate_hz: \"2 kHz\": give the samples")
        );
        assert!(
            said("\"channels\": 4").starts_with("the header says channels: 4: give the name of each channel")
        );
        assert!(said("\"channels\": [\"a\", 2]").starts_with("the header says channels: [\"a\",2]: give"));
        assert!(said("\"gain\": 1").starts_with("the header says gain, which means nothing here"));
        assert!(
            said("oops").contains("from column 38 on, it is no JSON object: {\"channels\":"),
            "{}",
            said("oops")
        );
        // What comes from elsewhere gives a terminal no orders and fills no screen.
        let long = said(&format!("\"name\": [\"\\u001b[31m{}\"]", "x".repeat(5000)));
        assert!(!long.contains('\x1b') && long.len() < 300, "{long}");
        let names = vec!["\"a\""; 1025].join(",");
        assert!(refusal(&format!("{{\"channels\": [{names}], \"rate_hz\": 1}}\n")).contains("1025 channels"));
    }
}
