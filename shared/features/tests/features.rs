//! What holds for the features of any window.

use proptest::collection::vec;
use proptest::prelude::*;
use tendon_features::{FeatureError, LaggedLogCovariance, MethodSettings, rest_floor};

fn features_of(channels: usize, floor_variance: f64, window: &[f32]) -> Result<Vec<f64>, FeatureError> {
    let mut covariance =
        LaggedLogCovariance::new(&MethodSettings::default(), channels, 2000.0, floor_variance)?;
    let mut features = vec![0.0; covariance.feature_count()];
    covariance.compute(window, &mut features)?;
    Ok(features)
}

/// Index of the diagonal's features.
fn diagonal(rows: usize) -> Vec<usize> {
    (0..rows).scan(0, |at, row| Some(std::mem::replace(at, *at + rows - row))).collect()
}

fn windows(value: impl Strategy<Value = f32> + 'static) -> impl Strategy<Value = (usize, Vec<f32>)> {
    let value = value.boxed();
    (1_usize..12, 13_usize..300).prop_flat_map(move |(channels, samples)| {
        vec(value.clone(), channels * samples).prop_map(move |window| (channels, window))
    })
}

/// All magnitudes of `f32`, and now and then one that is not finite.
fn any_number() -> impl Strategy<Value = f32> {
    let finite =
        any::<u32>().prop_map(f32::from_bits).prop_map(|value| if value.is_finite() { value } else { 0.0 });
    prop_oneof![2000 => finite, 1 => Just(f32::NAN), 1 => Just(f32::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// log(c² C) = log C + 2 ln c · 1, to 3e-5: the scaled samples are rounded to `f32` again, which the
    /// smallest eigenvalues, a thousandth of the mean, feel most.
    #[test]
    fn another_unit_shifts_the_diagonal_alone((channels, window) in windows(-500.0_f32..500.0), power in -9..6) {
        let unit = 10_f64.powi(power);
        let scaled: Vec<f32> = window.iter().map(|&sample| (f64::from(sample) * unit) as f32).collect();
        let mut expected = features_of(channels, 0.5, &window).expect("features");
        let rows = (((8 * expected.len() + 1) as f64).sqrt() as usize - 1) / 2;
        diagonal(rows).into_iter().for_each(|at| expected[at] += 2.0 * unit.ln());
        let features = features_of(channels, 0.5 * unit * unit, &scaled).expect("features");
        for (ours, expected) in features.iter().zip(&expected) {
            prop_assert!((ours - expected).abs() < 3e-5, "{ours} is not {expected}");
        }
    }

    /// Exchanged electrodes of every bipolar pair are the same person.
    #[test]
    fn a_window_turned_upside_down_has_the_same_features((channels, window) in windows(-500.0_f32..500.0)) {
        let turned: Vec<f32> = window.iter().map(|sample| -sample).collect();
        prop_assert_eq!(features_of(channels, 0.5, &window), features_of(channels, 0.5, &turned));
    }

    /// Any numbers at all: features that are finite, or the error that says why not.
    #[test]
    fn no_window_makes_it_panic((channels, window) in windows(any_number())) {
        let finite = window.iter().all(|sample| sample.is_finite());
        match features_of(channels, 0.5, &window) {
            Ok(features) => {
                prop_assert!(finite);
                prop_assert!(features.iter().all(|feature| feature.is_finite()));
            }
            Err(error) => {
                prop_assert_eq!(error, FeatureError::NotFinite);
                prop_assert!(!finite);
            }
        }
    }

    /// Without delays, the order of the samples in a piece does not matter.
    #[test]
    fn samples_in_another_order_have_the_same_features((channels, window) in windows(-500.0_f32..500.0), turn in 1_usize..12) {
        let samples = window.len() / channels;
        let mut turned = window.clone();
        turned.chunks_exact_mut(samples).for_each(|channel| channel.rotate_left(turn));
        let settings =
            MethodSettings { delays_ms: vec![0.0], piece_ms: 10_000.0, ..MethodSettings::default() };
        let mut covariance = LaggedLogCovariance::new(&settings, channels, 2000.0, 0.5).expect("valid");
        let mut first = vec![0.0; covariance.feature_count()];
        let mut second = first.clone();
        covariance.compute(&window, &mut first).expect("features");
        covariance.compute(&turned, &mut second).expect("features");
        for (first, second) in first.iter().zip(&second) {
            prop_assert!((first - second).abs() < 1e-9);
        }
    }

    /// Windows of a stream, with gaps and repeats, have the features of each window alone, to the bit, whether the
    /// increment divides the pieces (50, 75, 150) or not (40).
    #[test]
    fn windows_of_a_stream_have_the_features_of_each_alone(
        signal in vec(-500.0_f32..500.0, 2 * 1500),
        increment in prop_oneof![Just(50_usize), Just(75), Just(150), Just(40)],
        jumps in vec(prop_oneof![8 => Just(1_usize), 1 => Just(0), 1 => Just(2), 1 => Just(5)], 20),
        offset in prop_oneof![Just(0_u64), 1_u64..1000, Just(u64::MAX - 1300)],
    ) {
        const WINDOW: usize = 300;
        let settings = MethodSettings::default();
        let mut stream = LaggedLogCovariance::new(&settings, 2, 2000.0, 0.5)
            .expect("valid")
            .with_increment(WINDOW, increment);
        let mut alone = LaggedLogCovariance::new(&settings, 2, 2000.0, 0.5).expect("valid");
        let mut features = vec![0.0; alone.feature_count()];
        let mut expected = features.clone();
        let mut at = 0;
        for jump in jumps {
            at = (at + jump * increment) % (1500 - WINDOW);
            let window = [&signal[at..at + WINDOW], &signal[1500 + at..1500 + at + WINDOW]].concat();
            stream.compute_next(&window, offset + at as u64, &mut features).expect("features");
            alone.compute(&window, &mut expected).expect("features");
            prop_assert_eq!(&features, &expected);
        }
    }

    /// Channels in another order are the same features in another order.
    #[test]
    fn exchanged_channels_exchange_features(window in vec(-500.0_f32..500.0, 2 * 100)) {
        let exchanged = [&window[100..], &window[..100]].concat();
        let mut settings = MethodSettings::default();
        settings.delays_ms.truncate(1);
        let mut covariance = LaggedLogCovariance::new(&settings, 2, 2000.0, 0.5).expect("valid");
        let (mut first, mut second) = ([0.0; 3], [0.0; 3]);
        covariance.compute(&window, &mut first).expect("features");
        covariance.compute(&exchanged, &mut second).expect("features");
        second.swap(0, 2);
        for (first, second) in first.iter().zip(&second) {
            prop_assert!((first - second).abs() < 1e-9);
        }
    }
}

/// What was computed for an earlier window is not computed again: changed samples go unnoticed, except in the newest
/// piece. After a gap, and in a window that is not part of the stream, they count.
#[test]
fn a_window_of_a_stream_computes_its_newest_piece_only() {
    let mut random = 1_u32;
    let mut signal = Vec::new();
    signal.resize_with(1000, || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (random >> 8) as f32 / (1 << 24) as f32 - 0.5
    });
    let mut stream = LaggedLogCovariance::new(&MethodSettings::default(), 1, 2000.0, 1e-3)
        .expect("valid")
        .with_increment(300, 50);
    let mut features = vec![0.0; stream.feature_count()];
    for first_sample in [0, 50, 100] {
        let window = &signal[first_sample..first_sample + 300];
        stream.compute_next(window, first_sample as u64, &mut features).expect("features");
    }
    let mut alone = features.clone();
    stream.compute(&signal[150..450], &mut alone).expect("features");
    signal[160] += 1.0;
    stream.compute_next(&signal[150..450], 150, &mut features).expect("features");
    assert_eq!(features, alone, "the first piece is that of the first window");
    signal[360] += 1.0;
    stream.compute_next(&signal[200..500], 200, &mut features).expect("features");
    stream.compute(&signal[200..500], &mut alone).expect("features");
    assert_eq!(features, alone, "the newest piece is computed");
    signal[460] += 1.0;
    stream.compute_next(&signal[300..600], 300, &mut features).expect("features");
    stream.compute(&signal[300..600], &mut alone).expect("features");
    assert_eq!(features, alone, "a window is missing in between");
}

/// Magnitudes at both ends of what `f32` holds, beside each other and alone.
#[test]
fn extreme_windows_have_finite_features() {
    for (first, second) in [
        (0.0, 0.0),
        (f32::MAX, f32::MAX),
        (f32::MAX, 0.0),
        (f32::MAX, f32::from_bits(1)),
        (f32::from_bits(1), f32::from_bits(1)),
        (1.0, 1.0),
    ] {
        for floor_variance in [f64::MIN_POSITIVE, 1.0, 1e300] {
            let window: Vec<f32> = (0..200).map(|i| if i < 100 { first } else { second }).collect();
            let features = features_of(2, floor_variance, &window).expect("features");
            assert!(features.iter().all(|feature| feature.is_finite()), "{first} {second} {floor_variance}");
        }
    }
}

#[test]
fn a_sample_that_is_not_finite_is_an_error_wherever_it_is() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for at in 0..4 * 40 {
            let mut window: Vec<f32> = (0..4 * 40).map(|i| (i * i % 17) as f32 - 8.0).collect();
            window[at] = bad;
            assert_eq!(features_of(4, 0.5, &window), Err(FeatureError::NotFinite), "{bad} at {at}");
        }
    }
}

#[test]
fn delays_fit_the_rows_and_the_rate() {
    let delays = |channels, rate_hz| {
        let covariance =
            LaggedLogCovariance::new(&MethodSettings::default(), channels, rate_hz, 1.0).expect("valid");
        (covariance.delays_ms().to_vec(), covariance.rows())
    };
    assert_eq!(delays(4, 2000.0), (vec![0.0, 1.0, 2.0, 3.0], 16));
    assert_eq!(delays(8, 2000.0), (vec![0.0, 1.0, 2.0, 3.0], 32));
    assert_eq!(delays(10, 2000.0), (vec![0.0, 1.0, 2.0], 30));
    assert_eq!(delays(64, 2000.0), (vec![0.0], 64));
    // 1 and 2 ms are no sample apart from 0 at 200 Hz.
    assert_eq!(delays(4, 200.0), (vec![0.0, 3.0], 8));
}

#[test]
fn what_does_not_fit_is_refused() {
    let settings = MethodSettings::default();
    let refused = |channels, rate_hz, floor_variance| {
        LaggedLogCovariance::new(&settings, channels, rate_hz, floor_variance).expect_err("out of range")
    };
    assert_eq!(refused(0, 2000.0, 1.0), FeatureError::Channels(0));
    assert_eq!(refused(4, 0.0, 1.0), FeatureError::Rate(0.0));
    assert!(matches!(refused(4, f64::NAN, 1.0), FeatureError::Rate(_)));
    assert_eq!(refused(4, 2000.0, 0.0), FeatureError::Floor(0.0));
    let mut covariance = LaggedLogCovariance::new(&settings, 4, 2000.0, 1.0).expect("valid");
    let mut features = [0.0; 136];
    assert_eq!(
        covariance.compute(&[0.0; 4 * 12], &mut features),
        Err(FeatureError::TooShort { samples: 12, needed: 13 })
    );
    assert_eq!(
        covariance.compute(&[0.0; 41], &mut features),
        Err(FeatureError::Window { values: 41, channels: 4 })
    );
    assert_eq!(
        covariance.compute(&[0.0; 80], &mut features[1..]),
        Err(FeatureError::Length { given: 135, needed: 136 })
    );
}

#[test]
fn the_floor_is_a_share_of_the_rest_in_any_unit() {
    let settings = MethodSettings::default();
    // Two channels at rest, and one window with a twitch.
    let rest = |unit: f32| vec![unit; 200];
    for unit in [1e-3, 1.0, 1e3] {
        let twitch = rest(100.0 * unit);
        let windows = [rest(unit), rest(unit), twitch, rest(unit)];
        let floor = rest_floor(&settings, 2, windows.iter().map(Vec::as_slice)).expect("a floor");
        let expected = settings.rest_floor_share * f64::from(unit * unit);
        assert!((floor / expected - 1.0).abs() < 1e-6, "{floor} is not {expected}");
    }
    for flat in [vec![0.0; 200], vec![f32::NAN; 200]] {
        assert_eq!(rest_floor(&settings, 2, [flat.as_slice()]), Err(FeatureError::FlatRest));
    }
    assert_eq!(rest_floor(&settings, 2, []), Err(FeatureError::FlatRest));
    assert_eq!(
        rest_floor(&settings, 2, [[1.0; 3].as_slice()]),
        Err(FeatureError::Window { values: 3, channels: 2 })
    );
}
