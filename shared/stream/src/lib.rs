//! The format in which any program sends samples over TCP.
//!
//! ```text
//! {"name": "my amplifier", "channels": ["flexor", "extensor"], "rate_hz": 2000, "unit": "mV"}⏎      one line of JSON
//! frame: "EMGf" │ samples u32 │ index of the first sample u64 │ samples × channels f32               little-endian
//! frame: …                                                      all channels of a sample together
//! ```
//!
//! Samples that were lost are counted in the index. Frames may be torn anywhere; the [`Decoder`] keeps what is left over.
#![forbid(unsafe_code)]

mod decoder;
mod header;
mod settings;

pub use decoder::{Decoder, FrameError, Instants, LONGEST_FRAME, MAGIC};
pub use header::{Header, HeaderError, LONGEST_HEADER};
pub use settings::StreamSettings;
