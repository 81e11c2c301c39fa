//! Transit between two processes: Tendon's own hop beside its peers.
//!
//! One sender process serves all lanes, each lane has a receiver process of its own, asleep until its message
//! comes. The lanes take turns of half a second at the one pace, so that whatever else the machine does hits
//! them all alike. Sender and receivers are scheduled as acquisition and dsp are.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use serde::Serialize;
use tendon_config::{Realtime, SchedulingSettings};
use tendon_messages::Stage;
use tendon_process::{Control, Policy, Scheduling, Wake, schedule};
use tendon_report::{LatencySummary, duration_histogram};
use tendon_transport::{Leftovers, SessionLock, SessionName, now_ns};

use crate::busy;
use crate::child::Child;
use crate::transports::{BLOCK_SAMPLES, Lane, Transport};

/// Length of a lane's turn.
const TURN_S: f64 = 0.5;
/// Messages at the start of every turn that are not counted: the lane has been idle for seconds, its memory
/// has left the caches, which never happens to a hop of a running session.
const WARM_UP_MESSAGES: u64 = 10;
/// How long a child may take beyond what it was given to do.
const PATIENCE: Duration = Duration::from_secs(20);

/// How often and how long the lanes take turns.
#[derive(Clone, Copy, Debug, Args)]
struct Turns {
    /// Turns of each lane.
    #[arg(long)]
    turns: u64,
    /// Messages counted in a turn.
    #[arg(long)]
    turn_messages: u64,
}

impl Turns {
    fn messages_sent(self) -> u64 {
        self.turns * (WARM_UP_MESSAGES + self.turn_messages)
    }
}

/// Where and how a sender or receiver runs.
#[derive(Debug, Args)]
struct ChildArguments {
    /// For sockets.
    #[arg(long)]
    directory: PathBuf,
    /// Ask for SCHED_FIFO.
    #[arg(long)]
    realtime: bool,
    #[command(flatten)]
    turns: Turns,
}

impl ChildArguments {
    fn schedule(&self, stage: Stage) -> anyhow::Result<Scheduling> {
        let realtime = if self.realtime { Realtime::Auto } else { Realtime::Off };
        Ok(schedule(&SchedulingSettings { realtime, one_core: true }, stage)?)
    }
}

/// Command line of the sender process.
#[derive(Debug, Args)]
pub struct SendArguments {
    #[command(flatten)]
    child: ChildArguments,
    #[arg(long)]
    interval_ns: u64,
}

/// Command line of a receiver process.
#[derive(Debug, Args)]
pub struct ReceiveArguments {
    #[command(flatten)]
    child: ChildArguments,
    #[arg(long)]
    transport: Transport,
    #[arg(long)]
    channels: usize,
}

/// The sender process: one line when ready, one when all is sent; then it waits to be stopped, because what
/// was sent may not have been taken yet.
pub fn send(arguments: &SendArguments) -> anyhow::Result<()> {
    let scheduling = arguments.child.schedule(Stage::Acquisition)?;
    let lanes = Lane::all();
    let mut senders =
        lanes.iter().map(|lane| lane.sender(&arguments.child.directory)).collect::<Result<Vec<_>, _>>()?;
    let blocks: Vec<Vec<f32>> = lanes.iter().map(|lane| vec![1.0; lane.block_length()]).collect();
    let mut control = Control::install()?;
    say(&scheduling)?;
    let turns = arguments.child.turns;
    let mut due_ns = now_ns();
    for _ in 0..turns.turns {
        for (sender, block) in senders.iter_mut().zip(&blocks) {
            for _ in 0..WARM_UP_MESSAGES + turns.turn_messages {
                due_ns += arguments.interval_ns;
                while now_ns() < due_ns {
                    if control.wait(None, Some(due_ns))? == Wake::Stop {
                        bail!("told to stop");
                    }
                }
                sender.send(block)?;
            }
        }
    }
    say(&turns.messages_sent())?;
    while control.wait(None, None)? != Wake::Stop {}
    Ok(())
}

/// A receiver process: one line when ready, one with what it measured.
pub fn receive(arguments: &ReceiveArguments) -> anyhow::Result<()> {
    let scheduling = arguments.child.schedule(Stage::Dsp)?;
    let lane = Lane { transport: arguments.transport, channels: arguments.channels };
    let mut receiver = lane.receiver(&arguments.child.directory)?;
    let mut transits = duration_histogram();
    say(&scheduling)?;
    let turns = arguments.child.turns;
    for _ in 0..turns.turns {
        for message in 0..WARM_UP_MESSAGES + turns.turn_messages {
            let transit_ns = receiver.receive()?;
            if message >= WARM_UP_MESSAGES {
                transits.saturating_record(transit_ns);
            }
        }
    }
    say(&LatencySummary::of(&transits))
}

fn say(result: &impl Serialize) -> anyhow::Result<()> {
    println!("{}", serde_json::to_string(result).context("cannot say the result")?);
    Ok(())
}

/// Transits of all lanes under all conditions.
#[derive(Debug, Serialize)]
pub struct HopReport {
    /// Messages a second.
    rate_hz: f64,
    /// Samples of each channel in a block.
    block_samples: usize,
    conditions: Vec<Condition>,
}

/// Transits of all lanes while the machine was in one state.
#[derive(Debug, Serialize)]
struct Condition {
    /// Whether every core ran a busy loop beside.
    saturated: bool,
    scheduling: Scheduling,
    lanes: Vec<LaneTransit>,
    ratios: Vec<Ratio>,
}

#[derive(Debug, Serialize)]
struct LaneTransit {
    transport: Transport,
    channels: usize,
    #[serde(flatten)]
    transit: LatencySummary,
}

/// Something the design promises, as a quotient of two durations and what it may be at most.
#[derive(Debug, Serialize)]
struct Ratio {
    what: String,
    ratio: f64,
    at_most: f64,
}

/// Measures and prints all lanes: idle and saturated, with real-time scheduling and without.
pub fn measure(seconds: f64, rate_hz: f64) -> anyhow::Result<HopReport> {
    if !(seconds.is_finite() && seconds > 0.0 && (1.0..=10_000.0).contains(&rate_hz)) {
        bail!("--seconds {seconds} --rate-hz {rate_hz}: give more than 0 s, and 1 to 10 000 Hz");
    }
    let locks = take_sessions()?;
    let turns =
        Turns { turns: (seconds / TURN_S).ceil() as u64, turn_messages: (TURN_S * rate_hz).ceil() as u64 };
    println!(
        "\nHops: publish to receive, blocks of {BLOCK_SAMPLES} samples, {rate_hz} Hz, in turns of {TURN_S} s"
    );
    let mut conditions = Vec::new();
    for realtime in [true, false] {
        for saturated in [false, true] {
            if let Some(condition) = measure_condition(saturated, realtime, turns, rate_hz)? {
                condition.print();
                conditions.push(condition);
            }
        }
    }
    remove_leftovers(&locks);
    Ok(HopReport { rate_hz, block_samples: BLOCK_SAMPLES, conditions })
}

/// Takes the sessions that the lanes use and removes what an earlier, broken-off run left in them.
fn take_sessions() -> anyhow::Result<Vec<(SessionName, SessionLock)>> {
    let mut sessions: Vec<(SessionName, SessionLock)> = Vec::new();
    for name in Lane::all().into_iter().map(Lane::session_name) {
        if sessions.iter().all(|(taken, _)| *taken != name) {
            let lock = SessionLock::take(&name).context("is another benchmark running?")?;
            sessions.push((name, lock));
        }
    }
    remove_leftovers(&sessions);
    Ok(sessions)
}

fn remove_leftovers(sessions: &[(SessionName, SessionLock)]) {
    for (_, lock) in sessions {
        Leftovers::remove(lock);
    }
}

/// `None` when real-time scheduling is wanted and not to be had.
fn measure_condition(
    saturated: bool,
    realtime: bool,
    turns: Turns,
    rate_hz: f64,
) -> anyhow::Result<Option<Condition>> {
    let cores = std::thread::available_parallelism().context("cannot count the cores")?.get();
    let directory = tempfile::tempdir().context("cannot make a folder for sockets")?;
    let child_arguments = |command: &str| {
        let mut arguments = vec![command.to_owned()];
        let mut add = |name: &str, value: String| arguments.extend([name.to_owned(), value]);
        add("--directory", directory.path().display().to_string());
        add("--turns", turns.turns.to_string());
        add("--turn-messages", turns.turn_messages.to_string());
        if realtime {
            arguments.push("--realtime".to_owned());
        }
        arguments
    };
    let mut receivers = Vec::new();
    for lane in Lane::all() {
        let transport = lane.transport.to_possible_value().context("every transport can be named")?;
        let mut arguments = child_arguments("receive");
        arguments.extend(["--transport".to_owned(), transport.get_name().to_owned()]);
        arguments.extend(["--channels".to_owned(), lane.channels.to_string()]);
        let mut receiver = Child::start(&arguments)?;
        let scheduling: Scheduling = receiver.line(PATIENCE)?;
        if realtime && !matches!(scheduling.policy, Policy::Fifo(_)) {
            println!("\nReal-time scheduling is left out: {}", scheduling.shortfall);
            return Ok(None);
        }
        receivers.push((lane, receiver));
    }
    let interval_ns = (1e9 / rate_hz).round() as u64;
    let mut arguments = child_arguments("send");
    arguments.extend(["--interval-ns".to_owned(), interval_ns.to_string()]);
    let busy = if saturated { busy::saturate(cores)? } else { Vec::new() };
    let mut sender = Child::start(&arguments)?;
    let scheduling = sender.line(PATIENCE)?;
    let messages = turns.messages_sent() * receivers.len() as u64;
    let _: u64 = sender.line(PATIENCE + Duration::from_nanos(interval_ns * messages))?;
    let mut lanes = Vec::new();
    for (Lane { transport, channels }, mut receiver) in receivers {
        lanes.push(LaneTransit { transport, channels, transit: receiver.line(PATIENCE)? });
        receiver.finish()?;
    }
    sender.finish()?;
    drop(busy);
    let ratios = ratios(&lanes);
    Ok(Some(Condition { saturated, scheduling, lanes, ratios }))
}

fn ratios(lanes: &[LaneTransit]) -> Vec<Ratio> {
    let of = |transport, channels| {
        let lane = lanes.iter().find(|lane| (lane.transport, lane.channels) == (transport, channels));
        lane.map(|lane| lane.transit).unwrap_or_default()
    };
    let ratio = |what: String, ours_us: f64, theirs_us: f64, at_most| Ratio {
        what,
        ratio: ours_us / theirs_us,
        at_most,
    };
    let mut ratios = Vec::new();
    for channels in [4, 64] {
        let (ours, bare) = (of(Transport::Tendon, channels), of(Transport::BareIceoryx2, channels));
        let name = |quantile| format!("{quantile} of tendon over bare iceoryx2, {channels} channels");
        ratios.push(ratio(name("p50"), ours.p50_us, bare.p50_us, 1.3));
        ratios.push(ratio(name("p99"), ours.p99_us, bare.p99_us, 1.3));
    }
    let [few, many] = [4, 64].map(|channels| of(Transport::Tendon, channels));
    ratios.push(ratio("p50 of tendon, 64 over 4 channels".to_owned(), many.p50_us, few.p50_us, 1.5));
    ratios
}

impl Condition {
    fn print(&self) {
        let load = if self.saturated { "every core saturated" } else { "no load added" };
        println!("\n{load}; sender {}", self.scheduling);
        println!("  {:<14} {:>8}  {}", "transport", "channels", crate::COLUMNS);
        for LaneTransit { transport, channels, transit } in &self.lanes {
            println!("  {:<14} {channels:>8}  {}", transport.name(), crate::columns(transit));
        }
        for Ratio { what, ratio, at_most } in &self.ratios {
            println!("  {what}: {ratio:.2} (at most {at_most})");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_compare_tendon_with_bare_iceoryx2_and_many_channels_with_few() {
        let lane = |transport, channels, p50_us, p99_us| LaneTransit {
            transport,
            channels,
            transit: LatencySummary { p50_us, p99_us, ..LatencySummary::default() },
        };
        let lanes = [
            lane(Transport::Tendon, 4, 12.0, 30.0),
            lane(Transport::Tendon, 64, 18.0, 40.0),
            lane(Transport::BareIceoryx2, 4, 10.0, 20.0),
            lane(Transport::BareIceoryx2, 64, 9.0, 10.0),
        ];
        let values: Vec<f64> = ratios(&lanes).iter().map(|ratio| ratio.ratio).collect();
        assert_eq!(values, [1.2, 1.5, 2.0, 4.0, 1.5]);
    }
}
