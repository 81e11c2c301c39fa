//! Drawing on a file: PNG or SVG, by its ending, with the font that comes with the program.

use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use epaint_default_fonts::UBUNTU_LIGHT;
use plotters::coord::Shift;
use plotters::prelude::{
    BitMapBackend, DrawingArea, DrawingBackend, FontStyle, IntoDrawingArea, SVGBackend, WHITE,
};
use plotters::style::register_font;

/// Why a figure could not be made.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FigureError {
    /// Neither of the endings.
    #[error("{}: a figure is a .png or an .svg file", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
    },
    /// It could not be drawn or written.
    #[error("{}: cannot write the figure: {reason}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The drawing library's word.
        reason: String,
    },
}

pub(crate) const FONT: &str = "sans-serif";

/// Something that can be drawn on either kind of file.
pub(crate) trait Figure {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static;
}

pub(crate) fn draw(path: &Path, size: (u32, u32), figure: &impl Figure) -> Result<(), FigureError> {
    let write_error = |reason: String| FigureError::Write { path: path.to_owned(), reason };
    register_fonts().map_err(write_error)?;
    let drawn = match path.extension().and_then(|ending| ending.to_str()) {
        Some("png") => finish(figure, &BitMapBackend::new(path, size).into_drawing_area()),
        Some("svg") => finish(figure, &SVGBackend::new(path, size).into_drawing_area()),
        _ => return Err(FigureError::Ending { path: path.to_owned() }),
    };
    drawn.map_err(write_error)
}

fn finish<B: DrawingBackend>(figure: &impl Figure, area: &DrawingArea<B, Shift>) -> Result<(), String>
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE).map_err(text)?;
    figure.draw(area)?;
    area.present().map_err(text)
}

/// The font comes with the program, so that figures are the same on every machine.
fn register_fonts() -> Result<(), String> {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    let registered = REGISTERED.get_or_init(|| register_font(FONT, FontStyle::Normal, UBUNTU_LIGHT).is_ok());
    if *registered { Ok(()) } else { Err("the font that comes with the program is broken".to_owned()) }
}

pub(crate) fn text(error: impl Debug) -> String {
    format!("{error:?}")
}
