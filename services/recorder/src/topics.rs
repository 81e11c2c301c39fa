//! The topics of the session, from which messages are taken.

use std::collections::BTreeMap;

use anyhow::Context;
use tendon_config::Config;
use tendon_messages::{
    BLOCKS, BlockHeader, COMMANDS, CommandHeader, MEASUREMENTS, Measurement, MeasurementHeader, PREDICTIONS,
    PredictionHeader, STATES, StateHeader, Truth, WINDOWS, WindowHeader,
};
use tendon_session_file::{
    Block, CommandRecord, Cue, Event, EventKind, MeasurementRecord, Message, PredictionRecord, StateRecord,
    WindowRecord,
};
use tendon_transport::{Delivery, PolledSubscriber, Session, now_ns};

use crate::writing::{Item, WritingThread};

/// All topics.
#[derive(Debug)]
pub struct Topics {
    blocks: PolledSubscriber<BlockHeader, f32>,
    windows: PolledSubscriber<WindowHeader, f32>,
    predictions: PolledSubscriber<PredictionHeader, f32>,
    commands: PolledSubscriber<CommandHeader, f32>,
    states: PolledSubscriber<StateHeader, f32>,
    measurements: PolledSubscriber<MeasurementHeader, Measurement>,
    gestures: Vec<String>,
    /// The truth of the newest block; `None` before the first.
    truth: Option<Truth>,
    /// What was lost of each topic when it was last said.
    said: BTreeMap<String, u64>,
}

impl Topics {
    /// Opens all topics of the session with its delivery.
    pub fn open(session: &Session, config: &Config) -> anyhow::Result<Topics> {
        let delivery = config.delivery();
        Ok(Topics {
            blocks: PolledSubscriber::open(session, &BLOCKS, delivery)?,
            windows: PolledSubscriber::open(session, &WINDOWS, delivery)?,
            predictions: PolledSubscriber::open(session, &PREDICTIONS, delivery)?,
            commands: PolledSubscriber::open(session, &COMMANDS, delivery)?,
            states: PolledSubscriber::open(session, &STATES, Delivery::Live)?,
            measurements: PolledSubscriber::open(session, &MEASUREMENTS, Delivery::Live)?,
            gestures: config.decision.gestures.iter().map(String::from).collect(),
            truth: None,
            said: BTreeMap::new(),
        })
    }

    /// Whether all publishers are there, and this process is connected to them.
    pub fn connect(&self) -> anyhow::Result<bool> {
        // All of them, so that none waits for the others.
        let connected = [
            self.blocks.connect()?,
            self.windows.connect()?,
            self.predictions.connect()?,
            self.commands.connect()?,
            self.states.connect()?,
            self.measurements.connect()?,
        ];
        Ok(connected.iter().all(|is_connected| *is_connected))
    }

    /// Takes all that has come.
    pub fn take(&mut self, writing: &mut WritingThread) -> anyhow::Result<()> {
        while let Some(block) = self.blocks.receive().context("blocks")? {
            let header = block.header();
            if self.truth != Some(header.truth) {
                self.truth = Some(header.truth);
                writing.put(Item::Message(Message::Cue(cue(header, &self.gestures)), now_ns()));
            }
            writing.put(Item::Message(Message::Block(Block::of(header, block.payload())), now_ns()));
        }
        while let Some(window) = self.windows.receive().context("windows")? {
            writing.put(Item::Message(Message::Window(WindowRecord::of(window.header())), now_ns()));
        }
        while let Some(prediction) = self.predictions.receive().context("predictions")? {
            let record = PredictionRecord::of(prediction.header(), prediction.payload());
            writing.put(Item::Message(Message::Prediction(record), now_ns()));
        }
        while let Some(command) = self.commands.receive().context("commands")? {
            let record = CommandRecord::of(command.header(), command.payload());
            writing.put(Item::Message(Message::Command(record), now_ns()));
        }
        while let Some(state) = self.states.receive().context("states")? {
            let record = StateRecord::of(state.header(), state.payload());
            writing.put(Item::Message(Message::State(record), now_ns()));
        }
        while let Some(batch) = self.measurements.receive().context("measurements")? {
            let record = MeasurementRecord::of(batch.header());
            writing.put(Item::Message(Message::Measurement(record), now_ns()));
        }
        self.say_what_was_lost(writing);
        Ok(())
    }

    /// Messages that came too fast, by topic; only those of which there are any. Of measurements it is not known: each stage
    /// numbers its own. Every batch has the counts of those before it.
    pub fn lost(&self) -> BTreeMap<String, u64> {
        let lost = [
            (BLOCKS.name, self.blocks.lost()),
            (WINDOWS.name, self.windows.lost()),
            (PREDICTIONS.name, self.predictions.lost()),
            (COMMANDS.name, self.commands.lost()),
            (STATES.name, self.states.lost()),
        ];
        lost.into_iter()
            .filter(|(_, count)| *count > 0)
            .map(|(name, count)| (name.to_owned(), count))
            .collect()
    }

    fn say_what_was_lost(&mut self, writing: &mut WritingThread) {
        let mut lost = self.lost();
        for (topic, count) in writing.left_out() {
            *lost.entry(topic.to_owned()).or_default() += count;
        }
        for (topic, count) in &lost {
            let before = self.said.get(topic).copied().unwrap_or_default();
            if *count > before {
                let text = format!("{topic} missing here: {}, as the recorder was too slow", count - before);
                writing.put(Item::Event(Event { at_ns: now_ns(), kind: EventKind::Recording, text }));
            }
        }
        self.said = lost;
    }
}

fn cue(header: &BlockHeader, gestures: &[String]) -> Cue {
    let class_number = header.truth.gesture();
    Cue {
        since_sample: header.truth.since_sample(),
        captured_ns: header.trace.captured_ns,
        class_number,
        gesture: class_number.and_then(|number| gestures.get(usize::from(number))).cloned(),
    }
}
