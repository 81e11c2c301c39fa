//! The picture of a target-zone task: zones, the arm's path and the workspace.
//!
//! ```text
//!      front view           side view, where zones lie along x
//! z ┌──────────────┐    z ┌──────────────┐
//!   │  1 ○──┐      │      │    ○──┐ 1    │
//!   │       └─● 2  │      │    2 ●┘      │
//!   └──────────────┘ y    └──────────────┘ x
//! ```

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
/// the right, z up. Where zones lie along x, there is another beside it, from the arm's right: x to the right, z up.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn zones_figure(path: &Path, task: &ZoneTask, report: &TaskReport) -> Result<(), FigureError> {
    let picture = Zones { task, report };
    let widths = picture.views().map(|view| pixels(&picture.range_mm(view.across)) + LABELS + 2 * MARGIN);
    let height = pixels(&picture.range_mm(UP)) + LABELS + CAPTION + LEGEND + 2 * MARGIN;
    draw(path, (widths.sum(), height), &picture)
}

/// The component of a position that is up in every view.
const UP: usize = 2;

/// A view of the task.
#[derive(Clone, Copy)]
struct View {
    title: &'static str,
    /// The component of a position that goes to the right, and its name.
    across: usize,
    name: &'static str,
}

const FRONT: View = View { title: "front view", across: 1, name: "y, mm" };
const SIDE: View = View { title: "side view", across: 0, name: "x, mm" };

impl View {
    fn flat(self, position_mm: DVec3) -> DVec2 {
        DVec2::new(position_mm[self.across], position_mm[UP])
    }
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
        let TaskReport { name, zones_reached, zones_timed_out, .. } = self.report;
        let counts = format!("{zones_reached} zones reached, {zones_timed_out} timed out");
        let (_, height) = area.dim_in_pixel();
        let (mut views_area, legend_area) = area.split_vertically(height - LEGEND);
        for view in self.views() {
            let width = pixels(&self.range_mm(view.across)) + LABELS + 2 * MARGIN;
            let (view_area, others) = views_area.split_horizontally(width);
            // What there is to say of the task stands above the first view.
            let title = match view.across {
                across if across == FRONT.across => format!("{name}, {}: {counts}", view.title),
                _ => view.title.to_owned(),
            };
            self.draw_view(&view_area, view, &title)?;
            views_area = others;
        }
        draw_legend(&legend_area)
    }
}

impl Zones<'_> {
    /// From in front and, unless all zones lie in one plane across x, from the side.
    fn views(&self) -> impl Iterator<Item = View> + use<> {
        std::iter::once(FRONT).chain(self.task.axes()[SIDE.across].then_some(SIDE))
    }

    /// Range of a component of positions that holds the workspace and the whole path.
    fn range_mm(&self, component: usize) -> Range<f64> {
        let Workspace { min_mm, max_mm } = *self.task.workspace();
        let path = self.task.trajectory_mm().iter().map(|position| position[component]);
        let low_mm = path.clone().fold(min_mm[component], f64::min) - BORDER_MM;
        low_mm..path.fold(max_mm[component], f64::max) + BORDER_MM
    }

    fn draw_view<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        view: View,
        title: &str,
    ) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let (across_mm, up_mm) = (self.range_mm(view.across), self.range_mm(UP));
        let mut chart = ChartBuilder::on(area)
            .caption(title, (FONT, 20))
            .margin(MARGIN)
            .x_label_area_size(LABELS)
            .y_label_area_size(LABELS)
            .build_cartesian_2d(across_mm.clone(), up_mm.clone())
            .map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_labels(ticks(&across_mm))
            .y_labels(ticks(&up_mm))
            .x_label_formatter(&|mm| format!("{mm:.0}"))
            .y_label_formatter(&|mm| format!("{mm:.0}"))
            .bold_line_style(BLACK.mix(0.08))
            .x_desc(view.name)
            .y_desc("z, mm")
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .draw()
            .map_err(text)?;
        self.draw_workspace(&mut chart, view)?;
        self.draw_zones(&mut chart, view)?;
        self.draw_path(&mut chart, view)?;
        self.draw_numbers(&mut chart, view)
    }

    fn draw_workspace<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let Workspace { min_mm, max_mm } = *self.task.workspace();
        let corners = [min_mm, max_mm].map(|corner| <(f64, f64)>::from(view.flat(corner)));
        chart.draw_series([Rectangle::new(corners, BLACK.stroke_width(2))]).map_err(text).map(|_| ())
    }

    fn draw_zones<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let half_mm = self.report.width_mm / 2.0;
        for zone in &self.report.zones {
            let (across, up) = view.flat(zone.centre_mm.into()).into();
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

    fn draw_path<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let path: Vec<DVec2> =
            self.task.trajectory_mm().iter().map(|position_mm| view.flat(*position_mm)).collect();
        let path = straightened(&path);
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

    fn draw_numbers<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>, view: View) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let centres: Vec<DVec2> =
            self.report.zones.iter().map(|zone| view.flat(zone.centre_mm.into())).collect();
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
        let (plane, space) = ([false, true, true], [true; 3]);
        for (settings, axes) in
            [(TaskSettings::default(), plane), (TaskSettings::default().as_in_the_paper(), space)]
        {
            let mut task =
                ZoneTask::new(&settings, axes, workspace, 0.0, DVec3::new(386.0, 0.0, 362.0)).unwrap();
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
            // Where all lies in one plane across x, no other view has anything to show.
            for part in ["side view", "x, mm"] {
                assert_eq!(content.contains(part), axes == space, "`{part}`");
            }
            let png = folder.path().join("zones.png");
            zones_figure(&png, &task, &report).unwrap();
            assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
        }
    }
}
