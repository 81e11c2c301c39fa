//! How wide an instant of a Sessantaquattro is. Its accessory channels differ between units and firmware: 4, 6 or 8.

/// Numbers of accessory channels that were seen.
const ACCESSORIES: [usize; 3] = [4, 6, 8];
/// Over so many instants the last channel must count.
const INSTANTS: usize = 32;

/// No width fits the stream.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no channel of the stream counts the instants, with {emg_channels} EMG channels and 4, 6 or 8 others: does the device \
     send as many channels as the settings say?"
)]
pub struct WidthError {
    /// EMG channels of an instant.
    pub emg_channels: usize,
}

/// Bytes that [`find_accessories`] needs.
pub fn probe_bytes(emg_channels: usize) -> usize {
    2 * (emg_channels + ACCESSORIES[ACCESSORIES.len() - 1]) * INSTANTS
}

/// How many channels of an instant are no EMG, found in the first bytes of a stream, which begin with an instant: the last
/// channel, big-endian, counts up by one. `None` while there are not enough bytes.
///
/// # Errors
///
/// [`WidthError`] when no known number fits.
pub fn find_accessories(emg_channels: usize, bytes: &[u8]) -> Result<Option<usize>, WidthError> {
    if bytes.len() < probe_bytes(emg_channels) {
        return Ok(None);
    }
    let counts_with = |accessories: usize| {
        let width = 2 * (emg_channels + accessories);
        let counter = |instant: usize| {
            let end = (instant + 1) * width;
            u16::from_be_bytes([bytes[end - 2], bytes[end - 1]])
        };
        (1..INSTANTS).all(|instant| counter(instant) == counter(instant - 1).wrapping_add(1))
    };
    let found = ACCESSORIES.into_iter().find(|accessories| counts_with(*accessories));
    found.map(Some).ok_or(WidthError { emg_channels })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(emg_channels: usize, accessories: usize, counter: u16) -> Vec<u8> {
        let mut bytes = Vec::new();
        for instant in 0..40_u16 {
            for channel in 0..emg_channels + accessories - 1 {
                bytes.extend((instant.wrapping_mul(7919) ^ (channel as u16 * 31)).to_be_bytes());
            }
            bytes.extend(counter.wrapping_add(instant).to_be_bytes());
        }
        bytes
    }

    #[test]
    fn every_width_is_found_also_where_the_counter_wraps() {
        for accessories in ACCESSORIES {
            let bytes = stream(64, accessories, 65_530);
            assert_eq!(find_accessories(64, &bytes), Ok(Some(accessories)));
        }
    }

    #[test]
    fn too_few_bytes_wait_and_a_stream_that_does_not_count_is_refused() {
        assert_eq!(find_accessories(64, &[0; 100]), Ok(None));
        assert_eq!(find_accessories(64, &vec![7; 10_000]), Err(WidthError { emg_channels: 64 }));
        assert!(find_accessories(32, &stream(64, 8, 0)).is_err());
    }
}
