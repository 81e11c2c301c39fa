//! Filters that give white noise the spectra and coherencies of a profile, at the rate of a session.

use std::f64::consts::{PI, TAU};

use tendon_spectrum::Complex;

use crate::profile::{GestureProfile, Matrix, cholesky};

/// Length of a shaping filter: it resolves about 30 Hz, finer than muscle spectra have detail.
const FILTER_SECONDS: f64 = 0.064;

/// The number of taps is a multiple of this, to fill vector registers.
pub(crate) const TAPS_MULTIPLE: usize = 32;

/// Taps of a shaping filter at a sample rate.
pub(crate) fn tap_count(sample_rate_hz: f64) -> usize {
    ((FILTER_SECONDS * sample_rate_hz).ceil() as usize).next_multiple_of(TAPS_MULTIPLE)
}

/// Designs the filters that turn independent white noises of variance 1, one per channel of the profile, into
/// the channels of a gesture. Channel `i` is the sum over `j <= i` of noise `j` through filter
/// `filter_index(i, j)`; the filters are stored one after the other, `[filters][taps]`, each with its last
/// tap first, to match a history with the newest sample last.
///
/// At each frequency the channels' cross-spectral matrix `S` is factored as `S = L · Lᴴ` (Cholesky); `L` is
/// transformed to the time domain by the window method (Oppenheim & Schafer, Discrete-Time Signal Processing,
/// section 7.5). The variance of each channel equals the power of its spectrum below half of the sample rate.
pub(crate) fn design(frequencies_hz: &[f64], profile: &GestureProfile, sample_rate_hz: f64) -> Vec<f32> {
    let channels = profile.amplitude_density.len();
    let taps = tap_count(sample_rate_hz);
    // Four times finer than the filter resolves, so that the sum below stands for the integral.
    let points = 4 * taps;
    let step_hz = sample_rate_hz / 2.0 / points as f64;
    let middle = (taps as f64 - 1.0) / 2.0;
    let coherency: Vec<Matrix> =
        (0..frequencies_hz.len()).map(|index| profile.coherency_matrix(index)).collect();
    let mut wanted_power = vec![0.0; channels];
    let mut filters = vec![0.0; filter_index(channels, 0) * taps];
    for point in 0..points {
        let at_hz = (point as f64 + 0.5) * step_hz;
        let Some((below, share)) = between(frequencies_hz, at_hz) else { continue };
        let mix = |low: f64, high: f64| low * (1.0 - share) + high * share;
        let factor = factor_between(&coherency[below], &coherency[below + 1], share);
        for row in 0..channels {
            let density = &profile.amplitude_density[row];
            let magnitude = mix(density[below], density[below + 1]);
            wanted_power[row] += magnitude * magnitude * step_hz;
            for column in 0..=row {
                let filter = &mut filters[filter_index(row, column) * taps..][..taps];
                let response = factor[row][column] * magnitude;
                // The tap at time t is the sum of Re(L · exp(i 2π f t)), a rotation by one step a tap.
                let turn = TAU * at_hz / sample_rate_hz;
                let step = Complex::cis(-turn);
                let mut rotated = response * Complex::cis(turn * (taps as f64 - 1.0 - middle));
                for tap in filter {
                    *tap += rotated.re;
                    rotated *= step;
                }
            }
        }
    }
    for (row, wanted_power) in wanted_power.into_iter().enumerate() {
        let of_row = &mut filters[filter_index(row, 0) * taps..filter_index(row + 1, 0) * taps];
        for filter in of_row.chunks_exact_mut(taps) {
            for (tap, value) in filter.iter_mut().enumerate() {
                *value *= (PI * (tap as f64 + 0.5) / taps as f64).sin().powi(2);
            }
        }
        let power: f64 = of_row.iter().map(|tap| tap * tap).sum();
        let gain = if power > 0.0 { (wanted_power / power).sqrt() } else { 0.0 };
        of_row.iter_mut().for_each(|tap| *tap *= gain);
    }
    filters.into_iter().map(|tap| tap as f32).collect()
}

/// Index of the filter from noise `column` to channel `row`, `column <= row`.
pub(crate) fn filter_index(row: usize, column: usize) -> usize {
    row * (row + 1) / 2 + column
}

/// The Cholesky factor of a matrix on the straight line between two checked coherency matrices.
fn factor_between(low: &Matrix, high: &Matrix, share: f64) -> Matrix {
    let mixed: Matrix = low
        .iter()
        .zip(high)
        .map(|(low, high)| {
            low.iter().zip(high).map(|(low, high)| low * (1.0 - share) + high * share).collect()
        })
        .collect();
    cholesky(&mixed).expect("between two positive definite matrices all are positive definite")
}

/// Index of the frequency below `at_hz` and the fraction of the distance to the next; `None` outside the
/// frequencies.
fn between(frequencies_hz: &[f64], at_hz: f64) -> Option<(usize, f64)> {
    let above = frequencies_hz.partition_point(|frequency| *frequency < at_hz);
    let below = above.checked_sub(1)?;
    let (low, high) = (frequencies_hz[below], *frequencies_hz.get(above)?);
    Some((below, (at_hz - low) / (high - low)))
}

#[cfg(test)]
mod tests {
    use tendon_gesture::Gesture;

    use super::*;
    use crate::profile::Coherency;

    const FREQUENCIES_HZ: [f64; 4] = [10.0, 60.0, 150.0, 450.0];

    /// Two channels; the second is the first but for its scale, an independent part, and a delay.
    fn two_channels() -> GestureProfile {
        let coherency = Coherency { channels: [0, 1], real: vec![0.6; 4], imaginary: vec![0.5; 4] };
        GestureProfile {
            gesture: Gesture::GRIP,
            amplitude_density: vec![vec![2.0, 8.0, 5.0, 0.5], vec![1.0, 4.0, 2.5, 0.25]],
            coherency: vec![coherency],
        }
    }

    /// Response of one filter to a frequency; white noise of variance 1 has an amplitude density of √(2/rate).
    fn response(filters: &[f32], index: usize, at_hz: f64, sample_rate_hz: f64) -> Complex<f64> {
        let taps = tap_count(sample_rate_hz);
        let filter = filters[index * taps..][..taps].iter().rev();
        let turn = TAU * at_hz / sample_rate_hz;
        let sum: Complex<f64> =
            filter.enumerate().map(|(tap, value)| Complex::cis(-turn * tap as f64) * f64::from(*value)).sum();
        sum * (2.0 / sample_rate_hz).sqrt()
    }

    #[test]
    fn spectra_and_coherency_are_the_profiles_at_every_rate() {
        let profile = two_channels();
        for rate in [1000.0, 2000.0, 4000.0] {
            let filters = design(&FREQUENCIES_HZ, &profile, rate);
            for at_hz in [100.0, 120.0, 250.0, 350.0] {
                let (below, share) = between(&FREQUENCIES_HZ, at_hz).unwrap();
                let wanted = profile.amplitude_density[0][below] * (1.0 - share)
                    + profile.amplitude_density[0][below + 1] * share;
                let first = response(&filters, 0, at_hz, rate);
                let second = [1, 2].map(|index| response(&filters, index, at_hz, rate));
                let second_density = second.iter().map(|value| value.norm_sqr()).sum::<f64>().sqrt();
                assert!((first.norm() / wanted - 1.0).abs() < 0.05, "{at_hz} Hz at {rate}");
                assert!((second_density / wanted * 2.0 - 1.0).abs() < 0.05, "{at_hz} Hz at {rate}");
                let coherency = first * second[0].conj() / (first.norm() * second_density);
                assert!(
                    (coherency - Complex::new(0.6, 0.5)).norm() < 0.02,
                    "{coherency} at {at_hz} Hz, {rate}"
                );
            }
        }
    }

    #[test]
    fn the_power_is_the_integral_of_the_spectrum() {
        // Between frequencies the density is straight, so each piece of its square is (a² + ab + b²) / 3.
        let profile = two_channels();
        let density = &profile.amplitude_density[1];
        let wanted: f64 = FREQUENCIES_HZ
            .windows(2)
            .zip(density.windows(2))
            .map(|(hz, a)| (hz[1] - hz[0]) * (a[0] * a[0] + a[0] * a[1] + a[1] * a[1]) / 3.0)
            .sum();
        for rate in [1000.0, 2000.0, 10_000.0] {
            let filters = design(&FREQUENCIES_HZ, &profile, rate);
            let power: f64 = filters[tap_count(rate)..].iter().map(|tap| f64::from(*tap).powi(2)).sum();
            assert!((power / wanted - 1.0).abs() < 0.01, "{power} for {wanted} at {rate} Hz");
        }
    }

    #[test]
    fn silence_stays_silent() {
        let mut profile = two_channels();
        profile.amplitude_density = vec![vec![0.0; 4]; 2];
        assert!(design(&FREQUENCIES_HZ, &profile, 2000.0).iter().all(|tap| *tap == 0.0));
    }
}
