//! From commanded twists to a velocity that changes smoothly, and to rest when commands stop.
//!
//! ```text
//! mm/s            command                      no command for 150 ms, or `stop`
//! 100 ┤              .·───────────────────────·.
//!     │            ·                            ·
//!     │           ·      500 mm/s²,              ·  80 ms
//!   0 ┼─────────·´       10 000 mm/s³             `·──────────
//! ```
//!
//! - **Following.** An inner velocity goes straight to the commanded one at no more than the acceleration limit a.
//!   The velocity of the arm is the moving average of the inner velocities of the last T = 2a/j seconds. As an average
//!   of vectors it keeps their speed limit, and its acceleration is an average of accelerations, no greater
//!   than a. That acceleration changes by the difference of two inner accelerations over T: the jerk is at
//!   most 2a/T = j. (A trapezoidal profile smoothed by a moving average: Biagiotti and Melchiorri,
//!   Trajectory Planning for Automatic Machines and Robots, 2008, ch. 4.)
//! - **Limits.** Before each step the ramp asks whether the arm, should it brake right after it, would come to
//!   rest within its limits ([`RunDown`]). If not, it takes the greatest share of the step, and brakes for the rest. At
//!   a face of the workspace only the part of the command that leads into the face is braked: the arm slides along it.
//! - **Stopping.** Beside all that, a stop takes the velocity to zero by a factor that falls from 1 to 0 along two
//!   parabolas in [`STOP_NS`].

use nalgebra::Vector6;

use crate::limits::Obstacle;
use crate::step::{STEP_NS, STEP_S, part};
use crate::{ArmSettings, Twist};

/// Greatest angular speed of a commanded motion in rad/s: 29° a second, calm beside 100 mm/s.
pub const ANGULAR_SPEED_LIMIT_RAD_PER_S: f64 = 0.5;

/// Greatest angular acceleration of a commanded motion in rad/s²: to the speed limit in 0.2 s.
pub const ANGULAR_ACCELERATION_RAD_PER_S2: f64 = 2.5;

/// Time from the beginning of a stop to rest, in ns, whatever the speed.
pub const STOP_NS: u64 = 80_000_000;

const STOP_STEPS: u32 = (STOP_NS / STEP_NS) as u32;

/// The greatest length of the moving average in steps: 1 s.
pub(crate) const MOST_AVERAGED_STEPS: usize = 250;

/// How often the share of a step that keeps the limits is halved. A step is 2 mm/s at 500 mm/s²: the share is
/// exact to 0.06 mm/s.
const BISECTIONS: u32 = 6;

/// Bounds of a motion, either linear (mm/s, mm/s², mm/s³) or angular (rad/s, rad/s², rad/s³).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionBounds {
    /// Greatest speed.
    pub speed: f64,
    /// Greatest acceleration.
    pub acceleration: f64,
    /// Greatest jerk.
    pub jerk: f64,
}

impl MotionBounds {
    /// The bounds during a stop of a motion with these bounds.
    ///
    /// A stop multiplies the velocity v(t) by s(t) with |s′| ≤ 2/T and |s″| ≤ 4/T², T being [`STOP_NS`]. By the product
    /// rule acceleration is at most a + 2v/T, and jerk at most j + 2·a·2/T + v·4/T².
    pub fn while_stopping(&self) -> MotionBounds {
        let stop_s = STOP_NS as f64 * 1e-9;
        MotionBounds {
            speed: self.speed,
            acceleration: self.acceleration + 2.0 * self.speed / stop_s,
            jerk: self.jerk + 4.0 * self.acceleration / stop_s + 4.0 * self.speed / stop_s.powi(2),
        }
    }
}

/// The velocity an arm is to follow at each moment: limited in speed, acceleration and jerk, and at rest when
/// no command has come for the time of the watchdog.
#[derive(Clone, Debug)]
pub(crate) struct TwistRamp {
    linear_speed_limit_mm_per_s: f64,
    /// Greatest change of the inner velocity a step: linear in mm/s, angular in rad/s.
    most_change: [f64; 2],
    watchdog_ns: u64,
    target: Twist,
    /// When the last command runs out; `None` before the first, and after a stop, a halt or the watchdog.
    deadline_ns: Option<u64>,
    halted_by_watchdog: bool,
    /// The last inner velocities (mm/s above rad/s), as many as are averaged, and where the oldest of them is.
    recent: [Vector6<f64>; MOST_AVERAGED_STEPS],
    averaged_steps: usize,
    oldest: usize,
    /// How many of the last inner velocities were zero.
    quiet_steps: usize,
    /// Steps of the stop that were taken; `None` while following.
    stop_steps: Option<u32>,
    /// What kept the last step from being as commanded.
    obstacle: Option<Obstacle>,
    velocity: Twist,
}

impl TwistRamp {
    /// A ramp at rest.
    pub fn new(settings: &ArmSettings) -> TwistRamp {
        let averaged_steps = settings.averaged_steps().min(MOST_AVERAGED_STEPS);
        TwistRamp {
            linear_speed_limit_mm_per_s: settings.linear_speed_limit_mm_per_s,
            most_change: [
                settings.linear_acceleration_mm_per_s2 * STEP_S,
                ANGULAR_ACCELERATION_RAD_PER_S2 * STEP_S,
            ],
            watchdog_ns: settings.watchdog_ns(),
            target: Twist::ZERO,
            deadline_ns: None,
            halted_by_watchdog: false,
            recent: [Vector6::zeros(); MOST_AVERAGED_STEPS],
            averaged_steps,
            oldest: 0,
            quiet_steps: averaged_steps,
            stop_steps: None,
            obstacle: None,
            velocity: Twist::ZERO,
        }
    }

    /// Sets the velocity to ramp to, slowed as a whole to the speed limits, and feeds the watchdog. While the arm
    /// is stopping, it counts once the arm is at rest.
    pub fn command(&mut self, twist: Twist, now_ns: u64) {
        self.target = twist.limited(self.linear_speed_limit_mm_per_s, ANGULAR_SPEED_LIMIT_RAD_PER_S);
        self.deadline_ns = Some(now_ns.saturating_add(self.watchdog_ns));
        self.halted_by_watchdog = false;
    }

    /// Forgets the command and comes to rest within [`STOP_NS`].
    pub fn stop(&mut self) {
        self.target = Twist::ZERO;
        self.deadline_ns = None;
        self.halted_by_watchdog = false;
        if self.stop_steps.is_none() && self.moves() {
            self.stop_steps = Some(0);
        }
    }

    /// Forgets the command and is at rest at once: for an arm that has stopped by itself.
    pub fn halt(&mut self) {
        self.target = Twist::ZERO;
        self.deadline_ns = None;
        self.halted_by_watchdog = false;
        self.come_to_rest();
    }

    /// The velocity for the [`STEP_NS`] that begin at `now_ns`. `permits` says of a run-down whether it keeps the
    /// limits; braking needs no permission.
    pub fn advance(&mut self, now_ns: u64, permits: impl Fn(&RunDown) -> Result<(), Obstacle>) -> Twist {
        if self.deadline_ns.is_some_and(|deadline_ns| now_ns >= deadline_ns) {
            self.stop();
            self.halted_by_watchdog = true;
        }
        let (next, obstacle) = self.next_inner(permits);
        self.obstacle = obstacle;
        self.recent[self.oldest] = next;
        self.oldest = (self.oldest + 1) % self.averaged_steps;
        self.quiet_steps = if next == Vector6::zeros() { self.quiet_steps.saturating_add(1) } else { 0 };

        // Summed anew each time: a running sum would gather rounding errors, and rest would not be zero.
        let mean = self.sum_of_recent() / self.averaged_steps as f64;
        self.velocity = Twist::from_vector_mm(&mean);
        if let Some(steps) = self.stop_steps {
            let steps = steps + 1;
            self.stop_steps = Some(steps);
            self.velocity = self.velocity.scaled(stop_share(steps));
            if steps == STOP_STEPS {
                self.come_to_rest();
            }
        }
        self.velocity
    }

    /// The velocity of the last step.
    pub fn velocity(&self) -> Twist {
        self.velocity
    }

    /// What kept the last step from being as commanded.
    pub fn obstacle(&self) -> Option<Obstacle> {
        self.obstacle
    }

    /// Whether a stop is under way.
    pub fn is_stopping(&self) -> bool {
        self.stop_steps.is_some()
    }

    /// Whether the last command ran out and none has come since.
    pub fn halted_by_watchdog(&self) -> bool {
        self.halted_by_watchdog
    }

    /// Whether nothing moves and nothing will before the next command.
    pub fn is_at_rest(&self) -> bool {
        self.deadline_ns.is_none() && self.is_still()
    }

    /// Whether the velocity is zero and is to stay so until a command says otherwise.
    pub fn is_still(&self) -> bool {
        self.target == Twist::ZERO && !self.moves()
    }

    /// Whether the velocity, or one to come without any command, is other than zero.
    fn moves(&self) -> bool {
        self.quiet_steps < self.averaged_steps
    }

    fn come_to_rest(&mut self) {
        self.recent[..self.averaged_steps].fill(Vector6::zeros());
        self.quiet_steps = self.averaged_steps;
        self.stop_steps = None;
        self.velocity = Twist::ZERO;
    }

    /// The inner velocity of the coming step, and what kept it from being as commanded.
    fn next_inner(
        &self,
        permits: impl Fn(&RunDown) -> Result<(), Obstacle>,
    ) -> (Vector6<f64>, Option<Obstacle>) {
        let inner = self.recent[(self.oldest + self.averaged_steps - 1) % self.averaged_steps];
        let brake = toward(&inner, &Vector6::zeros(), self.most_change);
        if self.is_stopping() {
            return (brake, None);
        }
        let target = self.target.to_vector_mm();
        let wanted = toward(&inner, &target, self.most_change);
        if wanted == brake {
            return (wanted, None);
        }
        let obstacle = match permits(&RunDown::new(self, wanted)) {
            Ok(()) => return (wanted, None),
            Err(obstacle) => obstacle,
        };
        let least = self.slide(&inner, target, obstacle, &permits).unwrap_or(brake);
        // Each mixture of the two changes the inner velocity by no more than they do.
        let mixture = |share: f64| least + (wanted - least) * share;
        let (mut permitted, mut refused) = (0.0, 1.0);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (permitted + refused);
            if permits(&RunDown::new(self, mixture(middle))).is_ok() {
                permitted = middle;
            } else {
                refused = middle;
            }
        }
        (mixture(permitted), Some(obstacle))
    }

    /// The inner velocity on the way to the part of the target that leads along the faces of the workspace, if it is
    /// permitted.
    fn slide(
        &self,
        inner: &Vector6<f64>,
        mut target: Vector6<f64>,
        mut obstacle: Obstacle,
        permits: impl Fn(&RunDown) -> Result<(), Obstacle>,
    ) -> Option<Vector6<f64>> {
        // Three faces can meet in a corner.
        for _ in 0..3 {
            let Obstacle::WorkspaceFace { axis, is_upper } = obstacle else { return None };
            let leads_into_it = if is_upper { target[axis] > 0.0 } else { target[axis] < 0.0 };
            if !leads_into_it {
                return None;
            }
            target[axis] = 0.0;
            let along = toward(inner, &target, self.most_change);
            match permits(&RunDown::new(self, along)) {
                Ok(()) => return Some(along),
                Err(next) => obstacle = next,
            }
        }
        None
    }

    fn sum_of_recent(&self) -> Vector6<f64> {
        self.recent[..self.averaged_steps].iter().sum()
    }
}

/// What would follow if the inner velocity took a candidate value in the coming step and were braked to
/// rest from there.
pub(crate) struct RunDown<'a> {
    ramp: &'a TwistRamp,
    candidate: Vector6<f64>,
    /// The share of the candidate, linear and angular, that a step of braking takes away.
    braked_a_step: [f64; 2],
}

impl<'a> RunDown<'a> {
    fn new(ramp: &'a TwistRamp, candidate: Vector6<f64>) -> RunDown<'a> {
        let [linear, angular] = ramp.most_change;
        let (linear_speed, angular_speed) = (part(&candidate, 0).norm(), part(&candidate, 3).norm());
        // A speed of zero divides to infinity: braked in one step.
        let braked_a_step = [(linear / linear_speed).min(1.0), (angular / angular_speed).min(1.0)];
        RunDown { ramp, candidate, braked_a_step }
    }

    /// The velocity of the arm (mm/s above rad/s) in each step, the coming one first, the last one zero.
    pub fn velocities(&self) -> impl Iterator<Item = Vector6<f64>> {
        let (ramp, averaged) = (self.ramp, self.ramp.averaged_steps);
        let slowest = self.braked_a_step[0].min(self.braked_a_step[1]);
        let braking = (1.0 / slowest).ceil() as usize;
        let mut sum = ramp.sum_of_recent();
        (0..braking + averaged).map(move |step| {
            let leaving = match step.checked_sub(averaged) {
                None => ramp.recent[(ramp.oldest + step) % averaged],
                Some(step) => self.inner(step),
            };
            sum += self.inner(step) - leaving;
            sum / averaged as f64
        })
    }

    /// The inner velocity so many steps after the coming one.
    fn inner(&self, step: usize) -> Vector6<f64> {
        let left = self.braked_a_step.map(|braked| (1.0 - step as f64 * braked).max(0.0));
        let [linear, angular] = left;
        self.candidate.component_mul(&Vector6::new(linear, linear, linear, angular, angular, angular))
    }
}

/// The share of the velocity that is left after so many steps of a stop: two parabolas, which meet at one half.
fn stop_share(steps: u32) -> f64 {
    let passed = f64::from(steps) / f64::from(STOP_STEPS);
    if passed < 0.5 { 1.0 - 2.0 * passed.powi(2) } else { 2.0 * (1.0 - passed).powi(2) }
}

/// `from` moved toward `to`, its linear and its angular part each by at most `most` and in a straight line.
fn toward(from: &Vector6<f64>, to: &Vector6<f64>, most: [f64; 2]) -> Vector6<f64> {
    let mut moved = *to;
    for (row, most) in [(0, most[0]), (3, most[1])] {
        let (from, to) = (part(from, row), part(to, row));
        let distance = (to - from).norm();
        if distance > most {
            moved.fixed_rows_mut::<3>(row).copy_from(&(from + (to - from) * (most / distance)));
        }
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;

    fn forward(speed_mm_per_s: f64) -> Twist {
        Twist { linear_mm_per_s: [speed_mm_per_s, 0.0, 0.0], ..Twist::ZERO }
    }

    fn ramp() -> TwistRamp {
        TwistRamp::new(&ArmSettings::default())
    }

    /// Takes so many steps without limits, from the time of step `begin`, and returns the speeds along x in mm/s.
    fn speeds(ramp: &mut TwistRamp, begin: u64, steps: u64) -> Vec<f64> {
        (begin..begin + steps)
            .map(|step| ramp.advance(step * STEP_NS, |_| Ok(())).linear_mm_per_s[0])
            .collect()
    }

    #[test]
    fn the_ramp_takes_296_ms_to_the_speed_limit_and_is_symmetric() {
        let mut ramp = TwistRamp::new(&ArmSettings { watchdog_ms: 10_000, ..ArmSettings::default() });
        ramp.command(forward(300.0), 0);
        // 50 steps of 2 mm/s, averaged over 25.
        let up = speeds(&mut ramp, 0, 74);
        assert!(up[72] < 99.99 && (up[73] - 100.0).abs() < 1e-9);
        ramp.command(Twist::ZERO, 74 * STEP_NS);
        let down = speeds(&mut ramp, 74, 74);
        assert!(up.iter().zip(&down).all(|(up, down)| (up + down - 100.0).abs() < 1e-9));
        assert_eq!(down[73], 0.0);
        assert!(ramp.is_still() && !ramp.is_at_rest());
    }

    #[test]
    fn a_run_down_is_what_braking_does() {
        let mut ramp = ramp();
        ramp.command(Twist { linear_mm_per_s: [60.0, 70.0, 0.0], angular_rad_per_s: [0.0, 0.1, 0.3] }, 0);
        speeds(&mut ramp, 0, 30);
        ramp.command(forward(-100.0), 30 * STEP_NS);
        let foreseen = std::cell::RefCell::new(Vec::new());
        let mut followed = vec![ramp.advance(30 * STEP_NS, |run_down| {
            *foreseen.borrow_mut() = run_down.velocities().collect();
            Ok(())
        })];
        ramp.command(Twist::ZERO, 31 * STEP_NS);
        let foreseen = foreseen.into_inner();
        // With the watchdog's 150 ms this is shorter than the braking; feed it on the way.
        for step in 31..30 + foreseen.len() as u64 {
            ramp.command(Twist::ZERO, step * STEP_NS);
            followed.push(ramp.advance(step * STEP_NS, |_| Err(Obstacle::Singularity)));
        }
        assert!(ramp.is_still());
        for (foreseen, followed) in foreseen.iter().zip(followed) {
            assert!((foreseen - followed.to_vector_mm()).amax() < 1e-9);
        }
    }

    #[test]
    fn a_refused_step_is_braked_and_a_share_of_it_taken_if_that_is_permitted() {
        let mut ramp = ramp();
        ramp.command(forward(100.0), 0);
        speeds(&mut ramp, 0, 20);
        let most = |candidate: f64| {
            move |run_down: &RunDown| {
                if run_down.candidate[0] <= candidate { Ok(()) } else { Err(Obstacle::JointSpeed) }
            }
        };
        for (permitted, expected) in [(0.0, 38.0), (39.0, 39.0), (41.97, 41.9375), (50.0, 42.0)] {
            let inner = ramp.clone().next_inner(most(permitted)).0[0];
            assert!((inner - expected).abs() < 1e-9, "{permitted} {inner}");
        }
    }

    #[test]
    fn the_watchdog_stops_exactly_when_the_command_runs_out() {
        let mut ramp = ramp();
        ramp.command(forward(2.0), 1_000);
        (0..30).for_each(|_| _ = ramp.advance(150_000_999, |_| Ok(())));
        assert!((ramp.velocity().linear_mm_per_s[0] - 2.0).abs() < 1e-12);
        assert!(!ramp.halted_by_watchdog() && !ramp.is_stopping());
        ramp.advance(150_001_000, |_| Ok(()));
        assert!(ramp.halted_by_watchdog() && ramp.is_stopping());
        let slowing = speeds(&mut ramp, 38, 19);
        assert!(slowing[17] > 0.0 && slowing[18] == 0.0);
        assert!(ramp.halted_by_watchdog() && ramp.is_at_rest());
        ramp.command(forward(1.0), 300_000_000);
        assert!(!ramp.halted_by_watchdog());
    }

    #[test]
    fn a_command_waits_for_the_end_of_a_stop_and_may_run_out_meanwhile() {
        for (command_at, moves_after) in [(70, true), (56, true), (70 - 40, false)] {
            let mut ramp = TwistRamp::new(&ArmSettings { watchdog_ms: 60, ..ArmSettings::default() });
            for step in 0..50 {
                ramp.command(forward(100.0), step * STEP_NS);
                ramp.advance(step * STEP_NS, |_| Ok(()));
            }
            ramp.stop();
            for step in 50..80 {
                if step == command_at {
                    ramp.command(forward(100.0), step * STEP_NS);
                }
                let speed = ramp.advance(step * STEP_NS, |_| Ok(())).linear_mm_per_s[0];
                if step == 69 {
                    assert_eq!(speed, 0.0, "20 steps after the stop");
                }
                if step == 70 {
                    assert_eq!(speed > 0.0, moves_after, "{command_at}");
                }
            }
        }
    }

    #[test]
    fn a_stop_that_follows_a_stop_is_no_longer_and_drops_the_waiting_command() {
        let mut ramp = ramp();
        ramp.command(forward(100.0), 0);
        speeds(&mut ramp, 0, 30);
        ramp.stop();
        speeds(&mut ramp, 30, 10);
        ramp.command(forward(100.0), 40 * STEP_NS);
        ramp.stop();
        assert_eq!(speeds(&mut ramp, 40, 10)[9], 0.0);
        assert!(ramp.is_at_rest());
    }

    #[test]
    fn an_arm_that_stands_still_needs_no_stop() {
        let mut ramp = ramp();
        ramp.command(forward(100.0), 0);
        ramp.stop();
        assert!(ramp.is_at_rest() && !ramp.is_stopping());
    }

    #[test]
    fn an_arm_whose_velocity_passes_through_zero_is_not_still() {
        let mut ramp =
            TwistRamp::new(&ArmSettings { linear_jerk_mm_per_s3: 1000.0, ..ArmSettings::default() });
        ramp.command(forward(2.0), 0);
        speeds(&mut ramp, 0, 1);
        ramp.command(forward(-2.0), 0);
        assert_eq!(speeds(&mut ramp, 0, 2)[1], 0.0);
        ramp.command(Twist::ZERO, 0);
        assert_eq!(speeds(&mut ramp, 0, 1)[0], 0.0);
        assert!(!ramp.is_still());
    }

    #[test]
    fn a_halt_needs_no_ramp_and_lasts() {
        let mut ramp = ramp();
        ramp.command(forward(100.0), 0);
        speeds(&mut ramp, 0, 10);
        ramp.halt();
        assert!(ramp.is_at_rest());
        assert_eq!(speeds(&mut ramp, 10, 1), [0.0]);
    }
}
