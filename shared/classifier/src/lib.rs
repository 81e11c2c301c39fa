//! A trained model in ONNX Runtime, and the contract it carries.
//!
//! ```text
//! model.onnx ─┬─ graph:    window [1, channels, samples] ─▶ z-score ─▶ network ─▶ softmax ─▶ [1, classes]
//!             └─ metadata: channels, rate, window, filter, classes  =  Contract
//! ```
//!
//! A model is refused before its first window if its [`Contract`] does not fit what the session delivers.

mod contract;
mod locate;
mod recogniser;
mod run;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ort::environment::Environment;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::ValueType;
use tendon_gesture::Class;

pub use contract::{Contract, Mismatch, WindowSource};
pub use locate::{model_beside_program, runtime_library};
pub use recogniser::{DEFAULT_REST_MOVE_MODEL_FILE, Recogniser, default_model_file};

use run::Runner;

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
        /// ort's own word.
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
    /// The model says nothing, or nothing sensible, about what it was trained for.
    #[error("{}: {problem}; export it with models/training/train.py, which writes the metadata", path.display())]
    Contract {
        /// The model.
        path: PathBuf,
        /// What is missing or wrong.
        problem: String,
    },
    /// The model was trained for something else.
    #[error("{}: does not fit: {differences}; take another model with --model, or change the settings", path.display())]
    Unfit {
        /// The model.
        path: PathBuf,
        /// Everything in which it differs, by name.
        differences: String,
    },
    /// The outputs are no probabilities.
    #[error(
        "{}: its outputs are no probabilities, which lie from 0 to 1 and sum up to 1: {outputs}; export it with a softmax \
         as its last layer, as models/training/train.py does",
        path.display()
    )]
    NoProbabilities {
        /// The model.
        path: PathBuf,
        /// Each class and what the model gave for it.
        outputs: String,
    },
    /// A window could not be classified.
    #[error("the model failed on a window: {reason}")]
    Run {
        /// ONNX Runtime's own word.
        reason: String,
    },
}

/// A loaded model, ready to classify windows one by one. Once warm, classifying allocates nothing on our side.
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
        let library_error =
            |reason: String| ClassifierError::RuntimeLibrary { path: library.to_owned(), reason };
        let environment = environment(library).map_err(library_error)?;
        let model_error =
            |reason: String| ClassifierError::Model { path: model.to_owned(), reason: one_line(&reason) };
        if !model.is_file() {
            return Err(model_error("there is no such file".to_owned()));
        }
        let session = Session::builder(&environment)
            .map_err(|error| model_error(error.to_string()))?
            .with_intra_threads(1)
            .map_err(|error| model_error(error.to_string()))?
            .with_inter_threads(1)
            .map_err(|error| model_error(error.to_string()))?
            .with_optimization_level(GraphOptimizationLevel::Level3)
            .map_err(|error| model_error(error.to_string()))?
            .commit_from_file(model)
            .map_err(|error| model_error(error.to_string()))?;
        let contract_error = |problem: String| ClassifierError::Contract { path: model.to_owned(), problem };
        let contract = {
            let metadata = session.metadata().map_err(|error| model_error(error.to_string()))?;
            Contract::read(|key| metadata.custom(key)).map_err(contract_error)?
        };
        let (input, output) = names_of_tensors(&session, &contract).map_err(contract_error)?;
        let runner = Runner::new(session, [&input, &output], &input_shape(&contract), contract.classes.len())
            .map_err(|error| model_error(error.to_string()))?;
        let silence = vec![0.0; input_shape(&contract).iter().product::<i64>() as usize];
        let mut classifier = Classifier { path: model.to_owned(), contract, runner };
        classifier.classify(&silence)?;
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

    /// Makes sure that the model was trained for what delivers its windows.
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

    /// Classifies one window, channel-major `[channels × samples]`, or one sequence `[windows × channels ×
    /// samples]` if the model is of such, which is read in place. Returns the probability of every class of the
    /// contract, in its order.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Run`] when the window has another length than the contract says, or ONNX Runtime
    /// fails; [`ClassifierError::NoProbabilities`] when the outputs are none.
    pub fn classify(&mut self, window: &[f32]) -> Result<&[f32], ClassifierError> {
        self.probabilities(window).map(|(_, probabilities)| probabilities)
    }

    /// As [`Classifier::classify`], with the classes.
    fn probabilities(&mut self, window: &[f32]) -> Result<(&[Class], &[f32]), ClassifierError> {
        let outputs = self.runner.run(window).map_err(|reason| ClassifierError::Run { reason })?;
        if !are_probabilities(outputs) {
            let outputs = self.contract.classes.iter().zip(outputs);
            let outputs: Vec<String> = outputs.map(|(class, output)| format!("{class} {output}")).collect();
            return Err(ClassifierError::NoProbabilities {
                path: self.path.clone(),
                outputs: outputs.join(", "),
            });
        }
        Ok((&self.contract.classes, outputs))
    }
}

/// Whether each lies from 0 to 1 and together they are 1, to within what rounding and reduced precision may do.
fn are_probabilities(outputs: &[f32]) -> bool {
    const TOLERANCE: f32 = 0.01;
    // A NaN is in no range.
    outputs.iter().all(|output| (-TOLERANCE..=1.0 + TOLERANCE).contains(output))
        && (outputs.iter().sum::<f32>() - 1.0).abs() <= TOLERANCE
}

/// The process's one ONNX Runtime environment: a second one is refused, and so is a second library.
fn environment(library: &Path) -> Result<Environment, String> {
    static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);
    let mut environment = ENVIRONMENT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(environment) = &*environment {
        return Ok(environment.clone());
    }
    let made = ort::init_from(library)
        .map_err(|error| error.to_string())?
        .with_name("tendon")
        .with_telemetry(false)
        .build()
        .map_err(|error| error.to_string())?;
    Ok(environment.insert(made).clone())
}

/// Names of the model's one input and one output, if their shapes are what the contract says.
fn names_of_tensors(session: &Session, contract: &Contract) -> Result<(String, String), String> {
    let [input] = session.inputs() else {
        return Err(format!("the model has {} inputs instead of one", session.inputs().len()));
    };
    let [output] = session.outputs() else {
        return Err(format!("the model has {} outputs instead of one", session.outputs().len()));
    };
    let fits = |dtype: &ValueType, wanted: &[i64]| match dtype {
        ValueType::Tensor { ty: ort::value::TensorElementType::Float32, shape, .. } => {
            shape.len() == wanted.len()
                && shape.iter().zip(wanted).all(|(actual, wanted)| *actual < 0 || actual == wanted)
        }
        _ => false,
    };
    let window = input_shape(contract);
    if !fits(input.dtype(), &window) {
        return Err(format!("the input is {:?}, not float32 {window:?} as the metadata say", input.dtype()));
    }
    let classes = [1, contract.classes.len() as i64];
    if !fits(output.dtype(), &classes) {
        return Err(format!(
            "the output is {:?}, not float32 {classes:?} as the metadata say",
            output.dtype()
        ));
    }
    Ok((input.name().to_owned(), output.name().to_owned()))
}

/// Shape of the input tensor: `[1, channels, samples]`, or `[1, windows, channels, samples]` of a model of sequences.
fn input_shape(contract: &Contract) -> Vec<i64> {
    let Contract { channels, window_samples, sequence_windows, .. } = *contract;
    let windows = (sequence_windows > 1).then_some(sequence_windows);
    [1].into_iter().chain(windows).chain([channels, window_samples]).map(|size| size as i64).collect()
}

/// ONNX Runtime's messages come with line breaks; an error of ours is one sentence.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::are_probabilities;

    #[test]
    fn probabilities_are_told_from_other_outputs() {
        assert!(are_probabilities(&[0.25, 0.75, 0.0]));
        assert!(are_probabilities(&[0.3334, 0.3334, 0.3334]));
        for outputs in
            [[5.26, -4.0, -0.26], [0.9, 0.9, 0.9], [f32::NAN, 0.5, 0.5], [0.0; 3], [f32::INFINITY; 3]]
        {
            assert!(!are_probabilities(&outputs), "{outputs:?}");
        }
    }
}
