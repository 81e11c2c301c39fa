//! A session from the supervisor's side: its stages as processes, and the people at its terminal.
//!
//! ```text
//! keys, signals ──▶ RobotLine ──stop, arm, SIGTERM──▶ robot      past everything else, waits for nothing
//!       │               ▲  alive, while the loop turns
//!       └──Event──▶ Watch::turn ◀──Event── ready, end ── five stages     started, watched, started again, stopped
//!                        │ say, show                     │ what they write to standard error
//!                        ▼                               ▼
//!                     Writer ─────────────────────▶ terminal             may wait for ever; nobody waits for it
//! ```
#![forbid(unsafe_code)]

mod acquisition;
mod arm_stops;
mod children;
mod companion;
mod failure;
mod find;
mod keys;
mod progress;
mod recorder;
mod resources;
mod robot_line;
mod watch;
mod writer;

pub use acquisition::{AcquisitionWatch, Heard};
pub use arm_stops::{is_found_waiting, stop_words};
pub use children::{ChildrenError, Event, RECORDER_PROGRAM, check_source_program};
pub use companion::Companion;
pub use failure::SessionFailure;
pub use find::{BecomeOwnerError, become_owner};
pub use keys::{Keyboard, KeyboardError, Keys, gesture_keys, stop_on_signals};
pub use recorder::RecordingPlan;
pub use robot_line::RobotLine;
pub use watch::{Turn, Usage, Watch};
pub use writer::{OutputError, Writer};
