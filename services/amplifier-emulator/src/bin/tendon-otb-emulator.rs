//! The program `tendon-otb-emulator`: an emulated amplifier of OT Bioelettronica.
#![forbid(unsafe_code)]

use std::io::Write;
use std::net::SocketAddr;
use std::time::Duration;

use clap::{Parser, ValueEnum};
use tendon_amplifier_emulator::{Console, OtbEmulator, Place, WearerOptions, fault_help};
use tendon_otb::Device;

/// An emulated amplifier of OT Bioelettronica, worn by the simulated person.
///
/// It dials in at this computer as a Muovi does, or waits to be dialled as a Quattrocento does. It prints `ready` and the
/// address, then reads standard input, a line each: a gesture makes the person make it, `state` prints how many samples were
/// sent and lost, `quit` ends the program, and the faults listed below make something go wrong.
#[derive(Debug, Parser)]
#[command(version, after_help = fault_help())]
struct Options {
    /// Which amplifier.
    device: Name,
    /// Where Tendon waits for it [default: 127.0.0.1 and the vendor's port].
    #[arg(long, value_name = "ADDRESS", conflicts_with = "listen")]
    connect: Option<SocketAddr>,
    /// Where a Quattrocento waits for Tendon [default: 127.0.0.1:23456].
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<SocketAddr>,
    /// Lose 7 samples every so many seconds.
    #[arg(long, value_name = "SECONDS")]
    lose_every: Option<f64>,
    /// How much faster than it says it samples, parts per million.
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    drift_ppm: f64,
    #[command(flatten)]
    wearer: WearerOptions,
}

/// As the settings write it.
#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Name {
    Muovi,
    MuoviPlus,
    Sessantaquattro,
    Quattrocento,
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    let local = |port: u16| SocketAddr::from(([127, 0, 0, 1], port));
    let (device, place) = match options.device {
        Name::Muovi => (Device::Muovi, Place::Connect(options.connect.unwrap_or(local(54321)))),
        Name::MuoviPlus => (Device::MuoviPlus, Place::Connect(options.connect.unwrap_or(local(54321)))),
        Name::Sessantaquattro => {
            (Device::Sessantaquattro, Place::Connect(options.connect.unwrap_or(local(45454))))
        }
        Name::Quattrocento => (Device::Quattrocento, Place::Listen(options.listen.unwrap_or(local(23456)))),
    };
    // A wrong person is refused before anybody connects.
    options.wearer.open(2000.0)?;
    let console = Console::default();
    let emulator = OtbEmulator {
        device,
        wearer: options.wearer,
        lose_every: options.lose_every.map(Duration::from_secs_f64),
        drift_ppm: options.drift_ppm,
        console: console.clone(),
    };
    console.obey_beside("tendon-otb-emulator", move || {
        emulator.run(place, |address: SocketAddr| {
            // Without standard output nobody waits for it.
            let _ = writeln!(std::io::stdout(), "ready {address}");
        })
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_sound() {
        Options::command().debug_assert();
        Options::parse_from(["tendon-otb-emulator", "muovi_plus", "--lose-every", "1", "--drift-ppm", "-50"]);
    }
}
