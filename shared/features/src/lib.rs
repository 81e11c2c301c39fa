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
//! Everything here is pure: no clock, no topic, no file. Every constant of the method is in
//! [`MethodSettings`]. Features depend on no unit of the samples as long as the floor is taken from the
//! person's rest ([`rest_floor`]). Nothing that runs per window allocates.
//!
//! # What a window costs
//!
//! p50 of windows of 300 ms at 2000 Hz on an AMD EPYC with other work beside (`--example work`, release
//! build), in µs:
//!
//! | channels x delays | features | compute | posterior | distance | fit (ms) |
//! | --- | --- | --- | --- | --- | --- |
//! | 4 x 4 | 136 | 22 | 0.4 | 4 | 6 |
//! | 8 x 4 | 528 | 91 | 1.1 | 43 | 39 |
//! | 10 x 3 | 465 | 90 | 1.0 | 34 | 26 |
//! | 64 x 1 | 2080 | 899 | 9.5 | 2700 | 1800 |
//!
//! Most of it is the eigenvalues, computed by EISPACK's method in `eigen.rs`. In one run, for 16, 32 and 64
//! rows: 14, 45 and 273 µs; nalgebra's `SymmetricEigen` 17, 55 and 520 µs, and it allocates; faer 0.24 19, 74
//! and 323 µs without allocation, for two minutes of CPU more to build.
//!
//! On the fifteen people of 3DC (channels 0, 3, 5, 8; calibrated in one session, scored in another), windows
//! of 300 ms are right at 0.941 after one repetition and 0.986 after four, and those of 150 ms at 0.941 and
//! 0.985.
#![forbid(unsafe_code)]

mod covariance;
mod cross_validation;
mod discriminant;
mod eigen;
mod error;
mod population;
mod prior;
mod settings;
mod shrinkage;
mod training;

pub use covariance::{LaggedLogCovariance, rest_floor};
pub use cross_validation::CrossValidation;
pub use discriminant::Discriminant;
pub use error::{FeatureError, FitError, PriorError};
pub use population::{GestureMeans, Population};
pub use prior::{FeatureLayout, Prior, WithinClassScatter};
pub use settings::MethodSettings;
pub use shrinkage::{Shrunk, ledoit_wolf};
pub use training::{Class, Training};
