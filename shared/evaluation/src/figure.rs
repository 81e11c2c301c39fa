//! Figures: the confusion matrix as the paper draws it (row-normalised, each cell with its count and below it
//! the percentage of the true class), and the histogram of latencies. PNG or SVG, by the file's ending.

use std::fmt::Debug;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use epaint_default_fonts::UBUNTU_LIGHT;
use hdrhistogram::Histogram;
use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, BitMapBackend, ChartBuilder, Color, DrawingArea, DrawingBackend, FontStyle, IntoDrawingArea,
    IntoFont, PathElement, RGBColor, Rectangle, SVGBackend, Text, WHITE,
};
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use tendon_gesture::Class;

use crate::confusion::Confusion;

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
/// Side of a cell of the confusion matrix, pixels.
const CELL: i32 = 96;
/// Room for the names of the classes and the titles, pixels.
const MARGIN: i32 = 110;
/// Size of the latency figure, pixels.
const HISTOGRAM_SIZE: (u32, u32) = (800, 480);
/// Bars of the latency figure.
const BARS: usize = 60;
/// The darkest cell: 100 %.
const FULL: RGBColor = RGBColor(8, 48, 107);
/// Lines and bars.
const BAR: RGBColor = RGBColor(66, 146, 198);
/// Cells from here on (percent) are dark, their text is white.
const DARK_PERCENT: f64 = 50.0;

/// Draws a confusion matrix.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn confusion_figure(
    path: &Path,
    title: &str,
    classes: &[Class],
    confusion: &Confusion,
) -> Result<(), FigureError> {
    let side = (2 * MARGIN + CELL * classes.len() as i32) as u32;
    draw(path, (side, side), &Matrix { title, classes, confusion })
}

/// Draws how often which latency occurred. Values are in ns; the axis is in ms.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn latency_figure(path: &Path, title: &str, latencies_ns: &Histogram<u64>) -> Result<(), FigureError> {
    draw(path, HISTOGRAM_SIZE, &Latencies { title, latencies_ns })
}

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

struct Matrix<'a> {
    title: &'a str,
    classes: &'a [Class],
    confusion: &'a Confusion,
}

impl Figure for Matrix<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let count = self.classes.len() as i32;
        let middle = MARGIN + CELL * count / 2;
        let write = |content: &str, at: (i32, i32), size: i32, colour: &RGBColor| {
            let style = (FONT, size).into_font().color(colour).pos(Pos::new(HPos::Center, VPos::Center));
            area.draw(&Text::new(content.to_owned(), at, style)).map_err(text)
        };
        let black = RGBColor(BLACK.0, BLACK.1, BLACK.2);
        let white = RGBColor(WHITE.0, WHITE.1, WHITE.2);
        write(self.title, (middle, MARGIN / 2), 22, &black)?;
        write("predicted", (middle, MARGIN + CELL * count + MARGIN * 3 / 4), 18, &black)?;
        write("true", (MARGIN / 4, middle), 18, &black)?;
        for (truth, class) in self.classes.iter().enumerate() {
            let along = MARGIN + CELL * truth as i32 + CELL / 2;
            write(class.name(), (MARGIN * 2 / 3, along), 16, &black)?;
            write(class.name(), (along, MARGIN + CELL * count + MARGIN / 4), 16, &black)?;
            for predicted in 0..self.classes.len() {
                let percent = self.confusion.row_percent(truth, predicted);
                let left = MARGIN + CELL * predicted as i32;
                let top = MARGIN + CELL * truth as i32;
                let cell = [(left, top), (left + CELL, top + CELL)];
                area.draw(&Rectangle::new(cell, shade(percent).filled())).map_err(text)?;
                let colour = if percent >= DARK_PERCENT { &white } else { &black };
                let centre = (left + CELL / 2, top + CELL / 2);
                let windows = self.confusion.count(truth, predicted).to_string();
                write(&windows, (centre.0, centre.1 - 12), 18, colour)?;
                write(&format!("{percent:.1} %"), (centre.0, centre.1 + 12), 15, colour)?;
            }
        }
        let frame = [(MARGIN, MARGIN), (MARGIN + CELL * count, MARGIN + CELL * count)];
        area.draw(&Rectangle::new(frame, black.stroke_width(1))).map_err(text)
    }
}

/// From white at 0 % to [`FULL`] at 100 %.
fn shade(percent: f64) -> RGBColor {
    let mix = |full: u8| (255.0 + (f64::from(full) - 255.0) * percent / 100.0).round() as u8;
    RGBColor(mix(FULL.0), mix(FULL.1), mix(FULL.2))
}

struct Latencies<'a> {
    title: &'a str,
    latencies_ns: &'a Histogram<u64>,
}

impl Figure for Latencies<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let (range_ms, bars) = bars(self.latencies_ns);
        let highest = bars.iter().copied().max().unwrap_or_default().max(1);
        let width_ms = (range_ms.end - range_ms.start) / BARS as f64;
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, (FONT, 22))
            .margin(16)
            .x_label_area_size(44)
            .y_label_area_size(64)
            .build_cartesian_2d(range_ms.clone(), 0.0..highest as f64 * 1.05)
            .map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("latency, ms")
            .y_desc("windows")
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .draw()
            .map_err(text)?;
        chart
            .draw_series(bars.iter().enumerate().map(|(bar, windows)| {
                let left = range_ms.start + width_ms * bar as f64;
                Rectangle::new([(left, 0.0), (left + width_ms * 0.9, *windows as f64)], BAR.filled())
            }))
            .map_err(text)?;
        let mean_ms = self.latencies_ns.mean() / 1e6;
        let line =
            PathElement::new([(mean_ms, 0.0), (mean_ms, highest as f64 * 1.05)], BLACK.stroke_width(2));
        chart.draw_series([line]).map_err(text).map(|_| ())
    }
}

/// Range of the latencies in ms, to the 99th percentile, and how many fall into each bar; what lies beyond is in
/// the last one.
fn bars(latencies_ns: &Histogram<u64>) -> (Range<f64>, [u64; BARS]) {
    let ms = |ns: u64| ns as f64 / 1e6;
    let mut counts = [0; BARS];
    if latencies_ns.is_empty() {
        return (0.0..1.0, counts);
    }
    let start = ms(latencies_ns.min());
    let end = ms(latencies_ns.value_at_quantile(0.99)).max(start + 1e-3);
    for value in latencies_ns.iter_recorded() {
        let place = (ms(value.value_iterated_to()) - start) / (end - start) * BARS as f64;
        counts[(place.max(0.0) as usize).min(BARS - 1)] += value.count_at_value();
    }
    (start..end, counts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tendon_gesture::Gesture;

    fn confusion() -> Confusion {
        let mut confusion = Confusion::new(Gesture::COUNT);
        for gesture in Gesture::ALL {
            (0..10 + gesture.index()).for_each(|_| confusion.record(gesture.index(), gesture.index()));
        }
        confusion.record(3, 4);
        confusion
    }

    #[test]
    fn a_confusion_matrix_is_drawn_with_its_counts_and_percentages() {
        let folder = tempfile::tempdir().unwrap();
        let svg = folder.path().join("confusion.svg");
        confusion_figure(&svg, "six classes", &Gesture::ALL.map(Class::Gesture), &confusion()).unwrap();
        let content = std::fs::read_to_string(&svg).unwrap();
        for part in ["six classes", "ulnar", "radial", "92.9 %", "7.1 %", "predicted"] {
            assert!(content.contains(part), "`{part}` is not in the figure");
        }
        let png = folder.path().join("confusion.png");
        confusion_figure(&png, "six classes", &Gesture::ALL.map(Class::Gesture), &confusion()).unwrap();
        assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn every_latency_is_in_a_bar() {
        let mut latencies = Histogram::new_with_bounds(1, 60_000_000_000, 3).unwrap();
        for latency in 1..=1000_u64 {
            latencies.record(300_000_000 + latency * 10_000).unwrap();
        }
        let (range_ms, counts) = bars(&latencies);
        assert_eq!(counts.iter().sum::<u64>(), 1000);
        assert!((range_ms.start - 300.0).abs() < 0.5 && (range_ms.end - 310.0).abs() < 0.5, "{range_ms:?}");
        let folder = tempfile::tempdir().unwrap();
        latency_figure(&folder.path().join("latency.svg"), "latency", &latencies).unwrap();
        // Nothing measured is drawn, too.
        latencies.reset();
        latency_figure(&folder.path().join("latency.png"), "latency", &latencies).unwrap();
    }

    #[test]
    fn another_ending_and_a_folder_that_is_not_there_are_refused_by_name() {
        let refused =
            confusion_figure(Path::new("figure.pdf"), "", &Gesture::ALL.map(Class::Gesture), &confusion())
                .unwrap_err();
        assert!(refused.to_string().contains("figure.pdf: a figure is a .png or an .svg file"));
        let missing = confusion_figure(
            Path::new("/nowhere/x.png"),
            "",
            &Gesture::ALL.map(Class::Gesture),
            &confusion(),
        )
        .unwrap_err();
        assert!(missing.to_string().starts_with("/nowhere/x.png: cannot write the figure"));
    }
}
