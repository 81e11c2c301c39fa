//! Whether a device samples as fast as it says.

use std::error::Error;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use crate::{Decode, read_before};

/// Largest difference between the rate at which samples arrive and the device's own, as a share.
const TOLERANCE: f64 = 0.01;
/// A rate that is still another one after this time is another one. Before, the network may be the reason.
const LONGEST: Duration = Duration::from_secs(6);
/// A device that was started sends its first sample within this time.
const FIRST_SAMPLE: Duration = Duration::from_secs(5);
/// And the next one within this.
const SILENCE: Duration = Duration::from_millis(500);
/// Bytes of a read.
const READ_BYTES: usize = 1 << 16;

/// A device's samples do not come as they should.
#[derive(Debug, thiserror::Error)]
pub enum RateError {
    /// It was started and sends nothing.
    #[error("it is connected but sends no samples")]
    Silent,
    /// It closed the connection.
    #[error("it closed the connection")]
    Closed,
    /// The connection broke.
    #[error("the connection broke")]
    Broken(#[source] std::io::Error),
    /// What it sends is not what it should be.
    #[error("it sends something else than samples")]
    Decode(#[source] Box<dyn Error + Send + Sync>),
    /// Another rate than its own.
    #[error(
        "its samples arrive at {measured_hz:.1} Hz instead of {rate_hz} Hz: does the network lose some, or does the device \
         measure at another rate than it says?"
    )]
    Other {
        /// Measured.
        measured_hz: f64,
        /// Of the device.
        rate_hz: f64,
    },
}

/// Reads samples for `shortest` at least, until they are seen to arrive at `rate_hz`. `channels` are those of an instant.
///
/// # Errors
///
/// [`RateError`] when they do not.
pub fn check_rate(
    stream: &impl AsFd,
    decoder: &mut dyn Decode,
    channels: usize,
    rate_hz: f64,
    shortest: Duration,
) -> Result<(), RateError> {
    let mut buffer = vec![0; READ_BYTES];
    let mut first: Option<(u64, Instant)> = None;
    let mut end_sample = 0;
    let mut silent_at = Instant::now() + FIRST_SAMPLE;
    loop {
        let count = match read_before(stream, &mut buffer, silent_at) {
            Ok(None) => return Err(RateError::Silent),
            Ok(Some(0)) => return Err(RateError::Closed),
            Ok(Some(count)) => count,
            Err(error) => return Err(RateError::Broken(error)),
        };
        let before = end_sample;
        let mut take = |run: crate::Instants<'_>| {
            end_sample = run.first_sample + (run.instants.len() / channels) as u64;
        };
        decoder.push(&buffer[..count], &mut take).map_err(RateError::Decode)?;
        if end_sample == before {
            continue;
        }
        let now = Instant::now();
        silent_at = now + SILENCE;
        let Some((first_sample, began)) = first else {
            first = Some((end_sample, now));
            continue;
        };
        let elapsed = now - began;
        let measured_hz = (end_sample - first_sample) as f64 / elapsed.as_secs_f64();
        if elapsed >= shortest && (measured_hz / rate_hz - 1.0).abs() <= TOLERANCE {
            return Ok(());
        }
        if elapsed > LONGEST {
            return Err(RateError::Other { measured_hz, rate_hz });
        }
    }
}
