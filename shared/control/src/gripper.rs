//! Which way the gripper goes, from what it reports.
//!
//! Decision counts how often the gripper was asked to change sides. Where the gripper stands, and so whether it opens or
//! closes, is known here only: a request that came while the arm was stopped is spent, and leaves nothing at odds.

use tendon_arm::ArmSettings;

/// A gripper this near to its open position, as a share of its range, is open. Any other holds something, or was stopped
/// on its way, and opens next.
const OPEN_SHARE: f64 = 0.1;

/// Decides where the gripper goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gripper {
    open_pulses: f64,
    closed_pulses: f64,
    /// What the newest command counted.
    toggles: Option<u32>,
    /// Where it was last told to go; `None` once it was stopped, and before.
    target_pulses: Option<f64>,
}

impl Gripper {
    pub fn new(settings: &ArmSettings) -> Gripper {
        Gripper {
            open_pulses: settings.gripper_open_pulses,
            closed_pulses: settings.gripper_closed_pulses,
            toggles: None,
            target_pulses: None,
        }
    }

    /// Takes a command's count. Returns where the gripper is to go if it is to move now: `is_permitted`, and known to
    /// stand at `reported_pulses`.
    pub fn take(&mut self, toggles: u32, is_permitted: bool, reported_pulses: Option<f64>) -> Option<f64> {
        let before = self.toggles.replace(toggles)?;
        let is_toggled = toggles.wrapping_sub(before) % 2 == 1;
        if !(is_toggled && is_permitted) {
            return None;
        }
        let is_open = match self.target_pulses {
            Some(target_pulses) => target_pulses == self.open_pulses,
            None => self.is_open(reported_pulses?),
        };
        let target_pulses = if is_open { self.closed_pulses } else { self.open_pulses };
        self.target_pulses = Some(target_pulses);
        self.target_pulses
    }

    fn is_open(&self, reported_pulses: f64) -> bool {
        let from_open = (reported_pulses - self.open_pulses).abs();
        from_open <= OPEN_SHARE * (self.open_pulses - self.closed_pulses).abs()
    }

    /// It was stopped wherever it is.
    pub fn stopped(&mut self) {
        self.target_pulses = None;
    }

    /// The commands to come are another decision process's, which counts anew.
    pub fn counts_anew(&mut self) {
        self.toggles = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_changes_sides_from_where_it_stands() {
        let mut gripper = Gripper::new(&ArmSettings::default());
        assert_eq!(gripper.take(7, true, Some(850.0)), None, "the first count says nothing");
        assert_eq!(gripper.take(7, true, Some(850.0)), None);
        assert_eq!(gripper.take(8, true, Some(850.0)), Some(-10.0));
        // It holds something thick: closed all the same.
        assert_eq!(gripper.take(9, true, Some(700.0)), Some(850.0));
        // A message was lost, not the request in it.
        assert_eq!(gripper.take(12, true, Some(850.0)), Some(-10.0));
    }

    #[test]
    fn a_request_while_stopped_is_spent_and_leaves_nothing_at_odds() {
        let mut gripper = Gripper::new(&ArmSettings::default());
        gripper.take(0, false, Some(850.0));
        assert_eq!(gripper.take(1, false, Some(850.0)), None);
        assert_eq!(gripper.take(1, true, Some(850.0)), None, "it is not made up for");
        assert_eq!(gripper.take(2, true, Some(850.0)), Some(-10.0), "it still was open");
    }

    #[test]
    fn at_the_start_and_after_a_stop_what_it_reports_counts() {
        let mut gripper = Gripper::new(&ArmSettings::default());
        gripper.take(0, true, None);
        assert_eq!(gripper.take(1, true, None), None, "nobody knows where it stands");
        assert_eq!(gripper.take(2, true, Some(-10.0)), Some(850.0), "it was closed from the beginning");
        gripper.stopped();
        assert_eq!(gripper.take(3, true, Some(400.0)), Some(850.0), "stopped on its way, it opens");
    }
}
