//! EDF, EDF+, BDF and BDF+, as amplifiers' programs and EDFbrowser export them.
//!
//! ```text
//! 256 bytes     version, records, seconds of a record, signals        all text, filled up with blanks
//! 256 × signals label, …, unit, physical and digital range, samples of a record, …
//! record        signal 0, signal 1, …: counts of 16 bits (EDF) or 24 (BDF)
//! record          one of the signals may be text: annotations
//!                 +12.5 ␔␔␀               when the record begins: in files "D" records do not follow on
//!                 +13.25 ␕ 2 ␔ fist ␔␀    at 13.25 s, for 2 s
//! ```
//! Signals may have different rates. Those of one rate are read: that of the first channel chosen by name, else of the first
//! whose name says EMG, else the highest. Layout: [edfplus.info](https://www.edfplus.info/specs/edfplus.html).

mod head;
mod timeline;

use std::path::Path;

use crate::segment::Notice;
use crate::signals::{Signals, SignalsError, choose};
use crate::table::Channel;

use head::{Head, Signal};
use timeline::Timeline;

/// Reads the file `path` with the content `bytes`: these channels, by name or by number among those that can be read.
///
/// # Errors
/// When it is no such file, is damaged, or lacks a channel. A file that is cut off is read up to there.
pub fn read(path: &Path, bytes: &[u8], channels: &[Channel]) -> Result<Signals, SignalsError> {
    let head = Head::read(bytes)?;
    let of_rate = head.signals_of_one_rate(channels)?;
    let names: Vec<String> = of_rate.iter().map(|signal| signal.label.clone()).collect();
    let chosen = choose(channels, &names)?;
    let samples_of_record = of_rate[0].samples_of_record;
    let sample_rate_hz = rate_hz(samples_of_record, head.record_s);
    let unit = chosen.first().map_or_else(String::new, |first| of_rate[*first].unit.clone());
    let timeline = Timeline::read(&head, bytes, samples_of_record, sample_rate_hz)?;
    let mut columns: Vec<Vec<f32>> =
        chosen.iter().map(|number| head.column(bytes, of_rate[*number], &unit)).collect();
    let mut done = 0;
    for (start, end) in timeline.filled {
        for column in &mut columns {
            column[start.max(done)..end.max(done)].fill(f32::NAN);
        }
        done = end.max(done);
    }

    let mut notices = Vec::new();
    if let Some(expected) = head.expected {
        let of = expected.map_or_else(String::new, |expected| format!(" of {expected}"));
        notices.push(Notice::CutOff { file: path.to_owned(), read: format!("{} records{of}", head.records) });
    }
    let is_other = |signal: &&Signal| !signal.is_text && signal.samples_of_record != samples_of_record;
    let others: Vec<String> =
        head.signals.iter().filter(is_other).map(|signal| signal.label.clone()).collect();
    if !others.is_empty() {
        notices.push(Notice::OtherRates { file: path.to_owned(), channels: others, sample_rate_hz });
    }
    let (gaps, cues) = (timeline.gaps, timeline.cues);
    let missing = Vec::new();
    Ok(Signals { names, chosen, columns, unit, sample_rate_hz, gaps, cues, missing, notices })
}

/// Samples of a record to a rate: 35 in 0.0175 s are 2000 Hz, which a division misses by a digit.
fn rate_hz(samples_of_record: usize, record_s: f64) -> f64 {
    let rate_hz = samples_of_record as f64 / record_s;
    let whole_hz = rate_hz.round();
    if (rate_hz / whole_hz - 1.0).abs() < 1e-12 { whole_hz } else { rate_hz }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;
    use tendon_gesture::Gesture;

    use super::*;
    use crate::segment::Segment;
    use crate::signals::{Cue, Gap};

    /// Made by `tests/golden/make_edf.py`, which says what they hold.
    const DELSYS_BDF: &[u8] = include_bytes!("../tests/golden/delsys.bdf");
    const PLAIN_EDF: &[u8] = include_bytes!("../tests/golden/plain.edf");

    fn open(bytes: &[u8], channels: &[Channel]) -> Result<Signals, SignalsError> {
        read(Path::new("a.bdf"), bytes, channels)
    }

    fn expected(signal: usize, sample: usize) -> f64 {
        let scale = (signal + 1) as f64;
        100.0 * scale * (TAU * scale * sample as f64 / 40.0).sin()
    }

    #[test]
    fn what_edfio_writes_is_read_at_the_rate_of_the_emg() {
        let signals = open(DELSYS_BDF, &["EMG extensor".into(), 0.into()]).unwrap();
        assert_eq!(signals.names, ["EMG flexor", "EMG extensor"]);
        assert_eq!((signals.chosen.as_slice(), signals.unit.as_str()), ([1, 0].as_slice(), "uV"));
        assert!((signals.sample_rate_hz - 52_000.0 / 27.0).abs() < 1e-9);
        for (column, signal) in signals.columns.iter().zip([1, 0]) {
            assert_eq!(column.len(), 1040);
            for (sample, value) in column.iter().enumerate() {
                // A step is 10000 / 2^24.
                assert!((f64::from(*value) - expected(signal, sample)).abs() < 1e-3, "{signal}, {sample}");
            }
        }
        // At 0.1 s for 0.135 s, and at 0.3 s; the file begins at 0.25 s of its clock.
        let cues = [(Gesture::REST, 578, None), ("fist".parse().unwrap(), 193, Some(453))];
        let cues = cues.map(|(gesture, start_sample, end_sample)| Cue { gesture, start_sample, end_sample });
        assert_eq!(signals.cues, [cues[1], cues[0]]);
        let channels = vec!["ACC X".to_owned()];
        let sample_rate_hz = signals.sample_rate_hz;
        let others = Notice::OtherRates { file: "a.bdf".into(), channels, sample_rate_hz };
        assert_eq!(signals.notices, [others]);
        // Another rate, if it is asked for.
        let signals = open(DELSYS_BDF, &["ACC X".into()]).unwrap();
        assert_eq!((signals.columns[0].len(), signals.unit.as_str()), (80, "g"));
    }

    #[test]
    fn what_pyedflib_writes_is_read_in_the_unit_of_the_first_channel() {
        let signals = open(PLAIN_EDF, &["EMG2".into(), "EMG1".into()]).unwrap();
        assert_eq!((signals.unit.as_str(), signals.sample_rate_hz), ("mV", 200.0));
        assert_eq!(signals.cues, [Cue { gesture: Gesture::GRIP, start_sample: 100, end_sample: Some(300) }]);
        assert!(signals.notices.is_empty() && signals.gaps.is_empty());
        for sample in 0..400 {
            // A step is 2000 / 65535; pyedflib cuts off what is below.
            assert!((f64::from(signals.columns[0][sample]) - expected(1, sample)).abs() < 0.04);
            assert!((f64::from(signals.columns[1][sample]) - expected(0, sample) * 1e-3).abs() < 4e-5);
        }
    }

    /// A BDF+D file of one signal at 100 Hz, in records of 1 s that begin at these times.
    fn with_gaps(starts_s: &[f64], annotations: &[&str]) -> Vec<u8> {
        let mut bytes = b"\xffBIOSEMI".to_vec();
        let mut put = |text: &str, width: usize| bytes.extend(format!("{text:<width$}").into_bytes());
        put("", 176);
        put("768", 8);
        put("BDF+D", 44);
        put(&starts_s.len().to_string(), 8);
        put("1", 8);
        put("2", 4);
        let fields: [([&str; 2], usize); 10] = [
            (["EMG", "BDF Annotations"], 16),
            (["", ""], 80),
            (["uV", ""], 8),
            (["-8388608", "-1"], 8),
            (["8388607", "1"], 8),
            (["-8388608", "-8388608"], 8),
            (["8388607", "8388607"], 8),
            (["", ""], 80),
            (["100", "30"], 8),
            (["", ""], 32),
        ];
        for (values, width) in fields {
            values.into_iter().for_each(|value| put(value, width));
        }
        for (record, start_s) in starts_s.iter().enumerate() {
            for sample in 0..100 {
                bytes.extend(&(record as i32 * 100 + sample - 150).to_le_bytes()[..3]);
            }
            let mut text = format!("+{start_s}\u{14}\u{14}\0").into_bytes();
            text.extend(annotations.get(record).unwrap_or(&"").as_bytes());
            text.resize(90, 0);
            bytes.extend(text);
        }
        bytes
    }

    #[test]
    fn records_that_do_not_follow_on_leave_a_gap_that_no_trial_spans() {
        // The third record begins 2.5 s late, the others within what rounding gives.
        let bytes = with_gaps(
            &[0.0, 1.004, 4.5, 5.5],
            &["+1.5\u{15}4\u{14}grip\u{14}\0", "", "", "+6.3\u{14}rest\u{14}\0"],
        );
        let signals = open(&bytes, &[0.into()]).unwrap();
        assert_eq!(signals.gaps, [Gap { before_sample: 200, lost_samples: 250 }]);
        let column: Vec<f32> = (-150_i16..250).map(f32::from).collect();
        assert_eq!(signals.columns, [column]);
        let cue = |gesture, start_sample, end_sample| Cue { gesture, start_sample, end_sample };
        assert_eq!(signals.cues, [cue(Gesture::GRIP, 150, Some(300)), cue(Gesture::REST, 380, None)]);
        let part = |cue: Option<Gesture>, end_sample, samples_lost_before| Segment {
            file: "a.bdf".into(),
            repetition: cue.map(|_| 0),
            cue,
            end_sample,
            samples_lost_before,
        };
        assert_eq!(
            signals.segments(Path::new("a.bdf")),
            [
                part(None, Some(150), 0),
                part(Some(Gesture::GRIP), Some(200), 0),
                part(Some(Gesture::GRIP), Some(300), 250),
                part(None, Some(380), 0),
                part(Some(Gesture::REST), None, 0),
            ]
        );
        // What an export of ours filled up is missing, too.
        let filled = with_gaps(&[0.0, 1.0], &["+0.9\u{15}0.3\u{14}filled: the last value\u{14}\0"]);
        let signals = open(&filled, &[0.into()]).unwrap().without_missing(Path::new("a.bdf")).unwrap();
        assert_eq!(signals.gaps, [Gap { before_sample: 90, lost_samples: 30 }]);
        assert_eq!(signals.columns[0].len(), 170);
        let message = open(&with_gaps(&[0.0, 0.5], &[]), &[0.into()]).unwrap_err().to_string();
        assert!(
            message.contains("record 1 begins at 0.5 s, before the end of the one before it"),
            "{message}"
        );
    }

    #[test]
    fn a_file_that_is_cut_off_or_was_never_closed_is_read_up_to_there() {
        let whole = with_gaps(&[0.0, 1.0, 2.0], &[]);
        let missing = |bytes: &[u8]| {
            let signals = open(bytes, &[0.into()]).unwrap();
            (signals.columns[0].len(), signals.notices.first().map(ToString::to_string))
        };
        let message = |of: &str| {
            Some(format!("a.bdf: the file was cut off or not closed; what it holds was read: 2 records{of}"))
        };
        assert_eq!(missing(&whole[..whole.len() - 1]), (200, message(" of 3")));
        let mut open = whole[..whole.len() - 200].to_vec();
        open[236..244].copy_from_slice(b"-1      ");
        assert_eq!(missing(&open), (200, message("")));
    }

    #[test]
    fn a_whole_rate_is_whole() {
        assert_eq!([rate_hz(35, 0.0175), rate_hz(2000, 1.0), rate_hz(1, 0.001)], [2000.0, 2000.0, 1000.0]);
        assert!((rate_hz(26, 0.0135) - 52_000.0 / 27.0).abs() < 1e-9);
    }

    #[test]
    fn what_does_not_fit_is_refused_in_words() {
        let message = |bytes: &[u8], channel: Channel| open(bytes, &[channel]).unwrap_err().to_string();
        assert!(message(PLAIN_EDF, 2.into()).contains("no channel 2"));
        assert!(message(PLAIN_EDF, "EMG3".into()).contains("EMG3"));
        assert!(
            message(b"a,b\n1,2\n", 0.into())
                .starts_with("is not a file of the kind that its name says (EDF or BDF)")
        );
        assert!(message(&PLAIN_EDF[..300], 0.into()).contains("it ends within its head"));
        assert!(message(&PLAIN_EDF[..1024], 0.into()).contains("it ends after its head"));
        let with = |at: usize, text: &[u8]| {
            let mut bytes = PLAIN_EDF.to_vec();
            bytes[at..at + text.len()].copy_from_slice(text);
            bytes
        };
        assert!(
            message(&with(252, b"many"), 0.into()).contains("the number of signals is `many` in its head")
        );
        // The physical range of the first of three signals.
        let range = message(&with(256 + 3 * 104, b"1000    "), 0.into());
        assert!(range.contains("the ranges of signal EMG1 say nothing of its samples"), "{range}");
    }

    proptest! {
        #[test]
        fn no_damage_makes_it_panic(
            which in 0_usize..3,
            damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
            length in any::<prop::sample::Index>(),
        ) {
            let gaps = with_gaps(&[0.0, 3.0], &["+0.5\u{14}grip\u{14}\0"]);
            let mut bytes = [DELSYS_BDF, PLAIN_EDF, &gaps][which].to_vec();
            for (place, value) in damage {
                let place = place.index(bytes.len());
                bytes[place] = value;
            }
            for bytes in [&bytes[..], &bytes[..length.index(bytes.len())]] {
                if let Ok(signals) = open(bytes, &[0.into()]) {
                    let Ok(signals) = signals.without_missing(Path::new("a")) else { continue };
                    prop_assert!(signals.columns[0].iter().all(|sample| sample.is_finite()));
                    let end = signals.columns[0].len() as u64;
                    prop_assert!(signals.cues.iter().all(|cue| cue.start_sample < end));
                    let segments = signals.segments(Path::new("a"));
                    prop_assert!(segments.iter().filter_map(|segment| segment.end_sample).is_sorted());
                    prop_assert!(segments.last().is_some_and(|last| last.end_sample.is_none_or(|last| last <= end)));
                }
            }
        }
    }
}
