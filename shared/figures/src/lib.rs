//! Figures as PNG or SVG: latencies of a session, confusion matrices, target zones.
//!
//! ```text
//! Histogram ─▶ latency_figure ───┐
//! Confusion ─▶ confusion_figure ─┼─▶ canvas ─▶ file.png, file.svg
//! ZoneTask ──▶ zones_figure ─────┘
//! ```
#![forbid(unsafe_code)]

mod canvas;
mod confusion;
mod latency;
mod scores;
mod zones;

pub use canvas::{DrawError, FigureError};
pub use confusion::confusion_figure;
pub use latency::latency_figure;
pub use scores::write_score_figures;
pub use zones::zones_figure;
