//! Eigenvalues and eigenvectors of a small symmetric matrix, without allocation.
//!
//! ```text
//! A ── Householder, from the last row up ──▶ T = Qᵀ A Q, tridiagonal ── implicit QL ──▶ eigenvalues
//!                                            Qᵀ ──────── the same rotations ──────────▶ eigenvectors, one a row
//! ```
//!
//! The method is EISPACK's `tred2` and `imtql2` (Wilkinson and Reinsch 1971), with the eigenvectors kept as
//! rows, so that every inner loop runs over contiguous memory.

/// Steps of QL for one eigenvalue. It takes about two.
const LARGEST_STEPS: usize = 60;

/// A sum of squares below this is taken for 0: its reciprocal could overflow. The largest element of a matrix
/// is about 1.
const NOTHING: f64 = 1e-290;

/// The working memory for one size of matrix.
#[derive(Clone, Debug)]
pub(crate) struct SymmetricEigen {
    size: usize,
    /// Diagonal of T, then the eigenvalues.
    diagonal: Vec<f64>,
    /// Below the diagonal of T: element `i` couples rows `i` and `i + 1`. One spare element at the end.
    beside: Vec<f64>,
    /// Scale of each Householder reflection `1 - scale v vᵀ`.
    scales: Vec<f64>,
    /// Qᵀ, then the eigenvectors, one a row.
    vectors: Vec<f64>,
    product: Vec<f64>,
}

impl SymmetricEigen {
    pub(crate) fn new(size: usize) -> SymmetricEigen {
        SymmetricEigen {
            size,
            diagonal: vec![0.0; size],
            beside: vec![0.0; size],
            scales: vec![0.0; size],
            vectors: vec![0.0; size * size],
            product: vec![0.0; size],
        }
    }

    /// Decomposes a finite symmetric matrix with elements of the order of 1, of which the lower triangle is
    /// read and overwritten. False if QL does not converge.
    #[must_use]
    pub(crate) fn decompose(&mut self, matrix: &mut [f64]) -> bool {
        assert_eq!(matrix.len(), self.size * self.size, "the size of the working memory");
        self.make_tridiagonal(matrix);
        self.accumulate(matrix);
        self.make_diagonal()
    }

    /// The eigenvalues, in no particular order.
    pub(crate) fn values(&self) -> &[f64] {
        &self.diagonal
    }

    /// The eigenvector of each value, of length 1.
    pub(crate) fn vectors(&self) -> impl Iterator<Item = &[f64]> {
        self.vectors.chunks_exact(self.size.max(1))
    }

    /// Row by row from the last, reflects what is left of the diagonal onto its last element. The vectors of
    /// the reflections stay in the rows.
    fn make_tridiagonal(&mut self, matrix: &mut [f64]) {
        let n = self.size;
        for row in (1..n).rev() {
            let (above, rest) = matrix.split_at_mut(row * n);
            let (vector, own) = rest.split_at_mut(row);
            self.diagonal[row] = own[0];
            let scale = &mut self.scales[row];
            (self.beside[row - 1], *scale) = reflection(vector);
            if *scale == 0.0 {
                continue;
            }
            // product = scale A v, with A's lower triangle; then A -= v wᵀ + w vᵀ with w = product - (scale/2)(productᵀv) v.
            let product = &mut self.product[..row];
            product.fill(0.0);
            for i in 0..row {
                let line = &above[i * n..=i * n + i];
                let (line, own) = (&line[..i], line[i]);
                product[i] += dot(line, &vector[..i]) + own * vector[i];
                add_scaled(&mut product[..i], vector[i], line);
            }
            product.iter_mut().for_each(|value| *value *= *scale);
            let half = 0.5 * *scale * dot(product, vector);
            add_scaled(product, -half, vector);
            for i in 0..row {
                let (v, w) = (vector[i], product[i]);
                let line = &mut above[i * n..=i * n + i];
                for ((value, &vector), &product) in line.iter_mut().zip(&*vector).zip(&*product) {
                    *value -= v * product + w * vector;
                }
            }
        }
        if n > 0 {
            self.diagonal[0] = matrix[0];
        }
    }

    /// Multiplies the reflections into Qᵀ.
    fn accumulate(&mut self, matrix: &[f64]) {
        let n = self.size;
        self.vectors.fill(0.0);
        self.vectors.iter_mut().step_by(n + 1).for_each(|value| *value = 1.0);
        for row in 1..n {
            let scale = self.scales[row];
            if scale == 0.0 {
                continue;
            }
            let vector = &matrix[row * n..row * n + row];
            for line in self.vectors.chunks_exact_mut(n).take(row) {
                let line = &mut line[..row];
                let along = scale * dot(line, vector);
                add_scaled(line, -along, vector);
            }
        }
    }

    /// Implicit QL: every rotation of T also turns two eigenvectors.
    fn make_diagonal(&mut self) -> bool {
        let n = self.size;
        let SymmetricEigen { diagonal, beside, vectors, .. } = self;
        for first in 0..n {
            let mut steps = 0;
            loop {
                let end = (first..n - 1)
                    .find(|&i| beside[i].abs() <= f64::EPSILON * (diagonal[i].abs() + diagonal[i + 1].abs()))
                    .unwrap_or(n - 1);
                if end == first {
                    break;
                }
                if steps == LARGEST_STEPS {
                    return false;
                }
                steps += 1;
                ql_step(first, end, diagonal, beside, vectors);
            }
        }
        true
    }
}

/// One step of QL on the rows `first..=end`, with Wilkinson's shift.
fn ql_step(first: usize, end: usize, diagonal: &mut [f64], beside: &mut [f64], vectors: &mut [f64]) {
    let n = diagonal.len();
    let ratio = (diagonal[first + 1] - diagonal[first]) / (2.0 * beside[first]);
    let mut ahead = diagonal[end] - diagonal[first]
        + beside[first] / (ratio + (ratio * ratio + 1.0).sqrt().copysign(ratio));
    let (mut sine, mut cosine, mut shift) = (1.0, 1.0, 0.0);
    for i in (first..end).rev() {
        let bulge = sine * beside[i];
        let coupling = cosine * beside[i];
        let length = (bulge * bulge + ahead * ahead).sqrt();
        beside[i + 1] = length;
        if length == 0.0 {
            // The matrix has come apart here; the next step goes on with a part of it.
            diagonal[i + 1] -= shift;
            beside[end] = 0.0;
            return;
        }
        sine = bulge / length;
        cosine = ahead / length;
        let before = diagonal[i + 1] - shift;
        let mixed = (diagonal[i] - before) * sine + 2.0 * cosine * coupling;
        shift = sine * mixed;
        diagonal[i + 1] = before + shift;
        ahead = cosine * mixed - coupling;
        let (upper, lower) = vectors[i * n..(i + 2) * n].split_at_mut(n);
        for (upper, lower) in upper.iter_mut().zip(lower) {
            let value = *lower;
            *lower = sine * *upper + cosine * value;
            *upper = cosine * *upper - sine * value;
        }
    }
    diagonal[first] -= shift;
    beside[first] = ahead;
    beside[end] = 0.0;
}

/// Replaces `vector` by the `v` of a reflection `1 - scale v vᵀ` that leaves its last element only. Returns
/// that element and the scale, which is 0 if there is nothing to reflect.
fn reflection(vector: &mut [f64]) -> (f64, f64) {
    let Some((last, others)) = vector.split_last_mut() else { return (0.0, 0.0) };
    let others_squared = dot(others, others);
    if others_squared < NOTHING {
        return (*last, 0.0);
    }
    let length = (others_squared + *last * *last).sqrt();
    let target = -length.copysign(*last);
    *last -= target;
    (target, 2.0 / (others_squared + *last * *last))
}

/// Sum of products. Four sums in turns, so that the compiler may use vector instructions.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (a, b) in a.0.iter().zip(b.0) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a.1.iter().zip(b.1).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// `target += factor · values`.
pub(crate) fn add_scaled(target: &mut [f64], factor: f64, values: &[f64]) {
    for (target, value) in target.iter_mut().zip(values) {
        *target += factor * value;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Largest error of V Λ Vᵀ = A and of V Vᵀ = 1, relative to the largest element of A.
    fn error(size: usize, matrix: &[f64]) -> f64 {
        let mut eigen = SymmetricEigen::new(size);
        assert!(eigen.decompose(&mut matrix.to_vec()), "converges");
        let scale = matrix.iter().fold(f64::MIN_POSITIVE, |largest, value| largest.max(value.abs()));
        let mut worst = 0.0_f64;
        for i in 0..size {
            for j in 0..=i {
                let value: f64 =
                    eigen.values().iter().zip(eigen.vectors()).map(|(l, v)| l * v[i] * v[j]).sum();
                let unit: f64 = eigen.vectors().map(|v| v[i] * v[j]).sum();
                worst = worst.max((value - matrix[i * size + j]).abs() / scale);
                worst = worst.max((unit - f64::from(u8::from(i == j))).abs());
            }
        }
        worst
    }

    fn symmetric() -> impl Strategy<Value = (usize, Vec<f64>)> {
        (1_usize..24).prop_flat_map(|size| {
            let element =
                prop_oneof![3 => -1.0..1.0_f64, 1 => Just(0.0), 1 => Just(1.0), 1 => -1e-9..1e-9_f64];
            proptest::collection::vec(element, size * size).prop_map(move |mut matrix| {
                for i in 0..size {
                    for j in 0..i {
                        matrix[j * size + i] = matrix[i * size + j];
                    }
                }
                (size, matrix)
            })
        })
    }

    proptest! {
        /// To 1e-12 of the largest element.
        #[test]
        fn values_and_vectors_make_the_matrix((size, matrix) in symmetric()) {
            prop_assert!(error(size, &matrix) < 1e-12);
        }
    }

    #[test]
    fn matrices_with_equal_zero_and_graded_values_are_decomposed() {
        let size = 16;
        let zero = vec![0.0; size * size];
        let mut unit = zero.clone();
        let mut graded = zero.clone();
        let ones = vec![1.0; size * size];
        for i in 0..size {
            unit[i * size + i] = 1.0;
            for j in 0..size {
                graded[i * size + j] = 10_f64.powi(-((i + j) as i32)) * if i == j { 2.0 } else { 1.0 };
            }
        }
        for matrix in [&zero, &unit, &ones, &graded] {
            assert!(error(size, matrix) < 1e-13);
        }
    }
}
