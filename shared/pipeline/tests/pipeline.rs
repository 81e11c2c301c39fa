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
