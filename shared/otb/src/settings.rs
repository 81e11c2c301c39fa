//! Settings of the amplifier, as `[acquisition.otb]` in a configuration holds them.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

use crate::{
    Amplifier, Dialling, Gain, Mode, Quattrocento, QuattrocentoError, Sessantaquattro, SessantaquattroError,
};

/// Which amplifier it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// Muovi.
    #[default]
    Muovi,
    /// Muovi+.
    MuoviPlus,
    /// Sessantaquattro or Sessantaquattro+.
    Sessantaquattro,
    /// Quattrocento.
    Quattrocento,
}

/// An amplifier of OT Bioelettronica, how it measures, and where it is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OtbSettings {
    /// Which amplifier. Default: Muovi.
    pub device: Device,
    /// Where this computer waits for the amplifier to dial in; of a Quattrocento, its own address. Default: the vendor's
    /// port on all network interfaces, and the address that a Quattrocento comes with.
    pub address: Option<SocketAddr>,
    /// Inputs of a Sessantaquattro (8, 16, 32 or 64) or Quattrocento (96, 192, 288 or 384). Default: all.
    pub inputs: Option<usize>,
    /// Of a Sessantaquattro, against what each channel is measured. Default: monopolar.
    pub mode: Mode,
    /// Gain of a Sessantaquattro. Default: 8.
    pub gain: Gain,
}

/// The amplifier has no such setting.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OtbSettingsError {
    /// Of a Sessantaquattro.
    #[error(transparent)]
    Sessantaquattro(#[from] SessantaquattroError),
    /// Of a Quattrocento.
    #[error(transparent)]
    Quattrocento(#[from] QuattrocentoError),
}

impl OtbSettings {
    /// The amplifier, told to sample at `rate_hz`; a Muovi has one rate.
    ///
    /// # Errors
    ///
    /// When it has no such rate or number of inputs.
    pub fn amplifier(&self, rate_hz: f64) -> Result<Amplifier, OtbSettingsError> {
        Ok(match self.device {
            Device::Muovi => Amplifier::Muovi,
            Device::MuoviPlus => Amplifier::MuoviPlus,
            Device::Sessantaquattro => {
                let inputs = self.inputs.unwrap_or(64);
                Amplifier::Sessantaquattro(Sessantaquattro::new(rate_hz, inputs, self.mode, self.gain)?)
            }
            Device::Quattrocento => {
                let inputs = self.inputs.unwrap_or(384);
                Amplifier::Quattrocento(Quattrocento::new(rate_hz, inputs)?)
            }
        })
    }

    /// Where to wait for the amplifier, or where it is: the address of these settings, otherwise the vendor's.
    pub fn address_of(&self, amplifier: &Amplifier) -> SocketAddr {
        self.address.unwrap_or_else(|| match amplifier.dialling() {
            Dialling::Device { port } => SocketAddr::from(([0, 0, 0, 0], port)),
            Dialling::Computer { address } => address,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_amplifier_is_told_what_the_settings_say() {
        let of = |device, inputs| OtbSettings { device, inputs, ..OtbSettings::default() };
        let channels = |settings: OtbSettings, rate_hz| {
            settings.amplifier(rate_hz).map(|amplifier| amplifier.layout(8).emg_channels)
        };
        assert_eq!(channels(of(Device::Muovi, None), 2000.0), Ok(32));
        assert_eq!(channels(of(Device::MuoviPlus, None), 2000.0), Ok(64));
        assert_eq!(channels(of(Device::Sessantaquattro, Some(16)), 1000.0), Ok(16));
        assert_eq!(channels(of(Device::Quattrocento, None), 2048.0), Ok(384));
        let refused = channels(of(Device::Quattrocento, None), 2000.0).unwrap_err().to_string();
        assert!(refused.contains("512, 2048, 5120 or 10240"), "{refused}");
    }

    #[test]
    fn without_an_address_the_vendors_is_taken() {
        let mut settings = OtbSettings::default();
        assert_eq!(settings.address_of(&Amplifier::Muovi).to_string(), "0.0.0.0:54321");
        let quattrocento = Amplifier::Quattrocento(Quattrocento::new(2048.0, 96).unwrap());
        assert_eq!(settings.address_of(&quattrocento).to_string(), "169.254.1.10:23456");
        settings.address = Some(([127, 0, 0, 1], 5000).into());
        assert_eq!(settings.address_of(&Amplifier::Muovi).to_string(), "127.0.0.1:5000");
    }
}
