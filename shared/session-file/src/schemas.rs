//! The channels of a file and their JSON schemas, from which viewers know what they can plot.

use serde_json::{Map, Value, json};

use crate::block::LAYOUT;
use crate::records::Message;

/// Message encoding of blocks.
pub(crate) const BLOCK_ENCODING: &str = "tendon-block";
/// Message encoding of all others.
pub(crate) const JSON_ENCODING: &str = "json";

/// A channel of the file; its number is its place among [`CHANNELS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ChannelKind {
    Blocks,
    Windows,
    Predictions,
    Commands,
    States,
    Measurements,
    Events,
    Cues,
}

/// All channels.
pub(crate) const CHANNELS: [ChannelKind; 8] = [
    ChannelKind::Blocks,
    ChannelKind::Windows,
    ChannelKind::Predictions,
    ChannelKind::Commands,
    ChannelKind::States,
    ChannelKind::Measurements,
    ChannelKind::Events,
    ChannelKind::Cues,
];

impl ChannelKind {
    pub(crate) fn of(message: &Message) -> ChannelKind {
        match message {
            Message::Block(_) => ChannelKind::Blocks,
            Message::Window(_) => ChannelKind::Windows,
            Message::Prediction(_) => ChannelKind::Predictions,
            Message::Command(_) => ChannelKind::Commands,
            Message::State(_) => ChannelKind::States,
            Message::Measurement(_) => ChannelKind::Measurements,
            Message::Event(_) => ChannelKind::Events,
            Message::Cue(_) => ChannelKind::Cues,
        }
    }

    /// Name of the channel in the file.
    pub(crate) fn topic(self) -> &'static str {
        match self {
            ChannelKind::Blocks => "blocks",
            ChannelKind::Windows => "windows",
            ChannelKind::Predictions => "predictions",
            ChannelKind::Commands => "commands",
            ChannelKind::States => "states",
            ChannelKind::Measurements => "measurements",
            ChannelKind::Events => "events",
            ChannelKind::Cues => "cues",
        }
    }

    /// Name of the schema, its encoding and its text.
    pub(crate) fn schema(self) -> (&'static str, &'static str, Vec<u8>) {
        let (name, properties) = match self {
            ChannelKind::Blocks => return ("tendon.Block", BLOCK_ENCODING, LAYOUT.into()),
            ChannelKind::Windows => ("tendon.Window", of_window(&[])),
            ChannelKind::Predictions => (
                "tendon.Prediction",
                of_window(&[("novelty", number()), ("probabilities", numbers()), ("efforts", numbers())]),
            ),
            ChannelKind::Commands => (
                "tendon.Command",
                of_window(&[
                    ("gesture", integer()),
                    ("voted", integer()),
                    ("confidence", number()),
                    ("mode", integer()),
                    ("frame", integer()),
                    ("is_unsure", integer()),
                    ("ordered_mode", integer()),
                    ("gripper_toggles", integer()),
                    ("twist", numbers()),
                ]),
            ),
            ChannelKind::States => ("tendon.State", of_state()),
            ChannelKind::Measurements => ("tendon.Measurement", of_measurement()),
            ChannelKind::Events => {
                ("tendon.Event", object(&[("at_ns", integer()), ("kind", text()), ("text", text())]))
            }
            ChannelKind::Cues => (
                "tendon.Cue",
                object(&[
                    ("since_sample", integer()),
                    ("captured_ns", integer()),
                    ("class_number", integer()),
                    ("gesture", text()),
                ]),
            ),
        };
        (name, "jsonschema", properties.to_string().into_bytes())
    }
}

fn object(properties: &[(&str, Value)]) -> Value {
    let properties: Map<String, Value> =
        properties.iter().map(|(name, kind)| ((*name).to_owned(), kind.clone())).collect();
    json!({ "type": "object", "properties": properties })
}

fn integer() -> Value {
    json!({ "type": "integer" })
}

fn number() -> Value {
    json!({ "type": "number" })
}

fn numbers() -> Value {
    json!({ "type": "array", "items": { "type": "number" } })
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn trace() -> Value {
    let times = json!({ "type": "array", "items": { "type": "integer" } });
    object(&[
        ("sequence", integer()),
        ("captured_ns", integer()),
        ("received_ns", times.clone()),
        ("published_ns", times),
    ])
}

fn of_window(more: &[(&str, Value)]) -> Value {
    let context = [
        "first_sample",
        "truth",
        "truth_since_sample",
        "replaced_samples",
        "calibration_left_ms",
        "activity",
    ];
    let context = object(&context.map(|name| (name, integer())));
    object(&[&[("trace", trace()), ("context", context)], more].concat())
}

fn of_state() -> Value {
    let arrays = ["joints_rad", "position_mm", "orientation_rad"].map(|name| (name, numbers()));
    let values = ["speed_mm_per_s", "gripper_position", "confidence", "start_distance_mm"];
    let codes =
        ["gesture", "permission", "stop_reason", "fault_code", "arm_phase", "hindrance", "mode", "is_unsure"];
    let values = values.map(|name| (name, number()));
    let codes = codes.map(|name| (name, integer()));
    object(&[&[("trace", trace())][..], &arrays[..], &values[..], &codes[..]].concat())
}

fn of_measurement() -> Value {
    let counts = [
        "sequence",
        "process_id",
        "received",
        "published",
        "lost",
        "first_sequence",
        "next_sequence",
        "stale",
        "lost_samples",
        "replaced_samples",
        "first_message_ns",
        "newest_message_ns",
        "finished",
    ];
    let counts = counts.map(|name| (name, integer()));
    object(&[&[("stage", text()), ("clock_drift_ppm", number())][..], &counts[..]].concat())
}
