//! Filters that give white noise the spectrum of a profile at the rate of a session.

use std::f64::consts::{PI, TAU};

/// Length of a shaping filter: it resolves about 30 Hz, finer than muscle spectra have detail.
const FILTER_SECONDS: f64 = 0.064;

/// Taps of a shaping filter at a sample rate, a multiple of eight so that they fill vector registers.
pub(crate) fn tap_count(sample_rate_hz: f64) -> usize {
    ((FILTER_SECONDS * sample_rate_hz).ceil() as usize).div_ceil(8) * 8
}

/// Designs a linear-phase filter that turns white noise of variance 1 into noise with the given amplitude
/// density (unit/√Hz) at the given ascending frequencies, by the window method (Oppenheim & Schafer,
/// Discrete-Time Signal Processing, section 7.5). The variance of its output equals the power of the wanted
/// spectrum below half of the sample rate.
pub(crate) fn design(frequencies_hz: &[f64], amplitude_density: &[f64], sample_rate_hz: f64) -> Vec<f32> {
    let taps = tap_count(sample_rate_hz);
    // Four times finer than the filter resolves, so that the sum below stands for the integral.
    let points = 4 * taps;
    let step_hz = sample_rate_hz / 2.0 / points as f64;
    let magnitude: Vec<f64> = (0..points)
        .map(|point| interpolate(frequencies_hz, amplitude_density, (point as f64 + 0.5) * step_hz))
        .collect();
    let middle = (taps as f64 - 1.0) / 2.0;
    let shape: Vec<f64> = (0..taps)
        .map(|tap| {
            let window = (PI * (tap as f64 + 0.5) / taps as f64).sin().powi(2);
            let response: f64 = magnitude
                .iter()
                .enumerate()
                .map(|(point, value)| {
                    let frequency = (point as f64 + 0.5) * step_hz / sample_rate_hz;
                    value * (TAU * frequency * (tap as f64 - middle)).cos()
                })
                .sum();
            window * response
        })
        .collect();
    let wanted_power: f64 = magnitude.iter().map(|value| value * value * step_hz).sum();
    let power: f64 = shape.iter().map(|tap| tap * tap).sum();
    let gain = if power > 0.0 { (wanted_power / power).sqrt() } else { 0.0 };
    shape.iter().map(|tap| (tap * gain) as f32).collect()
}

/// Linear interpolation; zero outside the given frequencies.
fn interpolate(frequencies_hz: &[f64], values: &[f64], at_hz: f64) -> f64 {
    let above = frequencies_hz.partition_point(|frequency| *frequency < at_hz);
    if above == 0 || above == frequencies_hz.len() {
        return 0.0;
    }
    let (low, high) = (frequencies_hz[above - 1], frequencies_hz[above]);
    let share = (at_hz - low) / (high - low);
    values[above - 1] * (1.0 - share) + values[above] * share
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREQUENCIES_HZ: [f64; 4] = [10.0, 60.0, 150.0, 450.0];
    const DENSITY: [f64; 4] = [2.0, 8.0, 5.0, 0.5];

    /// Amplitude density of the filtered noise at one frequency: white noise of variance 1 has 2/rate.
    fn density_of(filter: &[f32], at_hz: f64, sample_rate_hz: f64) -> f64 {
        let angle = TAU * at_hz / sample_rate_hz;
        let (mut real, mut imaginary) = (0.0, 0.0);
        for (tap, value) in filter.iter().enumerate() {
            real += f64::from(*value) * (angle * tap as f64).cos();
            imaginary += f64::from(*value) * (angle * tap as f64).sin();
        }
        (real * real + imaginary * imaginary).sqrt() * (2.0 / sample_rate_hz).sqrt()
    }

    #[test]
    fn the_spectrum_is_the_profiles_at_every_rate() {
        for rate in [1000.0, 2000.0, 4000.0] {
            let filter = design(&FREQUENCIES_HZ, &DENSITY, rate);
            for at_hz in [100.0, 120.0, 250.0, 350.0] {
                let wanted = interpolate(&FREQUENCIES_HZ, &DENSITY, at_hz);
                let got = density_of(&filter, at_hz, rate);
                assert!((got / wanted - 1.0).abs() < 0.05, "{at_hz} Hz at {rate}: {got} for {wanted}");
            }
        }
    }

    #[test]
    fn the_power_is_the_integral_of_the_spectrum() {
        // Trapezoids of the squared density, integrated exactly: (a² + ab + b²) / 3 a segment.
        let wanted: f64 = FREQUENCIES_HZ
            .windows(2)
            .zip(DENSITY.windows(2))
            .map(|(hz, a)| (hz[1] - hz[0]) * (a[0] * a[0] + a[0] * a[1] + a[1] * a[1]) / 3.0)
            .sum();
        for rate in [1000.0, 2000.0, 10_000.0] {
            let filter = design(&FREQUENCIES_HZ, &DENSITY, rate);
            let power: f64 = filter.iter().map(|tap| f64::from(*tap).powi(2)).sum();
            assert!((power / wanted - 1.0).abs() < 0.01, "{power} for {wanted} at {rate} Hz");
        }
    }

    #[test]
    fn silence_stays_silent() {
        assert!(design(&FREQUENCIES_HZ, &[0.0; 4], 2000.0).iter().all(|tap| *tap == 0.0));
    }
}
