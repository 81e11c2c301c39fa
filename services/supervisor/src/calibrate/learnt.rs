//! What a calibration has learnt, as the page shows it.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use tendon_gesture::Gesture;
use tendon_people::{Finding, Person};

use super::in_words::InWords;
use super::scores::CheckScores;

/// What was learnt of a person. Shares are from 0 to 1.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageReport {
    /// Share of windows to be recognised; every gesture counts the same.
    expected_accuracy: f64,
    /// The same if the next repetitions are like the only one, which is too good; `None` where there are several.
    expected_if_alike: Option<f64>,
    /// The gestures, rest first.
    gestures: Vec<GestureReport>,
    /// The channels, in order.
    channels: Vec<ChannelReport>,
    /// What should be mended, the most serious first.
    findings: Vec<InWords<Finding>>,
    confusion: ConfusionReport,
    /// How a check round went; `None` without one.
    check: Option<CheckReport>,
    /// Where the person is kept.
    file: String,
}

/// A gesture.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct GestureReport {
    name: Gesture,
    /// Share of its windows to be recognised.
    recall: f64,
}

/// A channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ChannelReport {
    name: String,
    /// How much stronger the gestures are than rest, dB.
    snr_db: f64,
    /// What is wrong with it, in a word.
    remark: Option<&'static str>,
}

/// Windows by gesture made (row) and recognised (column).
#[derive(Clone, Debug, PartialEq, Serialize)]
struct ConfusionReport {
    gestures: Vec<Gesture>,
    counts: Vec<Vec<usize>>,
}

/// Shares of the windows of a check round that were recognised.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct CheckReport {
    /// Without the calibration; `None` where nothing fits.
    before: Option<f64>,
    /// With it.
    after: f64,
    /// The same by gesture.
    after_by_gesture: BTreeMap<Gesture, f64>,
}

impl CheckReport {
    fn of(scores: &CheckScores) -> CheckReport {
        let CheckScores { before, after, after_by_gesture, .. } = scores;
        CheckReport { before: *before, after: *after, after_by_gesture: after_by_gesture.clone() }
    }
}

impl PageReport {
    /// Of this person, who is kept in `file`.
    pub fn of(person: &Person, check: Option<&CheckScores>, file: &Path) -> PageReport {
        let names: Vec<Gesture> = person.gestures.iter().map(|gesture| gesture.name).collect();
        let counts = person.expected.confusion.clone();
        let recall =
            |(label, row): (usize, &Vec<usize>)| row[label] as f64 / row.iter().sum::<usize>().max(1) as f64;
        let recalls = counts.iter().enumerate().map(recall);
        let gestures = names.iter().zip(recalls).map(|(&name, recall)| GestureReport { name, recall });
        let channels = person.channels.iter().enumerate().map(|(number, quality)| ChannelReport {
            name: quality.name.clone(),
            snr_db: quality.signal_to_noise_db,
            remark: person.findings.iter().find_map(|finding| remark(finding, number)),
        });
        PageReport {
            expected_accuracy: person.expected.accuracy,
            expected_if_alike: person.expected.if_alike,
            gestures: gestures.collect(),
            channels: channels.collect(),
            findings: person.findings.iter().map(InWords::of).collect(),
            confusion: ConfusionReport { gestures: names, counts },
            check: check.map(CheckReport::of),
            file: file.display().to_string(),
        }
    }
}

/// What a finding says of this channel, in a word.
fn remark(finding: &Finding, number: usize) -> Option<&'static str> {
    let (channel, word) = match finding {
        Finding::Flat { channel, .. } => (channel, "flat"),
        Finding::FellOff { channel, .. } => (channel, "fell-off"),
        Finding::Clipped { channel, .. } => (channel, "clipped"),
        Finding::Hum { channel, .. } => (channel, "hum"),
        Finding::Weak { channel, .. } => (channel, "weak"),
        Finding::NotMade { .. } | Finding::Alike { .. } => return None,
    };
    (*channel == number).then_some(word)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_has_the_word_of_its_own_finding() {
        let hum = Finding::Hum { channel: 2, name: "flexor".to_owned(), mains_hz: 50.0, percent: 60.0 };
        assert_eq!((remark(&hum, 2), remark(&hum, 1)), (Some("hum"), None));
        assert_eq!(remark(&Finding::NotMade { gesture: Gesture::GRIP }, 0), None);
    }
}
