//! The step in which motion is computed, and the two parts of a velocity.

use nalgebra::{Vector3, Vector6};

/// Length of a step of motion in ns: 250 Hz, the rate of the vendor's controller.
pub const STEP_NS: u64 = 4_000_000;

/// [`STEP_NS`] in seconds.
pub(crate) const STEP_S: f64 = STEP_NS as f64 * 1e-9;

/// The linear (row 0) or the angular (row 3) part.
pub(crate) fn part(vector: &Vector6<f64>, row: usize) -> Vector3<f64> {
    vector.fixed_rows::<3>(row).into_owned()
}
