//! What the chain promises whatever it is fed.

use proptest::collection::vec;
use proptest::prelude::*;
use tendon_signal::{Activity, ActivitySettings, SignalChain, SignalSettings, Window, WindowSettings};

const CHANNELS: usize = 3;
const RATE_HZ: f64 = 500.0;

fn settings() -> SignalSettings {
    SignalSettings {
        activity: ActivitySettings { calibration_s: 0.2, ..ActivitySettings::default() },
        windows: WindowSettings { window_samples: 60, increment_samples: 25 },
        ..SignalSettings::default()
    }
}

/// A window with the bits of its samples, so that equal means equal.
type Seen = (Window, Vec<u32>);

/// Pushes `recording`, one vector of [`CHANNELS`] samples a time, in blocks of the given lengths, again and
/// again.
fn windows_of(recording: &[[f32; CHANNELS]], lengths: &[usize]) -> Vec<Seen> {
    let mut chain = SignalChain::new(&settings(), CHANNELS, RATE_HZ).expect("a chain");
    let mut seen = Vec::new();
    let mut start = 0;
    for &length in lengths.iter().cycle() {
        let end = recording.len().min(start + length);
        push(&mut chain, &recording[start..end], &mut seen);
        start = end;
        if start == recording.len() {
            return seen;
        }
    }
    seen
}

fn push(chain: &mut SignalChain, part: &[[f32; CHANNELS]], seen: &mut Vec<Seen>) {
    let block: Vec<f32> =
        (0..CHANNELS).flat_map(|channel| part.iter().map(move |sample| sample[channel])).collect();
    let mut from = 0;
    while from < part.len() {
        let push = chain.push(&block, from);
        assert!(push.consumed > 0);
        from += push.consumed;
        if let Some(window) = push.window {
            let mut samples = vec![0.0_f32; chain.window_len()];
            chain.write_window(&mut samples);
            seen.push((window, samples.iter().map(|sample| sample.to_bits()).collect()));
        }
    }
}

/// Mostly noise around an offset, with faults in between.
fn sample() -> impl Strategy<Value = f32> {
    prop_oneof![
        200 => (-100.0_f32..100.0).prop_map(|noise| 3000.0 + noise),
        100 => Just(3000.0),
        1 => Just(f32::NAN),
        1 => Just(f32::NEG_INFINITY),
        1 => Just(f32::MAX),
        1 => Just(-0.0),
        1 => Just(1e-40),
    ]
}

fn recording() -> impl Strategy<Value = Vec<[f32; CHANNELS]>> {
    vec(prop::array::uniform3(sample()), 200..500)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn windows_do_not_depend_on_how_the_samples_are_cut(
        recording in recording(),
        lengths in vec(1_usize..150, 1..6),
    ) {
        let whole = windows_of(&recording, &[recording.len()]);
        prop_assert_eq!(whole.len(), 1 + (recording.len() - 60) / 25);
        prop_assert_eq!(&windows_of(&recording, &lengths), &whole);
        prop_assert_eq!(&windows_of(&recording, &[1]), &whole);
    }

    #[test]
    fn bad_samples_are_counted_in_every_window_they_are_in_and_never_come_out(recording in recording()) {
        let bad = |sample: &f32| sample.is_nan() || sample.abs() > 1e12;
        for (window, samples) in windows_of(&recording, &[40]) {
            let start = window.first_sample as usize;
            let inside = recording[start..start + 60].iter().flatten().filter(|sample| bad(sample)).count();
            prop_assert_eq!(window.replaced_samples as usize, inside);
            prop_assert!(samples.iter().all(|&bits| f32::from_bits(bits).is_finite()));
        }
    }
}

#[test]
fn no_window_spans_a_gap_and_numbers_count_the_lost_samples() {
    let noise = |n: usize| [(n * 37 % 11) as f32, (n * 53 % 17) as f32, (n * 29 % 13) as f32];
    let recording: Vec<_> = (0..200).map(noise).collect();
    let mut chain = SignalChain::new(&settings(), CHANNELS, RATE_HZ).expect("a chain");
    let mut seen = Vec::new();
    push(&mut chain, &recording[..100], &mut seen);
    chain.gap(1000);
    push(&mut chain, &recording[100..], &mut seen);
    let starts: Vec<u64> = seen.iter().map(|(window, _)| window.first_sample).collect();
    assert_eq!(starts, [0, 25, 1100, 1125]);
}

#[test]
fn activity_goes_from_calibration_to_rest_to_move_and_back_and_a_gap_ends_a_movement() {
    let mut chain = SignalChain::new(&settings(), CHANNELS, RATE_HZ).expect("a chain");
    let mut time = 0_usize;
    let mut push = |chain: &mut SignalChain, samples: usize, amplitude: f32| {
        let mut activity = None;
        for _ in 0..samples {
            // 100 Hz with an amplitude that varies, so that rest has a spread.
            let wave = (time as f32 * 1.2566).sin() * amplitude * (1.0 + 0.2 * (time as f32 * 0.11).sin());
            time += 1;
            activity = Some(chain.push(&[wave; CHANNELS], 0).activity);
        }
        activity
    };
    assert_eq!(chain.baselines(), None);
    assert_eq!(push(&mut chain, 99, 1.0), Some(Activity::Calibrating));
    assert_eq!(push(&mut chain, 1, 1.0), Some(Activity::Rest));
    assert_eq!(chain.baselines().map(<[_]>::len), Some(CHANNELS));
    assert_eq!(push(&mut chain, 200, 1.0), Some(Activity::Rest));
    assert_eq!(push(&mut chain, 300, 30.0), Some(Activity::Move));
    chain.gap(1);
    assert_eq!(push(&mut chain, 1, 30.0), Some(Activity::Rest));
    assert_eq!(push(&mut chain, 300, 30.0), Some(Activity::Move));
    assert_eq!(push(&mut chain, 500, 1.0), Some(Activity::Rest));
}

#[test]
fn a_channel_that_was_stuck_during_calibration_is_never_active() {
    for stuck_at in [0.0, 32_767.0, -8_388_608.0, 2.5] {
        let mut chain = SignalChain::new(&SignalSettings::default(), 1, 2000.0).expect("a chain");
        for _ in 0..10_000 {
            chain.push(&[stuck_at], 0);
        }
        for sample in 0..4000 {
            let push = chain.push(&[stuck_at + [0.0, 500.0, 200.0][sample % 3]], 0);
            assert_eq!(push.activity, Activity::Rest, "stuck at {stuck_at}");
        }
    }
}

#[test]
fn a_whole_block_gives_the_windows_that_its_pieces_give() {
    let recording: Vec<[f32; CHANNELS]> = (0..400).map(|sample| [sample as f32, -1.0, f32::NAN]).collect();
    let expected = windows_of(&recording, &[recording.len()]);
    let block: Vec<f32> =
        (0..CHANNELS).flat_map(|channel| recording.iter().map(move |sample| sample[channel])).collect();
    let mut chain = SignalChain::new(&settings(), CHANNELS, RATE_HZ).expect("a chain");
    let (mut seen, mut ends) = (Vec::new(), Vec::new());
    let replaced = chain.push_block(&block, |chain, window, end| {
        let mut samples = vec![0.0_f32; chain.window_len()];
        chain.write_window(&mut samples);
        seen.push((window, samples.iter().map(|sample| sample.to_bits()).collect::<Vec<u32>>()));
        ends.push(end as u64 - 60);
        Ok::<(), std::convert::Infallible>(())
    });
    assert_eq!((&seen, replaced), (&expected, Ok(400)));
    assert!(ends.iter().eq(seen.iter().map(|(window, _)| &window.first_sample)));
    // What breaks off is told, and nothing after it is taken.
    let mut windows = 0;
    let broken =
        SignalChain::new(&settings(), CHANNELS, RATE_HZ).expect("a chain").push_block(&block, |_, _, _| {
            windows += 1;
            if windows == 3 { Err("enough") } else { Ok(()) }
        });
    assert_eq!((broken, windows), (Err("enough"), 3));
}
