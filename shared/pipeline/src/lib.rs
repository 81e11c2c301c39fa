//! The stages dsp, inference and decision in one process, for everything that runs offline.
//!
//! ```text
//! block ─▶ signal chain ─▶ window ─▶ recogniser ─▶ probabilities ─▶ decider ─▶ decision
//!  any source               └────────────────────────┴────────────────────────┴─▶ Step
//! ```
//! Each part is the one that its stage runs live, so a session and a [`Pipeline`] give the same to the bit. The
//! caller pushes blocks from whatever source it has: a replay, the simulated amplifier, a test.
#![forbid(unsafe_code)]

use std::time::Instant;

use tendon_classifier::{ClassifierError, Recogniser, Recognition, WindowSource};
use tendon_gesture::{Decider, Decision, DecisionSettings, Evidence, InvalidDecisionSetting};
use tendon_signal::{Activity, DesignError, SignalChain, SignalSettings, Window};

/// Settings of all stages of a pipeline.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineSettings {
    /// Number of channels.
    pub channels: usize,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Filters, activity detection and windows.
    pub signal: SignalSettings,
    /// Strategy, vote and gripper.
    pub decision: DecisionSettings,
}

/// Why a pipeline cannot be made, or broke off.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// Settings of the signal chain that do not fit.
    #[error(transparent)]
    Signal(#[from] DesignError),
    /// Settings of the decision that do not fit.
    #[error(transparent)]
    Decision(#[from] InvalidDecisionSetting),
    /// A model that does not fit, or failed on a window.
    #[error(transparent)]
    Classifier(#[from] ClassifierError),
}

/// What became of one window.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Where it lies, whether the muscles were active, and how many samples were replaced.
    pub window: Window,
    /// Its samples, filtered, `[channels × samples]`.
    pub samples: &'a [f32],
    /// Probability and effort of every gesture of the settings, by class number, and how strange the window is.
    pub recognition: Recognition<'a>,
    /// What the arm would be told.
    pub decision: Decision,
    /// Time from the window's newest sample being pushed to the decision, ns.
    pub work_ns: u64,
}

/// All stages between the samples and the arm.
#[derive(Debug)]
pub struct Pipeline {
    settings: PipelineSettings,
    chain: SignalChain,
    recogniser: Recogniser,
    decider: Decider,
    /// Room for a window, `[channels × samples]`.
    samples: Vec<f32>,
}

impl Pipeline {
    /// A pipeline at its start.
    ///
    /// # Errors
    /// When the settings do not fit each other or the models of `recogniser`.
    pub fn new(settings: PipelineSettings, recogniser: Recogniser) -> Result<Pipeline, PipelineError> {
        let PipelineSettings { channels, sample_rate_hz, ref signal, ref decision } = settings;
        recogniser.check_fit(&WindowSource::of_chain(
            "the configuration",
            channels,
            sample_rate_hz,
            signal,
        ))?;
        let chain = SignalChain::new(signal, channels, sample_rate_hz)?;
        let samples = vec![0.0; chain.window_len()];
        Ok(Pipeline { chain, decider: Decider::new(decision)?, recogniser, samples, settings })
    }

    /// Its settings.
    pub fn settings(&self) -> &PipelineSettings {
        &self.settings
    }

    /// Its models.
    pub fn recogniser(&self) -> &Recogniser {
        &self.recogniser
    }

    /// How many more samples the activity detector's calibration needs; 0 once it is over.
    pub fn calibration_left_samples(&self) -> usize {
        self.chain.calibration_left_samples()
    }

    /// Goes back to the start for another recording of the same person: resets filters and votes, but neither what
    /// the activity detector's calibration has measured, nor what the recogniser has adapted to.
    ///
    /// # Errors
    /// None that [`Pipeline::new`] has not given before.
    pub fn next_recording(&mut self) -> Result<(), PipelineError> {
        let calibrated = self.chain.clone();
        self.restart()?;
        self.chain.take_calibration(&calibrated);
        Ok(())
    }

    /// Goes back to the start, for another person: resets filters, calibration and votes, not the recogniser.
    ///
    /// # Errors
    /// None that [`Pipeline::new`] has not given before.
    pub fn restart(&mut self) -> Result<(), PipelineError> {
        let PipelineSettings { channels, sample_rate_hz, ref signal, ref decision } = self.settings;
        self.chain = SignalChain::new(signal, channels, sample_rate_hz)?;
        self.decider = Decider::new(decision)?;
        Ok(())
    }

    /// Tells the pipeline that so many samples of every channel are missing before the next block: no window spans them, and
    /// votes from before say nothing about what follows.
    pub fn gap(&mut self, lost_samples: u64) {
        self.chain.gap(lost_samples);
        self.decider.restart();
    }

    /// Takes a block, `[channels × samples]`, and gives what became of each window that it completes.
    ///
    /// # Errors
    /// When a model fails on a window. What follows in the block is then not taken.
    ///
    /// # Panics
    /// When the block is empty or not a whole number of samples for every channel.
    pub fn push(&mut self, block: &[f32], mut on_step: impl FnMut(Step<'_>)) -> Result<(), PipelineError> {
        let Pipeline { settings, chain, recogniser, decider, samples } = self;
        let mut began = Instant::now();
        chain.push_block(block, |chain, window, _| {
            chain.write_window(samples);
            let recognition = recogniser.recognise(samples, window.first_sample, window.novelty)?;
            let decision = decider.decide(&Evidence {
                probabilities: recognition.probabilities,
                efforts: recognition.efforts,
                novelty: recognition.novelty,
                moving: window.activity == Activity::Move,
                intact: window.replaced_samples == 0,
                captured_ns: (window.first_sample as f64 * 1e9 / settings.sample_rate_hz) as u64,
            });
            let work_ns = began.elapsed().as_nanos() as u64;
            on_step(Step { window, samples, recognition, decision, work_ns });
            if window.replaced_samples == 0 {
                recogniser.adapt();
            }
            began = Instant::now();
            Ok::<(), ClassifierError>(())
        })?;
        Ok(())
    }
}
