//! The acquisition process that reads a stream of the Lab Streaming Layer (`acquisition.source = "lsl"`).
//!
//! ```text
//! find the one stream ─▶ describe: rate, channels, units ─▶ Offer::choose ─▶ open, measure its clock ─▶ ready
//!                                    start ─▶ Reader ─▶ Timeline ─▶ BlockAssembler ─▶ tendon_source::acquire
//! ```
#![forbid(unsafe_code)]

mod rate;
mod source;
mod stamps;
mod timeline;

use std::process::ExitCode;

use tendon_messages::Stage;
use tendon_process::StageProcess;

use crate::source::LslSource;

fn main() -> ExitCode {
    tendon_process::main(Stage::Acquisition, |process| {
        let mut source = LslSource::open(&process.config.acquisition)?;
        let blocks = tendon_source::open_blocks(process)?;
        process.ready_with_signal(&source.detail(), source.signal().clone())?;
        Ok(move |process: &mut StageProcess| tendon_source::acquire(process, &mut source, blocks))
    })
}
