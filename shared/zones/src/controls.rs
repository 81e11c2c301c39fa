//! What gestures do to the arm's position, mode by mode: what a user has to know to steer it into zones.
//!
//! ```text
//! mode "y-z":  extension +z   flexion -z   ulnar +y   radial -y ┐ fist: the next mode
//! mode "x":    extension +x   flexion -x  ◀─────────────────────┘ fist: the next mode, the first again
//! ```
//!
//! Zones lie along the axes that the modes move the arm along both ways: along others, nobody could mend an overshoot.
//! Only motions in the base frame count. Motions in the tool frame and rotations are for other work.

use glam::DVec3;
use tendon_gesture::{Action, DecisionSettings, Frame, Gesture, Mode, SpeedControl, Strategy};

/// What gestures do to the arm's position.
#[derive(Clone, Debug, PartialEq)]
pub struct Controls {
    /// In the order of the settings. Never empty.
    modes: Vec<ModeControls>,
    axes: [bool; 3],
    /// Where effort sets the speed: the effort below which it moves nothing.
    effort_dead_zone: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
struct ModeControls {
    moves: Vec<Move>,
    change: Option<ModeChange>,
    /// Gestures that may be made by mistake: they lead nowhere that the moves do not lead back from.
    slips: Vec<Gesture>,
}

/// A gesture that moves the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Move {
    pub(crate) gesture: Gesture,
    /// Where to, along an axis of the base.
    pub(crate) direction: DVec3,
    /// The highest speed.
    pub(crate) speed_mm_per_s: f64,
}

/// A gesture that changes the mode once it was held.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ModeChange {
    pub(crate) gesture: Gesture,
    /// How long it has to be held at least, s.
    pub(crate) hold_s: f64,
}

/// What to do next on the way to a zone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Step {
    /// Move, with so much missing, mm.
    Move(Move, f64),
    /// What is missing needs another mode.
    Change(ModeChange),
}

impl Step {
    pub(crate) fn gesture(&self) -> Gesture {
        match self {
            Step::Move(planned, _) => planned.gesture,
            Step::Change(change) => change.gesture,
        }
    }
}

/// No gesture leads to a zone.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "[[decision.modes]]: no mode moves the arm both ways along an axis of its base, so that no zone could be reached: \
     give two gestures +y and -y, for instance"
)]
pub struct NothingMoves;

impl Controls {
    /// Those of a session with these settings.
    ///
    /// # Errors
    ///
    /// [`NothingMoves`] if the gestures do not move the arm both ways along any axis.
    pub fn new(settings: &DecisionSettings) -> Result<Controls, NothingMoves> {
        let of_mode = |mode| moves(mode, settings);
        let all: Vec<Move> = settings.modes.iter().flat_map(of_mode).collect();
        let leads = |direction| all.iter().any(|one| one.direction == direction);
        let axes = DVec3::AXES.map(|axis| leads(axis) && leads(-axis));
        if axes == [false; 3] {
            return Err(NothingMoves);
        }
        let modes = settings.modes.iter().map(|mode| ModeControls::new(mode, settings, axes)).collect();
        // Networks tell nothing of effort.
        let effort_matters =
            settings.speed_control == SpeedControl::Proportional && settings.strategy == Strategy::Personal;
        let effort_dead_zone = effort_matters.then_some(settings.effort_dead_zone);
        Ok(Controls { modes, axes, effort_dead_zone })
    }

    /// Whether zones may lie along x, y, z.
    pub fn axes(&self) -> [bool; 3] {
        self.axes
    }

    /// Whether a light contraction moves the arm slowly.
    pub(crate) fn effort_matters(&self) -> bool {
        self.effort_dead_zone.is_some()
    }

    /// The effort that moves the arm at this share of its highest speed: x with 3 x² - 2 x³ = share, beyond the dead zone.
    /// Where effort does not matter, a comfortable contraction.
    pub(crate) fn effort(&self, share: f64) -> f64 {
        self.effort_dead_zone.map_or(1.0, |dead_zone| {
            let above = 0.5 - ((1.0 - 2.0 * share.clamp(0.0, 1.0)).asin() / 3.0).sin();
            dead_zone + (1.0 - dead_zone) * above
        })
    }

    /// What to do in this mode with so much missing. Whatever this mode can do comes first, the axis on which most is missing
    /// before the others. What is missing by less than the tolerance is left as it is, unless nothing else is missing.
    pub(crate) fn next_step(&self, mode: usize, missing_mm: DVec3, tolerance_mm: f64) -> Option<Step> {
        let best = |mode: &ModeControls| {
            let steps = mode.moves.iter().map(|one| (*one, missing_mm.dot(one.direction)));
            // The first of equals.
            steps.reduce(|best, other| if other.1 > best.1 { other } else { best })
        };
        let present = self.modes.get(mode)?;
        let here = best(present);
        let needs_another_mode = here.is_none_or(|(_, missing_mm)| missing_mm <= tolerance_mm)
            && self.modes.iter().filter_map(best).any(|(_, missing_mm)| missing_mm > tolerance_mm);
        match (needs_another_mode, present.change) {
            (true, Some(change)) => Some(Step::Change(change)),
            _ => here.map(|(planned, missing_mm)| Step::Move(planned, missing_mm)),
        }
    }

    /// Gestures that may be made by mistake for the right one.
    pub(crate) fn slips(&self, mode: usize, right: Gesture) -> Vec<Gesture> {
        let slips = self.modes.get(mode).map_or(&[][..], |mode| &mode.slips);
        slips.iter().copied().filter(|gesture| *gesture != right).collect()
    }
}

impl ModeControls {
    fn new(mode: &Mode, settings: &DecisionSettings, axes: [bool; 3]) -> ModeControls {
        let leads_back = |one: &Move| {
            DVec3::AXES.iter().zip(axes).any(|(axis, both)| both && one.direction.abs() == *axis)
        };
        let moves: Vec<Move> = moves(mode, settings).into_iter().filter(leads_back).collect();
        let change = |(gesture, action): (&Gesture, &Action)| {
            let hold_s = match action {
                Action::NextMode => 0.0,
                Action::Gripper => settings.long_grip_s?,
                Action::Move(_) | Action::Nothing => return None,
            };
            Some(ModeChange { gesture: *gesture, hold_s })
        };
        let changes = mode.actions.iter().filter_map(change).filter(|_| settings.modes.len() > 1);
        let is_harmless = |gesture: &Gesture| match mode.actions.get(gesture) {
            Some(Action::Move(_)) => moves.iter().any(|one| one.gesture == *gesture),
            _ => *gesture != Gesture::REST,
        };
        ModeControls {
            slips: settings.gestures.iter().filter(is_harmless).collect(),
            change: changes.reduce(|one, other| if other.hold_s < one.hold_s { other } else { one }),
            moves,
        }
    }
}

/// The gestures that move the arm along an axis of the base.
fn moves(mode: &Mode, settings: &DecisionSettings) -> Vec<Move> {
    let along = |(gesture, action): (&Gesture, &Action)| match action {
        Action::Move(motion) if motion.frame == Frame::Base && !motion.direction.axis.is_rotation() => {
            let axis = DVec3::AXES[motion.direction.axis.index()];
            let direction = if motion.direction.is_negative { -axis } else { axis };
            let speed_mm_per_s = settings.speed_of(motion);
            (speed_mm_per_s > 0.0).then_some(Move { gesture: *gesture, direction, speed_mm_per_s })
        }
        _ => None,
    };
    mode.actions.iter().filter_map(along).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(modes: &str) -> DecisionSettings {
        toml::from_str(modes).unwrap()
    }

    const TWO_MODES: &str = "[[modes]]\nname = \"y-z\"\nextension = \"+z\"\nflexion = \"-z\"\nulnar = \"+y\"\n\
                             radial = \"-y\"\ngrip = \"next_mode\"\n[[modes]]\nname = \"x\"\n\
                             extension = { motion = \"+x\", speed_mm_per_s = 20.0 }\nflexion = \"-x\"\n\
                             ulnar = { motion = \"+z\", frame = \"tool\" }\nradial = \"+yaw\"\ngrip = \"next_mode\"\n";

    #[test]
    fn zones_lie_along_the_axes_that_gestures_move_along_both_ways() {
        let axes = |modes| Controls::new(&settings(modes)).map(|controls| controls.axes());
        assert_eq!(axes(""), Ok([false, true, true]));
        assert_eq!(axes(TWO_MODES), Ok([true, true, true]));
        let one_way = "[[modes]]\nname = \"a\"\nextension = \"+z\"\nflexion = \"-z\"\nulnar = \"+x\"\n";
        assert_eq!(axes(one_way), Ok([false, false, true]));
    }

    #[test]
    fn gestures_that_lead_to_no_zone_are_refused() {
        for modes in [
            "[[modes]]\nname = \"a\"\ngrip = \"gripper\"\n",
            "[[modes]]\nname = \"a\"\nextension = \"+z\"\n",
            "[[modes]]\nname = \"a\"\nextension = \"+yaw\"\nflexion = \"-yaw\"\n",
            "[[modes]]\nname = \"a\"\nextension = { motion = \"+z\", frame = \"tool\" }\nflexion = { motion = \"-z\", frame = \"tool\" }\n",
            "speed_mm_per_s = 0.0\n",
        ] {
            let error = Controls::new(&settings(modes)).unwrap_err().to_string();
            assert!(error.contains("no mode moves the arm both ways"), "{error}");
        }
    }

    #[test]
    fn what_the_mode_can_do_comes_first_and_then_it_is_changed() {
        let controls = Controls::new(&settings(TWO_MODES)).unwrap();
        let step = |mode, missing_mm| controls.next_step(mode, missing_mm, 10.0).unwrap();
        let Step::Move(planned, missing_mm) = step(0, DVec3::new(90.0, 30.0, -50.0)) else { panic!() };
        assert_eq!((planned.gesture, planned.direction, missing_mm), (Gesture::FLEXION, DVec3::NEG_Z, 50.0));
        assert_eq!(step(0, DVec3::new(90.0, 9.0, -9.0)).gesture(), Gesture::GRIP);
        let Step::Move(planned, _) = step(1, DVec3::new(90.0, 30.0, -50.0)) else { panic!() };
        assert_eq!((planned.gesture, planned.speed_mm_per_s), (Gesture::EXTENSION, 20.0));
        // Too little is missing to change the mode for: what is left here, is done.
        assert_eq!(step(0, DVec3::new(9.0, 2.0, 5.0)).gesture(), Gesture::EXTENSION);
    }

    #[test]
    fn effort_is_that_which_gives_the_speed_with_a_person_and_a_comfortable_one_without() {
        let person = |text: &str| {
            let settings = DecisionSettings { strategy: Strategy::Personal, ..settings(text) };
            Controls::new(&settings).unwrap()
        };
        for share in [0.0, 0.1, 0.5, 0.9, 1.0] {
            let above = (person("").effort(share) - 0.1) / 0.9;
            assert!((above * above * (3.0 - 2.0 * above) - share).abs() < 1e-9, "{share}");
        }
        assert_eq!(person("speed_control = \"constant\"").effort(0.1), 1.0);
        assert_eq!(Controls::new(&settings("")).unwrap().effort(0.1), 1.0);
    }

    #[test]
    fn a_long_grip_changes_the_mode_and_slips_lead_nowhere_without_a_way_back() {
        let modes = TWO_MODES.replace("next_mode", "gripper");
        let controls = Controls::new(&settings(&format!("long_grip_s = 1.5\n{modes}"))).unwrap();
        let step = controls.next_step(0, DVec3::X * 90.0, 10.0);
        assert_eq!(step, Some(Step::Change(ModeChange { gesture: Gesture::GRIP, hold_s: 1.5 })));
        // Ulnar and radial move the tool, which nothing would move back.
        assert_eq!(controls.slips(1, Gesture::GRIP), [Gesture::EXTENSION, Gesture::FLEXION]);
        assert_eq!(controls.slips(0, Gesture::GRIP).len(), 4);
    }
}
