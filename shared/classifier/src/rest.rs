//! Whether the rest of a session is as strong as that which its recogniser learnt from.
//!
//! A network that was trained on ADC counts and is shown millivolts takes everything for rest or noise, and nothing else
//! tells: its inputs fit, and so do its outputs.

use std::fmt;

/// Rest that is this many times as strong, or as weak, is of another unit, amplifier or electrode. Between people of 3DC
/// it is half to two and a half times as strong.
const ALIKE: f64 = 10.0;

/// Measures rest and compares it with that of training. Allocates nothing once made.
#[derive(Clone, Debug)]
pub struct RestCheck {
    /// RMS of each channel in training.
    trained_rms: Vec<f64>,
    squares: Vec<f64>,
    /// Measured over training, of each channel.
    ratios: Vec<f64>,
    samples: usize,
}

/// How much stronger or weaker rest is than in training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDifference {
    /// Median over the channels of the RMS measured over that of training.
    pub factor: f64,
}

impl fmt::Display for RestDifference {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (factor, word) =
            if self.factor < 1.0 { (1.0 / self.factor, "weaker") } else { (self.factor, "stronger") };
        if factor.is_finite() { write!(out, "{factor:.0} times {word}") } else { write!(out, "much {word}") }
    }
}

impl RestCheck {
    /// Nothing measured yet; in training, rest had this RMS in each channel.
    pub fn new(trained_rms: &[f64]) -> RestCheck {
        let none = vec![0.0; trained_rms.len()];
        RestCheck { trained_rms: trained_rms.to_vec(), squares: none.clone(), ratios: none, samples: 0 }
    }

    /// Takes a window of rest, channel-major `[channels × samples]`.
    pub fn push(&mut self, window: &[f32]) {
        let samples = window.len() / self.trained_rms.len().max(1);
        for (squares, channel) in self.squares.iter_mut().zip(window.chunks_exact(samples.max(1))) {
            *squares += channel.iter().map(|&sample| f64::from(sample) * f64::from(sample)).sum::<f64>();
        }
        self.samples += samples;
    }

    /// How much stronger or weaker the rest so far is than in training; `None` if it is alike, or none was measured.
    pub fn difference(&mut self) -> Option<RestDifference> {
        if self.samples == 0 {
            return None;
        }
        let measured = self.squares.iter().map(|squares| (squares / self.samples as f64).sqrt());
        for ((ratio, rms), trained) in self.ratios.iter_mut().zip(measured).zip(&self.trained_rms) {
            *ratio = rms / trained;
        }
        self.ratios.sort_unstable_by(f64::total_cmp);
        let factor = self.ratios[self.ratios.len() / 2];
        (!(1.0 / ALIKE..=ALIKE).contains(&factor)).then_some(RestDifference { factor })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Windows of three channels of 10 samples, each constant.
    fn difference(trained: [f64; 3], measured: [f32; 3]) -> Option<RestDifference> {
        let mut check = RestCheck::new(&trained);
        assert_eq!(check.difference(), None, "nothing was measured");
        let window: Vec<f32> = measured.iter().flat_map(|value| [*value; 10]).collect();
        check.push(&window);
        check.push(&window);
        check.difference()
    }

    #[test]
    fn rest_of_another_unit_is_noticed_and_that_of_another_person_is_not() {
        assert_eq!(difference([3.0, 5.0, 4.0], [9.0, 2.0, 8.0]), None);
        // One electrode that is off does not make another unit.
        assert_eq!(difference([3.0, 5.0, 4.0], [3.0, 5.0, 4000.0]), None);
        let weaker = difference([3.0, 5.0, 4.0], [0.003, 0.005, 0.004]).unwrap();
        assert_eq!(weaker.to_string(), "1000 times weaker");
        assert_eq!(
            difference([3.0, 5.0, 4.0], [60.0, 100.0, 80.0]).unwrap().to_string(),
            "20 times stronger"
        );
        assert_eq!(difference([3.0, 5.0, 4.0], [0.0; 3]).unwrap().to_string(), "much weaker");
    }
}
