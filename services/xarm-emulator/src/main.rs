//! The program `xarm-emulator`: an emulated xArm7 to try out whatever may go wrong with a real one.
#![forbid(unsafe_code)]

use std::io::{BufRead, Write};
use std::net::IpAddr;

use anyhow::Context;
use clap::Parser;
use tendon_xarm::{Firmware, Setup};
use tendon_xarm_emulator::{Emulator, FAULTS, Fault, Listen, Properties};

/// An emulated xArm7, for Tendon and for the vendor's own clients.
///
/// It prints `ready`, its address and its ports, then reads commands from standard input, one a line: `state` prints the
/// state of the arm, `quit` ends the program, and the faults listed below make something go wrong or end it. When
/// standard input is closed, the emulator runs until it is killed.
#[derive(Debug, Parser)]
#[command(version, after_help = faults())]
struct Options {
    /// Address to listen on. Anybody who can reach it can move the arm.
    #[arg(long, default_value = "127.0.0.1", help_heading = "Network")]
    address: IpAddr,
    /// Port of the control connection, 0 for any free one. Ports below 1024 may need root.
    #[arg(long, default_value_t = 502, help_heading = "Network")]
    control_port: u16,
    /// Port of the normal reports, 5 Hz.
    #[arg(long, default_value_t = 30001, help_heading = "Network")]
    normal_report_port: u16,
    /// Port of the rich reports, 5 Hz.
    #[arg(long, default_value_t = 30002, help_heading = "Network")]
    rich_report_port: u16,
    /// Port of the real-time reports, 100 Hz.
    #[arg(long, default_value_t = 30003, help_heading = "Network")]
    real_time_report_port: u16,
    #[command(flatten)]
    arm: ArmOptions,
    /// A fault that exists from the start, in quotes: --fault 'creep 20'. May be repeated.
    #[arg(long, value_name = "FAULT", help_heading = "Faults")]
    fault: Vec<Fault>,
}

/// Which arm to play.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Arm")]
struct ArmOptions {
    /// Number of joints that the arm reports. Tendon drives arms with 7.
    #[arg(long, default_value_t = 7)]
    axes: u8,
    /// Model number that the arm reports; 7 is the xArm7.
    #[arg(long, default_value_t = 7)]
    model: u8,
    /// Version of the firmware. Before 1.8.0 the arm keeps moving when no new velocity arrives.
    #[arg(long, default_value = "1.12.10", value_parser = firmware)]
    firmware: Firmware,
    /// Serial number [default: XI1300 and the control port]. Characters 3 to 6 are the generation: from 1305 on, joints 2
    /// and 4 have a smaller range. Tendon knows an arm by this number: no two may have the same.
    #[arg(long)]
    serial_number: Option<String>,
    /// TCP offset on the controller, from the flange to the tip of the tool: mm and rad. The arm reports the pose of the
    /// tip.
    #[arg(
        long,
        value_name = "X,Y,Z,ROLL,PITCH,YAW",
        default_value = "0,0,0,0,0,0",
        value_parser = numbers::<6>,
        allow_hyphen_values = true
    )]
    tcp_offset: [f32; 6],
    /// Load on the controller: mass in kg, then its centre from the flange in mm.
    #[arg(
        long,
        value_name = "KG,X,Y,Z",
        default_value = "0,0,0,0",
        value_parser = numbers::<4>,
        allow_hyphen_values = true
    )]
    load: [f32; 4],
    /// Collision sensitivity on the controller: 0 is off, 5 the most sensitive.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=5))]
    collision_sensitivity: u8,
    /// Teaching sensitivity on the controller.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=5))]
    teaching_sensitivity: u8,
    /// Direction of gravity on the controller: 0,0,-1 for an arm on a table, 0,0,1 under a ceiling.
    #[arg(
        long,
        value_name = "X,Y,Z",
        default_value = "0,0,-1",
        value_parser = numbers::<3>,
        allow_hyphen_values = true
    )]
    gravity: [f32; 3],
}

impl ArmOptions {
    fn properties(self, control_port: u16) -> Properties {
        let [load_kg, x, y, z] = self.load;
        Properties {
            axes: self.axes,
            model: self.model,
            firmware: self.firmware,
            serial_number: self.serial_number.unwrap_or_else(|| format!("XI1300{control_port:08}")),
            setup: Setup {
                tcp_offset: self.tcp_offset,
                load_kg,
                load_centre_mm: [x, y, z],
                collision_sensitivity: self.collision_sensitivity,
                teaching_sensitivity: self.teaching_sensitivity,
                gravity: Some(self.gravity),
            },
        }
    }
}

fn firmware(text: &str) -> anyhow::Result<Firmware> {
    Firmware::parse(text).context("write three numbers, such as 1.12.10")
}

fn numbers<const COUNT: usize>(text: &str) -> anyhow::Result<[f32; COUNT]> {
    let wanted = || format!("write {COUNT} numbers with commas between");
    let values =
        text.split(',').map(|word| word.trim().parse::<f32>().ok().filter(|value| value.is_finite()));
    let values: Vec<f32> = values.collect::<Option<_>>().with_context(wanted)?;
    <[f32; COUNT]>::try_from(values).ok().with_context(wanted)
}

/// All faults and what they do.
fn faults() -> String {
    let mut help = "Faults, on standard input or with --fault:".to_owned();
    for (form, explanation) in FAULTS {
        help += &format!("\n  {form:<18} {explanation}");
    }
    help += "\n\nExample: an arm with a tool and its emergency stop pressed from the start:\n  \
             xarm-emulator --control-port 5020 --tcp-offset 0,0,172,0,0,0 --load 0.8,0,0,48 --fault emergency-stop";
    help
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    let listen = Listen {
        address: options.address,
        control_port: options.control_port,
        normal_report_port: options.normal_report_port,
        rich_report_port: options.rich_report_port,
        real_time_report_port: options.real_time_report_port,
    };
    let emulator = Emulator::start_as(options.arm.properties(options.control_port), listen)?;
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
            "state" => print_state(&emulator, &mut output)?,
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

fn print_state(emulator: &Emulator, output: &mut impl Write) -> std::io::Result<()> {
    let model = emulator.model();
    let report = model.report();
    writeln!(
        output,
        "state {:?} mode {} codes {:?} speed_mm_per_s {:.3} pose {:?} gripper_pulses {:.0} gripper_moves {}",
        report.state,
        report.mode,
        model.codes(),
        model.speed_mm_per_s(),
        report.pose,
        model.gripper().position_pulses,
        model.gripper().moves(),
    )
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_options_are_those_of_an_xarm7_by_default() {
        Options::command().debug_assert();
        let options = Options::parse_from(["xarm-emulator"]);
        let expected = Properties { serial_number: "XI130000000502".to_owned(), ..Properties::default() };
        assert_eq!(options.arm.properties(options.control_port), expected);
        let options =
            Options::parse_from(["xarm-emulator", "--tcp-offset", "-1,0,172,0,0,0", "--firmware", "1.7.9"]);
        let properties = options.arm.properties(502);
        assert_eq!(properties.setup.tcp_offset[..3], [-1.0, 0.0, 172.0]);
        assert!(!properties.firmware.obeys_duration());
        for wrong in ["1,2", "1,2,3,4,5,x", "1,2,3,4,5,inf"] {
            assert!(Options::try_parse_from(["xarm-emulator", "--tcp-offset", wrong]).is_err(), "{wrong}");
        }
    }
}
