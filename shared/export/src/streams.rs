//! A session as streams in one XDF file: the signal, and what `tendon run --lsl-out` would have given beside it.
//!
//! ```text
//! blocks ─────────────▶ "Tendon SESSION EMG"           at the session's rate; a sample behind a gap has a stamp of its own
//! predictions ────────▶ "Tendon SESSION predictions"   probabilities, efforts
//! commands ───────────▶ "Tendon SESSION decisions"     gesture of the window, gesture that is acted on
//!             └───────▶ "Tendon SESSION commands"      twist, confidence
//! cues, events, states ▶ "Tendon SESSION markers"
//! ```
//!
//! Time stamps are CLOCK_MONOTONIC in s: that of the first sample, and from there on the axis of [`crate::Timeline`].

use std::io::{self, Write};

use tendon_messages::{COMMAND_CHANNELS, TWIST_LENGTH};
use tendon_session_file::{Block, CommandRecord, Message, Number, PredictionRecord, Reader};

use crate::chronicle::{Chronicle, Happening};
use crate::xdf::{StreamId, Values, XdfChannel, XdfStream, XdfWriter};
use crate::{ExportError, Survey};

/// Writes the session of `survey` as XDF. `has_read` is told how many bytes of the recording were read so far, and may
/// end the export.
///
/// # Errors
///
/// The system's, while it is written. That the recording cannot be read is one of them.
pub fn write_xdf(
    survey: &Survey,
    output: &mut dyn Write,
    mut has_read: impl FnMut(u64) -> Result<(), ExportError>,
) -> io::Result<()> {
    let unreadable = |error| io::Error::other(ExportError::from(error));
    let mut streams = Streams::begin(survey, output)?;
    let mut reader = Reader::open(&survey.path).map_err(unreadable)?;
    while let Some(message) = reader.next_message().map_err(unreadable)? {
        match &message {
            Message::Block(block) => streams.block(block)?,
            Message::Prediction(prediction) => streams.prediction(prediction)?,
            Message::Command(command) => streams.command(command)?,
            Message::State(state) => {
                let changed = streams.chronicle.state(state);
                streams.marker(changed.as_ref())?;
            }
            Message::Event(event) => {
                let happening = streams.chronicle.event(event);
                streams.marker(Some(&happening))?;
            }
            Message::Cue(cue) => streams.chronicle.cue(cue),
            Message::Window(_) | Message::Measurement(_) => {}
        }
        has_read(reader.bytes_read()).map_err(io::Error::other)?;
    }
    streams.file.finish()
}

struct Streams<'a> {
    survey: &'a Survey,
    chronicle: Chronicle,
    file: XdfWriter<&'a mut dyn Write>,
    emg: StreamId,
    predictions: StreamId,
    decisions: StreamId,
    commands: StreamId,
    markers: StreamId,
    frame: Vec<f32>,
    /// When the first sample was captured, s.
    begun_s: f64,
}

impl<'a> Streams<'a> {
    fn begin(survey: &'a Survey, output: &'a mut dyn Write) -> io::Result<Streams<'a>> {
        let recorded_at = humantime::format_rfc3339_millis(survey.begun_at).to_string();
        let person = survey.person.as_ref().map_or("", |person| person.as_str());
        let mut file = XdfWriter::begin(output, &recorded_at, person)?;
        let begun_s = survey.begun_ns as f64 * 1e-9;
        let mut add = |what: &str, content_type, channels, sample_rate_hz, is_text| {
            let name = format!("Tendon {} {what}", survey.session);
            file.add(&XdfStream { name, content_type, channels, sample_rate_hz, is_text }, begun_s)
        };
        let muscles = survey.channels.iter().map(|name| channel(name, &survey.unit)).collect();
        let by_gesture = |what: &str| -> Vec<XdfChannel> {
            survey.gestures.iter().map(|gesture| channel(&format!("{what} {gesture}"), "1")).collect()
        };
        let predictions = [by_gesture("probability"), by_gesture("effort")].concat();
        let decisions = ["gesture", "voted"].map(|label| channel(label, "")).to_vec();
        let commands = COMMAND_CHANNELS.map(|(label, unit)| channel(label, unit)).to_vec();
        Ok(Streams {
            survey,
            chronicle: Chronicle::new(survey),
            emg: add("EMG", "EMG", muscles, survey.sample_rate_hz, false)?,
            predictions: add("predictions", "Predictions", predictions, 0.0, false)?,
            decisions: add("decisions", "Decisions", decisions, 0.0, true)?,
            commands: add("commands", "Commands", commands, 0.0, false)?,
            markers: add("markers", "Markers", vec![channel("marker", "")], 0.0, true)?,
            file,
            frame: Vec::new(),
            begun_s,
        })
    }

    fn block(&mut self, block: &Block) -> io::Result<()> {
        let taken = self.chronicle.block(block);
        self.marker(taken.cue.as_ref())?;
        let samples = block.samples as usize;
        let is_first = self.chronicle.timeline.rows() == samples as u64;
        for sample in 0..samples {
            let time_s = taken.placed.start_s + sample as f64 / self.survey.sample_rate_hz;
            let follows = sample > 0 || !(taken.placed.is_behind_gap || is_first);
            self.frame.clear();
            self.frame.extend(block.values.chunks_exact(samples).map(|channel| channel[sample]));
            self.file.sample(self.emg, self.begun_s + time_s, follows, Values::Numbers(&self.frame))?;
        }
        Ok(())
    }

    fn prediction(&mut self, prediction: &PredictionRecord) -> io::Result<()> {
        let time_s =
            self.survey.window_end_s(&self.chronicle.timeline, &prediction.trace, &prediction.context);
        self.frame.clear();
        let gestures = self.survey.gestures.len();
        put(&mut self.frame, &prediction.probabilities, gestures);
        put(&mut self.frame, &prediction.efforts, gestures);
        self.file.sample(self.predictions, self.begun_s + time_s, false, Values::Numbers(&self.frame))
    }

    fn command(&mut self, command: &CommandRecord) -> io::Result<()> {
        let time_s = self.survey.window_end_s(&self.chronicle.timeline, &command.trace, &command.context);
        let at_s = self.begun_s + time_s;
        let [gesture, voted] = [command.gesture, command.voted].map(|number| self.survey.gesture(number));
        self.file.sample(self.decisions, at_s, false, Values::Texts(&[gesture, voted]))?;
        self.frame.clear();
        put(&mut self.frame, &command.twist, TWIST_LENGTH);
        self.frame.push(command.confidence.0);
        self.file.sample(self.commands, at_s, false, Values::Numbers(&self.frame))
    }

    fn marker(&mut self, happening: Option<&Happening>) -> io::Result<()> {
        let Some(Happening { at_s, kind, text }) = happening else { return Ok(()) };
        let text = if *kind == "arm" { text.clone() } else { format!("{kind} {text}") };
        self.file.sample(self.markers, self.begun_s + at_s, false, Values::Texts(&[&text]))
    }
}

fn channel(label: &str, unit: &str) -> XdfChannel {
    XdfChannel { label: label.to_owned(), unit: unit.to_owned() }
}

/// So many numbers; NaN for those that there are none for.
fn put(frame: &mut Vec<f32>, numbers: &[Number], count: usize) {
    frame.extend((0..count).map(|place| numbers.get(place).map_or(f32::NAN, |number| number.0)));
}
