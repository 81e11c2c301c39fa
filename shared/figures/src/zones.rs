//! The picture of a target-zone task: zones, the arm's way and the workspace, from above and from the front.

use std::ops::Range;
use std::path::Path;

use glam::{DVec2, DVec3};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{
    BLACK, Cartesian2d, ChartBuilder, ChartContext, Circle, Color, DrawingArea, DrawingBackend, IntoFont,
    PathElement, RGBColor, Rectangle, Text, WHITE,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use tendon_zones::{TaskReport, Workspace, ZoneScore, ZoneShape, ZoneTask};

use crate::canvas::{FONT, Figure, FigureError, draw, text};

/// Pixels a mm, the same in both views and directions.
const SCALE: f64 = 1.4;
/// Room for the labels of an axis, pixels.
const LABELS: u32 = 56;
/// Room around everything, pixels.
const MARGIN: u32 = 16;
/// Room for the title of a view, pixels.
const CAPTION: u32 = 36;
/// Room around the workspace, mm.
const BORDER_MM: f64 = 20.0;
/// A point so near to the straight line between others, mm, is not drawn.
const STRAIGHT_MM: f64 = 0.5;
/// Points of the way in one straight piece, at most: bounds the work on a way that never leaves its place.
const LONGEST_PIECE: usize = 1000;
const REACHED: RGBColor = RGBColor(0, 140, 60);
const MISSED: RGBColor = RGBColor(200, 40, 30);
const WAY: RGBColor = RGBColor(33, 113, 181);

/// Draws the zones of a task, reached ones in green and missed ones in red, numbered as they appeared, the arm's
/// way (blue, from the circle to the dot) and the workspace (the frame): seen from above, and from the front, where
/// the motion is. The arm stands beyond x = 0.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn zones_figure(path: &Path, task: &ZoneTask, report: &TaskReport) -> Result<(), FigureError> {
    let picture = Zones { task, report };
    let [x_mm, y_mm, z_mm] = picture.ranges_mm();
    let width = pixels(&y_mm) + LABELS + 2 * MARGIN;
    draw(path, (width, height(&x_mm) + height(&z_mm)), &picture)
}

/// Labels of an axis: one every 100 mm.
fn ticks(range_mm: &Range<f64>) -> usize {
    ((range_mm.end - range_mm.start) / 100.0).ceil() as usize + 1
}

fn pixels(range_mm: &Range<f64>) -> u32 {
    (SCALE * (range_mm.end - range_mm.start)).round() as u32
}

/// Height of a view whose upward coordinate has this range.
fn height(range_mm: &Range<f64>) -> u32 {
    pixels(range_mm) + LABELS + CAPTION + 2 * MARGIN
}

struct Zones<'a> {
    task: &'a ZoneTask,
    report: &'a TaskReport,
}

/// A view: which coordinate is drawn upwards; y is drawn to the right in both.
#[derive(Clone, Copy)]
struct View {
    title: &'static str,
    label: &'static str,
    upwards: fn(DVec3) -> f64,
}

const TOP: View = View { title: "top view", label: "x, mm", upwards: |position_mm| position_mm.x };
const FRONT: View = View { title: "side view", label: "z, mm", upwards: |position_mm| position_mm.z };

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

impl Zones<'_> {
    /// Ranges of x, y and z that hold the workspace and the whole way.
    fn ranges_mm(&self) -> [Range<f64>; 3] {
        let Workspace { min_mm, max_mm } = *self.task.workspace();
        let way = self.task.trajectory_mm();
        let low_mm = way.iter().fold(min_mm, |low, position| low.min(*position)) - BORDER_MM;
        let high_mm = way.iter().fold(max_mm, |high, position| high.max(*position)) + BORDER_MM;
        [low_mm.x..high_mm.x, low_mm.y..high_mm.y, low_mm.z..high_mm.z]
    }

    fn draw_view<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>, view: View) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let [x_mm, y_mm, z_mm] = self.ranges_mm();
        let upwards_mm = (view.upwards)(DVec3::new(x_mm.start, 0.0, z_mm.start))
            ..(view.upwards)(DVec3::new(x_mm.end, 0.0, z_mm.end));
        let TaskReport { name, zones_reached, zones_timed_out, .. } = self.report;
        let title =
            format!("{name}, {}: {zones_reached} zones reached, {zones_timed_out} timed out", view.title);
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 20))
            .margin(MARGIN)
            .x_label_area_size(LABELS)
            .y_label_area_size(LABELS)
            .build_cartesian_2d(y_mm, upwards_mm.clone())
            .map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_labels(ticks(&self.ranges_mm()[1]))
            .y_labels(ticks(&upwards_mm))
            .x_label_formatter(&|mm| format!("{mm:.0}"))
            .y_label_formatter(&|mm| format!("{mm:.0}"))
            .bold_line_style(BLACK.mix(0.08))
            .x_desc("y, mm")
            .y_desc(view.label)
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .draw()
            .map_err(text)?;
        self.draw_workspace(&mut chart, view)?;
        self.draw_zones(&mut chart, view)?;
        self.draw_way(&mut chart, view)
    }

    fn draw_workspace<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let Workspace { min_mm, max_mm } = *self.task.workspace();
        let corners = [(min_mm.y, (view.upwards)(min_mm)), (max_mm.y, (view.upwards)(max_mm))];
        chart.draw_series([Rectangle::new(corners, BLACK.stroke_width(2))]).map_err(text).map(|_| ())
    }

    fn draw_zones<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let half_mm = self.report.width_mm / 2.0;
        for zone in &self.report.zones {
            let centre_mm = DVec3::from(zone.centre_mm);
            let (across, up) = (centre_mm.y, (view.upwards)(centre_mm));
            let colour = colour(zone);
            match self.report.shape {
                ZoneShape::Sphere => {
                    let radius = (SCALE * half_mm).round() as i32;
                    chart
                        .draw_series([
                            Circle::new((across, up), radius, colour.mix(0.12).filled()),
                            Circle::new((across, up), radius, colour.stroke_width(1)),
                        ])
                        .map_err(text)?;
                }
                ZoneShape::Cube => {
                    let corners = [(across - half_mm, up - half_mm), (across + half_mm, up + half_mm)];
                    chart
                        .draw_series([
                            Rectangle::new(corners, colour.mix(0.12).filled()),
                            Rectangle::new(corners, colour.stroke_width(1)),
                        ])
                        .map_err(text)?;
                }
            }
        }
        Ok(())
    }

    fn draw_way<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let flat = |position_mm: &DVec3| DVec2::new(position_mm.y, (view.upwards)(*position_mm));
        let way = straightened(&self.task.trajectory_mm().iter().map(flat).collect::<Vec<_>>());
        // Piece by piece: plotters gives a path that turns back on itself no width.
        let pieces = way
            .windows(2)
            .map(|ends| PathElement::new([<(f64, f64)>::from(ends[0]), ends[1].into()], WAY.stroke_width(2)));
        chart.draw_series(pieces).map_err(text)?;
        let [start, end] = [way.first(), way.last()].map(|end| end.copied().unwrap_or_default().into());
        chart
            .draw_series([Circle::new(start, 6, WAY.stroke_width(2)), Circle::new(end, 6, WAY.filled())])
            .map_err(text)?;
        // From above all zones lie on one line: their numbers would cover each other.
        if view.label == FRONT.label {
            self.draw_numbers(chart, view)?;
        }
        Ok(())
    }

    fn draw_numbers<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let numbers = self.report.zones.iter().enumerate().map(|(index, zone)| {
            let centre_mm = DVec3::from(zone.centre_mm);
            // Near the upper edge, since the way mostly ends in the middle.
            let place = (centre_mm.y, (view.upwards)(centre_mm) + 0.3 * self.report.width_mm);
            let style = (FONT, 14).into_font().color(&colour(zone)).pos(Pos::new(HPos::Center, VPos::Center));
            Text::new((index + 1).to_string(), place, style)
        });
        chart.draw_series(numbers).map_err(text).map(|_| ())
    }
}

impl Figure for Zones<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String>
    where
        B::ErrorType: 'static,
    {
        let [x_mm, ..] = self.ranges_mm();
        let (top, front) = area.split_vertically(height(&x_mm));
        self.draw_view(&top, TOP)?;
        self.draw_view(&front, FRONT)
    }
}

/// The way without the points that lie within [`STRAIGHT_MM`] of the straight line between their neighbours.
fn straightened(way: &[DVec2]) -> Vec<DVec2> {
    let Some(first) = way.first() else { return Vec::new() };
    let mut kept = vec![*first];
    let mut anchor = 0;
    for next in 1..way.len() {
        let between = &way[anchor + 1..next];
        let is_straight =
            between.iter().all(|point| distance_to_piece(*point, way[anchor], way[next]) <= STRAIGHT_MM);
        if !is_straight || between.len() >= LONGEST_PIECE {
            anchor = next - 1;
            kept.push(way[anchor]);
        }
    }
    kept.extend(way[1..].last());
    kept
}

/// Distance from a point to the straight piece between two others.
fn distance_to_piece(point: DVec2, from: DVec2, to: DVec2) -> f64 {
    let along = to - from;
    let share = ((point - from).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    point.distance(from + share * along)
}

fn colour(zone: &ZoneScore) -> RGBColor {
    if zone.reached { REACHED } else { MISSED }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tendon_zones::TaskSettings;

    #[test]
    fn a_straight_way_is_two_points_and_corners_and_turns_are_kept() {
        let point = |across: i32, up: i32| DVec2::new(across.into(), up.into());
        let right = (0..50).map(|across| point(across, 0));
        let up_and_back = (0..20).chain((0..10).rev()).map(|up| point(49, up));
        let way: Vec<DVec2> = right.chain(up_and_back).collect();
        assert_eq!(straightened(&way), [point(0, 0), point(49, 0), point(49, 19), point(49, 0)]);
        assert_eq!(straightened(&[]), []);
        assert_eq!(straightened(&[DVec2::ONE]), [DVec2::ONE]);
    }

    #[test]
    fn zones_and_way_are_drawn_with_what_came_of_them() {
        let workspace =
            Workspace { min_mm: DVec3::new(200.0, -400.0, 100.0), max_mm: DVec3::new(600.0, 400.0, 650.0) };
        for settings in [TaskSettings::default(), TaskSettings::default().as_in_the_paper()] {
            let mut task = ZoneTask::new(&settings, workspace, 0.0, DVec3::new(386.0, 0.0, 362.0)).unwrap();
            for second in 1..40_u32 {
                // Every other zone is reached; the arm also leaves the workspace, which the picture still shows.
                let aside_mm = if second < 20 { DVec3::Y * 450.0 } else { DVec3::ZERO };
                task.observe(f64::from(second), task.zone().centre_mm + aside_mm);
            }
            let report = task.report("zones", "simulated", 0);
            let folder = tempfile::tempdir().unwrap();
            let svg = folder.path().join("zones.svg");
            zones_figure(&svg, &task, &report).unwrap();
            let content = std::fs::read_to_string(&svg).unwrap();
            for part in ["top view", "side view", "x, mm", "y, mm", "z, mm", "zones reached"] {
                assert!(content.contains(part), "`{part}` is not in the figure");
            }
            let png = folder.path().join("zones.png");
            zones_figure(&png, &task, &report).unwrap();
            assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
        }
    }
}
