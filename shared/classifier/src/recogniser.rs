//! What recognises gestures, whatever it is made of: the models of a strategy, or a person that was calibrated.
//!
//! ```text
//! threshold, direct   window ─▶ model ─▶ probabilities
//! two_stage           window ─▶ rest or move? ─ rest ─▶ probability of rest; 0 for all gestures
//!                                             └ move ─▶ five gestures ─▶ their probabilities; 0 for rest
//! personal            window ─▶ person ─▶ probabilities, effort, novelty
//! ```
//! Whoever cut the window says how strange its channels are, which counts as novelty with models and people alike.

use std::path::{Path, PathBuf};

use tendon_gesture::{Class, DecisionSettings, Gesture, GestureSet, Strategy};
use tendon_people::{Adaptation, Person, PersonalRecogniser, Recognition, SignalOffer};
use tendon_signal::WindowSettings;

use crate::locate::{model_beside_program, runtime_library};
use crate::{Classifier, ClassifierError, TrainedOn, WindowSource};

/// File name of the model that comes with Tendon to recognise gestures by `strategy`; `None` for a person.
pub const fn default_model_file(strategy: Strategy) -> Option<&'static str> {
    match strategy {
        Strategy::Threshold | Strategy::TwoStage => Some("cnn-five-gesture.onnx"),
        Strategy::Direct => Some("cnn-six-class.onnx"),
        Strategy::Personal => None,
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
    /// [`ClassifierError::NoModel`] when that one is not there, [`ClassifierError::NoPerson`] for the strategy that has no
    /// models.
    pub fn find(
        strategy: Strategy,
        model: Option<&Path>,
        rest_move_model: Option<&Path>,
    ) -> Result<ModelFiles, ClassifierError> {
        let find = |model: Option<&Path>, default: &str| {
            model.map_or_else(|| model_beside_program(default), |path| Ok(path.to_owned()))
        };
        let default = default_model_file(strategy).ok_or(ClassifierError::NoPerson)?;
        let gestures = find(model, default)?;
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

/// The files that a recogniser is made from, as they were named.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecogniserFiles<'a> {
    /// ONNX Runtime's shared library.
    pub runtime_library: Option<&'a Path>,
    /// The model of the gestures.
    pub model: Option<&'a Path>,
    /// The model of rest and move, for the two-stage strategy.
    pub rest_move_model: Option<&'a Path>,
    /// The person, for the personal strategy.
    pub person: Option<&'a Path>,
    /// [`Person::checksum`] of the person that is wanted; `None` takes whomever the file holds.
    pub person_checksum: Option<&'a str>,
}

/// Turns windows into probabilities of gestures.
#[derive(Debug)]
pub struct Recogniser(Kind);

#[derive(Debug)]
enum Kind {
    Networks(Box<Networks>),
    Person(Box<OfPerson>),
}

/// The model of a strategy, or the two of the two-stage strategy.
#[derive(Debug)]
struct Networks {
    gestures: Classifier,
    /// For each output of the model of the gestures, where its probability goes.
    places: Vec<usize>,
    rest_move: Option<RestMove>,
    /// By class number.
    probabilities: Vec<f32>,
    /// A network does not tell how hard a gesture is made: always 1.
    efforts: Vec<f32>,
}

/// A person and where they come from.
#[derive(Debug)]
struct OfPerson {
    path: PathBuf,
    person: Person,
    recogniser: PersonalRecogniser,
}

/// The first stage of the two-stage strategy.
#[derive(Debug)]
struct RestMove {
    classifier: Classifier,
    /// Which of the two outputs is rest.
    rest: usize,
}

impl Recogniser {
    /// Makes the recogniser of the strategy of `decision`, from the files that were named or the models that come with
    /// Tendon. Windows follow one another as `windows` says.
    ///
    /// # Errors
    ///
    /// [`ClassifierError`], naming the file and the remedy.
    pub fn open(
        decision: &DecisionSettings,
        windows: &WindowSettings,
        files: &RecogniserFiles<'_>,
    ) -> Result<Recogniser, ClassifierError> {
        if decision.strategy != Strategy::Personal {
            let library = runtime_library(files.runtime_library)?;
            return Recogniser::load(&library, decision, files.model, files.rest_move_model);
        }
        let path = files.person.ok_or(ClassifierError::NoPerson)?;
        let person = Person::read(path)?;
        if files.person_checksum.is_some_and(|checksum| checksum != person.checksum()) {
            return Err(ClassifierError::OtherPerson { path: path.to_owned() });
        }
        Recogniser::of_person(person, path, &decision.gestures, windows)
    }

    /// The recogniser of `person`, who was read from the file `path`, in a session with these gestures.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::UnfitPerson`] if the session has other gestures.
    pub fn of_person(
        person: Person,
        path: &Path,
        session: &GestureSet,
        windows: &WindowSettings,
    ) -> Result<Recogniser, ClassifierError> {
        let unfit = |differences: String| ClassifierError::UnfitPerson { path: path.to_owned(), differences };
        let own = person.gesture_set();
        if own != *session {
            let names = |set: &GestureSet| set.iter().map(String::from).collect::<Vec<_>>().join(", ");
            return Err(unfit(format!(
                "gestures: calibrated with {}, decision.gestures has {}",
                names(&own),
                names(session)
            )));
        }
        let recogniser = PersonalRecogniser::new(&person, windows.increment_samples)
            .map_err(|error| unfit(error.to_string()))?;
        let of_person = OfPerson { path: path.to_owned(), person, recogniser };
        Ok(Recogniser(Kind::Person(Box::new(of_person))))
    }

    /// The same recogniser that follows its person during use, or does not.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::OnlyPersonsAdapt`] if a network is to adapt.
    pub fn with_adaptation(self, adaptation: Adaptation) -> Result<Recogniser, ClassifierError> {
        match self.0 {
            Kind::Networks(_) if adaptation != Adaptation::Off => Err(ClassifierError::OnlyPersonsAdapt),
            Kind::Networks(networks) => Ok(Recogniser(Kind::Networks(networks))),
            Kind::Person(mut of_person) => {
                of_person.recogniser = of_person.recogniser.with_adaptation(adaptation);
                Ok(Recogniser(Kind::Person(of_person)))
            }
        }
    }

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
        let (probabilities, efforts) = (vec![0.0; session.len()], vec![1.0; session.len()]);
        let networks = Networks { gestures, places, rest_move, probabilities, efforts };
        Ok(Recogniser(Kind::Networks(Box::new(networks))))
    }

    /// Checks that each model, or the person, fits the source of the windows.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Unfit`] or [`ClassifierError::UnfitPerson`], with everything that differs.
    pub fn check_fit(&self, source: &WindowSource<'_>) -> Result<(), ClassifierError> {
        match &self.0 {
            Kind::Networks(networks) => {
                let Networks { gestures, rest_move, .. } = &**networks;
                gestures.check_fit(source)?;
                rest_move.as_ref().map_or(Ok(()), |rest_move| rest_move.classifier.check_fit(source))
            }
            Kind::Person(of_person) => {
                let OfPerson { path, person, .. } = &**of_person;
                let differences = person.differences(&SignalOffer {
                    source: source.name,
                    channels: source.channels,
                    channel_names: None,
                    sample_rate_hz: source.sample_rate_hz,
                    unit: "",
                    window_samples: source.window_samples,
                    filter: source.filter,
                });
                if differences.is_empty() {
                    return Ok(());
                }
                let differences: Vec<String> = differences.iter().map(ToString::to_string).collect();
                Err(ClassifierError::UnfitPerson { path: path.clone(), differences: differences.join("; ") })
            }
        }
    }

    /// The files of the models, in the order in which they run, or that of the person.
    pub fn models(&self) -> Vec<&Path> {
        match &self.0 {
            Kind::Networks(networks) => networks.classifiers().map(Classifier::path).collect(),
            Kind::Person(of_person) => vec![&of_person.path],
        }
    }

    /// RMS of each channel at rest in the recordings that it learnt from, and their unit; both empty if it does not say.
    pub fn rest(&self) -> (Vec<f64>, &str) {
        match &self.0 {
            Kind::Networks(networks) => {
                let contract = networks.gestures.contract();
                (contract.rest_rms.clone(), &contract.unit)
            }
            Kind::Person(of_person) => {
                let Person { channels, signal, .. } = &of_person.person;
                (channels.iter().map(|channel| channel.rest_rms).collect(), &signal.unit)
            }
        }
    }

    /// Whom each model was trained on, as far as its metadata say. A person is not trained on anybody else.
    pub fn trained_on(&self) -> impl Iterator<Item = &TrainedOn> {
        let networks = match &self.0 {
            Kind::Networks(networks) => Some(&**networks),
            Kind::Person(_) => None,
        };
        networks.into_iter().flat_map(Networks::classifiers).map(|model| &model.contract().trained_on)
    }

    /// The probability of every gesture by class number, 0 for those that the model does not know; for a person also how
    /// hard each gesture would be made (1 from a network). The novelty is that of the signal, as given, or of the person
    /// if that is higher. `first_sample` is the window's place in the stream. The window is read in place.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Run`], as [`Classifier::classify`].
    pub fn recognise(
        &mut self,
        window: &[f32],
        first_sample: u64,
        novelty: f32,
    ) -> Result<Recognition<'_>, ClassifierError> {
        let mut recognition = match &mut self.0 {
            Kind::Networks(networks) => networks.recognise(window)?,
            Kind::Person(of_person) => of_person.recogniser.recognise(window, first_sample)?,
        };
        // What is no number stays so, and is strange, too.
        if novelty > recognition.novelty {
            recognition.novelty = novelty;
        }
        Ok(recognition)
    }

    /// Adapts to the window that was recognised last, where [adaptation](Self::with_adaptation) is on.
    pub fn adapt(&mut self) {
        if let Kind::Person(of_person) = &mut self.0 {
            of_person.recogniser.adapt();
        }
    }

    /// Forgets what it has seen, as if it were opened again: what the person's recogniser adapted to. Windows follow one
    /// another as `windows` says.
    ///
    /// # Errors
    ///
    /// None with a person that was opened before.
    pub fn begin_anew(&mut self, windows: &WindowSettings) -> Result<(), ClassifierError> {
        // A network knows nothing of the windows before.
        let Kind::Person(of_person) = &mut self.0 else { return Ok(()) };
        let adaptation = of_person.recogniser.adaptation();
        let recogniser = PersonalRecogniser::new(&of_person.person, windows.increment_samples);
        let recogniser = recogniser.map_err(|error| ClassifierError::UnfitPerson {
            path: of_person.path.clone(),
            differences: error.to_string(),
        })?;
        of_person.recogniser = recogniser.with_adaptation(adaptation);
        Ok(())
    }

    /// Runs every model on `window`, whatever it contains, as a rehearsal needs.
    ///
    /// # Errors
    ///
    /// [`ClassifierError::Run`], as [`Classifier::classify`].
    pub fn rehearse(&mut self, window: &[f32]) -> Result<(), ClassifierError> {
        match &mut self.0 {
            Kind::Networks(networks) => networks.rehearse(window),
            Kind::Person(of_person) => Ok(of_person.recogniser.recognise_alone(window).map(drop)?),
        }
    }
}

impl Networks {
    /// In the order in which they run.
    fn classifiers(&self) -> impl Iterator<Item = &Classifier> {
        let rest_move = self.rest_move.iter().map(|rest_move| &rest_move.classifier);
        rest_move.chain([&self.gestures])
    }

    /// With two stages, the probability of the first if it says rest, otherwise those of the second.
    fn recognise(&mut self, window: &[f32]) -> Result<Recognition<'_>, ClassifierError> {
        self.probabilities.fill(0.0);
        let mut moves = true;
        if let Some(rest_move) = &mut self.rest_move {
            let outputs = rest_move.classifier.classify(window)?;
            let (rest, movement) = (outputs[rest_move.rest], outputs[1 - rest_move.rest]);
            // Rest if both are equal, or if the model returns NaN: an arm that waits does less harm.
            moves = movement > rest;
            self.probabilities[REST] = rest;
        }
        if moves {
            for (place, probability) in self.places.iter().zip(self.gestures.classify(window)?) {
                self.probabilities[*place] = *probability;
            }
            if self.rest_move.is_some() {
                self.probabilities[REST] = 0.0;
            }
        }
        Ok(Recognition { probabilities: &self.probabilities, efforts: &self.efforts, novelty: 0.0 })
    }

    fn rehearse(&mut self, window: &[f32]) -> Result<(), ClassifierError> {
        if let Some(rest_move) = &mut self.rest_move {
            rest_move.classifier.classify(window)?;
        }
        self.gestures.classify(window).map(drop)
    }
}
