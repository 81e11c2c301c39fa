//! The inference process: windows in, probabilities and efforts of the gestures out. The model, or the person, is
//! `tendon_classifier::Recogniser`, which reads the window where it lies in shared memory.
//!
//! ```text
//!   window ─▶ classify ─▶ prediction        ···        rehearse ─▶ window ─▶ classify ─▶ prediction
//!   └───────────────────────── one increment, 75 ms ─────────────────┘
//! ```
//!
//! In the 75 ms between two windows the processor forgets the model: its weights leave the caches, and the
//! core goes to sleep. So just before a window is due the model runs on nothing (a *rehearsal*). Only under
//! SCHED_FIFO: under a fair policy that time would be held against the process when the window comes.

use std::process::ExitCode;

use anyhow::ensure;
use tendon_classifier::{Recogniser, RecogniserFiles, Recognition, RestCheck, WindowSource};
use tendon_messages::{
    Measured, PREDICTIONS, PredictionHeader, ReplayMark, Stage, WINDOWS, WindowContext, WindowHeader,
};
use tendon_process::{Consumer, Policy, StageProcess};
use tendon_transport::{Publisher, Received, Subscriber, now_ns};

/// The filter has settled after this time, s.
const SETTLED_S: f64 = 1.0;
/// So long the signal may be that of movements from the beginning on, s; if no window was weaker by then, it is of another
/// unit.
const REST_COMES_S: f64 = 30.0;
/// Windows classified before the session starts: the first runs allocate and fill caches.
const WARM_UP_RUNS: usize = 20;
/// How long before the next window's newest sample the rehearsal begins: a run on cold caches and one on warm
/// ones fit, and the first may begin late because the core has to wake up.
const REHEARSAL_LEAD_NS: u64 = 850_000;

fn main() -> ExitCode {
    tendon_process::main(Stage::Inference, |process| {
        let config = &process.config;
        let files = RecogniserFiles {
            runtime_library: config.inference.runtime_library.as_deref(),
            model: config.inference.model.as_deref(),
            rest_move_model: config.inference.rest_move_model.as_deref(),
            person: config.inference.person.as_deref(),
            person_checksum: config.inference.person_checksum.as_deref(),
        };
        let recogniser = Recogniser::open(&config.decision, &config.dsp.windows, &files)?;
        let mut recogniser = recogniser.with_adaptation(config.inference.adaptation)?;
        let acquisition = &config.acquisition;
        recogniser.check_fit(&WindowSource::of_chain(
            "the session",
            acquisition.channels,
            acquisition.sample_rate_hz,
            &config.dsp,
        ))?;
        let silence = vec![0.0; config.window_length()];
        let mut shortest_run_ns = u64::MAX;
        for _ in 0..WARM_UP_RUNS {
            let start_ns = now_ns();
            recogniser.rehearse(&silence)?;
            shortest_run_ns = shortest_run_ns.min(now_ns() - start_ns);
        }
        let values = 2 * config.decision.gestures.len();
        let delivery = config.delivery();
        let predictions =
            Publisher::open(&process.session, &PREDICTIONS, values, delivery, process.control.stop_flag())?;
        let windows = Subscriber::open(&process.session, &WINDOWS, Some(Stage::Inference), delivery)?;
        let rehearsal = matches!(process.scheduling.policy, Policy::Fifo(_)).then(|| {
            let increment_samples = process.config.dsp.windows.increment_samples as f64;
            Rehearsal {
                silence,
                increment_ns: (increment_samples * 1e9 / process.config.acquisition.sample_rate_hz) as u64,
                next_window_ns: None,
                shortest_run_ns,
            }
        });
        let models: Vec<String> = recogniser.models().iter().map(|path| path.display().to_string()).collect();
        let (rest_rms, unit) = recogniser.rest();
        let rest = (!rest_rms.is_empty()).then(|| Rest {
            check: RestCheck::new(&rest_rms),
            unit: if unit.is_empty() { String::new() } else { format!(" (in {unit})") },
            settled_sample: (SETTLED_S * acquisition.sample_rate_hz) as u64,
            wait_samples: (REST_COMES_S * acquisition.sample_rate_hz) as u64,
            begun_sample: None,
        });
        let inference = Inference { recogniser, predictions, rehearsal, rest };
        process.connect(&windows)?;
        process.ready(&models.join(", "))?;
        Ok(move |process: &mut StageProcess| process.consume(windows, inference))
    })
}

struct Inference {
    recogniser: Recogniser,
    predictions: Publisher<PredictionHeader, f32>,
    /// Only under SCHED_FIFO.
    rehearsal: Option<Rehearsal>,
    /// Until it is clear whether the unit is the same; not if the recogniser does not say what its rest was.
    rest: Option<Rest>,
}

/// The rest at the beginning of the session, beside that which the recogniser learnt from.
struct Rest {
    check: RestCheck,
    /// That of the recogniser, in brackets.
    unit: String,
    /// From this sample on, the filter has settled.
    settled_sample: u64,
    /// Samples in which some rest will come.
    wait_samples: u64,
    /// First sample of the first window that was checked.
    begun_sample: Option<u64>,
}

impl Rest {
    /// Takes a window, and says what differs once that is sure. Returns whether it is still unsure: the rest calibration is
    /// not over, or there was no rest yet.
    fn take(&mut self, window: &[f32], context: &WindowContext) -> bool {
        if context.first_sample >= self.settled_sample && context.replaced_samples == 0 {
            self.check.push(window);
            self.begun_sample.get_or_insert(context.first_sample);
        }
        if context.calibration_left_ms > 0 {
            return true;
        }
        if let Some(difference) = self.check.difference() {
            let begun_sample = self.begun_sample.unwrap_or(context.first_sample);
            if difference.is_stronger() && context.first_sample < begun_sample + self.wait_samples {
                return true;
            }
            tracing::warn!(
                "at rest the signal is {difference} than in the recordings that the recogniser learnt from{}, so it will \
                 recognise little: give it the same unit and amplifier, or calibrate or train with this signal \
                 (tendon calibrate, docs/models.md)",
                self.unit
            );
        }
        false
    }
}

/// When and on what to rehearse.
struct Rehearsal {
    silence: Vec<f32>,
    /// Time between two windows.
    increment_ns: u64,
    /// When the next window's newest sample is captured; `None` until a window has come.
    next_window_ns: Option<u64>,
    /// How long a run takes on warm caches.
    shortest_run_ns: u64,
}

impl Consumer<WindowHeader, f32> for Inference {
    type Error = anyhow::Error;

    fn take(
        &mut self,
        process: &mut StageProcess,
        window: &Received<WindowHeader, f32>,
    ) -> anyhow::Result<Measured> {
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
        if let Some(rehearsal) = &mut self.rehearsal {
            rehearsal.next_window_ns = Some(trace.captured_ns + rehearsal.increment_ns);
        }
        if let Some(rest) = &mut self.rest
            && !rest.take(window.payload(), &header.context)
        {
            self.rest = None;
        }
        if header.context.is_marked(ReplayMark::LeftOutByInference) {
            return Ok(process.measure(&trace, None));
        }
        if header.context.is_marked(ReplayMark::InferenceBeganAnew) {
            self.recogniser.begin_anew(&process.config.dsp.windows)?;
        }
        let Recognition { probabilities, efforts, novelty } =
            self.recogniser.recognise(window.payload(), header.context.first_sample, header.novelty)?;
        let prediction = PredictionHeader { trace, context: header.context, novelty };
        let published_ns = self.predictions.publish(prediction, 2 * probabilities.len(), |payload| {
            let (first, second) = payload.split_at_mut(probabilities.len());
            first.copy_from_slice(probabilities);
            second.copy_from_slice(efforts);
        })?;
        process.measurements.counts.published = self.predictions.published();
        // Only now, so that no prediction waits for it.
        if header.context.replaced_samples == 0 {
            self.recogniser.adapt();
        }
        Ok(process.measure(&trace, Some(published_ns)))
    }

    fn rehearsal_ns(&self) -> Option<u64> {
        self.rehearsal
            .as_ref()?
            .next_window_ns
            .map(|next_window_ns| next_window_ns.saturating_sub(REHEARSAL_LEAD_NS))
    }

    /// Runs the model on silence as often as it fits before the next window, which must not wait.
    fn rehearse(&mut self) -> anyhow::Result<()> {
        let Some(rehearsal) = &mut self.rehearsal else { return Ok(()) };
        let Some(next_window_ns) = rehearsal.next_window_ns.take() else { return Ok(()) };
        let mut start_ns = now_ns();
        while start_ns + rehearsal.shortest_run_ns < next_window_ns {
            self.recogniser.rehearse(&rehearsal.silence)?;
            let end_ns = now_ns();
            rehearsal.shortest_run_ns = rehearsal.shortest_run_ns.min(end_ns - start_ns);
            start_ns = end_ns;
        }
        Ok(())
    }
}
