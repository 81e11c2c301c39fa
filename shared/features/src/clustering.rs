//! A stream of windows, divided into as many clusters as there are gestures, without knowing any.
//!
//! ```text
//! windows ─▶ blocks of consecutive windows ─▶ Ward ─▶ first clusters ─┬─▶ means ─▶ sticky chain ─▶ shares ─┐
//!                                                                     └──────────── ten times ◀────────────┘
//! ```
//!
//! A gesture is held: windows that follow each other are mostly of one gesture. Blocks average noise away before anything is
//! merged (Ward 1963), and the chain keeps single windows from leaving their neighbours.

use nalgebra::DMatrix;

/// Consecutive windows whose mean is clustered: about half a second at a window every 75 ms.
const BLOCK_WINDOWS: usize = 6;
/// Times that means and shares are computed.
const ROUNDS: usize = 10;
/// Probability that the next window is of the same cluster.
const STAY: f64 = 0.95;
/// By which log-likelihoods are multiplied: windows that overlap tell less than independent ones.
const LIKELIHOOD_SCALE: f64 = 0.3;

/// Divides windows (dimensions x windows, whitened: a unit is one deviation within a cluster) into `clusters`. Returns the
/// share of every cluster in every window, windows x clusters; `None` if there are fewer blocks than clusters.
pub(crate) fn cluster_stream(windows: &DMatrix<f64>, clusters: usize) -> Option<DMatrix<f64>> {
    let count = windows.ncols();
    let blocks = ((count as f64 / BLOCK_WINDOWS as f64).round() as usize).max(1);
    if blocks < clusters || clusters == 0 {
        return None;
    }
    let block_of = |window: usize| window * blocks / count;
    let mut shares = DMatrix::zeros(count, blocks);
    (0..count).for_each(|window| shares[(window, block_of(window))] = 1.0);
    let of_block = ward(&means(windows, &shares), clusters);
    let mut shares = DMatrix::zeros(count, clusters);
    (0..count).for_each(|window| shares[(window, of_block[block_of(window)])] = 1.0);
    for _ in 0..ROUNDS {
        shares = chain_shares(&log_likelihoods(windows, &means(windows, &shares)));
    }
    Some(shares)
}

/// The mean of each cluster (dimensions x clusters) of windows with these shares (windows x clusters).
pub(crate) fn means(windows: &DMatrix<f64>, shares: &DMatrix<f64>) -> DMatrix<f64> {
    let mut means = windows * shares;
    for (mut mean, shares) in means.column_iter_mut().zip(shares.column_iter()) {
        mean /= shares.sum().max(1e-9);
    }
    means
}

/// Ward's clustering of points (dimensions x points): as long as there are more than `clusters`, the two are merged whose
/// union adds least to the sum of squares. Returns the cluster of every point, numbered by their first points.
pub(crate) fn ward(points: &DMatrix<f64>, clusters: usize) -> Vec<usize> {
    let count = points.ncols();
    let mut sizes = vec![1.0; count];
    let mut of_point: Vec<usize> = (0..count).collect();
    // Twice what a union adds to the sum of squares.
    let mut distances = DMatrix::from_fn(count, count, |row, column| {
        (points.column(row) - points.column(column)).norm_squared()
    });
    let mut left: Vec<usize> = (0..count).collect();
    while left.len() > clusters.max(1) {
        let (kept, merged) = nearest(&left, &distances);
        let between = distances[(kept, merged)];
        left.retain(|&cluster| cluster != merged);
        for &other in left.iter().filter(|&&other| other != kept) {
            // Lance and Williams 1967.
            let (a, b, c) = (sizes[kept], sizes[merged], sizes[other]);
            let sum = (a + c) * distances[(kept, other)] + (b + c) * distances[(merged, other)] - c * between;
            let distance = sum / (a + b + c);
            distances[(kept, other)] = distance;
            distances[(other, kept)] = distance;
        }
        sizes[kept] += sizes[merged];
        of_point.iter_mut().filter(|own| **own == merged).for_each(|own| *own = kept);
    }
    of_point.iter().map(|own| left.iter().position(|cluster| cluster == own).unwrap_or(0)).collect()
}

/// The two clusters that are nearest, the smaller number first.
fn nearest(left: &[usize], distances: &DMatrix<f64>) -> (usize, usize) {
    let mut nearest = (left[0], left[1]);
    for (place, &second) in left.iter().enumerate() {
        for &first in &left[..place] {
            if distances[(first, second)] < distances[nearest] {
                nearest = (first, second);
            }
        }
    }
    nearest
}

/// Scaled log-likelihood of every window under every cluster with unit covariance, windows x clusters.
fn log_likelihoods(windows: &DMatrix<f64>, means: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(windows.ncols(), means.ncols(), |window, cluster| {
        -0.5 * LIKELIHOOD_SCALE * (windows.column(window) - means.column(cluster)).norm_squared()
    })
}

/// The posterior of a hidden chain whose states mostly stay, from log-likelihoods, windows x states (forward-backward, Rabiner
/// 1989). All states are equally likely at first, and so are all changes.
pub(crate) fn chain_shares(log_likelihoods: &DMatrix<f64>) -> DMatrix<f64> {
    let (count, states) = log_likelihoods.shape();
    let change = if states > 1 { (1.0 - STAY) / (states - 1) as f64 } else { 0.0 };
    let stay = if states > 1 { STAY } else { 1.0 };
    // A transition, in either direction: the chain is symmetric.
    let moved = |from: &[f64]| -> Vec<f64> {
        let sum: f64 = from.iter().sum();
        from.iter().map(|share| stay * share + change * (sum - share)).collect()
    };
    let likelihoods: Vec<Vec<f64>> = log_likelihoods
        .row_iter()
        .map(|row| row.iter().map(|value| (value - row.max()).exp()).collect())
        .collect();
    let mut shares = DMatrix::zeros(count, states);
    let mut state = vec![1.0 / states as f64; states];
    for (window, likelihoods) in likelihoods.iter().enumerate() {
        if window > 0 {
            state = moved(&state);
        }
        state.iter_mut().zip(likelihoods).for_each(|(share, likelihood)| *share *= likelihood);
        normalise(&mut state);
        state.iter().enumerate().for_each(|(cluster, share)| shares[(window, cluster)] = *share);
    }
    let mut later = vec![1.0; states];
    for window in (0..count).rev() {
        if let Some(likelihoods) = likelihoods.get(window + 1) {
            later.iter_mut().zip(likelihoods).for_each(|(share, likelihood)| *share *= likelihood);
            later = moved(&later);
            normalise(&mut later);
        }
        let mut row = shares.row_mut(window);
        row.iter_mut().zip(&later).for_each(|(share, later)| *share *= later);
        let sum = row.sum();
        row /= sum;
    }
    shares
}

fn normalise(shares: &mut [f64]) {
    let sum: f64 = shares.iter().sum();
    shares.iter_mut().for_each(|share| *share /= sum);
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Golden {
        ward: Ward,
    }

    #[derive(Deserialize)]
    struct Ward {
        points: Vec<f64>,
        dimensions: usize,
        cuts: Vec<Cut>,
    }

    #[derive(Deserialize)]
    struct Cut {
        clusters: usize,
        of_point: Vec<usize>,
    }

    #[test]
    fn ward_is_that_of_scipy() {
        let golden: Golden =
            serde_json::from_str(include_str!("../tests/golden/unlabelled.json")).expect("the golden file");
        let Ward { points, dimensions, cuts } = golden.ward;
        let points = DMatrix::from_column_slice(dimensions, points.len() / dimensions, &points);
        for Cut { clusters, of_point } in cuts {
            let ours = ward(&points, clusters);
            // SciPy numbers them otherwise: what counts is who is together.
            for (one, other) in (0..of_point.len()).flat_map(|one| (0..one).map(move |other| (one, other))) {
                let (ours, theirs) = (ours[one] == ours[other], of_point[one] == of_point[other]);
                assert_eq!(ours, theirs, "{clusters} clusters, points {one} and {other}");
            }
        }
    }

    #[test]
    fn ward_merges_the_two_whose_union_adds_least() {
        let points = DMatrix::from_row_slice(1, 6, &[0.0, 10.0, 0.5, 11.0, 30.0, 10.4]);
        assert_eq!(ward(&points, 3), [0, 1, 0, 1, 2, 1]);
        assert_eq!(ward(&points, 2), [0, 0, 0, 0, 1, 0]);
        assert_eq!(ward(&points, 6), [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn a_single_window_does_not_leave_its_neighbours() {
        let of_first = |window: usize| if window == 5 { -1.0 } else { 1.0 };
        let log_likelihoods =
            DMatrix::from_fn(10, 2, |window, state| if state == 0 { of_first(window) } else { 0.0 });
        let shares = chain_shares(&log_likelihoods);
        assert!(shares.column(0).iter().all(|share| *share > 0.9), "{shares}");
        assert!(shares.row_iter().all(|row| (row.sum() - 1.0).abs() < 1e-12));
    }

    #[test]
    fn a_stream_falls_into_what_was_held_in_it() {
        // Three holds of 30 windows, the last like the first.
        let middle = |window: usize| if (30..60).contains(&window) { 20.0 } else { 0.0 };
        let windows =
            DMatrix::from_fn(2, 90, |row, window| middle(window) + ((7 * window + 3 * row) % 5) as f64 / 5.0);
        let shares = cluster_stream(&windows, 2).expect("enough blocks");
        let is_same = |a: usize, b: usize| (shares[(a, 0)] - shares[(b, 0)]).abs() < 0.01;
        assert!(is_same(5, 85) && !is_same(5, 45), "{shares}");
        assert!(cluster_stream(&windows, 16).is_none(), "15 blocks are too few");
    }
}
