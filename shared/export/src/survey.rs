//! What a recording says of itself and what its samples are like: all that has to be known before the first byte of an export
//! is written.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::Serialize;
use serde_json::Value;
use tendon_config::Config;
use tendon_gesture::Strategy;
use tendon_people::{PersonName, name_in};
use tendon_session_file::{
    Block, CONFIGURATION, ContextRecord, Message, PERSON, Reader, Record, TASK, TraceRecord,
};
use tendon_zones::TaskReport;

use crate::bdf::Part;
use crate::timeline::captured_ns;
use crate::{ExportError, Timeline};

/// Samples that are missing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// Time of the first missing sample, s.
    pub start_s: f64,
    /// Time of the first sample behind it, s.
    pub end_s: f64,
    /// Number of the sample behind it, counted over the recorded ones.
    #[serde(skip)]
    pub row: u64,
}

/// Some time, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    pub(crate) start_s: f64,
    pub(crate) end_s: f64,
}

/// Spans of unusable samples that are no farther apart are one, s.
const UNUSABLE_APART_S: f64 = 1.0;

/// What is known of a recording.
#[derive(Clone, Debug)]
pub struct Survey {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Name of the session.
    pub session: String,
    /// The configuration as run.
    pub config: Config,
    /// The same as the text of a `tendon.toml`.
    pub configuration: String,
    /// Where it comes from; `null` if the file does not say.
    pub provenance: Value,
    /// Whose session it was, if it had a person.
    pub person: Option<PersonName>,
    /// How the target zones went, if there were any.
    pub task: Option<TaskReport>,
    /// Names of the channels.
    pub channels: Vec<String>,
    /// Unit of the samples; empty if nobody knows.
    pub unit: String,
    /// Names of the gestures, by class number.
    pub gestures: Vec<String>,
    /// Rate of the samples, Hz.
    pub sample_rate_hz: f64,
    /// When the first sample was captured.
    pub begun_at: SystemTime,
    /// The same on CLOCK_MONOTONIC, ns.
    pub begun_ns: u64,
    /// Samples of each channel.
    pub samples: u64,
    /// From the first sample to after the last, s.
    pub duration_s: f64,
    /// Where samples are missing.
    pub gaps: Vec<Gap>,
    /// Where samples are NaN or infinite.
    pub(crate) unusable: Vec<Span>,
    /// Smallest and largest finite sample of each channel; `(0, 0)` where there is none.
    pub ranges: Vec<(f32, f32)>,
    /// Whether the file was finished; `false` if its recorder was killed.
    pub is_whole: bool,
    /// Whether the file is damaged outside its samples, so that what it says of the session may be wrong.
    pub is_damaged_elsewhere: bool,
    /// Whether the session had a person, and the file does not tell any more who it was.
    pub lacks_person: bool,
    /// Damaged pieces of the file that were left out.
    pub damaged_pieces: u64,
    /// Their bytes.
    pub damaged_bytes: u64,
}

impl Survey {
    /// Looks through the file at `path`. `has_read` is told how many bytes were read so far, and may end it.
    ///
    /// # Errors
    ///
    /// [`ExportError`].
    pub fn read(
        path: &Path,
        mut has_read: impl FnMut(u64) -> Result<(), ExportError>,
    ) -> Result<Survey, ExportError> {
        let mut reader = Reader::open(path)?;
        let mut said = Said::default();
        let mut samples = None;
        while let Some(record) = reader.next()? {
            match record {
                Record::Attachment { name, bytes } => said.take_file(&name, &bytes),
                Record::Metadata { name, facts } => said.take_facts(&name, facts),
                Record::Message(Message::Block(block)) => {
                    samples.get_or_insert_with(|| Samples::begin(&block)).take(&block, path)?;
                }
                Record::Message(_) => {}
            }
            has_read(reader.bytes_read())?;
        }
        let samples = samples.ok_or_else(|| ExportError::NoSamples { path: path.to_owned() })?;
        let config = Config::parse(&said.configuration, path).map_err(|source| {
            ExportError::Configuration { path: path.to_owned(), source: Box::new(source) }
        })?;
        let begun_ns = samples.begun_ns;
        let lacks_person = config.decision.strategy == Strategy::Personal && said.person.is_none();
        Ok(Survey {
            path: path.to_owned(),
            bytes: reader.bytes_read(),
            session: said.session,
            gestures: config.decision.gestures.iter().map(String::from).collect(),
            config,
            configuration: said.configuration,
            provenance: said.provenance,
            person: said.person,
            task: said.task,
            channels: said.signal.channels(samples.ranges.len()),
            unit: said.signal.unit,
            sample_rate_hz: samples.sample_rate_hz,
            begun_at: SystemTime::UNIX_EPOCH
                + Duration::from_nanos(said.monotonic_to_time_of_day_ns.saturating_add(begun_ns)),
            begun_ns,
            samples: samples.timeline.rows(),
            duration_s: samples.timeline.end_s(),
            gaps: samples.gaps,
            unusable: samples.unusable,
            ranges: samples.ranges.into_iter().map(|range| range.unwrap_or_default()).collect(),
            is_whole: reader.is_whole(),
            is_damaged_elsewhere: reader.is_damaged_elsewhere(),
            lacks_person,
            damaged_pieces: reader.damaged_pieces(),
            damaged_bytes: reader.damaged_bytes(),
        })
    }

    /// Samples of a window.
    pub(crate) fn window_samples(&self) -> u64 {
        self.config.dsp.windows.window_samples as u64
    }

    /// Time of the newest sample of a window, s.
    pub(crate) fn window_end_s(
        &self,
        timeline: &Timeline,
        trace: &TraceRecord,
        context: &ContextRecord,
    ) -> f64 {
        let newest = context.first_sample.saturating_add(self.window_samples()).saturating_sub(1);
        timeline.sample_of_s(trace, newest)
    }

    /// The parts between the gaps.
    pub(crate) fn parts(&self) -> Vec<Part> {
        let room = |gap: &Gap| ((gap.end_s - gap.start_s) * self.sample_rate_hz).round() as u64;
        let ends = self.gaps.iter().map(|gap| (gap.row, room(gap))).chain([(self.samples, u64::MAX)]);
        let starts = [0].into_iter().chain(self.gaps.iter().map(|gap| gap.row));
        starts.zip(ends).map(|(start, (end, room))| Part { samples: end - start, room }).collect()
    }

    /// Name of a gesture; empty for a number that stands for none.
    pub(crate) fn gesture(&self, number: u8) -> &str {
        self.gestures.get(usize::from(number)).map_or("", String::as_str)
    }
}

/// What the source said that it measures.
#[derive(Debug, Default)]
struct Signal {
    channels: Vec<String>,
    unit: String,
}

impl Signal {
    /// Names for so many channels.
    fn channels(&self, count: usize) -> Vec<String> {
        if self.channels.len() == count {
            return self.channels.clone();
        }
        (0..count).map(|channel| format!("channel_{channel}")).collect()
    }
}

/// What the file says beside its messages.
#[derive(Debug, Default)]
struct Said {
    session: String,
    monotonic_to_time_of_day_ns: u64,
    configuration: String,
    provenance: Value,
    person: Option<PersonName>,
    task: Option<TaskReport>,
    signal: Signal,
}

impl Said {
    fn take_file(&mut self, name: &str, bytes: &[u8]) {
        match name {
            CONFIGURATION => self.configuration = String::from_utf8_lossy(bytes).into_owned(),
            PERSON => self.person = name_in(&String::from_utf8_lossy(bytes)),
            _ => {}
        }
    }

    fn take_facts(&mut self, name: &str, mut facts: BTreeMap<String, String>) {
        let json = facts.get("json").map(String::as_str).unwrap_or_default();
        match name {
            "session" => {
                self.session = facts.remove("session").unwrap_or_default();
                let offset_ns = facts.get("monotonic_to_time_of_day_ns");
                self.monotonic_to_time_of_day_ns =
                    offset_ns.and_then(|offset_ns| offset_ns.parse().ok()).unwrap_or_default();
            }
            "provenance" => self.provenance = serde_json::from_str(json).unwrap_or_default(),
            "stages" => {
                let stages: Value = serde_json::from_str(json).unwrap_or_default();
                let signal = &stages["acquisition"]["signal"];
                let names = signal["channels"].as_array().into_iter().flatten();
                self.signal = Signal {
                    channels: names.filter_map(|name| Some(name.as_str()?.to_owned())).collect(),
                    unit: signal["unit"].as_str().unwrap_or_default().to_owned(),
                };
            }
            TASK => self.task = serde_json::from_str(json).ok(),
            _ => {}
        }
    }
}

/// What the samples are like, as far as they have been read.
#[derive(Debug)]
struct Samples {
    sample_rate_hz: f64,
    timeline: Timeline,
    /// When the first sample was captured, CLOCK_MONOTONIC ns.
    begun_ns: u64,
    gaps: Vec<Gap>,
    unusable: Vec<Span>,
    ranges: Vec<Option<(f32, f32)>>,
}

impl Samples {
    fn begin(first: &Block) -> Samples {
        let length_ns = (f64::from(first.samples) - 1.0) / first.sample_rate_hz * 1e9;
        let begun_ns = captured_ns(first).saturating_sub(length_ns as u64);
        Samples {
            sample_rate_hz: first.sample_rate_hz,
            timeline: Timeline::new(first.sample_rate_hz, begun_ns),
            begun_ns,
            gaps: Vec::new(),
            unusable: Vec::new(),
            ranges: vec![None; first.channels as usize],
        }
    }

    fn take(&mut self, block: &Block, path: &Path) -> Result<(), ExportError> {
        let start_s = self.timeline.end_s();
        let channels = block.channels as usize;
        let is_same = channels == self.ranges.len() && block.sample_rate_hz == self.sample_rate_hz;
        if !(is_same && block.sample_rate_hz > 0.0 && block.sample_rate_hz.is_finite()) {
            return Err(ExportError::OtherSignal {
                path: path.to_owned(),
                at_s: start_s,
                channels,
                sample_rate_hz: block.sample_rate_hz,
                expected_channels: self.ranges.len(),
                expected_rate_hz: self.sample_rate_hz,
            });
        }
        let placed = self.timeline.take(block);
        if placed.is_behind_gap {
            self.gaps.push(Gap { start_s, end_s: placed.start_s, row: placed.row });
        }
        for (range, values) in self.ranges.iter_mut().zip(block.values.chunks_exact(block.samples as usize)) {
            for value in values.iter().copied().filter(|value| value.is_finite()) {
                let (low, high) = range.unwrap_or((value, value));
                *range = Some((low.min(value), high.max(value)));
            }
        }
        let is_unusable = |sample: &usize| {
            block.values.iter().skip(*sample).step_by(block.samples as usize).any(|value| !value.is_finite())
        };
        for sample in (0..block.samples as usize).filter(is_unusable) {
            self.mark_unusable(placed.start_s + sample as f64 / self.sample_rate_hz);
        }
        Ok(())
    }

    fn mark_unusable(&mut self, at_s: f64) {
        let end_s = at_s + 1.0 / self.sample_rate_hz;
        match self.unusable.last_mut() {
            Some(last) if at_s - last.end_s <= UNUSABLE_APART_S => last.end_s = end_s,
            _ => self.unusable.push(Span { start_s: at_s, end_s }),
        }
    }
}
