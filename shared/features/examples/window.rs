//! How long one window takes: `cargo run --release -p tendon-features --example window`.
#![allow(clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use tendon_features::{Class, CrossValidation, Discriminant, LaggedLogCovariance, MethodSettings, Training};

const SAMPLES: usize = 600;
/// From one window of a stream to the next.
const INCREMENT: usize = 50;
const CLASSES: usize = 6;
/// Windows of a minute: 5 s of six gestures and as much rest, every 75 ms.
const CALIBRATION: usize = 66 * CLASSES;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!(
        "µs a window of {SAMPLES} samples, p50 (p99), alone and every {INCREMENT} samples               fit, held out (s)"
    );
    println!("channels  rows  features            alone        in stream        posterior         distance");
    let settings = MethodSettings::default();
    for channels in [4, 8, 10, 64] {
        let mut random = 1_u32;
        let mut window = |class: usize| -> Vec<f32> {
            let samples = channels * SAMPLES;
            let mut noise = vec![0.0_f32; samples + 3];
            for value in &mut noise {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *value = (random >> 8) as f32 / (1 << 24) as f32 - 0.5;
            }
            let gain = |at: usize| if at / SAMPLES % CLASSES == class { 200.0 } else { 50.0 };
            (0..samples).map(|at| gain(at) * noise[at..at + 4].iter().sum::<f32>()).collect()
        };
        let mut covariance =
            LaggedLogCovariance::new(&settings, channels, 2000.0, 1.0)?.with_increment(SAMPLES, INCREMENT);
        let feature_count = covariance.feature_count();
        let labels: Vec<usize> = (0..CALIBRATION).map(|number| number % CLASSES).collect();
        let blocks: Vec<usize> = (0..CALIBRATION).map(|number| number * 4 / CALIBRATION).collect();
        let windows: Vec<Vec<f32>> = labels.iter().map(|&label| window(label)).collect();
        let mut features = vec![0.0; CALIBRATION * feature_count];
        for (window, features) in windows.iter().zip(features.chunks_exact_mut(feature_count)) {
            covariance.compute(window, features)?;
        }
        let classes: Vec<Class> =
            (0..CLASSES).map(|class| Class { name: class.to_string(), weight: 1.0 }).collect();
        let training = Training {
            classes: &classes,
            feature_count,
            features: &features,
            labels: &labels,
            increment_s: 0.075,
            blocks: &blocks,
        };
        let start = Instant::now();
        let discriminant = Discriminant::fit(&training, None, &settings)?;
        let fit_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let temperature = CrossValidation::new(&training, None, &settings)?.temperature(&settings);
        let held_out_s = start.elapsed().as_secs_f64();
        let discriminant = discriminant.with_temperature(temperature)?;

        let repetitions = if channels == 64 { 1000 } else { 20_000 };
        let [mut alone_us, mut stream_us, mut posterior_us, mut distance_us] = [(); 4].map(|()| Vec::new());
        let (mut features, mut whitened) = (vec![0.0; feature_count], vec![0.0; feature_count]);
        let mut posterior = vec![0.0; CLASSES];
        for (number, window) in windows.iter().cycle().take(repetitions).enumerate() {
            let start = Instant::now();
            covariance.compute(black_box(window), &mut features)?;
            alone_us.push(start.elapsed().as_secs_f64() * 1e6);
            // What the other pieces hold does not matter: they are not looked at.
            let start = Instant::now();
            covariance.compute_next(black_box(window), (number * INCREMENT) as u64, &mut features)?;
            stream_us.push(start.elapsed().as_secs_f64() * 1e6);
            let start = Instant::now();
            discriminant.posterior(black_box(&features), &mut posterior)?;
            posterior_us.push(start.elapsed().as_secs_f64() * 1e6);
            let start = Instant::now();
            black_box(discriminant.distance(black_box(&features), &mut whitened)?);
            distance_us.push(start.elapsed().as_secs_f64() * 1e6);
        }
        print!("{channels:8} {:5} {feature_count:9}", covariance.rows());
        for mut work_us in [alone_us, stream_us, posterior_us, distance_us] {
            work_us.sort_by(f64::total_cmp);
            let [p50, p99] = [0.5, 0.99].map(|share| work_us[(work_us.len() as f64 * share) as usize]);
            print!(" {p50:7.1} ({p99:6.1})");
        }
        println!(" {fit_s:8.3} {held_out_s:8.3}");
    }
    Ok(())
}
