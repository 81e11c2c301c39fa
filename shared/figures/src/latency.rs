//! The histogram of latencies.
//!
//! ```text
//! windows              │ mean 0.41 ms
//!  100 ┤    ▐▌         │
//!   10 ┤   ▐██▌▐▌      │             beyond p99:
//!    1 ┤ ▐▌██████▐▌ ▐▌ │▐▌           12 windows,
//!      └─┬───────┬───────┬──  ████   at most 9.8 ms
//!       0.3     0.4     0.5   tail
//! ```
//!
//! Bars of one width go from the shortest latency to the 99th percentile. What lies beyond would press them into a
//! corner; it is one bar of another colour, apart and labelled. The count axis is logarithmic where a bar of a single
//! window could not be seen otherwise.

use std::ops::Range;
use std::path::Path;

use hdrhistogram::Histogram;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::{
    BLACK, Cartesian2d, ChartBuilder, ChartContext, Color, DrawingArea, DrawingBackend, IntoFont,
    PathElement, RGBColor, Rectangle, Text, WHITE,
};
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::canvas::{DrawError, FONT, Figure, FigureError, draw, text};

/// Size of the figure, pixels.
const SIZE: (u32, u32) = (800, 480);
/// Bars up to the 99th percentile, at most. None is narrower than what the histogram tells apart.
const BARS: u64 = 60;
/// Room between the last bar and the tail, as a share of the range of the bars.
const TAIL_GAP: f64 = 0.07;
/// Width of the tail's bar, and of the room for its label beside it, as shares of that range.
const TAIL_WIDTH: f64 = 0.07;
const TAIL_LABEL: f64 = 0.2;
/// From this count on a bar of one window is lower than two pixels of a linear axis.
const LOGARITHMIC_FROM: u64 = 200;
/// Where a logarithmic axis begins, so that one window is a visible bar.
const LOGARITHMIC_FLOOR: f64 = 0.5;
/// Room above the highest bar, for the mean's label.
const HEADROOM: f64 = 1.15;
/// Labels of an axis, at most.
const LABELS: f64 = 8.0;
const BAR: RGBColor = RGBColor(66, 146, 198);
const TAIL: RGBColor = RGBColor(217, 95, 14);

/// Draws how often which latency occurred. Values are in ns; the axis is in ms.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn latency_figure(path: &Path, title: &str, latencies_ns: &Histogram<u64>) -> Result<(), FigureError> {
    draw(path, SIZE, &Latencies { title, latencies_ns, bars: Bars::of(latencies_ns) })
}

struct Latencies<'a> {
    title: &'a str,
    latencies_ns: &'a Histogram<u64>,
    bars: Bars,
}

/// How many latencies fall into which bar.
struct Bars {
    /// What the bars of one width span, ms.
    range_ms: Range<f64>,
    counts: Vec<u64>,
    /// Latencies above the range.
    tail: u64,
}

impl Bars {
    fn of(latencies_ns: &Histogram<u64>) -> Bars {
        if latencies_ns.is_empty() {
            return Bars { range_ms: 0.0..1.0, counts: vec![0; BARS as usize], tail: 0 };
        }
        let last_ns = latencies_ns.value_at_quantile(0.99);
        let start_ns = latencies_ns.lowest_equivalent(latencies_ns.min());
        let end_ns = latencies_ns.next_non_equivalent(last_ns);
        let bars = ((end_ns - start_ns) / latencies_ns.equivalent_range(last_ns)).clamp(1, BARS);
        let mut counts = vec![0; bars as usize];
        let mut tail = 0;
        for value in latencies_ns.iter_recorded() {
            let latency_ns = value.value_iterated_to();
            if latency_ns > last_ns {
                tail += value.count_at_value();
            } else {
                let middle_ns = latencies_ns.median_equivalent(latency_ns).max(start_ns);
                let bar = (middle_ns - start_ns) * bars / (end_ns - start_ns);
                counts[bar.min(bars - 1) as usize] += value.count_at_value();
            }
        }
        Bars { range_ms: milliseconds(start_ns)..milliseconds(end_ns), counts, tail }
    }

    fn width_ms(&self) -> f64 {
        (self.range_ms.end - self.range_ms.start) / self.counts.len() as f64
    }

    fn highest(&self) -> u64 {
        self.counts.iter().copied().max().unwrap_or_default().max(self.tail).max(1)
    }
}

impl Figure for Latencies<'_> {
    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        let axis = LatencyAxis::of(&self.bars);
        let counts = CountAxis::up_to(self.bars.highest());
        let unit = if counts.is_logarithmic() { "windows (logarithmic)" } else { "windows" };
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, (FONT, 22))
            .margin(16)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(axis, counts)
            .map_err(text)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(BLACK.mix(0.08))
            .disable_x_mesh()
            .x_desc("latency, ms")
            .y_desc(unit)
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .draw()
            .map_err(text)?;
        let width_ms = self.bars.width_ms();
        let start = self.bars.range_ms.start;
        let bars = self.bars.counts.iter().enumerate().filter(|(_, windows)| **windows > 0);
        chart
            .draw_series(bars.map(|(bar, windows)| {
                let left = start + width_ms * bar as f64;
                Rectangle::new([(left, 0.0), (left + width_ms * 0.9, *windows as f64)], BAR.filled())
            }))
            .map_err(text)?;
        self.draw_tail(&mut chart)?;
        self.draw_mean(&mut chart)
    }
}

type Chart<'a, B> = ChartContext<'a, B, Cartesian2d<LatencyAxis, CountAxis>>;

impl Latencies<'_> {
    fn draw_tail<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        if self.bars.tail == 0 {
            return Ok(());
        }
        let range_ms = self.bars.range_ms.end - self.bars.range_ms.start;
        let left = self.bars.range_ms.end + TAIL_GAP * range_ms;
        let right = left + TAIL_WIDTH * range_ms;
        let bar = Rectangle::new([(left, 0.0), (right, self.bars.tail as f64)], TAIL.filled());
        chart.draw_series([bar]).map_err(text)?;
        let longest_ms = milliseconds(self.latencies_ns.max());
        let lines = [
            "beyond p99:".to_owned(),
            format!("{} {},", self.bars.tail, if self.bars.tail == 1 { "window" } else { "windows" }),
            format!("at most {} ms", short(longest_ms)),
        ];
        let (x, y) = chart.backend_coord(&(right, CountAxis::FLOOR));
        for (line, content) in lines.into_iter().rev().enumerate() {
            let style = (FONT, 14).into_font().color(&TAIL).pos(Pos::new(HPos::Left, VPos::Bottom));
            let place = (x + 6, y - 6 - 17 * line as i32);
            chart
                .plotting_area()
                .strip_coord_spec()
                .draw(&Text::new(content, self.inside(chart, place), style))
                .map_err(text)?;
        }
        Ok(())
    }

    fn draw_mean<B: DrawingBackend>(&self, chart: &mut Chart<'_, B>) -> Result<(), DrawError>
    where
        B::ErrorType: 'static,
    {
        if self.latencies_ns.is_empty() {
            return Ok(());
        }
        let mean_ms = self.latencies_ns.mean() / 1e6;
        let top = CountAxis::TOP;
        let Range { start, end } = self.bars.range_ms;
        // A few very long ones can take the mean beyond the axis.
        let is_on_axis = (start..=end).contains(&mean_ms);
        let at_ms = if is_on_axis { mean_ms } else { end };
        if is_on_axis {
            let line = PathElement::new([(mean_ms, 0.0), (mean_ms, top)], BLACK.stroke_width(2));
            chart.draw_series([line]).map_err(text)?;
        }
        let label = format!("mean {} ms{}", short(mean_ms), if is_on_axis { "" } else { ", beyond p99" });
        // On the side where there is room.
        let is_left = at_ms < start + 0.7 * (end - start);
        let (x, y) = chart.backend_coord(&(at_ms, top));
        let (side, shift) = if is_left { (HPos::Left, 6) } else { (HPos::Right, -6) };
        let style = (FONT, 14).into_font().color(&BLACK).pos(Pos::new(side, VPos::Top));
        let place = self.inside(chart, (x + shift, y));
        chart.plotting_area().strip_coord_spec().draw(&Text::new(label, place, style)).map_err(text)
    }

    /// A place on the whole figure as one within the plotting area.
    fn inside<B: DrawingBackend>(&self, chart: &Chart<'_, B>, (x, y): (i32, i32)) -> (i32, i32) {
        let (left, top) = chart.plotting_area().get_base_pixel();
        (x - left, y - top)
    }
}

/// Latencies in ms, labelled only as far as the bars go that stand for a latency each.
struct LatencyAxis {
    range_ms: Range<f64>,
    labelled_to_ms: f64,
}

impl LatencyAxis {
    fn of(bars: &Bars) -> LatencyAxis {
        let Range { start, end } = bars.range_ms;
        let tail = if bars.tail > 0 { TAIL_GAP + TAIL_WIDTH + TAIL_LABEL } else { 0.0 };
        LatencyAxis { range_ms: start..end + tail * (end - start), labelled_to_ms: end }
    }
}

impl Ranged for LatencyAxis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let Range { start, end } = self.range_ms;
        place((value - start) / (end - start), limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        let step = round_step((self.labelled_to_ms - self.range_ms.start) / LABELS);
        let first = (self.range_ms.start / step).ceil() as u64;
        let last = (self.labelled_to_ms / step).floor() as u64;
        (first..=last).map(|number| number as f64 * step).collect()
    }

    fn range(&self) -> Range<f64> {
        self.range_ms.clone()
    }
}

impl ValueFormatter<f64> for LatencyAxis {
    fn format_ext(&self, value: &f64) -> String {
        let step = round_step((self.labelled_to_ms - self.range_ms.start) / LABELS);
        let decimals = (-step.log10().floor()).max(0.0) as usize;
        format!("{value:.decimals$}")
    }
}

/// Counts, from 0 linear or from one half logarithmic.
struct CountAxis {
    highest: u64,
}

impl CountAxis {
    /// Anything at or below the axis.
    const FLOOR: f64 = 0.0;
    /// Anything above it.
    const TOP: f64 = f64::MAX;

    fn up_to(highest: u64) -> CountAxis {
        CountAxis { highest }
    }

    fn is_logarithmic(&self) -> bool {
        self.highest >= LOGARITHMIC_FROM
    }

    /// Logarithms have room above, too: a factor of the highest bar's height.
    fn share(&self, count: f64) -> f64 {
        let highest = self.highest as f64;
        if !self.is_logarithmic() {
            return count / (highest * HEADROOM);
        }
        let height = |count: f64| (count.max(LOGARITHMIC_FLOOR) / LOGARITHMIC_FLOOR).ln();
        height(count) / (height(highest) * HEADROOM)
    }
}

impl Ranged for CountAxis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        place(self.share(*value).min(1.0), limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        let highest = self.highest;
        if self.is_logarithmic() {
            return (0..)
                .map(|power| 10_u64.pow(power))
                .take_while(|count| *count <= highest)
                .map(|count| count as f64)
                .collect();
        }
        let step = round_step(highest as f64 / LABELS).max(1.0) as u64;
        (0..=highest / step).map(|number| (number * step) as f64).collect()
    }

    fn range(&self) -> Range<f64> {
        0.0..self.highest as f64 * HEADROOM
    }
}

impl ValueFormatter<f64> for CountAxis {
    fn format_ext(&self, value: &f64) -> String {
        format!("{value:.0}")
    }
}

/// The pixel at a share of an axis.
fn place(share: f64, (from, to): (i32, i32)) -> i32 {
    from + (share * f64::from(to - from)).round() as i32
}

/// The smallest of 1, 2 and 5 times a power of ten that is not less than `least`.
fn round_step(least: f64) -> f64 {
    let power = 10_f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * power)
        .into_iter()
        .find(|step| *step >= least)
        .unwrap_or(least)
}

fn milliseconds(ns: u64) -> f64 {
    ns as f64 / 1e6
}

/// Three significant digits, as many as the histogram tells.
fn short(value_ms: f64) -> String {
    let decimals = (2.0 - value_ms.max(1e-3).log10().floor()).max(0.0) as usize;
    format!("{value_ms:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn histogram(latencies_us: impl Iterator<Item = u64>) -> Histogram<u64> {
        let mut latencies = Histogram::new_with_bounds(1, 60_000_000_000, 3).unwrap();
        latencies_us.for_each(|latency_us| latencies.record(latency_us * 1000).unwrap());
        latencies
    }

    fn drawn(latencies: &Histogram<u64>) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("latency.svg");
        latency_figure(&path, "newest sample to command", latencies).unwrap();
        std::fs::read_to_string(path).unwrap()
    }

    #[test]
    fn every_latency_is_in_a_bar_or_in_the_tail() {
        let bars = Bars::of(&histogram((1..=1000).map(|latency| 300_000 + latency * 10)));
        assert_eq!(bars.counts.iter().sum::<u64>() + bars.tail, 1000);
        let Range { start, end } = bars.range_ms;
        assert!((start - 300.0).abs() < 0.5 && (end - 310.0).abs() < 0.5, "{start} to {end}");
    }

    #[test]
    fn no_bar_is_narrower_than_what_the_histogram_tells_apart() {
        let latencies = histogram((0..400).map(|index| 299_600 + index * 2));
        let bars = Bars::of(&latencies);
        assert!(bars.width_ms() >= milliseconds(latencies.equivalent_range(300_000_000)) * 0.99);
        assert!(bars.counts.iter().all(|windows| *windows > 0), "{:?}", bars.counts);
    }

    #[test]
    fn the_tail_is_labelled_with_its_count_and_maximum_and_the_mean_with_its_value() {
        let content = drawn(&histogram((1..=990).map(|index| 400 + index % 50).chain([9000; 10])));
        for part in ["beyond p99:", "10 windows,", "at most 9.00 ms", "mean 0.51", "windows"] {
            assert!(content.contains(part), "`{part}` is not in the figure");
        }
        let one = drawn(&histogram((1..=99).map(|index| 400 + index).chain([9000])));
        assert!(one.contains("1 window,"), "the number is not that of its noun");
        // Nothing beyond p99: nothing to label.
        assert!(!drawn(&histogram([400; 50].into_iter())).contains("beyond"));
        // Nothing measured can be drawn, too.
        assert!(!drawn(&histogram(std::iter::empty())).contains("mean"));
    }

    #[test]
    fn counts_are_whole_numbers_and_logarithmic_where_one_window_could_not_be_seen() {
        let labels = |highest| {
            let axis = CountAxis::up_to(highest);
            let points = axis.key_points(10);
            points.iter().map(|count| axis.format_ext(count)).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(labels(1), "0 1");
        assert_eq!(labels(5), "0 1 2 3 4 5");
        assert_eq!(labels(199), "0 50 100 150");
        assert_eq!(labels(4321), "1 10 100 1000");
        assert!(CountAxis::up_to(100_000).share(1.0) > 0.04, "a bar of one window is seen");
    }

    #[test]
    fn latencies_are_labelled_with_round_numbers_only_as_far_as_the_bars_go() {
        let axis = LatencyAxis { range_ms: 0.31..1.0, labelled_to_ms: 0.62 };
        let labels: Vec<String> = axis.key_points(10).iter().map(|value| axis.format_ext(value)).collect();
        assert_eq!(labels, ["0.35", "0.40", "0.45", "0.50", "0.55", "0.60"]);
    }
}
