//! The line of JSON that comes first.

use serde::Deserialize;

/// Longest header line, bytes.
pub const LONGEST_HEADER: usize = 1 << 16;
/// Most channels.
const MOST_CHANNELS: usize = 1024;

/// What a program says of its samples.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Header {
    /// What the user calls the amplifier; may be left out.
    #[serde(default)]
    pub name: String,
    /// Names of the channels, in the order of the samples.
    pub channels: Vec<String>,
    /// Samples of each channel in a second, Hz.
    pub rate_hz: f64,
    /// Unit of the samples; may be left out if nobody knows it.
    #[serde(default)]
    pub unit: String,
}

/// A header that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum HeaderError {
    /// It is no JSON, or lacks something.
    #[error(
        "the first line of the stream is no header such as {{\"channels\": [\"flexor\", \"extensor\"], \"rate_hz\": 2000, \
         \"unit\": \"mV\"}}"
    )]
    Json(#[source] serde_json::Error),
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
        let header: Header = serde_json::from_slice(&bytes[..end]).map_err(HeaderError::Json)?;
        let channels = header.channels.len();
        if !(1..=MOST_CHANNELS).contains(&channels) {
            return Err(HeaderError::Channels { channels });
        }
        if !(1.0..=1e6).contains(&header.rate_hz) {
            return Err(HeaderError::Rate { rate_hz: header.rate_hz });
        }
        Ok(Some((header, end + 1)))
    }
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
        assert!(refusal("{\"channels\": [\"a\"], \"rate\": 5}\n").contains("no header"));
        assert!(refusal(&"x".repeat(LONGEST_HEADER)).contains("longer than"));
        let names = vec!["\"a\""; 1025].join(",");
        assert!(refusal(&format!("{{\"channels\": [{names}], \"rate_hz\": 1}}\n")).contains("1025 channels"));
    }
}
