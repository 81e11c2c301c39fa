//! Samples of the slots that have a sensor.
//!
//! ```text
//! in step       │ a b 0 0 … │ a b 0 0 … │         a and b: sensors; slots without one are exactly 0
//! out of step   │ 0 0 … a b │ 0 0 … a b │         by whole values: a slot without a sensor is not 0
//! ```

use std::error::Error;

use tendon_delsys::{Decoder, SLOTS};
use tendon_link::{Decode, Instants};

/// A slot without a sensor holds a sample.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the samples are out of step: slot {slot}, where no sensor is paired, reads {value:e} V")]
struct Misplaced {
    /// Counted from 1.
    slot: usize,
    value: f32,
}

/// Passes on the slots that have a sensor, and says which sensor was lost and is back.
pub struct SlotDecoder {
    decoder: Decoder,
    /// Counted from 0.
    slots: Vec<usize>,
    /// Those of `slots` that stand still.
    lost: Vec<bool>,
    /// Whether lost sensors are said and samples in other slots refused: not while the server begins to send.
    is_watching: bool,
    instants: Vec<f32>,
}

impl SlotDecoder {
    pub fn new(rate_hz: f64, slots: &[usize]) -> SlotDecoder {
        SlotDecoder {
            decoder: Decoder::new(rate_hz),
            slots: slots.to_vec(),
            lost: vec![false; slots.len()],
            is_watching: false,
            instants: Vec::new(),
        }
    }

    /// Says from now on when a sensor is lost, and refuses samples in slots without one.
    pub fn watch(&mut self) {
        self.is_watching = true;
    }

    /// Slots with a sensor that sent nothing, and slots without one that did, counted from 1.
    pub fn misplaced(&self) -> (Vec<usize>, Vec<usize>) {
        let numbers = |is_paired: bool| {
            let of_kind = (0..SLOTS).filter(move |slot| self.slots.contains(slot) == is_paired);
            of_kind.filter(move |slot| self.decoder.was_used(*slot) != is_paired).map(|slot| slot + 1)
        };
        (numbers(true).collect(), numbers(false).collect())
    }

    fn say_lost_sensors(&mut self) {
        for (slot, was_lost) in self.slots.iter().zip(&mut self.lost) {
            let is_lost = self.decoder.stands_still(*slot);
            if is_lost && !*was_lost {
                tracing::warn!(
                    "slot {}: its value has not changed for 50 ms: is the sensor out of reach, or its battery empty? Its \
                     samples are no numbers until it is back",
                    slot + 1
                );
            } else if *was_lost && !is_lost {
                tracing::warn!("slot {}: the sensor is back", slot + 1);
            }
            *was_lost = is_lost;
        }
    }
}

impl Decode for SlotDecoder {
    fn push(
        &mut self,
        bytes: &[u8],
        take: &mut dyn FnMut(Instants<'_>),
    ) -> Result<(), Box<dyn Error + Send + Sync>> {
        let (first_sample, all) = self.decoder.push(bytes)?;
        self.instants.clear();
        for instant in all.chunks_exact(SLOTS) {
            if self.is_watching {
                check_other_slots(instant, &self.slots)?;
            }
            self.instants.extend(self.slots.iter().map(|slot| instant[*slot]));
        }
        if !self.instants.is_empty() {
            take(Instants { first_sample, instants: &self.instants });
        }
        if self.is_watching {
            self.say_lost_sensors();
        }
        Ok(())
    }
}

/// Whether a whole instant has nothing in slots without a sensor. Samples that are lost are NaN by then.
fn check_other_slots(instant: &[f32], slots: &[usize]) -> Result<(), Misplaced> {
    let mut others =
        (0..).zip(instant).filter(|(slot, value)| **value != 0.0 && !value.is_nan() && !slots.contains(slot));
    others.next().map_or(Ok(()), |(slot, value)| Err(Misplaced { slot: slot + 1, value: *value }))
}

#[cfg(test)]
mod tests {
    use tendon_delsys::INSTANT_BYTES;

    use super::*;

    fn instant(values: &[f32]) -> Vec<u8> {
        (0..SLOTS).flat_map(|slot| values.get(slot).copied().unwrap_or(0.0).to_le_bytes()).collect()
    }

    /// Samples of slots 1 and 2, of which these bytes are missing or were added after the first ten.
    fn read(damage: impl Fn(&mut Vec<u8>)) -> Result<(), Box<dyn Error + Send + Sync>> {
        let sample =
            |number: usize| instant(&[1e-3 + number as f32 * 1.1e-6, -1e-3 - number as f32 * 1.3e-6]);
        let mut decoder = SlotDecoder::new(2000.0, &[0, 1]);
        decoder.watch();
        decoder.push(&(0..10).flat_map(sample).collect::<Vec<u8>>(), &mut |_| {}).unwrap();
        let mut rest: Vec<u8> = (10..200).flat_map(sample).collect();
        damage(&mut rest);
        decoder.push(&rest, &mut |_| {})
    }

    #[test]
    fn bytes_that_are_lost_or_added_are_noticed_wherever_they_are() {
        read(|_| {}).unwrap();
        for bytes in 1..INSTANT_BYTES {
            let lost = read(|rest| drop(rest.drain(..bytes))).unwrap_err().to_string();
            let added = read(|rest| drop(rest.splice(..0, vec![0; bytes]))).unwrap_err().to_string();
            assert!(
                lost.contains("out of step") && added.contains("out of step"),
                "{bytes}: {lost}; {added}"
            );
        }
        let said = read(|rest| drop(rest.drain(..60))).unwrap_err().to_string();
        assert!(
            said.starts_with("the samples are out of step: slot 3, where no sensor is paired, reads"),
            "{said}"
        );
    }

    #[test]
    fn slots_are_picked_and_those_that_do_not_fit_are_named() {
        let mut decoder = SlotDecoder::new(2000.0, &[1, 3]);
        let bytes = instant(&[0.0, 0.25, 0.0, 0.0, 5.0]);
        let mut taken = Vec::new();
        decoder.push(&bytes, &mut |run| taken.extend_from_slice(run.instants)).unwrap();
        assert_eq!(taken, [0.25, 0.0]);
        assert_eq!(decoder.misplaced(), (vec![4], vec![5]));
    }
}
