//! What an arm was told, for comparison with what it does.

use nalgebra::Vector3;

use crate::kinematics::JointVector;
use crate::twist::Twist;

/// What an arm does may be off what it was told by this share.
pub(crate) const OFF_SHARE: f64 = 0.3;

/// How far the tip of a tool, which a told rotation keeps in place, may be from the flange, in mm.
pub(crate) const TOOL_REACH_MM: f64 = 300.0;

/// A slower flange, in mm/s, is told to rest: at a limit the velocity is never quite zero.
const REST_MM_PER_S: f64 = 1.0;

/// What an arm was told since the guard last looked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// The velocity of the flange.
    pub velocity: Twist,
    /// The velocities of the joints, if it was told these.
    pub joints_rad_per_s: Option<JointVector>,
    /// For how long the arm has given no sign of life, in ns.
    pub silent_ns: u64,
}

impl Told {
    /// A velocity of the flange, told to an arm that answers at once.
    pub fn velocity(velocity: Twist) -> Told {
        Told { velocity, joints_rad_per_s: None, silent_ns: 0 }
    }

    pub(crate) fn is_rest(&self) -> bool {
        let Told { velocity, joints_rad_per_s, .. } = self;
        joints_rad_per_s.is_none_or(|velocities| velocities == JointVector::zeros())
            && velocity.linear_speed_mm_per_s() < REST_MM_PER_S
            && velocity.angular_speed_rad_per_s() * TOOL_REACH_MM < REST_MM_PER_S
    }
}

/// The velocities told in some time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ToldRange {
    /// Along x, y and z in mm/s.
    pub lowest_mm_per_s: Vector3<f64>,
    pub highest_mm_per_s: Vector3<f64>,
    /// The greatest speeds.
    pub linear_mm_per_s: f64,
    pub angular_rad_per_s: f64,
    /// The longest silence of the arm.
    pub silent_ns: u64,
}

impl ToldRange {
    /// The range of one velocity; with rest in it if that may not have been heard.
    pub fn of(told: &Told, may_be_unheard: bool) -> ToldRange {
        let linear_mm_per_s = Vector3::from(told.velocity.linear_mm_per_s);
        let other_mm_per_s = if may_be_unheard { Vector3::zeros() } else { linear_mm_per_s };
        ToldRange {
            lowest_mm_per_s: linear_mm_per_s.inf(&other_mm_per_s),
            highest_mm_per_s: linear_mm_per_s.sup(&other_mm_per_s),
            linear_mm_per_s: linear_mm_per_s.norm(),
            angular_rad_per_s: told.velocity.angular_speed_rad_per_s(),
            silent_ns: told.silent_ns,
        }
    }

    /// The range of both.
    pub fn joined(self, other: &ToldRange) -> ToldRange {
        ToldRange {
            lowest_mm_per_s: self.lowest_mm_per_s.inf(&other.lowest_mm_per_s),
            highest_mm_per_s: self.highest_mm_per_s.sup(&other.highest_mm_per_s),
            linear_mm_per_s: self.linear_mm_per_s.max(other.linear_mm_per_s),
            angular_rad_per_s: self.angular_rad_per_s.max(other.angular_rad_per_s),
            silent_ns: self.silent_ns.max(other.silent_ns),
        }
    }
}
