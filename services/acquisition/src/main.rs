//! The acquisition process that comes with Tendon: the simulated amplifier, or a recording. What it does with their
//! blocks is `tendon_source::acquire`, as in the process of any other source.

mod recorded_session;
mod source;

use std::process::ExitCode;

use tendon_messages::Stage;
use tendon_process::StageProcess;

fn main() -> ExitCode {
    tendon_process::main(Stage::Acquisition, |process| {
        let source::Opened { mut source, description, signal } = source::open(&process.config)?;
        let blocks = tendon_source::open_blocks(process)?;
        match signal {
            Some(signal) => process.ready_with_signal(&description, signal)?,
            None => process.ready(&description)?,
        }
        Ok(move |process: &mut StageProcess| tendon_source::acquire(process, &mut *source, blocks))
    })
}
