//! What can be wrong with a model's metadata, inputs and outputs.

use tendon_gesture::Class;

/// What can be wrong with what a model says of itself.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContractProblem {
    /// Metadata that are missing.
    #[error("the metadata lack `{key}`")]
    Missing {
        /// The key.
        key: &'static str,
    },
    /// Metadata that mean nothing.
    #[error("the metadata's `{key}` is `{value}`, which is not valid")]
    Senseless {
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
    },
    /// Metadata of another layout.
    #[error("the metadata are of contract version {found}, this program reads {known}")]
    Version {
        /// Their version.
        found: String,
        /// The version that this program reads.
        known: &'static str,
    },
    /// Two outputs for one class.
    #[error("the metadata's `tendon.classes` name `{class}` twice")]
    ClassTwice {
        /// The class.
        class: Class,
    },
    /// Too many inputs or outputs, or none.
    #[error("the model has {found} {what}s instead of one")]
    Count {
        /// `input` or `output`.
        what: &'static str,
        /// How many there are.
        found: usize,
    },
    /// An input or output of another shape or type than the metadata say.
    #[error("the model's {what} is {found}, but the metadata want {expected}")]
    Shape {
        /// `input` or `output`.
        what: &'static str,
        /// What it is.
        found: String,
        /// What follows from the metadata.
        expected: String,
    },
    /// Outputs that are no probabilities: a softmax is missing.
    #[error(
        "its outputs are not probabilities (0 to 1, adding up to 1) but {}: end the network with a softmax",
        listed(outputs)
    )]
    NoProbabilities {
        /// The outputs for a window of zeros.
        outputs: Vec<f32>,
    },
}

/// The value of a key that means nothing.
pub(crate) fn senseless(key: &'static str, value: &str) -> ContractProblem {
    ContractProblem::Senseless { key, value: value.to_owned() }
}

/// Numbers in words: `0.5, 0.2`.
fn listed(numbers: &[f32]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
