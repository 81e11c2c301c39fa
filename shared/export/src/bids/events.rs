//! What happened in a session, as `_events.tsv` and as annotations of the BDF file.

use serde_json::json;
use tendon_session_file::{Message, Reader};

use super::cell;
use crate::bdf::Annotation;
use crate::chronicle::{Chronicle, Happening, Trial};
use crate::{ExportError, Survey};

/// A row of the table.
pub(super) struct BidsEvent {
    onset_s: f64,
    duration_s: f64,
    /// `gesture`, or the kind of a happening.
    kind: &'static str,
    text: String,
}

/// All that happened, in order.
pub(super) fn gather(
    survey: &Survey,
    record_samples: usize,
    has_read: &mut impl FnMut(u64) -> Result<(), ExportError>,
) -> Result<Vec<BidsEvent>, ExportError> {
    let mut chronicle = Chronicle::new(survey);
    let mut events = Vec::new();
    let mut reader = Reader::open(&survey.path)?.without_samples();
    while let Some(message) = reader.next_message()? {
        match &message {
            Message::Block(block) => events.extend(chronicle.block(block).ended.map(BidsEvent::from)),
            Message::State(state) => events.extend(chronicle.state(state).map(BidsEvent::from)),
            Message::Event(event) => events.push(chronicle.event(event).into()),
            Message::Cue(cue) => chronicle.cue(cue),
            Message::Window(_) | Message::Prediction(_) | Message::Command(_) | Message::Measurement(_) => {}
        }
        has_read(reader.bytes_read())?;
    }
    events.extend(chronicle.finish().map(BidsEvent::from));
    events.extend(survey.unusable.iter().map(|span| BidsEvent {
        onset_s: span.start_s,
        duration_s: span.end_s - span.start_s,
        kind: "unusable",
        text: "samples that were no numbers hold the last value".to_owned(),
    }));
    events.extend(filled(survey, record_samples));
    events.sort_by(|a, b| a.onset_s.total_cmp(&b.onset_s));
    Ok(events)
}

/// Where a part ends within a record, which is filled up.
fn filled(survey: &Survey, record_samples: usize) -> impl Iterator<Item = BidsEvent> {
    let ends_s = survey.gaps.iter().map(|gap| gap.start_s).chain([survey.duration_s]);
    let ends = survey
        .parts()
        .into_iter()
        .zip(ends_s)
        .map(move |(part, end_s)| (end_s, part.filled(record_samples) as f64 / survey.sample_rate_hz));
    ends.filter(|(_, filled_s)| *filled_s > 0.0).map(|(onset_s, duration_s)| {
        let text = "the last value fills up the record".to_owned();
        BidsEvent { onset_s, duration_s, kind: "filled", text }
    })
}

impl From<Trial> for BidsEvent {
    fn from(trial: Trial) -> BidsEvent {
        let duration_s = trial.end_s - trial.start_s;
        BidsEvent { onset_s: trial.start_s, duration_s, kind: "gesture", text: trial.gesture }
    }
}

impl From<Happening> for BidsEvent {
    fn from(happening: Happening) -> BidsEvent {
        let Happening { at_s, kind, text } = happening;
        BidsEvent { onset_s: at_s, duration_s: 0.0, kind, text }
    }
}

impl BidsEvent {
    pub(super) fn annotation(&self) -> Annotation {
        let text = match self.kind {
            "gesture" | "arm" => self.text.clone(),
            kind => format!("{kind}: {}", self.text),
        };
        Annotation { onset_s: self.onset_s, duration_s: self.duration_s, text }
    }
}

/// The text of `_events.tsv`.
pub(super) fn table(events: &[BidsEvent]) -> String {
    let rows = events.iter().map(|BidsEvent { onset_s, duration_s, kind, text }| {
        format!("{onset_s:.6}\t{duration_s:.6}\t{kind}\t{}\n", cell(text))
    });
    ["onset\tduration\ttrial_type\tvalue\n".to_owned()].into_iter().chain(rows).collect()
}

/// The text of `_events.json`.
pub(super) fn columns() -> Vec<u8> {
    let text = json!({
        "trial_type": {
            "Description": "What kind of event it is",
            "Levels": {
                "gesture": "The person was asked for the gesture in the column value",
                "arm": "Whether the arm may move changed",
                "session": "The program stopped the arm, restarted a part of itself, or found something wrong",
                "note": "The operator noted something",
                "recording": "Something is missing in the recording",
                "unusable": "Samples were no numbers; the last value stands for them",
                "filled": "There are no samples: the last value fills up the record",
            },
        },
        "value": { "Description": "Name of the gesture, or what was said" },
    });
    format!("{text:#}\n").into_bytes()
}
