use super::*;
use tendon_gesture::DecisionSettings;

use crate::{TaskReport, TaskSettings, Workspace, ZoneTask};

const START_MM: DVec3 = DVec3::new(386.0, 0.0, 362.0);
const SPEED_MM_PER_S: f64 = 50.0;
const STEP_S: f64 = 0.01;

/// A system in small: gestures take effect some time later, at one of the moments that windows end, and the arm
/// ramps to and from its speed.
struct Plant {
    /// Gestures and when they were begun.
    made: Vec<(f64, Gesture)>,
    onset_s: f64,
    offset_s: f64,
    direction: DVec3,
    velocity_mm_per_s: DVec3,
    position_mm: DVec3,
}

impl Plant {
    fn new(onset_s: f64, offset_s: f64) -> Plant {
        Plant {
            made: vec![(0.0, Gesture::REST)],
            onset_s,
            offset_s,
            direction: DVec3::ZERO,
            velocity_mm_per_s: DVec3::ZERO,
            position_mm: START_MM,
        }
    }

    fn step(&mut self, time_s: f64, gesture: Gesture) {
        if self.made.last().is_some_and(|(_, last)| *last != gesture) {
            self.made.push((time_s, gesture));
        }
        let window_end_s = (time_s / 0.075).floor() * 0.075;
        let acts = |(begun_s, gesture): &&(f64, Gesture)| {
            let delay_s = if *gesture == Gesture::REST { self.offset_s } else { self.onset_s };
            begun_s + delay_s <= window_end_s
        };
        let acting = self.made.iter().rev().find(acts).map_or(Gesture::REST, |(_, gesture)| *gesture);
        self.direction = match acting {
            Gesture::ULNAR => DVec3::Y,
            Gesture::RADIAL => DVec3::NEG_Y,
            Gesture::EXTENSION => DVec3::Z,
            Gesture::FLEXION => DVec3::NEG_Z,
            _ => DVec3::ZERO,
        };
        let wanted = self.direction * SPEED_MM_PER_S - self.velocity_mm_per_s;
        self.velocity_mm_per_s += wanted.clamp_length_max(500.0 * STEP_S);
        self.position_mm += self.velocity_mm_per_s * STEP_S;
    }
}

/// `duration_s` of the task, and every gesture with its time.
fn play(settings: &TaskSettings, mut plant: Plant, duration_s: f64) -> (TaskReport, Vec<(f64, Gesture)>) {
    let workspace =
        Workspace { min_mm: DVec3::new(200.0, -400.0, 100.0), max_mm: DVec3::new(600.0, 400.0, 650.0) };
    let controls = Controls::new(&DecisionSettings::default()).unwrap();
    let mut task = ZoneTask::new(settings, controls.axes(), workspace, 0.0, START_MM).unwrap();
    let mut user = SimulatedUser::new(&settings.user, controls, settings.seed);
    for step in 0..(duration_s / STEP_S) as u64 {
        let time_s = step as f64 * STEP_S;
        task.observe(time_s, plant.position_mm);
        let gesture = user.act(time_s, plant.position_mm, 0, task.zone()).gesture;
        plant.step(time_s, gesture);
    }
    (task.report("zones", "simulated", 0), plant.made)
}

#[test]
fn twenty_zones_are_reached_in_five_minutes_whatever_the_seed_and_the_latency() {
    for seed in 0..10 {
        for (onset_s, offset_s) in [(0.45, 0.45), (0.5, 0.35), (0.4, 0.55), (0.25, 0.25)] {
            let settings = TaskSettings { seed, ..TaskSettings::default() };
            for settings in [settings.clone(), settings.as_in_the_paper()] {
                let (report, _) = play(&settings, Plant::new(onset_s, offset_s), 300.0);
                assert!(report.zones_reached >= 20, "seed {seed}, {onset_s} s, {offset_s} s: {report}");
                assert_eq!(report.box_violations, 0, "seed {seed}, {onset_s} s, {offset_s} s: {report}");
            }
        }
    }
}

#[test]
fn nothing_is_done_before_a_reaction_time_and_the_same_seed_does_the_same() {
    let user = UserSettings { reaction_ms: 400.0, error_rate: 0.0 };
    let settings = TaskSettings { user, seed: 3, ..TaskSettings::default() };
    let (_, made) = play(&settings, Plant::new(0.45, 0.45), 30.0);
    // Four standard deviations of the logarithm below the median.
    assert!(made[1].0 > 0.4 * (-4.0 * REACTION_SPREAD).exp(), "{made:?}");
    assert_eq!(made, play(&settings, Plant::new(0.45, 0.45), 30.0).1);
    let other = TaskSettings { seed: 4, ..settings };
    assert_ne!(made, play(&other, Plant::new(0.45, 0.45), 30.0).1);
}

#[test]
fn wrong_gestures_are_mended() {
    let grips = |error_rate| {
        let user = UserSettings { error_rate, ..UserSettings::default() };
        let settings = TaskSettings { user, ..TaskSettings::default() };
        let (report, made) = play(&settings, Plant::new(0.45, 0.45), 300.0);
        (report, made.iter().filter(|(_, gesture)| *gesture == Gesture::GRIP).count())
    };
    // No zone needs a grip, so each is a wrong gesture.
    let (flawless, no_grips) = grips(0.0);
    let (flawed, some_grips) = grips(0.3);
    assert_eq!(no_grips, 0);
    assert!(some_grips > 3, "{some_grips}");
    assert!(flawed.zones_reached < flawless.zones_reached, "{flawed}\n{flawless}");
    assert!(flawed.zones_reached >= 15, "{flawed}");
}

#[test]
fn the_stop_of_a_slower_system_is_learnt() {
    let user = UserSettings { error_rate: 0.0, ..UserSettings::default() };
    let settings = TaskSettings { user, ..TaskSettings::default() };
    let (report, _) = play(&settings, Plant::new(0.9, 0.9), 300.0);
    let overshoots = |zones: &[crate::ZoneScore]| zones.iter().map(|zone| zone.overshoots).sum::<u32>();
    assert!(report.zones_reached >= 15, "{report}");
    assert!(overshoots(&report.zones[5..15]) <= 3, "{report:#?}");
}

#[test]
fn without_a_way_to_move_nothing_panics_and_the_user_goes_on_trying() {
    let (report, made) = play(&TaskSettings::default(), Plant::new(1e9, 1e9), 60.0);
    assert_eq!((report.zones_reached, report.zones_timed_out), (0, 2));
    assert!(made.len() > 10, "{}", made.len());
}
