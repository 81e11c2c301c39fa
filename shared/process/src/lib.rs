//! What every stage's process does besides its own work.
//!
//! ```text
//! start ─▶ read config ─▶ ask the scheduler ─▶ join the session ─▶ open ports, warm up ─▶ say ready
//!                                                                                          │
//!       stop ◀─ SIGTERM, SIGINT, end of input ── one blocking wait ◀── message, order, deadline
//! ```
//!
//! A process says that it is ready by one line of JSON on its standard output ([`Ready`]). What goes wrong
//! goes to standard error as one sentence, and the exit code is 2 if the process could not start, 1 if it
//! broke off later.

mod allocations;
mod answer;
mod control;
mod datagrams;
mod error;
mod measure;
mod notes;
mod orders;
mod page;
mod requests;
mod scheduling;

use std::io::{IsTerminal, Write};
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use serde::{Deserialize, Serialize};
use tendon_config::Config;
use tendon_messages::{Measured, MessageTimes, Stage, Trace, Traced};
use tendon_transport::{Delivery, Element, Received, Session, Subscriber, now_ns};

pub use allocations::allocations;
pub use answer::Answer;
pub use control::{Control, Wake};
pub use error::{ProcessError, WorkError, with_causes};
pub use measure::{BATCH_LENGTH, Measurements};
pub use notes::{LONGEST_NOTE, NoteError, NoteSocket, NoteText, leave_note};
pub use orders::{Asker, Order, OrderError, order_robot};
pub use page::{PAGE_VARIABLE, PageKeys, socket_variables};
pub use requests::{
    Asked, CalibrationRequest, GestureRequest, Next, NextCalibration, NextSession, Request, RequestError,
    RequestSocket, ask_session, session_status,
};
pub use scheduling::{Policy, RealtimeRefused, Scheduling, keep_off_the_stages_core, schedule};

/// Age of a window's newest sample, or of a block, from which on it is not acted upon any more, in ns. Older
/// intentions are no intentions: the person has seen since what the arm did.
pub const STALE_NS: u64 = 100_000_000;

/// Command line of a stage. `tendon run` starts the stages with it; so can you, in any order.
#[derive(Debug, Parser)]
#[command(version, about = "One stage of a Tendon session; `tendon run` starts the whole set.")]
struct Arguments {
    /// Configuration of the session.
    #[arg(long, value_name = "FILE", default_value = "tendon.toml")]
    config: PathBuf,
    /// The process before did not end in good order. The robot then leaves the arm where it is until it is armed.
    #[arg(long)]
    restarted: bool,
    /// The session follows on another. The robot then leaves the arm where it is until it is armed.
    #[arg(long)]
    follows_on_session: bool,
}

/// The line a process writes to standard output when it is ready.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ready {
    /// Name of the stage.
    pub stage: String,
    /// What the kernel granted.
    pub scheduling: Scheduling,
    /// What a user may want to know, such as the model or the recording.
    pub detail: String,
    /// Of a source that knows it: what it measures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signal: Option<SignalDescription>,
}

/// What a source measures, as it says itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SignalDescription {
    /// Names of the channels, in the order of the samples.
    pub channels: Vec<String>,
    /// Unit of the samples; empty if nobody knows.
    pub unit: String,
}

/// A stage's own work: what it does with each message of its one input.
pub trait Consumer<H: Traced, E: Element> {
    /// What can go wrong in it.
    type Error: Into<WorkError>;

    /// Does the stage's work on one message, and says what it measured.
    ///
    /// # Errors
    ///
    /// What ends the session: a message that cannot be one of this session, or a transport that is broken.
    fn take(&mut self, process: &mut StageProcess, message: &Received<H, E>)
    -> Result<Measured, Self::Error>;

    /// Hears an order that is for this stage.
    fn obey(&mut self, _order: Order) {}

    /// When the consumer wants [`Consumer::rehearse`] to be called, CLOCK_MONOTONIC ns, if no message comes
    /// first.
    fn rehearsal_ns(&self) -> Option<u64> {
        None
    }

    /// Work without a message, so that the next message finds the processor's caches warm.
    ///
    /// # Errors
    ///
    /// As [`Consumer::take`].
    fn rehearse(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

/// A process that takes part in a session as a stage.
#[derive(Debug)]
pub struct StageProcess {
    /// Which stage.
    pub stage: Stage,
    /// The session's settings.
    pub config: Config,
    /// The session.
    pub session: Session,
    /// Orders, signals and the blocking wait.
    pub control: Control,
    /// What is measured.
    pub measurements: Measurements,
    /// What the kernel granted.
    pub scheduling: Scheduling,
    /// Whether this process stands in for one that did not end in good order.
    pub is_restarted: bool,
    /// Whether the session follows on another, without anybody at the terminal.
    pub follows_on_session: bool,
    is_ready: bool,
}

impl StageProcess {
    /// Waits until the stage before has opened `input`'s topic, and connects to it, so that no message is
    /// published to a port that is not yet connected. Returns early when told to stop. Orders that come meanwhile are
    /// kept for later.
    ///
    /// # Errors
    ///
    /// When the other's memory cannot be mapped.
    pub fn connect<H: Traced, E: Element>(&mut self, input: &Subscriber<H, E>) -> Result<(), ProcessError> {
        let mut orders = Vec::new();
        while !input.connect()? {
            match self.control.wait(Some(input.as_fd()), None)? {
                Wake::Stop => break,
                Wake::Order(order) => orders.push(order),
                Wake::Message | Wake::Deadline => input.acknowledge_wakes()?,
            }
        }
        self.control.keep(orders);
        Ok(())
    }

    /// Says that the process is ready: its ports are open and connected, and it is warm.
    ///
    /// # Errors
    ///
    /// When standard output is closed or the measurements cannot be published.
    pub fn ready(&mut self, detail: &str) -> Result<(), ProcessError> {
        self.say_ready(detail, None)
    }

    /// As [`StageProcess::ready`], for a source that knows what it measures.
    ///
    /// # Errors
    ///
    /// As [`StageProcess::ready`].
    pub fn ready_with_signal(&mut self, detail: &str, signal: SignalDescription) -> Result<(), ProcessError> {
        self.say_ready(detail, Some(signal))
    }

    fn say_ready(&mut self, detail: &str, signal: Option<SignalDescription>) -> Result<(), ProcessError> {
        let ready = Ready {
            stage: self.stage.name().to_owned(),
            scheduling: self.scheduling.clone(),
            detail: detail.to_owned(),
            signal,
        };
        self.measurements.publish()?;
        let line = serde_json::to_string(&ready).map_err(|error| ProcessError::Ready(error.into()))?;
        writeln!(std::io::stdout(), "{line}").map_err(ProcessError::Ready)?;
        self.is_ready = true;
        Ok(())
    }

    /// Hands every message of `input` to `consumer` as it comes, until the process is to stop.
    ///
    /// # Errors
    ///
    /// The first error of the consumer, or of the transport.
    pub fn consume<H: Traced, E: Element>(
        &mut self,
        mut input: Subscriber<H, E>,
        mut consumer: impl Consumer<H, E>,
    ) -> Result<(), ProcessError> {
        loop {
            let rehearsal_ns = consumer.rehearsal_ns();
            let deadlines_ns = [rehearsal_ns, self.measurements.deadline_ns()];
            match self.control.wait(Some(input.as_fd()), deadlines_ns.into_iter().flatten().min())? {
                Wake::Stop => break,
                Wake::Order(order) => consumer.obey(order),
                Wake::Deadline => {
                    if rehearsal_ns.is_some_and(|rehearsal_ns| now_ns() >= rehearsal_ns) {
                        consumer.rehearse().map_err(|error| ProcessError::Work(error.into()))?;
                    }
                    self.measurements.publish_if_due()?;
                }
                Wake::Message => {
                    input.acknowledge_wakes()?;
                    while !self.control.is_stopped() {
                        let Some(message) = input.receive()? else { break };
                        let measured = match consumer.take(self, &message) {
                            // Being stopped while the next stage takes nothing more is no failure.
                            Err(_) if self.control.is_stopped() => break,
                            measured => measured.map_err(|error| ProcessError::Work(error.into()))?,
                        };
                        drop(message);
                        self.count(&input);
                        self.measurements.record(measured)?;
                    }
                }
            }
        }
        self.measurements.publish()
    }

    /// Takes over what `input` has counted.
    pub fn count<H: Traced, E: Element>(&mut self, input: &Subscriber<H, E>) {
        let counts = &mut self.measurements.counts;
        counts.received = input.received();
        counts.lost = input.lost();
        if let Some((first_sequence, next_sequence)) = input.sequence_range() {
            counts.first_sequence = first_sequence;
            counts.next_sequence = next_sequence;
        }
    }

    /// Whether what was captured then is too old to act upon now, or cannot have been captured then. In a lossless replay
    /// nothing is: its messages wait for each other as long as it takes.
    pub fn is_stale(&self, trace: &Trace) -> bool {
        self.config.delivery() == Delivery::Live && trace.is_stale(STALE_NS, now_ns())
    }

    /// Transit and work of a message with this trace, which led to a publication at `published_ns` or to none.
    pub fn measure(&self, trace: &Trace, published_ns: Option<u64>) -> Measured {
        Measured::Message(self.message_times(trace, published_ns))
    }

    /// As [`StageProcess::measure`], for a stage that measures more than these times.
    pub fn message_times(&self, trace: &Trace, published_ns: Option<u64>) -> MessageTimes {
        let received_ns = trace.received_ns[self.stage.index()];
        let sent_ns = self.stage.upstream().map_or(0, |upstream| trace.published_ns[upstream.index()]);
        MessageTimes {
            transit_ns: received_ns.saturating_sub(sent_ns),
            work_ns: published_ns.unwrap_or_else(now_ns).saturating_sub(received_ns),
            newest_sample_to_publish_ns: published_ns
                .map(|published_ns| published_ns.saturating_sub(trace.captured_ns)),
        }
    }
}

/// The `main` of a stage: prepares the process, opens the stage with `open`, and runs what that gives until
/// it ends.
pub fn main<Run, RunError>(
    stage: Stage,
    open: impl FnOnce(&mut StageProcess) -> Result<Run, WorkError>,
) -> ExitCode
where
    Run: FnOnce(&mut StageProcess) -> Result<(), RunError>,
    RunError: Into<WorkError>,
{
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        // A standard error that is closed must not end a stage.
        .log_internal_errors(false)
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_env("TENDON_LOG").unwrap_or_else(|_| "warn".into()),
        )
        .init();
    let arguments = Arguments::parse();
    let opened = prepare(stage, &arguments)
        .map_err(WorkError::from)
        .and_then(|mut process| Ok((open(&mut process)?, process)));
    let (result, failure) = match opened {
        Ok((run, mut process)) => {
            let result = run(&mut process).map_err(Into::into);
            (result, ExitCode::from(if process.is_ready { 1 } else { 2 }))
        }
        Err(error) => (Err(error), ExitCode::from(2)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Without standard error there is nobody left to tell; the exit code still says it.
            let text = with_causes(error.as_ref());
            let _ = writeln!(std::io::stderr(), "tendon {}: error: {text}", stage.name());
            failure
        }
    }
}

fn prepare(stage: Stage, arguments: &Arguments) -> Result<StageProcess, ProcessError> {
    let config = Config::read(&arguments.config)?;
    config.check()?;
    let control = Control::install()?;
    let scheduling = match config.delivery() {
        Delivery::Live => scheduling::schedule(&config.scheduling, stage)?,
        // Nothing is urgent in a replay at full speed: it takes all cores, and lets others have theirs.
        Delivery::Lossless => Scheduling::untouched(),
    };
    let session = Session::join(&config.session, stage.name())?;
    let measurements = Measurements::open(&session, stage)?;
    let (is_restarted, follows_on_session) = (arguments.restarted, arguments.follows_on_session);
    Ok(StageProcess {
        stage,
        config,
        session,
        control,
        measurements,
        scheduling,
        is_restarted,
        follows_on_session,
        is_ready: false,
    })
}
