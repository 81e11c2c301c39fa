//! The vendor's own client drives the emulator.
//!
//! Needs a Python with `xarm-python-sdk`, which `TENDON_XARM_PYTHON` names.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use tendon_xarm::{Firmware, Setup};
use tendon_xarm_emulator::{Emulator, Listen, Properties};

#[test]
fn the_vendors_client_moves_the_arm_grips_and_sees_errors() {
    let Some(python) = std::env::var_os("TENDON_XARM_PYTHON") else {
        println!("skipped: TENDON_XARM_PYTHON names no Python with xarm-python-sdk");
        return;
    };
    let properties = Properties {
        firmware: Firmware { major: 2, minor: 5, revision: 0 },
        serial_number: "XI130506D01L04".to_owned(),
        setup: Setup {
            tcp_offset: [1.0, -2.0, 172.0, 0.0, 0.0, 0.5],
            load_kg: 0.82,
            load_centre_mm: [0.0, 1.0, 48.0],
            collision_sensitivity: 4,
            teaching_sensitivity: 2,
            gravity: Some([0.0, 0.0, 1.0]),
        },
        ..Properties::default()
    };
    let emulator = Emulator::start_as(properties, Listen::anywhere()).unwrap();
    let listen = emulator.listen;
    let ports = [
        listen.control_port,
        listen.normal_report_port,
        listen.rich_report_port,
        listen.real_time_report_port,
    ];
    let mut client = Command::new(python)
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/vendor_client.py"))
        .args(ports.map(|port| port.to_string()))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut last = String::new();
    for line in BufReader::new(client.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        println!("{line}");
        if let Some(fault) = line.strip_prefix("inject ") {
            emulator.inject(fault.parse().unwrap());
        }
        last = line;
    }
    assert!(client.wait().unwrap().success());
    assert_eq!(last, "all ok");
}
