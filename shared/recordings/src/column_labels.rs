//! Labels in a column of a table: what was done at each of its samples.
//!
//! ```text
//! t_s    EMG …  gesture
//! 0.000  …      rest       ─┐
//! 0.001  …      rest       ─┴ a trial of rest, repetition 0
//! 0.002  …      grip       ── a trial of grip, repetition 0
//! 0.003  …                 ── no trial: the label is empty, or no gesture
//! ```
//! Numbers are gestures as in annotations: 0 is rest, 3 is `gesture-3`.

use std::collections::BTreeMap;
use std::path::Path;

use tendon_gesture::Gesture;

use crate::segment::Segment;
use crate::signals::gesture_of;
use crate::table;

/// The trials in the table `text` at `path` and what lies between them, by this column of labels; `None` if there is no gesture in
/// it.
pub(crate) fn segments(path: &Path, text: &[u8], column: usize) -> Option<Vec<Segment>> {
    let mut repetitions: BTreeMap<Gesture, u32> = BTreeMap::new();
    let mut segments: Vec<Segment> = Vec::new();
    let mut current: Option<&[u8]> = None;
    for (row, label) in (0..).zip(table::cells_of_column(text, column)) {
        if current == Some(label) {
            continue;
        }
        current = Some(label);
        let cue = gesture_in(label);
        if segments.last().is_some_and(|last| last.cue == cue) {
            continue;
        }
        if let Some(last) = segments.last_mut() {
            last.end_sample = Some(row);
        }
        let repetition = cue.map(|gesture| {
            let next = repetitions.entry(gesture).or_default();
            *next += 1;
            *next - 1
        });
        let file = path.to_owned();
        segments.push(Segment { file, repetition, cue, end_sample: None, samples_lost_before: 0 });
    }
    (!repetitions.is_empty()).then_some(segments)
}

/// The gesture that a label names; whole numbers may be written `3.0`.
fn gesture_in(label: &[u8]) -> Option<Gesture> {
    let label = std::str::from_utf8(label).ok()?;
    let whole = label.parse::<f64>().ok().filter(|number| number.fract() == 0.0 && *number >= 0.0);
    gesture_of(&whole.map_or_else(|| label.replace(' ', "_"), |number| number.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The column, and of each part its end, its repetition and its gesture.
    fn trials(text: &str) -> Option<(String, Vec<String>)> {
        let columns = table::columns(text.as_bytes()).unwrap();
        let column = table::truth(&columns)?;
        let segments = segments(Path::new("emg.csv"), text.as_bytes(), column)?;
        let part = |Segment { end_sample, repetition, cue, .. }: Segment| match (repetition, cue) {
            (Some(repetition), Some(cue)) => format!("{end_sample:?} {cue} {repetition}"),
            _ => format!("{end_sample:?} -"),
        };
        Some((columns[column].name.clone(), segments.into_iter().map(part).collect()))
    }

    #[test]
    fn runs_of_a_label_are_trials() {
        let text =
            "EMG,Gesture,trial\n1,rest,1\n2,rest,1\n3,Thumb up,1\n4,,1\n5,\"grip\",2\n6,grip,2\n7,rest,2\n";
        let expected = ["Some(2) rest 0", "Some(3) thumb_up 0", "Some(4) -", "Some(6) grip 0", "None rest 1"];
        assert_eq!(trials(text), Some(("Gesture".to_owned(), expected.map(String::from).to_vec())));
    }

    #[test]
    fn numbers_are_gestures_and_of_several_columns_the_best_one_counts() {
        let text = "EMG,stimulus,restimulus\n1,5,0\n2,5,0\n3,5,3.0\n";
        let expected = ["Some(2) rest 0", "None gesture-3 0"].map(String::from).to_vec();
        assert_eq!(trials(text), Some(("restimulus".to_owned(), expected)));
    }

    #[test]
    fn without_such_a_column_or_a_gesture_in_it_there_are_no_trials() {
        for text in ["EMG,b\n1,2\n", "EMG,marker\n1,rest\n", "EMG,label\n1,\n2,?!\n"] {
            assert_eq!(trials(text), None, "{text}");
        }
    }
}
