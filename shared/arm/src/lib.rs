//! The xArm7: kinematics, joint velocities within its limits, and a simulated arm.
//!
//! ```text
//!           twist                                velocity                    joint velocities
//! command ────────▶ motion (`Motion`) ────────────────────▶ solve (`velocity`) ──────────────▶ integrate
//!                   ramp: speed, acceleration, jerk,  │     joint limits                      at 250 Hz
//!                   watchdog, stop                    │                                       (`SimulatedArm`)
//!                   limits: workspace, joints,        └───▶ or to a real arm ──▶ its reports ──▶ `Guard`
//!                   singularities
//! ```
//!
//! Everything is pure: time is given from outside as nanoseconds, nothing allocates once constructed. The
//! motion, the settings and the guard know nothing of the simulation, so that another arm can stand in
//! its place.
//!
//! Lengths are millimetres where people and commands meet the crate ([`Twist`], [`ArmState`],
//! [`ArmSettings`]) and metres inside ([`kinematics`], [`velocity`]), which every name says.
#![forbid(unsafe_code)]

mod course;
mod guard;
pub mod kinematics;
mod limits;
mod motion;
mod ramp;
mod settings;
mod simulation;
mod step;
mod told;
mod twist;
pub mod velocity;
mod violation;

pub use guard::Guard;
pub use kinematics::{DenavitHartenberg, JointLimits, JointVector, XArm7, denavit_hartenberg};
pub use limits::Obstacle;
pub use motion::Motion;
pub use ramp::{ANGULAR_ACCELERATION_RAD_PER_S2, ANGULAR_SPEED_LIMIT_RAD_PER_S, MotionBounds, STOP_NS};
pub use settings::{ArmSettings, ArmSettingsError};
pub use simulation::{ArmState, SimulatedArm};
pub use step::STEP_NS;
pub use told::Told;
pub use twist::{NonFiniteTwist, Twist};
pub use violation::LimitViolation;
