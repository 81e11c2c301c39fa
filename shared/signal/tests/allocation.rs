//! Once constructed and calibrated, the chain allocates nothing. Alone in its file: the allocator counts for
//! the whole process.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use tendon_signal::{Activity, ActivitySettings, Resampler, SignalChain, SignalSettings};

struct CountingAllocator;

thread_local! {
    /// Of this thread alone: the test harness allocates on its own.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system's allocator as it came; the counter is a plain thread-local
// that neither allocates nor has a destructor.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller keeps to the contract of `GlobalAlloc`, which is that of `System`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above; `pointer` came from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

#[test]
fn pushing_blocks_allocates_nothing() {
    let before_construction = ALLOCATIONS.get();
    let settings = SignalSettings {
        activity: ActivitySettings { calibration_s: 0.5, ..ActivitySettings::default() },
        ..SignalSettings::default()
    };
    let mut chain = SignalChain::new(&settings, 4, 2000.0).expect("a chain");
    let mut resampler = Resampler::new(2, 1, 4).expect("a resampler");
    let mut resampled = Vec::with_capacity(10 * 4);
    let mut window = vec![0.0; chain.window_len()];
    assert!(ALLOCATIONS.get() > before_construction, "the counter counts");

    // Through calibration, rest, movement, bad samples and a gap.
    let (mut windows, mut moved, mut replaced) = (0, false, 0);
    let mut random = 1_u32;
    let before = ALLOCATIONS.get();
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
    assert_eq!(ALLOCATIONS.get() - before, 0);
    assert!(windows > 0 && moved && replaced == 1, "{windows} windows, moved {moved}, {replaced} replaced");
}
