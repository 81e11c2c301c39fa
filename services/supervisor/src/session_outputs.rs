//! The files that `tendon run` is asked to write.

use std::path::{Path, PathBuf};
use std::time::Duration;

use tendon_figures::{FigureError, latency_figure, zones_figure};
use tendon_output::{OutputError, OutputErrors, OutputFile, OutputFolder, check_distinct, collect};
use tendon_report::{Report, SessionMeasurements, write_latency_log};
use tendon_session::Writer;
use tendon_zones::TaskRun;

use crate::Failure;
use crate::output::checked;

/// Files of a session, checked before it starts.
#[derive(Debug)]
pub struct SessionOutputs {
    json: Option<OutputFile>,
    latency_log: Option<OutputFile>,
    figures: Option<OutputFolder>,
}

impl SessionOutputs {
    /// Checks that everything can be written, and that no output replaces another or one of `inputs`.
    ///
    /// # Errors
    ///
    /// The first that cannot.
    pub fn check(
        json: Option<&Path>,
        latency_log: Option<&Path>,
        figures: Option<&Path>,
        inputs: &[PathBuf],
    ) -> Result<SessionOutputs, Failure> {
        let outputs = SessionOutputs {
            json: checked(json)?,
            latency_log: checked(latency_log)?,
            figures: figures.map(OutputFolder::check).transpose().map_err(Failure::input)?,
        };
        let files = outputs.json.iter().chain(&outputs.latency_log);
        check_distinct(files, &outputs.figures, inputs.iter().map(PathBuf::as_path))
            .map_err(Failure::input)?;
        Ok(outputs)
    }

    /// Writes all files, whatever becomes of the others. Without anything to draw, that is said instead.
    ///
    /// # Errors
    ///
    /// All that could not be written.
    pub fn write(
        &self,
        report: &Report,
        measurements: &SessionMeasurements,
        task: Option<&TaskRun>,
        standard_error: &Writer,
    ) -> Result<(), OutputErrors> {
        let json = self.json.iter().map(|file| file.write_json(report));
        let length = Duration::from_secs_f64(report.duration_s);
        let log = self
            .latency_log
            .iter()
            .map(|file| file.write(|mut out| write_latency_log(measurements, length, &mut out)));
        let has_commands = !measurements.newest_sample_to_command.is_empty();
        if let (Some(folder), false) = (&self.figures, has_commands) {
            standard_error.say(format!(
                "tendon: {}: there is nothing to draw, because the session gave no command",
                folder.path().display()
            ));
        }
        let drawn = self.figures.iter().filter(|_| has_commands);
        let figures = drawn.flat_map(|folder| write_figures(folder, measurements, task));
        collect(json.chain(log).chain(figures))
    }
}

/// Draws the latencies of the whole path and the zones, each as PNG and SVG.
fn write_figures(
    folder: &OutputFolder,
    measurements: &SessionMeasurements,
    task: Option<&TaskRun>,
) -> Vec<Result<(), OutputError>> {
    if let Err(error) = folder.make() {
        return vec![Err(error)];
    }
    let newest = &measurements.newest_sample_to_command;
    let window = &measurements.window_start_to_command.histogram;
    let mut results = Vec::new();
    for ending in ["png", "svg"] {
        let path = |name: &str| folder.path().join(format!("{name}.{ending}"));
        let newest_path = path("newest-sample-to-command");
        results.push(latency_figure(&newest_path, "newest sample to command", newest));
        results.push(latency_figure(&path("window-start-to-command"), "window start to command", window));
        if let Some((task, report)) = task.and_then(|run| run.under_way().zip(run.report(0))) {
            results.push(zones_figure(&path("zones"), task, &report));
        }
    }
    results.into_iter().map(|result| result.map_err(FigureError::into)).collect()
}
