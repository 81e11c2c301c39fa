//! What is published of the arm.

use tendon_arm::Obstacle;
use tendon_messages::{ArmPhase, Hindrance, Permission, STATE_LENGTH, StateHeader};

use super::{Controller, Phase};

/// What is published of the arm.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// The header; its trace is that of the last command acted on.
    pub header: StateHeader,
    /// See [`STATE_LENGTH`].
    pub payload: [f32; STATE_LENGTH],
}

impl Controller {
    /// Where the arm is, whether it may move, and why not.
    pub fn state(&self) -> State {
        let report = self.arm.report();
        let stop = self.latch.reason();
        let is_before = !(self.has_followed || self.phase == Phase::Connecting);
        let follows = self.phase == Phase::Following && self.latch.permission() == Permission::Granted;
        let obstacle = report.obstacle.filter(|_| follows);
        let header = StateHeader {
            speed_mm_per_s: report.speed_mm_per_s as f32,
            gripper_position: report
                .gripper_pulses
                .filter(|_| self.settings.has_gripper)
                .map_or(f32::NAN, |pulses| pulses as f32),
            permission: self.latch.permission() as u8,
            stop_reason: stop.map_or(0, |stop| stop.reason as u8),
            fault_code: stop.map_or(0, |stop| stop.fault_code),
            arm_phase: self.arm_phase() as u8,
            hindrance: obstacle.map_or(0, |obstacle| hindrance_of(obstacle).number()),
            start_distance_mm: if is_before { self.header.start_distance_mm } else { 0.0 },
            ..self.header
        };
        let mut payload = [0.0; STATE_LENGTH];
        if let Some(joints_rad) = report.joints_rad {
            let pose = self.kinematics.flange_pose_m(&joints_rad);
            let (roll, pitch, yaw) = pose.rotation.euler_angles();
            let position_mm = pose.translation.vector * 1e3;
            let components = joints_rad.iter().chain(&position_mm).copied().chain([roll, pitch, yaw]);
            for (component, value) in payload.iter_mut().zip(components) {
                *component = value as f32;
            }
        }
        State { header, payload }
    }

    fn arm_phase(&self) -> ArmPhase {
        match self.phase {
            Phase::Connecting => ArmPhase::Connecting,
            Phase::EnablingJoints | Phase::EnablingFlange => ArmPhase::BringingUp,
            Phase::GoingToStart(_) => ArmPhase::GoingToStart,
            Phase::Following => ArmPhase::Following,
            Phase::Departing | Phase::Waiting => ArmPhase::Waiting,
        }
    }
}

fn hindrance_of(obstacle: Obstacle) -> Hindrance {
    match obstacle {
        Obstacle::WorkspaceFace { axis, is_upper } => Hindrance::WorkspaceFace { axis: axis as u8, is_upper },
        Obstacle::JointLimit { joint } => Hindrance::JointLimit { joint: joint as u8 },
        Obstacle::Singularity => Hindrance::Singularity,
        Obstacle::JointSpeed => Hindrance::JointSpeed,
    }
}
