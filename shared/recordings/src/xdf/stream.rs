//! A stream: what its head says, and its samples.

use roxmltree::{Document, Node};

use super::chunks::{Contents, length};

/// A stream of the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stream {
    pub(super) id: u32,
    pub(super) name: String,
    pub(super) content_type: String,
    /// 0 of one without a rate.
    pub(super) rate_hz: f64,
    format: Format,
    pub(super) channels: Vec<StreamChannel>,
    /// It says itself that samples may be missing.
    pub(super) can_drop_samples: bool,
}

/// A channel of a stream.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StreamChannel {
    /// As in the head, else its number from 0.
    pub(super) label: String,
    pub(super) unit: String,
}

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Format {
    Int8,
    Int16,
    Int32,
    Int64,
    Float32,
    Double64,
    Text,
}

/// What was read of a stream.
pub(super) struct Samples {
    /// Of the chosen channels.
    pub(super) columns: Vec<Vec<f32>>,
    pub(super) stamps: Stamps,
    /// A chunk of them could not be read to its end.
    pub(super) is_damaged: bool,
}

/// When samples were taken, by the stream's own clock.
#[derive(Default)]
pub(super) struct Stamps {
    /// Of each sample, in s.
    pub(super) times_s: Vec<f64>,
    /// The samples that have one of their own; the others follow on.
    pub(super) own: Vec<usize>,
}

/// More channels than any device has.
const MAX_CHANNELS: usize = 4096;

impl Stream {
    /// Reads the head of stream `id`; `None` if it does not say what it has to.
    pub(super) fn read(id: u32, head: &str) -> Option<Stream> {
        let document = Document::parse(head).ok()?;
        let root = document.root_element();
        let field = |name: &str| text_of(root, name);
        let format = match field("channel_format")?.as_str() {
            "int8" => Format::Int8,
            "int16" => Format::Int16,
            "int32" => Format::Int32,
            "int64" => Format::Int64,
            "float32" => Format::Float32,
            "double64" => Format::Double64,
            "string" => Format::Text,
            _ => return None,
        };
        let count: usize = field("channel_count")?.parse().ok()?;
        if !(1..=MAX_CHANNELS).contains(&count) {
            return None;
        }
        let description = child(root, "desc");
        let listed: Vec<Node<'_, '_>> = description
            .and_then(|description| child(description, "channels"))
            .into_iter()
            .flat_map(|channels| channels.children().filter(|channel| channel.has_tag_name("channel")))
            .collect();
        let channel = |number: usize| {
            let text = |name: &str| listed.get(number).and_then(|channel| text_of(*channel, name));
            let label = text("label").filter(|label| !label.is_empty()).unwrap_or_else(|| number.to_string());
            StreamChannel { label, unit: text("unit").unwrap_or_default() }
        };
        let can_drop_samples = description
            .and_then(|description| text_of(child(description, "synchronization")?, "can_drop_samples"))
            .is_some_and(|answer| answer.eq_ignore_ascii_case("true"));
        Some(Stream {
            id,
            name: field("name").unwrap_or_default(),
            content_type: field("type").unwrap_or_default(),
            rate_hz: field("nominal_srate")?.parse().ok().filter(|rate_hz: &f64| rate_hz.is_finite())?,
            format,
            channels: (0..count).map(channel).collect(),
            can_drop_samples,
        })
    }

    /// Whether it has numbers at a rate.
    pub(super) fn is_readable(&self) -> bool {
        self.rate_hz > 0.0 && !self.is_text()
    }

    /// Whether its samples are texts.
    pub(super) fn is_text(&self) -> bool {
        self.format == Format::Text
    }

    /// Whether its texts say what happens. Others may be results, such as decisions.
    pub(super) fn is_of_markers(&self) -> bool {
        let content_type = self.content_type.to_ascii_lowercase();
        self.is_text() && ["marker", "event", "stim"].iter().any(|kind| content_type.starts_with(kind))
    }

    /// The channel that `STREAM: CHANNEL` means, if it is of this stream.
    pub(super) fn own_channel<'a>(&self, name: &'a str) -> Option<&'a str> {
        name.strip_prefix(self.name.as_str())?.strip_prefix(": ").filter(|_| !self.name.is_empty())
    }

    /// All samples of the chosen channels.
    pub(super) fn samples(&self, contents: &Contents<'_>, chosen: &[usize]) -> Samples {
        let mut samples =
            Samples { columns: vec![Vec::new(); chosen.len()], stamps: Stamps::default(), is_damaged: false };
        let size = self.format.size();
        for chunk in self.chunks(contents) {
            let read = self.read_chunk(chunk, &mut samples.stamps, |mut rest| {
                let (values, after) = rest.split_at_checked(size * self.channels.len())?;
                rest = after;
                for (column, channel) in samples.columns.iter_mut().zip(chosen) {
                    column.push(self.format.number(&values[channel * size..][..size]));
                }
                Some(rest)
            });
            samples.is_damaged |= read.is_none();
        }
        samples
    }

    /// All texts of its first channel, with their stamps.
    pub(super) fn texts(&self, contents: &Contents<'_>) -> Vec<(f64, String)> {
        let mut stamps = Stamps::default();
        let mut texts = Vec::new();
        for chunk in self.chunks(contents) {
            // What is read of a damaged chunk is right.
            let _ = self.read_chunk(chunk, &mut stamps, |mut rest| {
                for channel in 0..self.channels.len() {
                    let (bytes, after) = length(rest)?;
                    let (text, after) = after.split_at_checked(bytes)?;
                    if channel == 0 {
                        texts.push(String::from_utf8_lossy(text).into_owned());
                    }
                    rest = after;
                }
                Some(rest)
            });
            texts.truncate(stamps.times_s.len());
        }
        stamps.times_s.into_iter().zip(texts).collect()
    }

    fn chunks<'a>(&self, contents: &Contents<'a>) -> impl Iterator<Item = &'a [u8]> {
        let id = self.id;
        contents.samples.iter().filter(move |(stream, _)| *stream == id).map(|(_, chunk)| *chunk)
    }

    /// Reads the samples of a chunk, each with its stamp, its values by `read_values`; `None` if it is damaged.
    fn read_chunk<'a>(
        &self,
        chunk: &'a [u8],
        stamps: &mut Stamps,
        mut read_values: impl FnMut(&'a [u8]) -> Option<&'a [u8]>,
    ) -> Option<()> {
        let period_s = if self.rate_hz > 0.0 { 1.0 / self.rate_hz } else { 0.0 };
        let (count, mut rest) = length(chunk)?;
        for _ in 0..count {
            let (has_stamp, after) = rest.split_first()?;
            let (stamp_s, after) = match has_stamp {
                0 => (stamps.times_s.last().map_or(0.0, |last| last + period_s), after),
                8 => after.split_first_chunk().map(|(stamp, after)| (f64::from_le_bytes(*stamp), after))?,
                _ => return None,
            };
            if !stamp_s.is_finite() {
                return None;
            }
            rest = read_values(after)?;
            if *has_stamp != 0 {
                stamps.own.push(stamps.times_s.len());
            }
            stamps.times_s.push(stamp_s);
        }
        Some(())
    }
}

impl Format {
    /// Bytes of a value.
    fn size(self) -> usize {
        match self {
            Format::Int8 => 1,
            Format::Int16 => 2,
            Format::Int32 | Format::Float32 => 4,
            Format::Int64 | Format::Double64 => 8,
            Format::Text => 0,
        }
    }

    fn number(self, bytes: &[u8]) -> f32 {
        match (self, bytes) {
            (Format::Int8, &[a]) => f32::from(a as i8),
            (Format::Int16, &[a, b]) => f32::from(i16::from_le_bytes([a, b])),
            (Format::Int32, &[a, b, c, d]) => i32::from_le_bytes([a, b, c, d]) as f32,
            (Format::Float32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            (Format::Int64, &[a, b, c, d, e, f, g, h]) => i64::from_le_bytes([a, b, c, d, e, f, g, h]) as f32,
            (Format::Double64, &[a, b, c, d, e, f, g, h]) => {
                f64::from_le_bytes([a, b, c, d, e, f, g, h]) as f32
            }
            _ => f32::NAN,
        }
    }
}

fn child<'a, 'b>(node: Node<'a, 'b>, name: &str) -> Option<Node<'a, 'b>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn text_of(node: Node<'_, '_>, name: &str) -> Option<String> {
    child(node, name).map(|child| child.text().unwrap_or_default().trim().to_owned())
}
