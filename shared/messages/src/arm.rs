//! What the arm is doing, and what keeps a held gesture from moving it.

use core::fmt;

use crate::numbered::numbered;

numbered! {
    /// How far the arm is, as it travels in [`StateHeader::arm_phase`](crate::StateHeader::arm_phase).
    pub enum ArmPhase {
        /// There is no connection yet.
        Connecting = 0,
        /// Its errors are cleared and its motors switched on.
        BringingUp = 1,
        /// It goes to its start position by itself.
        GoingToStart = 2,
        /// It follows commands, as far as [`Permission`](crate::Permission) lets them through.
        Following = 3,
        /// It is connected and stays where it is until `tendon arm`.
        Waiting = 4,
    } otherwise Connecting
}

/// What keeps the arm from following a command in full, as it travels in
/// [`StateHeader::hindrance`](crate::StateHeader::hindrance). Displayed, it names the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hindrance {
    /// A face of the workspace box.
    WorkspaceFace {
        /// 0 for x, 1 for y, 2 for z.
        axis: u8,
        /// The face at `workspace_max_mm`, not that at `workspace_min_mm`.
        is_upper: bool,
    },
    /// The limit of a joint.
    JointLimit {
        /// Number of the joint, 1 to 7.
        joint: u8,
    },
    /// A posture in which some directions are impossible.
    Singularity,
    /// A joint would have to be faster than it can be.
    JointSpeed,
}

/// The number of the first hindrance by a joint.
const FIRST_JOINT: u8 = 10;

impl Hindrance {
    /// The number of this hindrance, never 0.
    pub fn number(self) -> u8 {
        match self {
            Hindrance::WorkspaceFace { axis, is_upper } => 1 + 2 * axis + u8::from(is_upper),
            Hindrance::JointLimit { joint } => FIRST_JOINT + joint,
            Hindrance::Singularity => 20,
            Hindrance::JointSpeed => 21,
        }
    }

    /// The hindrance with this number; `None` for 0 and for what no sender of ours writes.
    pub fn from_number(number: u8) -> Option<Hindrance> {
        match number {
            1..=6 => {
                Some(Hindrance::WorkspaceFace { axis: (number - 1) / 2, is_upper: number.is_multiple_of(2) })
            }
            11..=17 => Some(Hindrance::JointLimit { joint: number - FIRST_JOINT }),
            20 => Some(Hindrance::Singularity),
            21 => Some(Hindrance::JointSpeed),
            _ => None,
        }
    }
}

impl fmt::Display for Hindrance {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Hindrance::WorkspaceFace { axis, is_upper } => {
                let axis = ["x", "y", "z"].get(usize::from(*axis)).unwrap_or(&"?");
                write!(formatter, "at the workspace limit {}{axis}", if *is_upper { '+' } else { '-' })
            }
            Hindrance::JointLimit { joint } => write!(formatter, "joint {joint} is near its limit"),
            Hindrance::Singularity => formatter.write_str("near a singularity"),
            Hindrance::JointSpeed => formatter.write_str("a joint cannot go faster"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_hindrances_go_both_ways() {
        let known: Vec<Hindrance> = (0..=u8::MAX).filter_map(Hindrance::from_number).collect();
        assert_eq!(known.len(), 6 + 7 + 2);
        assert!(known.iter().all(|hindrance| Hindrance::from_number(hindrance.number()) == Some(*hindrance)));
        assert_eq!(Hindrance::from_number(0), None);
        let face = Hindrance::WorkspaceFace { axis: 2, is_upper: true };
        assert_eq!(face.to_string(), "at the workspace limit +z");
    }
}
