//! Once constructed and fitted, a window allocates nothing. Alone in its file: the allocator counts for the
//! whole process.

use tendon_counting_allocator::allocations;
use tendon_features::{Class, Discriminant, LaggedLogCovariance, MethodSettings, Training};

#[test]
fn a_window_allocates_nothing() {
    for channels in [1, 4, 10, 64] {
        let mut random = 1_u32;
        let mut window = |samples: usize, gain: f32| -> Vec<f32> {
            let noise = std::iter::repeat_with(|| {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                gain * ((random >> 8) as f32 / (1 << 24) as f32 - 0.5)
            });
            noise.take(channels * samples).collect()
        };
        let before_construction = allocations();
        let settings = MethodSettings::default();
        let mut covariance = LaggedLogCovariance::new(&settings, channels, 2000.0, 1e-3)
            .expect("valid")
            .with_increment(600, 50);
        let feature_count = covariance.feature_count();
        let mut features = vec![0.0; 12 * feature_count];
        for (number, features) in features.chunks_exact_mut(feature_count).enumerate() {
            covariance.compute(&window(600, if number < 6 { 1.0 } else { 5.0 }), features).expect("features");
        }
        let classes = ["rest", "fist"].map(|name| Class { name: name.to_owned(), weight: 1.0 });
        let labels: Vec<usize> = (0..12).map(|number| number / 6).collect();
        let training = Training {
            classes: &classes,
            feature_count,
            features: &features,
            labels: &labels,
            increment_s: 0.075,
            blocks: &labels,
        };
        let discriminant = Discriminant::fit(&training, None, &settings).expect("a fit");
        assert!(allocations() > before_construction, "the counter counts");

        let mut bad = window(600, 1.0);
        bad[300] = f32::NAN;
        let windows = [window(600, 1.0), window(600, 5.0), window(200, 5.0), window(13, 0.0), bad];
        let (mut features, mut whitened) = (vec![0.0; feature_count], vec![0.0; feature_count]);
        let (mut posterior, mut recognised, mut refused) = ([0.0; 2], 0, 0);
        let before = allocations();
        for window in &windows {
            for first_sample in [0, 50, 100, 150, 200, 1000] {
                // Its result is that of the window alone.
                let _ = covariance.compute_next(window, first_sample, &mut features);
            }
            match covariance.compute(window, &mut features) {
                Ok(()) => {
                    let done = discriminant
                        .posterior(&features, &mut posterior)
                        .and_then(|()| discriminant.distance(&features, &mut whitened));
                    recognised += usize::from(done.is_ok());
                }
                Err(_) => refused += 1,
            }
        }
        assert_eq!(allocations() - before, 0, "{channels} channels");
        assert_eq!((recognised, refused), (4, 1));
    }
}
