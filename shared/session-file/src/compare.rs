//! What differs between two recordings of the same samples, such as a session and its replay.
//!
//! ```text
//! A ─┐  by source epoch and first sample: predictions (probabilities, efforts, novelty),
//!    ├─▶ commands (gesture, voted, confidence, mode, frame, unsure, toggles, twist)
//! B ─┘  ─▶ how many are the same, differ, are in one alone; the first differences with their time
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use crate::marks::{Epochs, KeyOfWindow};
use crate::reader::{Reader, SessionFileError};
use crate::records::{CommandRecord, Message, PredictionRecord, TraceRecord};

/// Differences that are kept one by one, of each topic.
const KEPT: usize = 10;

/// What differs between two recordings. The JSON keys are a contract with other programs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Of the predictions.
    pub predictions: Differences,
    /// Of the decisions and commands.
    pub commands: Differences,
    /// Whether each recording lacks the beginning of its session: it was begun while that ran. A replay does not know what the
    /// filters and the detector had taken in by then, and begins anew with its first block.
    pub lacks_beginning: [bool; 2],
    /// Pieces of each file that are damaged and were left out.
    pub damaged_pieces: [u64; 2],
    /// Whether each file was finished; `false` if its recorder was killed.
    pub is_whole: [bool; 2],
}

/// What differs on one topic.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Differences {
    /// The same in both, bit for bit.
    pub same: u64,
    /// In both, but not the same.
    pub different: u64,
    /// Only in the first recording.
    pub only_in_first: u64,
    /// Only in the second.
    pub only_in_second: u64,
    /// The first of them, in order of time.
    pub first: Vec<Difference>,
}

/// A difference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Since the first block of the recording that has it (of the first one, if both have), s.
    pub at_s: f64,
    /// How often the source had begun anew.
    pub epoch: u32,
    /// First sample of the window.
    pub first_sample: u64,
    /// What differs, in words.
    pub what: String,
}

impl Comparison {
    /// All that is not the same in both.
    pub fn differences(&self) -> u64 {
        self.predictions.count() + self.commands.count()
    }

    /// Whether neither recording holds anything that could be compared.
    pub fn is_empty(&self) -> bool {
        self.differences() + self.predictions.same + self.commands.same == 0
    }

    /// Whether both recordings can be the same: either both have the beginning of their session, or neither.
    pub fn is_fair(&self) -> bool {
        self.lacks_beginning[0] == self.lacks_beginning[1]
    }
}

impl Differences {
    /// All that is not the same in both.
    pub fn count(&self) -> u64 {
        self.different + self.only_in_first + self.only_in_second
    }
}

/// Compares the files at `first` and `second`. `progress` hears how many bytes were read of both together.
///
/// # Errors
///
/// When one cannot be read or is no file of a session.
pub fn compare(
    first: &Path,
    second: &Path,
    mut progress: impl FnMut(u64),
) -> Result<Comparison, SessionFileError> {
    let (first, bytes) = Made::read(first, 0, &mut progress)?;
    let (second, _) = Made::read(second, bytes, &mut progress)?;
    Ok(Comparison {
        predictions: differences(&first.predictions, &second.predictions, prediction_difference),
        commands: differences(&first.commands, &second.commands, command_difference),
        lacks_beginning: [first.lacks_beginning, second.lacks_beginning],
        damaged_pieces: [first.damaged_pieces, second.damaged_pieces],
        is_whole: [first.is_whole, second.is_whole],
    })
}

/// Something, and when the newest sample behind it was captured since the first block, s.
type At<T> = (f64, T);

/// What a session made of its windows.
#[derive(Debug, Default)]
struct Made {
    predictions: BTreeMap<KeyOfWindow, At<PredictionRecord>>,
    commands: BTreeMap<KeyOfWindow, At<CommandRecord>>,
    lacks_beginning: bool,
    damaged_pieces: u64,
    is_whole: bool,
}

impl Made {
    fn read(
        path: &Path,
        before: u64,
        progress: &mut impl FnMut(u64),
    ) -> Result<(Made, u64), SessionFileError> {
        let mut reader = Reader::open(path)?.without_samples();
        let mut epochs = Epochs::default();
        let mut start_ns = None;
        let mut first_sequence = None;
        // A prediction may stand before its block in the file: the epochs are known only at the end.
        let (mut predictions, mut commands) = (Vec::new(), Vec::new());
        while let Some(message) = reader.next_message()? {
            match message {
                Message::Block(block) => {
                    epochs.take(block.first_sample, block.published_ns);
                    start_ns.get_or_insert(block.captured_ns);
                    first_sequence.get_or_insert(block.sequence);
                }
                Message::Prediction(prediction) => predictions.push(prediction),
                Message::Command(command) => commands.push(command),
                _ => {}
            }
            progress(before + reader.bytes_read());
        }
        let start_ns = start_ns.unwrap_or_default();
        let at_s = |trace: &TraceRecord| trace.captured_ns.saturating_sub(start_ns) as f64 / 1e9;
        let predictions = predictions.into_iter().map(|prediction| {
            let key = epochs.key(&prediction.trace, prediction.context.first_sample);
            (key, (at_s(&prediction.trace), prediction))
        });
        let commands = commands.into_iter().map(|command| {
            let key = epochs.key(&command.trace, command.context.first_sample);
            (key, (at_s(&command.trace), command))
        });
        let made = Made {
            predictions: predictions.collect(),
            commands: commands.collect(),
            lacks_beginning: first_sequence.is_some_and(|sequence| sequence > 0),
            damaged_pieces: reader.damaged_pieces(),
            is_whole: reader.is_whole(),
        };
        Ok((made, before + reader.bytes_read()))
    }
}

fn differences<T>(
    first: &BTreeMap<KeyOfWindow, At<T>>,
    second: &BTreeMap<KeyOfWindow, At<T>>,
    difference: impl Fn(&T, &T) -> Option<String>,
) -> Differences {
    let mut found = Differences::default();
    let mut noted: Vec<(KeyOfWindow, f64, String)> = Vec::new();
    for (key, (at_s, value)) in first {
        match second.get(key) {
            None => {
                found.only_in_first += 1;
                noted.push((*key, *at_s, "only in the first recording".to_owned()));
            }
            Some((_, other)) => match difference(value, other) {
                None => found.same += 1,
                Some(what) => {
                    found.different += 1;
                    noted.push((*key, *at_s, what));
                }
            },
        }
    }
    for (key, (at_s, _)) in second.iter().filter(|(key, _)| !first.contains_key(key)) {
        found.only_in_second += 1;
        noted.push((*key, *at_s, "only in the second recording".to_owned()));
    }
    noted.sort_by_key(|(key, ..)| *key);
    let kept = noted.into_iter().take(KEPT).map(|(key, at_s, what)| Difference {
        at_s,
        epoch: key.epoch,
        first_sample: key.first_sample,
        what,
    });
    found.first = kept.collect();
    found
}

fn prediction_difference(first: &PredictionRecord, second: &PredictionRecord) -> Option<String> {
    first_that_differs([
        (
            "novelty",
            format!("{:?}", first.novelty.0),
            format!("{:?}", second.novelty.0),
            first.novelty == second.novelty,
        ),
        (
            "probabilities",
            numbers(&first.probabilities),
            numbers(&second.probabilities),
            first.probabilities == second.probabilities,
        ),
        ("efforts", numbers(&first.efforts), numbers(&second.efforts), first.efforts == second.efforts),
    ])
}

fn command_difference(first: &CommandRecord, second: &CommandRecord) -> Option<String> {
    let number =
        |name, first: u32, second: u32| (name, first.to_string(), second.to_string(), first == second);
    let byte = |name, first: u8, second: u8| number(name, first.into(), second.into());
    first_that_differs([
        byte("gesture", first.gesture, second.gesture),
        byte("voted", first.voted, second.voted),
        byte("mode", first.mode, second.mode),
        byte("frame", first.frame, second.frame),
        byte("is_unsure", first.is_unsure, second.is_unsure),
        byte("ordered_mode", first.ordered_mode, second.ordered_mode),
        number("gripper_toggles", first.gripper_toggles, second.gripper_toggles),
        (
            "confidence",
            format!("{:?}", first.confidence.0),
            format!("{:?}", second.confidence.0),
            first.confidence == second.confidence,
        ),
        ("twist", numbers(&first.twist), numbers(&second.twist), first.twist == second.twist),
    ])
}

/// The first of these that differs, in words.
fn first_that_differs<const N: usize>(parts: [(&str, String, String, bool); N]) -> Option<String> {
    let (name, first, second, _) = parts.into_iter().find(|(.., is_same)| !is_same)?;
    Some(format!("{name} {first} and {second}"))
}

fn numbers(numbers: &[crate::Number]) -> String {
    let numbers: Vec<String> = numbers.iter().map(|number| format!("{:?}", number.0)).collect();
    format!("[{}]", numbers.join(", "))
}
