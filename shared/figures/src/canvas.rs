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
use tendon_output::{OutputError, OutputFile};

/// Why a figure could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// Neither of the endings.
    #[error("{}: a figure is a .png or an .svg file", path.display())]
    Ending {
        /// The file.
        path: PathBuf,
    },
    /// It could not be drawn.
    #[error("{}: cannot draw the figure", path.display())]
    Draw {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: DrawError,
    },
    /// It could not be written.
    #[error(transparent)]
    Write(#[from] OutputError),
}

impl From<FigureError> for OutputError {
    fn from(error: FigureError) -> OutputError {
        match error {
            FigureError::Write(error) => error,
            FigureError::Ending { path } => {
                OutputError::Content { path, reason: "a figure is a .png or an .svg file".to_owned() }
            }
            FigureError::Draw { path, source } => {
                OutputError::Content { path, reason: format!("cannot draw the figure: {source}") }
            }
        }
    }
}

pub(crate) const FONT: &str = "sans-serif";

/// Why nothing could be drawn.
#[derive(Debug, thiserror::Error)]
pub enum DrawError {
    /// The font is broken.
    #[error("the font that comes with the program is broken")]
    Font,
    /// The drawing library, which has an error type of its own for each kind of file, refused.
    #[error("the drawing library refused: {0}")]
    Library(String),
}

/// Bytes of a pixel: red, green, blue.
const PIXEL: usize = 3;

/// Something that can be drawn on either kind of file.
pub(crate) trait Figure {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static;
}

/// Draws in memory, then writes the file as a whole.
pub(crate) fn draw(path: &Path, size: (u32, u32), figure: &impl Figure) -> Result<(), FigureError> {
    let draw_error = |source| FigureError::Draw { path: path.to_owned(), source };
    register_fonts().map_err(draw_error)?;
    let content = match path.extension().and_then(|ending| ending.to_str()) {
        Some("png") => png(size, figure).map_err(draw_error)?,
        Some("svg") => {
            let mut content = String::new();
            finish(figure, &SVGBackend::with_string(&mut content, size).into_drawing_area())
                .map_err(draw_error)?;
            content.into_bytes()
        }
        _ => return Err(FigureError::Ending { path: path.to_owned() }),
    };
    Ok(OutputFile::check(path)?.write_bytes(&content)?)
}

fn png(size: (u32, u32), figure: &impl Figure) -> Result<Vec<u8>, DrawError> {
    let (width, height) = size;
    let mut pixels = vec![0; width as usize * height as usize * PIXEL];
    finish(figure, &BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area())?;
    let mut content = Vec::new();
    let mut encoder = png::Encoder::new(&mut content, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().and_then(|mut image| image.write_image_data(&pixels)).map_err(text)?;
    Ok(content)
}

fn finish<B: DrawingBackend>(figure: &impl Figure, area: &DrawingArea<B, Shift>) -> Result<(), DrawError>
where
    B::ErrorType: 'static,
{
    area.fill(&WHITE).map_err(text)?;
    figure.draw(area)?;
    area.present().map_err(text)
}

/// The font comes with the program, so that figures are the same on every machine.
fn register_fonts() -> Result<(), DrawError> {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    let registered = REGISTERED.get_or_init(|| register_font(FONT, FontStyle::Normal, UBUNTU_LIGHT).is_ok());
    if *registered { Ok(()) } else { Err(DrawError::Font) }
}

pub(crate) fn text(error: impl Debug) -> DrawError {
    DrawError::Library(format!("{error:?}"))
}
