//! The program `xarm-emulator`: an arm to try everything on that may go wrong.
#![forbid(unsafe_code)]

use std::io::{BufRead, Write};
use std::net::IpAddr;

use clap::Parser;
use tendon_xarm_emulator::{Emulator, Fault, Listen};

/// An xArm7 that is not there, for the vendor's clients and for Tendon.
///
/// Reads lines from its standard input: `state` prints how the arm is, `quit` ends it, and these make something go
/// wrong: emergency-stop, release, collision, error CODE, warning CODE, runaway MM_PER_S, drop, late MS COUNT, torn COUNT,
/// garbage COUNT, silent COUNT. Without an input it runs until it is killed.
#[derive(Debug, Parser)]
#[command(version)]
struct Options {
    /// Where to listen; whoever reaches it can move the arm.
    #[arg(long, default_value = "127.0.0.1")]
    address: IpAddr,
    /// Port of control, 0 for any. Ports below 1024 may need rights.
    #[arg(long, default_value_t = 502)]
    control_port: u16,
    /// Port of the normal reports, 5 Hz.
    #[arg(long, default_value_t = 30001)]
    normal_report_port: u16,
    /// Port of the rich reports, 5 Hz.
    #[arg(long, default_value_t = 30002)]
    rich_report_port: u16,
    /// Port of the real-time reports, 100 Hz.
    #[arg(long, default_value_t = 30003)]
    real_time_report_port: u16,
    /// A fault from the start, as on standard input; may be given several times.
    #[arg(long, value_name = "FAULT")]
    fault: Vec<Fault>,
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    let emulator = Emulator::start(Listen {
        address: options.address,
        control_port: options.control_port,
        normal_report_port: options.normal_report_port,
        rich_report_port: options.rich_report_port,
        real_time_report_port: options.real_time_report_port,
    })?;
    options.fault.iter().for_each(|&fault| emulator.inject(fault));
    let mut output = std::io::stdout();
    let Listen { address, control_port, normal_report_port, rich_report_port, real_time_report_port } =
        emulator.listen;
    writeln!(
        output,
        "ready {address} control {control_port} normal {normal_report_port} rich {rich_report_port} \
         real-time {real_time_report_port}"
    )?;
    for line in std::io::stdin().lock().lines() {
        match line?.trim() {
            "" => {}
            "quit" => return Ok(()),
            "state" => {
                let model = emulator.model();
                let report = model.report();
                writeln!(
                    output,
                    "state {:?} mode {} codes {:?} speed_mm_per_s {:.3} pose {:?} gripper_pulses {:.0}",
                    report.state,
                    report.mode,
                    model.codes(),
                    model.speed_mm_per_s(),
                    report.pose,
                    model.gripper().position_pulses,
                )?;
            }
            line => match line.parse() {
                Ok(fault) => emulator.inject(fault),
                Err(error) => writeln!(output, "{error}")?,
            },
        }
    }
    loop {
        std::thread::park();
    }
}
