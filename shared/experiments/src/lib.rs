//! Every comparison of the paper, on any recordings of its layouts, from raw files to tables.
//!
//! ```text
//! recordings ─▶ data sets ─▶ scripts/train ─▶ models ─▶ scores ─┐
//!     ├─▶ strategies, offline ──────────────────────────────────┼─▶ report.md, report.json, figures
//!     └─▶ strategies, live: tendon run --replay ────────────────┘
//! ```
//! Everything goes into one folder. What is already there is kept, so an interrupted run continues where it stopped.
#![forbid(unsafe_code)]

mod error;
mod live;
mod paper;
mod plan;
mod report;
mod run;
mod training;

pub use error::ExperimentError;
pub use run::{Event, Results, Settings, run};
