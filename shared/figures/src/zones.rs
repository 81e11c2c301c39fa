//! The picture of a target-zone task: zones, the arm's path and the workspace, seen from in front of the arm. No gesture
//! moves along x, so all of it lies in one plane: from above there would be a line only.

use std::ops::Range;
use std::path::Path;

use glam::{DVec2, DVec3};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{
    BLACK, Cartesian2d, ChartBuilder, ChartContext, Circle, Color, DrawingArea, DrawingBackend, IntoFont,
    PathElement, RGBColor, Rectangle, ShapeStyle, Text, WHITE,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use tendon_zones::{TaskReport, Workspace, ZoneScore, ZoneShape, ZoneTask};

use crate::canvas::{DrawError, FONT, Figure, FigureError, draw, text};

/// Pixels a mm, the same in both directions.
const SCALE: f64 = 1.4;
/// Room for the labels of an axis, pixels.
const LABELS: u32 = 56;
/// Room around everything, pixels.
const MARGIN: u32 = 16;
/// Room for the title, pixels.
const CAPTION: u32 = 36;
/// Room for the line that explains colours and marks, pixels.
const LEGEND: u32 = 28;
/// Room around the workspace, mm.
const BORDER_MM: f64 = 20.0;
/// A point so near to the straight line between others, mm, is not drawn.
const STRAIGHT_MM: f64 = 0.5;
/// Points of the path in one straight piece, at most: bounds the work on a path that never leaves its place.
const LONGEST_PIECE: usize = 1000;
const REACHED: RGBColor = RGBColor(0, 140, 60);
const MISSED: RGBColor = RGBColor(200, 40, 30);
/// Room for a digit of a zone's number, pixels.
const DIGIT_WIDTH: f64 = 9.0;
const DIGIT_HEIGHT: f64 = 15.0;
/// Radius of a mark, pixels.
const MARK: i32 = 6;
const PATH: RGBColor = RGBColor(33, 113, 181);

/// Draws the zones of a task, reached ones in green and missed ones in red, numbered as they appeared (without a number
/// where it would cover others), the arm's
/// path (blue, from the circle to the dot) and the workspace (the frame). The view is from in front of the arm: y to
/// the right, z up.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn zones_figure(path: &Path, task: &ZoneTask, report: &TaskReport) -> Result<(), FigureError> {
    let picture = Zones { task, report };
    let [y_mm, z_mm] = picture.ranges_mm();
    let size = (pixels(&y_mm) + LABELS + 2 * MARGIN, pixels(&z_mm) + LABELS + CAPTION + LEGEND + 2 * MARGIN);
    draw(path, size, &picture)
}

/// Labels of an axis: one every 100 mm.
fn ticks(range_mm: &Range<f64>) -> usize {
    ((range_mm.end - range_mm.start) / 100.0).ceil() as usize + 1
}

fn pixels(range_mm: &Range<f64>) -> u32 {
    (SCALE * (range_mm.end - range_mm.start)).round() as u32
}

struct Zones<'a> {
    task: &'a ZoneTask,
    report: &'a TaskReport,
}

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

impl Figure for Zones<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let [y_mm, z_mm] = self.ranges_mm();
        let TaskReport { name, zones_reached, zones_timed_out, .. } = self.report;
        let title = format!("{name}, front view: {zones_reached} zones reached, {zones_timed_out} timed out");
        let (_, height) = area.dim_in_pixel();
        let (chart_area, legend_area) = area.split_vertically(height - LEGEND);
        let mut chart = ChartBuilder::on(&chart_area)
            .caption(title, (FONT, 20))
            .margin(MARGIN)
            .x_label_area_size(LABELS)
            .y_label_area_size(LABELS)
            .build_cartesian_2d(y_mm.clone(), z_mm.clone())
            .map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_labels(ticks(&y_mm))
            .y_labels(ticks(&z_mm))
            .x_label_formatter(&|mm| format!("{mm:.0}"))
            .y_label_formatter(&|mm| format!("{mm:.0}"))
            .bold_line_style(BLACK.mix(0.08))
            .x_desc("y, mm")
            .y_desc("z, mm")
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .draw()
            .map_err(text)?;
        self.draw_workspace(&mut chart)?;
        self.draw_zones(&mut chart)?;
        self.draw_path(&mut chart)?;
        self.draw_numbers(&mut chart)?;
        draw_legend(&legend_area)
    }
}

impl Zones<'_> {
    /// Ranges of y and z that hold the workspace and the whole path.
    fn ranges_mm(&self) -> [Range<f64>; 2] {
        let Workspace { min_mm, max_mm } = *self.task.workspace();
        let path = self.task.trajectory_mm();
        let low_mm = path.iter().fold(min_mm, |low, position| low.min(*position)) - BORDER_MM;
        let high_mm = path.iter().fold(max_mm, |high, position| high.max(*position)) + BORDER_MM;
        [low_mm.y..high_mm.y, low_mm.z..high_mm.z]
    }

    fn draw_workspace<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let Workspace { min_mm, max_mm } = *self.task.workspace();
        let corners = [(min_mm.y, min_mm.z), (max_mm.y, max_mm.z)];
        chart.draw_series([Rectangle::new(corners, BLACK.stroke_width(2))]).map_err(text).map(|_| ())
    }

    fn draw_zones<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let half_mm = self.report.width_mm / 2.0;
        for zone in &self.report.zones {
            let [_, across, up] = zone.centre_mm;
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

    fn draw_path<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let flat = |position_mm: &DVec3| DVec2::new(position_mm.y, position_mm.z);
        let path = straightened(&self.task.trajectory_mm().iter().map(flat).collect::<Vec<_>>());
        // Piece by piece: plotters gives a path that turns back on itself no width.
        let pieces = path.windows(2).map(|ends| {
            PathElement::new([<(f64, f64)>::from(ends[0]), ends[1].into()], PATH.stroke_width(2))
        });
        chart.draw_series(pieces).map_err(text)?;
        let [start, end] = [path.first(), path.last()].map(|end| end.copied().unwrap_or_default().into());
        chart
            .draw_series([
                Circle::new(start, MARK, PATH.stroke_width(2)),
                Circle::new(end, MARK, PATH.filled()),
            ])
            .map_err(text)
            .map(|_| ())
    }

    fn draw_numbers<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let centres: Vec<DVec2> =
            self.report.zones.iter().map(|zone| DVec2::new(zone.centre_mm[1], zone.centre_mm[2])).collect();
        let places = number_places(&centres, self.report.width_mm);
        let numbers =
            self.report.zones.iter().zip(places).enumerate().filter_map(|(index, (zone, place))| {
                let style =
                    (FONT, 14).into_font().color(&colour(zone)).pos(Pos::new(HPos::Center, VPos::Center));
                Some(Text::new((index + 1).to_string(), <(f64, f64)>::from(place?), style))
            });
        chart.draw_series(numbers).map_err(text).map(|_| ())
    }
}

/// Where the number of each zone stands so that no two overlap: inside it near its upper edge, since the path mostly ends
/// in the middle, or at another of its edges, inside or outside; `None` where there is no room.
fn number_places(centres_mm: &[DVec2], width_mm: f64) -> Vec<Option<DVec2>> {
    const SIDES: [DVec2; 4] = [DVec2::Y, DVec2::X, DVec2::NEG_Y, DVec2::NEG_X];
    let size_mm = |index: usize| {
        let digits = (index + 1).to_string().len() as f64;
        DVec2::new(digits * DIGIT_WIDTH, DIGIT_HEIGHT) / SCALE
    };
    let mut taken: Vec<(DVec2, DVec2)> = Vec::new();
    let place = |(index, centre): (usize, &DVec2)| {
        let size = size_mm(index);
        let is_free = |place: &DVec2| {
            taken.iter().all(|(other, other_size)| {
                let distance = (*place - *other).abs();
                let least = (size + *other_size) / 2.0;
                distance.x >= least.x || distance.y >= least.y
            })
        };
        let inside = SIDES.map(|side| *centre + side * 0.3 * width_mm);
        let outside = SIDES.map(|side| *centre + side * (0.5 * width_mm + size / 2.0));
        let free = inside.into_iter().chain(outside).find(is_free)?;
        taken.push((free, size));
        Some(free)
    };
    centres_mm.iter().enumerate().map(place).collect()
}

/// One line below the chart: what colours and marks mean.
fn draw_legend<B: DrawingBackend>(area: &DrawingArea<B, Shift>) -> Result<(), DrawError>
where
    B::ErrorType: 'static,
{
    let (width, height) = area.dim_in_pixel();
    let middle = height as i32 / 2 - 6;
    let entry = |index: u32| (LABELS + MARGIN + index * (width - LABELS) / 5) as i32;
    let write = |index: u32, content: &'static str| {
        let style = (FONT, 14).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(content, (entry(index) + MARK + 6, middle), style)).map_err(text)
    };
    let circle = |index: u32, style: ShapeStyle| {
        area.draw(&Circle::new((entry(index), middle), MARK, style)).map_err(text)
    };
    circle(0, REACHED.stroke_width(1))?;
    write(0, "zone reached")?;
    circle(1, MISSED.stroke_width(1))?;
    write(1, "zone timed out")?;
    circle(2, PATH.stroke_width(2))?;
    write(2, "path begins")?;
    circle(3, PATH.filled())?;
    write(3, "path ends")?;
    let frame = [(entry(4) - MARK, middle - MARK), (entry(4) + MARK, middle + MARK)];
    area.draw(&Rectangle::new(frame, BLACK.stroke_width(2))).map_err(text)?;
    write(4, "workspace")
}

/// The path without the points that lie within [`STRAIGHT_MM`] of the straight line between their neighbours.
fn straightened(path: &[DVec2]) -> Vec<DVec2> {
    let Some(first) = path.first() else { return Vec::new() };
    let mut kept = vec![*first];
    let mut anchor = 0;
    for next in 1..path.len() {
        let between = &path[anchor + 1..next];
        let is_straight =
            between.iter().all(|point| distance_to_piece(*point, path[anchor], path[next]) <= STRAIGHT_MM);
        if !is_straight || between.len() >= LONGEST_PIECE {
            anchor = next - 1;
            kept.push(path[anchor]);
        }
    }
    kept.extend(path[1..].last());
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
    fn numbers_of_zones_do_not_overlap_and_are_left_out_where_there_is_no_room() {
        // All in one place: as many as there are sides, inside and outside.
        let places = number_places(&[DVec2::ZERO; 12], 40.0);
        assert_eq!(places[0], Some(DVec2::new(0.0, 12.0)));
        let placed: Vec<DVec2> = places.iter().copied().flatten().collect();
        assert!((4..12).contains(&placed.len()), "{places:?}");
        for (index, place) in placed.iter().enumerate() {
            for other in &placed[..index] {
                let distance = (*place - *other).abs() * SCALE;
                assert!(distance.x >= DIGIT_WIDTH || distance.y >= DIGIT_HEIGHT, "{place} {other}");
            }
        }
        // Apart, each has its own.
        let apart: Vec<DVec2> = (0..12).map(|zone| DVec2::X * 50.0 * f64::from(zone)).collect();
        assert!(number_places(&apart, 40.0).iter().all(Option::is_some));
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
            for part in ["front view", "y, mm", "z, mm", "zones reached", "path begins"] {
                assert!(content.contains(part), "`{part}` is not in the figure");
            }
            // All lies in one plane across x, so no other view has anything to show.
            assert!(!content.contains("top view") && !content.contains("x, mm"));
            let png = folder.path().join("zones.png");
            zones_figure(&png, &task, &report).unwrap();
            assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
        }
    }
}
