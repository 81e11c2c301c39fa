//! Settings of the decision stage.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::GestureSet;
use crate::belief::EvidenceSettings;
use crate::map::{Action, InvalidModes, Mode, Motion, check_modes};

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
    /// Windows that vote in the paper's strategies, the current one included.
    pub vote_windows: usize,
    /// Grips in a row that toggle the gripper, in the paper's strategies.
    pub grip_windows: u32,
    /// Shortest time between two toggles of the gripper, in s.
    pub grip_interval_s: f64,
    /// When a gesture of the gripper is held for so long, it changes the mode instead, in s; without it, it never does.
    pub long_grip_s: Option<f64>,
    /// Highest speed of the arm along an axis while a gesture is held, in mm/s.
    pub speed_mm_per_s: f64,
    /// Highest speed of the arm about an axis, in degrees/s.
    pub rotation_speed_deg_per_s: f64,
    /// How fast the arm moves while a gesture is held.
    pub speed_control: SpeedControl,
    /// Efforts below this, as a share of a comfortable contraction, do not move the arm.
    pub effort_dead_zone: f64,
    /// When a gesture of a person is clear enough, for the strategy `personal`.
    pub evidence: EvidenceSettings,
    /// What gestures do, one table a mode. The first is on when a session begins.
    pub modes: Vec<Mode>,
}

/// How fast the arm moves while a gesture is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum SpeedControl {
    /// At the set speed.
    Constant,
    /// The harder the contraction, the faster, up to the set speed at a comfortable one. A model that tells nothing of effort
    /// moves the arm at the set speed.
    Proportional,
}

impl Default for DecisionSettings {
    fn default() -> Self {
        DecisionSettings {
            gestures: GestureSet::default(),
            strategy: Strategy::Threshold,
            vote_windows: 3,
            grip_windows: 3,
            grip_interval_s: 2.0,
            long_grip_s: None,
            speed_mm_per_s: 50.0,
            rotation_speed_deg_per_s: 20.0,
            speed_control: SpeedControl::Proportional,
            effort_dead_zone: 0.1,
            evidence: EvidenceSettings::default(),
            modes: vec![Mode::default()],
        }
    }
}

/// A setting of the decision stage that cannot work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum InvalidDecisionSetting {
    /// A number out of its range.
    #[error("{setting} = {value}: {remedy}")]
    Number {
        /// Key of the setting.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What to do.
        remedy: &'static str,
    },
    /// What gestures do.
    #[error(transparent)]
    Modes(#[from] InvalidModes),
}

impl DecisionSettings {
    /// Checks the ranges.
    ///
    /// # Errors
    ///
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), InvalidDecisionSetting> {
        let invalid = |setting, value, remedy| Err(InvalidDecisionSetting::Number { setting, value, remedy });
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
        if let Some(long_grip_s) = self.long_grip_s.filter(|seconds| !(0.5..=60.0).contains(seconds)) {
            return invalid("long_grip_s", long_grip_s, "take 0.5 to 60 s");
        }
        if !(0.0..=180.0).contains(&self.rotation_speed_deg_per_s) {
            return invalid("rotation_speed_deg_per_s", self.rotation_speed_deg_per_s, "take 0 to 180 deg/s");
        }
        if !(0.0..=0.9).contains(&self.effort_dead_zone) {
            return invalid("effort_dead_zone", self.effort_dead_zone, "take 0 to 0.9");
        }
        self.evidence.check()?;
        Ok(check_modes(&self.modes, &self.gestures, self.long_grip_s.is_some())?)
    }

    /// The fastest motion along and about an axis that a gesture may ask for: mm/s, degrees/s.
    pub fn fastest(&self) -> (f64, f64) {
        let motions =
            self.modes.iter().flat_map(|mode| mode.actions.values()).filter_map(|action| match action {
                Action::Move(motion) => Some(motion),
                _ => None,
            });
        motions.fold((0.0, 0.0), |(along, about), motion| {
            let speed = self.speed_of(motion);
            if motion.direction.axis.is_rotation() {
                (along, speed.max(about))
            } else {
                (speed.max(along), about)
            }
        })
    }

    /// The highest speed of a motion: its own, or the one that all have. In mm/s, or degrees/s of a rotation.
    pub fn speed_of(&self, motion: &Motion) -> f64 {
        let of_all = match motion.direction.axis.is_rotation() {
            true => self.rotation_speed_deg_per_s,
            false => self.speed_mm_per_s,
        };
        motion.speed.unwrap_or(of_all)
    }
}

pub(crate) const MAXIMUM_VOTES: usize = 15;
const MAXIMUM_GRIPS: u32 = 100;
