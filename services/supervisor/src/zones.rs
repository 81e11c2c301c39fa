//! The target-zone task of `tendon run --task`, as the configuration describes it.

use tendon_arm::SimulatedArm;
use tendon_config::Config;
use tendon_gesture::Strategy;
use tendon_zones::{Controls, TaskKind, TaskPlan, TaskRun, Workspace};

/// The task of a session with this configuration.
///
/// # Errors
///
/// When the gestures move the arm nowhere, or there is no room for zones around its start.
pub fn task(kind: TaskKind, config: &Config, has_simulated_user: bool) -> anyhow::Result<TaskRun> {
    let arm = &config.robot.arm;
    Ok(TaskRun::new(TaskPlan {
        kind,
        settings: config.task.clone(),
        workspace: Workspace { min_mm: arm.workspace_min_mm.into(), max_mm: arm.workspace_max_mm.into() },
        start_mm: SimulatedArm::new(arm.clone(), 0)?.state().position_mm.into(),
        calibration_s: match config.decision.strategy {
            Strategy::Threshold => config.dsp.activity.calibration_s,
            Strategy::TwoStage | Strategy::Direct | Strategy::Personal => 0.0,
        },
        controls: Controls::new(&config.decision)?,
        has_simulated_user,
    })?)
}
