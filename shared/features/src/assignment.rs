//! Which cluster is which gesture, when all are decided together.
//!
//! ```text
//! costs of every gesture being made in every cluster, once for each way the armband may sit
//!      │
//!      ▼  every assignment p: w(p) = sum over places of exp(-½ scale · sum of the costs)
//! probability of every gesture (row) being every cluster (column), and the most probable assignment
//! ```

use nalgebra::DMatrix;

/// By which the costs are multiplied: people differ in fewer ways than there are numbers.
const COST_SCALE: f64 = 0.25;

/// What the clusters are.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Assigned {
    /// Of each gesture, its cluster in the most probable assignment.
    pub(crate) cluster_of: Vec<usize>,
    /// Gestures x clusters: how probable it is that the gesture is the cluster; rows and columns sum to 1.
    pub(crate) probabilities: DMatrix<f64>,
}

/// Weighs all assignments in which gesture 0 is cluster `first`. `costs` are squared distances, gestures x clusters, of each
/// place of the armband; all square and of one size.
pub(crate) fn assign(costs: &[DMatrix<f64>], first: usize) -> Assigned {
    let count = costs[0].nrows();
    let mut clusters: Vec<usize> =
        std::iter::once(first).chain((0..count).filter(|&cluster| cluster != first)).collect();
    let mut weighed = Vec::new();
    loop {
        weighed.push((log_weight(costs, &clusters), clusters.clone()));
        if !next_permutation(&mut clusters[1..]) {
            break;
        }
    }
    let largest = weighed.iter().fold(f64::NEG_INFINITY, |largest, (weight, _)| largest.max(*weight));
    let mut probabilities = DMatrix::zeros(count, count);
    let mut sum = 0.0;
    for (weight, clusters) in &weighed {
        let weight = (weight - largest).exp();
        sum += weight;
        clusters
            .iter()
            .enumerate()
            .for_each(|(gesture, &cluster)| probabilities[(gesture, cluster)] += weight);
    }
    probabilities /= sum;
    let best = weighed.into_iter().max_by(|(one, _), (other, _)| one.total_cmp(other));
    let (_, cluster_of) = best.expect("there is at least one assignment");
    Assigned { cluster_of, probabilities }
}

/// Logarithm of the sum over places.
fn log_weight(costs: &[DMatrix<f64>], clusters: &[usize]) -> f64 {
    let of_place = |costs: &DMatrix<f64>| {
        let costs = clusters.iter().enumerate().map(|(gesture, &cluster)| costs[(gesture, cluster)]);
        -0.5 * COST_SCALE * costs.sum::<f64>()
    };
    let places: Vec<f64> = costs.iter().map(of_place).collect();
    let largest = places.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + places.iter().map(|place| (place - largest).exp()).sum::<f64>().ln()
}

/// The next permutation in lexicographic order; false after the last (Narayana's algorithm).
fn next_permutation(values: &mut [usize]) -> bool {
    let Some(turn) = values.windows(2).rposition(|pair| pair[0] < pair[1]) else { return false };
    let larger = values.iter().rposition(|value| *value > values[turn]);
    values.swap(turn, larger.expect("the next value is larger"));
    values[turn + 1..].reverse();
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_permutations_come_once() {
        let mut values = [0, 1, 2, 3];
        let mut seen = vec![values];
        while next_permutation(&mut values) {
            seen.push(values);
        }
        assert_eq!(seen.len(), 24);
        assert!(seen.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(!next_permutation(&mut []));
    }

    #[test]
    fn gestures_are_decided_together_and_rest_is_given() {
        // Cluster 1 suits both gestures best, but gesture 2 can be nothing else.
        let costs = DMatrix::from_row_slice(3, 3, &[90.0, 90.0, 90.0, 4.0, 0.0, 0.0, 100.0, 2.0, 0.0]);
        let assigned = assign(&[costs], 2);
        assert_eq!(assigned.cluster_of, [2, 0, 1]);
        assert_eq!(assigned.probabilities[(0, 2)], 1.0);
        assert!(assigned.probabilities[(2, 1)] > 0.99);
    }

    #[test]
    fn a_place_of_the_armband_that_fits_decides() {
        let unfit = DMatrix::from_element(3, 3, 500.0);
        let fit = DMatrix::from_row_slice(3, 3, &[0.0, 9.0, 9.0, 9.0, 9.0, 0.0, 9.0, 0.0, 9.0]);
        let assigned = assign(&[unfit, fit], 0);
        assert_eq!(assigned.cluster_of, [0, 2, 1]);
    }
}
