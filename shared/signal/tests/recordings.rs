//! How the activity detector and the watch over the electrodes do on real forearm signals, the 3DC recordings, where they are present.

use std::path::{Path, PathBuf};

use tendon_signal::{
    Activity, ActivityDetector, ActivitySettings, DEFAULT_ENVELOPE_MS, EmgFilter, Envelope, FilterSettings,
    Resampler, SignalChain, SignalSettings,
};

/// The columns that stand for the four electrodes.
const CHANNELS: [usize; 4] = [0, 3, 5, 8];
const RATE_HZ: f64 = 2000.0;

type Envelopes = Vec<[f32; 4]>;

fn recordings() -> Option<PathBuf> {
    let shared = std::env::var_os("TENDON_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"), PathBuf::from);
    Some(shared.join("data/3dc")).filter(|folder| folder.is_dir())
}

/// One repetition, unfiltered: the samples of its gestures by channel, one gesture after the other, rest first.
fn samples(folder: &Path, number: usize) -> Option<Vec<[Vec<f32>; 4]>> {
    let mut resamplers = vec![Resampler::new(2, 1, 1).expect("a resampler"); 4];
    let mut offset = None;
    let mut gestures = Vec::new();
    for gesture in 0..=10 {
        let text =
            std::fs::read_to_string(folder.join(format!("3dc_EMG_gesture_{number}_{gesture}.txt"))).ok()?;
        let rows: Vec<Vec<f32>> = text
            .lines()
            .map(|line| line.split(',').filter_map(|field| field.trim().parse().ok()).collect())
            .collect();
        // The resampler starts from zeros.
        let offset = offset.get_or_insert_with(|| rows[0].clone());
        let mut channels = CHANNELS.map(|_| Vec::new());
        for (channel, column) in CHANNELS.into_iter().enumerate() {
            let input: Vec<f32> = rows.iter().map(|row| row[column] - offset[column]).collect();
            resamplers[channel].process(&input, &mut channels[channel]);
        }
        gestures.push(channels);
    }
    Some(gestures)
}

/// One repetition: the envelope of its gestures, one after the other, rest first.
fn repetition(folder: &Path, number: usize) -> Option<Vec<Envelopes>> {
    let mut filter = EmgFilter::new(&FilterSettings::default(), 4, RATE_HZ).expect("a filter");
    let mut envelopes = vec![Envelope::new(DEFAULT_ENVELOPE_MS, RATE_HZ).expect("an envelope"); 4];
    let mut gestures = samples(folder, number)?;
    let envelope = |channels: &mut [Vec<f32>; 4]| {
        for (channel, samples) in channels.iter_mut().enumerate() {
            assert_eq!(filter.process(channel, samples), 0);
            samples.iter_mut().for_each(|sample| *sample = envelopes[channel].push(*sample));
        }
        (0..channels[0].len()).map(|sample| [0, 1, 2, 3].map(|channel| channels[channel][sample])).collect()
    };
    Some(gestures.iter_mut().map(envelope).collect())
}

/// A detector that has been calibrated on `rest`; it has to be long enough.
fn calibrated_on(rest: &[[f32; 4]], calibration_s: f64) -> Option<ActivityDetector> {
    let settings = ActivitySettings { calibration_s, ..ActivitySettings::default() };
    let mut detector = ActivityDetector::new(&settings, 4, RATE_HZ).expect("a detector");
    rest.iter().take((calibration_s * RATE_HZ) as usize).for_each(|envelope| {
        detector.push(envelope);
    });
    (detector.activity() == Activity::Rest).then_some(detector)
}

/// How often the detector goes from rest to movement.
fn activations(mut detector: ActivityDetector, envelopes: &[[f32; 4]]) -> usize {
    let mut before = Activity::Rest;
    let mut activations = 0;
    for envelope in envelopes {
        let activity = detector.push(envelope);
        activations += usize::from(before == Activity::Rest && activity == Activity::Move);
        before = activity;
    }
    activations
}

#[test]
fn seldom_active_at_rest_and_nearly_always_in_a_gesture() {
    let Some(folder) = recordings() else {
        println!("skipped: recordings not found");
        return;
    };
    let (mut later, mut later_samples) = (0, 0);
    let (mut half, mut half_samples) = (0, 0);
    let (mut moving, mut gesture_samples) = (0, 0);
    for person in std::fs::read_dir(folder).expect("the recordings").flatten() {
        for part in ["train", "test"] {
            let folder = person.path().join(part).join("EMG");
            let repetitions: Vec<_> = (0..4).filter_map(|number| repetition(&folder, number)).collect();
            for (number, gestures) in repetitions.iter().enumerate() {
                let rest = &gestures[0];
                if let Some(detector) = calibrated_on(rest, 2.5) {
                    let second_half = &rest[5000..];
                    half += activations(detector, second_half);
                    half_samples += second_half.len();
                }
                // Some rests are a little short of 5 s.
                let Some(mut detector) = calibrated_on(rest, 4.0) else { continue };
                for (other, gestures) in repetitions.iter().enumerate() {
                    if other != number {
                        later += activations(detector.clone(), &gestures[0]);
                        later_samples += gestures[0].len();
                    }
                }
                for envelope in &rest[8000..] {
                    detector.push(envelope);
                }
                for gesture in &gestures[1..] {
                    for (sample, envelope) in gesture.iter().enumerate() {
                        let is_move = detector.push(envelope) == Activity::Move;
                        if sample >= 2400 {
                            gesture_samples += 1;
                            moving += usize::from(is_move);
                        }
                    }
                }
            }
        }
    }
    let per_minute = |count: usize, samples: usize| count as f64 / (samples as f64 / RATE_HZ / 60.0);
    let (half_per_minute, later_per_minute) =
        (per_minute(half, half_samples), per_minute(later, later_samples));
    let move_share = moving as f64 / gesture_samples as f64;
    println!(
        "false activations a minute: {half_per_minute:.2} in the second half of the calibrated rest, \
         {later_per_minute:.2} in the rests of other repetitions; movement in {:.1} % of the gesture samples",
        100.0 * move_share
    );
    assert!(half_per_minute < 0.5 && later_per_minute < 1.0 && move_share > 0.96);
}

#[test]
fn hardly_a_window_of_a_person_is_strange_and_none_of_rest() {
    let Some(folder) = recordings() else {
        println!("skipped: recordings not found");
        return;
    };
    let (mut windows, mut strange, mut strange_rest) = (0, 0, 0);
    for person in std::fs::read_dir(folder).expect("the recordings").flatten() {
        for part in ["train", "test"] {
            let folder = person.path().join(part).join("EMG");
            let mut chain = SignalChain::new(&SignalSettings::default(), 4, RATE_HZ).expect("a chain");
            for repetition in (0..4).filter_map(|number| samples(&folder, number)) {
                chain.gap(0);
                for (gesture, channels) in repetition.iter().enumerate() {
                    // In this order: the samples of the first channel, then those of the next.
                    let block = channels.concat();
                    chain
                        .push_block(&block, |_, window, _| {
                            windows += 1;
                            strange += usize::from(window.novelty > 1.0);
                            strange_rest += usize::from(window.novelty > 1.0 && gesture == 0);
                            Ok::<(), std::convert::Infallible>(())
                        })
                        .expect("nothing fails");
                }
            }
        }
    }
    println!("{strange} of {windows} windows are strange, {strange_rest} of them at rest");
    assert!(windows > 80_000 && 2000 * strange < windows && strange_rest == 0);
}
