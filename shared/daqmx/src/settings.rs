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

/// A setting that no device can take.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} = {value}: {remedy}")]
pub struct InvalidNidaqmxSetting {
    /// The key.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// What can be done.
    pub remedy: &'static str,
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

impl NidaqmxSettings {
    /// Refuses what no device can take.
    ///
    /// # Errors
    ///
    /// [`InvalidNidaqmxSetting`] with the key and what to do.
    pub fn check(&self) -> Result<(), InvalidNidaqmxSetting> {
        let refuse = |key, value: String, remedy| Err(InvalidNidaqmxSetting { key, value, remedy });
        if self.channels.trim().is_empty() || self.channels.contains('\0') {
            let remedy = "name the analog inputs as the driver does, such as cDAQ1Mod1/ai0:3";
            return refuse("channels", format!("{:?}", self.channels), remedy);
        }
        let [lowest, highest] = self.range_v;
        if !(lowest.is_finite() && highest.is_finite() && lowest < highest) {
            let remedy = "take the lowest and the highest voltage, such as [-5.0, 5.0]";
            return refuse("range_v", format!("{:?}", self.range_v), remedy);
        }
        if !(self.gain.is_finite() && self.gain > 0.0) {
            let remedy = "take the gain of the amplifier before the device, such as 1000; 1 for none";
            return refuse("gain", self.gain.to_string(), remedy);
        }
        if !(0.1..=60.0).contains(&self.buffer_s) {
            return refuse("buffer_s", self.buffer_s.to_string(), "take 0.1 to 60 s");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_no_device_takes_are_refused_by_key() {
        assert_eq!(NidaqmxSettings::default().check(), Ok(()));
        let refused = |change: fn(&mut NidaqmxSettings)| {
            let mut settings = NidaqmxSettings::default();
            change(&mut settings);
            settings.check().unwrap_err().key
        };
        assert_eq!(refused(|settings| settings.channels = " ".to_owned()), "channels");
        assert_eq!(refused(|settings| settings.range_v = [1.0, f64::NAN]), "range_v");
        assert_eq!(refused(|settings| settings.range_v = [1.0, 1.0]), "range_v");
        assert_eq!(refused(|settings| settings.gain = 0.0), "gain");
        assert_eq!(refused(|settings| settings.buffer_s = f64::INFINITY), "buffer_s");
    }
}
