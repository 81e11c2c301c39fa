//! An emulated xArm7: the vendor's protocol, server side, over a model of the arm.
//!
//! ```text
//! control, 502  ──request──▶ [`answer`] ──▶ [`Model`] ◀── every 10 or 200 ms ── reports, 30001 to 30003
//!               ◀──reply─── [`Fault`]s       4 ms steps, as [`Properties`] say
//! ```
//!
//! Each connection has a thread. The model catches up with the time that passed whenever somebody looks at it. The
//! vendor's own client drives it (`tests/vendor_client.py`), and it plays what goes wrong with a real arm: each
//! [`Fault`] is one line of text, in a test, on the command line or on the standard input of `xarm-emulator`.
#![forbid(unsafe_code)]

mod answer;
mod fault;
pub mod model;
mod properties;
mod server;

pub use answer::answer;
pub use fault::{FAULTS, Fault, FaultError};
pub use model::Model;
pub use properties::Properties;
pub use server::{Emulator, Listen};
