//! The Fourier transform of real signals.
//!
//! RustFFT is generic, so whichever crate first plans a transform compiles the whole library: about half a minute.
//! This crate does that once. Crates that change more often call it and stay quick to build.
#![forbid(unsafe_code)]

use std::sync::Arc;

pub use realfft::RealToComplex;
pub use realfft::num_complex::Complex;

/// Plans the transform of `length` real samples into `length / 2 + 1` complex bins, without scaling.
pub fn plan_real_fft(length: usize) -> Arc<dyn RealToComplex<f64>> {
    realfft::RealFftPlanner::new().plan_fft_forward(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cosine_is_one_line() {
        let length = 16;
        let fft = plan_real_fft(length);
        let turn = 2.0 * std::f64::consts::PI * 3.0 / length as f64;
        let mut input: Vec<f64> = (0..length).map(|sample| (turn * sample as f64).cos()).collect();
        let mut bins = fft.make_output_vec();
        fft.process(&mut input, &mut bins).unwrap();
        for (index, bin) in bins.iter().enumerate() {
            let expected = if index == 3 { length as f64 / 2.0 } else { 0.0 };
            assert!((bin - Complex::new(expected, 0.0)).norm() < 1e-12, "bin {index}: {bin}");
        }
    }
}
