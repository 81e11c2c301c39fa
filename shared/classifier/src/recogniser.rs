//! The models of a strategy, as one thing that turns windows into probabilities of gestures.

use std::path::{Path, PathBuf};

use tendon_gesture::{Class, DecisionSettings, Gesture, Strategy};

use crate::locate::model_beside_program;
use crate::{Classifier, ClassifierError, TrainedOn, WindowSource};

/// File name of the model that comes with Tendon to recognise gestures by `strategy`.
pub const fn default_model_file(strategy: Strategy) -> &'static str {
    match strategy {
        Strategy::Threshold | Strategy::TwoStage => "cnn-five-gesture.onnx",
        Strategy::Direct => "cnn-six-class.onnx",
    }
}

/// Class number of rest.
const REST: usize = 0;

/// File name of the model that comes with Tendon for the first stage of the two-stage strategy.
pub const DEFAULT_REST_MOVE_MODEL_FILE: &str = "cnn-rest-move.onnx";

/// The files of the models that a strategy needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelFiles {
    /// The model of the gestures.
    pub gestures: PathBuf,
    /// The model of rest and move, for the two-stage strategy.
    pub rest_move: Option<PathBuf>,
}

impl ModelFiles {
    /// The files that were named; where a path is left out, the model that comes with Tendon.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::NoModel`] when that one is not there.
    pub fn find(
        strategy: Strategy,
        model: Option<&Path>,
        rest_move_model: Option<&Path>,
    ) -> Result<ModelFiles, ClassifierError> {
        let find = |model: Option<&Path>, default: &str| {
            model.map_or_else(|| model_beside_program(default), |path| Ok(path.to_owned()))
        };
        let gestures = find(model, default_model_file(strategy))?;
        let is_two_stage = strategy == Strategy::TwoStage;
        let rest_move =
            is_two_stage.then(|| find(rest_move_model, DEFAULT_REST_MOVE_MODEL_FILE)).transpose()?;
        Ok(ModelFiles { gestures, rest_move })
    }

    /// The files in the order in which the models are asked.
    pub fn paths(&self) -> impl Iterator<Item = &Path> {
        self.rest_move.iter().chain([&self.gestures]).map(PathBuf::as_path)
    }
}

/// The model of a strategy, or the two of the two-stage strategy.
///
/// ```text
/// threshold, direct   window ─▶ model ─▶ probabilities
/// two_stage           window ─▶ rest or move? ─ rest ─▶ probability of rest; 0 for all gestures
///                                             └ move ─▶ five gestures ─▶ their probabilities; 0 for rest
/// ```
#[derive(Debug)]
pub struct Recogniser {
    gestures: Classifier,
    /// For each output of the model of the gestures, where its probability goes.
    places: Vec<usize>,
    rest_move: Option<RestMove>,
    /// By class number.
    probabilities: Vec<f32>,
}

/// The first stage of the two-stage strategy.
#[derive(Debug)]
struct RestMove {
    classifier: Classifier,
    /// Which of the two outputs is rest.
    rest: usize,
}

impl Recogniser {
    /// Loads what the strategy of `decision` needs from ONNX Runtime in `library`: `model`, and for the two-stage
    /// strategy `rest_move_model`; where a path is left out, the model that comes with Tendon.
    ///
    /// # Errors
    ///
    /// [`ClassifierError`], naming the file and the remedy.
    pub fn load(
        library: &Path,
        decision: &DecisionSettings,
        model: Option<&Path>,
        rest_move_model: Option<&Path>,
    ) -> Result<Recogniser, ClassifierError> {
        let DecisionSettings { strategy, gestures: ref session, .. } = *decision;
        let ModelFiles { gestures, rest_move: rest_move_file } =
            ModelFiles::find(strategy, model, rest_move_model)?;
        let gestures = Classifier::load(library, &gestures)?;
        let unfit = |classifier: &Classifier, needed: &'static str| {
            let classes: Vec<&str> = classifier.contract().classes.iter().map(|class| class.name()).collect();
            Err(ClassifierError::Unfit {
                path: classifier.path().to_owned(),
                differences: format!(
                    "it knows the classes {}; decision.strategy = \"{}\", {needed}",
                    classes.join(", "),
                    strategy.name()
                ),
            })
        };
        let classes = &gestures.contract().classes;
        if strategy == Strategy::Direct && !classes.contains(&Class::Gesture(Gesture::REST)) {
            return unfit(&gestures, "which needs a model that knows rest");
        }
        let mut places = Vec::new();
        for class in classes {
            match class {
                Class::Gesture(gesture) => match session.number(*gesture) {
                    Some(number) => places.push(usize::from(number)),
                    None => {
                        return Err(ClassifierError::Unfit {
                            path: gestures.path().to_owned(),
                            differences: format!("it knows the gesture {gesture}, which the session has not"),
                        });
                    }
                },
                Class::Move => {
                    return unfit(&gestures, "which needs a model that knows the gestures one by one");
                }
            }
        }
        let mut rest_move = None;
        if let Some(file) = rest_move_file {
            let classifier = Classifier::load(library, &file)?;
            let rest = match classifier.contract().classes[..] {
                [Class::Gesture(Gesture::REST), Class::Move] => 0,
                [Class::Move, Class::Gesture(Gesture::REST)] => 1,
                _ => return unfit(&classifier, "whose first stage needs a model of rest and move"),
            };
            rest_move = Some(RestMove { classifier, rest });
        }
        let probabilities = vec![0.0; session.len()];
        Ok(Recogniser { gestures, places, rest_move, probabilities })
    }

    /// Checks that each model fits the source of the windows.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Unfit`], with everything that differs.
    pub fn check_fit(&self, source: &WindowSource<'_>) -> Result<(), ClassifierError> {
        self.gestures.check_fit(source)?;
        self.rest_move.as_ref().map_or(Ok(()), |rest_move| rest_move.classifier.check_fit(source))
    }

    /// The files of the models, in the order in which they run.
    pub fn models(&self) -> Vec<&Path> {
        let rest_move = self.rest_move.iter().map(|rest_move| rest_move.classifier.path());
        rest_move.chain([self.gestures.path()]).collect()
    }

    /// Whom each model was trained on, as far as its metadata say.
    pub fn trained_on(&self) -> impl Iterator<Item = &TrainedOn> {
        let rest_move = self.rest_move.iter().map(|rest_move| &rest_move.classifier);
        rest_move.chain([&self.gestures]).map(|model| &model.contract().trained_on)
    }

    /// The probability of every gesture by class number, 0 for those that the model does not know. With two
    /// stages, the probability of the first if it says rest, otherwise those of the second. The window is
    /// read in place.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Run`], as [`Classifier::classify`].
    pub fn recognise(&mut self, window: &[f32]) -> Result<&[f32], ClassifierError> {
        self.probabilities.fill(0.0);
        if let Some(rest_move) = &mut self.rest_move {
            let outputs = rest_move.classifier.classify(window)?;
            let (rest, movement) = (outputs[rest_move.rest], outputs[1 - rest_move.rest]);
            // Rest if both are equal, or if the model returns NaN: an arm that waits does less harm.
            let moves = movement > rest;
            if !moves {
                self.probabilities[REST] = rest;
                return Ok(&self.probabilities);
            }
        }
        for (place, probability) in self.places.iter().zip(self.gestures.classify(window)?) {
            self.probabilities[*place] = *probability;
        }
        if self.rest_move.is_some() {
            self.probabilities[REST] = 0.0;
        }
        Ok(&self.probabilities)
    }

    /// Runs every model on `window`, whatever it contains, as a rehearsal needs.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Run`], as [`Classifier::classify`].
    pub fn rehearse(&mut self, window: &[f32]) -> Result<(), ClassifierError> {
        if let Some(rest_move) = &mut self.rest_move {
            rest_move.classifier.classify(window)?;
        }
        self.gestures.classify(window).map(drop)
    }
}
