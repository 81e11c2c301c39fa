//! The target-zone task in a session: it sees every state of the arm, and may be done by a simulated user, whose
//! gestures go to the simulated DAQ as those of the keyboard do.
//!
//! ```text
//! states ─▶ ZoneTask ─▶ report, figures
//!        └▶ SimulatedUser ─▶ gesture ─▶ acquisition ─▶ … ─▶ robot ─▶ states
//! ```

use std::path::Path;

use anyhow::Context;
use glam::DVec3;
use tendon_arm::SimulatedArm;
use tendon_config::Config;
use tendon_evaluation::zones_figure;
use tendon_gesture::{Gesture, Strategy};
use tendon_messages::{Permission, Stage, StateHeader};
use tendon_task::{Placement, SimulatedUser, TaskReport, TaskSettings, Workspace, ZoneTask};

/// A task on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TaskOption {
    /// The zones of the configuration.
    Zones,
    /// The paper's zones: cubes that are reached once entered.
    PaperZones,
}

impl TaskOption {
    /// The settings of this task.
    pub fn settings(self, configured: TaskSettings) -> TaskSettings {
        match self {
            TaskOption::Zones => configured,
            TaskOption::PaperZones => configured.as_in_the_paper(),
        }
    }

    fn name(self) -> &'static str {
        match self {
            TaskOption::Zones => "zones",
            TaskOption::PaperZones => "paper-zones",
        }
    }
}

/// The task of a session.
#[derive(Debug)]
pub struct Task {
    option: TaskOption,
    settings: TaskSettings,
    /// The box that the arm must not leave.
    workspace: Workspace,
    /// From the first sample that led to a command to the first zone, s: the strategy is ready then.
    begins_s: f64,
    user: Option<SimulatedUser>,
    /// The gesture that the user makes, and whether acquisition knows of it.
    gesture: (Gesture, bool),
    /// When the first sample that led to a command was captured.
    first_captured_ns: Option<u64>,
    under_way: Option<ZoneTask>,
}

impl Task {
    /// A task that begins with the first states that answer to samples, or, where the strategy has to calibrate,
    /// after that.
    ///
    /// # Errors
    ///
    /// When there is no room for zones around the arm's start.
    pub fn new(option: TaskOption, config: &Config, with_simulated_user: bool) -> anyhow::Result<Task> {
        let settings = config.task.clone();
        // Zones will lie around wherever the arm then is, but what can be known now is refused before anything moves.
        let start_mm = SimulatedArm::new(config.robot.arm.clone(), 0)?.state().position_mm.into();
        let workspace = Workspace {
            min_mm: config.robot.arm.workspace_min_mm.into(),
            max_mm: config.robot.arm.workspace_max_mm.into(),
        };
        Placement::new(&settings, start_mm, &workspace)?;
        let user = || SimulatedUser::new(&settings.user, config.decision.speed_mm_per_s, settings.seed);
        Ok(Task {
            option,
            begins_s: match config.decision.strategy {
                Strategy::Threshold => config.dsp.activity.calibration_s,
                Strategy::TwoStage | Strategy::Direct => 0.0,
            },
            user: with_simulated_user.then(user),
            gesture: (Gesture::Rest, true),
            first_captured_ns: None,
            under_way: None,
            workspace,
            settings,
        })
    }

    /// Looks at a state of the arm.
    ///
    /// # Errors
    ///
    /// When there is no room for zones around the place where the task begins; it is then not begun again.
    pub fn observe(&mut self, header: &StateHeader, position_mm: [f32; 3]) -> anyhow::Result<()> {
        let trace = &header.trace;
        if trace.captured_ns == 0 {
            // The arm has not heard of any sample yet.
            return Ok(());
        }
        let first_ns = *self.first_captured_ns.get_or_insert(trace.captured_ns);
        let observed_ns = trace.published_ns[Stage::Robot.index()];
        let time_s = observed_ns.saturating_sub(first_ns) as f64 / 1e9;
        let may_move = Permission::from_number(header.permission) == Permission::Granted;
        if time_s < self.begins_s || self.under_way.is_none() && !may_move {
            return Ok(());
        }
        let position_mm = DVec3::from(position_mm.map(f64::from));
        let task = match &mut self.under_way {
            Some(task) => task,
            under_way => {
                let task = ZoneTask::new(&self.settings, self.workspace, time_s, position_mm);
                // The session is to end in good order, so this is said once.
                under_way.insert(task.inspect_err(|_| self.begins_s = f64::INFINITY)?)
            }
        };
        task.observe(time_s, position_mm);
        if let Some(user) = &mut self.user {
            let wanted = user.gesture(time_s, position_mm, task.zone());
            // An arm that waits for a rest gets one: the live line asks for it.
            let gesture = if may_move { wanted } else { Gesture::Rest };
            if gesture != self.gesture.0 {
                self.gesture = (gesture, false);
            }
        }
        Ok(())
    }

    /// The simulated user's gesture, if it is another than that of the last call.
    pub fn new_gesture(&mut self) -> Option<Gesture> {
        let (gesture, is_known) = self.gesture;
        self.gesture.1 = true;
        (!is_known).then_some(gesture)
    }

    /// What to tell the user at the start.
    pub fn describe(&self) -> String {
        let TaskSettings { width_mm, dwell_s, timeout_s, seed, .. } = self.settings;
        format!(
            "{}, {width_mm} mm wide, dwell {dwell_s} s, timeout {timeout_s} s, seed {seed}, {} user",
            self.option.name(),
            self.user_name()
        )
    }

    /// For the live line: which zone there is, and how far it is.
    pub fn live(&self) -> String {
        match &self.under_way {
            Some(task) => format!("  zone {} at {:3.0} mm", task.zone_number(), task.distance_mm()),
            None => "  rest: the first zone is to come".to_owned(),
        }
    }

    /// How the task went; `None` if it never began.
    pub fn report(&self, states_lost: u64) -> Option<TaskReport> {
        let task = self.under_way.as_ref()?;
        Some(task.report(self.option.name(), self.user_name(), states_lost))
    }

    /// Draws the zones as PNG and SVG in `folder`, which is there.
    pub fn write_figures(&self, folder: &Path) -> anyhow::Result<()> {
        let Some(task) = &self.under_way else { return Ok(()) };
        let report = task.report(self.option.name(), self.user_name(), 0);
        for file in ["zones.png", "zones.svg"] {
            zones_figure(&folder.join(file), task, &report).context("the task's figure")?;
        }
        Ok(())
    }

    fn user_name(&self) -> &'static str {
        if self.user.is_some() { "simulated" } else { "person" }
    }
}
