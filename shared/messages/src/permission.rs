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
    /// A stage ended and was started again.
    StageEnded = 11,
    /// There is no record that the arm was left in good order.
    NotLeftInGoodOrder = 12,
    /// The arm was left in good order, but at other joint angles than it reports now.
    MovedSince = 13,
    /// The record of how the arm was left cannot be read, or is not to be trusted.
    RecordUnusable = 14,
    /// The start position is far away; [`StateHeader::start_distance_mm`](crate::StateHeader::start_distance_mm).
    StartIsFar = 15,
    /// The straight way of the joints to the start position leaves the workspace box.
    WayLeavesBox = 16,
    /// The flange moves though it is commanded to rest.
    Creeping = 17,
    /// Another program changed the arm's mode or state.
    TakenOver = 18,
    /// The arm refused a velocity.
    VelocityRefused = 19,
    /// The arm, or its firmware, is none that Tendon drives.
    UnsupportedArm = 20,
    /// The arm has not answered or reported for a while.
    ArmSilent = 21,
}

impl StopReason {
    /// All of them, in the order of their numbers, which begin with 1.
    const ALL: [StopReason; 21] = [
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
        StopReason::NotLeftInGoodOrder,
        StopReason::MovedSince,
        StopReason::RecordUnusable,
        StopReason::StartIsFar,
        StopReason::WayLeavesBox,
        StopReason::Creeping,
        StopReason::TakenOver,
        StopReason::VelocityRefused,
        StopReason::UnsupportedArm,
        StopReason::ArmSilent,
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
            StopReason::StageEnded => "a stage ended: see above which one",
            StopReason::NotLeftInGoodOrder => {
                "no record says that the last session left the arm in good order: look at the arm and its surroundings"
            }
            StopReason::MovedSince => {
                "the arm is not where the last session left it: look at the arm and its surroundings"
            }
            StopReason::RecordUnusable => {
                "the record of how the arm was left cannot be used: look at the arm and its surroundings"
            }
            StopReason::StartIsFar => "the start position is far away",
            StopReason::WayLeavesBox => "the way to the start position leaves the workspace box",
            StopReason::Creeping => "the arm moved though commanded to rest: find out what drives or pulls it",
            StopReason::TakenOver => "another program changed the arm's mode: quit that program",
            StopReason::VelocityRefused => "the arm refused a velocity: quit other programs that use it",
            StopReason::UnsupportedArm => "the arm or its firmware is not supported: see the robot's message",
            StopReason::ArmSilent => "the arm did not answer in time: check its network",
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
        assert_eq!(StopReason::from_number(22), None);
        for permission in [Permission::Granted, Permission::AwaitRest, Permission::Stopped] {
            assert_eq!(Permission::from_number(permission as u8), permission);
        }
        assert_eq!(Permission::from_number(77), Permission::Stopped);
    }
}
