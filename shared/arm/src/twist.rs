//! The velocity of the flange that a command asks for.

use nalgebra::{UnitQuaternion, Vector3, Vector6};

/// Velocity of the flange in the base frame: of its origin along, and about, the axes x, y and z.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Linear velocity along x, y, z in mm/s.
    pub linear_mm_per_s: [f64; 3],
    /// Angular velocity about x, y, z in rad/s.
    pub angular_rad_per_s: [f64; 3],
}

/// A twist that holds a NaN or an infinity.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("twist component {component} is {value}: it was taken as a stop; send finite velocities")]
pub struct NonFiniteTwist {
    /// Which component: `linear x` to `angular z`.
    pub component: &'static str,
    /// Its value.
    pub value: f64,
}

impl Twist {
    /// Standing still.
    pub const ZERO: Twist = Twist { linear_mm_per_s: [0.0; 3], angular_rad_per_s: [0.0; 3] };

    /// This twist, or which of its components is not finite.
    ///
    /// # Errors
    /// [`NonFiniteTwist`] names the first NaN or infinite component.
    pub fn finite(self) -> Result<Twist, NonFiniteTwist> {
        const NAMES: [&str; 6] = ["linear x", "linear y", "linear z", "angular x", "angular y", "angular z"];
        let values = self.linear_mm_per_s.into_iter().chain(self.angular_rad_per_s);
        match NAMES.into_iter().zip(values).find(|(_, value)| !value.is_finite()) {
            Some((component, value)) => Err(NonFiniteTwist { component, value }),
            None => Ok(self),
        }
    }

    /// Linear speed in mm/s.
    pub fn linear_speed_mm_per_s(&self) -> f64 {
        Vector3::from(self.linear_mm_per_s).norm()
    }

    /// Angular speed in rad/s.
    pub fn angular_speed_rad_per_s(&self) -> f64 {
        Vector3::from(self.angular_rad_per_s).norm()
    }

    /// This twist of a frame that is turned by `rotation`, in the frame that it is turned from.
    pub fn rotated(&self, rotation: &UnitQuaternion<f64>) -> Twist {
        let rotated = |vector: [f64; 3]| (rotation * Vector3::from(vector)).into();
        Twist {
            linear_mm_per_s: rotated(self.linear_mm_per_s),
            angular_rad_per_s: rotated(self.angular_rad_per_s),
        }
    }

    /// The same direction at `factor` times the speed.
    pub fn scaled(&self, factor: f64) -> Twist {
        Twist {
            linear_mm_per_s: self.linear_mm_per_s.map(|value| value * factor),
            angular_rad_per_s: self.angular_rad_per_s.map(|value| value * factor),
        }
    }

    /// The same direction, slowed as a whole until neither speed (mm/s and rad/s) passes its limit.
    pub fn limited(&self, linear_mm_per_s: f64, angular_rad_per_s: f64) -> Twist {
        let linear = linear_mm_per_s / self.linear_speed_mm_per_s();
        let angular = angular_rad_per_s / self.angular_speed_rad_per_s();
        // A speed of zero divides to infinity, which limits nothing.
        self.scaled(linear.min(angular).min(1.0))
    }

    /// Linear velocity in m/s above angular velocity in rad/s, as the Jacobian has its rows.
    pub fn to_vector_m(&self) -> Vector6<f64> {
        let [x, y, z] = self.linear_mm_per_s.map(|value| value * 1e-3);
        let [roll, pitch, yaw] = self.angular_rad_per_s;
        Vector6::new(x, y, z, roll, pitch, yaw)
    }

    /// The twist of a vector that has linear velocity in m/s above angular velocity in rad/s.
    pub fn from_vector_m(vector: &Vector6<f64>) -> Twist {
        let [x, y, z, roll, pitch, yaw] = (*vector).into();
        Twist {
            linear_mm_per_s: [x, y, z].map(|value: f64| value * 1e3),
            angular_rad_per_s: [roll, pitch, yaw],
        }
    }

    /// Linear velocity in mm/s above angular velocity in rad/s.
    pub(crate) fn to_vector_mm(self) -> Vector6<f64> {
        let ([x, y, z], [roll, pitch, yaw]) = (self.linear_mm_per_s, self.angular_rad_per_s);
        Vector6::new(x, y, z, roll, pitch, yaw)
    }

    /// The twist of a vector that has linear velocity in mm/s above angular velocity in rad/s.
    pub(crate) fn from_vector_mm(vector: &Vector6<f64>) -> Twist {
        Twist {
            linear_mm_per_s: [vector[0], vector[1], vector[2]],
            angular_rad_per_s: [vector[3], vector[4], vector[5]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limited_twist_keeps_its_direction() {
        let twist = Twist { linear_mm_per_s: [300.0, 0.0, 400.0], angular_rad_per_s: [0.0, 1.0, 0.0] };
        let limited = twist.limited(100.0, 0.5);
        assert_eq!(limited, twist.scaled(0.2));
        assert_eq!(twist.limited(1000.0, 0.5), twist.scaled(0.5));
        assert_eq!(twist.limited(1000.0, 2.0), twist);
        assert_eq!(Twist::ZERO.limited(100.0, 0.5), Twist::ZERO);
    }

    #[test]
    fn a_component_that_is_not_finite_is_named() {
        let twist = Twist { linear_mm_per_s: [0.0, f64::INFINITY, 0.0], ..Twist::ZERO };
        let error = twist.finite().unwrap_err();
        assert_eq!(error, NonFiniteTwist { component: "linear y", value: f64::INFINITY });
        let twist = Twist { angular_rad_per_s: [0.0, 0.0, f64::NAN], ..Twist::ZERO };
        assert_eq!(twist.finite().unwrap_err().component, "angular z");
        assert_eq!(Twist::ZERO.finite(), Ok(Twist::ZERO));
    }
}
