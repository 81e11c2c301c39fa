//! Whether the arm may move, and why it may not.

use core::fmt;

use crate::numbered::numbered;

numbered! {
    /// Whether the arm may move, as it travels in [`StateHeader::permission`](crate::StateHeader::permission).
    pub enum Permission {
        /// It follows commands.
        Granted = 0,
        /// It will follow them once the person has been at rest, so that nothing that was meant before moves it.
        AwaitRest = 1,
        /// It follows none before `tendon arm`.
        Stopped = 2,
    } otherwise Stopped
}

numbered! {
    /// Why the arm may not move, as it travels in [`StateHeader::stop_reason`](crate::StateHeader::stop_reason).
    /// Displayed, it says what to do.
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
        /// The flange does not move as it was told.
        NotFollowing = 22,
        /// The start position is beyond the joint limits of this arm.
        StartBeyondLimit = 23,
        /// The arm stands outside the workspace box at the start.
        OutsideBox = 24,
        /// The arm was left in good order, but another user's session has used it since.
        UsedSince = 25,
        /// There has been no connection to the arm yet.
        NeverConnected = 26,
        /// The session follows on another, and nobody has said yet that the arm may move in it.
        NextSession = 27,
    }
}

/// Says in words whether the arm may move, each time that changes.
#[derive(Clone, Debug, Default)]
pub struct PermissionChanges {
    /// As last said.
    last: Option<(u8, u8)>,
}

impl PermissionChanges {
    /// What to say of this [`StateHeader::permission`](crate::StateHeader::permission) and
    /// [`StateHeader::stop_reason`](crate::StateHeader::stop_reason); `None` if it is what was last said.
    pub fn said(&mut self, permission: u8, stop_reason: u8) -> Option<String> {
        let now = (permission, stop_reason);
        if self.last.replace(now) == Some(now) {
            return None;
        }
        let reason = StopReason::from_number(stop_reason);
        let reason = reason.map_or(String::new(), |reason| format!(": {reason}"));
        Some(match Permission::from_number(permission) {
            Permission::Granted => "arm follows".to_owned(),
            Permission::AwaitRest => format!("arm waits for rest{reason}"),
            Permission::Stopped => format!("arm is stopped{reason}"),
        })
    }
}

impl StopReason {
    /// Whether it says how the arm was found at the start: then it has not been stopped, and waits for its first
    /// `tendon arm`.
    pub fn is_how_found(self) -> bool {
        use StopReason::{
            MovedSince, NextSession, NotLeftInGoodOrder, OutsideBox, RecordUnusable, StartBeyondLimit,
            StartIsFar, UsedSince, WayLeavesBox,
        };
        matches!(
            self,
            NotLeftInGoodOrder
                | UsedSince
                | RecordUnusable
                | MovedSince
                | StartIsFar
                | StartBeyondLimit
                | OutsideBox
                | WayLeavesBox
                | NextSession
        )
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            StopReason::NoCommands => "no fresh commands came: see whether the amplifier sends, or which stage is slow or gone",
            StopReason::SupervisorSilent => "the supervisor was silent: see whether it hangs",
            StopReason::RobotStalled => "the robot process stood still: free the processor for it",
            StopReason::Ordered => "stopped by order",
            StopReason::ArmFault => "the arm has an error",
            StopReason::ConnectionBroke => "the connection to the arm broke: check its cable and power",
            StopReason::NotReady => {
                "the arm was stopped by its emergency button or another program: release it, quit the other"
            }
            StopReason::JointLimit => "a joint is beyond its limit: drive it back with the vendor's software",
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
            StopReason::UsedSince => {
                "another session has used the arm since: look at the arm and its surroundings"
            }
            StopReason::StartIsFar => "the start position is far away: look around, then `tendon arm` sends the arm there",
            StopReason::StartBeyondLimit => {
                "start_joints_deg is beyond the joint limits of this arm: change it"
            }
            StopReason::OutsideBox => "the arm stands outside the workspace box: drive it back by gestures",
            StopReason::WayLeavesBox => "the way to the start position leaves the workspace box",
            StopReason::Creeping => "the arm moved though commanded to rest: find out what drives or pulls it",
            StopReason::TakenOver => "another program changed the arm's mode: quit that program",
            StopReason::VelocityRefused => "the arm refused a velocity: quit other programs that use it",
            StopReason::UnsupportedArm => "the arm or its firmware is not supported: see the robot's message",
            StopReason::NotFollowing => {
                "the arm did not move as it was told: find out what holds, pulls or slows it"
            }
            StopReason::NeverConnected => "no arm answers at its address: check address, cable and power",
            StopReason::NextSession => {
                "this session follows on another: look at the arm and its surroundings"
            }
            StopReason::ArmSilent => "the arm did not answer in time: check its network",
        })
    }
}
