//! What each amplifier is told, and how its samples lie in the stream.

use std::net::SocketAddr;

use crate::{Quattrocento, Sessantaquattro};

/// Nominal value of a count of the probes at gain 8, mV (286.1 nV).
pub(crate) const PROBE_MV_PER_COUNT: f64 = 286.1e-6;
/// Rate of the Muovi probes in EMG mode, Hz.
const MUOVI_RATE_HZ: f64 = 2000.0;
/// Accessory channels of a Muovi: four of the orientation, the buffer with the trigger, the counter.
const MUOVI_ACCESSORIES: usize = 6;

/// An amplifier and how it is to measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Amplifier {
    /// Muovi: 32 monopolar channels, 2000 Hz.
    Muovi,
    /// Muovi+: 64 monopolar channels, 2000 Hz.
    MuoviPlus,
    /// Sessantaquattro and Sessantaquattro+.
    Sessantaquattro(Sessantaquattro),
    /// Quattrocento.
    Quattrocento(Quattrocento),
}

/// Who opens the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialling {
    /// The device dials in; the computer listens on this TCP port.
    Device {
        /// The port.
        port: u16,
    },
    /// The computer dials in at the device.
    Computer {
        /// Where the device is, as it comes from the factory.
        address: SocketAddr,
    },
}

/// Order of the two bytes of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The higher byte first.
    Big,
    /// The lower byte first.
    Little,
}

/// How an instant lies in the stream: `channels` samples of 16 bits, with a sign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Instants in a second.
    pub rate_hz: f64,
    /// Channels of an instant, accessories included.
    pub channels: usize,
    /// The first so many are EMG.
    pub emg_channels: usize,
    /// The channel that counts the instants, without a sign.
    pub counter_channel: usize,
    /// Order of the bytes.
    pub byte_order: ByteOrder,
    /// Value of a count of an EMG channel, mV.
    pub mv_per_count: f64,
}

impl Layout {
    /// Length of an instant.
    pub fn instant_bytes(&self) -> usize {
        2 * self.channels
    }
}

impl Amplifier {
    /// The name that the vendor gives it.
    pub fn name(&self) -> &'static str {
        match self {
            Amplifier::Muovi => "Muovi",
            Amplifier::MuoviPlus => "Muovi+",
            Amplifier::Sessantaquattro(_) => "Sessantaquattro+",
            Amplifier::Quattrocento(_) => "Quattrocento",
        }
    }

    /// Who opens the connection, and where.
    pub fn dialling(&self) -> Dialling {
        match self {
            Amplifier::Muovi | Amplifier::MuoviPlus => Dialling::Device { port: 54321 },
            Amplifier::Sessantaquattro(_) => Dialling::Device { port: 45454 },
            Amplifier::Quattrocento(_) => {
                Dialling::Computer { address: SocketAddr::from(([169, 254, 1, 10], 23456)) }
            }
        }
    }

    /// What makes it send samples.
    pub fn start_word(&self) -> Vec<u8> {
        match self {
            // EMG, monopolar at gain 8, GO.
            Amplifier::Muovi | Amplifier::MuoviPlus => vec![0b0000_1001],
            Amplifier::Sessantaquattro(settings) => settings.word(true).to_vec(),
            Amplifier::Quattrocento(settings) => settings.word(true).to_vec(),
        }
    }

    /// What makes it stop. A Sessantaquattro must not be sent this before it was started: it would hang up.
    pub fn stop_word(&self) -> Vec<u8> {
        match self {
            Amplifier::Muovi | Amplifier::MuoviPlus => vec![0b0000_1000],
            Amplifier::Sessantaquattro(settings) => settings.word(false).to_vec(),
            Amplifier::Quattrocento(settings) => settings.word(false).to_vec(),
        }
    }

    /// How its instants lie in the stream. `accessories` are the channels of a Sessantaquattro that are no EMG, which
    /// [`find_accessories`](crate::find_accessories) finds out; the other amplifiers have fixed numbers.
    pub fn layout(&self, accessories: usize) -> Layout {
        let probe = |rate_hz, emg_channels, accessories: usize, mv_per_count| Layout {
            rate_hz,
            channels: emg_channels + accessories,
            emg_channels,
            counter_channel: emg_channels + accessories - 1,
            byte_order: ByteOrder::Big,
            mv_per_count,
        };
        match self {
            Amplifier::Muovi => probe(MUOVI_RATE_HZ, 32, MUOVI_ACCESSORIES, PROBE_MV_PER_COUNT),
            Amplifier::MuoviPlus => probe(MUOVI_RATE_HZ, 64, MUOVI_ACCESSORIES, PROBE_MV_PER_COUNT),
            Amplifier::Sessantaquattro(settings) => probe(
                settings.rate_hz(),
                settings.emg_channels(),
                accessories.max(1),
                settings.gain().mv_per_count(),
            ),
            Amplifier::Quattrocento(settings) => settings.layout(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn muovi_words_and_instants_are_those_of_the_vendors_clients() {
        assert_eq!(Amplifier::Muovi.start_word(), [0x09]);
        assert_eq!(Amplifier::MuoviPlus.stop_word(), [0x08]);
        let (muovi, plus) = (Amplifier::Muovi.layout(0), Amplifier::MuoviPlus.layout(0));
        assert_eq!((muovi.channels, muovi.instant_bytes(), muovi.counter_channel), (38, 76, 37));
        assert_eq!((plus.channels, plus.counter_channel), (70, 69));
    }
}
