//! The figures of a model's scores, as files.

use std::path::Path;

use tendon_evaluation::Tally;

use crate::canvas::FigureError;
use crate::{confusion_figure, latency_figure};

/// Draws the confusion matrix and the histogram of the time per window into `folder`, which is made, as PNG and SVG;
/// their names begin with that of `model`.
///
/// # Errors
///
/// When the folder or a figure cannot be written.
pub fn write_score_figures(folder: &Path, model: &Path, tally: &Tally) -> Result<(), FigureError> {
    std::fs::create_dir_all(folder)
        .map_err(|error| FigureError::Write { path: folder.to_owned(), reason: error.to_string() })?;
    let name = model.file_stem().unwrap_or_default().to_string_lossy();
    for ending in ["png", "svg"] {
        let path = |figure: &str| folder.join(format!("{name}-{figure}.{ending}"));
        confusion_figure(&path("confusion"), &name, tally.classes(), tally.confusion())?;
        latency_figure(&path("work"), &format!("{name}: time for a window"), tally.work())?;
    }
    Ok(())
}
