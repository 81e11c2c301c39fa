//! A covariance from few windows: shrunk towards a multiple of the identity.

use nalgebra::DMatrix;

/// A covariance and how far it was shrunk.
#[derive(Clone, Debug)]
pub struct Shrunk {
    /// (1 - shrinkage) · S + shrinkage · (trace S / features) · 1.
    pub covariance: DMatrix<f64>,
    /// From 0 (as measured) to 1 (a multiple of the identity).
    pub shrinkage: f64,
}

/// The covariance of Ledoit and Wolf 2004 ("A well-conditioned estimator for large-dimensional covariance
/// matrices"), which is scikit-learn's `ledoit_wolf` with `assume_centered`. `centred` is features x windows
/// with a mean of 0 and at least one window; S is its product with its transpose over the number of windows.
///
/// With d features, n windows x_i and m = trace S / d, all norms squared Frobenius: distance = |S - m·1|²,
/// spread = Σ|x_i|⁴ / n² - |S|² / n, shrinkage = spread / distance, within 0 to 1.
pub fn ledoit_wolf(centred: &DMatrix<f64>) -> Shrunk {
    let (features, windows) = (centred.nrows() as f64, centred.ncols() as f64);
    let mut covariance = centred * centred.transpose() / windows;
    let mean = covariance.trace() / features;
    let squared = covariance.norm_squared();
    let distance = squared - features * mean * mean;
    let fourth: f64 = centred.column_iter().map(|window| window.norm_squared().powi(2)).sum();
    let spread = (fourth / windows - squared) / windows;
    let shrinkage = if distance > 0.0 { (spread / distance).clamp(0.0, 1.0) } else { 0.0 };
    covariance *= 1.0 - shrinkage;
    covariance.iter_mut().step_by(centred.nrows() + 1).for_each(|variance| *variance += shrinkage * mean);
    Shrunk { covariance, shrinkage }
}
