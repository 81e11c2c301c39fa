//! The topics of a session.

use core::marker::PhantomData;

use crate::{
    BlockHeader, CommandHeader, Measurement, MeasurementHeader, PredictionHeader, Stage, StateHeader,
    WindowHeader,
};

/// A named stream of messages with header `H` and payload `[E]`.
#[derive(Debug)]
pub struct Topic<H, E> {
    /// Name within the session.
    pub name: &'static str,
    /// The stage that publishes it; `None` where every stage does.
    pub publisher: Option<Stage>,
    /// Messages kept for a subscriber that is behind. Live, an older one makes way for a newer one;
    /// lossless, the publisher waits.
    pub buffer: usize,
    marker: PhantomData<fn() -> (H, E)>,
}

impl<H, E> Topic<H, E> {
    const fn new(name: &'static str, publisher: Option<Stage>, buffer: usize) -> Self {
        Topic { name, publisher, buffer, marker: PhantomData }
    }
}

/// Raw EMG as acquired. 64 blocks of 5 ms are 320 ms: more than a stage may ever lag and still act.
pub const BLOCKS: Topic<BlockHeader, f32> = Topic::new("blocks", Some(Stage::Acquisition), 64);

/// Filtered windows.
pub const WINDOWS: Topic<WindowHeader, f32> = Topic::new("windows", Some(Stage::Dsp), 8);

/// Class probabilities.
pub const PREDICTIONS: Topic<PredictionHeader, f32> = Topic::new("predictions", Some(Stage::Inference), 8);

/// What the arm is to do.
pub const COMMANDS: Topic<CommandHeader, f32> = Topic::new("commands", Some(Stage::Decision), 8);

/// What the arm does.
pub const STATES: Topic<StateHeader, f32> = Topic::new("states", Some(Stage::Robot), 8);

/// What each stage measured.
pub const MEASUREMENTS: Topic<MeasurementHeader, Measurement> = Topic::new("measurements", None, 64);
