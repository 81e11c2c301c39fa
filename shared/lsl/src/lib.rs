//! The Lab Streaming Layer (LSL): the socket that most laboratories' programs speak.
//!
//! ```text
//! liblsl.so ── loaded at run time ──▶ Lsl ─▶ resolve ─▶ Stream ─▶ Inlet ─▶ Reader (a thread) ─▶ frames, a descriptor
//!                                      └──▶ Outlet, TextOutlet
//! ```
//!
//! liblsl is C++ and is not linked: without it everything else of Tendon runs. `library.rs` holds its functions and is the
//! only place that knows their types; the handles of `stream.rs`, `inlet.rs` and `outlet.rs` free what they own.
//!
//! Time stamps are seconds of the *sender's* clock. Its difference from ours (`Inlet::time_correction`) is added to them; ours
//! is CLOCK_MONOTONIC, as liblsl's `local_clock` is on Linux.

mod error;
mod inlet;
mod library;
mod locate;
mod outlet;
mod reader;
mod settings;
mod stream;

pub use error::LslError;
pub use inlet::Inlet;
pub use library::Lsl;
pub use locate::find_library;
pub use outlet::{Outlet, StreamDescription, TextOutlet};
pub use reader::{Frame, Reader};
pub use settings::{LslSettings, LslSettingsError};
pub use stream::{ChannelFacts, Format, Stream, StreamFacts};
