//! By which whole numbers one sampling rate is brought to another.
//!
//! ```text
//! 1000 → 2000 Hz        2 / 1      whole rates: exact
//! 1925.926 → 2000 Hz    27 / 26    others: the smallest numbers that come near enough
//! ```

use crate::error::RecordingError;

/// The largest number in a resampling ratio: the low-pass has 20 or 32 times as many taps.
const MAX_RATIO: u64 = 100_000;
/// How far from the true ratio an approximation by smaller numbers may be.
const SMALL_ERROR: f64 = 1e-6;

/// Output and input samples of the ratio, in lowest terms: exact for whole rates, otherwise the smallest numbers of a
/// continued fraction that come within [`SMALL_ERROR`], or the largest within [`MAX_RATIO`].
pub(crate) fn ratio(from_hz: f64, to_hz: f64) -> Result<(u64, u64), RecordingError> {
    if from_hz == to_hz {
        return Ok((1, 1));
    }
    // Beyond this not every whole number is an f64.
    const LARGEST_HZ: f64 = 9e15;
    let is_whole = |hz: f64| hz.fract() == 0.0 && (1.0..LARGEST_HZ).contains(&hz);
    if is_whole(from_hz) && is_whole(to_hz) {
        let (mut divisor, mut rest) = (to_hz as u64, from_hz as u64);
        while rest != 0 {
            (divisor, rest) = (rest, divisor % rest);
        }
        let (up, down) = (to_hz as u64 / divisor, from_hz as u64 / divisor);
        if up.max(down) <= MAX_RATIO {
            return Ok((up, down));
        }
    }
    approximate(to_hz / from_hz).ok_or(RecordingError::Resampling { from_hz, to_hz })
}

/// The first convergent of the continued fraction of `ratio` within [`SMALL_ERROR`] of it, or the last one within
/// [`MAX_RATIO`]; `None` if there is none.
fn approximate(ratio: f64) -> Option<(u64, u64)> {
    if !(ratio.is_finite() && ratio > 0.0) {
        return None;
    }
    let (mut before, mut last) = ((0, 1), (1, 0));
    let mut found = None;
    let mut rest = ratio;
    loop {
        let whole = rest.floor();
        if whole > MAX_RATIO as f64 {
            return found;
        }
        let next = (whole as u64 * last.0 + before.0, whole as u64 * last.1 + before.1);
        if next.0.max(next.1) > MAX_RATIO {
            return found;
        }
        (before, last) = (last, next);
        if last.0 > 0 {
            found = Some(last);
            let error = last.0 as f64 / last.1 as f64 / ratio - 1.0;
            if error.abs() < SMALL_ERROR {
                return found;
            }
        }
        rest = 1.0 / (rest - whole);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    proptest::proptest! {
        #[test]
        fn a_ratio_is_never_far_off(from_hz in 10.0..20_000.0_f64, to_hz in 10.0..20_000.0_f64) {
            let (up, down) = ratio(from_hz, to_hz).unwrap();
            proptest::prop_assert!(up.max(down) <= MAX_RATIO && up.min(down) > 0);
            let error = up as f64 / down as f64 / (to_hz / from_hz) - 1.0;
            proptest::prop_assert!(error.abs() < 1e-5, "{up}/{down}: {error}");
        }
    }
}
