//! What `tendon stop` and `tendon arm` are answered.

use tendon_messages::StopReason;

use crate::arm::Stop;

/// What came of an order to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopAnswer {
    /// The arm was told, and answers.
    Stopped,
    /// There is no connection over which the arm could hear of it.
    NotConnected,
    /// The arm does not answer.
    ArmSilent,
}

impl StopAnswer {
    /// The answer as a sentence.
    pub fn text(self) -> &'static str {
        match self {
            StopAnswer::Stopped => "the arm is stopped: `tendon arm` permits motion again",
            StopAnswer::NotConnected => {
                "not confirmed: there is no connection to the arm; use its emergency stop button"
            }
            StopAnswer::ArmSilent => "not confirmed: the arm does not answer; use its emergency stop button",
        }
    }
}

/// Why an order to permit motion counts for nothing: its sender saw the arm as it was before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outdated {
    /// The arm was stopped after its sender looked, or a new reason for the stop became known.
    StoppedSince,
    /// Its sender looked too long ago, or claims to have seen what is to come.
    TooLate,
}

impl Outdated {
    /// The answer as a sentence.
    pub fn text(self) -> &'static str {
        match self {
            Outdated::StoppedSince => {
                "not armed: whoever gave this order cannot have seen the newest stop yet; look at the arm again, then arm it anew"
            }
            Outdated::TooLate => {
                "not armed: the order came too late; look at the arm again, then arm it anew"
            }
        }
    }
}

/// What came of an order to permit motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmAnswer {
    /// The arm was brought up.
    Armed,
    /// It was armed before, and waits for a rest.
    AwaitsRest,
    /// It was armed before, and follows commands.
    AlreadyArmed,
    /// It is on the way to its start position.
    GoingToStart,
    /// It is being brought up, by an order before or at the start.
    BringingUp,
    /// There is no connection to it, for this reason.
    NotConnected(StopReason),
    /// The supervisor is silent, so nothing is to move.
    SupervisorSilent,
    /// It did not come up, or was stopped meanwhile.
    Failed(Stop),
    /// It did not come up in time.
    TooSlow,
}

impl ArmAnswer {
    /// Whether the arm is armed now, or will be by itself.
    pub fn is_success(self) -> bool {
        use ArmAnswer::{AlreadyArmed, Armed, AwaitsRest, BringingUp, GoingToStart};
        matches!(self, Armed | AwaitsRest | AlreadyArmed | GoingToStart | BringingUp)
    }

    /// The answer as a sentence; `words` says why the arm stopped and what to do.
    pub fn text(self, words: impl Fn(Stop) -> String) -> String {
        match self {
            ArmAnswer::Armed => "armed: the arm moves once the muscles have been at rest".to_owned(),
            ArmAnswer::AwaitsRest => {
                "already armed: the arm moves once the muscles have been at rest".to_owned()
            }
            ArmAnswer::AlreadyArmed => "already armed: the arm follows commands".to_owned(),
            ArmAnswer::GoingToStart => {
                "armed: the arm goes to its start position, then moves once the muscles have been at rest"
                    .to_owned()
            }
            ArmAnswer::BringingUp => {
                "the arm is being brought up: wait, or stop it with `tendon stop`".to_owned()
            }
            ArmAnswer::NotConnected(reason) => format!("not armed: {}", words(Stop::because(reason))),
            ArmAnswer::SupervisorSilent => {
                format!("not armed: {}", words(Stop::because(StopReason::SupervisorSilent)))
            }
            ArmAnswer::Failed(stop) => format!("not armed: {}", words(stop)),
            ArmAnswer::TooSlow => {
                "not armed: the arm was not brought up in time; look at its control box, then try again"
                    .to_owned()
            }
        }
    }
}
