//! The loop in small: a simulated user, muscles, a recogniser that does not err, the decision stage and the simulated arm.
//!
//! ```text
//! user ─▶ level of the muscles ─▶ window: gesture, effort ─▶ Decider ─▶ twist ─▶ SimulatedArm ─▶ position, mode ─▶ user
//! ```
#![allow(clippy::unwrap_used, reason = "helpers of tests may unwrap, as tests may")]

use std::collections::VecDeque;

use glam::DVec3;
use tendon_arm::{ArmSettings, SimulatedArm, Twist};
use tendon_gesture::{Decider, DecisionSettings, Evidence, SpeedControl, Strategy};
use tendon_zones::{Contraction, Controls, SimulatedUser, TaskReport, TaskSettings, Workspace, ZoneTask};

const STEP_NS: u64 = 5_000_000;
const INCREMENT_STEPS: u64 = 5;
const WINDOW_STEPS: usize = 30;
/// From rest to a comfortable contraction, and back, as the simulated source has it.
const RISE_S: f64 = 0.15;
/// A window whose mean effort is below this is recognised as rest.
const WEAKEST_EFFORT: f64 = 0.1;

/// How strongly each gesture is made, over the last window.
struct Muscles {
    levels: Vec<f64>,
    window: VecDeque<Vec<f64>>,
}

impl Muscles {
    fn new(gestures: usize) -> Muscles {
        Muscles { levels: vec![0.0; gestures], window: VecDeque::new() }
    }

    fn step(&mut self, commanded: usize, effort: f64) {
        let most = STEP_NS as f64 / 1e9 / RISE_S;
        for (number, level) in self.levels.iter_mut().enumerate() {
            let wanted = if number == commanded && number != 0 { effort } else { 0.0 };
            *level += (wanted - *level).clamp(-most, most);
        }
        self.window.push_back(self.levels.clone());
        if self.window.len() > WINDOW_STEPS {
            self.window.pop_front();
        }
    }

    /// Root mean square of each gesture over the window.
    fn efforts(&self) -> Vec<f32> {
        let of = |number: usize| {
            let squares: f64 = self.window.iter().map(|levels| levels[number] * levels[number]).sum();
            (squares / self.window.len() as f64).sqrt() as f32
        };
        (0..self.levels.len()).map(of).collect()
    }
}

/// `duration_s` of the task, and the modes in the order in which they were on.
fn steer(settings: &TaskSettings, decision: &DecisionSettings, duration_s: f64) -> (TaskReport, Vec<usize>) {
    let arm_settings = ArmSettings { linear_speed_limit_mm_per_s: 300.0, ..ArmSettings::default() };
    let workspace = Workspace {
        min_mm: arm_settings.workspace_min_mm.into(),
        max_mm: arm_settings.workspace_max_mm.into(),
    };
    let mut arm = SimulatedArm::new(arm_settings, 0).unwrap();
    let controls = Controls::new(decision).unwrap();
    let mut task =
        ZoneTask::new(settings, controls.axes(), workspace, 0.0, arm.state().position_mm.into()).unwrap();
    let mut user = SimulatedUser::new(&settings.user, controls, settings.seed);
    let mut decider = Decider::new(decision).unwrap();
    let mut muscles = Muscles::new(decision.gestures.len());
    let mut modes = vec![0];
    for step in 0..(duration_s * 1e9) as u64 / STEP_NS {
        let (time_ns, time_s) = (step * STEP_NS, (step * STEP_NS) as f64 / 1e9);
        let position_mm = DVec3::from(arm.state().position_mm);
        task.observe(time_s, position_mm);
        let mode = *modes.last().unwrap();
        let Contraction { gesture, effort } = user.act(time_s, position_mm, mode, task.zone());
        muscles.step(decision.gestures.number(gesture).unwrap().into(), effort);
        if step % INCREMENT_STEPS == 0 {
            let efforts = muscles.efforts();
            let strongest =
                (1..efforts.len()).max_by(|one, other| efforts[*one].total_cmp(&efforts[*other])).unwrap();
            let recognised = if f64::from(efforts[strongest]) < WEAKEST_EFFORT { 0 } else { strongest };
            let probabilities: Vec<f32> =
                (0..efforts.len()).map(|number| f32::from(u8::from(number == recognised))).collect();
            let decided = decider.decide(&Evidence {
                probabilities: &probabilities,
                efforts: &efforts,
                novelty: 0.0,
                moving: true,
                intact: true,
                captured_ns: time_ns,
            });
            let [x, y, z, ..] = decided.twist;
            arm.command(Twist { linear_mm_per_s: [x, y, z], ..Twist::ZERO }, time_ns).unwrap();
            if decided.mode != mode {
                modes.push(decided.mode);
            }
        }
        arm.tick(time_ns);
    }
    (task.report("zones", "simulated", 0), modes)
}

fn decision(modes: &str) -> DecisionSettings {
    DecisionSettings { strategy: Strategy::Direct, ..toml::from_str(modes).unwrap() }
}

/// A mode for the plane, and one for what it lacks.
const SPACE: &str = r#"
[[modes]]
name = "y-z"
extension = "+z"
flexion = "-z"
ulnar = "+y"
radial = "-y"
grip = "next_mode"

[[modes]]
name = "x"
extension = "+x"
flexion = "-x"
grip = "next_mode"
"#;

#[test]
fn a_user_steers_into_every_zone_in_space_with_two_modes() {
    for seed in 0..5 {
        let settings = TaskSettings { seed, ..TaskSettings::default() };
        let (report, modes) = steer(&settings, &decision(SPACE), 300.0);
        assert!(report.zones_reached >= 30 && report.zones_timed_out <= 2, "seed {seed}: {report}");
        assert_eq!(report.box_violations, 0, "seed {seed}: {report}");
        assert!(modes.len() > 15, "seed {seed}: {modes:?}");
        let off_plane = report
            .zones
            .iter()
            .filter(|zone| (zone.centre_mm[0] - report.zones[0].centre_mm[0]).abs() > 20.0);
        assert!(off_plane.count() > 10, "seed {seed}");
    }
}

#[test]
fn a_long_grip_and_gestures_of_any_name_will_do() {
    let modes = r#"
gestures = ["rest", "fist", "point", "thumb_up"]
long_grip_s = 1.0
[[modes]]
name = "x"
point = "+x"
thumb_up = "-x"
fist = "gripper"
[[modes]]
name = "y"
point = "+y"
thumb_up = "-y"
fist = "gripper"
[[modes]]
name = "z"
point = "-z"
thumb_up = { motion = "+z", speed_mm_per_s = 80.0 }
fist = "gripper"
"#;
    let (report, modes) = steer(&TaskSettings::default(), &decision(modes), 300.0);
    assert!(report.zones_reached >= 15 && report.zones_timed_out <= 4, "{report}");
    assert!(modes.windows(2).all(|pair| pair[1] == (pair[0] + 1) % 3), "{modes:?}");
}

#[test]
fn the_plane_is_steered_as_ever() {
    let (report, modes) = steer(&TaskSettings::default(), &decision(""), 300.0);
    assert!(report.zones_reached >= 55 && report.zones_timed_out == 0, "{report}");
    assert_eq!(modes, [0]);
}

#[test]
fn with_effort_a_fast_arm_is_steered_better_than_without() {
    let with = |speed_control: SpeedControl, speed_mm_per_s: f64| {
        let decision = DecisionSettings {
            strategy: Strategy::Personal,
            speed_control,
            speed_mm_per_s,
            ..DecisionSettings::default()
        };
        steer(&TaskSettings::default(), &decision, 300.0).0
    };
    let throughput = |report: &TaskReport| report.throughput_bits_per_s.unwrap();
    let [usual, fast] = [50.0, 150.0].map(|speed| with(SpeedControl::Constant, speed));
    let proportional = with(SpeedControl::Proportional, 150.0);
    assert!(throughput(&proportional) >= 1.15 * throughput(&usual), "{proportional}\n{usual}");
    assert!(throughput(&proportional) >= 1.15 * throughput(&fast), "{proportional}\n{fast}");
    assert!(proportional.overshoots < fast.overshoots, "{proportional}\n{fast}");
}
