//! Settings of the task, as `[task]` in a configuration holds them.

use serde::{Deserialize, Serialize};

use crate::ZoneShape;

/// What zones look like, where they appear, and when they count as reached.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TaskSettings {
    /// Shape of every zone. Default: sphere.
    pub shape: ZoneShape,
    /// Diameter of a sphere, edge of a cube, in mm: the W of Fitts' law. Default 40.
    pub width_mm: f64,
    /// How long without a break the arm has to be in a zone, in s; 0: a zone is reached once entered. Default
    /// 1: longer than the arm needs to cross a zone at its usual speed, so that passing through is not enough.
    pub dwell_s: f64,
    /// A zone that was not reached for so long, in s, is missed, and the next appears. Default 20.
    pub timeout_s: f64,
    /// Shortest and longest way from the centre of one zone to that of the next, in mm. Default 50 to 150.
    pub distance_mm: [f64; 2],
    /// Zones lie wholly within ± this of where the task began, along the axes that zones lie along, in mm. Default
    /// 180: the arm has 200 mm of straight way along y and z from its default start.
    pub reach_mm: f64,
    /// The same seed gives the same zones, however the arm moves, and the same simulated user. Default 0.
    pub seed: u64,
    /// The simulated user.
    pub user: UserSettings,
}

impl Default for TaskSettings {
    fn default() -> TaskSettings {
        TaskSettings {
            shape: ZoneShape::Sphere,
            width_mm: 40.0,
            dwell_s: 1.0,
            timeout_s: 20.0,
            distance_mm: [50.0, 150.0],
            reach_mm: 180.0,
            seed: 0,
            user: UserSettings::default(),
        }
    }
}

/// What the simulated user is like.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UserSettings {
    /// Median of the time from seeing to contracting a muscle, in ms; it is distributed log-normally. Default 250.
    pub reaction_ms: f64,
    /// Share of movements that begin with a wrong gesture, 0 to 1. Default 0.03.
    pub error_rate: f64,
}

impl Default for UserSettings {
    fn default() -> UserSettings {
        UserSettings { reaction_ms: 250.0, error_rate: 0.03 }
    }
}

/// A setting of the task that cannot work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{setting} = {value}: {remedy}")]
pub struct TaskSettingsError {
    /// Key of the setting.
    pub setting: &'static str,
    /// Its value.
    pub value: f64,
    /// What to do.
    pub remedy: &'static str,
}

impl TaskSettings {
    /// The same with the paper's zones: cubes that are reached once entered.
    pub fn as_in_the_paper(self) -> TaskSettings {
        TaskSettings { shape: ZoneShape::Cube, dwell_s: 0.0, ..self }
    }

    /// Checks the ranges. Whether there is room for the zones depends on where the task begins:
    /// [`Placement::new`](crate::Placement::new).
    ///
    /// # Errors
    ///
    /// The first setting that is out of its range.
    pub fn check(&self) -> Result<(), TaskSettingsError> {
        let [nearest_mm, farthest_mm] = self.distance_mm;
        let UserSettings { reaction_ms, error_rate } = self.user;
        for (setting, value, within, remedy) in [
            ("width_mm", self.width_mm, 1.0..=1000.0, "take 1 to 1000 mm"),
            ("dwell_s", self.dwell_s, 0.0..=60.0, "take 0 to 60 s"),
            ("timeout_s", self.timeout_s, 0.1..=3600.0, "take 0.1 to 3600 s"),
            ("distance_mm[0]", nearest_mm, 1.0..=1000.0, "take 1 to 1000 mm"),
            ("distance_mm[1]", farthest_mm, nearest_mm..=1000.0, "take distance_mm[0] to 1000 mm"),
            ("reach_mm", self.reach_mm, 1.0..=1000.0, "take 1 to 1000 mm"),
            ("user.reaction_ms", reaction_ms, 1.0..=10_000.0, "take 1 to 10000 ms"),
            ("user.error_rate", error_rate, 0.0..=1.0, "take 0 to 1"),
        ] {
            if !within.contains(&value) {
                return Err(TaskSettingsError { setting, value, remedy });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_sound_and_the_papers_zones_need_no_dwelling() {
        let settings = TaskSettings::default();
        assert_eq!(settings.check(), Ok(()));
        let paper = settings.as_in_the_paper();
        assert_eq!((paper.shape, paper.dwell_s), (ZoneShape::Cube, 0.0));
        assert_eq!(paper.check(), Ok(()));
    }

    #[test]
    fn values_out_of_range_are_named() {
        let check = |settings: TaskSettings| settings.check().unwrap_err().to_string();
        let swapped = TaskSettings { distance_mm: [100.0, 50.0], ..TaskSettings::default() };
        assert_eq!(check(swapped), "distance_mm[1] = 50: take distance_mm[0] to 1000 mm");
        let endless = TaskSettings { timeout_s: f64::NAN, ..TaskSettings::default() };
        assert!(check(endless).starts_with("timeout_s = NaN"));
        let user = UserSettings { error_rate: 1.5, ..UserSettings::default() };
        assert!(check(TaskSettings { user, ..TaskSettings::default() }).starts_with("user.error_rate = 1.5"));
    }
}
