//! A discriminant that follows its person slowly during use.
//!
//! ```text
//! window ─▶ posterior of a class > 0.95, novelty ≤ 1 ─▶ mean of the class goes 1 - exp(-increment / 2.5 s) of the way to
//!                                                       the window, and is never farther than 3 from where it was fitted
//! ```
//!
//! All of it happens in whitened space, where distances are Mahalanobis distances.

use super::Discriminant;

/// A window counts for a class with a posterior above this.
const CONFIDENT: f64 = 0.95;
/// A window that is farther from all classes than the person's limit counts for none.
const HIGHEST_NOVELTY: f64 = 1.0;
/// A mean goes 63 % of the way to windows that all say the same in so many seconds of confident windows of its class. It is a
/// time, so that it does not matter how often windows come.
const TIME_CONSTANT_S: f64 = 2.5;
/// Farthest that a mean may be from where it was fitted, as a Mahalanobis distance.
const LIMIT: f64 = 3.0;

/// Moves the means of a discriminant towards windows that it recognises surely. Keeps where they were fitted.
#[derive(Clone, Debug)]
pub struct SlowAdaptation {
    /// Classes x features: the whitened means as they were fitted.
    fitted: Vec<f64>,
    /// The mean of these.
    middle: Vec<f64>,
    /// Logarithm of the share of each class.
    shares_ln: Vec<f64>,
    /// How much of the way to a window a mean goes.
    share_of_way: f64,
}

impl SlowAdaptation {
    /// The adaptation of `discriminant`, to windows that come every `increment_s`.
    pub fn new(discriminant: &Discriminant, increment_s: f64) -> SlowAdaptation {
        SlowAdaptation {
            fitted: discriminant.whitened_means.clone(),
            middle: discriminant.whitened_middle(),
            shares_ln: discriminant.shares_ln(),
            share_of_way: -(-increment_s / TIME_CONSTANT_S).exp_m1(),
        }
    }

    /// Moves the mean of the class that a window surely is of, if it is of one. `posterior` and `whitened` are what
    /// [`Discriminant::posterior`] and [`Discriminant::distance`] wrote for the window, and `novelty` is that distance over the
    /// person's limit. Allocates nothing.
    ///
    /// # Panics
    ///
    /// When this was made for a discriminant with other classes or features.
    pub fn follow(&self, discriminant: &mut Discriminant, posterior: &[f64], whitened: &[f64], novelty: f64) {
        let confident = posterior.iter().position(|probability| *probability > CONFIDENT);
        let Some(class) = confident.filter(|_| novelty <= HIGHEST_NOVELTY) else { return };
        let count = discriminant.feature_count;
        let fitted = &self.fitted[class * count..][..count];
        let mean = &mut discriminant.whitened_means[class * count..][..count];
        let mut squared = 0.0;
        for ((mean, window), fitted) in mean.iter_mut().zip(whitened).zip(fitted) {
            *mean += self.share_of_way * (window - *mean);
            squared += (*mean - fitted).powi(2);
        }
        let beyond = squared.sqrt() / LIMIT;
        if beyond > 1.0 {
            mean.iter_mut().zip(fitted).for_each(|(mean, fitted)| *mean = fitted + (*mean - fitted) / beyond);
        }
        discriminant.lay_class(class, self.shares_ln[class], &self.middle);
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;
    use crate::{Class, MethodSettings, Training};

    const FEATURES: usize = 3;
    const CLASSES: usize = 2;

    /// Two classes of different shares about the means (0, 0, 0) and (8, 0, 0), with features that go together.
    fn discriminant() -> Discriminant {
        let mut random = 1_u32;
        let mut noise = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(random >> 8) / f64::from(1 << 24) - 0.5
        };
        let labels: Vec<usize> = (0..80).map(|window| window % CLASSES).collect();
        let features: Vec<f64> = labels
            .iter()
            .flat_map(|&label| {
                let common = noise();
                [8.0 * label as f64 + common, common + noise(), noise()]
            })
            .collect();
        let classes =
            [("rest", 2.0), ("fist", 1.0)].map(|(name, weight)| Class { name: name.to_owned(), weight });
        let training = Training {
            classes: &classes,
            feature_count: FEATURES,
            features: &features,
            labels: &labels,
            increment_s: 0.025,
            blocks: &[0; 80],
        };
        Discriminant::fit(&training, None, &MethodSettings::default()).expect("a fit")
    }

    /// Shows a window with this novelty; gives the posterior before.
    fn show(
        adaptation: &SlowAdaptation,
        discriminant: &mut Discriminant,
        features: &[f64],
        novelty: f64,
    ) -> [f64; CLASSES] {
        let (mut posterior, mut whitened) = ([0.0; CLASSES], [0.0; FEATURES]);
        discriminant.posterior(features, &mut posterior).expect("a posterior");
        discriminant.distance(features, &mut whitened).expect("a distance");
        adaptation.follow(discriminant, &posterior, &whitened, novelty);
        posterior
    }

    /// How far the mean of each class is from where it was fitted.
    fn moved(adaptation: &SlowAdaptation, discriminant: &Discriminant) -> Vec<f64> {
        let means = discriminant.whitened_means.chunks_exact(FEATURES);
        let apart = means.zip(adaptation.fitted.chunks_exact(FEATURES)).map(|(mean, fitted)| {
            mean.iter().zip(fitted).map(|(mean, fitted)| (mean - fitted).powi(2)).sum::<f64>().sqrt()
        });
        apart.collect()
    }

    #[test]
    fn a_mean_goes_to_where_the_windows_are_and_no_farther_than_the_limit() {
        let fitted = discriminant();
        let mut followed = fitted.clone();
        let adaptation = SlowAdaptation::new(&fitted, 0.025);
        // Fist is made a little elsewhere: its mean arrives there.
        let elsewhere = [8.0, 0.5, 0.0];
        let mut whitened = [0.0; FEATURES];
        let before = fitted.distance(&elsewhere, &mut whitened).expect("a distance");
        for _ in 0..1000 {
            show(&adaptation, &mut followed, &elsewhere, 1.0);
        }
        let after = followed.distance(&elsewhere, &mut whitened).expect("a distance");
        assert!(before > 1.0 && after < 0.01, "{before} {after}");
        assert_eq!(moved(&adaptation, &followed)[0], 0.0, "rest was not made");
        // Much farther away it stops at the limit.
        for _ in 0..1000 {
            show(&adaptation, &mut followed, &[8.0, 3.0, 0.0], 1.0);
        }
        assert!((moved(&adaptation, &followed)[1] - LIMIT).abs() < 1e-9);
    }

    #[test]
    fn unsure_and_strange_windows_move_nothing() {
        let fitted = discriminant();
        let mut followed = fitted.clone();
        let adaptation = SlowAdaptation::new(&fitted, 0.025);
        let fist = [8.0, 0.5, 0.0];
        show(&adaptation, &mut followed, &fist, 1.01);
        show(&adaptation, &mut followed, &fist, f64::NAN);
        adaptation.follow(&mut followed, &[0.06, 0.94], &[9.0; FEATURES], 0.5);
        assert_eq!(followed, fitted);
        adaptation.follow(&mut followed, &[0.04, 0.96], &[9.0; FEATURES], 0.5);
        assert_ne!(followed, fitted);
    }

    #[test]
    fn it_does_not_matter_how_often_windows_come() {
        let after_a_second = |windows: usize| {
            let fitted = discriminant();
            let mut followed = fitted.clone();
            let adaptation = SlowAdaptation::new(&fitted, 1.0 / windows as f64);
            for _ in 0..windows {
                show(&adaptation, &mut followed, &[8.0, 0.5, 0.0], 0.5);
            }
            moved(&adaptation, &followed)[1]
        };
        assert!(after_a_second(10) > 0.1);
        assert!((after_a_second(10) - after_a_second(40)).abs() < 1e-9);
    }

    #[test]
    fn the_posterior_follows_the_means() {
        let fitted = discriminant();
        let mut followed = fitted.clone();
        let adaptation = SlowAdaptation::new(&fitted, 0.025);
        for _ in 0..200 {
            show(&adaptation, &mut followed, &[8.0, 0.5, 0.3], 0.5);
        }
        let features = [4.0, 0.3, 0.1];
        let (mut posterior, mut whitened) = ([0.0; CLASSES], [0.0; FEATURES]);
        followed.posterior(&features, &mut posterior).expect("a posterior");
        followed.distance(&features, &mut whitened).expect("a distance");
        // Bayes' rule with normal densities of unit covariance about the whitened means.
        let density = |class: usize, share: f64| {
            let mean = &followed.whitened_means[class * FEATURES..][..FEATURES];
            let squared: f64 = mean.iter().zip(&whitened).map(|(mean, window)| (window - mean).powi(2)).sum();
            share.ln() - 0.5 * squared
        };
        let odds_ln = density(1, 1.0 / 3.0) - density(0, 2.0 / 3.0);
        assert!((posterior[1] - 1.0 / (1.0 + (-odds_ln).exp())).abs() < 1e-9, "{posterior:?} {odds_ln}");
    }

    proptest! {
        #[test]
        fn whatever_comes_no_mean_goes_beyond_the_limit(
            windows in vec((vec(-1e6_f64..1e6, FEATURES), 0.0_f64..2.0, 0.0_f64..1.0), 1..200),
            increment_s in 0.001_f64..10.0,
        ) {
            let mut followed = discriminant();
            let adaptation = SlowAdaptation::new(&followed, increment_s);
            for (mut features, novelty, scale) in windows {
                // Some of ordinary size, some far out.
                features.iter_mut().for_each(|feature| *feature *= 1e-5_f64.powf(scale));
                let posterior = show(&adaptation, &mut followed, &features, novelty);
                prop_assert!((posterior.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{posterior:?}");
                let moved = moved(&adaptation, &followed);
                prop_assert!(moved.iter().all(|moved| *moved <= LIMIT + 1e-9), "{moved:?}");
            }
        }
    }
}
