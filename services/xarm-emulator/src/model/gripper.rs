//! The gripper: it travels with its own speed, obeys only while its motor is on, and may meet an object.

use super::STEP_S;

/// Ends of the gripper's way, pulses.
const CLOSED_PULSES: f64 = -10.0;
const OPEN_PULSES: f64 = 850.0;
/// Pulses/s of a gripper to which nobody gave a speed.
const SPEED_PULSES_PER_S: f64 = 1500.0;

/// The gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gripper {
    /// Whether its motor is on.
    pub enabled: bool,
    /// Where it is, pulses.
    pub position_pulses: f64,
    /// Where it goes, pulses.
    pub target_pulses: f64,
    /// How fast, pulses/s.
    pub speed_pulses_per_s: f64,
    /// Error code.
    pub error: u16,
    /// Width of the object between its fingers, pulses; they close no further.
    pub object_pulses: Option<f64>,
}

impl Gripper {
    /// Open, and switched off.
    pub(super) fn new() -> Gripper {
        Gripper {
            enabled: false,
            position_pulses: OPEN_PULSES,
            target_pulses: OPEN_PULSES,
            speed_pulses_per_s: SPEED_PULSES_PER_S,
            error: 0,
            object_pulses: None,
        }
    }

    /// Switches the motor. Off, the fingers stay where they are.
    pub fn enable(&mut self, on: bool) {
        self.enabled = on;
        if !on {
            self.target_pulses = self.position_pulses;
        }
    }

    /// Sets the speed, pulses/s.
    pub fn set_speed(&mut self, speed_pulses_per_s: u16) {
        self.speed_pulses_per_s = f64::from(speed_pulses_per_s.max(1));
    }

    /// Where it is to go, pulses. Returns whether it took the order: not while its motor is off.
    pub fn move_to(&mut self, pulses: i32) -> bool {
        if self.enabled {
            self.target_pulses = f64::from(pulses).clamp(CLOSED_PULSES, OPEN_PULSES);
        }
        self.enabled
    }

    /// Puts an object of this width, pulses, between the fingers, which must be further apart.
    pub fn put_object(&mut self, pulses: u16) {
        self.object_pulses = Some(f64::from(pulses)).filter(|&width| width <= self.position_pulses);
    }

    /// How far it can go toward its target.
    fn end_pulses(&self) -> f64 {
        self.object_pulses.map_or(self.target_pulses, |width| self.target_pulses.max(width))
    }

    /// Whether the fingers move.
    pub fn moves(&self) -> bool {
        self.position_pulses != self.end_pulses()
    }

    /// Whether the fingers press on the object.
    pub fn holds(&self) -> bool {
        !self.moves() && self.target_pulses < self.position_pulses
    }

    /// Lets a step of the model pass.
    pub(super) fn step(&mut self) {
        let way = self.speed_pulses_per_s * STEP_S;
        let left = self.end_pulses() - self.position_pulses;
        // To the last bit, so that standing is standing.
        self.position_pulses =
            if left.abs() <= way { self.end_pulses() } else { self.position_pulses + way.copysign(left) };
        if self.object_pulses.is_some_and(|width| self.position_pulses > width + 1.0 && !self.moves()) {
            // Nothing holds it any more.
            self.object_pulses = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on() -> Gripper {
        let mut gripper = Gripper::new();
        gripper.enable(true);
        gripper.set_speed(1000);
        gripper
    }

    #[test]
    fn it_takes_its_time_and_stops_where_it_is_told() {
        let mut gripper = on();
        assert!(gripper.move_to(350));
        (0..100).for_each(|_| gripper.step());
        assert!(gripper.moves());
        assert!(gripper.move_to(gripper.position_pulses as i32));
        (0..2).for_each(|_| gripper.step());
        assert!(!gripper.moves() && (gripper.position_pulses - 450.0).abs() < 1.0, "{gripper:?}");
        assert!(gripper.move_to(5000));
        (0..1000).for_each(|_| gripper.step());
        assert_eq!((gripper.moves(), gripper.position_pulses), (false, 850.0));
    }

    #[test]
    fn it_refuses_when_off() {
        let mut gripper = on();
        gripper.move_to(0);
        gripper.step();
        gripper.enable(false);
        assert!(!gripper.moves() && !gripper.move_to(0) && !gripper.moves());
    }

    #[test]
    fn it_holds_what_it_closes_on() {
        let mut gripper = on();
        gripper.put_object(400);
        gripper.move_to(0);
        (0..1000).for_each(|_| gripper.step());
        assert_eq!((gripper.position_pulses, gripper.holds()), (400.0, true));
        gripper.move_to(400);
        assert!(!gripper.holds(), "a target where it is takes the force away");
    }
}
