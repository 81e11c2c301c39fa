//! Design of the filters as second-order sections, in `f64`, for any sampling rate.
//!
//! The results equal those of SciPy's `iirnotch` and `butter(…, output="sos")`, with sections in the same
//! order, so a model trained on data filtered with SciPy sees the same signal here.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use num_complex::Complex64;

use crate::error::{DesignError, check_sample_rate};

/// The highest order of [`butterworth_band_pass`] and [`butterworth_high_pass`].
pub const MAX_ORDER: usize = 12;

/// A second-order section, `H(z) = (b0 + b1 z⁻¹ + b2 z⁻²) / (1 + a1 z⁻¹ + a2 z⁻²)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// Numerator `b0, b1, b2`.
    pub b: [f64; 3],
    /// Denominator `a1, a2`; `a0` is 1.
    pub a: [f64; 2],
}

impl Section {
    /// Gain for a constant input once the section has settled.
    pub fn gain_at_zero_hz(&self) -> f64 {
        self.b.iter().sum::<f64>() / (1.0 + self.a[0] + self.a[1])
    }
}

/// A notch that removes `frequency_hz` in a band `frequency_hz / quality` wide (at -3 dB).
///
/// # Errors
/// A frequency that is not inside (0, `sample_rate_hz` / 2), or a quality of 0.5 or less.
pub fn notch(frequency_hz: f64, quality: f64, sample_rate_hz: f64) -> Result<Section, DesignError> {
    check_sample_rate(sample_rate_hz)?;
    if !(frequency_hz > 0.0 && frequency_hz < sample_rate_hz / 2.0) {
        return Err(DesignError::NotchFrequency { frequency_hz, sample_rate_hz });
    }
    if !(quality.is_finite() && quality > 0.5) {
        return Err(DesignError::NotchQuality(quality));
    }
    // Orfanidis, Introduction to Signal Processing, eq. 11.3.4 and 11.3.19, as in SciPy.
    let center = 2.0 * PI * frequency_hz / sample_rate_hz;
    let width = center / quality;
    let gain_at_edge = FRAC_1_SQRT_2;
    let beta = (1.0 - gain_at_edge * gain_at_edge).sqrt() / gain_at_edge * (width / 2.0).tan();
    let gain = 1.0 / (1.0 + beta);
    let middle = -2.0 * gain * center.cos();
    Ok(Section { b: [gain, middle, gain], a: [middle, 2.0 * gain - 1.0] })
}

/// A Butterworth band-pass of `order` in SciPy's sense: `order` sections, `6 × order` dB per octave at each
/// edge.
///
/// # Errors
/// Edges that are not `0 < low_hz < high_hz < sample_rate_hz / 2`, or an order outside 1 to [`MAX_ORDER`].
pub fn butterworth_band_pass(
    order: usize,
    low_hz: f64,
    high_hz: f64,
    sample_rate_hz: f64,
) -> Result<Vec<Section>, DesignError> {
    check_sample_rate(sample_rate_hz)?;
    if !(low_hz > 0.0 && low_hz < high_hz && high_hz < sample_rate_hz / 2.0) {
        return Err(DesignError::BandEdges { low_hz, high_hz, sample_rate_hz });
    }
    let prototype = low_pass_prototype(order)?;
    let (low, high) = (warped(low_hz, sample_rate_hz), warped(high_hz, sample_rate_hz));
    let (bandwidth, center_squared) = (high - low, low * high);
    let poles: Vec<Complex64> = prototype
        .iter()
        .flat_map(|pole| {
            let half = pole * (bandwidth / 2.0);
            let root = (half * half - center_squared).sqrt();
            [half + root, half - root]
        })
        .collect();
    // Of the analog zeros, `order` lie at 0 and `order` at infinity.
    Ok(digital_sections(order, order, &poles, bandwidth.powi(order as i32)))
}

/// A Butterworth high-pass of `order`: `order / 2` sections, rounded up.
///
/// # Errors
/// An edge that is not inside (0, `sample_rate_hz` / 2), or an order outside 1 to [`MAX_ORDER`].
pub fn butterworth_high_pass(
    order: usize,
    low_hz: f64,
    sample_rate_hz: f64,
) -> Result<Vec<Section>, DesignError> {
    check_sample_rate(sample_rate_hz)?;
    if !(low_hz > 0.0 && low_hz < sample_rate_hz / 2.0) {
        return Err(DesignError::BandEdges { low_hz, high_hz: f64::INFINITY, sample_rate_hz });
    }
    let edge = warped(low_hz, sample_rate_hz);
    let poles: Vec<Complex64> = low_pass_prototype(order)?.iter().map(|pole| edge / pole).collect();
    Ok(digital_sections(order, 0, &poles, 1.0))
}

/// The left half of the unit circle's 2·`order` evenly spaced poles: the analog low-pass with its edge at 1.
fn low_pass_prototype(order: usize) -> Result<Vec<Complex64>, DesignError> {
    if !(1..=MAX_ORDER).contains(&order) {
        return Err(DesignError::BandOrder(order));
    }
    let order = order as i32;
    Ok((1 - order..order)
        .step_by(2)
        .map(|m| -Complex64::from_polar(1.0, PI * f64::from(m) / f64::from(2 * order)))
        .collect())
}

/// The bilinear transform's `2 × rate`, for a rate of 2 as in SciPy.
const BILINEAR: f64 = 4.0;

/// The analog frequency that the bilinear transform maps to `frequency_hz`.
fn warped(frequency_hz: f64, sample_rate_hz: f64) -> f64 {
    BILINEAR * (PI * frequency_hz / sample_rate_hz).tan()
}

/// The bilinear transform of an analog filter that has `zeros_at_zero` zeros at 0 and as many poles as
/// zeros once `zeros_at_infinity` are counted, as sections in SciPy's order.
fn digital_sections(
    zeros_at_zero: usize,
    zeros_at_infinity: usize,
    analog_poles: &[Complex64],
    analog_gain: f64,
) -> Vec<Section> {
    let denominator: Complex64 = analog_poles.iter().map(|pole| BILINEAR - pole).product();
    let gain = analog_gain * (BILINEAR.powi(zeros_at_zero as i32) / denominator).re;
    let mut zeros = vec![1.0; zeros_at_zero];
    zeros.extend(vec![-1.0; zeros_at_infinity]);
    let poles = analog_poles.iter().map(|pole| (BILINEAR + pole) / (BILINEAR - pole)).collect();
    paired_sections(zeros, poles, gain)
}

/// Pairs poles with zeros like SciPy's `zpk2sos(pairing="nearest")`: from the last section to the first, the
/// pole nearest to the unit circle takes its conjugate and the two zeros nearest to it. The gain is in the
/// first section. All zeros are real here.
fn paired_sections(mut zeros: Vec<f64>, mut poles: Vec<Complex64>, gain: f64) -> Vec<Section> {
    if poles.len() % 2 == 1 {
        zeros.push(0.0);
        poles.push(Complex64::ZERO);
    }
    // One of each conjugate pair, and the real ones.
    let is_real = |pole: &Complex64| pole.im.abs() <= 100.0 * f64::EPSILON * pole.norm();
    let mut reals: Vec<f64> = poles.iter().filter(|pole| is_real(pole)).map(|pole| pole.re).collect();
    poles.retain(|pole| !is_real(pole) && pole.im > 0.0);

    let from_circle = |pole: Complex64| (1.0 - pole.norm()).abs();
    let mut sections = Vec::new();
    loop {
        let complex = position_of_least(&poles, |&pole| from_circle(pole));
        let real = position_of_least(&reals, |&pole| from_circle(pole.into()));
        let (first, second) = match (complex, real) {
            (None, None) => break,
            (Some(at), Some(other)) if from_circle(poles[at]) > from_circle(reals[other].into()) => {
                take_two_reals(&mut reals, other)
            }
            (Some(at), _) => {
                let pole = poles.remove(at);
                (pole, pole.conj())
            }
            (None, Some(at)) => take_two_reals(&mut reals, at),
        };
        let mut nearest_zero =
            || position_of_least(&zeros, |&zero| (first - zero).norm()).map_or(0.0, |at| zeros.remove(at));
        let (zero, other_zero) = (nearest_zero(), nearest_zero());
        sections.push(Section {
            b: [1.0, -(zero + other_zero), zero * other_zero],
            a: [-(first + second).re, (first * second).re],
        });
    }
    sections.reverse();
    for coefficient in &mut sections[0].b {
        *coefficient *= gain;
    }
    sections
}

/// Removes the real pole at `at` and, of the others, the one nearest to the unit circle. The number of real
/// poles is even: the total is even, and complex poles come in pairs.
fn take_two_reals(reals: &mut Vec<f64>, at: usize) -> (Complex64, Complex64) {
    let first = reals.remove(at);
    let second = position_of_least(reals, |pole| (1.0 - pole.abs()).abs()).map_or(0.0, |at| reals.remove(at));
    (first.into(), second.into())
}

fn position_of_least<T>(items: &[T], key: impl Fn(&T) -> f64) -> Option<usize> {
    (0..items.len()).min_by(|&a, &b| key(&items[a]).total_cmp(&key(&items[b])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_designed_is_refused_with_what_to_do() {
        let remedy = |error: DesignError| error.to_string();
        assert!(remedy(notch(60.0, 30.0, 0.0).expect_err("no rate")).starts_with("sample_rate_hz = 0"));
        assert!(
            remedy(notch(60.0, 30.0, 100.0).expect_err("aliased")).starts_with("notch_hz = 60 at 100 Hz")
        );
        assert!(remedy(notch(60.0, 0.0, 2000.0).expect_err("no quality")).starts_with("notch_quality = 0"));
        for (low_hz, high_hz) in [(0.0, 500.0), (500.0, 5.0), (5.0, 1000.0), (f64::NAN, 500.0)] {
            let error = butterworth_band_pass(6, low_hz, high_hz, 2000.0).expect_err("no band");
            assert!(remedy(error).starts_with("band_pass_hz = ["));
        }
        assert_eq!(butterworth_high_pass(13, 5.0, 2000.0), Err(DesignError::BandOrder(13)));
        assert_eq!(butterworth_band_pass(0, 5.0, 500.0, 2000.0), Err(DesignError::BandOrder(0)));
    }
}
