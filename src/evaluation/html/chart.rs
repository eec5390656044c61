use plotters::backend::{DrawingBackend, SVGBackend};
use plotters::chart::ChartBuilder;
pub(super) use plotters::chart::SeriesLabelPosition as Legend;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea as _};
use plotters::element::{Circle, PathElement, Rectangle};
use plotters::series::LineSeries;
use plotters::style::{Color as _, RGBColor, WHITE};

use std::ops::Range;

/// Lines of more points have none drawn.
const MOST_DOTS: usize = 12;
/// Width and height, pixels of the page.
const SIZE: (u32, u32) = (460, 320);
const PALETTE: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(120, 120, 120),
];
const FAINT: RGBColor = RGBColor(170, 170, 170);

/// A plot of lines and dots.
pub(super) struct Chart<'a> {
    pub(super) title: &'a str,
    pub(super) x: Axis<'a>,
    pub(super) y: Axis<'a>,
    pub(super) series: Vec<Series>,
    /// A faint line from one corner to the other: what an honest estimator would have.
    pub(super) diagonal: bool,
    /// Where the names of several series stand: where no lines are.
    pub(super) legend: Legend,
}

pub(super) struct Axis<'a> {
    pub(super) label: &'a str,
    pub(super) range: Range<f64>,
    /// What stands at 0, 1, 2 and so on in place of these numbers; empty for the numbers themselves.
    pub(super) ticks: Vec<String>,
}

impl<'a> Axis<'a> {
    pub(super) fn new(label: &'a str, range: Range<f64>) -> Self {
        Self { label, range, ticks: Vec::new() }
    }

    fn tick(&self, value: f64) -> String {
        // The mesh asks for positions between ticks, too.
        let named = |(place, _): &(usize, &String)| (value - *place as f64).abs() < 1e-9;
        match self.ticks.iter().enumerate().find(named) {
            Some((_, name)) => name.clone(),
            None if self.ticks.is_empty() => {
                format!("{value:.2}").trim_end_matches('0').trim_end_matches('.').to_owned()
            }
            None => String::new(),
        }
    }
}

pub(super) struct Series {
    pub(super) name: String,
    pub(super) points: Vec<(f64, f64)>,
    pub(super) kind: Kind,
    /// Vertical lines: x, and from which y to which.
    pub(super) whiskers: Vec<(f64, f64, f64)>,
}

impl Series {
    pub(super) fn new(name: impl Into<String>, kind: Kind, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, kind, whiskers: Vec::new() }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Line,
    Dots,
}

impl Chart<'_> {
    /// The plot as an SVG element; nothing where it cannot be drawn.
    pub(super) fn svg(&self) -> String {
        Self::row(std::slice::from_ref(self))
    }

    /// Plots side by side as one SVG element.
    pub(super) fn row(charts: &[Self]) -> String {
        let mut svg = String::new();
        let width = u32::try_from(charts.len()).map_or(SIZE.0, |count| count.saturating_mul(SIZE.0));
        let drawn = {
            let area = SVGBackend::with_string(&mut svg, (width, SIZE.1)).into_drawing_area();
            let areas = area.split_evenly((1, charts.len()));
            charts.iter().zip(&areas).all(|(chart, area)| chart.draw(area).is_ok()) && area.present().is_ok()
        };
        if drawn { svg } else { String::new() }
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, ("sans-serif", 15))
            .margin(8)
            .x_label_area_size(38)
            .y_label_area_size(46)
            .build_cartesian_2d(self.x.range.clone(), self.y.range.clone())?;
        chart
            .configure_mesh()
            .x_desc(self.x.label)
            .y_desc(self.y.label)
            .x_labels(if self.x.ticks.is_empty() { 10 } else { self.x.ticks.len() })
            .x_label_formatter(&|value| self.x.tick(*value))
            .light_line_style(WHITE)
            .bold_line_style(FAINT.mix(0.4))
            .draw()?;
        if self.diagonal {
            let ends = [(self.x.range.start, self.y.range.start), (self.x.range.end, self.y.range.end)];
            chart.draw_series(LineSeries::new(ends, &FAINT))?;
        }
        for (series, colour) in self.series.iter().zip(PALETTE.into_iter().cycle()) {
            let inside = |value: f64, axis: &Axis<'_>| value.clamp(axis.range.start, axis.range.end);
            for (x, low, high) in &series.whiskers {
                let ends = [low, high].map(|y| (*x, inside(*y, &self.y)));
                chart.draw_series([PathElement::new(ends, colour.mix(0.6))])?;
            }
            let shown = series.points.iter().filter(|(x, y)| x.is_finite() && !y.is_nan());
            let points = shown.map(|(x, y)| (inside(*x, &self.x), inside(*y, &self.y)));
            let drawn = match series.kind {
                Kind::Line => {
                    // A single point has no line; of many, dots hide it.
                    let dots = if series.points.len() <= MOST_DOTS { 2 } else { 0 };
                    chart.draw_series(LineSeries::new(points, colour.stroke_width(2)).point_size(dots))?
                }
                Kind::Dots => chart.draw_series(points.map(|point| Circle::new(point, 2, colour.mix(0.6).filled())))?,
            };
            drawn
                .label(series.name.as_str())
                .legend(move |(x, y)| Rectangle::new([(x, y - 3), (x + 12, y + 3)], colour.filled()));
        }
        if self.series.len() > 1 {
            chart
                .configure_series_labels()
                .position(self.legend.clone())
                .background_style(WHITE.mix(0.8))
                .border_style(FAINT)
                .draw()?;
        }
        Ok(())
    }
}
