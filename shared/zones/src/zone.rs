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

/// Says where zones appear: a random walk from centre to centre, set by the seed alone.
#[derive(Clone, Debug)]
pub struct Placement {
    shape: ZoneShape,
    width_mm: f64,
    distance_mm: [f64; 2],
    /// Where centres may lie.
    region: Workspace,
    last_centre_mm: DVec3,
    rng: Xoshiro256PlusPlus,
}

impl Placement {
    /// Zones around `start_mm`, wholly inside the workspace.
    ///
    /// # Errors
    ///
    /// [`NoRoomForZones`] if some centre could have no successor.
    pub fn new(
        settings: &TaskSettings,
        start_mm: DVec3,
        workspace: &Workspace,
    ) -> Result<Placement, NoRoomForZones> {
        let half_mm = DVec3::splat(settings.width_mm / 2.0);
        let reach_mm = DVec3::new(0.0, settings.reach_mm, settings.reach_mm);
        let mut region = Workspace {
            min_mm: (start_mm - reach_mm).max(workspace.min_mm) + half_mm,
            max_mm: (start_mm + reach_mm).min(workspace.max_mm) - half_mm,
        };
        (region.min_mm.x, region.max_mm.x) = (start_mm.x, start_mm.x);
        let [nearest_mm, farthest_mm] = settings.distance_mm;
        let sides_mm = region.max_mm - region.min_mm;
        // From anywhere in a rectangle, half of its longer side can be walked along that side.
        if sides_mm.min_element() < 0.0 || nearest_mm > sides_mm.max_element() / 2.0 {
            return Err(NoRoomForZones {
                width_mm: settings.width_mm,
                nearest_mm,
                reach_mm: settings.reach_mm,
                start_mm,
            });
        }
        Ok(Placement {
            shape: settings.shape,
            width_mm: settings.width_mm,
            // Nothing is farther than the diagonal, and drawing it would be in vain.
            distance_mm: [nearest_mm, farthest_mm.min(sides_mm.length())],
            region,
            last_centre_mm: start_mm,
            rng: Xoshiro256PlusPlus::seed_from_u64(settings.seed),
        })
    }

    /// The next zone.
    pub fn next_zone(&mut self) -> Zone {
        let [nearest_mm, farthest_mm] = self.distance_mm;
        // Ends, since a part of all directions and distances leads to a place inside.
        loop {
            let (sin, cos) = self.rng.random_range(0.0..TAU).sin_cos();
            let distance_mm = self.rng.random_range(nearest_mm..=farthest_mm);
            let centre_mm = self.last_centre_mm + distance_mm * DVec3::new(0.0, cos, sin);
            if self.region.contains(centre_mm) {
                self.last_centre_mm = centre_mm;
                return Zone { shape: self.shape, centre_mm, width_mm: self.width_mm };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const START_MM: DVec3 = DVec3::new(386.0, 0.0, 362.0);

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
            Placement::new(&settings, START_MM, workspace).unwrap_err().to_string()
        };
        let wide = TaskSettings { width_mm: 400.0, ..TaskSettings::default() };
        assert!(refused(wide, &workspace()).contains("no room for zones 400 mm wide"));
        let low = Workspace { max_mm: DVec3::new(600.0, 400.0, 100.0), ..workspace() };
        assert!(refused(TaskSettings::default(), &low).contains("(386, 0, 362)"));
    }

    proptest! {
        #[test]
        fn zones_lie_inside_at_their_distances_and_depend_on_the_seed_alone(
            seed: u64,
            width_mm in 1.0..120.0_f64,
            nearest_mm in 1.0..119.0_f64,
            farther_mm in 0.0..300.0_f64,
            shift in prop::array::uniform3(-100.0..100.0_f64),
        ) {
            let settings = TaskSettings {
                seed,
                width_mm,
                distance_mm: [nearest_mm, nearest_mm + farther_mm],
                ..TaskSettings::default()
            };
            let start_mm = START_MM + DVec3::from(shift);
            let mut placement = Placement::new(&settings, start_mm, &workspace()).unwrap();
            let mut again = Placement::new(&settings, start_mm, &workspace()).unwrap();
            let mut last_mm = start_mm;
            for _ in 0..50 {
                let zone = placement.next_zone();
                prop_assert_eq!(zone, again.next_zone());
                let away_mm = zone.centre_mm - start_mm;
                prop_assert_eq!(away_mm.x, 0.0);
                prop_assert!(away_mm.abs().max_element() <= 180.0 - width_mm / 2.0 + 1e-9);
                for sign in [-0.5, 0.5] {
                    let edge_mm = zone.centre_mm + sign * width_mm * (DVec3::Y + DVec3::Z) * (1.0 - 1e-9);
                    prop_assert!(workspace().contains(edge_mm));
                }
                let distance_mm = zone.centre_mm.distance(last_mm);
                prop_assert!(distance_mm >= nearest_mm - 1e-9);
                prop_assert!(distance_mm <= nearest_mm + farther_mm + 1e-9);
                last_mm = zone.centre_mm;
            }
        }
    }

    #[test]
    fn other_seeds_give_other_zones() {
        let first = |seed| {
            let settings = TaskSettings { seed, ..TaskSettings::default() };
            Placement::new(&settings, START_MM, &workspace()).unwrap().next_zone()
        };
        assert_ne!(first(0), first(1));
    }
}
