//! Acquires from any program that connects and sends samples, `acquisition.source = "stream"`.
//!
//! ```text
//! a program ──connects──▶ connect: header, first second checked ─▶ tendon_link::LinkedSource (samples, loss, clock)
//! ```
#![forbid(unsafe_code)]

mod connect;

use std::process::ExitCode;

use crate::connect::StreamConnector;

fn main() -> ExitCode {
    tendon_link::main(|config| Ok(StreamConnector::new(&config.acquisition.stream)?))
}
