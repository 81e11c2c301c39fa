//! Bytes of the EMG port in, samples of the slots out.

/// Slots of a base, and values of an instant.
pub const SLOTS: usize = 16;
/// Length of an instant.
pub const INSTANT_BYTES: usize = 4 * SLOTS;
/// A slot whose value stands still for so long has lost its sensor, s.
const STANDSTILL_S: f64 = 0.05;

/// No sensor measures more than this, in V or whatever else it says its values are in. Half of all random bytes do.
const LARGEST_VALUE: f32 = 1000.0;

/// What comes are no samples: bytes were lost or added, and the values are read out of step.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the samples are out of step: slot {slot} reads {value:e} V, which no sensor measures")]
pub struct OutOfStep {
    /// Where it shows, counted from 1.
    pub slot: usize,
    /// What stands there.
    pub value: f32,
}

/// Decodes the stream of one connection. Samples of a slot that stands still become NaN, so that nobody acts upon them. Allocates
/// nothing once it has seen its longest read.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// Beginning of an instant whose rest has not come.
    torn: Vec<u8>,
    instants: Vec<f32>,
    next_sample: u64,
    /// For so many samples a slot may stand still.
    longest: u32,
    slots: [Slot; SLOTS],
}

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    value: f32,
    /// Samples with this value in a row.
    same: u32,
    /// Whether it was ever another value than 0.
    was_used: bool,
}

impl Decoder {
    /// For samples at this rate.
    pub fn new(rate_hz: f64) -> Decoder {
        Decoder {
            torn: Vec::with_capacity(INSTANT_BYTES),
            instants: Vec::new(),
            next_sample: 0,
            longest: (STANDSTILL_S * rate_hz).ceil() as u32,
            slots: [Slot::default(); SLOTS],
        }
    }

    /// Takes the bytes of a read; gives the index of the first sample and the samples, `[samples × 16]`, V, that they complete.
    ///
    /// # Errors
    ///
    /// [`OutOfStep`]: what follows cannot be read.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(u64, &[f32]), OutOfStep> {
        self.instants.clear();
        let first_sample = self.next_sample;
        let mut bytes = bytes;
        if !self.torn.is_empty() {
            let (head, rest) = bytes.split_at(bytes.len().min(INSTANT_BYTES - self.torn.len()));
            self.torn.extend_from_slice(head);
            bytes = rest;
            if self.torn.len() < INSTANT_BYTES {
                return Ok((first_sample, &self.instants));
            }
            let mut torn = std::mem::take(&mut self.torn);
            let decoded = self.decode(&torn);
            torn.clear();
            self.torn = torn;
            decoded?;
        }
        let mut instants = bytes.chunks_exact(INSTANT_BYTES);
        self.torn.extend_from_slice(instants.remainder());
        instants.try_for_each(|instant| self.decode(instant))?;
        Ok((first_sample, &self.instants))
    }

    /// Whether this slot, counted from 0, stands still.
    pub fn stands_still(&self, slot: usize) -> bool {
        self.slots[slot].same >= self.longest
    }

    /// Whether this slot, counted from 0, ever held something else than exactly 0, as slots without a sensor do.
    pub fn was_used(&self, slot: usize) -> bool {
        self.slots[slot].was_used
    }

    fn decode(&mut self, instant: &[u8]) -> Result<(), OutOfStep> {
        for (number, (slot, bytes)) in (1..).zip(self.slots.iter_mut().zip(instant.chunks_exact(4))) {
            let value = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
            if value.is_nan() || value.abs() > LARGEST_VALUE {
                return Err(OutOfStep { slot: number, value });
            }
            slot.same = if value.to_bits() == slot.value.to_bits() { slot.same.saturating_add(1) } else { 1 };
            slot.value = value;
            slot.was_used |= value != 0.0;
            self.instants.push(if slot.same >= self.longest { f32::NAN } else { value });
        }
        self.next_sample += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RATE_HZ: f64 = 2000.0;

    fn instant(slots: &[f32]) -> Vec<u8> {
        (0..SLOTS).flat_map(|slot| slots.get(slot).copied().unwrap_or(0.0).to_le_bytes()).collect()
    }

    #[test]
    fn the_vector_of_the_protocol_sheet_is_read() {
        let mut bytes = vec![0x00, 0x00, 0x80, 0x3e, 0x00, 0x00, 0x00, 0xbf];
        bytes.extend([0; 56]);
        let mut decoder = Decoder::new(RATE_HZ);
        let (first_sample, samples) = decoder.push(&bytes).unwrap();
        assert_eq!((first_sample, samples.len()), (0, SLOTS));
        assert_eq!(samples[..3], [0.25, -0.5, 0.0]);
        assert!(decoder.was_used(1) && !decoder.was_used(2));
    }

    #[test]
    fn a_slot_that_stands_still_for_50_ms_is_lost_and_comes_back() {
        let mut decoder = Decoder::new(RATE_HZ);
        let mut lost = Vec::new();
        for sample in 0..400 {
            let held = if (100..300).contains(&sample) { 0.5 } else { sample as f32 * 1e-3 };
            let (_, samples) = decoder.push(&instant(&[held, sample as f32])).unwrap();
            assert_eq!(samples[1], sample as f32);
            let is_lost = samples[0].is_nan();
            if is_lost {
                lost.push(sample);
            }
            assert_eq!(decoder.stands_still(0), is_lost);
        }
        assert_eq!((lost.first(), lost.last()), (Some(&199), Some(&299)));
    }

    #[test]
    fn values_that_no_sensor_measures_are_refused_by_their_slot() {
        for value in [f32::NAN, f32::INFINITY, -1e30, 1001.0] {
            let mut decoder = Decoder::new(RATE_HZ);
            decoder.push(&instant(&[0.01, 0.02])).unwrap();
            let refused = decoder.push(&instant(&[0.01, value])).unwrap_err();
            assert_eq!((refused.slot, refused.value.to_bits()), (2, value.to_bits()));
        }
    }

    proptest! {
        #[test]
        fn samples_that_are_read_out_of_step_are_noticed(
            microvolts in proptest::collection::vec(-5000.0..5000.0_f32, SLOTS * 20),
            shift in 1_usize..INSTANT_BYTES,
        ) {
            prop_assume!(shift % 4 != 0);
            let bytes: Vec<u8> = microvolts.iter().flat_map(|value| (value * 1e-6).to_le_bytes()).collect();
            prop_assert!(Decoder::new(RATE_HZ).push(&bytes[shift..]).is_err());
        }

        #[test]
        fn reads_of_any_length_give_the_same_samples(reads in proptest::collection::vec(1_usize..200, 1..20)) {
            let bytes: Vec<u8> = (0..60).flat_map(|sample| instant(&[sample as f32, -1.0 / (sample + 1) as f32])).collect();
            let mut decoder = Decoder::new(RATE_HZ);
            let (mut left, mut found) = (&bytes[..], Vec::new());
            for length in reads.iter().cycle() {
                let (read, rest) = left.split_at((*length).min(left.len()));
                left = rest;
                let (first_sample, samples) = decoder.push(read).unwrap();
                prop_assert_eq!(first_sample as usize * SLOTS, found.len());
                found.extend(samples.iter().map(|value| value.to_bits()));
                if left.is_empty() {
                    break;
                }
            }
            let mut whole = Decoder::new(RATE_HZ);
            let whole: Vec<u32> = whole.push(&bytes).unwrap().1.iter().map(|value| value.to_bits()).collect();
            prop_assert_eq!(found, whole);
        }
    }
}
