//! Acquires from Delsys Trigno sensors over the vendor's server, `acquisition.source = "delsys"`.
//!
//! ```text
//! server ◀──commands── connect: sensors, rate, START, slots checked ─▶ tendon_link::LinkedSource (samples, loss, clock)
//! ```
#![forbid(unsafe_code)]

mod connect;
mod decode;

use std::process::ExitCode;

use crate::connect::DelsysConnector;

fn main() -> ExitCode {
    tendon_link::main(|config| Ok(DelsysConnector::new(&config.acquisition.delsys)))
}
