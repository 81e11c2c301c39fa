//! The thread that looks at a session's topics. Nobody waits for it: not the stages, and not it for a browser.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use axum::extract::ws::Message;
use serde_json::{Value, json};
use tendon_config::Config;
use tendon_messages::{
    BLOCKS, BlockHeader, COMMANDS, CommandHeader, MEASUREMENTS, Measurement, MeasurementHeader, PREDICTIONS,
    PredictionHeader, STATES, StateHeader,
};
use tendon_transport::{Delivery, PolledSubscriber, Session, SessionName, now_ns, own_user};
use tokio::sync::{broadcast, watch};

use crate::desk::{self, Desk};
use crate::traces::Traces;
use crate::view::View;

/// Name of this process in a session, for humans.
const NAME: &str = "page";
/// Time between two looks at the topics, each of which makes a frame. Of states, commands and predictions only the newest is
/// shown; blocks and measurements are kept for longer than this.
const FRAME: Duration = Duration::from_micros(33_333);
/// Time between two summaries of latencies, and two looks whether the session runs.
const SUMMARY: Duration = Duration::from_secs(1);
/// Time between two looks for a session that is to come.
const SESSION_LOOK: Duration = Duration::from_millis(200);
/// Updates that are kept for a slow viewer, a third of a second; what is older it never sees.
const UPDATES: usize = 10;

/// How long viewers are waited for when the session has ended.
const GOODBYE_TIMEOUT: Duration = Duration::from_millis(200);

/// What all viewers are told of one look: bins of the signal, a state, latencies. Together, so that each viewer is written to once,
/// and its browser woken once.
pub type Update = Arc<[Message]>;

/// Where the viewers listen.
#[derive(Debug)]
pub struct Audience {
    /// The session's facts; `None` while none runs.
    pub hello: watch::Sender<Option<Value>>,
    /// What happens in it.
    pub updates: broadcast::Sender<Update>,
    /// How it stands besides.
    pub desk: watch::Sender<Desk>,
    /// Whether the session has ended as it should, so that nobody takes the end of the connection for a fault.
    pub has_ended: watch::Sender<bool>,
}

impl Audience {
    /// Without viewers.
    pub fn new() -> Audience {
        Audience {
            hello: watch::Sender::new(None),
            updates: broadcast::Sender::new(UPDATES),
            desk: watch::Sender::new(Desk::default()),
            has_ended: watch::Sender::new(false),
        }
    }

    /// Tells the viewers that the session has ended as it should, and waits until they have been told; not for one that takes
    /// nothing.
    pub async fn say_goodbye(&self) {
        self.has_ended.send_replace(true);
        let _ = tokio::time::timeout(GOODBYE_TIMEOUT, self.has_ended.closed()).await;
    }
}

/// Whose session is watched.
#[derive(Debug)]
pub enum Watched {
    /// The one that started this program. When it ends, this ends.
    Given(Box<Config>),
    /// Whichever has this name, one after the other.
    Named(SessionName),
}

impl Watched {
    /// The session's name.
    pub fn name(&self) -> &SessionName {
        match self {
            Watched::Given(config) => &config.session,
            Watched::Named(name) => name,
        }
    }
}

/// Watches until `stop`, or the session that was given has ended.
pub fn watch(watched: &Watched, audience: &Audience, stop: &Arc<AtomicBool>) -> anyhow::Result<()> {
    match watched {
        Watched::Given(config) => {
            let session = Session::join(&config.session, NAME)?;
            watch_session(config, session, audience, stop)
        }
        Watched::Named(name) => {
            while !stop.load(Ordering::Relaxed) {
                if name.is_run_by(own_user()) {
                    let session = Session::join(name, NAME)?;
                    if let Some(text) = session.configuration()? {
                        let config =
                            Config::parse(&text, std::path::Path::new("the session's configuration"))?;
                        watch_session(&config, session, audience, stop)?;
                        audience.hello.send_replace(None);
                    }
                }
                std::thread::sleep(SESSION_LOOK);
            }
            Ok(())
        }
    }
}

/// Watches the run that `session` has joined, until `stop` or its end.
fn watch_session(
    config: &Config,
    session: Session,
    audience: &Audience,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    ensure!(
        config.delivery() == Delivery::Live,
        "session `{}` runs as fast as it can: the page shows sessions in the arm's own time only",
        config.session
    );
    if !session.is_running() {
        return Ok(());
    }
    let mut topics = Topics::open(session)?;
    let (mut view, mut traces) = (View::new(config), Traces::new(config)?);
    desk::look(&config.session, &audience.desk);
    let hello = view.hello(now_ns(), traces.bin_ms(), &audience.desk.borrow().facts);
    audience.hello.send_replace(Some(hello));
    let (mut next_frame, mut next_summary) = (Instant::now(), Instant::now());
    while !stop.load(Ordering::Relaxed) {
        topics.take(&mut view, &mut traces)?;
        let is_summary = Instant::now() >= next_summary;
        if is_summary {
            next_summary = Instant::now() + SUMMARY;
            if !topics.session.is_running() {
                return Ok(());
            }
        }
        let frame = traces.frame();
        if audience.updates.receiver_count() > 0 {
            let state = view.now(now_ns(), &traces, &audience.desk.borrow().facts);
            let latency = is_summary.then(|| view.latency());
            let frame = frame.map(|frame| Message::Binary(frame.into()));
            let texts =
                [state.map(|state| text("state", state)), latency.map(|latency| text("latency", latency))];
            // The viewer may have gone meanwhile.
            let _ = audience.updates.send(frame.into_iter().chain(texts.into_iter().flatten()).collect());
        }
        // Frames that were missed are not made up for.
        next_frame = (next_frame + FRAME).max(Instant::now());
        std::thread::sleep(next_frame.saturating_duration_since(Instant::now()));
    }
    Ok(())
}

fn text(name: &str, what: Value) -> Message {
    Message::Text(json!({ name: what }).to_string().into())
}

/// The topics of a session, without wake-ups.
struct Topics {
    blocks: PolledSubscriber<BlockHeader, f32>,
    predictions: PolledSubscriber<PredictionHeader, f32>,
    commands: PolledSubscriber<CommandHeader, f32>,
    states: PolledSubscriber<StateHeader, f32>,
    measurements: PolledSubscriber<MeasurementHeader, Measurement>,
    // Ports close before the membership they belong to.
    session: Session,
}

impl Topics {
    fn open(session: Session) -> anyhow::Result<Topics> {
        Ok(Topics {
            blocks: PolledSubscriber::open(&session, &BLOCKS, Delivery::Live)?,
            predictions: PolledSubscriber::open(&session, &PREDICTIONS, Delivery::Live)?,
            commands: PolledSubscriber::open(&session, &COMMANDS, Delivery::Live)?,
            states: PolledSubscriber::open(&session, &STATES, Delivery::Live)?,
            measurements: PolledSubscriber::open(&session, &MEASUREMENTS, Delivery::Live)?,
            session,
        })
    }

    /// Takes all that has come.
    fn take(&mut self, view: &mut View, traces: &mut Traces) -> anyhow::Result<()> {
        while let Some(block) = self.blocks.receive().context("blocks")? {
            view.block(block.header());
            traces.take(block.header(), block.payload())?;
        }
        while let Some(prediction) = self.predictions.receive().context("predictions")? {
            view.prediction(prediction.header(), prediction.payload());
        }
        while let Some(command) = self.commands.receive().context("commands")? {
            view.command(command.header(), command.payload());
        }
        while let Some(state) = self.states.receive().context("states")? {
            view.state(state.header(), state.payload());
        }
        while let Some(batch) = self.measurements.receive().context("measurements")? {
            view.measured(batch.header(), batch.payload());
        }
        Ok(())
    }
}
