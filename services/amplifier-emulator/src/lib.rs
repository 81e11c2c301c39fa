//! Emulated amplifiers on the network, worn by the simulated person.
//!
//! ```text
//! standard input: gestures, faults ─▶ Wearer ──microvolts──▶ transmit: packets at the right time, faults ──TCP──▶ Tendon
//!                                                               ▲ the amplifier's words: otb, delsys
//! ```
//!
//! They play the device's side of the protocols that `shared/otb` and `shared/delsys` describe, as far as Tendon uses them.
#![forbid(unsafe_code)]

mod console;
mod delsys;
mod fault;
mod otb;
mod transmit;
mod wearer;

pub use console::Console;
pub use delsys::DelsysEmulator;
pub use fault::{Fault, FaultError, fault_help};
pub use otb::{OtbEmulator, Place};
pub use wearer::{Wearer, WearerOptions};
