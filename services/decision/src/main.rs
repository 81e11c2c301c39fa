//! The decision process: class probabilities in, commands out, one for every window. The logic itself is
//! `tendon_gesture::Decider`.

use std::process::ExitCode;

use anyhow::ensure;
use tendon_gesture::{Decider, Evidence, Frame, Gesture};
use tendon_messages::{
    Activity, COMMANDS, CommandHeader, Measured, PREDICTIONS, PredictionHeader, ReplayMark, Stage,
    TWIST_LENGTH, TwistFrame,
};
use tendon_process::{Consumer, Order, StageProcess};
use tendon_transport::{Publisher, Received, Subscriber};

fn main() -> ExitCode {
    tendon_process::main(Stage::Decision, |process| {
        let config = &process.config;
        let delivery = config.delivery();
        let decision = Decision {
            decider: Decider::new(&config.decision)?,
            commands: Publisher::open(
                &process.session,
                &COMMANDS,
                TWIST_LENGTH,
                delivery,
                process.control.stop_flag(),
            )?,
            increment_samples: config.dsp.windows.increment_samples as u64,
            last_first_sample: None,
            ordered_mode: 0,
            gripper_toggles: 0,
        };
        let predictions = Subscriber::open(&process.session, &PREDICTIONS, Some(Stage::Decision), delivery)?;
        process.connect(&predictions)?;
        process.ready(&format!("strategy {}", process.config.decision.strategy.name()))?;
        Ok(move |process: &mut StageProcess| process.consume(predictions, decision))
    })
}

struct Decision {
    decider: Decider,
    commands: Publisher<CommandHeader, f32>,
    increment_samples: u64,
    /// Index of the last window's first sample.
    last_first_sample: Option<u64>,
    /// The place, from 1, of the mode to take with the next window; 0 to keep the one that is on.
    ordered_mode: u8,
    /// Since this process began.
    gripper_toggles: u32,
}

impl Consumer<PredictionHeader, f32> for Decision {
    type Error = anyhow::Error;

    fn obey(&mut self, order: Order) {
        if let Order::Mode(place) = order {
            self.ordered_mode = place.saturating_add(1);
        }
    }

    fn take(
        &mut self,
        process: &mut StageProcess,
        prediction: &Received<PredictionHeader, f32>,
    ) -> anyhow::Result<Measured> {
        let context = prediction.header().context;
        let trace = prediction.trace();
        let gestures = self.decider.gestures().len();
        ensure!(
            prediction.payload().len() == 2 * gestures,
            "a prediction of {} numbers, but the session has {gestures} gestures: start all processes with the same \
             configuration",
            prediction.payload().len()
        );
        let (probabilities, efforts) = prediction.payload().split_at(gestures);
        if context.is_marked(ReplayMark::DecisionBeganAnew) {
            self.decider = Decider::new(&process.config.decision)?;
            (self.last_first_sample, self.gripper_toggles) = (None, 0);
        }
        // Windows are missing, whoever left them out: votes from before say nothing about now.
        let follows = |last: u64| context.first_sample == last + self.increment_samples;
        if self.last_first_sample.is_some_and(|last| !follows(last)) {
            self.decider.restart();
        }
        self.last_first_sample = Some(context.first_sample);
        if process.is_stale(&trace) {
            process.measurements.counts.stale += 1;
            self.decider.restart();
            return Ok(process.measure(&trace, None));
        }
        if context.is_marked(ReplayMark::LeftOutByDecision) {
            self.decider.restart();
            return Ok(process.measure(&trace, None));
        }
        let repeated = Some(context.ordered_mode).filter(|ordered| *ordered != 0);
        let ordered_mode = repeated.unwrap_or_else(|| std::mem::take(&mut self.ordered_mode));
        if let Some(mode) = ordered_mode.checked_sub(1) {
            self.decider.take_mode(mode.into());
        }
        let outcome = self.decider.decide(&Evidence {
            probabilities,
            efforts,
            novelty: prediction.header().novelty,
            moving: Activity::from_number(context.activity) == Activity::Move,
            intact: context.replaced_samples == 0,
            captured_ns: sample_time_ns(process, context.first_sample),
        });
        let number = |gesture: Gesture| {
            let number = self.decider.gestures().number(gesture);
            number.expect("the decider decides among the session's gestures")
        };
        self.gripper_toggles = self.gripper_toggles.wrapping_add(outcome.toggles_gripper.into());
        let header = CommandHeader {
            trace,
            context,
            confidence: outcome.confidence,
            gesture: number(outcome.gesture),
            voted: number(outcome.voted),
            gripper_toggles: self.gripper_toggles,
            frame: match outcome.frame {
                Frame::Base => TwistFrame::Base.number(),
                Frame::Tool => TwistFrame::Tool.number(),
            },
            mode: outcome.mode as u8,
            is_unsure: outcome.is_unsure.into(),
            ordered_mode,
        };
        let published_ns = self.commands.publish(header, TWIST_LENGTH, |twist| {
            for (component, velocity) in twist.iter_mut().zip(outcome.twist) {
                *component = velocity as f32;
            }
        })?;
        process.measurements.counts.published = self.commands.published();
        Ok(Measured::Decision {
            times: process.message_times(&trace, Some(published_ns)),
            window_start_to_publish_ns: published_ns.saturating_sub(context.first_captured_ns),
            truth: context.gesture_throughout(),
            gesture: number(outcome.gesture),
        })
    }
}

/// Time of a sample on the source's own clock, so that a replay decides the same at any speed.
fn sample_time_ns(process: &StageProcess, sample: u64) -> u64 {
    (sample as f64 * 1e9 / process.config.acquisition.sample_rate_hz) as u64
}
