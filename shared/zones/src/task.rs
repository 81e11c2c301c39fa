//! The task: which zone there is, and how it is going.
//!
//! ```text
//! appears ─▶ outside ──enter──▶ inside ──dwelt──▶ reached ─┬─▶ the next appears
//!               ▲  └────────────────│───time over▶ missed ─┘
//!               └───────leave───────┘ an overshoot
//! ```

use glam::DVec3;

use crate::report::{components, index_of_difficulty_bits};
use crate::{
    NoRoomForZones, Placement, TaskReport, TaskSettings, TaskStatus, Workspace, Zone, ZoneScore, ZoneStatus,
};

/// The trajectory keeps a position for about every mm of way.
const TRAJECTORY_STEP_MM: f64 = 1.0;

/// A task under way.
#[derive(Clone, Debug)]
pub struct ZoneTask {
    settings: TaskSettings,
    axes: [bool; 3],
    workspace: Workspace,
    placement: Placement,
    attempt: Attempt,
    scores: Vec<ZoneScore>,
    began_s: f64,
    now_s: f64,
    position_mm: DVec3,
    box_violations: u32,
    outside_box_s: f64,
    trajectory_mm: Vec<DVec3>,
}

/// What has been done about the zone there is.
#[derive(Clone, Debug)]
struct Attempt {
    zone: Zone,
    appeared_s: f64,
    start_mm: DVec3,
    path_length_mm: f64,
    /// While the arm is in the zone: how it came in.
    entry: Option<Entry>,
    overshoots: u32,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    time_s: f64,
    position_mm: DVec3,
    path_length_mm: f64,
}

impl ZoneTask {
    /// The task begins: the first zone appears. Zones lie along the axes x, y, z that are chosen. Times are on any clock that
    /// goes on steadily.
    ///
    /// # Errors
    ///
    /// [`NoRoomForZones`] around `position_mm`, where the arm is.
    pub fn new(
        settings: &TaskSettings,
        axes: [bool; 3],
        workspace: Workspace,
        time_s: f64,
        position_mm: DVec3,
    ) -> Result<ZoneTask, NoRoomForZones> {
        let mut placement = Placement::new(settings, axes, position_mm, &workspace)?;
        let attempt = Attempt::begin(placement.next_zone(), time_s, position_mm);
        Ok(ZoneTask {
            settings: settings.clone(),
            axes,
            workspace,
            placement,
            attempt,
            scores: Vec::new(),
            began_s: time_s,
            now_s: time_s,
            position_mm,
            box_violations: u32::from(!workspace.contains(position_mm)),
            outside_box_s: 0.0,
            trajectory_mm: vec![position_mm],
        })
    }

    /// The arm is at `position_mm` now. A position that is not finite is not looked at.
    pub fn observe(&mut self, time_s: f64, position_mm: DVec3) {
        if !position_mm.is_finite() {
            return;
        }
        self.watch_workspace(time_s, position_mm);
        self.attempt.path_length_mm += position_mm.distance(self.position_mm);
        (self.now_s, self.position_mm) = (time_s, position_mm);
        if self.trajectory_mm.last().is_none_or(|last| last.distance(position_mm) >= TRAJECTORY_STEP_MM) {
            self.trajectory_mm.push(position_mm);
        }
        if let Some(score) = self.attempt.observe(time_s, position_mm, &self.settings) {
            self.scores.push(score);
            self.attempt = Attempt::begin(self.placement.next_zone(), time_s, position_mm);
        }
    }

    fn watch_workspace(&mut self, time_s: f64, position_mm: DVec3) {
        if !self.workspace.contains(self.position_mm) {
            self.outside_box_s += time_s - self.now_s;
        } else if !self.workspace.contains(position_mm) {
            self.box_violations += 1;
        }
    }

    /// The zone there is.
    pub fn zone(&self) -> &Zone {
        &self.attempt.zone
    }

    /// The number of the zone there is, from 1.
    pub fn zone_number(&self) -> usize {
        self.scores.len() + 1
    }

    /// From the arm to the centre of the zone, mm.
    pub fn offset_mm(&self) -> DVec3 {
        self.attempt.zone.centre_mm - self.position_mm
    }

    /// Whether the arm is in the zone.
    pub fn is_inside(&self) -> bool {
        self.attempt.zone.contains(self.position_mm)
    }

    /// Whether zones lie along x, y, z.
    pub fn axes(&self) -> [bool; 3] {
        self.axes
    }

    /// The workspace that must not be left.
    pub fn workspace(&self) -> &Workspace {
        &self.workspace
    }

    /// Where the arm has been, about every mm.
    pub fn trajectory_mm(&self) -> &[DVec3] {
        &self.trajectory_mm
    }

    /// How the task stands. `kind` is as in [`TaskStatus`].
    pub(crate) fn status(&self, kind: &'static str) -> TaskStatus {
        let Zone { shape, centre_mm, width_mm } = self.attempt.zone;
        let dwelt_s = self.attempt.entry.map_or(0.0, |entry| self.now_s - entry.time_s);
        let dwell_s = self.settings.dwell_s;
        let throughputs: Vec<f64> =
            self.scores.iter().filter_map(|score| score.throughput_bits_per_s).collect();
        let is_known = !throughputs.is_empty();
        TaskStatus {
            kind,
            zone: Some(ZoneStatus { shape, center_mm: components(centre_mm), width_mm }),
            reached: self.scores.iter().filter(|score| score.reached).count(),
            trials: self.scores.len(),
            overshoots: self.scores.iter().map(|score| score.overshoots).sum::<u32>()
                + self.attempt.overshoots,
            throughput_bits_per_s: is_known
                .then(|| throughputs.iter().sum::<f64>() / throughputs.len() as f64),
            dwell_share: if dwell_s > 0.0 { (dwelt_s / dwell_s).min(1.0) } else { 0.0 },
        }
    }

    /// How the task has gone so far. `name`, `user` and `states_lost` are as in [`TaskReport`].
    pub fn report(&self, name: &str, user: &str, states_lost: u64) -> TaskReport {
        let settings = &self.settings;
        let mut report = TaskReport {
            name: name.to_owned(),
            user: user.to_owned(),
            seed: settings.seed,
            shape: settings.shape,
            width_mm: settings.width_mm,
            dwell_s: settings.dwell_s,
            timeout_s: settings.timeout_s,
            duration_s: self.now_s - self.began_s,
            zones_reached: 0,
            zones_timed_out: 0,
            mean_completion_time_s: None,
            mean_movement_time_s: None,
            mean_index_of_difficulty_bits: None,
            throughput_bits_per_s: None,
            mean_path_efficiency: None,
            overshoots: 0,
            box_violations: self.box_violations,
            outside_box_s: self.outside_box_s,
            states_lost,
            zones: self.scores.clone(),
        };
        report.summarise();
        report
    }
}

impl Attempt {
    fn begin(zone: Zone, time_s: f64, position_mm: DVec3) -> Attempt {
        let mut attempt = Attempt {
            zone,
            appeared_s: time_s,
            start_mm: position_mm,
            path_length_mm: 0.0,
            entry: None,
            overshoots: 0,
        };
        attempt.enter_or_leave(time_s, position_mm);
        attempt
    }

    fn enter_or_leave(&mut self, time_s: f64, position_mm: DVec3) {
        match (self.entry, self.zone.contains(position_mm)) {
            (None, true) => {
                self.entry = Some(Entry { time_s, position_mm, path_length_mm: self.path_length_mm });
            }
            (Some(_), false) => {
                self.entry = None;
                self.overshoots += 1;
            }
            _ => {}
        }
    }

    /// The score if this is the end of the attempt.
    fn observe(&mut self, time_s: f64, position_mm: DVec3, settings: &TaskSettings) -> Option<ZoneScore> {
        self.enter_or_leave(time_s, position_mm);
        let dwelt = self.entry.filter(|entry| time_s - entry.time_s >= settings.dwell_s);
        let time_is_over = time_s - self.appeared_s >= settings.timeout_s;
        (dwelt.is_some() || time_is_over).then(|| self.score(time_s, dwelt))
    }

    fn score(&self, time_s: f64, reached: Option<Entry>) -> ZoneScore {
        let distance_mm = self.start_mm.distance(self.zone.centre_mm);
        let difficulty_bits = index_of_difficulty_bits(distance_mm, self.zone.width_mm);
        let movement_time_s = reached.map(|entry| entry.time_s - self.appeared_s);
        ZoneScore {
            centre_mm: components(self.zone.centre_mm),
            distance_mm,
            index_of_difficulty_bits: difficulty_bits,
            reached: reached.is_some(),
            completion_time_s: reached.map(|_| time_s - self.appeared_s),
            movement_time_s,
            throughput_bits_per_s: movement_time_s
                .filter(|time_s| *time_s > 0.0)
                .map(|time_s| difficulty_bits / time_s),
            path_length_mm: reached.map_or(self.path_length_mm, |entry| entry.path_length_mm),
            path_efficiency: reached
                .filter(|entry| entry.path_length_mm > 0.0)
                .map(|entry| entry.position_mm.distance(self.start_mm) / entry.path_length_mm),
            overshoots: self.overshoots,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::ZoneShape;

    const START_MM: DVec3 = DVec3::new(386.0, 0.0, 362.0);

    fn workspace() -> Workspace {
        Workspace { min_mm: DVec3::new(200.0, -400.0, 100.0), max_mm: DVec3::new(600.0, 400.0, 650.0) }
    }

    fn task(settings: &TaskSettings) -> ZoneTask {
        ZoneTask::new(settings, [false, true, true], workspace(), 10.0, START_MM).unwrap()
    }

    /// Positions relative to the centre of the zone there is, at these times.
    fn follow(task: &mut ZoneTask, way: &[(f64, DVec3)]) {
        let centre_mm = task.zone().centre_mm;
        for (time_s, away_mm) in way {
            task.observe(*time_s, centre_mm + away_mm);
        }
    }

    #[test]
    fn a_zone_is_reached_by_dwelling_and_scored_by_hand() {
        let mut task = task(&TaskSettings { distance_mm: [120.0, 120.0], ..TaskSettings::default() });
        let first = *task.zone();
        let towards = (START_MM - first.centre_mm) / 120.0;
        let aside = DVec3::new(0.0, -towards.z, towards.y);
        // 120 mm away with 40 mm wide zones: log₂(120/40 + 1) = 2 bits. Into the zone after 2 s, through it and out
        // on the other side, back in after 4 s, there for 1 s.
        follow(
            &mut task,
            &[
                (12.0, towards * 19.0),
                (12.5, towards * -30.0),
                (14.0, towards * -15.0),
                (14.5, towards * -15.0 + aside * 5.0),
            ],
        );
        assert_eq!((task.zone_number(), *task.zone()), (1, first));
        let status = task.status("zones");
        assert_eq!((status.reached, status.trials, status.overshoots), (0, 0, 1));
        assert_eq!((status.throughput_bits_per_s, status.dwell_share), (None, 0.5));
        follow(&mut task, &[(15.0, towards * -15.0)]);
        assert_eq!(task.zone_number(), 2);
        let status = task.status("zones");
        assert_eq!((status.reached, status.trials, status.overshoots), (1, 1, 1));
        assert_eq!(status.dwell_share, 0.0);
        assert!((task.zone().centre_mm.distance(first.centre_mm) - 120.0).abs() < 1e-9);
        let report = task.report("zones", "simulated", 0);
        let score = &report.zones[0];
        let near = |value: f64, wanted: f64| assert!((value - wanted).abs() < 1e-9, "{value} for {wanted}");
        near(score.distance_mm, 120.0);
        near(score.index_of_difficulty_bits, 2.0);
        near(score.movement_time_s.unwrap(), 4.0);
        near(score.completion_time_s.unwrap(), 5.0);
        near(score.throughput_bits_per_s.unwrap(), 0.5);
        // 101 mm, 49 mm and back 15 mm; it entered for good 135 mm from the start.
        near(score.path_length_mm, 165.0);
        near(score.path_efficiency.unwrap(), 135.0 / 165.0);
        assert_eq!((score.reached, score.overshoots), (true, 1));
        near(report.throughput_bits_per_s.unwrap(), 0.5);
        near(report.duration_s, 5.0);
        assert_eq!((report.zones_reached, report.zones_timed_out, report.overshoots), (1, 0, 1));
    }

    #[test]
    fn throughput_is_the_mean_of_the_zones_ratios() {
        let settings = TaskSettings {
            distance_mm: [120.0, 120.0],
            dwell_s: 0.0,
            width_mm: 40.0,
            ..TaskSettings::default()
        };
        let mut task = task(&settings);
        follow(&mut task, &[(11.0, DVec3::ZERO)]);
        follow(&mut task, &[(15.0, DVec3::ZERO)]);
        let report = task.report("zones", "person", 0);
        // 2 bits in 1 s and 2 bits in 4 s: (2 + 0.5) / 2, and not 4 bits in 5 s.
        assert!((report.throughput_bits_per_s.unwrap() - 1.25).abs() < 1e-9);
        assert!((report.mean_movement_time_s.unwrap() - 2.5).abs() < 1e-9);
        assert!((report.mean_path_efficiency.unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_zone_that_is_not_reached_in_time_makes_way_and_has_no_times() {
        let mut task = task(&TaskSettings::default());
        let far = DVec3::Y * 30.0;
        follow(&mut task, &[(29.5, DVec3::ZERO), (29.9, DVec3::ZERO), (30.0, far)]);
        assert_eq!(task.zone_number(), 2);
        let report = task.report("zones", "simulated", 3);
        let score = &report.zones[0];
        assert!(!score.reached && score.movement_time_s.is_none() && score.path_efficiency.is_none());
        assert_eq!((report.zones_reached, report.zones_timed_out, report.states_lost), (0, 1, 3));
        assert_eq!((report.throughput_bits_per_s, report.overshoots), (None, 1));
        let text = report.to_string();
        assert!(
            text.contains("0 zones reached in 20 s, 1 timed out") && !text.contains("throughput"),
            "{text}"
        );
    }

    #[test]
    fn the_papers_zone_vanishes_once_entered() {
        let mut task = task(&TaskSettings::default().as_in_the_paper());
        assert_eq!(task.zone().shape, ZoneShape::Cube);
        follow(&mut task, &[(10.5, DVec3::new(0.0, 20.1, 0.0))]);
        assert_eq!(task.zone_number(), 1);
        follow(&mut task, &[(11.0, DVec3::new(0.0, 20.0, -20.0))]);
        assert_eq!(task.zone_number(), 2);
    }

    #[test]
    fn leaving_the_workspace_is_counted_once_and_timed() {
        let mut task = task(&TaskSettings::default());
        let outside = DVec3::new(386.0, 401.0, 362.0);
        for (time_s, position_mm) in
            [(11.0, outside), (11.5, outside), (12.0, START_MM), (13.0, outside), (13.25, START_MM)]
        {
            task.observe(time_s, position_mm);
        }
        let report = task.report("zones", "simulated", 0);
        assert_eq!(report.box_violations, 2);
        assert!((report.outside_box_s - 1.25).abs() < 1e-9);
        assert!(report.to_string().contains("box violations 2 (1.2 s outside)"), "{report}");
    }

    #[test]
    fn the_report_has_the_keys_that_other_programs_read() {
        let mut task = task(&TaskSettings::default().as_in_the_paper());
        follow(&mut task, &[(12.0, DVec3::ZERO)]);
        let report = task.report("paper-zones", "simulated", 0);
        let json = serde_json::to_value(&report).unwrap();
        for key in [
            "zones_reached",
            "zones_timed_out",
            "mean_completion_time_s",
            "mean_movement_time_s",
            "mean_index_of_difficulty_bits",
            "throughput_bits_per_s",
            "mean_path_efficiency",
            "overshoots",
            "box_violations",
            "outside_box_s",
            "duration_s",
            "states_lost",
        ] {
            assert!(json[key].is_number(), "{key}: {json:#}");
        }
        assert_eq!((&json["name"], &json["shape"]), (&"paper-zones".into(), &"cube".into()));
        assert_eq!(json["zones"][0]["reached"], true);
        assert_eq!(serde_json::from_value::<TaskReport>(json).unwrap(), report);
    }

    proptest! {
        #[test]
        fn scores_are_sound_whatever_the_arm_does(
            steps in prop::collection::vec((0.0..1.0_f64, prop::array::uniform2(-40.0..40.0_f64)), 1..300),
            dwell_s in 0.0..2.0_f64,
        ) {
            let mut task = task(&TaskSettings { dwell_s, timeout_s: 15.0, ..TaskSettings::default() });
            let (mut time_s, mut position_mm) = (10.0, START_MM);
            for (step_s, [y, z]) in steps {
                time_s += step_s;
                position_mm += DVec3::new(0.0, y, z);
                task.observe(time_s, position_mm);
            }
            let report = task.report("zones", "simulated", 0);
            prop_assert_eq!(report.zones_reached + report.zones_timed_out, report.zones.len());
            prop_assert!((report.duration_s - (time_s - 10.0)).abs() < 1e-9);
            prop_assert!(report.outside_box_s <= report.duration_s + 1e-9);
            for zone in &report.zones {
                prop_assert!(zone.distance_mm >= 0.0 && zone.index_of_difficulty_bits >= 0.0);
                prop_assert_eq!(zone.reached, zone.movement_time_s.is_some());
                if let (Some(movement_s), Some(completion_s)) = (zone.movement_time_s, zone.completion_time_s) {
                    prop_assert!(movement_s >= 0.0 && completion_s - movement_s >= dwell_s - 1e-9);
                }
                prop_assert!(zone.path_efficiency.is_none_or(|share| (0.0..=1.0 + 1e-9).contains(&share)));
            }
        }
    }
}
