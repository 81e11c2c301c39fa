//! From what was recognised in a window to what the arm should do (paper sections "Muscle Activation Detection
//! Strategies" and "Simulations and Implementation on the Robotic Arm").
//!
//! ```text
//! probabilities, activity ─▶ strategy ─▶ gesture ─▶ vote ─┬─▶ mode ─▶ direction ─┬─▶ twist
//! efforts ────────────────────────────────────────────────┼──────────▶ speed ────┘
//!                                                         └─▶ held? ─▶ gripper, next mode
//! ```
//!
//! With a person, evidence summed over windows takes the place of the vote.

use crate::belief::{Belief, Believer};
use crate::hold::{Hold, Press};
use crate::map::{Action, Frame};
use crate::settings::{DecisionSettings, InvalidDecisionSetting, SpeedControl, Strategy};
use crate::vote::Votes;
use crate::{Gesture, GestureSet};

/// Lead from which on a gesture moves the arm at full speed: odds of 7 to 1.
const CERTAIN_LEAD: f64 = 2.0;

/// What is known of a window when the decision is made.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// Probability of every gesture of the session, by class number.
    pub probabilities: &'a [f32],
    /// How hard the contraction is if it is that gesture, by class number: 0 at rest, 1 at a comfortable contraction or above.
    pub efforts: &'a [f32],
    /// How strange the window is: above 1, it is unlike all gestures of the calibration, or an electrode is off.
    pub novelty: f32,
    /// The activity detector says that the muscles are active.
    pub moving: bool,
    /// The window is intact: none of its samples had to be replaced.
    pub intact: bool,
    /// When the window was captured, in ns of any steady clock.
    pub captured_ns: u64,
}

/// What follows from a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// This window's gesture, before the vote.
    pub gesture: Gesture,
    /// Its probability; 1 if no classifier was asked.
    pub confidence: f32,
    /// The gesture acted on, after the vote, or by the evidence so far.
    pub voted: Gesture,
    /// It is not clear which gesture is made, and the arm rests for that. It is no rest of the person: their rest is clear.
    pub is_unsure: bool,
    /// Velocity along (mm/s) and about (rad/s) the axes x, y, z of `frame`.
    pub twist: [f64; 6],
    /// Whose axes.
    pub frame: Frame,
    /// Whether to toggle the gripper. Only the robot knows whether that means open or close.
    pub toggles_gripper: bool,
    /// The mode that is on, by its place in the settings; after a change, the new one.
    pub mode: usize,
}

/// The decision stage: remembers the last votes, the mode, and when the gripper was last toggled.
#[derive(Clone, Debug)]
pub struct Decider {
    settings: DecisionSettings,
    votes: Votes,
    believer: Believer,
    hold: Hold,
    mode: usize,
}

impl Decider {
    /// A decider at rest.
    ///
    /// # Errors
    ///
    /// [`InvalidDecisionSetting`] as [`DecisionSettings::check`].
    pub fn new(settings: &DecisionSettings) -> Result<Decider, InvalidDecisionSetting> {
        settings.check()?;
        Ok(Decider {
            votes: Votes::new(settings.vote_windows),
            believer: Believer::new(settings.evidence),
            settings: settings.clone(),
            hold: Hold::new(settings),
            mode: 0,
        })
    }

    /// Decides on the next window.
    pub fn decide(&mut self, evidence: &Evidence<'_>) -> Decision {
        let (gesture, confidence) = self.recognise(evidence);
        let (voted, held) = match self.settings.strategy {
            Strategy::Personal => match self.believe(evidence) {
                Belief::Clear(gesture) => (gesture, Some(gesture)),
                Belief::Unsure => (Gesture::REST, None),
            },
            Strategy::Threshold | Strategy::TwoStage | Strategy::Direct => {
                let voted = self.votes.cast(&self.settings.gestures, gesture);
                (voted, self.is_usable(evidence).then_some(gesture))
            }
        };
        let press = self.press(held, evidence.captured_ns);
        if press == Press::ChangesMode {
            self.mode = (self.mode + 1) % self.settings.modes.len();
        }
        let effort =
            self.settings.gestures.number(voted).map_or(0.0, |number| {
                evidence.efforts.get(usize::from(number)).copied().unwrap_or(0.0).into()
            });
        let (twist, frame) = self.motion(voted, effort);
        Decision {
            gesture,
            confidence,
            voted,
            is_unsure: held.is_none(),
            twist,
            frame,
            toggles_gripper: press == Press::TogglesGripper,
            mode: self.mode,
        }
    }

    /// Takes the mode at this place, if there is one. What was made before says nothing about now, and a gesture that is still
    /// held does nothing in the new mode before it is let go: nobody means it for that.
    pub fn take_mode(&mut self, mode: usize) {
        if mode == self.mode || mode >= self.settings.modes.len() {
            return;
        }
        self.mode = mode;
        self.hold.spend();
        self.restart();
    }

    /// Discards what the last windows said: windows are missing, so they say nothing about the present. The mode stays.
    pub fn restart(&mut self) {
        self.votes = Votes::new(self.settings.vote_windows);
        self.believer = Believer::new(self.settings.evidence);
        self.hold.restart();
    }

    /// The gestures among which it decides.
    pub fn gestures(&self) -> &GestureSet {
        &self.settings.gestures
    }

    /// What a gesture does once it is held; `None` where it is not clear which one is made.
    fn press(&mut self, gesture: Option<Gesture>, captured_ns: u64) -> Press {
        let Some(gesture) = gesture else {
            self.hold.doubt(&self.settings, captured_ns);
            return Press::Nothing;
        };
        let mode = &self.settings.modes[self.mode];
        let action = |gesture| mode.actions.get(&gesture).copied().unwrap_or(Action::Nothing);
        self.hold.take(&self.settings, action, gesture, captured_ns)
    }

    /// What the windows so far say together. A damaged window says nothing: the evidence begins anew after it.
    fn believe(&mut self, evidence: &Evidence<'_>) -> Belief {
        if !self.is_usable(evidence) {
            self.believer = Believer::new(self.settings.evidence);
            return Belief::Unsure;
        }
        self.believer.take(&self.settings.gestures, evidence)
    }

    /// Whether a window can say anything. With a person, a strange one is weighed among the others.
    fn is_usable(&self, evidence: &Evidence<'_>) -> bool {
        let is_known = self.settings.strategy == Strategy::Personal || evidence.novelty <= 1.0;
        is_known
            && evidence.intact
            && evidence.probabilities.iter().all(|probability| probability.is_finite())
    }

    fn recognise(&self, evidence: &Evidence<'_>) -> (Gesture, f32) {
        if !self.is_usable(evidence) {
            return (Gesture::REST, 1.0);
        }
        let first_candidate = match self.settings.strategy {
            Strategy::Threshold if !evidence.moving => return (Gesture::REST, 1.0),
            Strategy::Threshold => 1,
            Strategy::TwoStage | Strategy::Direct | Strategy::Personal => 0,
        };
        self.settings
            .gestures
            .iter()
            .zip(evidence.probabilities.iter().copied())
            .skip(first_candidate)
            .max_by(|(_, left), (_, right)| left.total_cmp(right))
            .unwrap_or((Gesture::REST, 1.0))
    }

    /// Velocity that a gesture asks for in the present mode.
    fn motion(&self, gesture: Gesture, effort: f64) -> ([f64; 6], Frame) {
        let action = self.settings.modes[self.mode].actions.get(&gesture);
        let (Some(Action::Move(motion)), false) = (action, self.hold.is_spent(gesture)) else {
            return ([0.0; 6], Frame::Base);
        };
        let axis = motion.direction.axis;
        let speed = self.settings.speed_of(motion) * self.speed_share(effort) * self.certainty(gesture);
        let speed = if axis.is_rotation() { speed.to_radians() } else { speed };
        let mut twist = [0.0; 6];
        twist[axis.index()] = if motion.direction.is_negative { -speed } else { speed };
        (twist, motion.frame)
    }

    /// Share of the set speed for how clear a person's gesture is: wrong gestures lead by little.
    fn certainty(&self, gesture: Gesture) -> f64 {
        match (self.settings.strategy, self.settings.speed_control) {
            (Strategy::Personal, SpeedControl::Proportional) => {
                (self.believer.lead(&self.settings.gestures, gesture) / CERTAIN_LEAD).clamp(0.0, 1.0)
            }
            _ => 1.0,
        }
    }

    /// Share of the set speed: 0 within the dead zone, rising smoothly (3 x² - 2 x³) to 1 at a comfortable contraction.
    fn speed_share(&self, effort: f64) -> f64 {
        match self.settings.speed_control {
            SpeedControl::Constant => 1.0,
            SpeedControl::Proportional => {
                let dead_zone = self.settings.effort_dead_zone;
                // NaN, like everything below, is no effort.
                let above = ((effort - dead_zone) / (1.0 - dead_zone)).clamp(0.0, 1.0).max(0.0);
                above * above * (3.0 - 2.0 * above)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{any, prop, prop_assert, prop_assert_eq, proptest};

    const INCREMENT_NS: u64 = 75_000_000;

    fn certain(gesture: Gesture) -> [f32; 6] {
        let mut probabilities = [0.02; 6];
        probabilities[usize::from(gesture.paper_number().unwrap())] = 0.9;
        probabilities
    }

    fn decide_all(decider: &mut Decider, windows: &[(Gesture, bool)]) -> Vec<Decision> {
        let decide = |(index, (gesture, moving)): (usize, &(Gesture, bool))| {
            decider.decide(&Evidence {
                probabilities: &certain(*gesture),
                efforts: &[1.0; 6],
                novelty: 0.0,
                moving: *moving,
                intact: true,
                captured_ns: index as u64 * INCREMENT_NS,
            })
        };
        windows.iter().enumerate().map(decide).collect()
    }

    /// The windows that toggle the gripper.
    fn toggles(decisions: &[Decision]) -> Vec<usize> {
        (0..decisions.len()).filter(|&window| decisions[window].toggles_gripper).collect()
    }

    #[test]
    fn gestures_move_the_arm_as_the_paper_says() {
        for (gesture, velocity) in [
            (Gesture::EXTENSION, [0.0, 0.0, 50.0]),
            (Gesture::FLEXION, [0.0, 0.0, -50.0]),
            (Gesture::ULNAR, [0.0, 50.0, 0.0]),
            (Gesture::RADIAL, [0.0, -50.0, 0.0]),
            (Gesture::GRIP, [0.0, 0.0, 0.0]),
        ] {
            let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
            let decisions = decide_all(&mut decider, &[(gesture, true); 2]);
            assert_eq!(decisions[0].voted, Gesture::REST, "one vote of three is no majority");
            assert_eq!(decisions[1].voted, gesture);
            assert_eq!(decisions[1].twist[..3], velocity);
        }
    }

    #[test]
    fn three_grips_toggle_the_gripper_but_not_twice_within_two_seconds() {
        let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
        let decisions = decide_all(&mut decider, &[(Gesture::GRIP, true); 60]);
        // 2 s are 26.7 increments: the next toggle comes with window 2 + 27.
        assert_eq!(toggles(&decisions), [2, 29, 56]);
    }

    #[test]
    fn a_source_that_begins_anew_does_not_keep_the_gripper_shut() {
        let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
        let later = 600_000_000_000;
        let grip = certain(Gesture::GRIP);
        let evidence = Evidence {
            probabilities: &grip,
            efforts: &[1.0; 6],
            novelty: 0.0,
            moving: true,
            intact: true,
            captured_ns: later,
        };
        assert!((0..3).any(|_| decider.decide(&evidence).toggles_gripper));
        decider.restart();
        let decisions = decide_all(&mut decider, &[(Gesture::GRIP, true); 3]);
        assert!(decisions[2].toggles_gripper);
    }

    #[test]
    fn a_broken_row_of_grips_toggles_nothing() {
        let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
        let windows = [Gesture::GRIP, Gesture::GRIP, Gesture::ULNAR, Gesture::GRIP, Gesture::GRIP];
        let decisions = decide_all(&mut decider, &windows.map(|gesture| (gesture, true)));
        assert!(toggles(&decisions).is_empty());
    }

    #[test]
    fn only_the_threshold_strategy_leaves_rest_to_the_activity_detector() {
        let threshold = DecisionSettings::default();
        let two_stage = DecisionSettings { strategy: Strategy::TwoStage, ..DecisionSettings::default() };
        let direct = DecisionSettings { strategy: Strategy::Direct, ..DecisionSettings::default() };
        for (settings, moving, expected) in [
            (&threshold, false, Gesture::REST),
            (&threshold, true, Gesture::GRIP),
            (&two_stage, false, Gesture::GRIP),
            (&direct, false, Gesture::GRIP),
        ] {
            let mut decider = Decider::new(settings).unwrap();
            let decisions = decide_all(&mut decider, &[(Gesture::GRIP, moving)]);
            assert_eq!(decisions[0].gesture, expected);
        }
        for settings in [&two_stage, &direct] {
            let mut decider = Decider::new(settings).unwrap();
            assert_eq!(decide_all(&mut decider, &[(Gesture::REST, true)])[0].gesture, Gesture::REST);
        }
    }

    #[test]
    fn damaged_and_strange_windows_hold_the_arm_still_and_are_no_rest_of_the_person() {
        let ulnar = certain(Gesture::ULNAR);
        for (probabilities, intact, novelty) in
            [(ulnar, false, 0.0), ([f32::NAN; 6], true, 0.0), (ulnar, true, 1.1), (ulnar, true, f32::NAN)]
        {
            let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
            for _ in 0..5 {
                let evidence = Evidence {
                    probabilities: &probabilities,
                    efforts: &[1.0; 6],
                    novelty,
                    moving: true,
                    intact,
                    captured_ns: 0,
                };
                let decision = decider.decide(&evidence);
                assert_eq!((decision.gesture, decision.is_unsure), (Gesture::REST, true));
            }
        }
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let error =
            Decider::new(&DecisionSettings { vote_windows: 0, ..DecisionSettings::default() }).unwrap_err();
        assert_eq!(error.to_string(), "vote_windows = 0: take 1 to 15 windows");
    }

    fn gestures() -> impl proptest::strategy::Strategy<Value = Vec<(Gesture, bool)>> {
        prop::collection::vec((prop::sample::select(Gesture::PAPER.to_vec()), any::<bool>()), 1..200)
    }

    /// A gesture held for so many windows, then another.
    fn held(decider: &mut Decider, row: &[(Gesture, usize)]) -> Vec<Decision> {
        let windows: Vec<(Gesture, bool)> =
            row.iter().flat_map(|(gesture, count)| std::iter::repeat_n((*gesture, true), *count)).collect();
        decide_all(decider, &windows)
    }

    fn settings(modes: &str) -> DecisionSettings {
        #[derive(serde::Deserialize)]
        struct File {
            modes: Vec<crate::Mode>,
        }
        let File { modes } = toml::from_str(modes).unwrap();
        DecisionSettings { strategy: Strategy::Direct, modes, ..DecisionSettings::default() }
    }

    const TWO_MODES: &str = "[[modes]]\nname = \"a\"\nextension = \"+z\"\ngrip = \"gripper\"\nradial = \"next_mode\"\n\
                             [[modes]]\nname = \"b\"\nextension = \"-pitch\"\nradial = \"+x\"\nulnar = \"next_mode\"\ngrip = \"gripper\"\n\
                             flexion = { motion = \"+z\", frame = \"tool\", speed_mm_per_s = 20.0 }\n";

    #[test]
    fn a_gesture_changes_the_mode_once_and_moves_nothing_before_it_was_let_go() {
        let mut decider = Decider::new(&settings(TWO_MODES)).unwrap();
        let decisions = held(&mut decider, &[(Gesture::EXTENSION, 3), (Gesture::RADIAL, 20)]);
        assert_eq!(decisions[2].twist, [0.0, 0.0, 50.0, 0.0, 0.0, 0.0]);
        assert_eq!(decisions.iter().map(|decision| decision.mode).max(), Some(1));
        assert!(decisions[6..].iter().all(|decision| decision.twist == [0.0; 6] && decision.mode == 1));
        let decisions =
            held(&mut decider, &[(Gesture::REST, 2), (Gesture::RADIAL, 2), (Gesture::EXTENSION, 2)]);
        assert_eq!(decisions[3].twist, [50.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(decisions[5].twist[4], -20_f64.to_radians());
        let decisions = held(&mut decider, &[(Gesture::FLEXION, 3), (Gesture::ULNAR, 4)]);
        assert_eq!((decisions[2].twist[2], decisions[2].frame), (20.0, Frame::Tool));
        assert_eq!(decisions[6].mode, 0, "after the last mode comes the first");
    }

    #[test]
    fn a_mode_that_is_ordered_is_taken_and_moves_nothing_before_the_gesture_was_let_go() {
        let mut decider = Decider::new(&settings(TWO_MODES)).unwrap();
        assert!(held(&mut decider, &[(Gesture::EXTENSION, 3)])[2].twist[2] > 0.0);
        // The one that is on, and one that there is not, change nothing.
        decider.take_mode(0);
        decider.take_mode(2);
        assert!(held(&mut decider, &[(Gesture::EXTENSION, 1)])[0].twist[2] > 0.0);
        decider.take_mode(1);
        let still_held = held(&mut decider, &[(Gesture::EXTENSION, 10)]);
        assert!(still_held.iter().all(|decision| decision.twist == [0.0; 6] && decision.mode == 1));
        let again = held(&mut decider, &[(Gesture::REST, 2), (Gesture::EXTENSION, 3)]);
        assert_eq!(again[4].twist[4], -20_f64.to_radians());
    }

    #[test]
    fn a_long_grip_changes_the_mode_and_a_short_one_moves_the_gripper_when_it_ends() {
        let settings = DecisionSettings { long_grip_s: Some(1.0), ..settings(TWO_MODES) };
        let mut decider = Decider::new(&settings).unwrap();
        let short = held(&mut decider, &[(Gesture::GRIP, 10), (Gesture::REST, 3)]);
        assert_eq!(toggles(&short), [10]);
        decider.restart();
        let long = held(&mut decider, &[(Gesture::GRIP, 40), (Gesture::REST, 3)]);
        assert!(toggles(&long).is_empty());
        // 1 s are 13.3 increments.
        assert_eq!(long.iter().position(|decision| decision.mode == 1), Some(14));
        assert_eq!(long[42].mode, 1);
    }

    #[test]
    fn windows_that_are_missing_end_no_grip() {
        let settings = DecisionSettings { long_grip_s: Some(1.0), ..settings(TWO_MODES) };
        let mut decider = Decider::new(&settings).unwrap();
        held(&mut decider, &[(Gesture::GRIP, 10)]);
        decider.restart();
        assert!(toggles(&held(&mut decider, &[(Gesture::REST, 3)])).is_empty());
    }

    /// A person's gestures, every 25 ms, with this novelty.
    fn personal(settings: &DecisionSettings, row: &[(Gesture, usize, f32)]) -> Vec<Decision> {
        let mut decider = Decider::new(settings).unwrap();
        let windows =
            row.iter().flat_map(|(gesture, count, novelty)| std::iter::repeat_n((gesture, novelty), *count));
        let decide = |(window, (gesture, novelty)): (usize, (&Gesture, &f32))| {
            decider.decide(&Evidence {
                probabilities: &certain(*gesture),
                efforts: &[0.0, 0.5, 1.0, 1.0, 1.0, 1.0],
                novelty: *novelty,
                moving: false,
                intact: true,
                captured_ns: window as u64 * 25_000_000,
            })
        };
        windows.enumerate().map(decide).collect()
    }

    #[test]
    fn a_person_moves_the_arm_by_evidence_and_effort_and_unsure_windows_hold_it_still() {
        let settings = DecisionSettings { strategy: Strategy::Personal, ..DecisionSettings::default() };
        let rows = [(Gesture::REST, 4, 0.5), (Gesture::FLEXION, 4, 0.5), (Gesture::FLEXION, 2, 2.0)];
        let decisions = personal(&settings, &rows);
        assert!((-50.0..-40.0).contains(&decisions[5].twist[2]), "{:?}", decisions[5].twist);
        assert_eq!(decisions[7].twist[2], -50.0);
        assert!(decisions[8..].iter().all(|decision| decision.is_unsure && decision.twist == [0.0; 6]));
        let light = personal(&settings, &[(Gesture::REST, 4, 0.5), (Gesture::EXTENSION, 4, 0.5)]);
        assert!((10.0..30.0).contains(&light[7].twist[2]), "{:?}", light[7].twist);
        let constant = DecisionSettings { speed_control: SpeedControl::Constant, ..settings };
        let light = personal(&constant, &[(Gesture::REST, 4, 0.5), (Gesture::EXTENSION, 4, 0.5)]);
        assert_eq!(light[7].twist[2], 50.0);
    }

    #[test]
    fn a_persons_grip_moves_the_gripper_once_it_was_held_and_again_once_it_was_let_go() {
        let settings = DecisionSettings { strategy: Strategy::Personal, ..DecisionSettings::default() };
        let rows = [(Gesture::REST, 4, 0.5), (Gesture::GRIP, 200, 0.5)];
        let toggled = toggles(&personal(&settings, &rows));
        assert_eq!(toggled.len(), 1, "{toggled:?}");
        assert!((16..20).contains(&toggled[0]), "{toggled:?}");
        let rows = [rows[0], (Gesture::GRIP, 90, 0.5), (Gesture::REST, 20, 0.5), (Gesture::GRIP, 20, 0.5)];
        assert_eq!(toggles(&personal(&settings, &rows)).len(), 2);
        // A window of doubt in the middle lets go of nothing.
        let rows = [rows[0], (Gesture::GRIP, 90, 0.5), (Gesture::GRIP, 1, 3.0), (Gesture::GRIP, 90, 0.5)];
        assert_eq!(toggles(&personal(&settings, &rows)).len(), 1);
    }

    proptest! {
        #[test]
        fn the_harder_the_contraction_the_faster_and_never_faster_than_set(
            weak in -0.5_f64..1.5,
            strong in -0.5_f64..1.5,
            dead_zone in 0.0..0.9_f64,
        ) {
            let settings = DecisionSettings { effort_dead_zone: dead_zone, ..DecisionSettings::default() };
            let decider = Decider::new(&settings).unwrap();
            let (slow, fast) = (decider.speed_share(weak.min(strong)), decider.speed_share(weak.max(strong)));
            prop_assert!((0.0..=1.0).contains(&slow) && slow <= fast && fast <= 1.0);
            prop_assert!(weak > dead_zone || decider.speed_share(weak) == 0.0);
            prop_assert_eq!(decider.speed_share(1.0), 1.0);
            prop_assert_eq!(decider.speed_share(f64::NAN), 0.0);
        }

        #[test]
        fn the_arm_moves_only_with_two_of_three_windows_and_never_faster_than_set(windows in gestures()) {
            let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
            let decisions = decide_all(&mut decider, &windows);
            for (index, decision) in decisions.iter().enumerate() {
                let speed = decision.twist.iter().map(|v| v * v).sum::<f64>().sqrt();
                prop_assert!(speed <= 50.0);
                let recent = &decisions[index.saturating_sub(2)..=index];
                let agreeing = recent.iter().filter(|other| other.gesture == decision.voted).count();
                prop_assert!(decision.voted == Gesture::REST || agreeing >= 2);
            }
        }

        #[test]
        fn gripper_toggles_are_two_seconds_apart(windows in gestures()) {
            let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
            let toggles = toggles(&decide_all(&mut decider, &windows));
            prop_assert!(toggles.windows(2).all(|pair| (pair[1] - pair[0]) as u64 * INCREMENT_NS >= 2_000_000_000));
        }
    }
}
