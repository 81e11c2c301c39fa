//! What the guard finds of an arm, in words that say what to do.

/// An arm is not where, or not as fast, as it should be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LimitViolation {
    /// A joint is beyond its limit, or its angle not a number.
    #[error(
        "joint {joint} is at {angle_deg:.1}°, beyond its limit: drive it back within its range by hand or with the \
         vendor's software, then run `tendon arm`"
    )]
    JointLimit {
        /// Number of the joint, 1 to 7.
        joint: usize,
        /// Its angle in degrees.
        angle_deg: f64,
    },
    /// The flange is out of the workspace, or its position not a number.
    #[error(
        "the flange is at {axis} = {position_mm:.1} mm, out of the workspace: drive it back inside (or widen \
         workspace_min_mm and workspace_max_mm), then run `tendon arm`"
    )]
    WorkspaceBox {
        /// The axis, `x`, `y` or `z`.
        axis: char,
        /// The position on it in mm.
        position_mm: f64,
    },
    /// The flange moves though the arm is commanded to rest.
    #[error(
        "the flange moves at {speed_mm_per_s:.0} mm/s though the arm is commanded to rest: find out what drives or \
         pulls it, then run `tendon arm`"
    )]
    Creeping {
        /// Its mean speed over 0.1 s in mm/s.
        speed_mm_per_s: f64,
    },
    /// The flange crept away while the arm was commanded to rest.
    #[error(
        "the flange moved by {way_mm:.0} mm while the arm was commanded to rest: find out what drives or pulls it, \
         then run `tendon arm`"
    )]
    Drifted {
        /// How far it is from where it came to rest, in mm.
        way_mm: f64,
    },
    /// The flange does not move as it was told.
    #[error(
        "the flange moves along {axis} at {measured_mm_per_s:.0} mm/s and was told {lowest_mm_per_s:.0} to \
         {highest_mm_per_s:.0}: find out what holds or pulls the arm, or slows it in its own settings, then run \
         `tendon arm`"
    )]
    NotFollowing {
        /// The axis, `x`, `y` or `z`.
        axis: char,
        /// Its mean velocity along it over 0.3 s in mm/s.
        measured_mm_per_s: f64,
        /// The least velocity along it that it was told, in mm/s.
        lowest_mm_per_s: f64,
        /// The greatest.
        highest_mm_per_s: f64,
    },
    /// The flange is not where its commands have led it.
    #[error(
        "the flange is {off_mm:.0} mm from where its commands have led it: find out what holds or pulls the arm, then run \
         `tendon arm`"
    )]
    OffCourse {
        /// How far off it is, in mm.
        off_mm: f64,
    },
    /// A joint is not where its commands have led it.
    #[error(
        "joint {joint} is {off_deg:.0}° from where its commands have led it: find out what holds or pulls the arm, then \
         run `tendon arm`"
    )]
    JointOffCourse {
        /// Number of the joint, 1 to 7.
        joint: usize,
        /// How far off it is, in degrees.
        off_deg: f64,
    },
    /// The flange is faster than any command allows.
    #[error(
        "the flange moves at {speed_mm_per_s:.0} mm/s, faster than it was told: find out what else drives the arm, \
         then run `tendon arm`"
    )]
    OverSpeed {
        /// Its mean speed between two reports in mm/s.
        speed_mm_per_s: f64,
    },
}
