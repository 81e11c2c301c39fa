//! The histogram of latencies.

use std::ops::Range;
use std::path::Path;

use hdrhistogram::Histogram;
use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, ChartBuilder, Color, DrawingArea, DrawingBackend, PathElement, RGBColor, Rectangle, WHITE,
};

use crate::canvas::{FONT, Figure, FigureError, draw, text};

/// Size of the figure, pixels.
const SIZE: (u32, u32) = (800, 480);
/// Number of bars.
const BARS: usize = 60;
const BAR: RGBColor = RGBColor(66, 146, 198);

/// Draws how often which latency occurred. Values are in ns; the axis is in ms.
///
/// # Errors
///
/// [`FigureError`], naming the file.
pub fn latency_figure(path: &Path, title: &str, latencies_ns: &Histogram<u64>) -> Result<(), FigureError> {
    draw(path, SIZE, &Latencies { title, latencies_ns })
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
}
