//! Samples of the slots that have a sensor.

use std::error::Error;

use tendon_delsys::{Decoder, SLOTS};
use tendon_link::{Decode, Instants};

/// Passes on the slots that have a sensor, and says which sensor was lost and is back.
pub struct SlotDecoder {
    decoder: Decoder,
    /// Counted from 0.
    slots: Vec<usize>,
    /// Those of `slots` that stand still.
    lost: Vec<bool>,
    /// Whether lost sensors are said: not while the server begins to send.
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

    /// Says from now on when a sensor is lost.
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
        let (first_sample, all) = self.decoder.push(bytes);
        self.instants.clear();
        for instant in all.chunks_exact(SLOTS) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_are_picked_and_those_that_do_not_fit_are_named() {
        let mut decoder = SlotDecoder::new(2000.0, &[1, 3]);
        let mut bytes = Vec::new();
        for slot in 0..SLOTS {
            let value = [0.0, 0.25, 0.0, 0.0, 5.0].get(slot).copied().unwrap_or(0.0_f32);
            bytes.extend(value.to_le_bytes());
        }
        let mut taken = Vec::new();
        decoder.push(&bytes, &mut |run| taken.extend_from_slice(run.instants)).unwrap();
        assert_eq!(taken, [0.25, 0.0]);
        assert_eq!(decoder.misplaced(), (vec![4], vec![5]));
    }
}
