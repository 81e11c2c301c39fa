//! Everything that must hold while the arm is up, and what becomes of it when it does not.

use tendon_arm::{JointVector, LimitViolation, Told, Twist};
use tendon_messages::{Permission, StopReason};

use super::{Controller, Phase};
use crate::arm::{ArmReport, Link, Stop};

/// After so long without a word from the supervisor it is taken to hang, ns: four of its heartbeats.
const SUPERVISOR_SILENCE_NS: u64 = 120_000_000;
/// After so long without a sign of life from the arm it is brought to rest, ns.
pub(super) const ARM_SILENCE_NS: u64 = 300_000_000;
/// After so long without a sign of life from the arm the connection counts as broken, ns.
const CONNECTION_SILENCE_NS: u64 = 1_000_000_000;

impl Controller {
    /// More about this reason to stop than it says itself: what the guard measured, or the arm's own words.
    pub fn explanation(&self, reason: StopReason) -> Option<String> {
        use StopReason::{NeverConnected, NotReady, TakenOver, UnsupportedArm, VelocityRefused};
        match reason {
            NeverConnected | NotReady | TakenOver | UnsupportedArm | VelocityRefused => {
                self.arm.explanation()
            }
            _ => {
                let found = self.violation.filter(|violation| reason_of(*violation) == reason);
                found.map(|violation| violation.to_string())
            }
        }
    }

    /// What the guard found, once for every stop by it.
    pub fn take_violation(&mut self) -> Option<LimitViolation> {
        let was_told = std::mem::replace(&mut self.is_violation_told, true);
        self.violation.filter(|_| !was_told)
    }

    pub(super) fn is_supervisor_silent(&self, now_ns: u64) -> bool {
        self.settings.stale_ns.is_some()
            && self
                .supervisor_heard_ns
                .is_some_and(|heard_ns| now_ns.saturating_sub(heard_ns) > SUPERVISOR_SILENCE_NS)
    }

    /// Whether fresh commands came in this session and come no more. Before the first, the stages may not be ready.
    fn are_commands_missing(&self, now_ns: u64) -> bool {
        let longest_ns = self.settings.arm.watchdog_ms * 1_000_000;
        self.settings.stale_ns.is_some()
            && self.fresh_command_ns.is_some_and(|came_ns| now_ns.saturating_sub(came_ns) > longest_ns)
    }

    /// A controller that stood still while its arm moved must not go on where it was: the arm has come to rest.
    pub(super) fn notice_stall(&mut self, now_ns: u64) {
        let woke_ns = self.woke_ns.replace(now_ns).unwrap_or(now_ns);
        if self.settings.stale_ns.is_none_or(|stale_ns| now_ns.saturating_sub(woke_ns) <= stale_ns) {
            return;
        }
        self.latch.break_row();
        if let Phase::EnablingJoints | Phase::GoingToStart(_) | Phase::EnablingFlange = self.phase {
            self.stop(Stop::because(StopReason::RobotStalled), now_ns);
        } else if !self.arm.is_still() {
            self.arm.stalled();
            self.latch.interrupt(StopReason::RobotStalled);
        }
    }

    pub(super) fn look_at_link(&mut self, report: &ArmReport, now_ns: u64) {
        if let Some(stop) = report.stop {
            self.stop(stop, now_ns);
        } else if report.link == Link::Connecting {
            self.stop(Stop::because(StopReason::ConnectionBroke), now_ns);
        }
    }

    /// Everything that must hold while the arm is up, wherever it goes.
    pub(super) fn watch(&mut self, report: &ArmReport, now_ns: u64) {
        if self.phase == Phase::Waiting {
            return;
        }
        let is_by_itself = self.phase != Phase::Following;
        if self.is_supervisor_silent(now_ns) {
            if is_by_itself {
                return self.stop(Stop::because(StopReason::SupervisorSilent), now_ns);
            }
            self.interrupt(StopReason::SupervisorSilent);
        }
        // Where the arm follows commands, its own watchdog brings it to rest.
        if matches!(self.phase, Phase::GoingToStart(_)) && self.are_commands_missing(now_ns) {
            return self.stop(Stop::because(StopReason::NoCommands), now_ns);
        }
        let is_moving_phase = matches!(self.phase, Phase::GoingToStart(_) | Phase::Following);
        if is_moving_phase && report.silent_ns > CONNECTION_SILENCE_NS {
            return self.stop(Stop::because(StopReason::ConnectionBroke), now_ns);
        }
        if is_moving_phase && report.silent_ns > ARM_SILENCE_NS {
            if is_by_itself {
                return self.stop(Stop::because(StopReason::ArmSilent), now_ns);
            }
            self.interrupt(StopReason::ArmSilent);
        }
        if let Some(joints_rad) = report.joints_rad {
            let reported_ns = now_ns.saturating_sub(report.report_age_ns);
            let told = self.told(report, &joints_rad);
            if let Err(violation) = self.guard.check(now_ns, reported_ns, &joints_rad, &told) {
                self.violation = Some(violation);
                self.is_violation_told = false;
                return self.stop(Stop::because(reason_of(violation)), now_ns);
            }
        }
        // It stays so until the next command that the arm is given: a reason once, and not again and again.
        if report.halted_by_watchdog && self.latch.permission() == Permission::Granted {
            self.interrupt(StopReason::NoCommands);
        }
    }

    /// What the arm was told, as the guard wants it.
    fn told(&self, report: &ArmReport, joints_rad: &JointVector) -> Told {
        let silent_ns = report.silent_ns;
        let Phase::GoingToStart(told_rad_per_s) = self.phase else {
            return Told { velocity: report.told, joints_rad_per_s: None, silent_ns };
        };
        let twist = Twist::from_vector_m(&(self.kinematics.jacobian(joints_rad) * told_rad_per_s));
        // The joints are told where the flange goes. Its rotation keeps no tool in place.
        let velocity = Twist { angular_rad_per_s: [0.0; 3], ..twist };
        Told { velocity, joints_rad_per_s: Some(told_rad_per_s), silent_ns }
    }
}

/// The reason to stop that this violation is.
fn reason_of(violation: LimitViolation) -> StopReason {
    match violation {
        LimitViolation::JointLimit { .. } => StopReason::JointLimit,
        LimitViolation::WorkspaceBox { .. } => StopReason::WorkspaceBox,
        LimitViolation::Creeping { .. } | LimitViolation::Drifted { .. } => StopReason::Creeping,
        LimitViolation::NotFollowing { .. }
        | LimitViolation::OffCourse { .. }
        | LimitViolation::JointOffCourse { .. } => StopReason::NotFollowing,
        LimitViolation::OverSpeed { .. } => StopReason::OverSpeed,
    }
}
