//! How long the chain works on a block: `cargo run --release -p tendon-signal --example work`.
#![allow(clippy::print_stdout)]

use std::time::Instant;

use tendon_signal::{SignalChain, SignalSettings};

fn main() -> Result<(), tendon_signal::DesignError> {
    const SAMPLES: usize = 10;
    const BLOCKS: usize = 20_000;
    println!("channels   p50    p99  p99.9    the one that ends calibration  (µs a block of {SAMPLES})");
    for channels in [4, 10, 64] {
        let mut chain = SignalChain::new(&SignalSettings::default(), channels, 2000.0)?;
        let mut window = vec![0.0; chain.window_len()];
        let mut block = vec![0.0_f32; channels * SAMPLES];
        let mut random = 1_u32;
        let mut work_us = Vec::with_capacity(BLOCKS);
        let mut calibration_us = 0.0;
        for _ in 0..BLOCKS {
            for sample in &mut block {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *sample = 30_000.0 + (random >> 20) as f32;
            }
            let was_calibrating = chain.baselines().is_none();
            let start = Instant::now();
            let Ok(_) = chain.push_block(&block, |chain, _, _| {
                chain.write_window(&mut window);
                Ok::<(), std::convert::Infallible>(())
            });
            work_us.push(start.elapsed().as_secs_f64() * 1e6);
            if was_calibrating && chain.baselines().is_some() {
                calibration_us = work_us.pop().unwrap_or_default();
            }
        }
        work_us.sort_by(f64::total_cmp);
        let [p50, p99, p999] =
            [0.5, 0.99, 0.999].map(|share| work_us[(work_us.len() as f64 * share) as usize]);
        println!("{channels:8} {p50:5.2} {p99:6.2} {p999:6.2} {calibration_us:12.0}");
    }
    Ok(())
}
