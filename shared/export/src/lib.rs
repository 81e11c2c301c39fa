//! Recorded sessions in the formats of others.
//!
//! ```text
//! session.mcap ──first pass──▶ Survey: channels, unit, rate, gaps, ranges, person, provenance
//!      │                          │
//!      └──────second pass─────────┴─▶ Timeline ─▶ Chronicle (cues, trials, stops)
//!                                        ├─▶ tables: signal.csv, predictions.csv, … for R, MATLAB and pandas
//!                                        ├─▶ bids: sidecars, events, BDF+ (bdf)
//!                                        └─▶ streams: XDF (xdf)
//! Staging: files lie in a hidden folder until all of them are whole; one export at a time writes to a folder
//! ```
//!
//! Each pass holds one message in memory, however long the session was; BIDS also holds the events, which are few. All times are seconds since the first recorded
//! sample, see [`Timeline`].
#![forbid(unsafe_code)]

mod bdf;
mod bids;
mod chronicle;
mod error;
mod staging;
mod streams;
mod survey;
mod table;
mod tables;
#[cfg(test)]
mod tests;
mod timeline;
mod xdf;

pub use bids::{BidsFacts, participant_of, write_bids};
pub use error::ExportError;
pub use staging::is_unfinished_export;
pub use streams::write_xdf;
pub use survey::{Gap, Survey};
pub use tables::{TABLES, check_tables, write_tables};
pub use timeline::{Placed, Timeline};
pub use xdf::is_exported_xdf;
