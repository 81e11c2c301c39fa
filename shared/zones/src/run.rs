//! The task in a session: it follows the states of the arm, and may be done by a simulated user.
//!
//! ```text
//! states ─▶ TaskRun ─▶ ZoneTask ─▶ report, figures
//!             └──────▶ SimulatedUser ─▶ contraction ─▶ acquisition ─▶ … ─▶ robot ─▶ states
//! ```

use clap::ValueEnum;
use glam::DVec3;
use tendon_messages::{Permission, Stage, StateHeader};

use crate::{
    Contraction, Controls, NoRoomForZones, Placement, SimulatedUser, TaskReport, TaskSettings, TaskStatus,
    Workspace, ZoneTask,
};

/// Which task there is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TaskKind {
    /// The zones of the configuration.
    Zones,
    /// The paper's zones: cubes that are reached once entered.
    PaperZones,
}

impl TaskKind {
    /// The settings of this task.
    pub fn settings(self, configured: TaskSettings) -> TaskSettings {
        match self {
            TaskKind::Zones => configured,
            TaskKind::PaperZones => configured.as_in_the_paper(),
        }
    }

    /// The name in reports and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            TaskKind::Zones => "zones",
            TaskKind::PaperZones => "paper-zones",
        }
    }
}

/// What a task needs to know of the session it runs in.
#[derive(Clone, Debug)]
pub struct TaskPlan {
    /// Which task.
    pub kind: TaskKind,
    /// Zones and simulated user.
    pub settings: TaskSettings,
    /// The box that the arm must not leave.
    pub workspace: Workspace,
    /// Where the arm will stand when the session begins, mm.
    pub start_mm: DVec3,
    /// How long the strategy calibrates on the first samples, s. The first zone appears after that.
    pub calibration_s: f64,
    /// What gestures do. Zones lie where they can move the arm.
    pub controls: Controls,
    /// Whether the simulated user does the task.
    pub has_simulated_user: bool,
}

/// The task of a session. Times are those of the states.
#[derive(Debug)]
pub struct TaskRun {
    plan: TaskPlan,
    user: Option<SimulatedUser>,
    /// What the user does with the muscles.
    contraction: Contraction,
    /// Whether [`TaskRun::new_contraction`] has given it out.
    contraction_is_known: bool,
    /// When the first sample that led to a command was captured.
    first_captured_ns: Option<u64>,
    under_way: Option<ZoneTask>,
    found_no_room: bool,
}

impl TaskRun {
    /// A task that begins once the strategy has calibrated and the arm may move.
    ///
    /// # Errors
    ///
    /// [`NoRoomForZones`] around the start. Zones will lie around wherever the arm then is, but what can be known now is
    /// refused before anything moves.
    pub fn new(plan: TaskPlan) -> Result<TaskRun, NoRoomForZones> {
        Placement::new(&plan.settings, plan.controls.axes(), plan.start_mm, &plan.workspace)?;
        let user = plan
            .has_simulated_user
            .then(|| SimulatedUser::new(&plan.settings.user, plan.controls.clone(), plan.settings.seed));
        Ok(TaskRun {
            plan,
            user,
            contraction: Contraction::REST,
            contraction_is_known: true,
            first_captured_ns: None,
            under_way: None,
            found_no_room: false,
        })
    }

    /// Looks at a state of the arm.
    ///
    /// # Errors
    ///
    /// [`NoRoomForZones`] around the place where the task begins. This is said once; the task then never begins.
    pub fn observe(&mut self, header: &StateHeader, position_mm: [f32; 3]) -> Result<(), NoRoomForZones> {
        let trace = &header.trace;
        if trace.captured_ns == 0 || self.found_no_room {
            // The arm has not heard of any sample yet.
            return Ok(());
        }
        let first_ns = *self.first_captured_ns.get_or_insert(trace.captured_ns);
        let observed_ns = trace.published_ns[Stage::Robot.index()];
        let time_s = observed_ns.saturating_sub(first_ns) as f64 / 1e9;
        let may_move = Permission::from_number(header.permission) == Permission::Granted;
        if time_s < self.plan.calibration_s || self.under_way.is_none() && !may_move {
            return Ok(());
        }
        let position_mm = DVec3::from(position_mm.map(f64::from));
        let task = match &mut self.under_way {
            Some(task) => task,
            under_way => {
                let TaskPlan { settings, controls, workspace, .. } = &self.plan;
                let task = ZoneTask::new(settings, controls.axes(), *workspace, time_s, position_mm);
                under_way.insert(task.inspect_err(|_| self.found_no_room = true)?)
            }
        };
        task.observe(time_s, position_mm);
        if let Some(user) = &mut self.user {
            let wanted = user.act(time_s, position_mm, header.mode.into(), task.zone());
            // An arm that waits for a rest gets one: the live line asks for it.
            let contraction = if may_move { wanted } else { Contraction::REST };
            if contraction != self.contraction {
                self.contraction = contraction;
                self.contraction_is_known = false;
            }
        }
        Ok(())
    }

    /// What the simulated user does with the muscles, if it has changed since the last call.
    pub fn new_contraction(&mut self) -> Option<Contraction> {
        let is_known = std::mem::replace(&mut self.contraction_is_known, true);
        (!is_known).then_some(self.contraction)
    }

    /// What to tell the user at the start.
    pub fn describe(&self) -> String {
        let TaskSettings { width_mm, dwell_s, timeout_s, seed, .. } = self.plan.settings;
        format!(
            "{}, {width_mm} mm wide, dwell {dwell_s} s, timeout {timeout_s} s, seed {seed}, {} user",
            self.plan.kind.name(),
            self.user_name()
        )
    }

    /// For the live line: which zone there is and where, as seen from behind the arm, as on the page: forward is +x,
    /// left is +y, up is +z.
    pub fn live(&self) -> String {
        match &self.under_way {
            None => "  rest: the first zone appears soon".to_owned(),
            Some(task) if task.is_inside() => format!("  zone {}: inside, stay", task.zone_number()),
            Some(task) => {
                format!("  zone {}: {} mm", task.zone_number(), directions(task.offset_mm(), task.axes()))
            }
        }
    }

    /// How the task stands, for whoever shows it while it goes on.
    pub fn status(&self) -> TaskStatus {
        let kind = self.plan.kind.name();
        self.under_way.as_ref().map_or(TaskStatus { kind, ..TaskStatus::default() }, |task| task.status(kind))
    }

    /// The task itself, once it has begun.
    pub fn under_way(&self) -> Option<&ZoneTask> {
        self.under_way.as_ref()
    }

    /// How the task went; `None` if it never began.
    pub fn report(&self, states_lost: u64) -> Option<TaskReport> {
        let task = self.under_way.as_ref()?;
        Some(task.report(self.plan.kind.name(), self.user_name(), states_lost))
    }

    fn user_name(&self) -> &'static str {
        if self.user.is_some() { "simulated" } else { "person" }
    }
}

/// Such as `up 78, left 40`, the greatest first, of the axes that zones lie along.
fn directions(offset_mm: DVec3, axes: [bool; 3]) -> String {
    let names = [("forward", "back"), ("left", "right"), ("up", "down")];
    let named = |axis: usize| {
        let (forth, back) = names[axis];
        (offset_mm[axis], if offset_mm[axis] < 0.0 { back } else { forth })
    };
    // The vertical goes first among equals.
    let mut parts: Vec<_> = (0..3).rev().filter(|axis| axes[*axis]).map(named).collect();
    parts.sort_by(|one, other| other.0.abs().total_cmp(&one.0.abs()));
    let parts: Vec<String> = parts
        .iter()
        .map(|(mm, direction)| (mm.abs().round(), direction))
        .filter(|(mm, _)| *mm > 0.0)
        .map(|(mm, direction)| format!("{direction} {mm:.0}"))
        .collect();
    parts.join(", ")
}

#[cfg(test)]
mod tests {
    use tendon_gesture::{DecisionSettings, Gesture};

    use super::*;

    const START_MM: [f32; 3] = [386.0, 0.0, 362.0];

    fn plan() -> TaskPlan {
        TaskPlan {
            kind: TaskKind::Zones,
            settings: TaskSettings::default(),
            workspace: Workspace {
                min_mm: DVec3::new(200.0, -400.0, 100.0),
                max_mm: DVec3::new(600.0, 400.0, 650.0),
            },
            start_mm: DVec3::from(START_MM.map(f64::from)),
            calibration_s: 5.0,
            controls: Controls::new(&DecisionSettings::default()).unwrap(),
            has_simulated_user: true,
        }
    }

    fn state(time_s: f64, permission: Permission) -> StateHeader {
        let mut header = StateHeader { permission: permission as u8, ..StateHeader::default() };
        header.trace.captured_ns = 1_000_000_000;
        header.trace.published_ns[Stage::Robot.index()] = 1_000_000_000 + (time_s * 1e9) as u64;
        header
    }

    #[test]
    fn the_first_zone_waits_for_samples_the_calibration_and_the_permission() {
        let mut run = TaskRun::new(plan()).unwrap();
        run.observe(
            &StateHeader { permission: Permission::Granted as u8, ..StateHeader::default() },
            START_MM,
        )
        .unwrap();
        run.observe(&state(1.0, Permission::Granted), START_MM).unwrap();
        run.observe(&state(6.0, Permission::AwaitRest), START_MM).unwrap();
        assert!(run.report(0).is_none() && run.live().contains("first zone"), "{}", run.live());
        assert_eq!(run.status(), TaskStatus { kind: "zones", ..TaskStatus::default() });
        run.observe(&state(6.1, Permission::Granted), START_MM).unwrap();
        assert_eq!(run.under_way().map(ZoneTask::zone_number), Some(1));
    }

    #[test]
    fn the_live_line_says_where_the_zone_is() {
        let in_plane = |offset_mm| directions(offset_mm, [false, true, true]);
        assert_eq!(in_plane(DVec3::new(4.0, 40.2, 78.4)), "up 78, left 40");
        assert_eq!(in_plane(DVec3::new(0.0, -90.0, -3.0)), "right 90, down 3");
        assert_eq!(in_plane(DVec3::new(0.0, 0.3, -31.0)), "down 31");
        assert_eq!(directions(DVec3::new(-50.0, 3.0, 60.0), [true; 3]), "up 60, back 50, left 3");
        let mut run = TaskRun::new(plan()).unwrap();
        assert!(run.live().contains("first zone"));
        run.observe(&state(6.0, Permission::Granted), START_MM).unwrap();
        let centre_mm = run.under_way().unwrap().zone().centre_mm;
        let zone = run.status().zone.unwrap();
        assert_eq!((zone.center_mm, zone.width_mm), (centre_mm.into(), TaskSettings::default().width_mm));
        assert!(run.live().starts_with("  zone 1: ") && run.live().ends_with(" mm"), "{}", run.live());
        run.observe(&state(6.1, Permission::Granted), <[f64; 3]>::from(centre_mm).map(|mm| mm as f32))
            .unwrap();
        assert_eq!(run.live(), "  zone 1: inside, stay");
    }

    #[test]
    fn each_gesture_of_the_user_is_given_out_once_and_a_stopped_arm_gets_a_rest() {
        let mut run = TaskRun::new(plan()).unwrap();
        let mut time_s = 6.0;
        let mut follow = |run: &mut TaskRun, permission, until: &dyn Fn(Gesture) -> bool| loop {
            time_s += 0.004;
            assert!(time_s < 20.0, "the user does nothing");
            run.observe(&state(time_s, permission), START_MM).unwrap();
            let made = run.new_contraction().map(|contraction| contraction.gesture);
            if let Some(gesture) = made.filter(|gesture| until(*gesture)) {
                assert_eq!(run.new_contraction(), None);
                break gesture;
            }
        };
        follow(&mut run, Permission::Granted, &|gesture| gesture != Gesture::REST);
        assert_eq!(follow(&mut run, Permission::Stopped, &|_| true), Gesture::REST);
    }

    #[test]
    fn zones_without_room_are_refused_before_the_session_and_reported_once_within_it() {
        let wide = TaskSettings { width_mm: 400.0, ..TaskSettings::default() };
        assert!(TaskRun::new(TaskPlan { settings: wide, ..plan() }).is_err());
        let mut run = TaskRun::new(plan()).unwrap();
        let outside = [386.0, 900.0, 362.0];
        assert!(run.observe(&state(6.0, Permission::Granted), outside).is_err());
        assert!(run.observe(&state(6.1, Permission::Granted), outside).is_ok());
        assert!(run.report(0).is_none());
    }
}
