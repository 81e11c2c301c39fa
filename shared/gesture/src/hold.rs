//! Gestures that are held act once: on the gripper, on the mode.
//!
//! ```text
//! grip  ────┌──────────┐────     the gripper moves once the grip is held long enough
//!           └ toggle               with long_grip_s: when the grip ends, or the mode changes once it is longer than that
//! ```

use crate::Gesture;
use crate::map::Action;
use crate::settings::{DecisionSettings, Strategy};

/// What a held gesture does now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Press {
    Nothing,
    TogglesGripper,
    ChangesMode,
}

/// What makes a gesture a held one.
#[derive(Clone, Copy, Debug)]
enum Rule {
    /// So many windows in a row; the gripper then moves again and again (the paper's rule).
    Windows(u32),
    /// So long, in ns; it acts again once something else was made for so long.
    Time { hold_ns: u64, release_ns: u64 },
}

/// The gesture that is held, and what it has led to.
#[derive(Clone, Debug)]
pub(crate) struct Hold {
    rule: Rule,
    gesture: Gesture,
    windows: u32,
    since_ns: u64,
    /// A gesture that has acted and was not let go since, and how long something else was made, ns.
    spent: Option<(Gesture, u64)>,
    /// When the last window was captured.
    before_ns: u64,
    toggled_ns: Option<u64>,
}

impl Hold {
    pub(crate) fn new(settings: &DecisionSettings) -> Hold {
        let rule = match settings.strategy {
            Strategy::Personal => Rule::Time {
                hold_ns: (settings.evidence.hold_ms * 1e6) as u64,
                release_ns: (settings.evidence.release_ms * 1e6) as u64,
            },
            Strategy::Threshold | Strategy::TwoStage | Strategy::Direct => {
                Rule::Windows(settings.grip_windows)
            }
        };
        Hold {
            rule,
            gesture: Gesture::REST,
            windows: 0,
            since_ns: 0,
            spent: None,
            before_ns: 0,
            toggled_ns: None,
        }
    }

    /// Windows are missing: nobody knows whether the gesture was held through them.
    pub(crate) fn restart(&mut self) {
        (self.gesture, self.windows) = (Gesture::REST, 0);
    }

    /// The gesture that is held does nothing more before it is let go.
    pub(crate) fn spend(&mut self) {
        self.spent = Some((self.gesture, 0));
    }

    /// Whether this gesture has acted and was not let go since.
    pub(crate) fn is_spent(&self, gesture: Gesture) -> bool {
        self.spent.is_some_and(|(spent, _)| spent == gesture)
    }

    /// Nobody knows what is made in this window: none is let go, and a held gesture begins anew. Where the length of a grip
    /// counts, it only waits: else doubt at its end would take the end away.
    pub(crate) fn doubt(&mut self, settings: &DecisionSettings, captured_ns: u64) {
        let elapsed_ns = captured_ns.saturating_sub(self.before_ns);
        self.before_ns = captured_ns;
        if settings.long_grip_s.is_some() {
            self.since_ns += elapsed_ns;
        } else {
            self.restart();
        }
    }

    /// Takes the gesture of a window; `action` says what a gesture does in the present mode.
    pub(crate) fn take(
        &mut self,
        settings: &DecisionSettings,
        action: impl Fn(Gesture) -> Action,
        gesture: Gesture,
        captured_ns: u64,
    ) -> Press {
        let was_spent = self.is_spent(self.gesture);
        self.let_go(gesture, captured_ns);
        if gesture == self.gesture {
            self.windows = self.windows.saturating_add(1);
        } else {
            let was_held = self.is_held(captured_ns) && !was_spent;
            let is_short_grip =
                settings.long_grip_s.is_some() && was_held && action(self.gesture) == Action::Gripper;
            (self.gesture, self.windows, self.since_ns) = (gesture, 1, captured_ns);
            if is_short_grip && self.toggles(settings, captured_ns) {
                return Press::TogglesGripper;
            }
        }
        if !self.is_held(captured_ns) || self.is_spent(gesture) {
            return Press::Nothing;
        }
        match (action(gesture), settings.long_grip_s) {
            (Action::NextMode, _) => self.changes_mode(),
            (Action::Gripper, Some(long_grip_s)) => {
                let held_ns = captured_ns.saturating_sub(self.since_ns);
                if held_ns as f64 * 1e-9 >= long_grip_s { self.changes_mode() } else { Press::Nothing }
            }
            (Action::Gripper, None) if self.toggles(settings, captured_ns) => {
                match self.rule {
                    Rule::Windows(_) => self.windows = 0,
                    Rule::Time { .. } => self.spent = Some((gesture, 0)),
                }
                Press::TogglesGripper
            }
            _ => Press::Nothing,
        }
    }

    /// Forgets that a gesture has acted once it was let go.
    fn let_go(&mut self, gesture: Gesture, captured_ns: u64) {
        // A time before the last one comes from a source that started anew.
        let elapsed_ns = captured_ns.saturating_sub(self.before_ns);
        self.before_ns = captured_ns;
        let release_ns = match self.rule {
            Rule::Windows(_) => 0,
            Rule::Time { release_ns, .. } => release_ns,
        };
        if let Some((spent, away_ns)) = &mut self.spent {
            *away_ns = if *spent == gesture { 0 } else { *away_ns + elapsed_ns };
            if *spent != gesture && *away_ns >= release_ns {
                self.spent = None;
            }
        }
    }

    fn is_held(&self, captured_ns: u64) -> bool {
        match self.rule {
            Rule::Windows(windows) => self.windows >= windows,
            Rule::Time { hold_ns, .. } => {
                self.windows > 0 && captured_ns.saturating_sub(self.since_ns) >= hold_ns
            }
        }
    }

    fn changes_mode(&mut self) -> Press {
        self.spend();
        Press::ChangesMode
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
