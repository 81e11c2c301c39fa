//! How long the chain works on a block: `cargo run --release -p tendon-signal --example work`.
#![allow(clippy::print_stdout)]

use std::time::Instant;

use tendon_signal::{SignalChain, SignalSettings};

fn main() -> Result<(), tendon_signal::DesignError> {
    const SAMPLES: usize = 10;
    const BLOCKS: usize = 20_000;
    println!("channels  block of {SAMPLES}: p50    p99    max  (µs, calibration and windows included)");
    for channels in [4, 10, 64] {
        let mut chain = SignalChain::new(&SignalSettings::default(), channels, 2000.0)?;
        let mut window = vec![0.0; chain.window_len()];
        let mut block = vec![0.0_f32; channels * SAMPLES];
        let mut random = 1_u32;
        let mut work_us = Vec::with_capacity(BLOCKS);
        for _ in 0..BLOCKS {
            for sample in &mut block {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *sample = 30_000.0 + (random >> 20) as f32;
            }
            let start = Instant::now();
            let mut from = 0;
            while from < SAMPLES {
                let push = chain.push(&block, from);
                from += push.consumed;
                if push.window.is_some() {
                    chain.write_window(&mut window);
                }
            }
            work_us.push(start.elapsed().as_secs_f64() * 1e6);
        }
        work_us.sort_by(f64::total_cmp);
        let (p50, p99, max) = (work_us[BLOCKS / 2], work_us[BLOCKS * 99 / 100], work_us[BLOCKS - 1]);
        println!("{channels:8}  {p50:16.2} {p99:6.2} {max:6.1}");
    }
    Ok(())
}
