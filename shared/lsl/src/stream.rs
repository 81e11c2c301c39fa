//! Streams on the network, and what they say of themselves.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use crate::library::{Info, Lsl, c_text, text};
use crate::{LslError, LslSettings};

/// Most streams that are listed.
const MOST_STREAMS: usize = 256;
/// Most channels whose description is read; beyond it the stream is more likely damaged than meant.
const MOST_CHANNELS: usize = 4096;
/// How long others are listened for once one stream has answered: liblsl asks each port of known peers only after 0.5 s.
const OTHERS: Duration = Duration::from_secs(1);

/// In which form a stream carries its values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// 32 bit floating point.
    Float32,
    /// 64 bit floating point.
    Double64,
    /// Text.
    String,
    /// 32 bit integers.
    Int32,
    /// 16 bit integers.
    Int16,
    /// 8 bit integers.
    Int8,
    /// 64 bit integers.
    Int64,
    /// A form that this program does not know.
    Unknown,
}

impl Format {
    /// By its number in liblsl.
    fn of_number(number: i32) -> Format {
        match number {
            1 => Format::Float32,
            2 => Format::Double64,
            3 => Format::String,
            4 => Format::Int32,
            5 => Format::Int16,
            6 => Format::Int8,
            7 => Format::Int64,
            _ => Format::Unknown,
        }
    }
}

/// What a stream says of a channel; each may be empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ChannelFacts {
    /// Its name.
    pub label: String,
    /// Unit of its values, in the sender's spelling.
    pub unit: String,
    /// What it measures, such as `EMG`.
    #[serde(rename = "type")]
    pub content_type: String,
}

/// What a stream says of itself.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StreamFacts {
    /// Name of the stream.
    pub name: String,
    /// Its content type, such as `EMG`.
    #[serde(rename = "type")]
    pub content_type: String,
    /// Names the device; may be empty.
    pub source_id: String,
    /// Of this one outlet: another one after a restart.
    pub uid: String,
    /// When this outlet was made, s on the clock of its computer.
    pub created_s: f64,
    /// The computer that sends it.
    pub hostname: String,
    /// Number of channels.
    pub channels: usize,
    /// Nominal sampling rate, Hz; 0 if it is irregular.
    pub sample_rate_hz: f64,
    /// Form of the values.
    pub format: Format,
    /// Its channels; empty if the stream describes none, or was not asked.
    pub channel_facts: Vec<ChannelFacts>,
}

impl StreamFacts {
    /// Whether `other` is a later outlet of the same device: this one's program has ended, but still seems to be there for some
    /// seconds. Streams without a source id are never taken for the same.
    fn is_replaced_by(&self, other: &StreamFacts) -> bool {
        let origin = |facts: &StreamFacts| {
            (facts.name.clone(), facts.content_type.clone(), facts.source_id.clone(), facts.hostname.clone())
        };
        !self.source_id.is_empty() && origin(self) == origin(other) && self.created_s < other.created_s
    }
}

impl fmt::Display for StreamFacts {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let StreamFacts { name, content_type, hostname, channels, sample_rate_hz, .. } = self;
        let plural = if *channels == 1 { "" } else { "s" };
        write!(out, "\"{name}\" (type {content_type}, {channels} channel{plural}, ")?;
        if *sample_rate_hz > 0.0 {
            write!(out, "{sample_rate_hz} Hz")?;
        } else {
            write!(out, "no fixed rate")?;
        }
        write!(out, ", on {hostname}")?;
        if !self.source_id.is_empty() {
            write!(out, ", source id {}", self.source_id)?;
        }
        write!(out, ")")
    }
}

/// A stream that was found, as liblsl holds it.
#[derive(Debug)]
pub struct Stream {
    lsl: Lsl,
    info: Info,
    /// What it says of itself.
    pub facts: StreamFacts,
}

impl Drop for Stream {
    fn drop(&mut self) {
        // SAFETY: the handle is this value's own and not used after.
        unsafe { (self.lsl.functions.destroy_streaminfo)(self.info) };
    }
}

// SAFETY: liblsl binds its handles to no thread, and nobody else has this one.
unsafe impl Send for Stream {}

impl Stream {
    /// Takes over a handle that liblsl gave.
    ///
    /// # Safety
    ///
    /// `info` is a valid handle of a stream's description that nobody else frees.
    pub(crate) unsafe fn own(lsl: Lsl, info: Info) -> Stream {
        // SAFETY: the caller's; what is read is copied.
        let facts = unsafe { facts(lsl, info) };
        Stream { lsl, info, facts }
    }

    pub(crate) fn info(&self) -> Info {
        self.info
    }
}

/// Reads what a description says.
///
/// # Safety
///
/// `info` is a valid handle.
unsafe fn facts(lsl: Lsl, info: Info) -> StreamFacts {
    let functions = lsl.functions;
    // SAFETY: all are getters of a valid handle, whose texts live as long as it.
    unsafe {
        let channels = usize::try_from((functions.get_channel_count)(info)).unwrap_or(0);
        StreamFacts {
            name: text((functions.get_name)(info)),
            content_type: text((functions.get_type)(info)),
            source_id: text((functions.get_source_id)(info)),
            uid: text((functions.get_uid)(info)),
            created_s: (functions.get_created_at)(info),
            hostname: text((functions.get_hostname)(info)),
            channels,
            sample_rate_hz: (functions.get_nominal_srate)(info),
            format: Format::of_number((functions.get_channel_format)(info)),
            channel_facts: channel_facts(lsl, info, channels),
        }
    }
}

/// What a description says of its channels: `desc/channels/channel/{label,unit,type}`.
///
/// # Safety
///
/// `info` is a valid handle.
unsafe fn channel_facts(lsl: Lsl, info: Info, channels: usize) -> Vec<ChannelFacts> {
    let functions = lsl.functions;
    let mut facts = Vec::new();
    // SAFETY: elements belong to the description, which lives through this; liblsl gives an empty element for one that is
    // not there, and takes it.
    unsafe {
        let list = (functions.child)((functions.get_desc)(info), c"channels".as_ptr());
        let mut channel = (functions.child)(list, c"channel".as_ptr());
        while (functions.empty)(channel) == 0 && facts.len() < channels.min(MOST_CHANNELS) {
            facts.push(ChannelFacts {
                label: text((functions.child_value_n)(channel, c"label".as_ptr())),
                unit: text((functions.child_value_n)(channel, c"unit".as_ptr())),
                content_type: text((functions.child_value_n)(channel, c"type".as_ptr())),
            });
            channel = (functions.next_sibling_n)(channel, c"channel".as_ptr());
        }
    }
    facts
}

impl Lsl {
    /// All streams that answer within `wait`. They do not say what their channels are: an [`crate::Inlet`] does.
    pub fn streams(self, wait: Duration) -> Vec<Stream> {
        // SAFETY: as many handles as there is room for are written.
        self.found(|infos| unsafe {
            (self.functions.resolve_all)(infos.as_mut_ptr(), infos.len() as u32, wait.as_secs_f64())
        })
    }

    /// The streams that these settings mean. Waits up to `wait` for the first one, and a second longer for others.
    ///
    /// # Errors
    ///
    /// [`LslError::Text`] when the settings hold a zero byte.
    pub fn find(self, settings: &LslSettings, wait: Duration) -> Result<Vec<Stream>, LslError> {
        let first = self.find_first(settings, wait)?;
        if first.is_empty() {
            return Ok(first);
        }
        let all = self.resolve(settings, 0, OTHERS)?;
        // An outlet that has just ended may be the only one that answered at first.
        Ok(if all.is_empty() { first } else { all })
    }

    /// The same, but only those that answer as soon as the first one.
    pub(crate) fn find_first(self, settings: &LslSettings, wait: Duration) -> Result<Vec<Stream>, LslError> {
        self.resolve(settings, 1, wait)
    }

    /// Waits until at least `minimum` streams have answered, all the time if that is 0.
    fn resolve(self, settings: &LslSettings, minimum: i32, wait: Duration) -> Result<Vec<Stream>, LslError> {
        let predicate = c_text(&settings.predicate())?;
        // SAFETY: the text lives through the call; as many handles as there is room for are written.
        Ok(self.found(|infos| unsafe {
            (self.functions.resolve_bypred)(
                infos.as_mut_ptr(),
                infos.len() as u32,
                predicate.as_ptr(),
                minimum,
                wait.as_secs_f64(),
            )
        }))
    }

    fn found(self, resolve: impl FnOnce(&mut [Info]) -> i32) -> Vec<Stream> {
        let mut infos = vec![std::ptr::null_mut(); MOST_STREAMS];
        let count = usize::try_from(resolve(&mut infos)).unwrap_or(0);
        infos.truncate(count);
        // SAFETY: liblsl wrote so many handles, which are the caller's.
        let mut streams: Vec<Stream> =
            infos.into_iter().map(|info| unsafe { Stream::own(self, info) }).collect();
        let all: Vec<StreamFacts> = streams.iter().map(|stream| stream.facts.clone()).collect();
        streams.retain(|stream| !all.iter().any(|other| stream.facts.is_replaced_by(other)));
        streams
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outlet_is_replaced_by_a_later_one_of_the_same_device_and_by_no_other() {
        let of = |source_id: &str, hostname: &str, created_s: f64| StreamFacts {
            name: "Armband".to_owned(),
            content_type: "EMG".to_owned(),
            source_id: source_id.to_owned(),
            uid: created_s.to_string(),
            created_s,
            hostname: hostname.to_owned(),
            channels: 8,
            sample_rate_hz: 1000.0,
            format: Format::Float32,
            channel_facts: Vec::new(),
        };
        let old = of("serial 1", "lab", 10.0);
        assert!(old.is_replaced_by(&of("serial 1", "lab", 11.0)));
        assert!(!old.is_replaced_by(&old) && !of("serial 1", "lab", 11.0).is_replaced_by(&old));
        assert!(!old.is_replaced_by(&of("serial 2", "lab", 11.0)));
        assert!(!old.is_replaced_by(&of("serial 1", "clinic", 11.0)));
        assert!(!of("", "lab", 10.0).is_replaced_by(&of("", "lab", 11.0)), "without an id nobody knows");
    }
}
