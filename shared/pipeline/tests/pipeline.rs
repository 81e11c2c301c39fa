//! What a pipeline gives does not depend on how its samples come.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests, as tests, may fail and print"
)]

use std::path::{Path, PathBuf};

use tendon_classifier::{Recogniser, runtime_library};
use tendon_emg_simulation::{
    ContractionSettings, DEFAULT_SCRIPT, Performance, Profile, Repeat, SimulatedEmg, SimulationSettings,
};
use tendon_gesture::{DecisionSettings, Gesture};
use tendon_pipeline::{Pipeline, PipelineSettings};
use tendon_signal::SignalSettings;

const CHANNELS: usize = 4;
const RATE_HZ: f64 = 2000.0;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// The runtime library, if it has been fetched.
fn library() -> Option<PathBuf> {
    let fetched = repository().join(".cache/onnxruntime/libonnxruntime.so");
    let library = runtime_library(None).ok().or_else(|| fetched.is_file().then_some(fetched));
    if library.is_none() {
        println!("skipped: ONNX Runtime not found (scripts/fetch-onnxruntime)");
    }
    library
}

fn pipeline(library: &Path) -> Pipeline {
    let model = repository().join("models/cnn-five-gesture.onnx");
    let recogniser = Recogniser::load(library, &DecisionSettings::default(), Some(&model), None).unwrap();
    let settings = PipelineSettings {
        channels: CHANNELS,
        sample_rate_hz: RATE_HZ,
        signal: SignalSettings::default(),
        decision: DecisionSettings::default(),
    };
    Pipeline::new(settings, recogniser).unwrap()
}

/// Number of the first sample, probabilities and voted gesture of every window of 20 s of a simulated person.
fn decisions(pipeline: &mut Pipeline, block_samples: usize) -> Vec<(u64, Vec<u32>, Gesture)> {
    let simulation = SimulationSettings { channels: CHANNELS, sample_rate_hz: RATE_HZ, ..Default::default() };
    let mut emg = SimulatedEmg::new(&Profile::default(), &simulation).unwrap();
    let script = DEFAULT_SCRIPT.parse().unwrap();
    let contraction = ContractionSettings::default();
    let mut performance =
        Performance::of_script(emg.gestures(), script, Repeat::Forever, contraction, RATE_HZ);
    let mut block = vec![0.0; CHANNELS * block_samples];
    let mut decisions = Vec::new();
    for _ in 0..40_000 / block_samples {
        emg.fill_block(&mut performance, &mut block);
        let keep = |step: tendon_pipeline::Step<'_>| {
            let bits =
                step.recognition.probabilities.iter().map(|probability| probability.to_bits()).collect();
            decisions.push((step.window.first_sample, bits, step.decision.voted));
        };
        pipeline.push(&block, keep).unwrap();
    }
    decisions
}

#[test]
fn decisions_depend_neither_on_the_block_nor_on_what_was_before_a_restart() {
    let Some(library) = library() else { return };
    let mut pipeline = pipeline(&library);
    let expected = decisions(&mut pipeline, 10);
    assert_eq!(expected.len(), (40_000 - 600) / 150 + 1);
    // The comparison says something only if the person moved and was understood.
    assert!(expected.iter().any(|(_, _, voted)| *voted != Gesture::REST));
    for block_samples in [1, 400, 4000] {
        pipeline.restart().unwrap();
        assert!(decisions(&mut pipeline, block_samples) == expected, "blocks of {block_samples}");
    }
}

/// A simulated person who rests until 6 s, extends until 8 s, rests until 9 s and flexes until 11 s.
fn moving_person() -> (SimulatedEmg, Performance) {
    let simulation = SimulationSettings { channels: CHANNELS, sample_rate_hz: RATE_HZ, ..Default::default() };
    let emg = SimulatedEmg::new(&Profile::default(), &simulation).unwrap();
    let script = "rest 6s, extension 2s, rest 1s, flexion 2s, rest 1s".parse().unwrap();
    let contraction = ContractionSettings::default();
    let performance = Performance::of_script(emg.gestures(), script, Repeat::Forever, contraction, RATE_HZ);
    (emg, performance)
}

#[test]
fn an_electrode_that_comes_off_moves_nothing_and_is_no_rest() {
    let Some(library) = library() else { return };
    let mut pipeline = pipeline(&library);
    let hum = |at: u64| (400.0 * (std::f64::consts::TAU * 50.0 * at as f64 / RATE_HZ).sin()) as f32;
    let disturbances: [(&str, &dyn Fn(u64) -> f32); 3] =
        [("at zero", &|_| 0.0), ("at the end of the range", &|_| 8191.0), ("hum", &hum)];
    for (name, disturbance) in disturbances {
        for channels in [1, CHANNELS] {
            // From the start; before and during a gesture; during a gesture that is held.
            for [begin_s, end_s] in [[0.0, 12.0], [5.5, 9.0], [7.0, 12.0]] {
                pipeline.restart().unwrap();
                let (mut emg, mut performance) = moving_person();
                let mut block = vec![0.0; CHANNELS * 10];
                let (mut moved, mut looked) = (false, 0);
                for first in (0..24_000_u64).step_by(10) {
                    emg.fill_block(&mut performance, &mut block);
                    if (begin_s..end_s).contains(&(first as f64 / RATE_HZ)) {
                        for channel in block.chunks_exact_mut(10).take(channels) {
                            (first..).zip(channel).for_each(|(at, sample)| *sample = disturbance(at));
                        }
                    }
                    let look = |step: tendon_pipeline::Step<'_>| {
                        let newest_s = (step.window.first_sample + 600) as f64 / RATE_HZ;
                        let place = format!("{name}, {channels} channels, from {begin_s} s, at {newest_s} s");
                        moved |= step.decision.voted != Gesture::REST;
                        // The window is mostly disturbed, and the vote has had two windows more.
                        if (begin_s + 0.45..end_s).contains(&newest_s) {
                            looked += 1;
                            assert!(step.decision.is_unsure, "{place}");
                            assert_eq!(step.decision.voted, Gesture::REST, "{place}");
                        }
                    };
                    pipeline.push(&block, look).unwrap();
                }
                // The comparison says something only if the person moves without the disturbance.
                assert!(looked > 30 && moved == (begin_s > 0.0), "{name}, {channels} channels, {begin_s} s");
            }
        }
    }
}

#[test]
fn a_model_that_does_not_fit_the_settings_is_refused() {
    let Some(library) = library() else { return };
    let fitting = pipeline(&library);
    let settings = PipelineSettings { channels: 3, ..fitting.settings().clone() };
    let model = repository().join("models/cnn-five-gesture.onnx");
    let recogniser = Recogniser::load(&library, &DecisionSettings::default(), Some(&model), None).unwrap();
    let error = Pipeline::new(settings, recogniser).unwrap_err().to_string();
    assert!(error.contains("channels: the model wants 4, the configuration has 3"), "{error}");
}
