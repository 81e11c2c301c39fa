//! The samples of a session as BDF+.

use std::fs::File;
use std::io::{self, BufWriter, Read};
use std::path::Path;

use tendon_session_file::{Block, Message, Reader};

use super::events::BidsEvent;
use crate::bdf::{BdfHeader, BdfSignal, BdfWriter, RecordLength};
use crate::{ExportError, Survey, Timeline};

/// What the header of an exported file calls what recorded it, before the version.
const EQUIPMENT: &str = "Tendon";
/// Bytes of a header in which that stands.
const HEADER_BEGINNING: u64 = 168;

/// Whether the file is a recording that was exported.
pub(super) fn is_exported(path: &Path) -> bool {
    let mut beginning = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEADER_BEGINNING).read_to_end(&mut beginning));
    let equipment = format!(" X X {EQUIPMENT}");
    read.is_ok()
        && beginning.starts_with(b"\xFFBIOSEMI")
        && beginning.windows(equipment.len()).any(|bytes| bytes == equipment.as_bytes())
}

/// How long the records are.
pub(super) fn record_length(survey: &Survey) -> RecordLength {
    RecordLength::choose(survey.sample_rate_hz, survey.channels.len(), &survey.parts())
}

/// Writes the file. `has_read` is told how many bytes of the recording were read so far.
pub(super) fn write(
    survey: &Survey,
    signals: &[BdfSignal],
    events: &[BidsEvent],
    output: BufWriter<File>,
    mut has_read: impl FnMut(u64) -> Result<(), ExportError>,
) -> Result<(), ExportError> {
    let failed = ExportError::writing(&survey.path.with_extension("bdf"));
    let record = record_length(survey);
    let version = survey.provenance["version"].as_str().unwrap_or_default();
    let header = BdfHeader {
        patient: survey.person.as_ref().map_or("X", |person| person.as_str()).to_owned(),
        equipment: format!("{EQUIPMENT} {version}").trim().to_owned(),
        begun_at: survey.begun_at,
        is_discontinuous: !survey.gaps.is_empty(),
        signals: signals.to_vec(),
        annotations: events.iter().map(BidsEvent::annotation).collect(),
        records: survey.parts().iter().map(|part| part.samples.div_ceil(record.samples as u64)).sum(),
        record,
    };
    let mut records = Records::begin(survey, &header, output).map_err(&failed)?;
    let mut reader = Reader::open(&survey.path)?;
    while let Some(message) = reader.next_message()? {
        if let Message::Block(block) = &message {
            records.take(block).map_err(&failed)?;
        }
        has_read(reader.bytes_read())?;
    }
    records.finish().map_err(failed)
}

/// Gathers blocks into records.
struct Records {
    file: BdfWriter<BufWriter<File>>,
    timeline: Timeline,
    sample_rate_hz: f64,
    record_samples: usize,
    /// Time of the first sample that is gathered, s.
    start_s: f64,
    /// The samples that are gathered, of each channel.
    channels: Vec<Vec<f32>>,
    /// The newest finite sample of each channel.
    held: Vec<f32>,
}

impl Records {
    fn begin(survey: &Survey, header: &BdfHeader, output: BufWriter<File>) -> io::Result<Records> {
        let record_samples = header.record.samples;
        let channels = vec![Vec::with_capacity(record_samples); header.signals.len()];
        Ok(Records {
            file: BdfWriter::begin(output, header)?,
            timeline: Timeline::new(survey.sample_rate_hz, survey.begun_ns),
            sample_rate_hz: survey.sample_rate_hz,
            record_samples,
            start_s: 0.0,
            channels,
            held: vec![0.0; header.signals.len()],
        })
    }

    fn take(&mut self, block: &Block) -> io::Result<()> {
        let placed = self.timeline.take(block);
        if placed.is_behind_gap {
            self.fill_up()?;
        }
        let samples = block.samples as usize;
        for sample in 0..samples {
            if self.gathered() == 0 {
                self.start_s = placed.start_s + sample as f64 / self.sample_rate_hz;
            }
            let values = block.values.chunks_exact(samples).map(|channel| channel[sample]);
            for ((channel, held), value) in self.channels.iter_mut().zip(&mut self.held).zip(values) {
                *held = if value.is_finite() { value } else { *held };
                channel.push(*held);
            }
            if self.gathered() == self.record_samples {
                self.write()?;
            }
        }
        Ok(())
    }

    fn finish(mut self) -> io::Result<()> {
        self.fill_up()?;
        self.file.finish()
    }

    /// Ends a record that is not full, if there is one.
    fn fill_up(&mut self) -> io::Result<()> {
        if self.gathered() == 0 {
            return Ok(());
        }
        for (channel, held) in self.channels.iter_mut().zip(&self.held) {
            channel.resize(self.record_samples, *held);
        }
        self.write()
    }

    fn write(&mut self) -> io::Result<()> {
        self.file.record(self.start_s, &self.channels)?;
        self.channels.iter_mut().for_each(Vec::clear);
        Ok(())
    }

    fn gathered(&self) -> usize {
        self.channels.first().map_or(0, Vec::len)
    }
}
