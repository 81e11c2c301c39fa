//! The figures of a model's scores, as files.

use std::path::Path;

use tendon_evaluation::Tally;
use tendon_output::{OutputError, OutputFolder};

use crate::canvas::FigureError;
use crate::{confusion_figure, latency_figure};

/// Draws the confusion matrix and the histogram of the time per window into `folder`, which is made, as PNG and SVG;
/// their names begin with that of `model`. Each is drawn whatever becomes of the others.
pub fn write_score_figures(
    folder: &OutputFolder,
    model: &Path,
    tally: &Tally,
) -> Vec<Result<(), OutputError>> {
    if let Err(error) = folder.make() {
        return vec![Err(error)];
    }
    let name = model.file_stem().unwrap_or_default().to_string_lossy();
    let mut results = Vec::new();
    for ending in ["png", "svg"] {
        let path = |figure: &str| folder.path().join(format!("{name}-{figure}.{ending}"));
        results.push(confusion_figure(&path("confusion"), &name, tally.classes(), tally.confusion()));
        results.push(latency_figure(&path("work"), &format!("{name}: time for a window"), tally.work()));
    }
    results.into_iter().map(|result| result.map_err(FigureError::into)).collect()
}
