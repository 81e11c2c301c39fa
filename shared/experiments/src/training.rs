//! Runs the trainings that are missing, several at a time, each in a process of its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError, mpsc};
use std::time::{Duration, Instant};

use crate::error::ExperimentError;
use crate::plan::Training;
use crate::run::{Event, Settings};

/// Where the model of a training is written.
pub(crate) fn model_path(out: &Path, training: &Training) -> PathBuf {
    out.join("models").join(training.name() + ".onnx")
}

/// Trains what is not there yet, `settings.jobs` at a time.
pub(crate) fn train_all(
    settings: &Settings,
    trainings: &[Training],
    out: &Path,
    on_event: &mut dyn FnMut(Event<'_>),
) -> Result<(), ExperimentError> {
    let missing: Vec<&Training> =
        trainings.iter().filter(|training| !model_path(out, training).is_file()).collect();
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
                    let result = train(script, training, out);
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
fn train(script: &Path, training: &Training, out: &Path) -> Result<Duration, ExperimentError> {
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
