//! From commanded twists to a velocity that changes smoothly, and to rest when commands stop.
//!
//! ```text
//! mm/s            command           last command    its 150 ms are over
//! 100 ┤              ╭─────────────────────┬──────────╮
//!     │            ╱                                   ╲   500 mm/s²
//!   0 ┼──────────╯                                      ╰──────────
//! ```

use nalgebra::Vector3;

use crate::{ArmSettings, Twist};

/// Greatest angular speed of a commanded motion in rad/s: 29° a second, calm beside 100 mm/s.
pub const ANGULAR_SPEED_LIMIT_RAD_PER_S: f64 = 0.5;

/// Greatest angular acceleration of a commanded motion in rad/s²: to the speed limit in 0.2 s.
pub const ANGULAR_ACCELERATION_RAD_PER_S2: f64 = 2.5;

/// The velocity an arm is to follow at each moment: limited in speed and acceleration, and at rest when no
/// command has come for the time of the watchdog.
///
/// This watchdog is software: it is not safety-rated and replaces no emergency stop.
#[derive(Clone, Debug)]
pub struct TwistRamp {
    linear_speed_limit_mm_per_s: f64,
    linear_acceleration_mm_per_s2: f64,
    watchdog_ns: u64,
    target: Twist,
    velocity: Twist,
    /// When the last command runs out; `None` before the first, and after a halt or the watchdog.
    deadline_ns: Option<u64>,
    halted_by_watchdog: bool,
}

impl TwistRamp {
    /// A ramp at rest.
    pub fn new(settings: &ArmSettings) -> TwistRamp {
        TwistRamp {
            linear_speed_limit_mm_per_s: settings.linear_speed_limit_mm_per_s,
            linear_acceleration_mm_per_s2: settings.linear_acceleration_mm_per_s2,
            watchdog_ns: settings.watchdog_ns(),
            target: Twist::ZERO,
            velocity: Twist::ZERO,
            deadline_ns: None,
            halted_by_watchdog: false,
        }
    }

    /// Sets the velocity to ramp to, slowed as a whole to the speed limits, and feeds the watchdog.
    pub fn command(&mut self, twist: Twist, now_ns: u64) {
        self.target = twist.limited(self.linear_speed_limit_mm_per_s, ANGULAR_SPEED_LIMIT_RAD_PER_S);
        self.deadline_ns = Some(now_ns.saturating_add(self.watchdog_ns));
        self.halted_by_watchdog = false;
    }

    /// Zeroes target and velocity at once, without a ramp, until the next command.
    pub fn halt(&mut self) {
        self.target = Twist::ZERO;
        self.velocity = Twist::ZERO;
        self.deadline_ns = None;
        self.halted_by_watchdog = false;
    }

    /// The velocity for the `step_s` seconds that begin at `now_ns`.
    pub fn advance(&mut self, now_ns: u64, step_s: f64) -> Twist {
        if self.deadline_ns.is_some_and(|deadline_ns| now_ns >= deadline_ns) {
            self.target = Twist::ZERO;
            self.deadline_ns = None;
            self.halted_by_watchdog = true;
        }
        self.velocity = Twist {
            linear_mm_per_s: toward(
                self.velocity.linear_mm_per_s,
                self.target.linear_mm_per_s,
                self.linear_acceleration_mm_per_s2 * step_s,
            ),
            angular_rad_per_s: toward(
                self.velocity.angular_rad_per_s,
                self.target.angular_rad_per_s,
                ANGULAR_ACCELERATION_RAD_PER_S2 * step_s,
            ),
        };
        self.velocity
    }

    /// Takes over that the arm could follow only `scale` (0..=1) of the velocity, so that it gathers speed again
    /// from where it is and not from where it could not go.
    pub fn slow_to(&mut self, scale: f64) {
        self.velocity = self.velocity.scaled(scale);
    }

    /// The velocity of the last step.
    pub fn velocity(&self) -> Twist {
        self.velocity
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
        self.target == Twist::ZERO && self.velocity == Twist::ZERO
    }
}

/// `from` moved toward `to` by at most `most`, in a straight line.
fn toward(from: [f64; 3], to: [f64; 3], most: f64) -> [f64; 3] {
    let (from, to) = (Vector3::from(from), Vector3::from(to));
    let distance = (to - from).norm();
    if distance <= most { to.into() } else { (from + (to - from) * (most / distance)).into() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STEP_S: f64 = 0.004;

    fn forward(speed_mm_per_s: f64) -> Twist {
        Twist { linear_mm_per_s: [speed_mm_per_s, 0.0, 0.0], ..Twist::ZERO }
    }

    #[test]
    fn velocity_rises_by_the_acceleration_and_stays_at_the_limit() {
        let mut ramp = TwistRamp::new(&ArmSettings::default());
        ramp.command(forward(400.0), 0);
        for step in 1..=60 {
            let velocity = ramp.advance(0, STEP_S);
            let expected: f64 = if step < 50 { 2.0 * f64::from(step) } else { 100.0 };
            assert!((velocity.linear_mm_per_s[0] - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn the_watchdog_stops_exactly_when_the_command_runs_out() {
        let mut ramp = TwistRamp::new(&ArmSettings::default());
        ramp.command(forward(2.0), 1_000);
        assert_eq!(ramp.advance(150_000_999, STEP_S), forward(2.0));
        assert!(!ramp.halted_by_watchdog());
        assert_eq!(ramp.advance(150_001_000, STEP_S), Twist::ZERO);
        assert!(ramp.halted_by_watchdog() && ramp.is_at_rest());
        ramp.command(forward(1.0), 150_001_000);
        assert!(!ramp.halted_by_watchdog());
    }

    #[test]
    fn a_halt_needs_no_ramp_and_lasts() {
        let mut ramp = TwistRamp::new(&ArmSettings::default());
        ramp.command(forward(100.0), 0);
        ramp.advance(0, STEP_S);
        ramp.halt();
        assert!(ramp.is_at_rest());
        assert_eq!(ramp.advance(4_000_000, STEP_S), Twist::ZERO);
    }

    #[test]
    fn an_arm_that_was_slowed_gathers_speed_from_where_it_is() {
        let mut ramp = TwistRamp::new(&ArmSettings::default());
        ramp.command(forward(100.0), 0);
        (0..20).for_each(|_| _ = ramp.advance(0, STEP_S));
        ramp.slow_to(0.0);
        assert!((ramp.advance(0, STEP_S).linear_mm_per_s[0] - 2.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn no_command_changes_the_velocity_faster_than_the_acceleration(
            commands in prop::collection::vec(
                (prop::array::uniform3(-300.0..300.0_f64), prop::array::uniform3(-2.0..2.0_f64), 1..100_u64),
                1..10,
            ),
        ) {
            let mut ramp = TwistRamp::new(&ArmSettings::default());
            let mut now_ns = 0;
            for (linear_mm_per_s, angular_rad_per_s, steps) in commands {
                ramp.command(Twist { linear_mm_per_s, angular_rad_per_s }, now_ns);
                for _ in 0..steps {
                    let old = ramp.velocity();
                    let new = ramp.advance(now_ns, STEP_S);
                    now_ns += 4_000_000;
                    let change = |new: [f64; 3], old: [f64; 3]| (Vector3::from(new) - Vector3::from(old)).norm();
                    prop_assert!(change(new.linear_mm_per_s, old.linear_mm_per_s) <= 2.0 + 1e-9);
                    prop_assert!(change(new.angular_rad_per_s, old.angular_rad_per_s) <= 0.01 + 1e-9);
                    prop_assert!(new.linear_speed_mm_per_s() <= 100.0 + 1e-9);
                    prop_assert!(new.angular_speed_rad_per_s() <= ANGULAR_SPEED_LIMIT_RAD_PER_S + 1e-9);
                }
            }
        }
    }
}
