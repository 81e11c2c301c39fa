//! Settings of the Sessantaquattro+.
//!
//! ```text
//! byte 0   GET 7 | FSAMP 6..5 | NCH 4..3 | MODE 2..0        byte 1   HRES 7 | HPF 6 | GAIN 5..4 | TRIG 3..2 | REC 1 | GO 0
//! ```

use serde::{Deserialize, Serialize};

use crate::amplifier::PROBE_MV_PER_COUNT;

/// Rates that it has, Hz, by code.
const RATES_HZ: [u32; 4] = [500, 1000, 2000, 4000];
/// Channels that it has, by code.
const CHANNELS: [usize; 4] = [8, 16, 32, 64];
/// Bit of the high-pass filter, at 1/190 of the rate.
const HIGH_PASS: u8 = 1 << 6;

/// Against what a channel is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Against the reference electrode.
    #[default]
    Monopolar,
    /// Pairs of electrodes, which halves the channels.
    Bipolar,
}

/// Gain of the input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum Gain {
    /// 4.
    Four,
    /// 6.
    Six,
    /// 8.
    #[default]
    Eight,
}

/// It has no such gain.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("a Sessantaquattro+ has no gain of {gain}: take 4, 6 or 8")]
pub struct GainError {
    /// What was asked for.
    gain: u8,
}

impl TryFrom<u8> for Gain {
    type Error = GainError;

    fn try_from(gain: u8) -> Result<Gain, GainError> {
        match gain {
            4 => Ok(Gain::Four),
            6 => Ok(Gain::Six),
            8 => Ok(Gain::Eight),
            gain => Err(GainError { gain }),
        }
    }
}

impl From<Gain> for u8 {
    fn from(gain: Gain) -> u8 {
        match gain {
            Gain::Four => 4,
            Gain::Six => 6,
            Gain::Eight => 8,
        }
    }
}

impl Gain {
    fn code(self) -> u8 {
        match self {
            Gain::Eight => 0,
            Gain::Four => 1,
            Gain::Six => 2,
        }
    }

    /// Value of a count, mV.
    pub fn mv_per_count(self) -> f64 {
        PROBE_MV_PER_COUNT * 8.0 / f64::from(u8::from(self))
    }
}

/// How a Sessantaquattro+ is to measure: 16 bits, high-pass on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sessantaquattro {
    rate_code: u8,
    channels_code: u8,
    mode: Mode,
    gain: Gain,
}

/// It has no such setting.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessantaquattroError {
    /// It does not sample so fast.
    #[error("a Sessantaquattro+ has no rate of {rate_hz} Hz: take 500, 1000, 2000 or 4000")]
    Rate {
        /// What was asked for.
        rate_hz: f64,
    },
    /// It has no such number of inputs.
    #[error("a Sessantaquattro+ has no {inputs} inputs: take 8, 16, 32 or 64")]
    Inputs {
        /// What was asked for.
        inputs: usize,
    },
}

impl Sessantaquattro {
    /// At this rate, with so many inputs.
    ///
    /// # Errors
    ///
    /// When it has no such rate or number.
    pub fn new(
        rate_hz: f64,
        inputs: usize,
        mode: Mode,
        gain: Gain,
    ) -> Result<Sessantaquattro, SessantaquattroError> {
        let rate_code = RATES_HZ.iter().position(|known| f64::from(*known) == rate_hz);
        let channels_code = CHANNELS.iter().position(|known| *known == inputs);
        Ok(Sessantaquattro {
            rate_code: rate_code.ok_or(SessantaquattroError::Rate { rate_hz })? as u8,
            channels_code: channels_code.ok_or(SessantaquattroError::Inputs { inputs })? as u8,
            mode,
            gain,
        })
    }

    /// Its rate, Hz.
    pub fn rate_hz(&self) -> f64 {
        f64::from(RATES_HZ[usize::from(self.rate_code)])
    }

    /// EMG channels that it sends.
    pub fn emg_channels(&self) -> usize {
        let inputs = CHANNELS[usize::from(self.channels_code)];
        match self.mode {
            Mode::Monopolar => inputs,
            Mode::Bipolar => inputs / 2,
        }
    }

    /// Its gain.
    pub fn gain(&self) -> Gain {
        self.gain
    }

    /// The control word.
    pub(crate) fn word(&self, go: bool) -> [u8; 2] {
        let mode = match self.mode {
            Mode::Monopolar => 0,
            Mode::Bipolar => 1,
        };
        [
            self.rate_code << 5 | self.channels_code << 3 | mode,
            HIGH_PASS | self.gain.code() << 4 | u8::from(go),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_control_word_is_that_of_the_vendors_client() {
        let settings = Sessantaquattro::new(2000.0, 64, Mode::Monopolar, Gain::Eight).unwrap();
        assert_eq!(settings.word(true), [0x58, 0x41]);
        assert_eq!(settings.word(false), [0x58, 0x40]);
        assert_eq!(settings.emg_channels(), 64);
        let bipolar = Sessantaquattro::new(1000.0, 32, Mode::Bipolar, Gain::Four).unwrap();
        assert_eq!(bipolar.word(true), [0b0011_0001, 0b0101_0001]);
        assert_eq!((bipolar.emg_channels(), bipolar.rate_hz()), (16, 1000.0));
    }

    #[test]
    fn a_count_is_worth_what_the_sheets_say() {
        let nv = |gain: Gain| gain.mv_per_count() * 1e6;
        for (gain, sheet_nv) in [(Gain::Eight, 286.1), (Gain::Four, 572.2), (Gain::Six, 381.5)] {
            assert!((nv(gain) - sheet_nv).abs() < 0.05, "{gain:?}: {}", nv(gain));
        }
    }

    #[test]
    fn gains_are_numbers_in_the_settings_and_others_are_refused() {
        for gain in [Gain::Four, Gain::Six, Gain::Eight] {
            assert_eq!(Gain::try_from(u8::from(gain)), Ok(gain));
        }
        assert!(Gain::try_from(5).unwrap_err().to_string().contains("4, 6 or 8"));
    }

    #[test]
    fn rates_and_inputs_that_it_does_not_have_are_refused() {
        assert!(Sessantaquattro::new(2048.0, 64, Mode::Monopolar, Gain::Eight).is_err());
        assert!(Sessantaquattro::new(2000.0, 4, Mode::Monopolar, Gain::Eight).is_err());
    }
}
