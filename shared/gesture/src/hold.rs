//! Gestures that are held act once: on the gripper, on the mode.
//!
//! ```text
//! grip  ────┌──────────┐────     the gripper moves after grip_windows
//!           └ toggle               with long_grip_s: when the grip ends, or the mode changes once it is long enough
//! ```

use crate::Gesture;
use crate::map::Action;
use crate::settings::DecisionSettings;

/// What a held gesture does now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Press {
    Nothing,
    TogglesGripper,
    ChangesMode,
}

/// The gesture that is held, and what it has led to.
#[derive(Clone, Debug)]
pub(crate) struct Hold {
    gesture: Gesture,
    windows: u32,
    since_ns: u64,
    /// It has changed the mode: what it would do in the new one waits until it was let go.
    has_changed_mode: bool,
    toggled_ns: Option<u64>,
}

impl Hold {
    pub(crate) fn new() -> Hold {
        Hold { gesture: Gesture::REST, windows: 0, since_ns: 0, has_changed_mode: false, toggled_ns: None }
    }

    /// Windows are missing: nobody knows whether the gesture was held through them.
    pub(crate) fn restart(&mut self) {
        *self = Hold { toggled_ns: self.toggled_ns, ..Hold::new() };
    }

    /// Whether this gesture still is the one that has changed the mode.
    pub(crate) fn is_spent(&self, gesture: Gesture) -> bool {
        self.has_changed_mode && self.gesture == gesture
    }

    /// Takes the gesture of a window; `action` says what a gesture does in the present mode.
    pub(crate) fn take(
        &mut self,
        settings: &DecisionSettings,
        action: impl Fn(Gesture) -> Action,
        gesture: Gesture,
        captured_ns: u64,
    ) -> Press {
        if gesture == self.gesture {
            self.windows = self.windows.saturating_add(1);
        } else {
            let released = self.clone();
            self.restart();
            (self.gesture, self.windows, self.since_ns) = (gesture, 1, captured_ns);
            let is_short_grip = settings.long_grip_s.is_some()
                && action(released.gesture) == Action::Gripper
                && released.windows >= settings.grip_windows
                && !released.has_changed_mode;
            if is_short_grip && self.toggles(settings, captured_ns) {
                return Press::TogglesGripper;
            }
        }
        let is_held = self.windows >= settings.grip_windows;
        match (action(gesture), settings.long_grip_s) {
            (Action::NextMode, _) if is_held && !self.has_changed_mode => {
                self.has_changed_mode = true;
                Press::ChangesMode
            }
            (Action::Gripper, Some(long_grip_s)) if !self.has_changed_mode => {
                let held_ns = captured_ns.saturating_sub(self.since_ns);
                if is_held && held_ns as f64 * 1e-9 >= long_grip_s {
                    self.has_changed_mode = true;
                    return Press::ChangesMode;
                }
                Press::Nothing
            }
            (Action::Gripper, None) if is_held && self.toggles(settings, captured_ns) => {
                self.windows = 0;
                Press::TogglesGripper
            }
            _ => Press::Nothing,
        }
    }

    /// Toggles the gripper unless it is too soon after the last time.
    fn toggles(&mut self, settings: &DecisionSettings, captured_ns: u64) -> bool {
        let interval_ns = (settings.grip_interval_s * 1e9) as u64;
        // A time before the last toggle comes from a source that started anew.
        let elapsed_ns = self.toggled_ns.and_then(|toggled_ns| captured_ns.checked_sub(toggled_ns));
        if elapsed_ns.is_some_and(|elapsed_ns| elapsed_ns < interval_ns) {
            return false;
        }
        self.toggled_ns = Some(captured_ns);
        true
    }
}
