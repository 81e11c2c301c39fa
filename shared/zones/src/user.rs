//! A simulated user: sees arm, mode and zone, contracts, and closes the loop.
//!
//! ```text
//! rest ──the arm is still, outside the zone──▶ react ──log-normal time──▶ move, or change the mode ─┐
//!  ▲                                                     (now and then a slip: a wrong gesture)     │
//!  └── release: as early as the stop has been learnt to take, or seen to go astray, or to have changed ─┘
//! ```
//!
//! Gestures move along one axis at a time, so the user goes along the one on which most is missing, then along the
//! others; what the mode that is on can do comes first. It knows what gestures do ([`Controls`]), but nothing of how long
//! the system takes: how far the arm runs on after a release, and how long a contraction has no effect, are learnt from
//! one movement to the next. Where effort sets the speed, it contracts hard for a long way and lightly for a short one.

use std::collections::VecDeque;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, LogNormal, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use tendon_gesture::Gesture;

use crate::controls::{Controls, ModeChange, Move, Step};
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
/// What is missing along an axis by less than this share of the zone's width is left as it is: no zone that is not reached
/// has so little missing along all three.
const TOLERANCE: f64 = 0.25;
/// Standard deviation of what is timed by hand, as a share of it.
const TIMING_SPREAD: f64 = 0.1;
/// Standard deviation of the effort of a contraction, as a share of it.
const EFFORT_SPREAD: f64 = 0.1;
/// Where effort sets the speed, a movement is meant to take so long whatever its length, s: the farther, the harder the
/// contraction (isochrony).
const MOVEMENT_S: f64 = 0.3;
/// The least share of the highest speed that is meant: lighter contractions can hardly be kept or recognised.
const SLOWEST_SHARE: f64 = 0.1;

/// Share of what is new in what has been learnt.
const LEARNING_RATE: f64 = 0.3;
/// What the user expects of the system before the first movement: it starts and stops so late, s.
const EXPECTED_LATENCY_S: f64 = 0.45;

/// What the user does with the muscles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contraction {
    /// The gesture.
    pub gesture: Gesture,
    /// How hard it is made, as a share of a comfortable contraction, above 0 to 1.
    pub effort: f64,
}

impl Contraction {
    /// No contraction.
    pub const REST: Contraction = Contraction::comfortable(Gesture::REST);

    const fn comfortable(gesture: Gesture) -> Contraction {
        Contraction { gesture, effort: 1.0 }
    }
}

/// A simulated user at the task.
#[derive(Clone, Debug)]
pub struct SimulatedUser {
    error_rate: f64,
    reaction_s: LogNormal<f64>,
    rng: Xoshiro256PlusPlus,
    controls: Controls,
    /// Oldest first: what will be seen, and what was seen a moment ago.
    sights: VecDeque<Sight>,
    /// The zone that the user has taken notice of.
    zone: Option<Zone>,
    /// When another zone will have been noticed.
    notices_s: Option<f64>,
    phase: Phase,
    learnt: Learnt,
}

/// What there is to see of the arm.
#[derive(Clone, Copy, Debug)]
struct Sight {
    time_s: f64,
    position_mm: DVec3,
    /// The mode that is on, which the live line shows.
    mode: usize,
}

/// What the user has learnt of the system.
#[derive(Clone, Copy, Debug)]
struct Learnt {
    /// How much longer the arm goes on after a release than it was seen to have gone, s at its speed.
    stopping_s: f64,
    /// How much longer than the motion that follows a contraction has to be, s.
    without_effect_s: f64,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    /// At rest, and not judging the outcome before this time; then learning from this release.
    Rest { judges_s: f64, released: Option<Release> },
    /// About to contract.
    React { contracts_s: f64 },
    /// A gesture is made that moves the arm.
    Move(Movement),
    /// A gesture is made until the mode is seen to have changed from `mode`; then let go at `releases_s`.
    Change { change: ModeChange, mode: usize, since_s: f64, releases_s: Option<f64> },
    /// A wrong gesture is made until this time.
    Slip { gesture: Gesture, releases_s: f64 },
}

#[derive(Clone, Copy, Debug)]
struct Movement {
    /// The gesture, and where the arm is to go.
    planned: Move,
    since_s: f64,
    /// Where the arm was seen at the beginning, and in which mode.
    from: Sight,
    /// What is missing along the direction at the beginning, mm.
    missing_mm: f64,
    effort: f64,
    /// The speed that is meant.
    speed_mm_per_s: f64,
    end: End,
}

/// What ends a movement.
#[derive(Clone, Copy, Debug)]
enum End {
    /// The arm is seen this near, mm: it will come to rest in the middle.
    Near(f64),
    /// The way is too short to be watched: a contraction of this length, s.
    After(f64),
    /// It was seen to be wrong: the time of the release, s.
    Wrong(f64),
}

/// The end of a movement that the user can learn from.
#[derive(Clone, Copy, Debug)]
struct Release {
    movement: Movement,
    time_s: f64,
    /// Where the arm was seen then.
    at_mm: DVec3,
}

impl SimulatedUser {
    /// A user at rest who knows the controls. The same seed gives the same user.
    ///
    /// # Panics
    ///
    /// If the reaction time is not positive: see [`TaskSettings::check`](crate::TaskSettings::check).
    pub fn new(settings: &UserSettings, controls: Controls, seed: u64) -> SimulatedUser {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        // A stream of its own beside that of the zones.
        rng.jump();
        SimulatedUser {
            error_rate: settings.error_rate,
            reaction_s: LogNormal::new((settings.reaction_ms / 1e3).ln(), REACTION_SPREAD)
                .expect("the reaction time is positive"),
            rng,
            controls,
            sights: VecDeque::new(),
            zone: None,
            notices_s: None,
            phase: Phase::Rest { judges_s: 0.0, released: None },
            learnt: Learnt { stopping_s: EXPECTED_LATENCY_S + SEEING_DELAY_S, without_effect_s: 0.0 },
        }
    }

    /// The contraction that is made now, with the arm at `position_mm` in this mode, and this zone to reach.
    pub fn act(&mut self, time_s: f64, position_mm: DVec3, mode: usize, zone: &Zone) -> Contraction {
        self.sights.push_back(Sight { time_s, position_mm, mode });
        let Some(seen) = self.seen(time_s) else { return Contraction::REST };
        self.notice(time_s, seen, zone);
        match self.phase {
            Phase::Rest { judges_s, released } => {
                if time_s >= judges_s && self.is_still(time_s) {
                    self.judge(time_s, seen, released);
                }
            }
            Phase::React { contracts_s } if time_s >= contracts_s => self.contract(time_s, seen),
            Phase::React { .. } => {}
            Phase::Move(movement) => self.watch_movement(time_s, seen, movement),
            Phase::Change { .. } => self.watch_mode(time_s, seen),
            Phase::Slip { releases_s, .. } if time_s >= releases_s => self.release(time_s, None),
            Phase::Slip { .. } => {}
        }
        self.phase.contraction()
    }

    /// What is seen now. Older sights are kept for as long as stillness is judged by them.
    fn seen(&mut self, time_s: f64) -> Option<Sight> {
        while self.sights.front().is_some_and(|old| old.time_s < time_s - SEEING_DELAY_S - STILL_S) {
            self.sights.pop_front();
        }
        self.visible(time_s).last().copied()
    }

    fn visible(&self, time_s: f64) -> impl Iterator<Item = &Sight> {
        self.sights.iter().take_while(move |sight| sight.time_s <= time_s - SEEING_DELAY_S)
    }

    fn is_still(&self, time_s: f64) -> bool {
        let (mut lowest_mm, mut highest_mm) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for sight in self.visible(time_s) {
            lowest_mm = lowest_mm.min(sight.position_mm);
            highest_mm = highest_mm.max(sight.position_mm);
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
    fn notice(&mut self, time_s: f64, seen: Sight, zone: &Zone) {
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
            Phase::Rest { judges_s, .. } if time_s >= judges_s => self.contract(time_s, seen),
            Phase::Rest { .. } | Phase::React { .. } => {}
            Phase::Move(_) | Phase::Change { .. } | Phase::Slip { .. } => {
                let step = self
                    .next_step(zone, seen)
                    .filter(|step| step.gesture() == self.phase.contraction().gesture);
                match (step, self.phase) {
                    (Some(Step::Move(planned, missing_mm)), _) => {
                        self.begin(time_s, seen, planned, missing_mm)
                    }
                    (Some(Step::Change(_)), Phase::Change { .. }) => {}
                    _ => self.release(time_s, None),
                }
            }
        }
    }

    /// Looks at what came of the last movement, learns from it, and decides whether another is needed.
    fn judge(&mut self, time_s: f64, seen: Sight, released: Option<Release>) {
        if let Some(released) = released {
            self.learnt.learn(&released, seen.position_mm);
        }
        self.phase = match &self.zone {
            Some(zone) if !zone.contains(seen.position_mm) => {
                Phase::React { contracts_s: time_s + self.reaction_s() }
            }
            _ => Phase::Rest { judges_s: time_s, released: None },
        };
    }

    fn next_step(&self, zone: &Zone, seen: Sight) -> Option<Step> {
        let missing_mm = zone.centre_mm - seen.position_mm;
        self.controls.next_step(seen.mode, missing_mm, TOLERANCE * zone.width_mm)
    }

    fn contract(&mut self, time_s: f64, seen: Sight) {
        let zone = self.zone.filter(|zone| !zone.contains(seen.position_mm));
        let Some(step) = zone.and_then(|zone| self.next_step(&zone, seen)) else {
            self.phase = Phase::Rest { judges_s: time_s, released: None };
            return;
        };
        if self.rng.random_bool(self.error_rate) {
            let slips = self.controls.slips(seen.mode, step.gesture());
            if !slips.is_empty() {
                let gesture = slips[self.rng.random_range(0..slips.len())];
                // The slip is felt at once, but takes another reaction time to be mended.
                self.phase = Phase::Slip { gesture, releases_s: time_s + self.reaction_s() };
                return;
            }
        }
        match step {
            Step::Move(planned, missing_mm) => self.begin(time_s, seen, planned, missing_mm),
            Step::Change(change) => {
                self.phase = Phase::Change { change, mode: seen.mode, since_s: time_s, releases_s: None };
            }
        }
    }

    fn begin(&mut self, time_s: f64, seen: Sight, planned: Move, missing_mm: f64) {
        let speed_mm_per_s = self.speed_mm_per_s(missing_mm, planned);
        let effort = self.effort(speed_mm_per_s / planned.speed_mm_per_s);
        let end = self.plan(missing_mm, speed_mm_per_s);
        self.phase = Phase::Move(Movement {
            planned,
            since_s: time_s,
            from: seen,
            missing_mm,
            effort,
            speed_mm_per_s,
            end,
        });
    }

    /// The speed that is meant for a movement of this length.
    fn speed_mm_per_s(&self, missing_mm: f64, planned: Move) -> f64 {
        let highest = planned.speed_mm_per_s;
        match self.controls.effort_matters() {
            true => (missing_mm / MOVEMENT_S).clamp(SLOWEST_SHARE * highest, highest),
            false => highest,
        }
    }

    /// The effort for this share of the highest speed, as well as it can be kept.
    fn effort(&mut self, share: f64) -> f64 {
        if !self.controls.effort_matters() {
            return 1.0;
        }
        let normal: f64 = StandardNormal.sample(&mut self.rng);
        (self.controls.effort(share) * (1.0 + EFFORT_SPREAD * normal)).clamp(0.0, 1.0)
    }

    /// How a movement of this length will be ended.
    fn plan(&mut self, missing_mm: f64, speed_mm_per_s: f64) -> End {
        let Learnt { stopping_s, without_effect_s } = self.learnt;
        let stopping_mm = stopping_s * speed_mm_per_s;
        if missing_mm > 1.2 * stopping_mm {
            End::Near(self.by_hand(stopping_mm))
        } else {
            End::After(self.by_hand(missing_mm / speed_mm_per_s + without_effect_s))
        }
    }

    fn watch_movement(&mut self, time_s: f64, seen: Sight, movement: Movement) {
        let held_s = time_s - movement.since_s;
        let travelled_mm = seen.position_mm - movement.from.position_mm;
        let Movement { speed_mm_per_s, planned: Move { direction, .. }, .. } = movement;
        let missing_mm = movement.missing_mm - travelled_mm.dot(direction);
        let is_over = match movement.end {
            End::Wrong(releases_s) if time_s >= releases_s => return self.release(time_s, None),
            End::Wrong(_) => return,
            End::After(length_s) => held_s >= length_s,
            End::Near(near_mm) => missing_mm <= near_mm,
        };
        if is_over {
            self.release(time_s, Some(Release { movement, time_s, at_mm: seen.position_mm }));
            return;
        }
        let expected_s = movement.missing_mm / speed_mm_per_s + EXPECTED_LATENCY_S;
        let aside_mm = travelled_mm.reject_from_normalized(direction).length();
        let is_astray = aside_mm > ASTRAY_MM || missing_mm > movement.missing_mm + ASTRAY_MM;
        if is_astray || held_s > expected_s + STUCK_S || seen.mode != movement.from.mode {
            let end = End::Wrong(time_s + self.reaction_s());
            self.phase = Phase::Move(Movement { end, ..movement });
        }
    }

    fn watch_mode(&mut self, time_s: f64, seen: Sight) {
        let Phase::Change { change, mode, since_s, releases_s } = self.phase else { return };
        let is_enough = time_s > since_s + change.hold_s + EXPECTED_LATENCY_S + STUCK_S;
        match releases_s {
            Some(releases_s) if time_s >= releases_s => self.release(time_s, None),
            None if is_enough || seen.mode != mode => {
                let releases_s = Some(time_s + self.reaction_s());
                self.phase = Phase::Change { change, mode, since_s, releases_s };
            }
            _ => {}
        }
    }

    fn release(&mut self, time_s: f64, released: Option<Release>) {
        self.phase = Phase::Rest { judges_s: time_s + PATIENCE_S, released };
    }
}

impl Phase {
    /// The contraction that is made.
    fn contraction(&self) -> Contraction {
        match self {
            Phase::Rest { .. } | Phase::React { .. } => Contraction::REST,
            Phase::Move(movement) => {
                Contraction { gesture: movement.planned.gesture, effort: movement.effort }
            }
            Phase::Change { change, .. } => Contraction::comfortable(change.gesture),
            Phase::Slip { gesture, .. } => Contraction::comfortable(*gesture),
        }
    }
}

impl Learnt {
    /// The arm came to rest at `seen_mm` after this release.
    fn learn(&mut self, released: &Release, seen_mm: DVec3) {
        let Release { movement, time_s, at_mm } = released;
        let Movement { speed_mm_per_s, planned: Move { direction, .. }, .. } = *movement;
        match movement.end {
            End::Near(_) => {
                // What is not plausible, because a gesture was not recognised, is not learnt from.
                let stopping_s = (seen_mm - at_mm).dot(direction) / speed_mm_per_s;
                if (0.0..=3.0 * self.stopping_s).contains(&stopping_s) {
                    self.stopping_s += LEARNING_RATE * (stopping_s - self.stopping_s);
                }
            }
            End::After(_) => {
                let moved_s = (seen_mm - movement.from.position_mm).dot(direction) / speed_mm_per_s;
                let without_effect_s = (time_s - movement.since_s - moved_s).clamp(-1.0, 1.0);
                self.without_effect_s += LEARNING_RATE * (without_effect_s - self.without_effect_s);
            }
            End::Wrong(_) => {}
        }
    }
}

#[cfg(test)]
mod tests;
