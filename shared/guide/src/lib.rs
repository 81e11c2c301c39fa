//! A guided calibration: what a person is asked when, and whether it was done.
//!
//! ```text
//! GuideSettings ─▶ Guide ──Cue──▶ terminal, simulated person
//!    keys, troubles ─▶ │ ──Span──▶ labels of the recording
//! blocks as acquired ─▶ SignalWatch ──▶ level of effort, Trouble ─▶ do it again
//! ```
//!
//! Pure: the clock is the number of the newest sample, so that cues and labels belong to samples whatever the machine is
//! busy with. Nothing here knows of a topic, a file or a terminal.
#![forbid(unsafe_code)]

mod guide;
mod settings;
mod watch;

pub use guide::{Ask, Cue, Guide, Span, Trial};
pub use settings::{GuideSettings, InvalidGuide};
pub use watch::{SignalWatch, Trouble};
