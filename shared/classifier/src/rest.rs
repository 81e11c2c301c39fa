//! Whether the rest of a session is as strong as that which its recogniser learnt from.
//!
//! A network that was trained on ADC counts and is shown millivolts takes everything for rest or noise, and nothing else
//! tells: its inputs fit, and so do its outputs.
//!
//! ```text
//! windows ─┬─ RMS of all of them     below a tenth of that of training?  weaker: a movement is never weaker than rest
//!          └─ RMS of the quietest    above ten times that of training?   stronger: not even the quietest is rest
//! ```
//!
//! So nobody has to rest while it is measured, as long as some window is rest.

use std::fmt;

/// Rest that is this many times as strong, or as weak, is of another unit, amplifier or electrode. Between people of 3DC
/// it is half to two and a half times as strong.
const ALIKE: f64 = 10.0;

/// Compares the rest among some windows with that of training. Allocates nothing once made.
#[derive(Clone, Debug)]
pub struct RestCheck {
    /// RMS of each channel in training.
    trained_rms: Vec<f64>,
    /// Sums over all windows, of each channel.
    squares: Vec<f64>,
    /// Measured over training, of each channel.
    ratios: Vec<f64>,
    samples: usize,
    /// Median over the channels of the measured RMS over that of training, in the quietest window.
    quietest: f64,
}

/// How much stronger or weaker rest is than in training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDifference {
    /// Median over the channels of the RMS measured over that of training.
    pub factor: f64,
}

impl RestDifference {
    /// Whether it is stronger, so far: a quieter window may still come.
    pub fn is_stronger(self) -> bool {
        self.factor > 1.0
    }
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
        RestCheck {
            trained_rms: trained_rms.to_vec(),
            squares: none.clone(),
            ratios: none,
            samples: 0,
            quietest: f64::INFINITY,
        }
    }

    /// Takes a window, channel-major `[channels × samples]`.
    pub fn push(&mut self, window: &[f32]) {
        let samples = window.len() / self.trained_rms.len().max(1);
        let channels = window.chunks_exact(samples.max(1)).zip(&self.trained_rms);
        let sums = self.squares.iter_mut().zip(&mut self.ratios);
        for ((channel, trained), (sum, ratio)) in channels.zip(sums) {
            let squares: f64 = channel.iter().map(|&sample| f64::from(sample) * f64::from(sample)).sum();
            *sum += squares;
            *ratio = (squares / samples as f64).sqrt() / trained;
        }
        self.samples += samples;
        self.quietest = self.quietest.min(median(&mut self.ratios));
    }

    /// How much stronger or weaker rest is than in training, as far as the windows so far tell; `None` if it is alike, or
    /// nothing was measured.
    pub fn difference(&mut self) -> Option<RestDifference> {
        if self.samples == 0 {
            return None;
        }
        let measured = self.squares.iter().map(|squares| (squares / self.samples as f64).sqrt());
        for ((ratio, rms), trained) in self.ratios.iter_mut().zip(measured).zip(&self.trained_rms) {
            *ratio = rms / trained;
        }
        let of_all = median(&mut self.ratios);
        let factor = if of_all < 1.0 / ALIKE { of_all } else { self.quietest.max(1.0) };
        (!(1.0 / ALIKE..=ALIKE).contains(&factor)).then_some(RestDifference { factor })
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
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

    #[test]
    fn a_session_that_begins_with_a_movement_has_no_other_unit() {
        let window = |value: f32| vec![value; 30];
        let mut check = RestCheck::new(&[1.0; 3]);
        (0..20).for_each(|_| check.push(&window(25.0)));
        let so_far = check.difference().unwrap();
        assert!(so_far.is_stronger(), "{so_far}");
        check.push(&window(1.2));
        assert_eq!(check.difference(), None, "the first rest says that the unit is the same");
        // Movement among rest of a weaker unit makes it no stronger.
        let mut check = RestCheck::new(&[1.0; 3]);
        (0..20).for_each(|_| check.push(&window(0.001)));
        (0..20).for_each(|_| check.push(&window(0.025)));
        assert!(!check.difference().unwrap().is_stronger());
    }
}
