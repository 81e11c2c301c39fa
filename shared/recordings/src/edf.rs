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

use std::path::Path;

use tendon_signal::unit_factor;

use crate::segment::Notice;
use crate::signals::{Cue, Gap, Signals, SignalsError, choose, gesture_of};
use crate::table::Channel;

const HEAD_BYTES: usize = 256;

/// What the head says of a signal.
#[derive(Clone, Debug)]
struct Signal {
    label: String,
    unit: String,
    /// Physical value of digital 0, and of one digital step.
    offset: f64,
    step: f64,
    samples_of_record: usize,
    /// Where it begins in a record, in bytes.
    position: usize,
    is_text: bool,
}

/// Of the whole file.
struct Head {
    /// Bytes of a count.
    width: usize,
    has_gaps: bool,
    record_s: f64,
    record_bytes: usize,
    records: usize,
    /// Records that it should have, if there are fewer or it does not say.
    expected: Option<Option<usize>>,
    signals: Vec<Signal>,
    /// Where the first record begins.
    position: usize,
}

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
    let columns = chosen.iter().map(|number| head.column(bytes, of_rate[*number], &unit)).collect();

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
    let Timeline { gaps, cues, .. } = timeline;
    let missing = Vec::new();
    Ok(Signals { names, chosen, columns, unit, sample_rate_hz, gaps, cues, missing, notices })
}

impl Head {
    fn read(bytes: &[u8]) -> Result<Head, SignalsError> {
        let width = match bytes.get(..8) {
            Some(b"0       ") => 2,
            Some(b"\xffBIOSEMI") => 3,
            _ => return Err(SignalsError::OtherKind("EDF or BDF")),
        };
        let field = |at: usize, length: usize| bytes.get(at..at + length).map(text).ok_or_else(cut_in_head);
        let count: usize = number(&field(252, 4)?, "the number of signals")?;
        let position = HEAD_BYTES * (count + 1);
        if bytes.len() < position {
            return Err(cut_in_head());
        }
        let kind = field(192, 44)?;
        let record_s: f64 = number(&field(244, 8)?, "the length of a record")?;
        let mut signals = Vec::new();
        let mut record_bytes = 0;
        for signal in 0..count {
            let field = |at: usize, length: usize| field(HEAD_BYTES + at * count + signal * length, length);
            let mut read = Signal::read(&field, kind.contains('+'))?;
            read.position = record_bytes;
            record_bytes += read.samples_of_record * width;
            signals.push(read);
        }
        if !(record_s.is_finite() && record_s > 0.0) || signals.iter().all(|signal| signal.is_text) {
            return Err(SignalsError::Empty("it holds annotations only"));
        }
        if record_bytes == 0 {
            return Err(SignalsError::Empty("its signals have none in a record"));
        }
        let complete = (bytes.len() - position) / record_bytes;
        // -1 until the file is complete.
        let stated: i64 = number(&field(236, 8)?, "the number of records")?;
        let stated = usize::try_from(stated).ok();
        let records = stated.map_or(complete, |stated| stated.min(complete));
        if records == 0 {
            return Err(SignalsError::Empty("it ends after its head"));
        }
        let expected = (stated != Some(records)).then_some(stated);
        let has_gaps = kind.starts_with("EDF+D") || kind.starts_with("BDF+D");
        Ok(Head { width, has_gaps, record_s, record_bytes, records, expected, signals, position })
    }

    /// The signals of the rate that is read, at least one.
    fn signals_of_one_rate(&self, channels: &[Channel]) -> Result<Vec<&Signal>, SignalsError> {
        let with_samples =
            || self.signals.iter().filter(|signal| !signal.is_text && signal.samples_of_record > 0);
        let named = channels.iter().find_map(|channel| match channel {
            Channel::Name(name) => with_samples().find(|signal| signal.label == *name),
            Channel::Index(_) => None,
        });
        let says_emg = || with_samples().find(|signal| signal.label.to_ascii_uppercase().contains("EMG"));
        let fastest = || with_samples().max_by_key(|signal| signal.samples_of_record);
        let Some(first) = named.or_else(says_emg).or_else(fastest) else {
            return Err(SignalsError::Empty("its signals have none in a record"));
        };
        // BioSemi's amplifiers write the inputs for triggers as a signal.
        let is_trigger =
            |signal: &Signal| self.width == 3 && signal.label == "Status" && first.label != "Status";
        let is_read =
            |signal: &&Signal| signal.samples_of_record == first.samples_of_record && !is_trigger(signal);
        Ok(with_samples().filter(is_read).collect())
    }

    /// The bytes of a signal in a record.
    fn part<'a>(&self, bytes: &'a [u8], record: usize, signal: &Signal) -> &'a [u8] {
        let start = self.position + record * self.record_bytes + signal.position;
        &bytes[start..start + signal.samples_of_record * self.width]
    }

    /// All samples of a signal, in `unit` where that can be had.
    fn column(&self, bytes: &[u8], signal: &Signal, unit: &str) -> Vec<f32> {
        let factor = unit_factor(&signal.unit, unit).unwrap_or(1.0);
        let (offset, step) = (signal.offset * factor, signal.step * factor);
        let mut column = Vec::with_capacity(self.records * signal.samples_of_record);
        for record in 0..self.records {
            let counts = self.part(bytes, record, signal).chunks_exact(self.width);
            column.extend(counts.map(|count| {
                let count = match *count {
                    [low, high] => i32::from(i16::from_le_bytes([low, high])),
                    [low, middle, high] => i32::from_le_bytes([0, low, middle, high]) >> 8,
                    _ => 0,
                };
                (offset + step * f64::from(count)) as f32
            }));
        }
        column
    }
}

impl Signal {
    fn read(
        field: &dyn Fn(usize, usize) -> Result<String, SignalsError>,
        has_annotations: bool,
    ) -> Result<Signal, SignalsError> {
        let label = field(0, 16)?;
        let is_text = has_annotations && matches!(label.as_str(), "EDF Annotations" | "BDF Annotations");
        let samples_of_record = number(&field(216, 8)?, "the number of samples of a record")?;
        let mut signal = Signal {
            unit: field(96, 8)?,
            label,
            offset: 0.0,
            step: 0.0,
            samples_of_record,
            position: 0,
            is_text,
        };
        if !is_text {
            let range = |at: usize| number::<f64>(&field(at, 8)?, "a range");
            let (low, high) = (range(104)?, range(112)?);
            let (digital_low, digital_high) = (range(120)?, range(128)?);
            signal.step = (high - low) / (digital_high - digital_low);
            signal.offset = low - digital_low * signal.step;
            // A count is at most 2^23.
            let largest = signal.offset.abs() + signal.step.abs() * 8_388_608.0;
            if signal.step == 0.0 || largest.is_nan() || largest >= f64::from(f32::MAX) {
                let label = &signal.label;
                return Err(SignalsError::Damaged(format!(
                    "the ranges of signal {label} say nothing of its samples"
                )));
            }
        }
        Ok(signal)
    }
}

/// When samples were taken, and what was written beside them.
#[derive(Default)]
struct Timeline {
    /// Where records follow on: the first sample, and its time.
    runs: Vec<(u64, f64)>,
    samples: u64,
    sample_rate_hz: f64,
    gaps: Vec<Gap>,
    cues: Vec<Cue>,
}

impl Timeline {
    fn read(
        head: &Head,
        bytes: &[u8],
        samples_of_record: usize,
        sample_rate_hz: f64,
    ) -> Result<Timeline, SignalsError> {
        let texts: Vec<&Signal> = head.signals.iter().filter(|signal| signal.is_text).collect();
        let mut timeline = Timeline { sample_rate_hz, ..Timeline::default() };
        let mut annotations = Vec::new();
        for record in 0..head.records {
            let mut start_s = None;
            for (number, signal) in texts.iter().enumerate() {
                for (place, annotation) in annotations_of(head.part(bytes, record, signal)).enumerate() {
                    // The first one is the time of the record, and has no text.
                    if (number, place) == (0, 0) {
                        start_s = Some(annotation.onset_s);
                    }
                    annotations.push(annotation);
                }
            }
            if head.has_gaps && start_s.is_none() {
                return Err(SignalsError::Damaged(format!("record {record} does not say when it begins")));
            }
            timeline.begin_record(record, start_s.filter(|_| head.has_gaps || record == 0))?;
            timeline.samples += samples_of_record as u64;
        }
        timeline.cues = annotations.iter().filter_map(|annotation| timeline.cue(annotation)).collect();
        timeline.cues.sort_by_key(|cue| cue.start_sample);
        Ok(timeline)
    }

    /// A record begins, at a time of its own or after the one before.
    fn begin_record(&mut self, record: usize, start_s: Option<f64>) -> Result<(), SignalsError> {
        let Some(&(first_sample, run_start_s)) = self.runs.last() else {
            self.runs.push((0, start_s.unwrap_or(0.0)));
            return Ok(());
        };
        let Some(start_s) = start_s else { return Ok(()) };
        let expected_s = run_start_s + (self.samples - first_sample) as f64 / self.sample_rate_hz;
        let late_samples = (start_s - expected_s) * self.sample_rate_hz;
        // Times are rounded, too.
        const TOLERANCE_SAMPLES: f64 = 1.5;
        if late_samples < -TOLERANCE_SAMPLES {
            return Err(SignalsError::Damaged(format!(
                "record {record} begins at {start_s} s, before the end of the one before it"
            )));
        }
        if late_samples > TOLERANCE_SAMPLES {
            self.gaps.push(Gap::of(self.samples, late_samples));
            self.runs.push((self.samples, start_s));
        }
        Ok(())
    }

    /// The sample at a time: what lies in a gap belongs to its end.
    fn sample_at(&self, time_s: f64) -> u64 {
        let half_sample_s = 0.5 / self.sample_rate_hz;
        let place = self.runs.partition_point(|(_, start_s)| *start_s <= time_s + half_sample_s);
        let end = self.runs.get(place).map_or(self.samples, |(first_sample, _)| *first_sample);
        let Some(&(first_sample, start_s)) = self.runs[..place].last() else { return 0 };
        let sample = first_sample + ((time_s - start_s) * self.sample_rate_hz).round().max(0.0) as u64;
        sample.min(end)
    }

    fn cue(&self, annotation: &Annotation) -> Option<Cue> {
        let gesture = gesture_of(&annotation.text)?;
        let start_sample = self.sample_at(annotation.onset_s);
        let end_s = annotation.duration_s.filter(|duration_s| *duration_s > 0.0);
        let end_sample = end_s.map(|duration_s| self.sample_at(annotation.onset_s + duration_s));
        let is_inside = start_sample < self.samples && end_sample.is_none_or(|end| end > start_sample);
        is_inside.then_some(Cue { gesture, start_sample, end_sample })
    }
}

struct Annotation {
    onset_s: f64,
    duration_s: Option<f64>,
    text: String,
}

/// What annotations of a record say. What cannot be understood is passed over.
fn annotations_of(bytes: &[u8]) -> impl Iterator<Item = Annotation> {
    const TEXT: u8 = 0x14;
    const DURATION: u8 = 0x15;
    let lists = bytes.split(|byte| *byte == 0).filter(|list| !list.is_empty());
    lists.flat_map(|list| {
        let mut parts = list.split(|byte| *byte == TEXT);
        let time = parts.next().unwrap_or_default();
        let mut times = time.split(|byte| *byte == DURATION);
        let mut seconds = || text(times.next()?).parse().ok().filter(|seconds: &f64| seconds.is_finite());
        let (onset_s, duration_s) = (seconds(), seconds());
        let texts: Vec<String> = parts.map(text).collect();
        // What ends the last one begins no other.
        let texts = texts.len().saturating_sub(1);
        let parts = list.split(|byte| *byte == TEXT).skip(1).take(texts);
        onset_s.into_iter().flat_map(move |onset_s| {
            parts.clone().map(move |part| Annotation { onset_s, duration_s, text: text(part) })
        })
    })
}

/// Samples of a record to a rate: 35 in 0.0175 s are 2000 Hz, which a division misses by a digit.
fn rate_hz(samples_of_record: usize, record_s: f64) -> f64 {
    let rate_hz = samples_of_record as f64 / record_s;
    let whole_hz = rate_hz.round();
    if (rate_hz / whole_hz - 1.0).abs() < 1e-12 { whole_hz } else { rate_hz }
}

/// A field without the blanks around it. Others than ASCII stand in files all the same, as UTF-8 or Latin 1.
fn text(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.trim_matches([' ', '\0']).to_owned(),
        Err(_) => bytes.iter().map(|byte| char::from(*byte)).collect::<String>().trim().to_owned(),
    }
}

fn number<T: std::str::FromStr>(text: &str, what: &str) -> Result<T, SignalsError> {
    let parsed = text.replace(',', ".").parse();
    parsed.map_err(|_| SignalsError::Damaged(format!("{what} is `{text}` in its head")))
}

fn cut_in_head() -> SignalsError {
    SignalsError::Damaged("it ends within its head".to_owned())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use proptest::prelude::*;
    use tendon_gesture::Gesture;

    use super::*;
    use crate::segment::Segment;

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
