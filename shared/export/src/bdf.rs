//! Writing BDF+ (teuniz.net BDF+ page, edfplus.info): EDF+ with samples of 24 bits.
//!
//! ```text
//! header      ASCII, 256 bytes and 256 for each signal; the number of records is written last
//! record …    each signal's samples, i24 little-endian, then annotations: when the record begins, and what there is to say
//! ```
//!
//! "BDF+C" goes on without gaps; in "BDF+D" each record says when it begins. A record has the same number of samples everywhere,
//! so what ends within one is filled up.

use std::io::{self, Seek, SeekFrom, Write};
use std::time::SystemTime;

/// Characters of a number in the header.
const NUMBER_WIDTH: usize = 8;
/// Characters of a label.
const LABEL_WIDTH: usize = 16;
/// Where the number of records stands.
const RECORDS_AT: u64 = 236;
/// All that 24 bits hold.
const DIGITAL: (i32, i32) = (-0x80_0000, 0x7F_FFFF);
/// Longest text of an annotation, in bytes.
const LONGEST_TEXT: usize = 400;
/// Room for a record's own time, in bytes.
const TIME_LENGTH: usize = 24;
/// Largest record, in bytes.
const LARGEST_RECORD: usize = 10 << 20;

/// A signal of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BdfSignal {
    /// At most 16 ASCII characters.
    pub(crate) label: String,
    /// Unit; empty if nobody knows.
    pub(crate) unit: String,
    /// What the smallest and the largest digital value stand for.
    pub(crate) low: String,
    pub(crate) high: String,
}

/// What a file begins with.
#[derive(Clone, Debug)]
pub(crate) struct BdfHeader {
    /// Pseudonym; `X` without one.
    pub(crate) patient: String,
    /// What recorded it.
    pub(crate) equipment: String,
    pub(crate) begun_at: SystemTime,
    pub(crate) is_discontinuous: bool,
    pub(crate) record: RecordLength,
    pub(crate) signals: Vec<BdfSignal>,
    /// What there is to say, in order.
    pub(crate) annotations: Vec<Annotation>,
    /// Records that will be written.
    pub(crate) records: u64,
}

/// Something to say.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Annotation {
    /// When, s from the first sample on.
    pub(crate) onset_s: f64,
    /// How long, s; 0 for a moment.
    pub(crate) duration_s: f64,
    pub(crate) text: String,
}

/// How long a record is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RecordLength {
    /// Samples of each signal.
    pub(crate) samples: usize,
    /// The same in s, as the header says it.
    pub(crate) seconds: String,
}

/// Samples between two gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    /// Samples of each signal.
    pub(crate) samples: u64,
    /// How many would fit into the gap behind them.
    pub(crate) room: u64,
}

impl Part {
    /// Samples with which the last of its records is filled up.
    pub(crate) fn filled(self, record_samples: usize) -> u64 {
        self.samples.next_multiple_of(record_samples as u64) - self.samples
    }
}

impl RecordLength {
    /// The length, of a tenth of a second to a second, with the fewest samples to be filled up at the ends of these parts; a
    /// shorter one where these would not leave anything of a gap, as each gap must show. Its time in at most 8 characters
    /// gives the rate to 0.1 ppm, or as nearly as there is one.
    pub(crate) fn choose(sample_rate_hz: f64, channels: usize, parts: &[Part]) -> RecordLength {
        let most = (sample_rate_hz.ceil() as usize).clamp(1, LARGEST_RECORD / 3 / channels.max(1));
        // A step of one sample between records passes for rounding.
        const SHORTEST_GAP: u64 = 2;
        let stays_a_gap = |filled: u64, room: u64| filled == 0 || filled + SHORTEST_GAP <= room;
        let fits = |samples: &usize| parts.iter().all(|part| stays_a_gap(part.filled(*samples), part.room));
        let of_rate = |samples: usize| {
            let length_s = samples as f64 / sample_rate_hz;
            let seconds = shortest(length_s);
            let error = (seconds.parse::<f64>().unwrap_or_default() / length_s - 1.0).abs();
            (RecordLength { samples, seconds }, error.max(1e-7))
        };
        let long =
            (most.div_ceil(10)..=most).filter(fits).map(of_rate).min_by(|(a, a_error), (b, b_error)| {
                let filled =
                    |record: &RecordLength| parts.iter().map(|part| part.filled(record.samples)).sum::<u64>();
                let longer_first = b.samples.cmp(&a.samples);
                a_error.total_cmp(b_error).then_with(|| filled(a).cmp(&filled(b))).then(longer_first)
            });
        let short = || (1..most.div_ceil(10)).rev().filter(fits).map(of_rate);
        let best = long.or_else(|| short().min_by(|(_, a_error), (_, b_error)| a_error.total_cmp(b_error)));
        best.map_or_else(|| of_rate(1).0, |(best, _)| best)
    }
}

/// Numbers in the header between which all of `low..=high` lies; `None` where they need more than 8 characters.
pub(crate) fn physical_range(low: f32, high: f32) -> Option<(String, String)> {
    if low == high {
        // A range must not be empty.
        let reach = low.abs().max(1.0);
        return physical_range(low - reach, high + reach);
    }
    Some((outward(f64::from(low), f64::floor)?, outward(f64::from(high), f64::ceil)?))
}

/// The number with as many decimals as fit, rounded by `round`.
fn outward(number: f64, round: impl Fn(f64) -> f64) -> Option<String> {
    (0..NUMBER_WIDTH as i32 - 1).rev().find_map(|decimals| {
        let scale = 10_f64.powi(decimals);
        let rounded = round(number * scale) / scale;
        let text = format!("{rounded:.*}", decimals as usize);
        (text.len() <= NUMBER_WIDTH).then_some(text)
    })
}

/// A positive number in at most 8 characters.
fn shortest(number: f64) -> String {
    let fits = (0..NUMBER_WIDTH).rev().map(|decimals| format!("{number:.decimals$}"));
    let text = fits.into_iter().find(|text| text.len() <= NUMBER_WIDTH).unwrap_or_else(|| "1".to_owned());
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A label of at most 16 ASCII characters, different for each channel.
pub(crate) fn label(name: &str, channel: usize) -> String {
    let ascii: String = name
        .chars()
        .map(|character| if (' '..='~').contains(&character) { character } else { '_' })
        .collect();
    if ascii == name && name.len() <= LABEL_WIDTH && !name.trim().is_empty() {
        return ascii;
    }
    let number = format!("_{channel}");
    format!("{:.*}{number}", LABEL_WIDTH - number.len(), ascii.trim())
}

/// A file that is being written.
#[derive(Debug)]
pub(crate) struct BdfWriter<W: Write + Seek> {
    output: W,
    scales: Vec<Scale>,
    /// Time of the first sample since the file's whole second, s.
    offset_s: f64,
    /// What there is still to say, the last first.
    annotations: Vec<Vec<u8>>,
    annotation_length: usize,
    record: Vec<u8>,
    records: u64,
}

/// From physical to digital values.
#[derive(Clone, Copy, Debug)]
struct Scale {
    low: f64,
    digits_per_unit: f64,
}

impl Scale {
    fn of(signal: &BdfSignal) -> Scale {
        let [low, high] = [&signal.low, &signal.high].map(|number| number.parse().unwrap_or_default());
        let digits_per_unit = f64::from(DIGITAL.1 - DIGITAL.0) / (high - low);
        Scale { low, digits_per_unit }
    }

    fn digital(self, value: f32) -> i32 {
        let digits = (f64::from(value) - self.low) * self.digits_per_unit;
        (digits.round() + f64::from(DIGITAL.0)).clamp(f64::from(DIGITAL.0), f64::from(DIGITAL.1)) as i32
    }
}

impl<W: Write + Seek> BdfWriter<W> {
    pub(crate) fn begin(mut output: W, header: &BdfHeader) -> io::Result<BdfWriter<W>> {
        let since_1970 = header.begun_at.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let offset_s = f64::from(since_1970.subsec_nanos()) * 1e-9;
        let mut annotations: Vec<Vec<u8>> =
            header.annotations.iter().map(|annotation| annotation.bytes(offset_s)).collect();
        let longest = annotations.iter().map(Vec::len).max().unwrap_or_default();
        let total: usize = annotations.iter().map(Vec::len).sum();
        annotations.reverse();
        // Each record leaves less than the longest one unused, so that all of them fit.
        let share = if total == 0 { 0 } else { longest + total.div_ceil(header.records.max(1) as usize) };
        let annotation_length = (TIME_LENGTH + share).next_multiple_of(3);
        output.write_all(&header.bytes(annotation_length / 3))?;
        let scales = header.signals.iter().map(Scale::of).collect();
        Ok(BdfWriter {
            output,
            scales,
            offset_s,
            annotations,
            annotation_length,
            record: Vec::new(),
            records: 0,
        })
    }

    /// Writes a record of which the first sample is at `start_s`; `channels` holds the samples of each.
    pub(crate) fn record(&mut self, start_s: f64, channels: &[Vec<f32>]) -> io::Result<()> {
        self.record.clear();
        for (scale, channel) in self.scales.iter().zip(channels) {
            for value in channel {
                self.record.extend(&scale.digital(*value).to_le_bytes()[..3]);
            }
        }
        let end = self.record.len() + self.annotation_length;
        self.record.extend(format!("+{}\x14\x14\0", decimals(start_s + self.offset_s)).bytes());
        while self.annotations.last().is_some_and(|next| self.record.len() + next.len() <= end) {
            self.record.extend(self.annotations.pop().unwrap_or_default());
        }
        self.record.resize(end, 0);
        self.records += 1;
        self.output.write_all(&self.record)
    }

    /// Ends the file.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        self.output.seek(SeekFrom::Start(RECORDS_AT))?;
        self.output.write_all(field(&self.records.to_string(), NUMBER_WIDTH).as_bytes())?;
        self.output.flush()
    }
}

impl Annotation {
    fn bytes(&self, offset_s: f64) -> Vec<u8> {
        let Annotation { onset_s, duration_s, text } = self;
        let onset_s = onset_s + offset_s;
        let sign = if onset_s < 0.0 { '-' } else { '+' };
        let mut bytes = format!("{sign}{}", decimals(onset_s.abs())).into_bytes();
        if *duration_s > 0.0 {
            bytes.extend(format!("\x15{}", decimals(*duration_s)).bytes());
        }
        bytes.push(0x14);
        let text: String =
            text.chars().map(|character| if character.is_control() { ' ' } else { character }).collect();
        let end = text.floor_char_boundary(LONGEST_TEXT);
        bytes.extend(&text.as_bytes()[..end]);
        bytes.extend([0x14, 0]);
        bytes
    }
}

impl BdfHeader {
    fn bytes(&self, annotation_samples: usize) -> Vec<u8> {
        let stamp = humantime::format_rfc3339_nanos(self.begun_at).to_string();
        let (year, month, day, time) = (&stamp[2..4], &stamp[5..7], &stamp[8..10], &stamp[11..19]);
        let months = ["JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"];
        let name_of_month =
            month.parse().ok().and_then(|month: usize| months.get(month - 1)).unwrap_or(&"JAN");
        let date = format!("{day}-{name_of_month}-{}", &stamp[..4]);
        let kind = if self.is_discontinuous { "BDF+D" } else { "BDF+C" };
        let signals = self.signals.len() + 1;
        let mut bytes = b"\xFFBIOSEMI".to_vec();
        let mut put = |text: &str, width: usize| bytes.extend(field(text, width).bytes());
        put(&format!("{} X X X", self.patient), 80);
        put(&format!("Startdate {date} X X {}", self.equipment.replace(' ', "_")), 80);
        put(&format!("{day}.{month}.{year}"), 8);
        put(&time.replace(':', "."), 8);
        put(&(256 * (signals + 1)).to_string(), 8);
        put(kind, 44);
        put("-1", NUMBER_WIDTH);
        put(&self.record.seconds, NUMBER_WIDTH);
        put(&signals.to_string(), 4);
        let annotations = BdfSignal {
            label: "BDF Annotations".to_owned(),
            unit: String::new(),
            low: "-1".to_owned(),
            high: "1".to_owned(),
        };
        let all: Vec<&BdfSignal> = self.signals.iter().chain([&annotations]).collect();
        all.iter().for_each(|signal| put(&signal.label, LABEL_WIDTH));
        all.iter().for_each(|_| put("", 80));
        all.iter().for_each(|signal| put(&signal.unit, 8));
        all.iter().for_each(|signal| put(&signal.low, NUMBER_WIDTH));
        all.iter().for_each(|signal| put(&signal.high, NUMBER_WIDTH));
        all.iter().for_each(|_| put(&DIGITAL.0.to_string(), NUMBER_WIDTH));
        all.iter().for_each(|_| put(&DIGITAL.1.to_string(), NUMBER_WIDTH));
        all.iter().for_each(|_| put("", 80));
        self.signals.iter().for_each(|_| put(&self.record.samples.to_string(), 8));
        put(&annotation_samples.to_string(), 8);
        all.iter().for_each(|_| put("", 32));
        bytes
    }
}

/// Text in so many bytes of ASCII.
fn field(text: &str, width: usize) -> String {
    let ascii: String = text
        .chars()
        .map(|character| if (' '..='~').contains(&character) { character } else { '_' })
        .collect();
    format!("{ascii:<width$.width$}")
}

/// A time in s, to 1 us, without zeros that say nothing.
fn decimals(time_s: f64) -> String {
    let text = format!("{time_s:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;

    /// The file that edfio reads as two channels of 2 s at 2000 Hz that begin 0.25 s behind the second, with "fist" at 0.5 s.
    #[test]
    fn a_file_is_the_bytes_that_edfio_reads() {
        let signal = |label: &str| BdfSignal {
            label: label.to_owned(),
            unit: "uV".to_owned(),
            low: "-5000".to_owned(),
            high: "5000".to_owned(),
        };
        let header = BdfHeader {
            patient: "anna".to_owned(),
            equipment: "Tendon 0.1.0".to_owned(),
            begun_at: SystemTime::UNIX_EPOCH + Duration::from_millis(1_777_885_953_250),
            is_discontinuous: false,
            record: RecordLength { samples: 2000, seconds: "1".to_owned() },
            signals: vec![signal("flexor"), signal("extensor")],
            annotations: vec![Annotation { onset_s: 0.5, duration_s: 1.0, text: "fist".to_owned() }],
            records: 2,
        };
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = BdfWriter::begin(&mut bytes, &header).unwrap();
        let channels = vec![vec![15.6435_f32; 2000], vec![-5000.0; 2000]];
        writer.record(0.0, &channels).unwrap();
        writer.record(1.0, &channels).unwrap();
        writer.finish().unwrap();
        let bytes = bytes.into_inner();
        let text = |range: std::ops::Range<usize>| std::str::from_utf8(&bytes[range]).unwrap();
        assert_eq!(&bytes[..8], b"\xffBIOSEMI");
        assert_eq!(text(8..88).trim_end(), "anna X X X");
        assert_eq!(text(88..168).trim_end(), "Startdate 04-MAY-2026 X X Tendon_0.1.0");
        assert_eq!(text(168..256), format!("04.05.2609.12.331024    {:<44}2       1       3   ", "BDF+C"));
        // 26245 of the full 24 bits.
        assert_eq!(bytes[1024..1027], [0x85, 0x66, 0x00]);
        assert_eq!(bytes[1024 + 6000..1024 + 6003], [0x00, 0x00, 0x80]);
        let said = b"+0.25\x14\x14\0+0.75\x151\x14fist\x14\0\0";
        assert_eq!(&bytes[1024 + 12000..1024 + 12000 + said.len()], said);
        let length = (bytes.len() - 1024) / 2;
        let said = b"+1.25\x14\x14\0\0";
        assert_eq!(&bytes[1024 + length + 12000..1024 + length + 12000 + said.len()], said);
    }

    #[test]
    fn a_record_fits_the_rate_and_the_parts() {
        let choose = |rate_hz, parts: &[(u64, u64)]| {
            let parts: Vec<Part> = parts.iter().map(|&(samples, room)| Part { samples, room }).collect();
            let RecordLength { samples, seconds } = RecordLength::choose(rate_hz, 4, &parts);
            (samples, seconds)
        };
        let last = u64::MAX;
        assert_eq!(choose(2000.0, &[(40_000, last)]), (2000, "1".to_owned()));
        assert_eq!(choose(2000.0, &[(3_000, last)]), (1500, "0.75".to_owned()));
        // Something of each gap is left: 100 samples more do not fit into a gap of 10, and single lost samples leave no choice.
        assert_eq!(choose(2000.0, &[(3_900, 10), (4_000, last)]).0, 217);
        assert_eq!(choose(2000.0, &[(40, 30), (20, 10), (50, last)]).0, 28);
        assert_eq!(choose(2000.0, &[(41, 0), (30, 0), (50, last)]).0, 1);
        let (samples, seconds) = choose(1925.926, &[(19_266, last)]);
        assert!((samples as f64 / seconds.parse::<f64>().unwrap() / 1925.926 - 1.0).abs() < 2e-7);
    }

    #[test]
    fn labels_are_short_different_and_ascii() {
        assert_eq!(label("flexor", 0), "flexor");
        assert_eq!(label("Strecker \u{fc}ber allem", 3), "Strecker _ber _3");
        assert_eq!(label("", 12), "_12");
        assert_ne!(
            label("a very long name of a muscle, upper", 1),
            label("a very long name of a muscle, lower", 2)
        );
    }

    proptest! {
        #[test]
        fn a_range_holds_all_that_it_is_of(a in -9e6_f32..9e7, b in -9e6_f32..9e7) {
            let (low, high) = (a.min(b), a.max(b));
            let (written_low, written_high) = physical_range(low, high).unwrap();
            prop_assert!(written_low.len() <= 8 && written_high.len() <= 8);
            let (l, h): (f64, f64) = (written_low.parse().unwrap(), written_high.parse().unwrap());
            prop_assert!(l < h && l <= f64::from(low) && f64::from(high) <= h, "{} {}", written_low, written_high);
        }

        #[test]
        fn all_that_there_is_to_say_fits(
            texts in prop::collection::vec("[a-z\u{e4}\u{1}]{0,500}", 0..30),
            records in 1_u64..20,
        ) {
            let annotations: Vec<Annotation> = texts
                .iter()
                .map(|text| Annotation { onset_s: 1.5, duration_s: 0.0, text: text.clone() })
                .collect();
            let header = BdfHeader {
                patient: "X".to_owned(),
                equipment: "X".to_owned(),
                begun_at: SystemTime::UNIX_EPOCH,
                is_discontinuous: true,
                record: RecordLength { samples: 1, seconds: "1".to_owned() },
                signals: Vec::new(),
                annotations,
                records,
            };
            let mut writer = BdfWriter::begin(Cursor::new(Vec::new()), &header).unwrap();
            for record in 0..records {
                writer.record(record as f64, &[]).unwrap();
            }
            prop_assert!(writer.annotations.is_empty());
        }
    }
}
