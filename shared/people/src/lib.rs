//! People that Tendon has been calibrated to.
//!
//! ```text
//! windows of known gestures ─▶ Person::fit ─▶ Person ─▶ People: NAME/person.toml
//!    (Calibration)      Prior ──────┘            │
//!                                                └─▶ PersonalRecogniser: window ─▶ probabilities, effort, novelty
//! ```
//!
//! Whom it recognises, and how well, is in a person file that people can read. Fit and recogniser are pure: no clock, no
//! topic. Only [`People`] touches files. What the recogniser computes is in `tendon_features`.
#![forbid(unsafe_code)]

mod calibration;
mod effort;
mod expected;
mod file;
mod finding;
mod fit;
mod in_use;
mod name;
mod person;
mod quality;
mod recogniser;
mod store;
mod update;

pub use calibration::{Calibration, CalibrationError};
pub use effort::EffortRange;
pub use expected::{Expected, HeldOut};
pub use file::{PersonFileError, PersonProblem, name_in};
pub use finding::Finding;
pub use in_use::{PersonInUse, user_of_person};
pub use name::{InvalidName, PersonName};
pub use person::{Fitted, GestureFit, Made, Person, SignalFit};
pub use quality::{ChannelQuality, ClippingWatch};
pub use recogniser::{Adaptation, Difference, PersonalRecogniser, RecogniseError, Recognition, SignalOffer};
pub use store::{People, PeopleError, Reserved};
pub use update::ChannelShift;
