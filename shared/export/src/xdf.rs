//! Writing the Extensible Data Format (XDF 1.0, github.com/sccn/xdf/wiki/Specifications).
//!
//! ```text
//! "XDF:"  chunks: length (varlen), tag u16, [stream u32], content; little-endian
//!   1 file header (XML)   2 stream header (XML)   3 samples   4 clock offset   5 boundary   6 stream footer (XML)
//! ```
//!
//! All streams are on one clock, so the clock offsets, which readers look for, are 0.

use std::fmt::Write as _;
use std::io::{self, Write};

const FILE_HEADER: u16 = 1;
const STREAM_HEADER: u16 = 2;
const SAMPLES: u16 = 3;
const CLOCK_OFFSET: u16 = 4;
const BOUNDARY: u16 = 5;
const STREAM_FOOTER: u16 = 6;

/// What a reader finds its place again by in a damaged file.
const BOUNDARY_UUID: [u8; 16] =
    [0x43, 0xA5, 0x46, 0xDC, 0xCB, 0xF5, 0x41, 0x0F, 0xB3, 0x0E, 0xD5, 0x46, 0x73, 0x83, 0xCB, 0xE4];
/// Time between two boundaries, s.
const BOUNDARY_INTERVAL_S: f64 = 10.0;
/// Time that the samples of a chunk cover, s.
const CHUNK_S: f64 = 0.1;

/// A channel of a stream.
#[derive(Clone, Debug)]
pub(crate) struct XdfChannel {
    pub(crate) label: String,
    /// Empty if nobody knows.
    pub(crate) unit: String,
}

/// A stream.
#[derive(Clone, Debug)]
pub(crate) struct XdfStream {
    pub(crate) name: String,
    pub(crate) content_type: &'static str,
    pub(crate) channels: Vec<XdfChannel>,
    /// 0 where samples come irregularly.
    pub(crate) sample_rate_hz: f64,
    pub(crate) is_text: bool,
}

/// Which stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct StreamId(usize);

/// Values of a sample.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Values<'a> {
    Numbers(&'a [f32]),
    Texts(&'a [&'a str]),
}

/// A file that is being written.
#[derive(Debug)]
pub(crate) struct XdfWriter<W: Write> {
    output: W,
    streams: Vec<Written>,
    next_boundary_s: Option<f64>,
}

/// What was written of a stream.
#[derive(Debug, Default)]
struct Written {
    sample_rate_hz: f64,
    /// Samples that are gathered for a chunk: how many, since when, and their bytes.
    count: u64,
    since_s: f64,
    pending: Vec<u8>,
    first_s: f64,
    last_s: f64,
    samples: u64,
}

impl<W: Write> XdfWriter<W> {
    /// Begins a file of a recording that was made at `recorded_at`, RFC 3339, of this person; empty if there was none.
    pub(crate) fn begin(mut output: W, recorded_at: &str, person: &str) -> io::Result<XdfWriter<W>> {
        output.write_all(b"XDF:")?;
        let mut writer = XdfWriter { output, streams: Vec::new(), next_boundary_s: None };
        let header = format!(
            "<?xml version=\"1.0\"?><info><version>1.0</version><datetime>{}</datetime><person>{}</person></info>",
            escaped(recorded_at),
            escaped(person)
        );
        writer.chunk(FILE_HEADER, None, header.as_bytes())?;
        Ok(writer)
    }

    /// Adds a stream, whose first sample comes not before `begun_s`.
    pub(crate) fn add(&mut self, stream: &XdfStream, begun_s: f64) -> io::Result<StreamId> {
        let id = self.streams.len();
        self.streams.push(Written {
            sample_rate_hz: stream.sample_rate_hz,
            first_s: begun_s,
            last_s: begun_s,
            ..Written::default()
        });
        self.chunk(STREAM_HEADER, Some(id), header_of(stream).as_bytes())?;
        self.clock_offset(id, begun_s)?;
        Ok(StreamId(id))
    }

    /// Adds a sample with its time stamp. `follows` says that it comes one period after the one before.
    pub(crate) fn sample(
        &mut self,
        StreamId(id): StreamId,
        at_s: f64,
        follows: bool,
        values: Values<'_>,
    ) -> io::Result<()> {
        let stream = &self.streams[id];
        if stream.count > 0 && (at_s - stream.since_s >= CHUNK_S || at_s < stream.since_s) {
            self.flush(id)?;
        }
        let stream = &mut self.streams[id];
        if stream.count == 0 {
            stream.since_s = at_s;
        }
        if follows && stream.count > 0 && stream.sample_rate_hz > 0.0 {
            stream.pending.push(0);
        } else {
            stream.pending.push(8);
            stream.pending.extend(at_s.to_le_bytes());
        }
        match values {
            Values::Numbers(numbers) => {
                numbers.iter().for_each(|number| stream.pending.extend(number.to_le_bytes()));
            }
            Values::Texts(texts) => {
                for text in texts {
                    put_length(&mut stream.pending, text.len() as u64);
                    stream.pending.extend(text.as_bytes());
                }
            }
        }
        if stream.samples == 0 {
            stream.first_s = at_s;
        }
        (stream.count, stream.samples, stream.last_s) = (stream.count + 1, stream.samples + 1, at_s);
        Ok(())
    }

    /// Ends the file.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        let end_s = self.streams.iter().map(|stream| stream.last_s).fold(f64::NEG_INFINITY, f64::max);
        for id in 0..self.streams.len() {
            self.flush(id)?;
            self.clock_offset(id, end_s)?;
            let Written { first_s, last_s, samples, .. } = self.streams[id];
            let footer = format!(
                "<?xml version=\"1.0\"?><info><first_timestamp>{first_s}</first_timestamp>\
                 <last_timestamp>{last_s}</last_timestamp><sample_count>{samples}</sample_count><clock_offsets>\
                 <offset><time>{first_s}</time><value>0</value></offset>\
                 <offset><time>{end_s}</time><value>0</value></offset></clock_offsets></info>"
            );
            self.chunk(STREAM_FOOTER, Some(id), footer.as_bytes())?;
        }
        self.output.flush()
    }

    /// Writes the samples that are gathered of a stream.
    fn flush(&mut self, id: usize) -> io::Result<()> {
        let stream = &mut self.streams[id];
        let (count, since_s) = (std::mem::take(&mut stream.count), stream.since_s);
        if count == 0 {
            return Ok(());
        }
        let mut content = Vec::with_capacity(stream.pending.len() + 9);
        put_length(&mut content, count);
        content.append(&mut stream.pending);
        self.chunk(SAMPLES, Some(id), &content)?;
        if self.next_boundary_s.is_none_or(|next_s| since_s >= next_s) {
            self.next_boundary_s = Some(since_s + BOUNDARY_INTERVAL_S);
            self.chunk(BOUNDARY, None, &BOUNDARY_UUID)?;
        }
        Ok(())
    }

    fn clock_offset(&mut self, id: usize, at_s: f64) -> io::Result<()> {
        let content = [at_s.to_le_bytes(), 0.0_f64.to_le_bytes()].concat();
        self.chunk(CLOCK_OFFSET, Some(id), &content)
    }

    fn chunk(&mut self, tag: u16, stream: Option<usize>, content: &[u8]) -> io::Result<()> {
        let mut head = Vec::with_capacity(16);
        let id = stream.map(|id| id as u32 + 1);
        let length = size_of::<u16>() + id.map_or(0, |_| size_of::<u32>()) + content.len();
        put_length(&mut head, length as u64);
        head.extend(tag.to_le_bytes());
        if let Some(id) = id {
            head.extend(id.to_le_bytes());
        }
        self.output.write_all(&head)?;
        self.output.write_all(content)
    }
}

/// Whether `beginning`, the first 512 bytes of a file, are those of an export: recorders of streams name no person in the file's
/// header.
pub fn is_exported_xdf(beginning: &[u8]) -> bool {
    let header = b"</datetime><person>";
    beginning.starts_with(b"XDF:") && beginning.windows(header.len()).any(|bytes| bytes == header)
}

/// A length in as many bytes as it needs of 1, 4 and 8, behind how many these are.
fn put_length(bytes: &mut Vec<u8>, length: u64) {
    if let Ok(length) = u8::try_from(length) {
        bytes.extend([1, length]);
    } else if let Ok(length) = u32::try_from(length) {
        bytes.push(4);
        bytes.extend(length.to_le_bytes());
    } else {
        bytes.push(8);
        bytes.extend(length.to_le_bytes());
    }
}

/// A stream's description, as the Lab Streaming Layer has it.
fn header_of(stream: &XdfStream) -> String {
    let mut channels = String::new();
    for XdfChannel { label, unit } in &stream.channels {
        let _ = write!(
            channels,
            "<channel><label>{}</label><unit>{}</unit><type>{}</type></channel>",
            escaped(label),
            escaped(unit),
            stream.content_type
        );
    }
    format!(
        "<?xml version=\"1.0\"?><info><name>{name}</name><type>{}</type><channel_count>{}</channel_count>\
         <nominal_srate>{}</nominal_srate><channel_format>{}</channel_format><source_id>{name}</source_id>\
         <desc><channels>{channels}</channels><synchronization><can_drop_samples>true</can_drop_samples>\
         </synchronization></desc></info>",
        stream.content_type,
        stream.channels.len(),
        stream.sample_rate_hz,
        if stream.is_text { "string" } else { "float32" },
        name = escaped(&stream.name)
    )
}

/// Text in XML 1.0, which knows no control characters.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            character if character.is_control() => escaped.push(' '),
            character => escaped.push(character),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(channels: usize, sample_rate_hz: f64, is_text: bool) -> XdfStream {
        let channel = XdfChannel { label: "a<b".to_owned(), unit: "uV".to_owned() };
        let name = "test & trial".to_owned();
        XdfStream { name, content_type: "EMG", channels: vec![channel; channels], sample_rate_hz, is_text }
    }

    fn contains(bytes: &[u8], part: &[u8]) -> bool {
        bytes.windows(part.len()).any(|window| window == part)
    }

    /// The bytes that pyxdf 1.17.5 reads as 10.0 [1.5, -2], 10.0005 [0.25, 0] and 10.5 "fist".
    #[test]
    fn samples_and_markers_are_the_bytes_that_pyxdf_reads() {
        let mut bytes = Vec::new();
        let mut writer = XdfWriter::begin(&mut bytes, "2026-05-04T09:12:33Z", "anna").unwrap();
        let emg = writer.add(&stream(2, 2000.0, false), 10.0).unwrap();
        let markers = writer.add(&stream(1, 0.0, true), 10.0).unwrap();
        writer.sample(emg, 10.0, false, Values::Numbers(&[1.5, -2.0])).unwrap();
        writer.sample(emg, 10.0005, true, Values::Numbers(&[0.25, 0.0])).unwrap();
        writer.sample(markers, 10.5, false, Values::Texts(&["fist"])).unwrap();
        writer.finish().unwrap();
        let samples = b"\x01\x22\x03\x00\x01\0\0\0\x01\x02\x08\0\0\0\0\0\0\x24\x40\0\0\xc0\x3f\0\0\0\xc0\0\0\0\x80\x3e\0\0\0\0";
        assert!(contains(&bytes, samples));
        assert!(contains(&bytes, b"\x01\x17\x03\x00\x02\0\0\0\x01\x01\x08\0\0\0\0\0\0\x25\x40\x01\x04fist"));
        assert!(bytes.starts_with(b"XDF:\x01"));
        assert!(is_exported_xdf(&bytes[..bytes.len().min(512)]));
        let recorded = b"XDF:\x01\x5f\x01\0<?xml version=\"1.0\"?><info><version>1.0</version><datetime>2026</datetime></info>";
        assert!(!is_exported_xdf(recorded) && !is_exported_xdf(b"") && !is_exported_xdf(&bytes[4..]));
        assert!(contains(&bytes, &BOUNDARY_UUID) && contains(&bytes, b"<label>a&lt;b</label>"));
        assert!(contains(&bytes, b"<sample_count>2</sample_count>"));
        assert!(contains(&bytes, b"test &amp; trial"));
    }
}
