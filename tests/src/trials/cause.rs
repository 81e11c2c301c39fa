//! What is done to a session, when, and what follows from it.

use nix::sys::signal::Signal;
use serde::Serialize;
use tendon_messages::Stage;

/// A process of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Victim {
    /// One of the stages.
    Stage(Stage),
    /// `tendon run` itself.
    Supervisor,
}

/// How somebody stops the arm, or ends the session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The space bar.
    Space,
    /// The key q.
    Quit,
    /// Ctrl-C as a key.
    ControlC,
    /// A signal to `tendon run`.
    Signal(Signal),
    /// `tendon stop`.
    Stop,
}

/// Where `tendon run` writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// A pipe each for standard output and error.
    Pipes,
    /// A terminal for all three.
    Terminal,
    /// `/dev/full` for standard output and error.
    FullDevice,
}

/// What is done to a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A process is killed.
    Kill(Victim),
    /// A process hangs.
    Hang(Victim),
    /// The connection to the arm is cut.
    Cut,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The arm collides.
    Collision,
    /// The arm reports another error: a joint limit.
    ArmError,
    /// An order, with outputs that work.
    Order(Order),
    /// Nobody reads the output any more, though it stays open; then an order.
    Stalled(Output, Order),
    /// Whoever reads standard output closes it, as `head` does; then SIGTERM.
    ClosedOutput,
    /// Whoever reads standard output and error closes both; then SIGTERM.
    ClosedOutputs,
    /// Nothing can be written, from the start; then SIGTERM.
    FullDevice,
    /// The terminal goes away.
    TerminalGone,
}

/// When it is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
pub enum Phase {
    /// While the stages start.
    StartUp,
    /// While the arm goes to its start position.
    WayToStart,
    /// While a gesture moves the arm at full speed.
    Moving,
    /// While the session ends, after SIGTERM at full speed.
    ShutDown,
}

impl Phase {
    /// All of them, in their order in time.
    pub const ALL: [Phase; 4] = [Phase::StartUp, Phase::WayToStart, Phase::Moving, Phase::ShutDown];
}

const VICTIMS: [Victim; 6] = [
    Victim::Stage(Stage::Acquisition),
    Victim::Stage(Stage::Dsp),
    Victim::Stage(Stage::Inference),
    Victim::Stage(Stage::Decision),
    Victim::Stage(Stage::Robot),
    Victim::Supervisor,
];

/// Every cause but those that have a victim.
const OTHER_CAUSES: [Cause; 20] = [
    Cause::Cut,
    Cause::EmergencyStop,
    Cause::Collision,
    Cause::ArmError,
    Cause::Order(Order::Stop),
    Cause::Order(Order::Signal(Signal::SIGTERM)),
    Cause::Order(Order::Signal(Signal::SIGINT)),
    Cause::Order(Order::Signal(Signal::SIGHUP)),
    Cause::Stalled(Output::Pipes, Order::Stop),
    Cause::Stalled(Output::Pipes, Order::Signal(Signal::SIGTERM)),
    Cause::Stalled(Output::Pipes, Order::Signal(Signal::SIGINT)),
    Cause::Stalled(Output::Terminal, Order::Space),
    Cause::Stalled(Output::Terminal, Order::Quit),
    Cause::Stalled(Output::Terminal, Order::ControlC),
    Cause::Stalled(Output::Terminal, Order::Signal(Signal::SIGTERM)),
    Cause::Stalled(Output::Terminal, Order::Stop),
    Cause::ClosedOutput,
    Cause::ClosedOutputs,
    Cause::FullDevice,
    Cause::TerminalGone,
];

impl Cause {
    /// All causes.
    pub fn all() -> Vec<Cause> {
        let kills = VICTIMS.map(Cause::Kill);
        let hangs = VICTIMS.map(Cause::Hang);
        kills.into_iter().chain(hangs).chain(OTHER_CAUSES).collect()
    }

    /// In words, for a table.
    pub fn name(self) -> String {
        let victim = |victim| match victim {
            Victim::Stage(stage) => stage.name(),
            Victim::Supervisor => "supervisor",
        };
        let order = |order| match order {
            Order::Space => "space bar".to_owned(),
            Order::Quit => "key q".to_owned(),
            Order::ControlC => "Ctrl-C".to_owned(),
            Order::Signal(signal) => signal.to_string(),
            Order::Stop => "tendon stop".to_owned(),
        };
        match self {
            Cause::Kill(who) => format!("kill {}", victim(who)),
            Cause::Hang(who) => format!("hang {}", victim(who)),
            Cause::Cut => "connection cut".to_owned(),
            Cause::EmergencyStop => "emergency stop".to_owned(),
            Cause::Collision => "collision".to_owned(),
            Cause::ArmError => "joint limit".to_owned(),
            Cause::Order(by) => order(by),
            Cause::Stalled(Output::Terminal, by) => format!("stalled terminal, {}", order(by)),
            Cause::Stalled(_, by) => format!("stalled pipe, {}", order(by)),
            Cause::ClosedOutput => "closed output".to_owned(),
            Cause::ClosedOutputs => "closed outputs".to_owned(),
            Cause::FullDevice => "full device".to_owned(),
            Cause::TerminalGone => "terminal gone".to_owned(),
        }
    }

    /// Where the session must write for it.
    pub fn output(self) -> Output {
        match self {
            Cause::Stalled(output, _) => output,
            Cause::TerminalGone => Output::Terminal,
            Cause::FullDevice => Output::FullDevice,
            _ => Output::Pipes,
        }
    }

    /// Whether the arm has an error afterwards that somebody has to acknowledge.
    fn is_error_of_arm(self) -> bool {
        matches!(self, Cause::EmergencyStop | Cause::Collision | Cause::ArmError)
    }

    /// Whether it stops the arm until somebody arms it. Silence does not: after it, a rest is enough. Nor does what ends
    /// the session in good order.
    fn is_stop(self) -> bool {
        match self {
            Cause::Kill(_) | Cause::Cut | Cause::Order(Order::Stop | Order::Space) => true,
            Cause::Stalled(_, Order::Stop | Order::Space) => true,
            _ => self.is_error_of_arm(),
        }
    }

    /// Whether the arm must be at rest soon after it in `phase`. While the arm goes to its start, a stage through which
    /// nothing flows yet may hang without anybody's knowing; and a connection that is not there yet cannot be cut.
    pub fn must_stop(self, phase: Phase) -> bool {
        match self {
            Cause::Hang(Victim::Stage(stage)) if stage != Stage::Robot => {
                matches!(phase, Phase::Moving | Phase::ShutDown)
            }
            Cause::Cut => phase != Phase::StartUp,
            _ => true,
        }
    }

    /// Whether the next session may move the arm before anybody has armed it. `has_record`: the arm's record says that
    /// it was left in good order; in the first moments of the start nobody has taken the one before away yet.
    pub fn may_move_afterwards(self, phase: Phase, has_record: bool) -> bool {
        match phase {
            Phase::StartUp => has_record && !self.is_error_of_arm(),
            Phase::WayToStart | Phase::Moving => !self.is_stop(),
            // It was told to end in good order, and may have done so before the cause had its effect.
            Phase::ShutDown => !self.is_error_of_arm(),
        }
    }
}

/// The plan of a trial.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// What is done.
    pub cause: Cause,
    /// When.
    pub phase: Phase,
    /// How far into the phase, as a share of its length: 0 to 1.
    pub moment: f64,
    /// Whether an emergency stop is released before the next session.
    pub is_released: bool,
}

impl Plan {
    /// The plan of a seed. Successive seeds go through every cause in every phase.
    pub fn of(seed: u64) -> Plan {
        let causes = Cause::all();
        let combinations = (causes.len() * Phase::ALL.len()) as u64;
        let combination = (seed % combinations) as usize;
        let random = mixed(seed);
        Plan {
            cause: causes[combination / Phase::ALL.len()],
            phase: Phase::ALL[combination % Phase::ALL.len()],
            moment: (random >> 11) as f64 / (1_u64 << 53) as f64,
            is_released: random & 1 == 1,
        }
    }
}

/// The finaliser of SplitMix64.
fn mixed(seed: u64) -> u64 {
    let mut bits = seed.wrapping_add(0x9E37_79B9_7F4A_7C15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    bits ^ (bits >> 31)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn successive_seeds_try_every_cause_in_every_phase() {
        let combinations = Cause::all().len() * Phase::ALL.len();
        let planned: BTreeSet<(String, Phase)> =
            (1..=combinations as u64).map(Plan::of).map(|plan| (plan.cause.name(), plan.phase)).collect();
        assert_eq!(planned.len(), combinations);
        let moments: Vec<f64> = (1..=1000).map(|seed| Plan::of(seed).moment).collect();
        assert!(moments.iter().all(|moment| (0.0..1.0).contains(moment)));
        assert!((moments.iter().sum::<f64>() / 1000.0 - 0.5).abs() < 0.05);
    }
}
