//! A simulated user: sees arm and zone, makes gestures, and closes the loop.
//!
//! ```text
//! rest ──the arm is still, outside the zone──▶ react ──log-normal time──▶ contract ─┐
//!  ▲                                                     (now and then a wrong one) │
//!  └── release: as early as the stop has been learnt to take, or seen to go astray ─┘
//! ```
//!
//! Gestures move along one axis at a time, so the user goes along the one on which most is missing, then along the
//! other. It knows nothing of the system but what it has seen: how far the arm runs on after a release, and how long
//! a contraction has no effect, are learnt from one movement to the next.

use std::collections::VecDeque;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, LogNormal, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use tendon_gesture::Gesture;

use crate::{UserSettings, Zone};

/// How late what is there is seen, s: the delay of vision while something is followed with the eyes.
const SEEING_DELAY_S: f64 = 0.1;
/// Standard deviation of the logarithm of the reaction time: 0.2 s to 0.32 s are two thirds of a median of 0.25 s.
const REACTION_SPREAD: f64 = 0.25;
/// How long the user waits for the effect of a movement to show, s.
const PATIENCE_S: f64 = 0.5;
/// An arm that was not seen to move farther than this, mm, for [`STILL_S`] is at rest.
const STILL_MM: f64 = 0.5;
/// See [`STILL_MM`].
const STILL_S: f64 = 0.15;
/// The user lets go when the arm is so much farther from the zone than at the beginning of the movement, mm.
const ASTRAY_MM: f64 = 15.0;
/// The user lets go when a movement takes so much longer than it should, s.
const STUCK_S: f64 = 1.5;
/// Standard deviation of what is timed by hand, as a share of it.
const TIMING_SPREAD: f64 = 0.1;
/// Share of what is new in what has been learnt.
const LEARNING_RATE: f64 = 0.3;
/// What the user expects of the system before the first movement: it starts and stops so late, s.
const EXPECTED_LATENCY_S: f64 = 0.45;

/// A simulated user at the task.
#[derive(Clone, Debug)]
pub struct SimulatedUser {
    error_rate: f64,
    reaction_s: LogNormal<f64>,
    rng: Xoshiro256PlusPlus,
    speed_mm_per_s: f64,
    /// Time and position, oldest first: what will be seen, and what was seen a moment ago.
    positions: VecDeque<(f64, DVec3)>,
    /// The zone that the user has taken notice of.
    zone: Option<Zone>,
    /// When another zone will have been noticed.
    notices_s: Option<f64>,
    phase: Phase,
    learnt: Learnt,
}

/// What the user has learnt of the system.
#[derive(Clone, Copy, Debug)]
struct Learnt {
    /// How far the arm goes on from where it is seen at the release, mm.
    stopping_mm: f64,
    /// How much longer than the motion that follows a contraction has to be, s.
    without_effect_s: f64,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// At rest, and not judging the outcome before this time; then learning from this release.
    Rest { judges_s: f64, released: Option<Release> },
    /// About to contract.
    React { contracts_s: f64 },
    /// A gesture is made.
    Contract(Contraction),
}

#[derive(Clone, Copy, Debug)]
struct Contraction {
    gesture: Gesture,
    /// Where the arm is to go.
    direction: DVec3,
    since_s: f64,
    /// Where the arm was seen at the beginning.
    from_mm: DVec3,
    /// What is missing along the direction at the beginning, mm.
    missing_mm: f64,
    end: End,
}

/// What ends a contraction.
#[derive(Clone, Copy, Debug)]
enum End {
    /// The arm is seen this near, mm: it will come to rest in the middle.
    Near(f64),
    /// The way is too short to be watched: a contraction of this length, s.
    After(f64),
    /// It was seen to be wrong: the time of the release, s.
    Wrong(f64),
}

/// The end of a contraction that the user can learn from.
#[derive(Clone, Copy, Debug)]
struct Release {
    contraction: Contraction,
    time_s: f64,
    /// Where the arm was seen then.
    at_mm: DVec3,
}

/// A gesture and where it moves the arm: the paper's table.
const MOVES: [(Gesture, DVec3); 4] = [
    (Gesture::ULNAR, DVec3::Y),
    (Gesture::RADIAL, DVec3::NEG_Y),
    (Gesture::EXTENSION, DVec3::Z),
    (Gesture::FLEXION, DVec3::NEG_Z),
];

impl SimulatedUser {
    /// A user at rest, for an arm of this speed. The same seed gives the same user.
    ///
    /// # Panics
    ///
    /// If the reaction time is not positive: see [`TaskSettings::check`](crate::TaskSettings::check).
    pub fn new(settings: &UserSettings, speed_mm_per_s: f64, seed: u64) -> SimulatedUser {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        // A stream of its own beside that of the zones.
        rng.jump();
        SimulatedUser {
            error_rate: settings.error_rate,
            reaction_s: LogNormal::new((settings.reaction_ms / 1e3).ln(), REACTION_SPREAD)
                .expect("the reaction time is positive"),
            rng,
            speed_mm_per_s,
            positions: VecDeque::new(),
            zone: None,
            notices_s: None,
            phase: Phase::Rest { judges_s: 0.0, released: None },
            learnt: Learnt {
                stopping_mm: (EXPECTED_LATENCY_S + SEEING_DELAY_S) * speed_mm_per_s,
                without_effect_s: 0.0,
            },
        }
    }

    /// The gesture that is made now, with the arm at `position_mm` and this zone to reach.
    pub fn gesture(&mut self, time_s: f64, position_mm: DVec3, zone: &Zone) -> Gesture {
        self.positions.push_back((time_s, position_mm));
        let Some(seen_mm) = self.seen_mm(time_s) else { return Gesture::REST };
        self.notice(time_s, seen_mm, zone);
        match self.phase {
            Phase::Rest { judges_s, released } => {
                if time_s >= judges_s && self.is_still(time_s) {
                    self.judge(time_s, seen_mm, released);
                }
            }
            Phase::React { contracts_s } if time_s >= contracts_s => self.contract(time_s, seen_mm),
            Phase::React { .. } => {}
            Phase::Contract(contraction) => self.hold(time_s, seen_mm, contraction),
        }
        match self.phase {
            Phase::Contract(contraction) => contraction.gesture,
            _ => Gesture::REST,
        }
    }

    /// The position that is seen now. Older ones are kept for as long as stillness is judged by them.
    fn seen_mm(&mut self, time_s: f64) -> Option<DVec3> {
        while self.positions.front().is_some_and(|(old_s, _)| *old_s < time_s - SEEING_DELAY_S - STILL_S) {
            self.positions.pop_front();
        }
        let visible = self.positions.iter().take_while(|(at_s, _)| *at_s <= time_s - SEEING_DELAY_S);
        visible.last().map(|(_, position_mm)| *position_mm)
    }

    fn is_still(&self, time_s: f64) -> bool {
        let visible = self.positions.iter().take_while(|(at_s, _)| *at_s <= time_s - SEEING_DELAY_S);
        let (mut lowest_mm, mut highest_mm) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (_, position_mm) in visible {
            lowest_mm = lowest_mm.min(*position_mm);
            highest_mm = highest_mm.max(*position_mm);
        }
        (highest_mm - lowest_mm).max_element() <= STILL_MM
    }

    fn reaction_s(&mut self) -> f64 {
        self.reaction_s.sample(&mut self.rng)
    }

    /// What is meant to be `value` and done by hand.
    fn by_hand(&mut self, value: f64) -> f64 {
        let normal: f64 = StandardNormal.sample(&mut self.rng);
        (value * (1.0 + TIMING_SPREAD * normal)).max(0.0)
    }

    /// A new zone is noticed a reaction time after it appears; what is being done is then thought over.
    fn notice(&mut self, time_s: f64, seen_mm: DVec3, zone: &Zone) {
        if self.zone.as_ref() == Some(zone) {
            return;
        }
        let Some(notices_s) = self.notices_s else {
            self.notices_s = Some(time_s + self.reaction_s());
            return;
        };
        if time_s < notices_s {
            return;
        }
        self.notices_s = None;
        self.zone = Some(*zone);
        match self.phase {
            // The reaction time is over: it was that to the zone.
            Phase::Rest { judges_s, .. } if time_s >= judges_s => self.contract(time_s, seen_mm),
            Phase::Rest { .. } | Phase::React { .. } => {}
            Phase::Contract(contraction) => {
                let (gesture, direction, missing_mm) = best_move(zone, seen_mm);
                if gesture == contraction.gesture {
                    let end = self.plan(missing_mm);
                    let from_mm = seen_mm;
                    let since_s = time_s;
                    self.phase = Phase::Contract(Contraction {
                        gesture,
                        direction,
                        since_s,
                        from_mm,
                        missing_mm,
                        end,
                    });
                } else {
                    self.release(time_s, None);
                }
            }
        }
    }

    /// Looks at what came of the last movement, learns from it, and decides whether another is needed.
    fn judge(&mut self, time_s: f64, seen_mm: DVec3, released: Option<Release>) {
        if let Some(released) = released {
            self.learnt.learn(&released, seen_mm, self.speed_mm_per_s);
        }
        self.phase = match &self.zone {
            Some(zone) if !zone.contains(seen_mm) => Phase::React { contracts_s: time_s + self.reaction_s() },
            _ => Phase::Rest { judges_s: time_s, released: None },
        };
    }

    fn contract(&mut self, time_s: f64, seen_mm: DVec3) {
        let Some(zone) = self.zone.filter(|zone| !zone.contains(seen_mm)) else {
            self.phase = Phase::Rest { judges_s: time_s, released: None };
            return;
        };
        let (right, direction, missing_mm) = best_move(&zone, seen_mm);
        let (gesture, end) = if self.rng.random_bool(self.error_rate) {
            let wrong: Vec<Gesture> =
                Gesture::PAPER_ACTIVE.into_iter().filter(|gesture| *gesture != right).collect();
            let gesture = wrong[self.rng.random_range(0..wrong.len())];
            // The slip is felt at once, but takes another reaction time to be mended.
            (gesture, End::Wrong(time_s + self.reaction_s()))
        } else {
            (right, self.plan(missing_mm))
        };
        let contraction =
            Contraction { gesture, direction, since_s: time_s, from_mm: seen_mm, missing_mm, end };
        self.phase = Phase::Contract(contraction);
    }

    /// How a movement of this length will be ended.
    fn plan(&mut self, missing_mm: f64) -> End {
        let Learnt { stopping_mm, without_effect_s } = self.learnt;
        if missing_mm > 1.2 * stopping_mm {
            End::Near(self.by_hand(stopping_mm))
        } else {
            End::After(self.by_hand(missing_mm / self.speed_mm_per_s + without_effect_s))
        }
    }

    fn hold(&mut self, time_s: f64, seen_mm: DVec3, contraction: Contraction) {
        let held_s = time_s - contraction.since_s;
        let travelled_mm = seen_mm - contraction.from_mm;
        let missing_mm = contraction.missing_mm - travelled_mm.dot(contraction.direction);
        match contraction.end {
            End::Wrong(releases_s) if time_s >= releases_s => self.release(time_s, None),
            End::Wrong(_) => {}
            End::After(length_s) if held_s >= length_s => {
                self.release(time_s, Some(Release { contraction, time_s, at_mm: seen_mm }));
            }
            End::Near(near_mm) if missing_mm <= near_mm => {
                self.release(time_s, Some(Release { contraction, time_s, at_mm: seen_mm }));
            }
            End::After(_) | End::Near(_) => {
                let expected_s = contraction.missing_mm / self.speed_mm_per_s + EXPECTED_LATENCY_S;
                let aside_mm = travelled_mm.reject_from_normalized(contraction.direction).length();
                let is_astray = aside_mm > ASTRAY_MM || missing_mm > contraction.missing_mm + ASTRAY_MM;
                if is_astray || held_s > expected_s + STUCK_S {
                    let end = End::Wrong(time_s + self.reaction_s());
                    self.phase = Phase::Contract(Contraction { end, ..contraction });
                }
            }
        }
    }

    fn release(&mut self, time_s: f64, released: Option<Release>) {
        self.phase = Phase::Rest { judges_s: time_s + PATIENCE_S, released };
    }
}

impl Learnt {
    /// The arm came to rest at `seen_mm` after this release.
    fn learn(&mut self, released: &Release, seen_mm: DVec3, speed_mm_per_s: f64) {
        let Release { contraction, time_s, at_mm } = released;
        match contraction.end {
            End::Near(_) => {
                // What is not plausible, because a gesture was not recognised, is not learnt from.
                let stopping_mm = (seen_mm - at_mm).dot(contraction.direction);
                if (0.0..=3.0 * self.stopping_mm).contains(&stopping_mm) {
                    self.stopping_mm += LEARNING_RATE * (stopping_mm - self.stopping_mm);
                }
            }
            End::After(_) => {
                let moved_s = (seen_mm - contraction.from_mm).dot(contraction.direction) / speed_mm_per_s;
                let without_effect_s = (time_s - contraction.since_s - moved_s).clamp(-1.0, 1.0);
                self.without_effect_s += LEARNING_RATE * (without_effect_s - self.without_effect_s);
            }
            End::Wrong(_) => {}
        }
    }
}

/// The gesture for the axis on which most is missing, its direction, and how much that is, mm.
fn best_move(zone: &Zone, seen_mm: DVec3) -> (Gesture, DVec3, f64) {
    let error_mm = zone.centre_mm - seen_mm;
    let missing = MOVES.map(|(gesture, direction)| (gesture, direction, error_mm.dot(direction)));
    missing.into_iter().fold(missing[0], |best, other| if other.2 > best.2 { other } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
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
            let direction = MOVES.iter().find(|(gesture, _)| *gesture == acting);
            self.direction = direction.map_or(DVec3::ZERO, |(_, direction)| *direction);
            let wanted = self.direction * SPEED_MM_PER_S - self.velocity_mm_per_s;
            self.velocity_mm_per_s += wanted.clamp_length_max(500.0 * STEP_S);
            self.position_mm += self.velocity_mm_per_s * STEP_S;
        }
    }

    /// `duration_s` of the task, and every gesture with its time.
    fn play(settings: &TaskSettings, mut plant: Plant, duration_s: f64) -> (TaskReport, Vec<(f64, Gesture)>) {
        let workspace =
            Workspace { min_mm: DVec3::new(200.0, -400.0, 100.0), max_mm: DVec3::new(600.0, 400.0, 650.0) };
        let mut task = ZoneTask::new(settings, workspace, 0.0, START_MM).unwrap();
        let mut user = SimulatedUser::new(&settings.user, SPEED_MM_PER_S, settings.seed);
        for step in 0..(duration_s / STEP_S) as u64 {
            let time_s = step as f64 * STEP_S;
            task.observe(time_s, plant.position_mm);
            let gesture = user.gesture(time_s, plant.position_mm, task.zone());
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
}
