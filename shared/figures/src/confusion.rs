//! The confusion matrix as the paper draws it: row-normalised, each cell with its count and below it the percentage of
//! the true class.

use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, Color, DrawingArea, DrawingBackend, IntoFont, RGBColor, Rectangle, Text, WHITE,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use tendon_evaluation::Confusion;
use tendon_gesture::Class;

use crate::canvas::{DrawError, FONT, Figure, FigureError, draw, text};

/// Side of a cell, pixels.
const CELL: i32 = 96;
/// Room for the names of the classes and the titles, pixels.
const MARGIN: i32 = 110;
/// The darkest cell: 100 %.
const FULL: RGBColor = RGBColor(8, 48, 107);
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

struct Matrix<'a> {
    title: &'a str,
    classes: &'a [Class],
    confusion: &'a Confusion,
}

impl Figure for Matrix<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), DrawError>
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

#[cfg(test)]
mod tests {
    use super::*;
    use tendon_gesture::Gesture;

    fn confusion() -> Confusion {
        let mut confusion = Confusion::new(Gesture::PAPER.len());
        for class in 0..Gesture::PAPER.len() {
            (0..10 + class).for_each(|_| confusion.record(class, class));
        }
        confusion.record(3, 4);
        confusion
    }

    #[test]
    fn a_confusion_matrix_is_drawn_with_its_counts_and_percentages() {
        let folder = tempfile::tempdir().unwrap();
        let svg = folder.path().join("confusion.svg");
        confusion_figure(&svg, "six classes", &Gesture::PAPER.map(Class::Gesture), &confusion()).unwrap();
        let content = std::fs::read_to_string(&svg).unwrap();
        for part in ["six classes", "ulnar", "radial", "92.9 %", "7.1 %", "predicted"] {
            assert!(content.contains(part), "`{part}` is not in the figure");
        }
        let png = folder.path().join("confusion.png");
        confusion_figure(&png, "six classes", &Gesture::PAPER.map(Class::Gesture), &confusion()).unwrap();
        assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
    }

    #[test]
    fn another_ending_and_a_folder_that_is_not_there_are_refused_by_name() {
        let refused =
            confusion_figure(Path::new("figure.pdf"), "", &Gesture::PAPER.map(Class::Gesture), &confusion())
                .unwrap_err();
        assert!(refused.to_string().contains("figure.pdf: a figure is a .png or an .svg file"));
        let missing = confusion_figure(
            Path::new("/nowhere/x.png"),
            "",
            &Gesture::PAPER.map(Class::Gesture),
            &confusion(),
        )
        .unwrap_err();
        assert!(missing.to_string().starts_with("/nowhere/x.png: there is no folder /nowhere"));
    }
}
