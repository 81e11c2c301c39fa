//! A stream of LSL as a source.

use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use anyhow::{Context, bail, ensure};
use tendon_config::AcquisitionSettings;
use tendon_lsl::{ChannelFacts, Format, Inlet, Lsl, LslError, LslSettings, Reader, Stream, StreamFacts};
use tendon_process::{STALE_NS, SignalDescription};
use tendon_source::{BlockAssembler, Choice, Chunk, Next, Offer, OfferedChannel, Source, SourceError, Wait};

use crate::rate::ArrivalRate;
use crate::stamps::{Arrival, Oddities};
use crate::timeline::Timeline;

/// How long a stream that was found may take to describe itself and to open.
const ANSWER: Duration = Duration::from_secs(5);
/// How long streams are listened for when they are listed.
const LISTEN: Duration = Duration::from_secs(1);
/// Time between two lines about odd time stamps.
const ODDITIES_INTERVAL: Duration = Duration::from_secs(10);
/// So long, all stamps are too old until it is said.
const OLD_FOR: Duration = Duration::from_secs(2);
/// Time between two lines about stamps that are too old.
const OLD_INTERVAL: Duration = Duration::from_secs(30);

/// The stream that a session reads.
pub struct LslSource {
    lsl: Lsl,
    stream: StreamFacts,
    /// What the stream said of its clock when it was opened, s.
    correction_s: f64,
    /// Until it is started.
    inlet: Option<Inlet>,
    reader: Option<Reader>,
    choice: Choice,
    timeline: Timeline,
    assembler: BlockAssembler,
    /// What the session takes of a run.
    taken: Vec<f32>,
    told: Oddities,
    told_at: Option<Instant>,
    /// Since when all stamps are too old to act upon.
    old_since: Option<Instant>,
    old_told_at: Option<Instant>,
    rate: ArrivalRate,
}

impl LslSource {
    /// Finds the stream, compares it with the session and connects to it. One that ends meanwhile is looked for again.
    pub fn open(settings: &AcquisitionSettings) -> anyhow::Result<LslSource> {
        let lsl = Lsl::load(&tendon_lsl::find_library(settings.lsl.library.as_deref())?)?;
        loop {
            let stream = find(lsl, &settings.lsl)?;
            match LslSource::connect(lsl, &stream, settings) {
                Err(error) if matches!(error.downcast_ref(), Some(LslError::Lost { .. })) => {
                    tracing::warn!("LSL: {error}. It is looked for again");
                }
                connected => return connected,
            }
        }
    }

    fn connect(lsl: Lsl, stream: &Stream, settings: &AcquisitionSettings) -> anyhow::Result<LslSource> {
        let mut inlet = Inlet::new(lsl, stream)?;
        let stream = inlet.describe(ANSWER)?.facts.clone();
        let choice = offer(&stream)?.choose(settings).with_context(|| format!("LSL stream {stream}"))?;
        inlet.open(ANSWER)?;
        // Measured now, so that the first sample of the session has its time.
        let correction_s = inlet.time_correction(ANSWER)?;
        let timeline = Timeline::new(stream.sample_rate_hz);
        let assembler =
            BlockAssembler::new(settings.channels, settings.block_samples, settings.sample_rate_hz);
        Ok(LslSource {
            lsl,
            correction_s,
            inlet: Some(inlet),
            reader: None,
            choice,
            timeline,
            assembler,
            taken: Vec::with_capacity(settings.channels * settings.sample_rate_hz as usize),
            told: Oddities::default(),
            told_at: None,
            old_since: None,
            old_told_at: None,
            rate: ArrivalRate::new(stream.sample_rate_hz),
            stream,
        })
    }

    /// What a user may want to know.
    pub fn detail(&self) -> String {
        let SignalDescription { channels, unit } = &self.choice.signal;
        let unit = if unit.is_empty() { "unit unknown" } else { unit };
        format!("LSL stream {}, channels {}, {unit}", self.stream, channels.join(", "))
    }

    /// What it measures.
    pub fn signal(&self) -> &SignalDescription {
        &self.choice.signal
    }

    /// Takes all frames that have come.
    fn take_frames(&mut self) -> Result<(), SourceError> {
        let LslSource { reader, choice, timeline, assembler, taken, stream, rate, .. } = self;
        let Some(reader) = reader else { return Ok(()) };
        while !assembler.has_block() {
            let Some(frame) = reader.next_frame().map_err(SourceError::new)? else { break };
            let arrival = Arrival {
                is_new_connection: frame.is_new_connection,
                correction_s: frame.correction_s,
                received_ns: frame.received_ns,
            };
            let other_rate_hz = rate.take(frame.stamps.len(), arrival.received_ns, arrival.is_new_connection);
            if let Some(measured_hz) = other_rate_hz {
                tracing::warn!(
                    "LSL: the samples of the stream \"{}\" arrive at {measured_hz:.1} Hz instead of {} Hz: make its program state \
                     the amplifier's real rate, and set acquisition.sample_rate_hz to it",
                    stream.name,
                    stream.sample_rate_hz
                );
            }
            timeline.place(frame.stamps, arrival, |run| {
                let values = run.samples.start * stream.channels..run.samples.end * stream.channels;
                taken.clear();
                choice.take(&frame.instants[values], taken);
                let (first_sample, captured_ns) = (run.first_sample, run.captured_ns);
                assembler.push(Chunk { first_sample, captured_ns, instants: taken });
            });
        }
        Ok(())
    }

    /// Says that all stamps are too old to act upon, seldom.
    fn tell_old_stamps(&mut self) {
        let age_s = self.timeline.stamp_age_s();
        if age_s * 1e9 <= STALE_NS as f64 {
            self.old_since = None;
            return;
        }
        let is_told = self.old_told_at.is_some_and(|told| told.elapsed() < OLD_INTERVAL);
        if self.old_since.get_or_insert_with(Instant::now).elapsed() < OLD_FOR || is_told {
            return;
        }
        self.old_told_at = Some(Instant::now());
        tracing::warn!(
            "LSL: the stamps in the stream \"{}\" are {age_s:.1} s old, and its samples are left out: does its program stamp them \
             with another clock than LSL's, or does the network hold them up?",
            self.stream.name
        );
    }

    /// Says what is odd about the time stamps, seldom.
    fn tell_oddities(&mut self) {
        let oddities = self.timeline.oddities();
        if oddities == self.told || self.told_at.is_some_and(|told| told.elapsed() < ODDITIES_INTERVAL) {
            return;
        }
        self.told = oddities;
        self.told_at = Some(Instant::now());
        let Oddities { repeated, backwards, leaps, impossible } = oddities;
        tracing::warn!(
            "LSL: odd time stamps in the stream \"{}\" so far: {repeated} repeated, {backwards} backwards, {leaps} leaps of its \
             clock, {impossible} in the future or no numbers: its program should stamp samples with LSL's clock",
            self.stream.name
        );
    }
}

impl Source for LslSource {
    fn start(&mut self) -> Result<(), SourceError> {
        if let Some(inlet) = self.inlet.take() {
            let reader = Reader::start(self.lsl, inlet, &self.stream, self.correction_s);
            self.reader = Some(reader.map_err(SourceError::new)?);
        }
        Ok(())
    }

    fn wait(&self) -> Wait<'_> {
        match &self.reader {
            Some(reader) if !self.assembler.has_block() => Wait::Readable(reader.as_fd()),
            // Blocks wait; orders are looked at in between.
            _ => Wait::Until(0),
        }
    }

    fn next_block(&mut self, samples: &mut [f32]) -> Result<Next, SourceError> {
        self.take_frames()?;
        self.tell_oddities();
        self.tell_old_stamps();
        Ok(self.assembler.next_block(samples).map_or(Next::NotYet, Next::Block))
    }

    fn clock_drift_ppm(&self) -> Option<f64> {
        self.timeline.drift_ppm()
    }
}

/// The one stream that the settings mean.
fn find(lsl: Lsl, settings: &LslSettings) -> anyhow::Result<Stream> {
    let mut found = lsl.find(settings, Duration::from_secs_f64(settings.wait_s))?;
    let wanted = settings.describe();
    if found.len() > 1 {
        bail!(
            "{} LSL streams have {wanted}: {}. Choose one by acquisition.lsl.name, source_id or hostname",
            found.len(),
            listed(&found)
        );
    }
    found.pop().with_context(|| {
        let others = lsl.streams(LISTEN);
        let there = if others.is_empty() {
            "no stream answers at all: is the amplifier's program running with its LSL output on, and does the firewall let \
             UDP and TCP 16571 to 16604 pass?"
                .to_owned()
        } else {
            format!("there are: {}. Choose by acquisition.lsl.name and type", listed(&others))
        };
        format!("no LSL stream with {wanted} within {} s; {there}", settings.wait_s)
    })
}

fn listed(streams: &[Stream]) -> String {
    streams.iter().map(|stream| stream.facts.to_string()).collect::<Vec<_>>().join("; ")
}

/// What a stream offers: where it says what its channels measure, only EMG is that.
fn offer(stream: &StreamFacts) -> anyhow::Result<Offer> {
    ensure!(
        stream.sample_rate_hz > 0.0,
        "LSL stream {stream}: it has no fixed rate, as markers have, and so holds no signal: choose another one"
    );
    ensure!(
        !matches!(stream.format, Format::String | Format::Unknown),
        "LSL stream {stream}: it holds texts and no numbers: choose another one"
    );
    let has_types = stream.channel_facts.iter().any(|channel| !channel.content_type.is_empty());
    let unknown = ChannelFacts::default();
    let channels = (0..stream.channels).map(|place| {
        let ChannelFacts { label, unit, content_type } = stream.channel_facts.get(place).unwrap_or(&unknown);
        let name = if label.is_empty() { format!("channel_{place}") } else { label.clone() };
        let is_emg = !has_types || content_type.eq_ignore_ascii_case("EMG");
        OfferedChannel { name, unit: unit.clone(), is_emg }
    });
    Ok(Offer { sample_rate_hz: stream.sample_rate_hz, channels: channels.collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(types: &[&str]) -> StreamFacts {
        let facts = |content_type: &&str| ChannelFacts {
            label: String::new(),
            unit: "microvolts".to_owned(),
            content_type: (*content_type).to_owned(),
        };
        StreamFacts {
            name: "amplifier".to_owned(),
            content_type: "EMG".to_owned(),
            source_id: "a1".to_owned(),
            uid: "u".to_owned(),
            created_s: 0.0,
            hostname: "laboratory".to_owned(),
            channels: 3,
            sample_rate_hz: 2000.0,
            format: Format::Float32,
            channel_facts: types.iter().map(facts).collect(),
        }
    }

    #[test]
    fn only_emg_channels_count_where_types_are_given() {
        let muscles = |types: &[&str]| -> Vec<bool> {
            offer(&stream(types)).unwrap().channels.iter().map(|channel| channel.is_emg).collect()
        };
        assert_eq!(muscles(&["EMG", "trigger", "emg"]), [true, false, true]);
        assert_eq!(muscles(&["", "", ""]), [true; 3]);
        // Described in part: what is not described has no type.
        assert_eq!(muscles(&["EMG"]), [true, false, false]);
        assert_eq!(offer(&stream(&[])).unwrap().channels[2].name, "channel_2");
    }

    #[test]
    fn markers_and_texts_are_refused() {
        let markers = StreamFacts { sample_rate_hz: 0.0, ..stream(&[]) };
        assert!(offer(&markers).unwrap_err().to_string().contains("no fixed rate"));
        let texts = StreamFacts { format: Format::String, ..stream(&[]) };
        assert!(offer(&texts).unwrap_err().to_string().contains("texts"));
    }
}
