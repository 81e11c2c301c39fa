//! The columns of each table: name, unit, meaning. `columns.json` says them, the tables have the names only.

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::Survey;

/// A column.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Column {
    pub(super) name: String,
    /// Empty where there is none.
    unit: &'static str,
    meaning: String,
}

/// The columns of all tables.
#[derive(Clone, Debug)]
pub(super) struct Columns {
    pub(super) signal: Vec<Column>,
    pub(super) predictions: Vec<Column>,
    pub(super) decisions: Vec<Column>,
    pub(super) commands: Vec<Column>,
    pub(super) arm: Vec<Column>,
    pub(super) events: Vec<Column>,
    pub(super) trials: Vec<Column>,
    pub(super) zones: Vec<Column>,
    unit_of_signal: String,
}

const TIME: (&str, &str, &str) = ("time_s", "s", "since the first recorded sample");
const TIME_OF_WINDOW: (&str, &str, &str) =
    ("time_s", "s", "of the newest sample of the window, since the first recorded sample");
const WINDOW: (&str, &str, &str) =
    ("window", "", "number of the window's first sample, as the source counts; joins the tables");

impl Columns {
    pub(super) fn of(survey: &Survey) -> Columns {
        let channels = survey.channels.iter().map(|name| column(&column_name(name), "", "raw signal"));
        let by_gesture = |what: &str, meaning: &str| -> Vec<Column> {
            let columns = survey.gestures.iter();
            columns.map(|gesture| column(&format!("{what}_{gesture}"), "1", meaning)).collect()
        };
        Columns {
            signal: columns(&[TIME]).into_iter().chain(channels).collect(),
            predictions: [
                columns(&[
                    TIME_OF_WINDOW,
                    WINDOW,
                    ("truth", "", "gesture asked for at the newest sample; empty if nobody knows"),
                    ("activity", "", "calibrating, rest or move, as the activity detector has it"),
                    ("replaced_samples", "", "unusable samples that were replaced in the window"),
                    ("novelty", "1", "above 1, the window is unlike the calibration"),
                    ("gesture", "", "the most probable one"),
                ]),
                by_gesture("probability", "probability; 0 for what the model does not know"),
                by_gesture("effort", "strength of the contraction if it is this gesture, 0 to 1"),
                columns(&[
                    ("acquisition_to_dsp_us", "us", "from publishing to receiving the newest block"),
                    ("dsp_us", "us", "work of dsp"),
                    ("dsp_to_inference_us", "us", "from publishing to receiving the window"),
                    ("inference_us", "us", "work of inference"),
                    ("newest_sample_to_prediction_us", "us", "from its capture to publishing the prediction"),
                ]),
            ]
            .concat(),
            decisions: columns(&[
                TIME_OF_WINDOW,
                WINDOW,
                ("gesture", "", "gesture of the window"),
                ("confidence", "1", "its probability"),
                ("voted", "", "gesture that is acted on"),
                ("is_unsure", "", "1 if it is not clear which gesture is made"),
                ("mode", "", "number of the mode that is on"),
                ("inference_to_decision_us", "us", "from publishing to receiving the prediction"),
                ("decision_us", "us", "work of decision"),
                ("newest_sample_to_command_us", "us", "from its capture to publishing the command"),
            ]),
            commands: columns(&[
                TIME_OF_WINDOW,
                WINDOW,
                ("frame", "", "whose axes the twist is along: base or tool"),
                ("x_mm_per_s", "mm/s", "along x"),
                ("y_mm_per_s", "mm/s", "along y"),
                ("z_mm_per_s", "mm/s", "along z"),
                ("about_x_rad_per_s", "rad/s", "about x"),
                ("about_y_rad_per_s", "rad/s", "about y"),
                ("about_z_rad_per_s", "rad/s", "about z"),
                ("gripper_toggles", "", "how often the gripper was asked to change sides so far"),
            ]),
            arm: arm(),
            events: columns(&[
                TIME,
                ("kind", "", "session, note, recording (what it lacks), cue or arm (whether it may move)"),
                (
                    "text",
                    "",
                    "what was said; of a cue, the gesture, or `is over` where nothing is asked for after it",
                ),
            ]),
            trials: columns(&[
                ("start_s", "s", "when the gesture was asked for"),
                ("end_s", "s", "when the next one was, or the recording ended"),
                ("gesture", "", "its name"),
                ("start_row", "", "first row in signal.csv, counted from 0 without the header"),
                ("end_row", "", "row after the last one"),
            ]),
            zones: zones(),
            unit_of_signal: survey.unit.clone(),
        }
    }

    /// All of them, by table, with the unit of the signal, as it is known only by its source.
    pub(super) fn to_json(&self) -> Vec<u8> {
        let tables = [
            ("signal", &self.signal),
            ("predictions", &self.predictions),
            ("decisions", &self.decisions),
            ("commands", &self.commands),
            ("arm", &self.arm),
            ("events", &self.events),
            ("trials", &self.trials),
            ("zones", &self.zones),
        ];
        let described = |(table, columns): (&str, &Vec<Column>)| {
            let mut columns = json!(columns);
            if table == "signal" {
                let channels = columns.as_array_mut().into_iter().flatten().skip(1);
                channels.for_each(|channel| channel["unit"] = json!(self.unit_of_signal));
            }
            (table.to_owned(), columns)
        };
        let tables: Map<String, Value> = tables.into_iter().map(described).collect();
        format!("{:#}\n", Value::Object(tables)).into_bytes()
    }
}

/// The names of columns.
pub(super) fn names(columns: &[Column]) -> impl Iterator<Item = &str> {
    columns.iter().map(|column| column.name.as_str())
}

/// A name that simple readers understand: without separators and quotes, and no number, by which they tell a row.
fn column_name(channel: &str) -> String {
    let is_special = |character: char| matches!(character, ',' | ';' | '"') || character.is_control();
    let name = channel.trim().replace(is_special, "_");
    if name.parse::<f64>().is_ok() { format!("channel_{name}") } else { name }
}

fn column(name: &str, unit: &'static str, meaning: &str) -> Column {
    Column { name: name.to_owned(), unit, meaning: meaning.to_owned() }
}

fn columns(columns: &[(&str, &'static str, &str)]) -> Vec<Column> {
    columns.iter().map(|(name, unit, meaning)| column(name, unit, meaning)).collect()
}

fn arm() -> Vec<Column> {
    let joints = (1..=7).map(|joint| column(&format!("joint_{joint}_rad"), "rad", "angle of the joint"));
    let time = columns(&[
        TIME,
        ("permission", "", "granted, await_rest or stopped"),
        ("stop_reason", "", "why the arm may not move, in words"),
        ("phase", "", "connecting, bringing_up, going_to_start, following or waiting"),
        ("fault_code", "", "error code of the arm's controller"),
        ("hindrance", "", "what keeps the arm from following in full, in words"),
        ("gesture", "", "gesture that is acted on"),
        ("mode", "", "number of the mode that is on"),
    ]);
    let pose = columns(&[
        ("x_mm", "mm", "position of the flange"),
        ("y_mm", "mm", "position of the flange"),
        ("z_mm", "mm", "position of the flange"),
        ("roll_rad", "rad", "orientation of the flange"),
        ("pitch_rad", "rad", "orientation of the flange"),
        ("yaw_rad", "rad", "orientation of the flange"),
        ("speed_mm_per_s", "mm/s", "speed of the flange"),
        ("gripper_pulses", "pulses", "position of the gripper"),
        ("start_distance_mm", "mm", "distance from the start position"),
    ]);
    time.into_iter().chain(joints).chain(pose).collect()
}

fn zones() -> Vec<Column> {
    columns(&[
        ("zone", "", "number of the zone, from 1"),
        ("x_mm", "mm", "centre"),
        ("y_mm", "mm", "centre"),
        ("z_mm", "mm", "centre"),
        ("distance_mm", "mm", "from the arm to the centre when the zone appeared"),
        ("index_of_difficulty_bits", "bits", "log2(distance / width + 1)"),
        ("reached", "", "1 if it was reached in time"),
        ("completion_time_s", "s", "from its appearance to the end of the dwelling"),
        ("movement_time_s", "s", "from its appearance to the last entry"),
        ("throughput_bits_per_s", "bits/s", "index of difficulty over movement time"),
        ("path_length_mm", "mm", "way of the arm"),
        ("path_efficiency", "1", "straight distance over the way"),
        ("overshoots", "", "how often the arm left the zone too early"),
    ])
}
