//! The core of a recogniser that is fitted to one person.
//!
//! ```text
//!                      calibration                                  use, per window
//! windows ─▶ LaggedLogCovariance ─▶ features ┐         window ─▶ LaggedLogCovariance ─▶ features
//! labels, repetitions ───────────────────────┤                                            │
//! Prior: other people's windows and gestures ┴─▶ Discriminant ───────────────────────────▶├─▶ posterior
//!                                  CrossValidation ─▶ temperature, limit of distance       └─▶ distance
//! ```
//!
//! In use, [`SlowAdaptation`] lets a discriminant follow its person. Without labels, [`GestureMap`] finds the
//! gestures in a stream from where other people's lie.
//!
//! Everything here is pure: no clock, no topic, no file. Every constant of the method is in
//! [`MethodSettings`]. Features depend on no unit of the samples as long as the floor is taken from the
//! person's rest ([`rest_floor`]). Nothing that runs per window allocates.
//!
//! # What a window costs
//!
//! p50 of windows of 300 ms, four pieces, at 2000 Hz on an AMD EPYC (`--example window`, release build), in µs:
//!
//! | channels x delays | features | alone | in a stream, every 25 ms | posterior | distance | fit (ms) |
//! | --- | --- | --- | --- | --- | --- | --- |
//! | 4 x 4 | 136 | 58 | 14.5 | 0.3 | 4 | 2 |
//! | 8 x 4 | 528 | 255 | 64 | 1.1 | 45 | 24 |
//! | 10 x 3 | 465 | 232 | 58 | 1.0 | 35 | 15 |
//! | 64 x 1 | 2080 | 1576 | 382 | 9.9 | 1536 | 676 |
//!
//! Most of it is the eigenvalues, computed by EISPACK's method in `eigen.rs`. In one run, for 16, 32 and 64
//! rows: 14, 45 and 273 µs; nalgebra's `SymmetricEigen` 17, 55 and 520 µs, and it allocates; faer 0.24 19, 74
//! and 323 µs without allocation, for two minutes of CPU more to build.
//!
//! What it recognises, and what was tried, is in `docs/decisions/personal-recogniser.md`.
#![forbid(unsafe_code)]

mod assignment;
mod cache;
mod clustering;
mod cohort;
mod covariance;
mod cross_validation;
mod discriminant;
mod eigen;
mod error;
mod new_repetitions;
mod numbers;
mod population;
mod prior;
mod settings;
mod shrinkage;
mod training;
mod unlabelled;

pub use cohort::{Cohort, MemberId};
pub use covariance::{LaggedLogCovariance, rest_floor};
pub use cross_validation::CrossValidation;
pub use discriminant::{Discriminant, SlowAdaptation};
pub use error::{FeatureError, FitError, PriorError, UnlabelledError};
pub use new_repetitions::recognised_in_new_repetitions;
pub use population::{GestureMeans, Population};
pub use prior::{FeatureLayout, Prior, WithinClassScatter};
pub use settings::MethodSettings;
pub use shrinkage::{Shrunk, ledoit_wolf};
pub use training::{Class, Training};
pub use unlabelled::{GestureMap, PlacedGestures, Recognised};
