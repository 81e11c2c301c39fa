//! What the head of an EDF or BDF file says, and the samples that lie as it says.

use tendon_signal::unit_factor;

use crate::signals::SignalsError;
use crate::table::Channel;

const HEAD_BYTES: usize = 256;

/// What the head says of a signal.
#[derive(Clone, Debug)]
pub(super) struct Signal {
    pub(super) label: String,
    pub(super) unit: String,
    /// Physical value of digital 0, and of one digital step.
    pub(super) offset: f64,
    pub(super) step: f64,
    pub(super) samples_of_record: usize,
    /// Where it begins in a record, in bytes.
    pub(super) position: usize,
    pub(super) is_text: bool,
}

/// Of the whole file.
pub(super) struct Head {
    /// Bytes of a count.
    pub(super) width: usize,
    pub(super) has_gaps: bool,
    pub(super) record_s: f64,
    pub(super) record_bytes: usize,
    pub(super) records: usize,
    /// Records that it should have, if there are fewer or it does not say.
    pub(super) expected: Option<Option<usize>>,
    pub(super) signals: Vec<Signal>,
    /// Where the first record begins.
    pub(super) position: usize,
}

impl Head {
    pub(super) fn read(bytes: &[u8]) -> Result<Head, SignalsError> {
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
    pub(super) fn signals_of_one_rate(&self, channels: &[Channel]) -> Result<Vec<&Signal>, SignalsError> {
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
    pub(super) fn part<'a>(&self, bytes: &'a [u8], record: usize, signal: &Signal) -> &'a [u8] {
        let start = self.position + record * self.record_bytes + signal.position;
        &bytes[start..start + signal.samples_of_record * self.width]
    }

    /// All samples of a signal, in `unit` where that can be had.
    pub(super) fn column(&self, bytes: &[u8], signal: &Signal, unit: &str) -> Vec<f32> {
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

/// A field without the blanks around it. Others than ASCII stand in files all the same, as UTF-8 or Latin 1.
pub(super) fn text(bytes: &[u8]) -> String {
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
