//! The inference process: windows in, class probabilities out. The model itself is
//! `tendon_classifier::Classifier`, which reads the window where it lies in shared memory.

use std::process::ExitCode;

use anyhow::{bail, ensure};
use tendon_classifier::Classifier;
use tendon_gesture::{Gesture, Strategy};
use tendon_messages::{Measurement, PREDICTIONS, PredictionHeader, Stage, WINDOWS, WindowHeader};
use tendon_process::StageProcess;
use tendon_transport::{Publisher, Received, Subscriber};

/// Windows classified before the session starts: the first runs allocate and fill caches.
const WARM_UP_RUNS: usize = 20;

fn main() -> ExitCode {
    tendon_process::main(Stage::Inference, |process| {
        let config = &process.config;
        let library = tendon_classifier::runtime_library(config.inference.runtime_library.as_deref())?;
        let model = match &config.inference.model {
            Some(model) => model.clone(),
            None => tendon_classifier::model_beside_program(config.default_model_file())?,
        };
        let mut classifier = Classifier::load(&library, &model)?;
        let mismatches = classifier.contract().mismatches(
            config.acquisition.channels,
            config.acquisition.sample_rate_hz,
            config.dsp.windows.window_samples,
            &config.dsp.filter,
            config.decision.strategy == Strategy::Direct,
        );
        if !mismatches.is_empty() {
            let differences: Vec<String> = mismatches.iter().map(ToString::to_string).collect();
            bail!(
                "{}: does not fit this session: {}; take another model with --model, or change the configuration",
                model.display(),
                differences.join("; ")
            );
        }
        let silence = vec![0.0; config.window_length()];
        for _ in 0..WARM_UP_RUNS {
            classifier.classify(&silence)?;
        }
        let delivery = config.delivery();
        let predictions = Publisher::open(
            &process.session,
            &PREDICTIONS,
            Gesture::COUNT,
            delivery,
            process.control.stop_flag(),
        )?;
        let windows = Subscriber::open(&process.session, &WINDOWS, Some(Stage::Inference), delivery)?;
        let mut inference = Inference { classifier, predictions };
        process.connect(&windows)?;
        process.ready(&model.display().to_string())?;
        Ok(move |process: &mut StageProcess| {
            process.consume(windows, move |process, window| inference.take(process, &window))
        })
    })
}

struct Inference {
    classifier: Classifier,
    predictions: Publisher<PredictionHeader, f32>,
}

impl Inference {
    fn take(
        &mut self,
        process: &mut StageProcess,
        window: &Received<WindowHeader, f32>,
    ) -> anyhow::Result<Measurement> {
        let header = window.header();
        ensure!(
            window.payload().len() == header.channels as usize * header.samples as usize,
            "a window of {} × {} samples holds {} values",
            header.channels,
            header.samples,
            window.payload().len()
        );
        let trace = window.trace();
        if process.is_stale(&trace) {
            process.measurements.counts.stale += 1;
            return Ok(process.measure(&trace, None));
        }
        let probabilities = self.classifier.classify(window.payload())?;
        let prediction = PredictionHeader { trace, context: header.context };
        let published_ns = self
            .predictions
            .publish(prediction, Gesture::COUNT, |payload| payload.copy_from_slice(probabilities))?;
        process.measurements.counts.published = self.predictions.published();
        Ok(process.measure(&trace, Some(published_ns)))
    }
}
