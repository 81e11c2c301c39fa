//! Acquires from an NI device through NI-DAQmx, for `acquisition.source = "nidaqmx"`.
//!
//! ```text
//! thread of the driver (reader.rs)                                     loop of the process (device.rs)
//! Task::read, waits for a block ── pipe: index, time, samples ──▶ Source ─▶ tendon_source::acquire
//! ```
#![forbid(unsafe_code)]

mod device;
mod reader;
mod record;

use std::process::ExitCode;

use tendon_messages::Stage;
use tendon_process::StageProcess;

use crate::device::Device;

fn main() -> ExitCode {
    tendon_process::main(Stage::Acquisition, |process| {
        let mut device = Device::open(&process.config.acquisition)?;
        let blocks = tendon_source::open_blocks(process)?;
        process.ready_with_signal(&device.description(), device.signal())?;
        Ok(move |process: &mut StageProcess| tendon_source::acquire(process, &mut device, blocks))
    })
}
