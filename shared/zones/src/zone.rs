//! Zones and where they appear.

use std::f64::consts::TAU;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use crate::TaskSettings;

/// Shape of a zone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ZoneShape {
    /// A sphere: as wide from every direction, as Fitts' law wants it.
    Sphere,
    /// A cube with edges along the axes: the paper's.
    Cube,
}

/// A target in the workspace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zone {
    /// Its shape.
    pub shape: ZoneShape,
    /// Its centre, mm.
    pub centre_mm: DVec3,
    /// Diameter of the sphere or edge of the cube, mm.
    pub width_mm: f64,
}

impl Zone {
    /// Whether a position is in the zone, its surface included.
    pub fn contains(&self, position_mm: DVec3) -> bool {
        let away_mm = position_mm - self.centre_mm;
        let half_mm = self.width_mm / 2.0;
        match self.shape {
            ZoneShape::Sphere => away_mm.length_squared() <= half_mm * half_mm,
            ZoneShape::Cube => away_mm.abs().max_element() <= half_mm,
        }
    }
}

/// A box with edges along the axes that the arm must not leave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    /// Its lowest corner, mm.
    pub min_mm: DVec3,
    /// Its highest corner, mm.
    pub max_mm: DVec3,
}

impl Workspace {
    /// Whether a position is in the box, its surface included.
    pub fn contains(&self, position_mm: DVec3) -> bool {
        position_mm.cmpge(self.min_mm).all() && position_mm.cmple(self.max_mm).all()
    }
}

/// There is no room for zones of this width at these distances.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "no room for zones {width_mm} mm wide that are {nearest_mm} mm apart within {reach_mm} mm of ({:.0}, {:.0}, {:.0}) \
     mm and the workspace: make task.width_mm or task.distance_mm smaller, or task.reach_mm greater",
    start_mm.x, start_mm.y, start_mm.z
)]
pub struct NoRoomForZones {
    /// Width of a zone.
    pub width_mm: f64,
    /// Shortest distance from zone to zone.
    pub nearest_mm: f64,
    /// How far from the start zones may reach.
    pub reach_mm: f64,
    /// Where the task begins.
    pub start_mm: DVec3,
}

/// A region with a side shorter than this, mm, is no room: directions that stay inside would be hard to find.
const SHORTEST_SIDE_MM: f64 = 1.0;

/// Says where zones appear: a random walk from centre to centre, set by the seed alone.
#[derive(Clone, Debug)]
pub struct Placement {
    shape: ZoneShape,
    width_mm: f64,
    distance_mm: [f64; 2],
    /// Those along which zones lie.
    axes: Vec<DVec3>,
    /// Where centres may lie.
    region: Workspace,
    last_centre_mm: DVec3,
    rng: Xoshiro256PlusPlus,
}

impl Placement {
    /// Zones around `start_mm`, wholly inside the workspace along each of the axes x, y, z that is chosen; along the others,
    /// they lie where the start does.
    ///
    /// # Errors
    ///
    /// [`NoRoomForZones`] if some centre could have no successor.
    pub fn new(
        settings: &TaskSettings,
        axes: [bool; 3],
        start_mm: DVec3,
        workspace: &Workspace,
    ) -> Result<Placement, NoRoomForZones> {
        let half_mm = DVec3::splat(settings.width_mm / 2.0);
        let reach_mm = DVec3::splat(settings.reach_mm);
        let mut region = Workspace {
            min_mm: (start_mm - reach_mm).max(workspace.min_mm) + half_mm,
            max_mm: (start_mm + reach_mm).min(workspace.max_mm) - half_mm,
        };
        let [nearest_mm, farthest_mm] = settings.distance_mm;
        let sides_mm: Vec<f64> =
            (0..3).filter(|axis| axes[*axis]).map(|axis| region.max_mm[axis] - region.min_mm[axis]).collect();
        let longest_mm = sides_mm.iter().copied().fold(0.0, f64::max);
        // From anywhere in a box, half of its longest side can be walked along that side.
        if sides_mm.iter().any(|side_mm| *side_mm < SHORTEST_SIDE_MM) || nearest_mm >= longest_mm / 2.0 {
            return Err(NoRoomForZones {
                width_mm: settings.width_mm,
                nearest_mm,
                reach_mm: settings.reach_mm,
                start_mm,
            });
        }
        for axis in (0..3).filter(|axis| !axes[*axis]) {
            (region.min_mm[axis], region.max_mm[axis]) = (start_mm[axis], start_mm[axis]);
        }
        let diagonal_mm = sides_mm.iter().map(|side_mm| side_mm * side_mm).sum::<f64>().sqrt();
        Ok(Placement {
            shape: settings.shape,
            width_mm: settings.width_mm,
            // Nothing is farther than the diagonal, and drawing it would be in vain.
            distance_mm: [nearest_mm, farthest_mm.min(diagonal_mm)],
            axes: (0..3).filter(|axis| axes[*axis]).map(|axis| DVec3::AXES[axis]).collect(),
            // A start near a wall of the workspace may lie outside the region.
            last_centre_mm: start_mm.clamp(region.min_mm, region.max_mm),
            region,
            rng: Xoshiro256PlusPlus::seed_from_u64(settings.seed),
        })
    }

    /// The next zone.
    pub fn next_zone(&mut self) -> Zone {
        let [nearest_mm, farthest_mm] = self.distance_mm;
        // Ends, since a part of all directions and distances leads to a place inside.
        loop {
            let direction = self.direction();
            let distance_mm = self.rng.random_range(nearest_mm..=farthest_mm);
            let centre_mm = self.last_centre_mm + distance_mm * direction;
            if self.region.contains(centre_mm) {
                self.last_centre_mm = centre_mm;
                return Zone { shape: self.shape, centre_mm, width_mm: self.width_mm };
            }
        }
    }

    /// Any direction along the axes, each as likely as the others.
    fn direction(&mut self) -> DVec3 {
        match self.axes[..] {
            [one, other] => {
                let (sin, cos) = self.rng.random_range(0.0..TAU).sin_cos();
                cos * one + sin * other
            }
            [one] => one * if self.rng.random_bool(0.5) { 1.0 } else { -1.0 },
            _ => {
                // Archimedes: heights on a sphere are distributed evenly.
                let (sin, cos) = self.rng.random_range(0.0..TAU).sin_cos();
                let height = self.rng.random_range(-1.0..=1.0_f64);
                let across = (1.0 - height * height).sqrt();
                DVec3::new(across * cos, across * sin, height)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const START_MM: DVec3 = DVec3::new(386.0, 0.0, 362.0);

    const Y_Z: [bool; 3] = [false, true, true];

    fn workspace() -> Workspace {
        Workspace { min_mm: DVec3::new(200.0, -400.0, 100.0), max_mm: DVec3::new(600.0, 400.0, 650.0) }
    }

    #[test]
    fn a_sphere_is_round_and_a_cube_has_corners() {
        let zone = |shape| Zone { shape, centre_mm: START_MM, width_mm: 40.0 };
        let corner = START_MM + DVec3::splat(19.0);
        assert!(zone(ZoneShape::Cube).contains(corner) && !zone(ZoneShape::Sphere).contains(corner));
        let surface = START_MM + DVec3::Z * 20.0;
        assert!(zone(ZoneShape::Cube).contains(surface) && zone(ZoneShape::Sphere).contains(surface));
        let beyond = START_MM + DVec3::Y * 20.1;
        assert!(!zone(ZoneShape::Cube).contains(beyond) && !zone(ZoneShape::Sphere).contains(beyond));
    }

    #[test]
    fn zones_that_have_no_room_are_refused() {
        let refused = |settings: TaskSettings, workspace: &Workspace| {
            Placement::new(&settings, Y_Z, START_MM, workspace).unwrap_err().to_string()
        };
        let wide = TaskSettings { width_mm: 400.0, ..TaskSettings::default() };
        assert!(refused(wide, &workspace()).contains("no room for zones 400 mm wide"));
        let low = Workspace { max_mm: DVec3::new(600.0, 400.0, 100.0), ..workspace() };
        assert!(refused(TaskSettings::default(), &low).contains("(386, 0, 362)"));
    }

    /// Any choice of axes but none.
    fn axes() -> impl Strategy<Value = [bool; 3]> {
        any::<[bool; 3]>().prop_filter("zones lie along some axis", |axes| axes.contains(&true))
    }

    proptest! {
        #[test]
        fn zones_lie_inside_at_their_distances_and_depend_on_the_seed_alone(
            seed: u64,
            axes in axes(),
            width_mm in 1.0..120.0_f64,
            nearest_mm in 1.0..110.0_f64,
            farther_mm in 0.0..300.0_f64,
            shift in prop::array::uniform2(-100.0..100.0_f64),
        ) {
            let settings = TaskSettings {
                seed,
                width_mm,
                distance_mm: [nearest_mm, nearest_mm + farther_mm],
                ..TaskSettings::default()
            };
            let start_mm = START_MM + DVec3::new(0.0, shift[0], shift[1]);
            let mut placement = Placement::new(&settings, axes, start_mm, &workspace()).unwrap();
            let mut again = Placement::new(&settings, axes, start_mm, &workspace()).unwrap();
            let mut last_mm = start_mm;
            for _ in 0..50 {
                let zone = placement.next_zone();
                prop_assert_eq!(zone, again.next_zone());
                let away_mm = zone.centre_mm - start_mm;
                for axis in 0..3 {
                    prop_assert!(axes[axis] || away_mm[axis] == 0.0);
                    let edges_mm = [-0.5, 0.5].map(|sign| zone.centre_mm + sign * width_mm * DVec3::AXES[axis] * (1.0 - 1e-9));
                    prop_assert!(!axes[axis] || edges_mm.iter().all(|edge_mm| workspace().contains(*edge_mm)));
                }
                prop_assert!(away_mm.abs().max_element() <= 180.0 - width_mm / 2.0 + 1e-9);
                let distance_mm = zone.centre_mm.distance(last_mm);
                prop_assert!(distance_mm >= nearest_mm - 1e-9);
                prop_assert!(distance_mm <= nearest_mm + farther_mm + 1e-9);
                last_mm = zone.centre_mm;
            }
        }
    }

    #[test]
    fn zones_in_space_lie_to_all_sides() {
        let mut placement =
            Placement::new(&TaskSettings::default(), [true; 3], START_MM, &workspace()).unwrap();
        let centres: Vec<DVec3> = (0..200).map(|_| placement.next_zone().centre_mm - START_MM).collect();
        for direction in DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]) {
            assert!(centres.iter().filter(|centre| centre.dot(direction) > 80.0).count() > 10, "{direction}");
        }
    }

    #[test]
    fn the_plane_has_the_zones_that_it_always_had() {
        let mut placement = Placement::new(&TaskSettings::default(), Y_Z, START_MM, &workspace()).unwrap();
        for [y, z] in [[-39.8429, 440.7147], [-72.3494, 480.2013], [-124.3830, 481.7482]] {
            let centre_mm = placement.next_zone().centre_mm;
            assert!(centre_mm.abs_diff_eq(DVec3::new(386.0, y, z), 1e-3), "{centre_mm}");
        }
    }

    #[test]
    fn a_start_in_a_corner_of_the_workspace_has_zones() {
        let corner_mm = workspace().min_mm;
        let settings = TaskSettings { width_mm: 80.0, distance_mm: [40.0, 45.0], ..TaskSettings::default() };
        let mut placement = Placement::new(&settings, [true; 3], corner_mm, &workspace()).unwrap();
        assert!((placement.next_zone().centre_mm - corner_mm).min_element() >= 40.0);
    }

    #[test]
    fn other_seeds_give_other_zones() {
        let first = |seed| {
            let settings = TaskSettings { seed, ..TaskSettings::default() };
            Placement::new(&settings, Y_Z, START_MM, &workspace()).unwrap().next_zone()
        };
        assert_ne!(first(0), first(1));
    }
}
