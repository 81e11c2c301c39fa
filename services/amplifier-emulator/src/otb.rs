//! Amplifiers of OT Bioelettronica.

use std::io::Read;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, ensure};
use tendon_otb::{Amplifier, ByteOrder, Device, Gain, Layout, Mode, OtbSettings};

use crate::transmit::{Pace, transmit};
use crate::{Console, WearerOptions};

/// Accessory channels of the Sessantaquattro+ that is played.
const SESSANTAQUATTRO_ACCESSORIES: usize = 8;
/// Bytes of a packet, at most: a TCP segment over Wi-Fi.
const PACKET_BYTES: usize = 1400;
/// Time until a device dials in again.
const REDIAL: Duration = Duration::from_millis(300);
/// A computer that takes nothing for so long is gone.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);

/// Where the connection is made.
#[derive(Clone, Copy, Debug)]
pub enum Place {
    /// The device dials in here.
    Connect(SocketAddr),
    /// The device is dialled here.
    Listen(SocketAddr),
}

/// An emulated amplifier of OT Bioelettronica.
#[derive(Debug)]
pub struct OtbEmulator {
    /// Which one.
    pub device: Device,
    /// Who wears it.
    pub wearer: WearerOptions,
    /// Some samples are lost every so often.
    pub lose_every: Option<Duration>,
    /// How much faster than it says it samples, parts per million.
    pub drift_ppm: f64,
    /// Keyboard and counts.
    pub console: Console,
}

/// What a control word asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Asked {
    go: bool,
    amplifier: Amplifier,
}

impl OtbEmulator {
    /// Plays the amplifier for ever; `announce` is told where it listens, if it does.
    ///
    /// # Errors
    ///
    /// When it cannot listen, or the person cannot be simulated.
    pub fn run(&self, place: Place, announce: impl FnOnce(SocketAddr)) -> anyhow::Result<()> {
        let listener = match place {
            Place::Connect(address) => {
                announce(address);
                None
            }
            Place::Listen(address) => {
                let listener = TcpListener::bind(address)
                    .with_context(|| format!("cannot listen on {address}: choose another port"))?;
                announce(listener.local_addr()?);
                Some(listener)
            }
        };
        loop {
            let stream = match (&listener, place) {
                (Some(listener), _) => listener.accept()?.0,
                (None, Place::Connect(address) | Place::Listen(address)) => {
                    let Ok(stream) = TcpStream::connect(address) else {
                        std::thread::sleep(REDIAL);
                        continue;
                    };
                    stream
                }
            };
            // A connection that breaks is over; the other side sees it too.
            let away = self.serve(&stream)?;
            // Closes it though a thread still reads from it.
            let _ = stream.shutdown(std::net::Shutdown::Both);
            std::thread::sleep(away.max(REDIAL));
        }
    }

    /// Serves one connection; gives how long the device is away after it.
    fn serve(&self, mut stream: &TcpStream) -> anyhow::Result<Duration> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        let amplifier = loop {
            let mut word = vec![0; self.word_bytes()];
            if stream.read_exact(&mut word).is_err() {
                return Ok(Duration::ZERO);
            }
            match asked(self.device, &word) {
                Ok(Asked { go: true, amplifier }) => break amplifier,
                // Only a Quattrocento takes a stop when it does not measure; the others hang up.
                Ok(_) if self.device == Device::Quattrocento => {}
                Ok(_) => return Ok(Duration::ZERO),
                // A wrong word is passed over, as the devices do.
                Err(_) => {}
            }
        };
        let layout = amplifier.layout(SESSANTAQUATTRO_ACCESSORIES);
        let mut wearer = self.wearer.open(layout.rate_hz)?;
        let is_over = Arc::new(AtomicBool::new(false));
        self.watch(stream, &is_over)?;
        let pace = Pace {
            rate_hz: layout.rate_hz * (1.0 + self.drift_ppm * 1e-6),
            packet_samples: (PACKET_BYTES / layout.instant_bytes()).max(1) as u64,
            lose_every: self.lose_every,
        };
        let encode = |number: u64, microvolts: &[f32], packet: &mut Vec<u8>| {
            write_instant(&layout, number, microvolts, packet)
        };
        Ok(transmit(stream, pace, &mut wearer, &self.console, &is_over, encode))
    }

    fn word_bytes(&self) -> usize {
        match self.device {
            Device::Muovi | Device::MuoviPlus => 1,
            Device::Sessantaquattro => 2,
            Device::Quattrocento => 40,
        }
    }

    /// Sets `is_over` once the computer says stop or is gone.
    fn watch(&self, stream: &TcpStream, is_over: &Arc<AtomicBool>) -> anyhow::Result<()> {
        let (mut stream, is_over) = (stream.try_clone()?, is_over.clone());
        let (device, mut word) = (self.device, vec![0; self.word_bytes()]);
        std::thread::spawn(move || {
            while stream.read_exact(&mut word).is_ok() {
                if matches!(asked(device, &word), Ok(Asked { go: false, .. })) {
                    break;
                }
            }
            is_over.store(true, Ordering::Relaxed);
        });
        Ok(())
    }
}

/// What a control word asks of this device, read independently of how `tendon-otb` writes it.
fn asked(device: Device, word: &[u8]) -> anyhow::Result<Asked> {
    let settings = |inputs, mode, gain| OtbSettings { device, inputs, mode, gain, ..OtbSettings::default() };
    let (go, settings, rate_hz) = match device {
        Device::Muovi | Device::MuoviPlus => {
            ensure!(word[0] >> 1 == 0b000_0100, "only EMG, monopolar at gain 8 is played");
            (word[0] & 1, settings(None, Mode::Monopolar, Gain::Eight), 2000.0)
        }
        Device::Sessantaquattro => {
            let rate_hz = [500.0, 1000.0, 2000.0, 4000.0][usize::from(word[0] >> 5 & 3)];
            let inputs = [8, 16, 32, 64][usize::from(word[0] >> 3 & 3)];
            let mode = match word[0] & 7 {
                0 => Mode::Monopolar,
                1 => Mode::Bipolar,
                mode => anyhow::bail!("mode {mode} is not played"),
            };
            ensure!(word[1] & 0x80 == 0, "24 bits are not played");
            let gain = [Gain::Eight, Gain::Four, Gain::Six, Gain::Eight][usize::from(word[1] >> 4 & 3)];
            (word[1] & 1, settings(Some(inputs), mode, gain), rate_hz)
        }
        Device::Quattrocento => {
            ensure!(tendon_otb::crc8(&word[..39]) == word[39], "the checksum is wrong");
            let rate_hz = [512.0, 2048.0, 5120.0, 10240.0][usize::from(word[0] >> 3 & 3)];
            let inputs = [96, 192, 288, 384][usize::from(word[0] >> 1 & 3)];
            (word[0] & 1, settings(Some(inputs), Mode::Monopolar, Gain::Eight), rate_hz)
        }
    };
    Ok(Asked { go: go == 1, amplifier: settings.amplifier(rate_hz)? })
}

/// Appends an instant: channels beyond the electrodes repeat them, accessories are 0, and the counter counts.
fn write_instant(layout: &Layout, number: u64, microvolts: &[f32], packet: &mut Vec<u8>) {
    for channel in 0..layout.channels {
        let counts = match channel {
            _ if channel == layout.counter_channel => number as u16 as i16,
            _ if channel < layout.emg_channels => {
                let millivolts = f64::from(microvolts[channel % microvolts.len()]) * 1e-3;
                (millivolts / layout.mv_per_count).round().clamp(-32768.0, 32767.0) as i16
            }
            _ => 0,
        };
        packet.extend(match layout.byte_order {
            ByteOrder::Big => counts.to_be_bytes(),
            ByteOrder::Little => counts.to_le_bytes(),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_tendon_asks_for_is_what_the_emulator_understands() {
        for (device, inputs, rate_hz) in [
            (Device::Muovi, None, 2000.0),
            (Device::MuoviPlus, None, 2000.0),
            (Device::Sessantaquattro, Some(16), 1000.0),
            (Device::Sessantaquattro, Some(64), 4000.0),
            (Device::Quattrocento, Some(96), 2048.0),
            (Device::Quattrocento, Some(384), 512.0),
        ] {
            let settings = OtbSettings { device, inputs, ..OtbSettings::default() };
            let amplifier = settings.amplifier(rate_hz).unwrap();
            assert_eq!(asked(device, &amplifier.start_word()).unwrap(), Asked { go: true, amplifier });
            assert_eq!(asked(device, &amplifier.stop_word()).unwrap(), Asked { go: false, amplifier });
        }
    }

    #[test]
    fn instants_are_read_back_by_the_decoder() {
        let layout = Amplifier::MuoviPlus.layout(0);
        let mut packet = Vec::new();
        for number in 0..20 {
            write_instant(&layout, number + 65_530, &[100.0, -50.0, 0.0, 3000.0], &mut packet);
        }
        let mut samples = Vec::new();
        let mut decoder = tendon_otb::Decoder::new(layout);
        decoder.push(&packet, |run| samples.extend_from_slice(run.instants_mv)).unwrap();
        assert_eq!(samples.len(), 20 * 64);
        for (sample, expected) in samples.iter().zip([0.1, -0.05, 0.0, 3.0].iter().cycle()) {
            assert!((sample - expected).abs() < 0.0002, "{sample} {expected}");
        }
        assert_eq!(decoder.lost_samples(), 0);
    }

    #[test]
    fn a_word_with_a_wrong_checksum_is_refused() {
        let settings = OtbSettings { device: Device::Quattrocento, ..OtbSettings::default() };
        let mut word = settings.amplifier(2048.0).unwrap().start_word();
        word[5] ^= 1;
        asked(Device::Quattrocento, &word).unwrap_err();
    }
}
