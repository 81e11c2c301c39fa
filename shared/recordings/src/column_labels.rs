//! Labels in a column of a table: what was done at each of its samples.
//!
//! ```text
//! t_s    EMG …  gesture
//! 0.000  …      rest       ─┐
//! 0.001  …      rest       ─┴ a trial of rest, repetition 0
//! 0.002  …      grip       ── a trial of grip, repetition 0
//! 0.003  …                 ── no trial: the label is empty, or no gesture
//! ```
//! Numbers are gestures as in annotations: 0 is rest, 3 is `gesture-3`. Of words, what cannot stand in a gesture's name becomes
//! `_`: `Grip 50%` is `grip_50`. What still is no gesture is left out and counted.

use std::collections::BTreeMap;
use std::path::Path;

use tendon_gesture::Gesture;

use crate::segment::Segment;
use crate::signals::gesture_of;
use crate::table;

/// A table that a column of labels divides.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Labelled {
    /// The trials, and what lies between them.
    pub(crate) segments: Vec<Segment>,
    /// Labels that are left out, as they are written, and the trials of each.
    pub(crate) left_out: BTreeMap<String, u64>,
}

/// Divides the table `text` at `path` by this column of labels; `None` if there is no gesture in it.
pub(crate) fn divide(path: &Path, text: &[u8], column: usize) -> Option<Labelled> {
    // The label of each gesture, and its trials.
    let mut gestures: BTreeMap<Gesture, (String, u32)> = BTreeMap::new();
    let mut labelled = Labelled::default();
    let Labelled { segments, left_out } = &mut labelled;
    let mut current: Option<&[u8]> = None;
    for (row, cell) in (0..).zip(table::cells_of_column(text, column)) {
        if current == Some(cell) {
            continue;
        }
        current = Some(cell);
        let label = table::text_of(cell);
        let label = label.trim();
        let named = gesture_in(label);
        // Two labels must not become one gesture unseen.
        let named = named
            .filter(|(gesture, written)| gestures.get(gesture).is_none_or(|(first, _)| first == written));
        let is_missing = label.is_empty() || label.parse::<f64>().is_ok_and(f64::is_nan);
        if named.is_none() && !is_missing {
            *left_out.entry(label.to_owned()).or_default() += 1;
        }
        let cue = named.as_ref().map(|(gesture, _)| *gesture);
        if segments.last().is_some_and(|last| last.cue == cue) {
            continue;
        }
        if let Some(last) = segments.last_mut() {
            last.end_sample = Some(row);
        }
        let repetition = named.map(|(gesture, written)| {
            let (_, trials) = gestures.entry(gesture).or_insert((written, 0));
            *trials += 1;
            *trials - 1
        });
        let file = path.to_owned();
        segments.push(Segment { file, repetition, cue, end_sample: None, samples_lost_before: 0 });
    }
    (!gestures.is_empty()).then_some(labelled)
}

/// The gesture that a label names, and the label in a form in which capitals, blanks and `3.0` for `3` make no difference.
fn gesture_in(label: &str) -> Option<(Gesture, String)> {
    if let Ok(number) = label.parse::<f64>() {
        let is_whole = number.fract() == 0.0 && number >= 0.0;
        let gesture = is_whole.then(|| gesture_of(&number.abs().to_string())).flatten()?;
        return Some((gesture, gesture.name().to_owned()));
    }
    // Letters of other alphabets would only leave gaps in a name.
    let fits = |character: char| character.is_ascii_alphanumeric() || matches!(character, '-' | '_');
    if !label.is_ascii() || !label.contains(|character: char| character.is_ascii_alphanumeric()) {
        return None;
    }
    let words = label.split(|character| !fits(character)).filter(|word| !word.is_empty());
    let gesture = gesture_of(&words.collect::<Vec<_>>().join("_"))?;
    Some((gesture, label.to_ascii_lowercase().replace(' ', "_")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The column, and of each part its end, its repetition and its gesture.
    fn trials(text: &str) -> Option<(String, Vec<String>)> {
        let columns = table::columns(text.as_bytes()).unwrap();
        let column = table::truth(&columns)?;
        let Labelled { segments, .. } = divide(Path::new("emg.csv"), text.as_bytes(), column)?;
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
    fn of_words_what_no_name_has_becomes_a_line_below_and_what_is_no_gesture_is_counted() {
        let name = |label: &str| gesture_in(label).map(|(gesture, _)| gesture.name().to_owned());
        for (label, expected) in [
            ("Flex!!", "flex"),
            ("Grip 50%", "grip_50"),
            ("Radial/dev", "radial_dev"),
            ("Wrist  extension", "wrist_extension"),
            ("wrist-extension", "wrist-extension"),
            ("3.0", "gesture-3"),
            ("-0", "rest"),
        ] {
            assert_eq!(name(label).as_deref(), Some(expected), "{label}");
        }
        for label in [
            "",
            "?!",
            "-",
            "-1",
            "2.5",
            "99999999999",
            "inf",
            "Fäuste",
            "😀",
            "a name of 25 characters or more",
        ] {
            assert_eq!(name(label), None, "{label}");
        }
        // `flex` is `Flex!!` already, and is not taken for it.
        let rows = ["rest", "😀", "-1", "", "NaN", "😀", "Flex!!", "flex", "99999999999", "rest"];
        let text = format!("EMG,label\n{}", rows.map(|label| format!("1,{label}\n2,{label}\n")).concat());
        let expected = ["Some(2) rest 0", "Some(12) -", "Some(14) flex 0", "Some(18) -", "None rest 1"];
        assert_eq!(trials(&text), Some(("label".to_owned(), expected.map(String::from).to_vec())));
        let left_out = divide(Path::new("emg.csv"), text.as_bytes(), 1).unwrap().left_out;
        let expected = [("-1", 1), ("99999999999", 1), ("flex", 1), ("😀", 2)];
        assert_eq!(left_out, expected.map(|(label, trials)| (label.to_owned(), trials)).into());
    }

    #[test]
    fn without_such_a_column_or_a_gesture_in_it_there_are_no_trials() {
        for text in ["EMG,b\n1,2\n", "EMG,marker\n1,rest\n", "EMG,label\n1,\n2,?!\n"] {
            assert_eq!(trials(text), None, "{text}");
        }
    }
}
