//! Features, shrinkage and discriminant against NumPy, SciPy and scikit-learn: `golden/make_golden.py` made
//! the vectors.

use nalgebra::DMatrix;
use serde::Deserialize;
use tendon_features::{
    Class, CrossValidation, Discriminant, FeatureLayout, GestureMeans, LaggedLogCovariance, MethodSettings,
    Population, Prior, Training, WithinClassScatter, ledoit_wolf,
};

#[derive(Deserialize)]
struct Golden {
    features: Vec<Features>,
    ledoit_wolf: Vec<LedoitWolf>,
    discriminant: Discriminants,
}

#[derive(Deserialize)]
struct Features {
    channels: usize,
    delays_ms: Vec<f64>,
    rate_hz: f64,
    floor_variance: f64,
    window: Vec<f32>,
    features: Vec<f64>,
}

#[derive(Deserialize)]
struct LedoitWolf {
    feature_count: usize,
    centred: Vec<f64>,
    shrinkage: f64,
    covariance: Vec<f64>,
}

#[derive(Deserialize)]
struct Discriminants {
    weights: Vec<f64>,
    feature_count: usize,
    features: Vec<f64>,
    labels: Vec<usize>,
    blocks: Vec<usize>,
    others: Vec<f64>,
    scored: Vec<f64>,
    temperature: f64,
    increment_s: f64,
    people: Vec<Person>,
    fits: Vec<Fit>,
}

#[derive(Deserialize)]
struct Person {
    features: Vec<f64>,
    labels: Vec<usize>,
    blocks: Vec<usize>,
}

#[derive(Deserialize)]
struct Fit {
    prior_s: f64,
    has_population: bool,
    shrinkage: f64,
    posteriors: Vec<f64>,
    distances: Vec<f64>,
    best_temperature: f64,
    log_loss_at_1: f64,
    log_loss_at_best: f64,
    confusion: Vec<Vec<usize>>,
}

fn golden() -> Golden {
    serde_json::from_str(include_str!("golden/golden.json")).expect("the golden file")
}

/// To `tolerance` of the reference's largest value.
fn assert_close(ours: &[f64], reference: &[f64], tolerance: f64, what: &str) {
    assert_eq!(ours.len(), reference.len(), "{what}");
    let largest = reference.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    assert!(largest > 0.0, "{what}: an empty reference");
    for (at, (ours, reference)) in ours.iter().zip(reference).enumerate() {
        let error = (ours - reference).abs() / largest;
        assert!(error <= tolerance, "{what}: value {at} is {ours}, not {reference}: off by {error:e}");
    }
}

/// To 1e-11 of the largest feature; SciPy's `logm` says of itself that it is off by 2e-13.
#[test]
fn features_are_those_of_scipy() {
    for case in golden().features {
        let settings = MethodSettings { delays_ms: case.delays_ms, ..MethodSettings::default() };
        let mut covariance =
            LaggedLogCovariance::new(&settings, case.channels, case.rate_hz, case.floor_variance)
                .expect("valid settings");
        let mut features = vec![0.0; covariance.feature_count()];
        covariance.compute(&case.window, &mut features).expect("features");
        let what = format!("{} channels at {} Hz", case.channels, case.rate_hz);
        assert_close(&features, &case.features, 1e-11, &what);
    }
}

/// To 1e-12 of the largest element.
#[test]
fn shrinkage_is_that_of_scikit_learn() {
    for case in golden().ledoit_wolf {
        let windows = case.centred.len() / case.feature_count;
        let shrunk = ledoit_wolf(&DMatrix::from_column_slice(case.feature_count, windows, &case.centred));
        assert_close(&[shrunk.shrinkage], &[case.shrinkage], 1e-12, "shrinkage");
        assert_close(shrunk.covariance.as_slice(), &case.covariance, 1e-12, "covariance");
    }
}

/// Posteriors, distances and the log-loss at 1 to 1e-9, the best temperature to 1e-4 (the minimum is flat), and so the
/// log-loss there to 1e-6.
#[test]
fn discriminants_are_those_of_numpy() {
    let golden = golden().discriminant;
    let classes: Vec<Class> = ["rest", "flexion", "extension"]
        .into_iter()
        .zip(&golden.weights)
        .map(|(name, &weight)| Class { name: name.to_owned(), weight })
        .collect();
    let training = Training {
        classes: &classes,
        feature_count: golden.feature_count,
        features: &golden.features,
        labels: &golden.labels,
        increment_s: golden.increment_s,
        blocks: &golden.blocks,
    };
    let windows = vec![0; golden.others.len() / golden.feature_count];
    let others = Training { features: &golden.others, labels: &windows, blocks: &windows, ..training };
    let scatter = WithinClassScatter::new(&others).expect("a scatter");
    // Six features are those of three rows.
    let layout = FeatureLayout {
        channels: 3,
        delays_ms: vec![0.0],
        lowest_rate_hz: 1000.0,
        highest_rate_hz: 1000.0,
        piece_ms: 75.0,
    };
    let prior = Prior::pool(layout, [("others", &scatter)]).expect("a prior");
    let people: Vec<GestureMeans> = golden
        .people
        .iter()
        .map(|Person { features, labels, blocks }| {
            GestureMeans::new(&Training { features, labels, blocks, ..training }).expect("means")
        })
        .collect();
    let population = Population::pool(&people).expect("a population");
    let with_population = prior.clone().with_population(population).expect("of the same features");

    for fit in golden.fits {
        let settings = MethodSettings {
            prior_s: fit.prior_s,
            temperature_range: [0.01, 1000.0],
            ..MethodSettings::default()
        };
        let prior = if fit.has_population { &with_population } else { &prior };
        let prior = (fit.prior_s > 0.0).then_some(prior);
        let what = format!("prior {} s, population {}", fit.prior_s, fit.has_population);
        let discriminant = Discriminant::fit(&training, prior, &settings)
            .and_then(|discriminant| discriminant.with_temperature(golden.temperature))
            .expect("a fit");
        let (mut posteriors, mut distances) = (Vec::new(), Vec::new());
        for window in golden.scored.chunks_exact(golden.feature_count) {
            let (mut posterior, mut whitened) = ([0.0; 3], vec![0.0; golden.feature_count]);
            discriminant.posterior(window, &mut posterior).expect("a posterior");
            posteriors.extend(posterior);
            distances.push(discriminant.distance(window, &mut whitened).expect("a distance"));
        }
        assert_close(&[discriminant.shrinkage()], &[fit.shrinkage], 1e-12, &what);
        assert_close(&posteriors, &fit.posteriors, 1e-9, &what);
        assert_close(&distances, &fit.distances, 1e-9, &what);

        let validation = CrossValidation::new(&training, prior, &settings).expect("a validation");
        let temperature = validation.temperature(&settings);
        assert_eq!(validation.confusion(|_| true), fit.confusion, "{what}");
        assert_close(&[validation.log_loss(1.0)], &[fit.log_loss_at_1], 1e-9, &what);
        assert_close(&[validation.log_loss(temperature)], &[fit.log_loss_at_best], 1e-6, &what);
        assert_close(&[temperature], &[fit.best_temperature], 1e-4, &what);
    }
}
