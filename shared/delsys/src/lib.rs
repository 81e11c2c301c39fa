//! The protocol of the Delsys Trigno SDK server (Trigno Control Utility) over TCP.
//!
//! ```text
//! computer ── START⏎⏎ ──▶ command port 50040 ── OK⏎⏎ ──▶ computer              text; an empty line ends each ([`Replies`])
//!                         EMG port 50043 ── 16 × f32, volts, little-endian ──▶ computer     one value a slot ([`Decoder`])
//! ```
//!
//! The samples have no counter and no times. What is lost on the radio cannot be seen in the stream; the server sends zeros or
//! held values then, so a slot that stands still is taken for a lost sensor. Nor has it anything to find the beginning of an instant by:
//! values that cannot be show that bytes are missing.
//!
//! Sources: the Trigno SDK User Guide (MAN-025-3-5) and public clients. Nothing here was tried on the vendor's hardware.
#![forbid(unsafe_code)]

mod decoder;
mod reply;
mod settings;

pub use decoder::{Decoder, INSTANT_BYTES, OutOfStep, SLOTS};
pub use reply::{Replies, ReplyError, command, frame_rate_hz, holds_one_muscle, is_yes};
pub use settings::DelsysSettings;
