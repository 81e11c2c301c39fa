//! Runs the trainings that are missing, several at a time, each in a process of its own.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use tendon_classifier::trained_on;
use tendon_dataset::Manifest;
use tendon_identity::{PersonId, list_of};

use crate::error::ExperimentError;
use crate::plan::Training;
use crate::run::{Event, Settings};

/// Where the model of a training is written.
pub(crate) fn model_path(out: &Path, training: &Training) -> PathBuf {
    out.join("models").join(training.name() + ".onnx")
}

/// Whom a model was trained on, compared with the people of a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Acquaintance {
    /// There is no model.
    Missing,
    /// On those whom the data set trains on.
    Same,
    /// On others, but on nobody whom the data set holds out for the test.
    Others,
    /// On these people, whom the data set holds out for the test.
    Tested(Vec<PersonId>),
    /// It does not say.
    Unknown,
}

impl Acquaintance {
    /// That of the model in the file `model` with `dataset`.
    pub(crate) fn of(model: &Path, dataset: &Manifest) -> Acquaintance {
        if !model.is_file() {
            return Acquaintance::Missing;
        }
        let trained = trained_on(model).unwrap_or_default();
        let tested = &dataset.split.test_people;
        let both: Vec<PersonId> = trained
            .people_of(dataset.data_set.as_deref())
            .iter()
            .copied()
            .filter(|person| tested.contains(person))
            .collect();
        if trained.people.is_empty() {
            Acquaintance::Unknown
        } else if !both.is_empty() {
            Acquaintance::Tested(both)
        } else if trained.data_set == dataset.data_set && trained.people == dataset.split.train_people {
            Acquaintance::Same
        } else {
            Acquaintance::Others
        }
    }

    /// Whether a score on the people held out is one on strangers.
    pub(crate) fn may_be_tested(&self) -> bool {
        matches!(self, Acquaintance::Same | Acquaintance::Others)
    }

    /// What the report says of the model `name`; `None` if there is nothing to say.
    pub(crate) fn remark(&self, name: &str) -> Option<String> {
        let remedy = "train it anew (leave --no-training out), or choose another folder with --out";
        match self {
            Acquaintance::Missing => Some(format!("{name} is not trained yet")),
            Acquaintance::Same => None,
            Acquaintance::Others => {
                Some(format!("{name} was trained on other people than its data set holds: {remedy}"))
            }
            Acquaintance::Tested(people) => {
                let people = list_of(people);
                Some(format!("{name} is not scored: it was trained on {people}, who are held out: {remedy}"))
            }
            Acquaintance::Unknown => {
                Some(format!("{name} is not scored: it does not say whom it was trained on: {remedy}"))
            }
        }
    }
}

/// Trains what is not there yet or was trained on other people, `settings.jobs` at a time.
pub(crate) fn train_all(
    settings: &Settings,
    trainings: &[Training],
    datasets: &BTreeMap<&'static str, Manifest>,
    out: &Path,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Result<(), ExperimentError> {
    let is_trained = |training: &&Training| {
        let dataset = &datasets[training.model.dataset];
        Acquaintance::of(&model_path(out, training), dataset) == Acquaintance::Same
    };
    let missing: Vec<&Training> = trainings.iter().filter(|training| !is_trained(training)).collect();
    if missing.is_empty() {
        return Ok(());
    }
    let script = find_train_script(&settings.program)?;
    on_event(Event::Line(format!(
        "{} trainings of {} epochs, {} at a time: some minutes each; logs in {}",
        missing.len(),
        settings.epochs,
        settings.jobs,
        out.join("logs").display()
    )));
    // The first run of the script may have to install PyTorch, which two must not do at once.
    let output = Command::new(&script).arg("--help").stdin(Stdio::null()).stdout(Stdio::null()).status();
    if !output.is_ok_and(|status| status.success()) {
        return Err(ExperimentError::TrainScript { script });
    }
    let next = Mutex::new(missing.iter());
    let (finished, results) = mpsc::channel();
    let (script, next) = (&script, &next);
    std::thread::scope(|scope| {
        for _ in 0..settings.jobs.max(1) {
            let finished = finished.clone();
            scope.spawn(move || {
                loop {
                    let taken = next.lock().unwrap_or_else(PoisonError::into_inner).next();
                    let Some(training) = taken else { break };
                    let result = train(script, training, out, settings.replaces);
                    let failed = result.is_err();
                    // Nobody listens any more once a training has failed.
                    if finished.send((training.name(), result)).is_err() || failed {
                        break;
                    }
                }
            });
        }
        drop(finished);
        for (index, (name, result)) in results.into_iter().enumerate() {
            let minutes = result?.as_secs_f64() / 60.0;
            let line = format!("{} of {}: {name} in {minutes:.0} min", index + 1, missing.len());
            on_event(Event::Line(line));
        }
        Ok(())
    })
}

/// Runs one training; how long it took.
fn train(
    script: &Path,
    training: &Training,
    out: &Path,
    replaces: bool,
) -> Result<Duration, ExperimentError> {
    let start = Instant::now();
    let log_path = out.join("logs").join(training.name() + ".txt");
    let unwritable = |reason| ExperimentError::Write { path: log_path.clone(), reason };
    let log = fs::File::create(&log_path).map_err(unwritable)?;
    let errors = log.try_clone().map_err(unwritable)?;
    let status = Command::new(script)
        .arg("--dataset")
        .arg(out.join("data").join(training.model.dataset))
        .arg("--out")
        .arg(model_path(out, training))
        .args(["--network", training.model.network, "--classes", training.model.classes, "--threads", "1"])
        .args(["--epochs", &training.epochs.to_string(), "--seed", &training.seed.to_string()])
        .args(replaces.then_some("--force"))
        .stdin(Stdio::null())
        .stdout(log)
        .stderr(errors)
        .status()
        .map_err(|reason| ExperimentError::Start { program: script.to_owned(), reason })?;
    if !status.success() {
        return Err(ExperimentError::Training { name: training.name(), status, log: log_path });
    }
    Ok(start.elapsed())
}

/// `scripts/train` in a folder above `program`, or in the current one.
fn find_train_script(program: &Path) -> Result<PathBuf, ExperimentError> {
    let folders = program.ancestors().skip(1).map(Path::to_owned).chain(std::env::current_dir());
    let mut scripts = folders.map(|folder| folder.join("scripts/train"));
    scripts
        .find(|path| path.is_file())
        .ok_or_else(|| ExperimentError::NoTrainScript { program: program.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tendon_dataset::{DatasetSettings, SplitEntry, SplitWindows, TrainingStatistics};

    fn manifest(train_people: &[u16], test_people: &[u16]) -> Manifest {
        let people = |numbers: &[u16]| numbers.iter().copied().map(PersonId::from).collect();
        Manifest {
            settings: DatasetSettings::default(),
            data_set: Some("3DC".to_owned()),
            classes: Vec::new(),
            channel_names: Vec::new(),
            unit: String::new(),
            windows: 0,
            windows_per_gesture: BTreeMap::new(),
            windows_per_person: BTreeMap::new(),
            named_people: BTreeMap::new(),
            fallbacks: 0,
            onsets: BTreeMap::new(),
            split: SplitEntry {
                test_people: people(test_people),
                test_sessions: Vec::new(),
                test_repetitions: Vec::new(),
                held_out: String::new(),
                train_people: people(train_people),
                validation_share: 0.2,
                seed: 0,
                windows: SplitWindows::default(),
            },
            training_statistics: TrainingStatistics::default(),
            recordings: Vec::new(),
            skipped: Vec::new(),
            skipped_by_kind: BTreeMap::new(),
            notices: Vec::new(),
            provenance: Default::default(),
        }
    }

    #[test]
    fn a_model_of_an_earlier_run_is_known_by_whom_it_was_trained_on() {
        let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/cnn-six-class.onnx");
        let own = [1, 3, 4, 5, 6, 7, 9, 11, 12, 13, 14, 15];
        let acquaintance = |manifest: &Manifest| Acquaintance::of(&model, manifest);
        assert_eq!(acquaintance(&manifest(&own, &[19, 20, 22])), Acquaintance::Same);
        assert_eq!(acquaintance(&manifest(&[1, 3, 19], &[20])), Acquaintance::Others);
        let tested = acquaintance(&manifest(&[4, 19, 20], &[3, 9, 22]));
        assert_eq!(tested, Acquaintance::Tested(vec![3.into(), 9.into()]));
        assert!(!tested.may_be_tested());
        let remark = tested.remark("cnn-raw").unwrap();
        assert!(remark.contains("cnn-raw is not scored: it was trained on 3, 9") && remark.contains("--out"));
        let of_others = Manifest { data_set: Some("Ozdemir 2022".to_owned()), ..manifest(&own, &[3]) };
        assert_eq!(acquaintance(&of_others), Acquaintance::Others, "3 of another data set is somebody else");
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("none.onnx");
        assert_eq!(Acquaintance::of(&missing, &manifest(&own, &[19])), Acquaintance::Missing);
        let silent = folder.path().join("silent.onnx");
        fs::write(&silent, b"").unwrap();
        let silent = Acquaintance::of(&silent, &manifest(&own, &[19]));
        assert_eq!((silent.may_be_tested(), silent), (false, Acquaintance::Unknown));
    }
}
