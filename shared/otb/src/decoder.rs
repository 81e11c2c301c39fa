//! Bytes in, samples of the chosen channels out, with the instants that were lost counted.

use crate::{ByteOrder, Layout};

/// Longest loss that is believed, s. A larger jump of the counter means that the stream is out of step: a device that was
/// silent for so long was connected anew before.
const LONGEST_LOSS_S: f64 = 1.0;

/// The stream does not hold what it should.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the device's counter jumped from {before} to {counter}: bytes were lost on the way, or the device sends other channels \
     than the settings say"
)]
pub struct OutOfStep {
    /// Of the instant before.
    pub before: u16,
    /// Of this instant.
    pub counter: u16,
}

/// Instants that follow one another without a loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instants<'a> {
    /// Index of the first since the decoder was made, those that were lost included.
    pub first_sample: u64,
    /// `[samples × EMG channels]`, mV.
    pub instants_mv: &'a [f32],
}

/// Decodes the stream of one connection. Allocates nothing once it has seen its longest read.
#[derive(Clone, Debug)]
pub struct Decoder {
    layout: Layout,
    /// Beginning of an instant whose rest has not come.
    torn: Vec<u8>,
    instants_mv: Vec<f32>,
    counter_before: Option<u16>,
    next_sample: u64,
    lost_samples: u64,
}

impl Decoder {
    /// For the stream of an amplifier with this layout.
    pub fn new(layout: Layout) -> Decoder {
        Decoder {
            layout,
            torn: Vec::with_capacity(layout.instant_bytes()),
            instants_mv: Vec::new(),
            counter_before: None,
            next_sample: 0,
            lost_samples: 0,
        }
    }

    /// Instants that were lost so far.
    pub fn lost_samples(&self) -> u64 {
        self.lost_samples
    }

    /// Takes the bytes of a read, and gives every run of instants without a loss to `take`.
    ///
    /// # Errors
    ///
    /// [`OutOfStep`]: connect anew.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Instants<'_>)) -> Result<(), OutOfStep> {
        let length = self.layout.instant_bytes();
        let mut bytes = bytes;
        if !self.torn.is_empty() {
            let (head, rest) = bytes.split_at(bytes.len().min(length - self.torn.len()));
            self.torn.extend_from_slice(head);
            bytes = rest;
            if self.torn.len() < length {
                return Ok(());
            }
            let mut torn = std::mem::take(&mut self.torn);
            let decoded = self.decode(&torn, &mut take);
            torn.clear();
            self.torn = torn;
            decoded?;
        }
        let instants = bytes.chunks_exact(length);
        self.torn.extend_from_slice(instants.remainder());
        for instant in instants {
            self.decode(instant, &mut take)?;
        }
        self.hand_over(&mut take);
        Ok(())
    }

    fn decode(&mut self, instant: &[u8], take: &mut impl FnMut(Instants<'_>)) -> Result<(), OutOfStep> {
        let counter = self.sample(instant, self.layout.counter_channel) as u16;
        if let Some(before) = self.counter_before {
            let lost = u64::from(counter.wrapping_sub(before).wrapping_sub(1));
            if lost as f64 > LONGEST_LOSS_S * self.layout.rate_hz {
                return Err(OutOfStep { before, counter });
            }
            if lost > 0 {
                self.hand_over(take);
                self.next_sample += lost;
                self.lost_samples += lost;
            }
        }
        self.counter_before = Some(counter);
        for channel in 0..self.layout.emg_channels {
            let counts = f64::from(self.sample(instant, channel));
            self.instants_mv.push((counts * self.layout.mv_per_count) as f32);
        }
        Ok(())
    }

    fn sample(&self, instant: &[u8], channel: usize) -> i16 {
        let bytes = [instant[2 * channel], instant[2 * channel + 1]];
        match self.layout.byte_order {
            ByteOrder::Big => i16::from_be_bytes(bytes),
            ByteOrder::Little => i16::from_le_bytes(bytes),
        }
    }

    fn hand_over(&mut self, take: &mut impl FnMut(Instants<'_>)) {
        let samples = self.instants_mv.len() / self.layout.emg_channels;
        if samples > 0 {
            take(Instants { first_sample: self.next_sample, instants_mv: &self.instants_mv });
            self.next_sample += samples as u64;
            self.instants_mv.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Amplifier;
    use proptest::prelude::*;

    /// A stream of Muovi instants with these counters; channel 0 holds the counter, channel 1 its negative.
    fn muovi(counters: impl IntoIterator<Item = u16>) -> Vec<u8> {
        let layout = Amplifier::Muovi.layout(0);
        counters
            .into_iter()
            .flat_map(|counter| {
                let mut instant = vec![0; layout.instant_bytes()];
                instant[..2].copy_from_slice(&(counter as i16).to_be_bytes());
                instant[2..4].copy_from_slice(&(counter as i16).wrapping_neg().to_be_bytes());
                instant[2 * layout.counter_channel..].copy_from_slice(&counter.to_be_bytes());
                instant
            })
            .collect()
    }

    const CHANNELS: usize = 32;

    fn decoder() -> Decoder {
        Decoder::new(Amplifier::Muovi.layout(0))
    }

    /// First sample and samples of each run.
    fn decode(decoder: &mut Decoder, bytes: &[u8]) -> Result<Vec<(u64, Vec<f32>)>, OutOfStep> {
        let mut runs = Vec::new();
        decoder.push(bytes, |run| runs.push((run.first_sample, run.instants_mv.to_vec())))?;
        Ok(runs)
    }

    #[test]
    fn the_vector_of_the_protocol_sheet_is_read() {
        let mut bytes = vec![0x01, 0x00, 0xFF, 0xFE];
        bytes.extend([0; 70]);
        bytes.extend([0x00, 0x07]);
        let runs = decode(&mut decoder(), &bytes).unwrap();
        let [(0, samples)] = &runs[..] else { panic!("{runs:?}") };
        assert!(
            (samples[0] - 0.073_241_6).abs() < 1e-6 && samples[1] < 0.0 && samples[2] == 0.0,
            "{samples:?}"
        );
    }

    #[test]
    fn samples_of_a_sessantaquattro_and_a_quattrocento_are_read_in_their_own_order() {
        let row = [7_i16, -4, -1, 118];
        let layout =
            Layout { channels: 4, emg_channels: 3, counter_channel: 3, ..Amplifier::Muovi.layout(0) };
        for (byte_order, bytes) in [
            (ByteOrder::Big, row.map(i16::to_be_bytes).concat()),
            (ByteOrder::Little, row.map(i16::to_le_bytes).concat()),
        ] {
            let layout = Layout { byte_order, mv_per_count: 1.0, ..layout };
            let mut decoder = Decoder::new(layout);
            assert_eq!(decode(&mut decoder, &bytes).unwrap(), [(0, vec![7.0, -4.0, -1.0])]);
        }
    }

    #[test]
    fn lost_instants_are_counted_exactly_also_where_the_counter_wraps() {
        let mut decoder = decoder();
        let runs = decode(&mut decoder, &muovi((65_500..=65_535).chain(100..110).chain(115..117))).unwrap();
        let places: Vec<_> = runs.iter().map(|(first, samples)| (*first, samples.len() / CHANNELS)).collect();
        assert_eq!(places, [(0, 36), (136, 10), (151, 2)]);
        assert_eq!(decoder.lost_samples(), 105);
    }

    #[test]
    fn a_counter_that_jumps_back_repeats_or_jumps_far_is_out_of_step() {
        for counters in [[5, 4], [5, 5], [5, 5000]] {
            assert_eq!(
                decode(&mut decoder(), &muovi(counters)),
                Err(OutOfStep { before: counters[0], counter: counters[1] })
            );
        }
    }

    proptest! {
        #[test]
        fn reads_of_any_length_give_the_same_samples(cuts in proptest::collection::vec(1_usize..300, 1..60)) {
            let bytes = muovi((0..50).chain(60..100));
            let whole = decode(&mut decoder(), &bytes).unwrap();
            let mut torn = decoder();
            let (mut left, mut samples) = (&bytes[..], Vec::new());
            for cut in cuts {
                let (read, rest) = left.split_at(cut.min(left.len()));
                left = rest;
                for (first_sample, run) in decode(&mut torn, read).unwrap() {
                    samples.extend(run.chunks(CHANNELS).zip(first_sample..).map(|(instant, index)| (index, instant.to_vec())));
                }
            }
            let all: Vec<_> = whole
                .iter()
                .flat_map(|(first, run)| run.chunks(CHANNELS).zip(*first..).map(|(instant, index)| (index, instant.to_vec())))
                .collect();
            prop_assert_eq!(&samples[..], &all[..samples.len()]);
        }

        #[test]
        fn any_bytes_are_taken_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
            let _ = decode(&mut decoder(), &bytes);
        }
    }
}
