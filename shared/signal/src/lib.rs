//! The signal processing of the dsp stage: one implementation for live and offline use, so that training and
//! deployment cannot drift apart.
//!
//! ```text
//! block ─▶ filter ─┬─▶ windows ──────────────▶ window
//!                  └─▶ envelope ─▶ activity ─▶ rest or movement      all of it: chain
//! block, window ─▶ contact ──────────────────▶ novelty: is an electrode off?
//! recording ─▶ resample                                              to the session's rate
//! recording ─▶ filter ─▶ onset                                       where the movement starts
//! ```
//! The units that samples can be in are in [`known_units`].
//! Everything that depends on time takes the sampling rate as a parameter. Samples are `f32` in the source's
//! unit (mV or ADC counts), blocks and windows are channel-major. Nothing but [`find_onset`], which is for
//! offline use, allocates once constructed.
#![forbid(unsafe_code)]

mod activity;
mod chain;
mod contact;
mod design;
mod envelope;
mod error;
mod filter;
mod onset;
mod resample;
mod unit;
mod windows;

pub use activity::{Activity, ActivityDetector, ActivitySettings, Baseline, SIGMA_PER_MAD};
pub use chain::{Push, SignalChain, SignalSettings, Window};
pub use contact::Fault;
pub use design::{MAX_ORDER, Section, butterworth_band_pass, butterworth_high_pass, notch};
pub use envelope::{DEFAULT_ENVELOPE_MS, Envelope};
pub use error::DesignError;
pub use filter::{EmgFilter, FilterSettings, LARGEST_SAMPLE};
pub use onset::{Onset, OnsetMethod, OnsetSettings, find_onset};
pub use resample::Resampler;
pub use unit::{UnitError, are_same_channels, canonical_unit, known_units, unit_factor, without_unit};
pub use windows::{WindowInput, WindowSettings, Windower};
