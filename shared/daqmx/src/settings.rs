//! Settings of an NI device: `[acquisition.nidaqmx]`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Against what a voltage is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Terminal {
    /// As the device has it by default.
    #[default]
    Default,
    /// Between a pair of inputs.
    Differential,
    /// Pseudo-differential.
    PseudoDifferential,
    /// Against the device's ground.
    Referenced,
    /// Against a common input that is not ground.
    NonReferenced,
}

impl Terminal {
    /// The driver's number.
    pub(crate) fn number(self) -> i32 {
        match self {
            Terminal::Default => -1,
            Terminal::Differential => 10106,
            Terminal::PseudoDifferential => 12529,
            Terminal::Referenced => 10083,
            Terminal::NonReferenced => 10078,
        }
    }
}

/// How an NI device is to measure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NidaqmxSettings {
    /// Its analog inputs, as the driver names them, such as `cDAQ1Mod1/ai0:3`.
    pub channels: String,
    /// Against what they are measured.
    pub terminal: Terminal,
    /// Lowest and highest voltage at the inputs, V.
    pub range_v: [f64; 2],
    /// Gain of the amplifier before the device: with 1000, 1 V at an input is 1 mV at the skin.
    pub gain: f64,
    /// How much the driver keeps when the computer is busy, s.
    pub buffer_s: f64,
    /// NI-DAQmx's library; when left out, where the dynamic linker finds it.
    pub library: Option<PathBuf>,
}

impl Default for NidaqmxSettings {
    fn default() -> Self {
        NidaqmxSettings {
            channels: "cDAQ1Mod1/ai0:3".to_owned(),
            terminal: Terminal::Default,
            range_v: [-5.0, 5.0],
            gain: 1000.0,
            buffer_s: 1.0,
            library: None,
        }
    }
}
