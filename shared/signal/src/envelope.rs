//! The envelope: a moving root mean square, the paper's measure of muscle activity.

use crate::error::{DesignError, samples_of};

/// The paper's length of the moving RMS (section "Onset Detection"), in ms.
pub const DEFAULT_ENVELOPE_MS: f64 = 25.0;

/// Moving RMS of one channel. Samples before the first count as zero.
///
/// The sum over the last `length` squares is made of two sums that only ever grow, so it can neither drift,
/// however long it runs, nor become negative: the squares of this turn of the ring so far, and those of the
/// turn before that are still within reach, added up backwards once a turn.
///
/// ```text
/// ring   | this turn's squares | sums of last turn's squares from here to its end |
///          ───── newest ─────▲   ▲── tail
/// ```
#[derive(Clone, Debug)]
pub struct Envelope {
    ring: Vec<f64>,
    /// Where the next square goes.
    next: usize,
    /// Sum of this turn's squares.
    head: f64,
}

impl Envelope {
    /// An envelope over `length_ms`, rounded to samples.
    ///
    /// # Errors
    /// A length shorter than one sample.
    pub fn new(length_ms: f64, sample_rate_hz: f64) -> Result<Envelope, DesignError> {
        let length = samples_of("envelope_ms", length_ms, 1e-3, sample_rate_hz, DEFAULT_ENVELOPE_MS)?;
        Ok(Envelope { ring: vec![0.0; length], next: 0, head: 0.0 })
    }

    /// Takes the next filtered sample and returns the RMS of the newest ones, in the sample's unit.
    pub fn push(&mut self, sample: f32) -> f32 {
        let square = f64::from(sample) * f64::from(sample);
        self.ring[self.next] = square;
        self.head += square;
        self.next += 1;
        let sum = match self.ring.get(self.next) {
            Some(tail) => self.head + tail,
            None => {
                let whole = self.head;
                self.start_turn();
                whole
            }
        };
        (sum / self.ring.len() as f64).sqrt() as f32
    }

    fn start_turn(&mut self) {
        let mut sum = 0.0;
        for value in self.ring.iter_mut().rev() {
            sum += *value;
            *value = sum;
        }
        self.next = 0;
        self.head = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_artefact_leaves_no_trace_after_its_length() {
        // In a sum that adds and subtracts, 1e12² would swallow the digits of everything else in the window.
        let mut envelope = Envelope::new(25.0, 2000.0).expect("50 samples");
        for _ in 0..77 {
            envelope.push(0.5);
        }
        assert!(envelope.push(1e12) > 1e11);
        for _ in 0..49 {
            assert!(envelope.push(0.5) > 1e11);
        }
        for _ in 0..200 {
            assert_eq!(envelope.push(0.5), 0.5);
        }
    }

    #[test]
    fn one_sample_is_the_absolute_value_and_less_is_refused() {
        let mut envelope = Envelope::new(1.0, 1000.0).expect("one sample");
        assert_eq!([-3.0, 4.0].map(|sample| envelope.push(sample)), [3.0, 4.0]);
        let error = Envelope::new(0.1, 1000.0).expect_err("no sample");
        assert_eq!(
            error.to_string(),
            "envelope_ms = 0.1: give a duration from one sample to a minute, e.g. 25"
        );
    }
}
