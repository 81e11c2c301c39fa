//! What recognises gestures: trained models in ONNX Runtime with the contract that each carries, or a person.
//!
//! ```text
//! model.onnx ─┬─ graph:    window [1, channels, samples] ─▶ z-score ─▶ network ─▶ softmax ─▶ [1, classes]
//!             └─ metadata: channels, rate, window, filter, classes  =  Contract
//! ```
//!
//! A model whose [`Contract`] does not fit the session is refused before its first window.

mod contract;
mod locate;
mod metadata;
mod problem;
mod recogniser;
mod rest;
mod run;
mod trained_on;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ort::environment::Environment;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::{TensorElementType, ValueType};
use tendon_people::{PersonFileError, RecogniseError};

pub use contract::{Contract, Mismatch, WindowSource};
pub use locate::{model_beside_program, runtime_library};
pub use metadata::{contract_of, trained_on};
pub use problem::ContractProblem;
pub use recogniser::{
    DEFAULT_REST_MOVE_MODEL_FILE, ModelFiles, Recogniser, RecogniserFiles, default_model_file,
};
pub use tendon_people::{Adaptation, Recognition};

pub use rest::{RestCheck, RestDifference};
pub use trained_on::TrainedOn;

use run::{RunError, Runner};

/// Why there is no classifier.
#[derive(Debug, thiserror::Error)]
pub enum ClassifierError {
    /// No runtime library was found.
    #[error(
        "ONNX Runtime's library was not found: run scripts/fetch-onnxruntime, or set ORT_DYLIB_PATH or \
         inference.runtime_library to libonnxruntime.so"
    )]
    NoRuntimeLibrary,
    /// The runtime library cannot be used.
    #[error(
        "{}: cannot be used as ONNX Runtime: {reason}; scripts/fetch-onnxruntime fetches the version that fits",
        path.display()
    )]
    RuntimeLibrary {
        /// The library.
        path: PathBuf,
        /// The message of ort.
        reason: String,
    },
    /// No model was found.
    #[error("the model models/{file} was not found beside the programs: name one with --model FILE")]
    NoModel {
        /// The file looked for.
        file: String,
    },
    /// The model cannot be loaded.
    #[error("{}: cannot be loaded as an ONNX model: {reason}; is the file whole?", path.display())]
    Model {
        /// The model.
        path: PathBuf,
        /// ONNX Runtime's own word.
        reason: String,
    },
    /// The metadata do not say, or not sensibly, what the model was trained for.
    #[error("{}: {problem}; export it with models/training/train.py, which writes the metadata", path.display())]
    Contract {
        /// The model.
        path: PathBuf,
        /// What is missing or wrong.
        problem: ContractProblem,
    },
    /// The model was trained for something else.
    #[error("{}: does not fit: {differences}; take another model with --model, or change the settings", path.display())]
    Unfit {
        /// The model.
        path: PathBuf,
        /// Everything in which it differs, by name.
        differences: String,
    },
    /// The personal strategy without a person.
    #[error(
        "decision.strategy = \"personal\" needs a person: name one with --person NAME or inference.person; `tendon \
         calibrate` makes one"
    )]
    NoPerson,
    /// A network is to adapt.
    #[error(
        "inference.adaptation = \"slow\" is for a person's recogniser, and decision.strategy is not \"personal\": add \
         --person NAME, or set inference.adaptation to \"off\""
    )]
    OnlyPersonsAdapt,
    /// The file holds no person that can be used.
    #[error(transparent)]
    Person(#[from] PersonFileError),
    /// The file holds another person, or another calibration, than when the session began.
    #[error(
        "{}: this is not the person that the session began with: the file was replaced meanwhile; start the session again to \
         run with what it holds now",
        path.display()
    )]
    OtherPerson {
        /// The person file.
        path: PathBuf,
    },
    /// The person was calibrated for something else.
    #[error(
        "{}: does not fit: {differences}; change the settings, or calibrate again with these", path.display()
    )]
    UnfitPerson {
        /// The person file.
        path: PathBuf,
        /// Everything in which it differs, by name.
        differences: String,
    },
    /// A person's recogniser refuses a window.
    #[error(transparent)]
    Recognise(#[from] RecogniseError),
    /// A window could not be classified.
    #[error("the model failed on a window: {reason}")]
    Run {
        /// ONNX Runtime's own word.
        reason: String,
    },
}

impl From<RunError> for ClassifierError {
    fn from(error: RunError) -> ClassifierError {
        ClassifierError::Run { reason: error.to_string() }
    }
}

/// A loaded model, ready to classify windows one by one. Once warm, classifying allocates nothing outside of
/// ONNX Runtime.
#[derive(Debug)]
pub struct Classifier {
    path: PathBuf,
    contract: Contract,
    runner: Runner,
}

impl Classifier {
    /// Loads ONNX Runtime from `library` and the model at `model`, for one thread.
    ///
    /// # Errors
    ///
    /// [`ClassifierError`], naming the file and the remedy.
    pub fn load(library: &Path, model: &Path) -> Result<Classifier, ClassifierError> {
        let environment = environment(library).map_err(|error| ClassifierError::RuntimeLibrary {
            path: library.to_owned(),
            reason: error.to_string(),
        })?;
        let model_error = |error: &dyn std::fmt::Display| ClassifierError::Model {
            path: model.to_owned(),
            reason: one_line(&error.to_string()),
        };
        tendon_input::check(model, tendon_input::LARGEST_MODEL).map_err(|error| model_error(&error))?;
        let contract_error = |problem| ClassifierError::Contract { path: model.to_owned(), problem };
        let session = open_session(&environment, model).map_err(|error| model_error(&error))?;
        let contract = {
            let metadata = session.metadata().map_err(|error| model_error(&error))?;
            Contract::read(|key| metadata.custom(key)).map_err(contract_error)?
        };
        let (input, output) = names_of_tensors(&session, &contract).map_err(contract_error)?;
        let shape = input_shape(&contract);
        let runner = Runner::new(session, [&input, &output], &shape, contract.classes.len())
            .map_err(|error| model_error(&error))?;
        let silence = vec![0.0; shape.iter().product::<i64>() as usize];
        let mut classifier = Classifier { path: model.to_owned(), contract, runner };
        let outputs = classifier.classify(&silence)?.to_vec();
        if !are_probabilities(&outputs) {
            return Err(contract_error(ContractProblem::NoProbabilities { outputs }));
        }
        Ok(classifier)
    }

    /// The model's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the model was trained for.
    pub fn contract(&self) -> &Contract {
        &self.contract
    }

    /// Checks that the model was trained for this source of windows.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Unfit`], with everything that differs.
    pub fn check_fit(&self, source: &WindowSource<'_>) -> Result<(), ClassifierError> {
        let differences: Vec<String> =
            self.contract.mismatches(source).iter().map(ToString::to_string).collect();
        if differences.is_empty() {
            return Ok(());
        }
        Err(ClassifierError::Unfit { path: self.path.clone(), differences: differences.join("; ") })
    }

    /// Classifies one window, channel-major `[channels × samples]`, or, for a model of sequences, one
    /// sequence `[windows × channels × samples]`. It is read in place. Returns the probability of every class
    /// of the contract, in its order.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Run`] if the length of the window differs from the contract, or ONNX Runtime fails;
    /// [`ClassifierError::Contract`] if the outputs are finite, but no probabilities. Outputs that are not finite are
    /// returned as they are: they are no answer, and nobody acts on them.
    pub fn classify(&mut self, window: &[f32]) -> Result<&[f32], ClassifierError> {
        let outputs = self.runner.run(window)?;
        if outputs.iter().all(|output| output.is_finite()) && !are_probabilities(outputs) {
            let problem = ContractProblem::NoProbabilities { outputs: outputs.to_vec() };
            return Err(ClassifierError::Contract { path: self.path.clone(), problem });
        }
        Ok(outputs)
    }
}

/// The process's one ONNX Runtime environment: a second one is refused, and so is a second library.
fn environment(library: &Path) -> Result<Environment, RunError> {
    static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);
    let mut environment = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(environment) = &*environment {
        return Ok(environment.clone());
    }
    let library = ort::init_from(library).map_err(|error| RunError::Runtime(error.to_string()))?;
    let made = library.with_name("tendon").with_telemetry(false).build()?;
    Ok(environment.insert(made).clone())
}

/// Opens the model for one thread.
fn open_session(environment: &Environment, model: &Path) -> Result<Session, ort::Error> {
    let builder = Session::builder(environment)?.with_intra_threads(1)?.with_inter_threads(1)?;
    builder.with_optimization_level(GraphOptimizationLevel::Level3)?.commit_from_file(model)
}

/// Whether the outputs can be what a softmax gives, but for rounding.
fn are_probabilities(outputs: &[f32]) -> bool {
    let sum: f32 = outputs.iter().sum();
    outputs.iter().all(|output| (-1e-3..=1.0 + 1e-3).contains(output)) && (sum - 1.0).abs() < 1e-2
}

/// Names of the model's one input and one output, if their shapes are what the contract says.
fn names_of_tensors(session: &Session, contract: &Contract) -> Result<(String, String), ContractProblem> {
    let [input] = session.inputs() else {
        return Err(ContractProblem::Count { what: "input", found: session.inputs().len() });
    };
    let [output] = session.outputs() else {
        return Err(ContractProblem::Count { what: "output", found: session.outputs().len() });
    };
    let check = |what, dtype: &ValueType, expected: Vec<i64>| match dtype {
        ValueType::Tensor { ty: TensorElementType::Float32, shape, .. }
            if shape.len() == expected.len()
                && shape.iter().zip(&expected).all(|(actual, wanted)| *actual < 0 || actual == wanted) =>
        {
            Ok(())
        }
        _ => {
            let expected = tensor_in_words(TensorElementType::Float32, &expected);
            Err(ContractProblem::Shape { what, found: in_words(dtype), expected })
        }
    };
    check("input", input.dtype(), input_shape(contract))?;
    check("output", output.dtype(), vec![1, contract.classes.len() as i64])?;
    Ok((input.name().to_owned(), output.name().to_owned()))
}

/// What an input or output is, in words.
fn in_words(dtype: &ValueType) -> String {
    match dtype {
        ValueType::Tensor { ty, shape, .. } => tensor_in_words(*ty, shape),
        ValueType::Sequence(_) => "a sequence of tensors".to_owned(),
        ValueType::Map { .. } => "a map".to_owned(),
        ValueType::Optional(_) => "an optional value".to_owned(),
    }
}

/// `1 × 4 × 600 float32 numbers`.
fn tensor_in_words(element: TensorElementType, shape: &[i64]) -> String {
    let name = match element {
        TensorElementType::Float16 => "float16".to_owned(),
        TensorElementType::Float32 => "float32".to_owned(),
        TensorElementType::Float64 => "float64".to_owned(),
        TensorElementType::Int32 => "int32".to_owned(),
        TensorElementType::Int64 => "int64".to_owned(),
        other => other.to_string().to_ascii_lowercase(),
    };
    let lengths: Vec<String> =
        shape.iter().map(|&length| if length < 0 { "any".to_owned() } else { length.to_string() }).collect();
    match lengths.as_slice() {
        [] => format!("a single {name} number"),
        lengths => format!("{} {name} numbers", lengths.join(" × ")),
    }
}

/// Shape of the input tensor: `[1, channels, samples]`, or `[1, windows, channels, samples]` of a model of sequences.
fn input_shape(contract: &Contract) -> Vec<i64> {
    let Contract { channels, window_samples, sequence_windows, .. } = *contract;
    let windows = (sequence_windows > 1).then_some(sequence_windows);
    [1].into_iter().chain(windows).chain([channels, window_samples]).map(|size| size as i64).collect()
}

/// ONNX Runtime's messages contain line breaks; our errors are one sentence.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shape_is_told_in_words() {
        let words = |shape: &[i64]| tensor_in_words(TensorElementType::Float64, shape);
        assert_eq!(words(&[1, 4, -1]), "1 × 4 × any float64 numbers");
        assert_eq!(words(&[]), "a single float64 number");
    }

    #[test]
    fn outputs_are_probabilities_or_the_model_is_refused() {
        for (outputs, expected) in [
            (&[0.25_f32; 4][..], true),
            (&[1.0, 0.0], true),
            (&[5.26, -4.26], false),
            (&[0.5, 0.2], false),
            (&[f32::NAN, 1.0], false),
            (&[f32::INFINITY, 0.0], false),
        ] {
            assert_eq!(are_probabilities(outputs), expected, "{outputs:?}");
        }
    }
}
