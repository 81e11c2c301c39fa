//! The core of a recogniser that is fitted to one person.
//!
//! ```text
//!                      calibration                                  use, per window
//! windows ─▶ LaggedLogCovariance ─▶ features ┐         window ─▶ LaggedLogCovariance ─▶ features
//! labels, repetitions ───────────────────────┤                                            │
//! Prior (other people's covariance) ─────────┴─▶ Discriminant ───────────────────────────▶├─▶ posterior
//!                                  CrossValidation ─▶ temperature, limit of distance       └─▶ distance
//! ```
//!
//! Everything here is pure: no clock, no topic, no file. Every constant of the method is in [`MethodSettings`].
//! Features depend on no unit of the samples as long as the floor is taken from the person's rest
//! ([`rest_floor`]). Nothing that runs per window allocates.
//!
//! # What a window costs
//!
//! p50 on one core of an AMD EPYC shared with other work, windows of 300 ms at 2000 Hz, release build:
//!
//! MEASURED
#![forbid(unsafe_code)]

mod covariance;
mod cross_validation;
mod discriminant;
mod eigen;
mod error;
mod prior;
mod settings;
mod shrinkage;
mod training;

pub use covariance::{LaggedLogCovariance, rest_floor};
pub use cross_validation::CrossValidation;
pub use discriminant::Discriminant;
pub use error::{FeatureError, FitError, PriorError};
pub use prior::{FeatureLayout, Prior, WithinClassScatter};
pub use settings::MethodSettings;
pub use shrinkage::{Shrunk, ledoit_wolf};
pub use training::{Class, Training};
