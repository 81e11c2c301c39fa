//! `session.json`: what is true of the whole session.

use serde::Serialize;
use serde_json::Value;

use crate::{Gap, Survey};

#[derive(Serialize)]
struct Session<'a> {
    session: &'a str,
    /// The pseudonym; `null` without a person.
    person: Option<&'a str>,
    /// When the first sample was captured, RFC 3339 in UTC: 0 on the axis of all times.
    begun_at: String,
    duration_s: f64,
    samples: u64,
    sample_rate_hz: f64,
    channels: &'a [String],
    /// Empty if nobody knows.
    unit: &'a str,
    gestures: &'a [String],
    window_samples: u64,
    gaps: &'a [Gap],
    recording: Recording,
    provenance: &'a Value,
}

#[derive(Serialize)]
struct Recording {
    file: String,
    bytes: u64,
    /// `false` if the recorder was killed: what came after the last whole piece is missing.
    is_whole: bool,
    /// Pieces of the file that are damaged and were left out.
    damaged_pieces: u64,
    /// Whether it is damaged elsewhere, so that what it says of the session may be wrong.
    is_damaged_elsewhere: bool,
}

/// Its text.
pub(super) fn session(survey: &Survey) -> Vec<u8> {
    let session = Session {
        session: &survey.session,
        person: survey.person.as_ref().map(|person| person.as_str()),
        begun_at: humantime::format_rfc3339_millis(survey.begun_at).to_string(),
        duration_s: survey.duration_s,
        samples: survey.samples,
        sample_rate_hz: survey.sample_rate_hz,
        channels: &survey.channels,
        unit: &survey.unit,
        gestures: &survey.gestures,
        window_samples: survey.window_samples(),
        gaps: &survey.gaps,
        recording: Recording {
            file: survey.path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            bytes: survey.bytes,
            is_whole: survey.is_whole,
            damaged_pieces: survey.damaged_pieces,
            is_damaged_elsewhere: survey.is_damaged_elsewhere,
        },
        provenance: &survey.provenance,
    };
    let mut text =
        serde_json::to_vec_pretty(&session).expect("texts, numbers and lists: nothing that JSON cannot say");
    text.push(b'\n');
    text
}
