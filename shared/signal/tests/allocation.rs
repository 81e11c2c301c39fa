//! Once constructed and calibrated, the chain allocates nothing. Alone in its file: the allocator counts for
//! the whole process.

use tendon_counting_allocator::allocations;
use tendon_signal::{Activity, ActivitySettings, Resampler, SignalChain, SignalSettings};

#[test]
fn pushing_blocks_allocates_nothing() {
    let before_construction = allocations();
    let settings = SignalSettings {
        activity: ActivitySettings { calibration_s: 0.5, ..ActivitySettings::default() },
        ..SignalSettings::default()
    };
    let mut chain = SignalChain::new(&settings, 4, 2000.0).expect("a chain");
    let mut resampler = Resampler::new(2, 1, 4).expect("a resampler");
    let mut resampled = Vec::with_capacity(10 * 4);
    let mut window = vec![0.0; chain.window_len()];
    assert!(allocations() > before_construction, "the counter counts");

    // Through calibration, rest, movement, bad samples and a gap.
    let (mut windows, mut moved, mut replaced) = (0, false, 0);
    let mut random = 1_u32;
    let before = allocations();
    for number in 0..600 {
        let mut block = [0.0_f32; 4 * 10];
        for sample in &mut block {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (random >> 8) as f32 / (1 << 24) as f32 - 0.5;
            *sample = if number < 300 { noise } else { 20.0 * noise };
        }
        if number == 200 {
            block[13] = f32::NAN;
        }
        if number == 500 {
            chain.gap(1);
        }
        let mut from = 0;
        while from < 10 {
            let push = chain.push(&block, from);
            from += push.consumed;
            moved |= push.activity == Activity::Move;
            replaced += push.replaced_samples;
            if push.window.is_some() {
                chain.write_window(&mut window);
                windows += 1;
            }
        }
        resampled.clear();
        resampler.process(&block[..5 * 4], &mut resampled);
    }
    assert_eq!(allocations() - before, 0);
    assert!(windows > 0 && moved && replaced == 1, "{windows} windows, moved {moved}, {replaced} replaced");
}
