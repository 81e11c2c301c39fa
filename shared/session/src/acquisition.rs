//! The source of a session alone, for whoever records it: no window, no decision, no arm.
//!
//! ```text
//! AcquisitionWatch::start ─▶ wait_until_ready ─▶ turn, turn, … ─▶ stop
//!         orders ─▶ acquisition ──blocks──▶ turn ─▶ on_block; keys, signals, requests ─▶ Heard
//! ```

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use tendon_config::Config;
use tendon_messages::{BLOCKS, BlockHeader, Stage};
use tendon_process::{Answer, Asked, CalibrationRequest, Order, Ready, Request};
use tendon_transport::{Delivery, Received, Session, Subscriber};

use crate::children::{Children, Event};
use crate::failure::SessionFailure;
use crate::robot_line::RobotLine;
use crate::writer::Writer;

/// How long the source may take to become ready.
const READY_TIMEOUT: Duration = Duration::from_secs(60);
/// After so long without a block the source has stopped.
const SILENCE: Duration = Duration::from_secs(5);

/// What the person at the keys or the page wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing.
    Nothing,
    /// To go on.
    GoOn,
    /// To do the last once more.
    Redo,
    /// To stop.
    Stop,
}

/// A source that runs by itself. Dropping it kills it.
#[derive(Debug)]
pub struct AcquisitionWatch<'a> {
    children: Children,
    events: &'a Receiver<Event>,
    blocks: Subscriber<BlockHeader, f32>,
    last_block: Instant,
    /// Ports close before the membership they belong to.
    _session: Session,
}

impl<'a> AcquisitionWatch<'a> {
    /// Starts the source of this configuration.
    ///
    /// # Errors
    ///
    /// [`SessionFailure`] when the session cannot be joined or the program cannot be started.
    pub fn start(
        config: &Config,
        robot: &RobotLine,
        (sender, events): (&Sender<Event>, &'a Receiver<Event>),
        standard_error: &Writer,
    ) -> Result<AcquisitionWatch<'a>, SessionFailure> {
        let session = Session::join(&config.session, "calibrate")?;
        let blocks = Subscriber::open(&session, &BLOCKS, None, Delivery::Live)?;
        let children = Children::start(&[Stage::Acquisition], config, sender, robot, false, standard_error)?;
        Ok(AcquisitionWatch { children, events, blocks, last_block: Instant::now(), _session: session })
    }

    /// Waits until the source is ready and lets it begin; gives what it says of itself, `None` when told to stop before.
    ///
    /// # Errors
    ///
    /// [`SessionFailure`] when it ends or takes too long.
    pub fn wait_until_ready(&mut self) -> Result<Option<Ready>, SessionFailure> {
        let begun = Instant::now();
        loop {
            let left = READY_TIMEOUT.saturating_sub(begun.elapsed());
            match self.events.recv_timeout(left) {
                Ok(Event::Ready(_, ready)) => {
                    self.children.order(Stage::Acquisition, Order::Start);
                    self.last_block = Instant::now();
                    return Ok(Some(ready));
                }
                Ok(Event::Stop) => return Ok(None),
                Ok(Event::Request(asked)) => {
                    if hear_request(asked) == Heard::Stop {
                        return Ok(None);
                    }
                }
                Ok(Event::Ended(stage)) => return Err(self.ended(stage, true)),
                Ok(
                    Event::Order(..)
                    | Event::GoOn
                    | Event::Redo
                    | Event::LateArm
                    | Event::Record
                    | Event::Recorder,
                ) => {}
                Err(_) => {
                    let who = Stage::Acquisition.name().to_owned();
                    return Err(SessionFailure::NotReady { who, timeout: READY_TIMEOUT });
                }
            }
        }
    }

    /// Waits for keys and blocks, but no longer than `longest`, and gives every block to `on_block` in turn. Come by every
    /// 100 ms: later, blocks are lost.
    ///
    /// # Errors
    ///
    /// [`SessionFailure`] when the source ended, or gives no samples any more.
    pub fn turn(
        &mut self,
        longest: Duration,
        mut on_block: impl FnMut(&Received<BlockHeader, f32>),
    ) -> Result<Heard, SessionFailure> {
        let heard = match self.events.recv_timeout(longest) {
            Ok(Event::GoOn) => Heard::GoOn,
            Ok(Event::Redo) => Heard::Redo,
            Ok(Event::Request(asked)) => hear_request(asked),
            Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => Heard::Stop,
            Ok(Event::Ended(stage)) => return Err(self.ended(stage, false)),
            Ok(Event::Order(..) | Event::Ready(..) | Event::LateArm | Event::Record | Event::Recorder)
            | Err(RecvTimeoutError::Timeout) => Heard::Nothing,
        };
        self.blocks.acknowledge_wakes()?;
        while let Some(block) = self.blocks.receive()? {
            self.last_block = Instant::now();
            on_block(&block);
        }
        if self.last_block.elapsed() > SILENCE {
            return Err(SessionFailure::NoSamples { silence: SILENCE });
        }
        Ok(heard)
    }

    /// Gives the source an order.
    pub fn order(&mut self, order: Order) {
        self.children.order(Stage::Acquisition, order);
    }

    /// Stops the source.
    ///
    /// # Errors
    ///
    /// [`SessionFailure`] when it had to be killed.
    pub fn stop(mut self) -> Result<(), SessionFailure> {
        self.children.keep_quiet();
        let killed = self.children.stop(self.events, || ())?;
        if killed.is_empty() {
            return Ok(());
        }
        Err(SessionFailure::Killed { names: killed.join(", ") })
    }

    fn ended(&mut self, stage: Stage, at_start: bool) -> SessionFailure {
        match self.children.reap(stage) {
            Ok(Some(end)) => {
                SessionFailure::StageEnded { stage, status: end.status, at_start, last_words: end.last_words }
            }
            Ok(None) => SessionFailure::NoSamples { silence: Duration::ZERO },
            Err(error) => error.into(),
        }
    }
}

/// What a request wants, and the answer to it. Whoever passed it on has seen that it can be asked for now.
fn hear_request(asked: Asked) -> Heard {
    if !asked.is_waited_for() {
        return Heard::Nothing;
    }
    let (heard, answer) = match &asked.request {
        Request::Calibration(CalibrationRequest::GoOn) => (Heard::GoOn, Answer::done("it goes on")),
        Request::Calibration(CalibrationRequest::Redo) => (Heard::Redo, Answer::done("once more")),
        Request::Calibration(CalibrationRequest::Stop) => (Heard::Stop, Answer::done("it stops")),
        _ => (Heard::Nothing, Answer::refused("this cannot be asked of a source alone")),
    };
    asked.answer(&answer);
    heard
}
