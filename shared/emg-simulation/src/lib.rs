//! Simulated forearm EMG, faithful enough that a network trained on real people recognises it.
//!
//! ```text
//! script or keyboard ─▶ performance ──levels──▶ simulated EMG ──▶ samples, as an amplifier gives them
//!                            └────────▶ truth        ▲
//!          recordings ─▶ fit ─▶ profile ─────────────┘
//! ```
//!
//! A [`Profile`] describes what one person's muscles look like at the electrodes, gesture by gesture;
//! [`fit()`] makes one from recordings. A [`Script`] says which gesture is made when. A [`Performance`]
//! follows a script, or [`Performance::set_gesture`], and lets contractions rise and fall as in people.
//! [`SimulatedEmg`] turns all that into samples, with mains hum, baseline wander and, on request, faults. The
//! same seed gives the same samples, whatever the block size.
#![forbid(unsafe_code)]

mod fit;
mod performance;
mod profile;
mod script;
mod shaping;
mod simulator;

pub use fit::{FitError, FitSettings, Segment, fit};
pub use performance::{ContractionSettings, Performance, Repeat, Truth};
pub use profile::{Coherency, GestureProfile, Profile, ProfileError};
pub use script::{DEFAULT_SCRIPT, Script, ScriptError, Step};
pub use simulator::{SimulatedEmg, SimulationError, SimulationSettings};
