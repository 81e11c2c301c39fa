//! Scores of the task: as JSON with stable keys, and as lines for people.

use std::fmt;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::ZoneShape;

/// How one zone went. The *movement* lasts from the zone's appearance to the moment it was entered for good: the
/// dwelling that follows is a part of the completion, but not of the movement, since it takes everybody the same.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ZoneScore {
    /// Centre of the zone, mm.
    pub centre_mm: [f64; 3],
    /// Distance from where the arm was when the zone appeared to its centre, mm.
    pub distance_mm: f64,
    /// Index of difficulty log₂(D/W + 1) of that distance and the zone's width, bits: the Shannon form, as in
    /// ISO 9241-411.
    pub index_of_difficulty_bits: f64,
    /// Whether it was reached before its time was over.
    pub reached: bool,
    /// Appearance to the end of the dwelling, s; only of a zone that was reached.
    pub completion_time_s: Option<f64>,
    /// Appearance to the entry that it was reached with, s; only of a zone that was reached.
    pub movement_time_s: Option<f64>,
    /// Index of difficulty over movement time, bits/s; none where the arm was in the zone from the start.
    pub throughput_bits_per_s: Option<f64>,
    /// Length of the arm's way during the movement, mm; of a zone that was missed, until it vanished.
    pub path_length_mm: f64,
    /// Straight distance between the ends of the movement over the length of the way, 0 to 1; only of a zone that
    /// was reached by moving.
    pub path_efficiency: Option<f64>,
    /// How often the arm left the zone before it had dwelt in it.
    pub overshoots: u32,
}

/// Index of difficulty log₂(D/W + 1), bits (ISO 9241-411, with the nominal distance and width).
pub(crate) fn index_of_difficulty_bits(distance_mm: f64, width_mm: f64) -> f64 {
    (distance_mm / width_mm + 1.0).log2()
}

/// How the task went. The JSON keys are a contract with other programs. Means are over the zones reached and are
/// missing when there is none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskReport {
    /// `zones` or `paper-zones`.
    pub name: String,
    /// Who did it: `simulated`, or `person` where keys, a script or a recording said what to do.
    pub user: String,
    /// Seed of the zones.
    pub seed: u64,
    /// Shape of the zones.
    pub shape: ZoneShape,
    /// Width of the zones, mm.
    pub width_mm: f64,
    /// How long the arm had to be in a zone, s.
    pub dwell_s: f64,
    /// How long there was for each zone, s.
    pub timeout_s: f64,
    /// From the appearance of the first zone to the end, s.
    pub duration_s: f64,
    /// Zones reached.
    pub zones_reached: usize,
    /// Zones missed: their time was over. The zone that the end came upon counts as neither.
    pub zones_timed_out: usize,
    /// Mean completion time, dwelling included, s.
    pub mean_completion_time_s: Option<f64>,
    /// Mean movement time, dwelling left out, s.
    pub mean_movement_time_s: Option<f64>,
    /// Mean index of difficulty, bits.
    pub mean_index_of_difficulty_bits: Option<f64>,
    /// Mean over the zones of index of difficulty over movement time, bits/s. ISO 9241-411 asks for the effective
    /// width, from the scatter of end points; here it is the nominal one, as studies with dwelling have it.
    pub throughput_bits_per_s: Option<f64>,
    /// Mean path efficiency, 0 to 1. With one axis at a time, as the gestures have it, 0.71 to 1 can be had
    /// in a plane, 0.58 to 1 in space.
    pub mean_path_efficiency: Option<f64>,
    /// How often zones, reached or missed, were left before the dwelling was over.
    pub overshoots: u32,
    /// How often the arm left the workspace.
    pub box_violations: u32,
    /// How long it was outside, s.
    pub outside_box_s: f64,
    /// States of the arm that were lost, so that the task did not see them.
    pub states_lost: u64,
    /// Every zone, in the order in which they appeared.
    pub zones: Vec<ZoneScore>,
}

/// How the task stands while it goes on. The JSON keys are a contract with the page.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TaskStatus {
    /// `zones` or `paper-zones`.
    pub kind: &'static str,
    /// The zone there is; `None` before the first.
    pub zone: Option<ZoneStatus>,
    /// Zones reached so far.
    pub reached: usize,
    /// Zones reached and missed so far.
    pub trials: usize,
    /// How often zones were left before the dwelling was over, the one there is among them.
    pub overshoots: u32,
    /// Mean over the zones reached of index of difficulty over movement time, bits/s.
    pub throughput_bits_per_s: Option<f64>,
    /// How much of the dwelling in the zone there is is over, 0 to 1.
    pub dwell_share: f64,
}

/// A zone that is to be reached.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ZoneStatus {
    /// Its shape.
    pub shape: ZoneShape,
    /// Its centre, mm.
    pub center_mm: [f64; 3],
    /// Its width, mm.
    pub width_mm: f64,
}

impl TaskReport {
    /// Counts and means of `zones` in place of those there are.
    pub(crate) fn summarise(&mut self) {
        let zones = &self.zones;
        self.zones_reached = zones.iter().filter(|zone| zone.reached).count();
        self.zones_timed_out = zones.len() - self.zones_reached;
        self.overshoots = zones.iter().map(|zone| zone.overshoots).sum();
        let mean = |value: &dyn Fn(&ZoneScore) -> Option<f64>| {
            let values: Vec<f64> = zones.iter().filter(|zone| zone.reached).filter_map(value).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        self.mean_completion_time_s = mean(&|zone| zone.completion_time_s);
        self.mean_movement_time_s = mean(&|zone| zone.movement_time_s);
        self.mean_index_of_difficulty_bits = mean(&|zone| Some(zone.index_of_difficulty_bits));
        self.throughput_bits_per_s = mean(&|zone| zone.throughput_bits_per_s);
        self.mean_path_efficiency = mean(&|zone| zone.path_efficiency);
    }
}

impl fmt::Display for TaskReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TaskReport { name, user, zones_reached, zones_timed_out, duration_s, .. } = self;
        write!(
            out,
            "task {name}, {user} user  {zones_reached} zones reached in {duration_s:.0} s, {zones_timed_out} timed out"
        )?;
        if let (Some(completion_s), Some(movement_s)) =
            (self.mean_completion_time_s, self.mean_movement_time_s)
        {
            write!(out, ", completion time {completion_s:.2} s, of it movement {movement_s:.2} s")?;
        }
        write!(out, "\n  ")?;
        if let (Some(throughput), Some(difficulty)) =
            (self.throughput_bits_per_s, self.mean_index_of_difficulty_bits)
        {
            write!(out, "throughput {throughput:.3} bits/s (difficulty {difficulty:.2} bits), ")?;
        }
        if let Some(efficiency) = self.mean_path_efficiency {
            write!(out, "path efficiency {:.0} %, ", 100.0 * efficiency)?;
        }
        write!(out, "overshoots {}, box violations {}", self.overshoots, self.box_violations)?;
        if self.box_violations > 0 {
            write!(out, " ({:.1} s outside)", self.outside_box_s)?;
        }
        Ok(())
    }
}

/// A position as the report holds it.
pub(crate) fn components(position_mm: DVec3) -> [f64; 3] {
    position_mm.into()
}
