//! Whether the arm may move, and why it may not.

use core::fmt;

/// Whether the arm may move, as it travels in [`StateHeader::permission`](crate::StateHeader::permission).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Permission {
    /// It follows commands.
    Granted = 0,
    /// It will follow them once the person has been at rest, so that nothing that was meant before moves it.
    AwaitRest = 1,
    /// It follows none before `tendon arm`.
    Stopped = 2,
}

impl Permission {
    /// The permission with this number. What no sender of ours writes is taken for the harmless one.
    pub fn from_number(number: u8) -> Permission {
        match number {
            0 => Permission::Granted,
            1 => Permission::AwaitRest,
            _ => Permission::Stopped,
        }
    }
}

/// Why the arm may not move, as it travels in [`StateHeader::stop_reason`](crate::StateHeader::stop_reason).
/// Displayed, it says what to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum StopReason {
    /// No fresh command came in time.
    NoCommands = 1,
    /// The supervisor did not say in time that it is there.
    SupervisorSilent = 2,
    /// The robot process itself stood still for too long.
    RobotStalled = 3,
    /// `tendon stop`, or the space bar.
    Ordered = 4,
    /// The arm has an error.
    ArmFault = 5,
    /// The connection to the arm broke, or its reports stopped.
    ConnectionBroke = 6,
    /// The arm was taken out of motion by somebody else.
    NotReady = 7,
    /// A joint is beyond its limit.
    JointLimit = 8,
    /// The flange is outside the workspace box.
    WorkspaceBox = 9,
    /// The flange is faster than allowed.
    OverSpeed = 10,
    /// A stage ended and was started again, or the session before left the arm stopped.
    StageEnded = 11,
}

impl StopReason {
    /// All of them, in the order of their numbers, which begin with 1.
    const ALL: [StopReason; 11] = [
        StopReason::NoCommands,
        StopReason::SupervisorSilent,
        StopReason::RobotStalled,
        StopReason::Ordered,
        StopReason::ArmFault,
        StopReason::ConnectionBroke,
        StopReason::NotReady,
        StopReason::JointLimit,
        StopReason::WorkspaceBox,
        StopReason::OverSpeed,
        StopReason::StageEnded,
    ];

    /// The reason with this number; `None` for 0 and for what no sender of ours writes.
    pub fn from_number(number: u8) -> Option<StopReason> {
        StopReason::ALL.get(usize::from(number).checked_sub(1)?).copied()
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            StopReason::NoCommands => "no fresh commands came: look for the stage that is slow or gone",
            StopReason::SupervisorSilent => "the supervisor was silent: see whether it hangs",
            StopReason::RobotStalled => "the robot process stood still: free the processor for it",
            StopReason::Ordered => "stopped by order",
            StopReason::ArmFault => "the arm has an error",
            StopReason::ConnectionBroke => "the connection to the arm broke: check its cable and power",
            StopReason::NotReady => {
                "the arm was stopped by its emergency button or another program: release it, quit the other"
            }
            StopReason::JointLimit => "a joint is at its limit: drive the arm back by gestures",
            StopReason::WorkspaceBox => "the arm left the workspace box: drive it back by gestures",
            StopReason::OverSpeed => "the arm was faster than allowed: check what pulls it, and its settings",
            StopReason::StageEnded => "a stage ended, or the session before left it stopped: see above",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_reasons_go_both_ways() {
        for (index, reason) in StopReason::ALL.into_iter().enumerate() {
            assert_eq!(reason as usize, index + 1);
            assert_eq!(StopReason::from_number(reason as u8), Some(reason));
        }
        assert_eq!(StopReason::from_number(0), None);
        assert_eq!(StopReason::from_number(12), None);
        for permission in [Permission::Granted, Permission::AwaitRest, Permission::Stopped] {
            assert_eq!(Permission::from_number(permission as u8), permission);
        }
        assert_eq!(Permission::from_number(77), Permission::Stopped);
    }
}
