//! How long a velocity takes from the call of the client to the bytes given to the network, at 250 Hz. From the receipt
//! of a command by the robot process on, `tendon run` measures it: `command_to_wire` in its report.
//!
//! ```sh
//! cargo run -p tendon-xarm-emulator --example command_to_wire
//! ```

use std::io::Write;
use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tendon_xarm::{Client, ClientSettings, Mode, Phase, Velocity};
use tendon_xarm_emulator::{Emulator, Listen};

const COMMANDS: usize = 5000;
const PERIOD: Duration = Duration::from_millis(4);

fn main() -> anyhow::Result<()> {
    let emulator = Emulator::start(Listen::anywhere())?;
    let listen = emulator.listen;
    let on = |port| SocketAddr::new(listen.address, port);
    let client = Client::start(ClientSettings {
        control: on(listen.control_port),
        normal_report: on(listen.normal_report_port),
        real_time_report: on(listen.real_time_report_port),
        ..ClientSettings::new(listen.address)
    })?;
    while client.status().phase != Phase::Connected {
        std::thread::sleep(PERIOD);
    }
    client.arm(Mode::CartesianVelocity);
    while client.status().phase != Phase::Ready {
        std::thread::sleep(PERIOD);
    }
    let mut latencies_us = Vec::with_capacity(COMMANDS);
    let mut calls_us = Vec::with_capacity(COMMANDS);
    let mut due = Instant::now();
    let mut answered = client.status().commands_answered;
    for command in 0..COMMANDS {
        let along_y = if command % 250 < 125 { 20.0 } else { -20.0 };
        let call = Instant::now();
        client.follow_command(Velocity::Flange([0.0, along_y, 0.0, 0.0, 0.0, 0.0]), call);
        calls_us.push(call.elapsed().as_secs_f64() * 1e6);
        due += PERIOD;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let status = client.status();
        if status.commands_answered > answered {
            answered = status.commands_answered;
            latencies_us.push(status.command_to_wire.as_secs_f64() * 1e6);
        }
    }
    let mut output = std::io::stdout();
    for (name, values) in [("command to wire", &mut latencies_us), ("call of follow", &mut calls_us)] {
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
        writeln!(
            output,
            "{name}: {} of {COMMANDS}, p50 {:.1} us, p99 {:.1} us, p99.9 {:.1} us, max {:.1} us",
            values.len(),
            at(0.5),
            at(0.99),
            at(0.999),
            at(1.0)
        )?;
    }
    writeln!(output, "{:?}", client.status())?;
    Ok(())
}
