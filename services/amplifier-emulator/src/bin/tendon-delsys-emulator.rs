//! The program `tendon-delsys-emulator`: an emulated Delsys Trigno SDK server.
#![forbid(unsafe_code)]

use std::io::Write;
use std::net::IpAddr;

use clap::Parser;
use tendon_amplifier_emulator::{Console, DelsysEmulator, WearerOptions, fault_help};

/// An emulated Delsys Trigno SDK server, whose sensors the simulated person wears.
///
/// It prints `ready` and its addresses, then reads standard input, a line each: a gesture makes the person make it, `state`
/// prints how many samples were sent and lost, `quit` ends the program, and the faults listed below make something go wrong.
#[derive(Debug, Parser)]
#[command(version, after_help = fault_help())]
struct Options {
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1")]
    address: IpAddr,
    /// Port of the commands.
    #[arg(long, default_value_t = 50040)]
    command_port: u16,
    /// Port of the EMG samples.
    #[arg(long, default_value_t = 50043)]
    emg_port: u16,
    /// Slots with a sensor.
    #[arg(long, value_delimiter = ',', default_value = "1,2,3,4")]
    slots: Vec<usize>,
    #[command(flatten)]
    wearer: WearerOptions,
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    // A wrong person is refused before anybody connects.
    options.wearer.open(2000.0)?;
    let console = Console::default();
    let emulator = DelsysEmulator { slots: options.slots, wearer: options.wearer, console: console.clone() };
    let places = (options.address, options.command_port, options.emg_port);
    console.obey_beside("tendon-delsys-emulator", move || {
        emulator.run(places, |commands, emg| {
            // Without standard output nobody waits for it.
            let _ = writeln!(std::io::stdout(), "ready commands {commands} emg {emg}");
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
        let options = Options::parse_from(["tendon-delsys-emulator", "--slots", "1,3"]);
        assert_eq!(options.slots, [1, 3]);
    }
}
