//! The xArm7: kinematics, joint velocities within its limits, and a simulated arm.
//!
//! ```text
//!              commanded twist                     velocity                        joint velocities
//! command ────────────────────▶ ramp (`ramp`) ───────────────▶ solve (`velocity`) ──────────────────▶ integrate
//!                               speed limit, acceleration,     Jacobian (`kinematics`),               at 250 Hz
//!                               watchdog, halt                 joint limits, singularities            (`simulation`)
//! ```
//!
//! Everything is pure: time is given from outside as nanoseconds, nothing allocates once constructed. The
//! ramp, the settings and the limits know nothing of the simulation, so that another arm can stand in
//! its place.
//!
//! Lengths are millimetres where people and commands meet the crate ([`Twist`], [`ArmState`],
//! [`ArmSettings`]) and metres inside ([`kinematics`], [`velocity`]), which every name says.
#![forbid(unsafe_code)]

pub mod kinematics;
mod ramp;
mod settings;
mod simulation;
mod twist;
pub mod velocity;

pub use kinematics::{JointVector, XArm7};
pub use ramp::{ANGULAR_ACCELERATION_RAD_PER_S2, ANGULAR_SPEED_LIMIT_RAD_PER_S, TwistRamp};
pub use settings::{ArmSettings, ArmSettingsError};
pub use simulation::{ArmState, GripperCommand, STEP_NS, SimulatedArm};
pub use twist::{NonFiniteTwist, Twist};
