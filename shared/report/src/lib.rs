//! Histograms of every hop and stage, and the report of a session.
//!
//! ```text
//! measurements of every stage ─▶ SessionMeasurements ─┬─────────────▶ Report ─▶ table, JSON
//! what the session knows of itself ─▶ SessionFacts ───│──────────────▲
//!                                                     └─▶ interval log (hdrhistogram's standard format)
//! ```
//!
//! Three latencies are kept apart: *transit* (publish to receive, a hop), *work* (receive to publish, a
//! stage) and the algorithmic one, which the window's length sets and *window start to command* includes.
#![forbid(unsafe_code)]

mod log;
mod measurements;
mod report;
mod table;

pub use log::write_latency_log;
pub use measurements::{Counts, SessionMeasurements, Summary, duration_histogram};
pub use report::{
    GestureRecognition, Hop, LatencySummary, MessageCounts, Outcome, Recognition, Report, SessionEvent,
    SessionFacts, WindowStartSummary, Work,
};
pub use table::running_table;
