//! From the probabilities of a window to what the arm should do (paper sections "Muscle Activation Detection
//! Strategies" and "Simulations and Implementation on the Robotic Arm").

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::{Gesture, GestureSet};

/// How rest and movement are told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Strategy {
    /// Strategy (a): the activity detector separates rest from movement; the classifier only decides which of
    /// the five active gestures it is.
    Threshold,
    /// Strategy (b): a first classifier separates rest from movement, a second one decides which of the five
    /// active gestures it is. The activity detector is not used.
    #[value(alias = "two-stage")]
    TwoStage,
    /// Strategy (c): the classifier knows all six classes. The activity detector is not used.
    Direct,
    /// A recogniser that was calibrated to the person, who has gestures of their own, rest among them. The activity
    /// detector is not used.
    Personal,
}

impl Strategy {
    /// The paper's, in its order.
    pub const ALL: [Strategy; 3] = [Strategy::Threshold, Strategy::TwoStage, Strategy::Direct];

    /// The name used in configuration and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Strategy::Threshold => "threshold",
            Strategy::TwoStage => "two_stage",
            Strategy::Direct => "direct",
            Strategy::Personal => "personal",
        }
    }
}

/// Settings of the decision stage. The defaults are the paper's, except for the speed, which the paper does
/// not give.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DecisionSettings {
    /// The gestures of the session, rest first.
    pub gestures: GestureSet,
    /// How rest and movement are told apart.
    pub strategy: Strategy,
    /// Windows that vote, the current one included.
    pub vote_windows: usize,
    /// Grips in a row that toggle the gripper.
    pub grip_windows: u32,
    /// Shortest time between two toggles of the gripper, in s.
    pub grip_interval_s: f64,
    /// Speed of the arm while a gesture is held, in mm/s.
    pub speed_mm_per_s: f64,
}

impl Default for DecisionSettings {
    fn default() -> Self {
        DecisionSettings {
            gestures: GestureSet::default(),
            strategy: Strategy::Threshold,
            vote_windows: 3,
            grip_windows: 3,
            grip_interval_s: 2.0,
            speed_mm_per_s: 50.0,
        }
    }
}

/// A setting of the decision stage that cannot work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{setting} = {value}: {remedy}")]
pub struct InvalidDecisionSetting {
    /// Key of the setting.
    pub setting: &'static str,
    /// Its value.
    pub value: f64,
    /// What to do.
    pub remedy: &'static str,
}

impl DecisionSettings {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), InvalidDecisionSetting> {
        let invalid = |setting, value, remedy| Err(InvalidDecisionSetting { setting, value, remedy });
        if !(1..=MAXIMUM_VOTES).contains(&self.vote_windows) {
            return invalid("vote_windows", self.vote_windows as f64, "take 1 to 15 windows");
        }
        if !(1..=MAXIMUM_GRIPS).contains(&self.grip_windows) {
            return invalid("grip_windows", f64::from(self.grip_windows), "take 1 to 100 windows");
        }
        if !(0.0..=60.0).contains(&self.grip_interval_s) {
            return invalid("grip_interval_s", self.grip_interval_s, "take 0 to 60 s");
        }
        if !(0.0..=1000.0).contains(&self.speed_mm_per_s) {
            return invalid("speed_mm_per_s", self.speed_mm_per_s, "take 0 to 1000 mm/s");
        }
        Ok(())
    }
}

const MAXIMUM_VOTES: usize = 15;
const MAXIMUM_GRIPS: u32 = 100;

/// What is known of a window when the decision is made.
#[derive(Clone, Copy, Debug)]
pub struct Evidence<'a> {
    /// Probability of every gesture of the session, by class number.
    pub probabilities: &'a [f32],
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
    /// The gesture acted on, after the vote.
    pub voted: Gesture,
    /// Linear velocity in the arm's base frame, mm/s along x, y, z.
    pub velocity_mm_per_s: [f64; 3],
    /// Whether to toggle the gripper. Only the robot knows whether that means open or close.
    pub toggles_gripper: bool,
}

/// The decision stage: remembers the last votes and when the gripper was last toggled.
#[derive(Clone, Debug)]
pub struct Decider {
    settings: DecisionSettings,
    votes: [Gesture; MAXIMUM_VOTES],
    next_vote: usize,
    grips_in_a_row: u32,
    toggled_ns: Option<u64>,
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
            settings: settings.clone(),
            votes: [Gesture::REST; MAXIMUM_VOTES],
            next_vote: 0,
            grips_in_a_row: 0,
            toggled_ns: None,
        })
    }

    /// Decides on the next window.
    pub fn decide(&mut self, evidence: &Evidence<'_>) -> Decision {
        let (gesture, confidence) = self.recognise(evidence);
        self.votes[self.next_vote] = gesture;
        self.next_vote = (self.next_vote + 1) % self.settings.vote_windows;
        let voted = majority(&self.settings.gestures, &self.votes[..self.settings.vote_windows]);
        self.grips_in_a_row = if gesture == Gesture::GRIP { self.grips_in_a_row + 1 } else { 0 };
        Decision {
            gesture,
            confidence,
            voted,
            velocity_mm_per_s: direction(voted).map(|axis| axis * self.settings.speed_mm_per_s),
            toggles_gripper: self.toggles_gripper(evidence.captured_ns),
        }
    }

    /// Discards the votes: windows are missing, so the last ones say nothing about the present.
    pub fn restart(&mut self) {
        self.votes = [Gesture::REST; MAXIMUM_VOTES];
        self.grips_in_a_row = 0;
    }

    fn recognise(&self, evidence: &Evidence<'_>) -> (Gesture, f32) {
        let finite = evidence.probabilities.iter().all(|probability| probability.is_finite());
        if !evidence.intact || !finite {
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

    fn toggles_gripper(&mut self, captured_ns: u64) -> bool {
        let interval_ns = (self.settings.grip_interval_s * 1e9) as u64;
        // A time before the last toggle comes from a source that started anew.
        let elapsed_ns = self.toggled_ns.and_then(|toggled_ns| captured_ns.checked_sub(toggled_ns));
        let too_soon = elapsed_ns.is_some_and(|elapsed_ns| elapsed_ns < interval_ns);
        if self.grips_in_a_row < self.settings.grip_windows || too_soon {
            return false;
        }
        self.grips_in_a_row = 0;
        self.toggled_ns = Some(captured_ns);
        true
    }
}

/// The gesture with more than half of the votes. Rest without such a majority, because an arm that waits does
/// less harm than one that guesses.
fn majority(gestures: &GestureSet, votes: &[Gesture]) -> Gesture {
    gestures
        .iter()
        .find(|gesture| 2 * votes.iter().filter(|vote| *vote == gesture).count() > votes.len())
        .unwrap_or(Gesture::REST)
}

/// Direction of motion in the arm's base frame (the paper's table of gestures).
fn direction(gesture: Gesture) -> [f64; 3] {
    match gesture {
        Gesture::EXTENSION => [0.0, 0.0, 1.0],
        Gesture::FLEXION => [0.0, 0.0, -1.0],
        Gesture::ULNAR => [0.0, 1.0, 0.0],
        Gesture::RADIAL => [0.0, -1.0, 0.0],
        _ => [0.0, 0.0, 0.0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::{any, prop, prop_assert, proptest};

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
            assert_eq!(decisions[1].velocity_mm_per_s, velocity);
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
        let evidence = Evidence { probabilities: &grip, moving: true, intact: true, captured_ns: later };
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
    fn damaged_windows_are_rest() {
        for (probabilities, intact) in [(certain(Gesture::ULNAR), false), ([f32::NAN; 6], true)] {
            let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
            for _ in 0..5 {
                let evidence =
                    Evidence { probabilities: &probabilities, moving: true, intact, captured_ns: 0 };
                assert_eq!(decider.decide(&evidence).gesture, Gesture::REST);
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

    proptest! {
        #[test]
        fn the_arm_moves_only_with_two_of_three_windows_and_never_faster_than_set(windows in gestures()) {
            let mut decider = Decider::new(&DecisionSettings::default()).unwrap();
            let decisions = decide_all(&mut decider, &windows);
            for (index, decision) in decisions.iter().enumerate() {
                let speed = decision.velocity_mm_per_s.iter().map(|v| v * v).sum::<f64>().sqrt();
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
