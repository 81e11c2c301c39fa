//! How well a person will be recognised, from the calibration alone.
//!
//! ```text
//! block 1 | block 2 | block 3        each block in turn is scored by a discriminant
//!   fit       fit      score         that was fitted without it
//! ```

use crate::discriminant::Discriminant;
use crate::error::FitError;
use crate::prior::Prior;
use crate::settings::MethodSettings;
use crate::training::Training;

/// Steps of the golden-section search: each shortens the range of ln temperature to 0.62 of itself.
const SEARCH_STEPS: usize = 60;

/// Scores of windows by discriminants that have not seen their block.
#[derive(Clone, Debug)]
pub struct CrossValidation {
    class_count: usize,
    labels: Vec<usize>,
    /// What each window counts; the classes have their shares, the sum is 1.
    weights: Vec<f64>,
    /// Windows x classes.
    scores: Vec<f64>,
    /// To the nearest class.
    distances: Vec<f64>,
}

impl CrossValidation {
    /// Holds out each block (repetition) in turn.
    ///
    /// # Errors
    ///
    /// As [`Discriminant::fit`], or a class that has too few windows without one block.
    pub fn new(
        training: &Training,
        prior: Option<&Prior>,
        settings: &MethodSettings,
    ) -> Result<CrossValidation, FitError> {
        settings.check()?;
        training.check()?;
        training.check_counts(settings.fewest_windows)?;
        let class_count = training.classes.len();
        let counts = training.counts();
        let shares = training.shares();
        let mut validation = CrossValidation {
            class_count,
            labels: training.labels.to_vec(),
            weights: training.labels.iter().map(|&label| shares[label] / counts[label] as f64).collect(),
            scores: vec![0.0; training.len() * class_count],
            distances: vec![0.0; training.len()],
        };
        let mut blocks = training.blocks.to_vec();
        blocks.sort_unstable();
        blocks.dedup();
        for block in blocks {
            validation.hold_out(block, training, prior, settings)?;
        }
        Ok(validation)
    }

    fn hold_out(
        &mut self,
        block: usize,
        training: &Training,
        prior: Option<&Prior>,
        settings: &MethodSettings,
    ) -> Result<(), FitError> {
        let (mut features, mut labels, mut blocks) =
            (Vec::with_capacity(training.features.len()), Vec::new(), Vec::new());
        let windows = || training.windows().zip(training.labels).zip(training.blocks);
        for ((window, &label), &of) in windows().filter(|(_, window_block)| **window_block != block) {
            features.extend_from_slice(window);
            labels.push(label);
            blocks.push(of);
        }
        let others = Training { features: &features, labels: &labels, blocks: &blocks, ..*training };
        let discriminant = Discriminant::fit(&others, prior, settings).map_err(|error| match error {
            FitError::TooFewWindows { class, .. } => FitError::CannotHoldOut { class, block },
            error => error,
        })?;
        let mut whitened = vec![0.0; training.feature_count];
        let results = self.scores.chunks_exact_mut(self.class_count).zip(&mut self.distances);
        for (((window, _), window_block), (scores, distance)) in windows().zip(results) {
            if *window_block == block {
                discriminant.scores(window, scores)?;
                *distance = discriminant.distance(window, &mut whitened)?;
            }
        }
        Ok(())
    }

    /// Mean of -ln(posterior of the right class) at a temperature, with the classes in their shares.
    pub fn log_loss(&self, temperature: f64) -> f64 {
        let windows = self.scores.chunks_exact(self.class_count).zip(&self.labels).zip(&self.weights);
        windows
            .map(|((scores, &label), weight)| {
                let highest = scores.iter().fold(f64::NEG_INFINITY, |highest, score| highest.max(*score));
                let sum: f64 = scores.iter().map(|score| ((score - highest) / temperature).exp()).sum();
                weight * (sum.ln() - (scores[label] - highest) / temperature)
            })
            .sum()
    }

    /// The temperature in the range of the settings with the smallest log-loss. The loss is convex in 1 /
    /// temperature, so that it has one minimum, which a golden-section search finds to 1e-6.
    pub fn temperature(&self, settings: &MethodSettings) -> f64 {
        let [mut low, mut high] = settings.temperature_range.map(f64::ln);
        const RATIO: f64 = 0.618_033_988_749_894_9;
        for _ in 0..SEARCH_STEPS {
            let (lower, upper) = (high - RATIO * (high - low), low + RATIO * (high - low));
            if self.log_loss(lower.exp()) <= self.log_loss(upper.exp()) {
                high = upper;
            } else {
                low = lower;
            }
        }
        let [coldest, hottest] = settings.temperature_range;
        (0.5 * (low + high)).exp().clamp(coldest, hottest)
    }

    /// Windows by class made (row) and class recognised (column), of those for which `counts` holds.
    pub fn confusion(&self, counts: impl Fn(usize) -> bool) -> Vec<Vec<usize>> {
        let mut confusion = vec![vec![0; self.class_count]; self.class_count];
        let windows = self.scores.chunks_exact(self.class_count).zip(&self.labels).enumerate();
        for (_, (scores, &label)) in windows.filter(|(window, _)| counts(*window)) {
            let best = (0..self.class_count).max_by(|&a, &b| scores[a].total_cmp(&scores[b])).unwrap_or(0);
            confusion[label][best] += 1;
        }
        confusion
    }

    /// The distance to the nearest class that a share of the held-out windows stays below, e.g. 0.99: beyond
    /// it, a window is unlike the calibration. Parts of one repetition are more alike than repetitions are:
    /// on fifteen people scored in another session, 1.8 % of the windows were beyond the distance at 0.99
    /// after four repetitions, but 21 % after one (4 % beyond 1.3 times the distance).
    pub fn distance_at(&self, share: f64) -> f64 {
        let mut distances = self.distances.clone();
        distances.sort_by(f64::total_cmp);
        let last = distances.len().saturating_sub(1);
        let at = (share.clamp(0.0, 1.0) * last as f64).round() as usize;
        distances.get(at).copied().unwrap_or(0.0)
    }
}
