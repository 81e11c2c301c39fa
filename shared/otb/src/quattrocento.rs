//! Settings of the Quattrocento.
//!
//! ```text
//! byte 0   1 | DECIM 6 | REC_ON 5 | rate 4..3 | channels 2..1 | GO 0      bytes 1, 2   analog output
//! then     12 inputs: muscle, sensor and adapter, side 7..6 | high-pass 5..4 | low-pass 3..2 | mode 1..0      last   CRC-8
//! ```

use crate::crc::crc8;
use crate::{ByteOrder, Layout};

/// Rates that it has, Hz, by code.
const RATES_HZ: [u32; 4] = [512, 2048, 5120, 10240];
/// EMG channels that it sends, by code; with each go 16 auxiliary inputs and 8 accessory channels.
const EMG_CHANNELS: [usize; 4] = [96, 192, 288, 384];
const AUXILIARY: usize = 16;
const ACCESSORIES: usize = 8;
/// Value of a count: 5 V over 16 bits, at gain 150, mV.
const MV_PER_COUNT: f64 = 5.0 / 65536.0 / 150.0 * 1e3;
/// Length of the control word.
const WORD_BYTES: usize = 40;
/// Of every input: high-pass at 10 Hz, low-pass at 500 Hz, monopolar.
const INPUT: [u8; 3] = [0, 0, 0b0001_0100];
const INPUTS: usize = 12;

/// How a Quattrocento is to measure: monopolar, 10 to 500 Hz on all inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quattrocento {
    rate_code: u8,
    channels_code: u8,
}

/// It has no such setting.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum QuattrocentoError {
    /// It does not sample so fast.
    #[error("a Quattrocento has no rate of {rate_hz} Hz: take 512, 2048, 5120 or 10240")]
    Rate {
        /// What was asked for.
        rate_hz: f64,
    },
    /// It sends no such number of channels.
    #[error("a Quattrocento does not send {inputs} inputs: take 96, 192, 288 or 384")]
    Inputs {
        /// What was asked for.
        inputs: usize,
    },
}

impl Quattrocento {
    /// At this rate, with so many EMG channels.
    ///
    /// # Errors
    ///
    /// When it has no such rate or number.
    pub fn new(rate_hz: f64, inputs: usize) -> Result<Quattrocento, QuattrocentoError> {
        let rate_code = RATES_HZ.iter().position(|known| f64::from(*known) == rate_hz);
        let channels_code = EMG_CHANNELS.iter().position(|known| *known == inputs);
        Ok(Quattrocento {
            rate_code: rate_code.ok_or(QuattrocentoError::Rate { rate_hz })? as u8,
            channels_code: channels_code.ok_or(QuattrocentoError::Inputs { inputs })? as u8,
        })
    }

    pub(crate) fn layout(&self) -> Layout {
        let emg_channels = EMG_CHANNELS[usize::from(self.channels_code)];
        let channels = emg_channels + AUXILIARY + ACCESSORIES;
        Layout {
            rate_hz: f64::from(RATES_HZ[usize::from(self.rate_code)]),
            channels,
            emg_channels,
            counter_channel: channels - ACCESSORIES,
            byte_order: ByteOrder::Little,
            mv_per_count: MV_PER_COUNT,
        }
    }

    /// The control word, with its checksum.
    pub(crate) fn word(&self, go: bool) -> [u8; WORD_BYTES] {
        let mut word = [0; WORD_BYTES];
        word[0] = 0x80 | self.rate_code << 3 | self.channels_code << 1 | u8::from(go);
        for input in 0..INPUTS {
            word[3 + input * INPUT.len()..][..INPUT.len()].copy_from_slice(&INPUT);
        }
        word[WORD_BYTES - 1] = crc8(&word[..WORD_BYTES - 1]);
        word
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_words_and_their_checksums_are_those_of_the_vendors_client() {
        let word = |inputs, go| {
            let word = Quattrocento::new(2048.0, inputs).unwrap().word(go);
            (word[0], word[WORD_BYTES - 1])
        };
        assert_eq!(word(384, true), (0x8F, 0x57));
        assert_eq!(word(384, false), (0x8E, 0x1E));
        assert_eq!(word(192, true), (0x8B, 0x6A));
        assert_eq!(word(96, true), (0x89, 0xF8));
    }

    #[test]
    fn an_instant_holds_auxiliary_and_accessory_channels_behind_the_emg() {
        let layout = Quattrocento::new(2048.0, 384).unwrap().layout();
        assert_eq!((layout.channels, layout.counter_channel, layout.rate_hz), (408, 400, 2048.0));
        assert!((layout.mv_per_count - 5.0863e-4).abs() < 1e-8);
        assert!(Quattrocento::new(2000.0, 384).is_err());
    }
}
