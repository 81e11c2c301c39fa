//! Acquires from an amplifier of OT Bioelettronica, `acquisition.source = "otb"`.
//!
//! ```text
//! Muovi, Sessantaquattro+ ──dial in──▶ connect: start word, width, first second checked ─▶ tendon_link::LinkedSource
//! Quattrocento ◀──dialled─────────────┘                                                    (samples, loss, clock)
//! ```
#![forbid(unsafe_code)]

mod connect;

use std::process::ExitCode;

use crate::connect::OtbConnector;

fn main() -> ExitCode {
    tendon_link::main(|config| {
        let acquisition = &config.acquisition;
        Ok(OtbConnector::new(&acquisition.otb, acquisition.sample_rate_hz)?)
    })
}
