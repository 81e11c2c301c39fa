//! Times on a command line.

use std::time::Duration;

use anyhow::{anyhow, ensure};

/// A number of seconds above 0.
///
/// # Errors
///
/// When it is none.
pub fn seconds(text: &str) -> anyhow::Result<f64> {
    let seconds = text.trim().parse().ok().filter(|seconds: &f64| seconds.is_finite() && *seconds > 0.0);
    seconds.ok_or_else(|| anyhow!("give a number of seconds above 0, such as 30"))
}

/// A time to wait or to run, such as `20s`.
///
/// # Errors
///
/// When it is none, or 0.
pub fn duration(text: &str) -> anyhow::Result<Duration> {
    let duration = humantime::parse_duration(text)?;
    ensure!(!duration.is_zero(), "must be longer than 0, such as 20s");
    Ok(duration)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_are_a_finite_number_above_0() {
        assert_eq!(seconds("30").unwrap(), 30.0);
        for text in ["0", "-1", "inf", "NaN", "soon"] {
            assert!(seconds(text).unwrap_err().to_string().contains("above 0"), "{text}");
        }
    }

    #[test]
    fn a_duration_is_longer_than_0() {
        assert_eq!(duration("20s").unwrap(), Duration::from_secs(20));
        assert_eq!(duration("1ns").unwrap(), Duration::from_nanos(1));
        for refused in ["0s", "0ms", "0"] {
            assert!(duration(refused).unwrap_err().to_string().contains("longer than 0"), "{refused}");
        }
        duration("soon").unwrap_err();
    }
}
